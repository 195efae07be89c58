"""The files of a variant: derived in memory, written, loaded; and what a robot is called by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.arguments import check_type
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError, VariantError
from pupper_analysis.base.files import Writing, write_all
from pupper_analysis.base.inputs import STANDARD_INPUT, is_input
from pupper_analysis.base.kinds import MODEL_KIND
from pupper_analysis.base.runs import register_input
from pupper_analysis.models import mjcf
from pupper_analysis.models.description import Description
from pupper_analysis.models.mjcf_file import MjcfFile, read_mjcf
from pupper_analysis.models.places import one_line
from pupper_analysis.models.published import DESCRIPTION_PREFIX
from pupper_analysis.pupper.variants import (
    BASE_MODELS,
    VARIANTS,
    VariantSpec,
    find_model_folder,
    get_variant_spec,
)
from pupper_analysis.robot.build import build_robot
from pupper_analysis.robot.robot import PublishedFile, Robot

Array = NDArray[np.float64]

_SAFE_SCALE = 20.0
"""Scales up to this, or its inverse, compile; whether others do is tried, which takes its time."""


def describe_variant(variant: str | VariantSpec) -> Description:
    """Derives a variant's URDF from the base URDF and its MJCF from the base MJCF, in memory.

    The two derivations share no code but the numbers of the spec.

    Raises:
        VariantError: If the name is unknown.
        ModelError: If a base file is missing or damaged.
    """
    spec = get_variant_spec(variant)
    base = BASE_MODELS[spec.base]
    urdf_source = find_model_folder("urdf") / base.urdf
    mjcf_source = find_model_folder("mjcf") / base.mjcf
    urdf_text, mjcf_spec = _derived(
        spec, spec.name, urdf_source, mjcf_source, _stamp(urdf_source), _stamp(mjcf_source)
    )
    for file in (urdf_source, *_files(_read(mjcf_source, _stamp(mjcf_source)))):
        register_input(file)  # each time: what is derived is kept
    return Description(
        name=spec.name,
        urdf=urdf_text,
        urdf_source=urdf_source,
        mjcf=mjcf_spec.copy(),
        mjcf_source=mjcf_source,
        contact_points={foot: (frame, frame) for foot, frame in base.feet.items()},
    )


def _stamp(file: Path) -> tuple[int, int]:
    """Returns what tells that a file has changed; reading it tells that there is none."""
    if not file.is_file():
        return 0, 0
    found = file.stat()
    return found.st_mtime_ns, found.st_size


@lru_cache(maxsize=32)
def _derived(
    spec: VariantSpec,
    _name: str,  # which does not count where specs are compared
    urdf_source: Path,
    mjcf_source: Path,
    _urdf_stamp: tuple[int, int],
    mjcf_stamp: tuple[int, int],
) -> tuple[str, mujoco.MjSpec]:
    """Derives a variant's URDF and MJCF once, unless a base file changes."""
    urdf_text, mjcf_spec = urdf_source.read_text(), _read(mjcf_source, mjcf_stamp).spec.copy()
    if spec.leg_scale != 1.0 or spec.torso_mass_scale != 1.0:
        from pupper_analysis.pupper import derive  # yourdfpy is slow to import

        scales = spec.leg_scale, spec.torso_mass_scale
        try:
            urdf_text = derive.derive_urdf(urdf_text, spec, source=urdf_source)
            derive.derive_mjcf(mjcf_spec, spec)
            if max(*scales, *(1 / scale for scale in scales)) > _SAFE_SCALE:
                mjcf.compile_spec(mjcf_spec.copy(), mjcf_source)
        except (ArithmeticError, ValueError, ModelError) as error:
            raise VariantError(
                "leg_scale, torso_mass_scale",
                f"{scales[0]:g} and {scales[1]:g}",
                diagnose("scales-make-no-robot", message=one_line(error)),
            ) from error
    return urdf_text, mjcf_spec


@lru_cache(maxsize=8)
def _read(source: Path, _stamp: tuple[int, int]) -> MjcfFile:
    """Reads a base MJCF once, unless the file changes; that it compiles is known then."""
    return read_mjcf(source)


def _files(mjcf: MjcfFile) -> list[Path]:
    """Returns the files of an MJCF: itself, what it includes, and its meshes."""
    meshes = mjcf.path.parent / mjcf.spec.compiler.meshdir
    return [*mjcf.files, *sorted({meshes / mesh.file for mesh in mjcf.spec.meshes})]


def write_variant(
    variant: str | VariantSpec, folder: str | Path, *, force: bool = False
) -> tuple[Path, Path]:
    """Writes a variant's files, with the meshes they use, so that any viewer can open them.

    Args:
        variant: A name or a spec.
        folder: Gets ``urdf/NAME.urdf``, ``mjcf/NAME.xml`` and ``mjcf/meshes/``.
        force: Replace files that are there with another content.

    Returns:
        The paths of the URDF and of the MJCF.

    Raises:
        VariantError: If the name is unknown.
        OutputError: If a file cannot be written, or is there with another content.
    """
    description = describe_variant(variant)
    check_type("folder", folder, str | Path)
    folder = Path(folder)
    urdf_path = folder / "urdf" / f"{description.name}.urdf"
    mjcf_path = folder / "mjcf" / f"{description.name}.xml"
    mjcf_text = mjcf.to_xml(description.mjcf)
    meshes = {mesh.file for mesh in description.mjcf.meshes}
    meshdir = description.mjcf.compiler.meshdir
    beside = description.mjcf_source.parent / meshdir
    contents = {
        mjcf_path.parent / meshdir / mesh: (beside / mesh).read_bytes() for mesh in sorted(meshes)
    }
    contents |= {urdf_path: description.urdf.encode(), mjcf_path: mjcf_text.encode()}
    write_all([Writing(path, data, MODEL_KIND, force=force) for path, data in contents.items()])
    return urdf_path, mjcf_path


def load_variant(variant: str | VariantSpec, *, fixed_base: bool = False) -> Robot:
    """Loads one of the package's variants, or any other one.

    Args:
        variant: A name from ``VARIANTS``, or a ``VariantSpec``.
        fixed_base: Fix the base in the world, at the height that the MJCF gives it.

    Returns:
        The robot.

    Raises:
        VariantError: If the name is unknown.
        ModelError: If a model file is missing or damaged.
    """
    spec = get_variant_spec(variant)
    check_type("fixed_base", fixed_base, bool)
    base = BASE_MODELS[spec.base]
    robot = build_robot(
        describe_variant(spec), fixed_base=fixed_base, foot_depth=base.foot_depth(spec.leg_scale)
    )
    notes = (*base.remarks(), *robot.notes)
    return replace(robot, notes=notes, published=PublishedFile(None))


_ENDINGS: Final = (".urdf", ".xml", ".mjcf", ".xacro")

_MJCF_OF_SCHEME: Final = "_mj_description"
"""How the names of those packages end that are MJCFs."""

_HEAD: Final = 4096
"""Bytes of a file in which its root element begins."""

_BOTH: Final = "+"
"""Between a robot's two files, where several robots are named."""


def parse_robot_word(word: str) -> str | tuple[str, ...]:
    """Returns a variant's name, or the files of a robot: one, or two with a plus between them.

    Raises:
        VariantError: If it is neither.
    """
    if word in VARIANTS:
        return word
    files = (word,) if is_input(Path(word)) else tuple(word.split(_BOTH))
    if all(map(_is_file, files)):
        return files
    raise VariantError("name", word, diagnose("known-robots", variants=VARIANTS))


def parse_robot_words(words: Sequence[str]) -> list[str | tuple[str, ...]]:
    """Returns the variants and files of the robots that words name, each once.

    A URDF that is followed by an MJCF is one robot with it, in all commands; so are a URDF and an
    MJCF that are all that is named, in any order.

    Raises:
        VariantError: If a word names no robot.
    """
    found: list[str | tuple[str, ...]] = []
    for meant in map(parse_robot_word, words):
        last = found[-1] if found else None
        if _format(last) == "urdf" and _format(meant) == "mjcf":
            assert isinstance(last, tuple)
            assert isinstance(meant, tuple)
            found[-1] = (*last, *meant)
        elif meant not in found:
            found.append(meant)
    if [_format(meant) for meant in found] == ["mjcf", "urdf"]:
        return [tuple(str(file) for meant in found for file in meant)]
    return found


def parse_single_robot(words: Sequence[str]) -> str | tuple[str, ...] | None:
    """Returns the variant or the files of one robot, which may be two words; None without any.

    Raises:
        ConfigurationError: If it is more than one robot.
        VariantError: If it is none.
    """
    found = parse_robot_words(words)
    if len(found) > 1:
        raise ConfigurationError("ROBOT", diagnose("one-robot-at-a-time", robots=list(words)))
    return found[0] if found else None


def _format(meant: str | tuple[str, ...] | None) -> str | None:
    """Returns ``"urdf"`` or ``"mjcf"`` of a file alone; None of what else is named."""
    if not isinstance(meant, tuple) or len(meant) != 1:
        return None
    [word] = meant
    if word.startswith(DESCRIPTION_PREFIX):
        return "mjcf" if word.endswith(_MJCF_OF_SCHEME) else "urdf"
    ending = Path(word).suffix.lower()
    if ending == ".xml" and Path(word).is_file():  # which may be either
        with Path(word).open("rb") as file:
            return "urdf" if b"<robot" in file.read(_HEAD) else "mjcf"
    return {".urdf": "urdf", ".xacro": "urdf", ".xml": "mjcf", ".mjcf": "mjcf"}.get(ending)


def _is_file(word: str) -> bool:
    path = Path(word)
    return (
        word.startswith(DESCRIPTION_PREFIX)
        or path == STANDARD_INPUT
        or path.suffix.lower() in _ENDINGS
        or len(path.parts) > 1
        or is_input(path)
    )
