"""``pupper-analysis convert``: write an MJCF for a URDF, or a URDF for an MJCF."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from pupper_analysis.base import kinds
from pupper_analysis.base.arguments import match_names
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.inputs import path_exists
from pupper_analysis.cli import shared
from pupper_analysis.cli.modes import refuse_unused

_COMMON_OPTIONS = {"source", "output", "packages", "json_path", "style", "everything", "force"}
"""Parameters of the command that have an effect for both output formats."""
_MJCF_OPTIONS = {
    *("feet", "fixed_base", "armature", "repair_inertia", "copy_meshes"),
}
"""Parameters of the command that are used only if the output is an MJCF (``.xml``)."""

_XACRO_OPTIONS = {"xacro", "xacro_args"}
"""Parameters of ``convert`` that only a URDF as source uses."""

_USED_OPTIONS = {".urdf": _COMMON_OPTIONS, ".xml": _COMMON_OPTIONS | _MJCF_OPTIONS | _XACRO_OPTIONS}
"""{suffix of the output file: parameters of ``convert`` that have an effect for this format}. An
option without an effect is refused if the user typed it."""


def _propose_output(values: Mapping[str, Any]) -> str:
    """Return a file that does not exist, in the other format and beside the typed source."""
    source = Path(str(values["source"]))
    suffix = ".urdf" if source.suffix.lower() in (".xml", ".mjcf") else ".xml"
    stem = source.name.removesuffix(".xacro").removesuffix(".urdf").removesuffix(source.suffix)
    names = (f"{stem}{suffix}", *(f"{stem}_converted{number}{suffix}" for number in ("", 2, 3)))
    paths = [source.parent / name for name in names]
    return str(next((path for path in paths if not path_exists(path)), paths[0]))


@shared.command(
    "convert",
    meanings={"source": "the URDF, MJCF, USD or variant to convert"},
    examples={"-o": _propose_output},
)
@click.argument("source", type=shared.MODEL_FILE)
@shared.output_option(
    "-o",
    "--output",
    required=True,
    holds=kinds.MODEL_KIND,
    help="The file to write: .xml (from a URDF) or .urdf (from an MJCF).",
)
@click.option(
    "--foot",
    "feet",
    multiple=True,
    metavar="[NAME=]LINK",
    help="A foot; e.g. FL=FL_foot. Repeatable. By default the feet are detected.",
)
@click.option(
    "--fixed-base/--free-base",
    "fixed_base",
    default=None,
    help="Fix or free the base. By default a base with two or more limbs is free.",
)
@click.option(
    "--armature",
    multiple=True,
    metavar="[JOINTS=]KGM2",
    help="Rotor inertia (kg m^2) of all joints, or by pattern; e.g. '*knee*=0.01'. Repeatable.",
)
@click.option(
    "--repair-inertia",
    is_flag=True,
    help="Replace impossible inertias of moving links by the nearest possible ones; links "
    "without mass get 1 g.",
)
@click.option(
    "--copy-meshes", is_flag=True, help="Copy all meshes into NAME_meshes/ beside the output file."
)
@shared.package_option
@shared.xacro_options
@shared.json_option
@shared.text_format_option
@shared.verbose_option
def command(
    source: Path,
    output: Path,
    feet: tuple[str, ...],
    fixed_base: bool | None,
    armature: tuple[str, ...],
    repair_inertia: bool,
    copy_meshes: bool,
    packages: tuple[str, ...],
    xacro: bool,
    xacro_args: tuple[str, ...],
    json_path: Path | None,
    style: str,
    everything: bool,
) -> None:
    """Convert a URDF to an MJCF that is ready for simulation, or an MJCF to a URDF.

    All numbers of a URDF that an MJCF can express are kept. A floor, a free joint, feet, servos, a
    keyframe of the stand and an IMU are added. The output lists the additions, and values that the
    new format cannot express. The new file is then cross-checked with its source, and a new MJCF
    with a free base is simulated for 12 s.

    \b
    Examples:
      pupper-analysis convert robot.urdf -o new.xml
      pupper-analysis convert robot.urdf -o new.xml --armature 0.005
      pupper-analysis convert arm.urdf -o arm.xml --fixed-base
      pupper-analysis convert robot.urdf.xacro -o expanded.xml --xacro
      pupper-analysis convert robot.xml -o new.urdf
      pupper-analysis convert v3-long-leg -o long-leg.xml

    Exit status: 0 both files agree and the robot stands, 1 otherwise (the file is written
    nevertheless), 2 invalid input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.models.loading import read_as_urdf
    from pupper_analysis.pupper.named_robots import find_model
    from pupper_analysis.tools.convert.model import convert_model

    if output.suffix.lower() in _USED_OPTIONS:
        refuse_unused(output.suffix.lower(), _USED_OPTIONS)
    folders = shared.parse_packages(packages)
    named = dict(shared.parse_assignment("foot", foot) for foot in feet if "=" in foot)
    named |= {foot: foot for foot in feet if "=" not in foot}
    rotors, arguments = {}, shared.parse_xacro_args(xacro_args)
    if armature:
        request = arguments if xacro else None
        joints = read_as_urdf(find_model(source, "urdf"), folders, request).tree.joints.values()
        moving = [joint.name for joint in joints if not joint.is_fixed]
        rotors = _assign_by_pattern(armature, moving)
    with shared.show_progress("converting, and standing it for 12 s"):
        result = convert_model(
            source,
            output,
            feet=named or None,
            fixed_base=fixed_base,
            armature=rotors or None,
            repair_inertia=repair_inertia,
            copy_meshes=copy_meshes,
            packages=folders,
            xacro=xacro,
            xacro_args=arguments,
        )
    shared.show_results([("", result)], style, everything=everything)
    meshes = [path for path in result.written if Path(path) != Path(result.output)]
    if len(meshes) > _MAX_LISTED_MESHES and not everything:  # their folder, instead of each file
        meshes = [*dict.fromkeys(str(Path(path).parent) for path in meshes)]
    for path in (*meshes, result.output):
        shared.confirm_written(path)
    shared.finish_command(json_path, result, passed=result.passed)


_MAX_LISTED_MESHES = 2
"""Largest number of written mesh files whose names are printed without ``-v``. Chosen, not
tuned."""


def _assign_by_pattern(texts: tuple[str, ...], joints: list[str]) -> dict[str, float]:
    """Parse the texts ``[JOINTS=]KGM2`` of ``--armature`` to {joint: armature [kg m^2, kg]}.

    JOINTS is a name or a pattern (`match_names`); without JOINTS the value applies to all joints.
    """
    values = {}
    for text in texts:
        pattern, value = shared.parse_number_assignment(
            "armature", text if "=" in text else f"*={text}"
        )
        chosen = match_names(pattern, joints)
        if not chosen:
            message = diagnose("no-joint-like", pattern=pattern, known=joints)
            raise ConfigurationError("armature", message)
        values.update(dict.fromkeys(chosen, value))
    return values
