"""Writing a design as URDF, MJCF and stance, and evaluating the metrics again from the files.

Input is a study and a row of the results. The first output is a folder with both models, the
meshes, and the stance as a file of options. The second output is a comparison of the metrics in the
study with the metrics of the written files.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from pupper_analysis.base.arguments import check_type
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ConfigurationError, PupperAnalysisError
from pupper_analysis.base.files import Writing, write_all
from pupper_analysis.base.inputs import MAX_FILE_BYTES, read_input
from pupper_analysis.base.kinds import MODEL_KIND
from pupper_analysis.base.results import Result
from pupper_analysis.models.description import Description
from pupper_analysis.models.mjcf import to_xml
from pupper_analysis.models.published import existing_file
from pupper_analysis.models.urdf_file import urdf_from
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml import parse_text, to_text
from pupper_analysis.prepare.convert.load import load_robot
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tool import FramePoint, split_place, with_payload
from pupper_analysis.stance.stance_file import express_by_options, format_stance
from pupper_analysis.stance.stand import solve_stand
from pupper_analysis.stance.task import StandTask
from pupper_analysis.tools.study.design import DesignBuilder, measure_columns
from pupper_analysis.tools.study.measures import SET_DOWN_HEIGHT, Design, survives_set_down
from pupper_analysis.tools.study.store import require_library
from pupper_analysis.tools.study.study import Study

_METRIC_RTOL = 1e-6
"""Tolerance ``tol`` between the metrics of the study (expected) and of the written files (value).
Both values agree if |value - expected| <= tol max(|expected|, tol). The files contain all digits,
but the results of iterative solvers may differ within the solver tolerances. Chosen, not tuned.
"""

_MESH_FOLDER = "meshes"
"""Folder of the meshes, relative to the models."""


@dataclass(frozen=True, eq=False)
class WrittenDesign(Result):
    """Design of a study written to files, with the metrics before and after writing.

    Attributes:
        number: Row of the design in the table of the study, from 1.
        urdf: URDF of the design.
        mjcf: MJCF of the design.
        stance: Stance of the design, for ``--stance``.
        numbers: {variable: value}; names of motors are texts.
        study_values: {metric: value in the study}.
        file_values: {metric: value from the written files}; NaN for a metric that fails.
        command: Command that computes the stand from the written files.
        failures: Metrics whose values differ.
        warnings: Warning that the design stands, but not after a drop from 2 mm; empty without.
    """

    number: int
    urdf: Path
    mjcf: Path
    stance: Path
    numbers: Mapping[str, float | str] = field(metadata={"unit": "varies"})
    study_values: Mapping[str, float] = field(metadata={"unit": "varies"})
    file_values: Mapping[str, float] = field(metadata={"unit": "varies"})
    command: str
    failures: tuple[Diagnostic, ...]
    warnings: tuple[Diagnostic, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether the written files of a design give the metrics that the study has measured."""
        return not self.failures


def write_design(study: Study, number: int, folder: str | Path) -> WrittenDesign:
    """Write an evaluated design of a study to files, and evaluate the metrics of the files again.

    The folder ``design-NUMBER`` in the folder of the study gets the URDF, the MJCF with the servo
    gains, the meshes of both, and the stance as a file of options. The files describe the robot
    without the payload of the design, which is an option of the command.

    Args:
        study: Study.
        number: Row of the table, from 1.
        folder: Folder of the results of the study.

    Raises:
        ConfigurationError: If the row does not exist, or the design cannot be built, for example.
        OutputError: If a file cannot be written, or exists with other content.
    """
    check_type("study", study, Study)
    check_type("number", number, int)
    check_type("folder", folder, str | Path)
    require_library("pandas")
    table = study.stored_table(folder)
    if not 1 <= number <= len(table):
        finding = diagnose("design-not-there", number=number, count=len(table))
        raise ConfigurationError("number", finding)
    row = table.iloc[number - 1]
    codes = {name: variable.code_of(row[name]) for name, variable in study.variables.items()}
    design, bare = _build_design(study, codes, number)
    design_folder = Path(folder) / f"design-{number}"
    task = express_by_options(bare, design.stand.task)
    urdf, mjcf, stance = _write_design_files(study, task, bare, design_folder)
    loaded, options = _reload_files(bare, urdf, mjcf)
    payload = codes.get("payload", 0.0)
    if payload:
        loaded = with_payload(loaded, payload, design.point)
        options += ["--payload", f"{payload!r}kg", "--payload-at", format_place(design.point)]
    stand = solve_stand(loaded, task)
    reloaded = Design(
        loaded, stand, own_servos=design.own_servos, point=design.point, motors=design.motors
    )
    remeasured = measure_columns(reloaded, study.metrics)
    metric_names = [metric.name for metric in study.metrics]
    measured = {
        str(name): float(value)
        for name, value in row.items()
        if str(name).partition(".")[0] in metric_names and _is_number(value)
    }
    remeasured = {name: remeasured.get(name, math.nan) for name in measured}
    options = ["pupper-analysis", "stand", str(urdf), str(mjcf), *options, "--stance", str(stance)]
    return WrittenDesign(
        number=number,
        urdf=urdf,
        mjcf=mjcf,
        stance=stance,
        numbers={name: row[name] for name in study.variables},
        study_values=measured,
        file_values=remeasured,
        command=shlex.join(options),
        failures=tuple(_list_changed_metrics(number, measured, remeasured)),
        warnings=tuple(_warn_of_set_down(reloaded)),
    )


def _build_design(study: Study, codes: Mapping[str, float], number: int) -> tuple[Design, Robot]:
    """Build the design of a table row again, with visual meshes, to write the design as files.

    The second result is the robot of the design without payload. ``codes`` contains the value of
    each variable.
    """
    builder = DesignBuilder(
        study.make_source_with_visuals(),
        study.task,
        study.point,
        study.motors,
        study.present_motor,
    )
    try:
        return builder.design(codes), builder.robot_without_payload(codes)
    except PupperAnalysisError as error:
        finding = diagnose("design-makes-no-robot", number=number, reason=error.diagnostic)
        raise ConfigurationError("number", finding) from error


def _write_design_files(
    study: Study, task: StandTask, bare: Robot, folder: Path
) -> tuple[Path, Path, Path]:
    """Write the models of the robot without payload ``bare``, and the stance of the task.

    Returns:
        Paths of the URDF, the MJCF and the stance.
    """
    packages = getattr(getattr(study.source, "files", None), "options", {}).get("packages")
    contents = dict(_make_files(bare.description, packages))
    stance = Path("stance.toml")
    contents[stance] = format_stance(task).encode()
    write_all(
        [
            Writing(folder / place, content, MODEL_KIND)
            for place, content in contents.items()
            if not _has_content(folder / place, content)
        ]
    )
    urdf, mjcf = (folder / place for place in contents if place.suffix in (".urdf", ".xml"))
    return urdf, mjcf, folder / stance


def _list_changed_metrics(
    number: int, measured: Mapping[str, float], remeasured: Mapping[str, float]
) -> Iterator[Diagnostic]:
    """Yield a finding for each metric whose values in table and files differ (`_METRIC_RTOL`)."""
    for name, value in remeasured.items():
        expected = measured[name]
        tolerance = _METRIC_RTOL * max(abs(expected), _METRIC_RTOL)
        if not (value == expected or (abs(value - expected) <= tolerance < math.inf)):
            yield diagnose(
                "written-design-differs", number=number, metric=name, found=value, measured=expected
            )


def _warn_of_set_down(design: Design) -> Iterator[Diagnostic]:
    """Yield a warning if a design stands, but not after a small drop (`survives_set_down`)."""
    try:
        survives = survives_set_down(design)
    except PupperAnalysisError:  # the metrics state why it does not stand
        return
    if not survives:
        yield diagnose("stands-only-undisturbed", height=1e3 * SET_DOWN_HEIGHT)


def format_place(point: FramePoint) -> str:
    """Format a position as text for the option ``--payload-at``: ``x,y,z`` [m], or with a frame.

    Args:
        point: (x, y, z) or (frame, x, y, z) [m].
    """
    frame, place = split_place(point)
    numbers = ",".join(f"{float(value)!r}m" for value in place)
    return f"{frame},{numbers}" if frame else numbers


def _is_number(value: Any) -> bool:
    """Return True if the value of a table cell is a number, which may be infinite.

    An infinite metric is for example the time until a winding is hot that never becomes hot.
    """
    return value is not None and not bool(np.isnan(float(value)))


def _has_content(path: Path, content: bytes) -> bool:
    """Return True if a file exists with the given content, so that the file need not be written."""
    return path.is_file() and path.read_bytes() == content


def _reload_files(robot: Robot, urdf: Path, mjcf: Path) -> tuple[Robot, list[str]]:
    """Load the written files of ``robot``; return the loaded robot and the ``--foot`` options."""
    loaded = load_robot(urdf, mjcf)
    feet = robot.description.contact_points
    has_own_frames = any(link not in robot.description.made_frames for link, _ in feet.values())
    if not has_own_frames or loaded.description.contact_points == feet:
        return loaded, []
    options = [f"--foot={name}={link}:{frame}" for name, (link, frame) in feet.items()]
    return load_robot(urdf, mjcf, feet=dict(feet)), options


def _make_files(
    description: Description, packages: Mapping[str, Path] | None
) -> Iterator[tuple[Path, bytes]]:
    """Yield path and content of the URDF, the MJCF, and the referenced meshes and textures.

    Paths are relative to the folder of the design.
    """
    description = _without_made_frames(description)
    taken: dict[str, tuple[Path | None, bytes]] = {}
    urdf = urdf_from(
        description.urdf_source, description.urdf, parse_text(description.urdf), packages
    )
    for element in urdf.root.iter("mesh", "texture"):
        name = element.get("filename") or ""
        file = urdf.resolve_mesh(name) if name else None
        if file is not None:
            element.set("filename", _choose_path(taken, file, read_input(file, MAX_FILE_BYTES)))
    name = description.name.replace("/", "_")
    yield Path(f"{name}.urdf"), to_text(urdf.root).encode()
    yield Path(f"{name}.xml"), _render_mjcf(description, partial(_choose_path, taken)).encode()
    yield from ((Path(place), content) for place, (_, content) in taken.items())


def _without_made_frames(description: Description) -> Description:
    """Return the description without foot frames that loading added and will add again."""
    tree, spec = UrdfTree.of(description.urdf), description.mjcf.copy()
    for frame in description.made_frames:
        tree.remove_subtree(frame)
        spec.delete(spec.site(frame))
    return replace(description, urdf=to_text(tree.root), mjcf=spec)


def _choose_path(contents: dict[str, tuple[Path | None, bytes]], file: Path, content: bytes) -> str:
    """Choose the output path of a mesh or texture, and add its content to ``contents``."""
    number = 0
    while True:
        place = f"{_MESH_FOLDER}/{file.stem}{f'_{number}' if number else ''}{file.suffix}"
        if contents.setdefault(place, (file, content))[1] == content:
            return place
        number += 1


def _render_mjcf(description: Description, choose_path: Any) -> str:
    """Return the XML of the MJCF, with references to files replaced by other paths.

    ``choose_path(file, content)`` returns the path of a file in the XML.
    """
    spec = description.mjcf.copy()
    source_folder = description.mjcf_source.parent
    path_of_file: dict[str, str] = {}

    def find_file(name: str, folder: str) -> Path | None:
        """Return the path of a file that the MJCF references, such as a mesh; None if missing."""
        if not name:
            return None
        name = Path(name).name if spec.strippath else name
        return existing_file(source_folder / folder / name)

    def register_file(name: str, folder: str) -> str:
        """Choose the output path of a referenced file; return the present absolute path.

        The output path later replaces the absolute path in the rendered XML. A missing file keeps
        its name.
        """
        file = find_file(name, folder)
        if file is None:
            return name
        full = str(file.absolute())
        path_of_file[full] = choose_path(file, read_input(file, MAX_FILE_BYTES))
        return full

    for element in (*spec.meshes, *spec.hfields, *spec.skins):
        element.file = register_file(element.file, element.compiler.meshdir)
    for texture in spec.textures:
        texture.file = register_file(texture.file, texture.compiler.texturedir)
        texture.cubefiles = [
            register_file(file, texture.compiler.texturedir) for file in texture.cubefiles
        ]
    spec.compiler.meshdir = spec.compiler.texturedir = ""
    spec.strippath = False
    root = ElementTree.fromstring(to_xml(spec))
    for node in root.iter():
        for attribute, value in node.attrib.items():
            if value in path_of_file:
                node.set(attribute, path_of_file[value])
    return ElementTree.tostring(root, encoding="unicode") + "\n"
