"""Derive, write and load the files of a variant; parse the words that name a robot.

Input is the name of a variant or a ``VariantSpec``. The URDF and MJCF are derived in memory from
the files of the base model. They are cached until the URDF or the main MJCF of the base model
changes. `load_variant` returns the robot, `write_variant` writes both files.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from itertools import groupby
from pathlib import Path
from typing import Final

import mujoco

from pupper_analysis.base.arguments import check_type
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import (
    ConfigurationError,
    InputError,
    ModelError,
    UnknownNameError,
    VariantError,
)
from pupper_analysis.base.files import Writing, write_all
from pupper_analysis.base.inputs import (
    MAX_FILE_BYTES,
    STANDARD_INPUT,
    is_input,
    read_input,
    read_text,
)
from pupper_analysis.base.kinds import MODEL_KIND
from pupper_analysis.base.runs import register_input
from pupper_analysis.models import mjcf
from pupper_analysis.models.description import Description
from pupper_analysis.models.menagerie import is_menagerie_name
from pupper_analysis.models.mjcf_file import MjcfFile, read_mjcf
from pupper_analysis.models.places import make_input_error, one_line
from pupper_analysis.models.published import is_published_name, is_uri
from pupper_analysis.models.urdf_file import read_urdf
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.pupper.named_robots import (
    make_known_robots_error,
    make_unknown_robot_error,
)
from pupper_analysis.pupper.variants import (
    BASE_MODELS,
    VARIANTS,
    VariantSpec,
    find_model_folder,
    get_variant_spec,
)
from pupper_analysis.robot.build import build_robot
from pupper_analysis.robot.robot import PublishedFile, Robot

_SAFE_SCALE = 20.0
"""Largest scale factor [1] of legs and torso mass with which the derived MJCF is not compiled as a
test, to save time. The smallest such factor is the inverse. Chosen, not tuned."""


def describe_variant(variant: str | VariantSpec) -> Description:
    """Derive the URDF and MJCF of a variant from the files of the base model, in memory.

    The derivations of URDF and MJCF are independent implementations, so that a comparison of both
    files tests them; see `derive.derive_urdf` and `derive.derive_mjcf`.

    Raises:
        VariantError: If the name is unknown, or the scales give no valid model.
        ModelError: If a base file is missing, for example.
        OutputError: If this run of the command line also writes a base file.
    """
    spec = get_variant_spec(variant)
    base = BASE_MODELS[spec.base]
    urdf_source = find_model_folder("urdf") / base.urdf
    mjcf_source = find_model_folder("mjcf") / base.mjcf
    urdf_text, mjcf_spec = _derive_files(
        spec,
        spec.name,
        urdf_source,
        mjcf_source,
        _read_file_stamp(urdf_source),
        _read_file_stamp(mjcf_source),
    )
    for file in (urdf_source, *_list_files(_read_base(mjcf_source, _read_file_stamp(mjcf_source)))):
        register_input(file)  # in each run, although the derivation is cached
    return Description(
        name=spec.name,
        urdf=urdf_text,
        urdf_source=urdf_source,
        mjcf=mjcf_spec.copy(),
        mjcf_source=mjcf_source,
        contact_points={foot: (frame, frame) for foot, frame in base.feet.items()},
    )


def _read_file_stamp(file: Path) -> tuple[int, int]:
    """Return modification time [ns] and size [bytes] of a file, to detect a change of the file.

    (0, 0) if the path is no regular file.
    """
    if not file.is_file():
        return 0, 0
    found = file.stat()
    return found.st_mtime_ns, found.st_size


@lru_cache(maxsize=32)
def _derive_files(
    spec: VariantSpec,
    _name: str,  # part of the cache key; the comparison of specs ignores names
    urdf_source: Path,
    mjcf_source: Path,
    _urdf_stamp: tuple[int, int],
    mjcf_stamp: tuple[int, int],
) -> tuple[str, mujoco.MjSpec]:
    """Derive the URDF and MJCF of a variant; cached until the base URDF or main base MJCF changes.

    The stamps are results of `_read_file_stamp` for the base files.

    Returns:
        XML text of the URDF, and spec of the MJCF; callers must copy the cached spec.
    """
    links = UrdfTree(read_urdf(urdf_source).root).links  # a damaged file is a ModelError
    try:
        urdf_text = read_text(urdf_source)
    except InputError as error:
        raise make_input_error(urdf_source, error) from error
    mjcf_spec = _read_base(mjcf_source, mjcf_stamp).spec.copy()
    sites = [site.name for site in mjcf_spec.sites]
    for frame in BASE_MODELS[spec.base].feet.values():
        for source, what, names in (
            (urdf_source, "link (for a foot)", links),
            (mjcf_source, "site (for a foot)", sites),
        ):
            if frame not in names:
                raise UnknownNameError(source, what, frame, names)
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
        except (AttributeError, LookupError, TypeError) as error:
            problem = diagnose(
                "base-not-derivable", other=mjcf_source.name, message=one_line(error)
            )
            raise ModelError(urdf_source, problem) from error
    return urdf_text, mjcf_spec


@lru_cache(maxsize=8)
def _read_base(source: Path, _stamp: tuple[int, int]) -> MjcfFile:
    """Read and compile a base MJCF; cached while ``_stamp`` (`_read_file_stamp`) is the same.

    The stamp does not include the files that the MJCF includes.
    """
    return read_mjcf(source)


def _list_files(mjcf: MjcfFile) -> list[Path]:
    """List the files of an MJCF: the file itself, included files, and meshes."""
    meshes = mjcf.path.parent / mjcf.spec.compiler.meshdir
    return [*mjcf.files, *sorted({meshes / mesh.file for mesh in mjcf.spec.meshes})]


def write_variant(
    variant: str | VariantSpec, folder: str | Path, *, force: bool = False
) -> tuple[Path, Path]:
    """Write the URDF, the MJCF and the meshes of a Pupper variant.

    Args:
        variant: Name from ``VARIANTS``, or a ``VariantSpec``.
        folder: Output folder, for ``urdf/NAME.urdf``, ``mjcf/NAME.xml`` and ``mjcf/meshes/``.
        force: Whether to replace existing files with other content.

    Returns:
        Paths of the URDF and of the MJCF.

    Raises:
        VariantError: If the name is unknown, or the scales give no valid model.
        ConfigurationError: If ``folder`` is no path.
        ModelError: If a base file or a mesh is missing, for example.
        OutputError: If a file cannot be written, exists with other content and ``force`` is False,
            or if the run will write a base file.
    """
    description = describe_variant(variant)
    check_type("folder", folder, str | Path)
    folder = Path(folder)
    urdf_path = folder / "urdf" / f"{description.name}.urdf"
    mjcf_path = folder / "mjcf" / f"{description.name}.xml"
    mjcf_text = mjcf.to_xml(description.mjcf)
    meshes = {mesh.file for mesh in description.mjcf.meshes}
    source = description.mjcf_source
    meshes.update(_read_base(source, _read_file_stamp(source)).missing_files)
    meshdir = description.mjcf.compiler.meshdir
    beside = description.mjcf_source.parent / meshdir
    contents = {}
    for mesh in sorted(meshes):
        try:
            contents[mjcf_path.parent / meshdir / mesh] = read_input(beside / mesh, MAX_FILE_BYTES)
        except InputError as error:
            raise make_input_error(beside / mesh, error) from error
    contents |= {urdf_path: description.urdf.encode(), mjcf_path: mjcf_text.encode()}
    write_all([Writing(path, data, MODEL_KIND, force=force) for path, data in contents.items()])
    return urdf_path, mjcf_path


def load_variant(variant: str | VariantSpec, *, fixed_base: bool = False) -> Robot:
    """Load a Pupper variant (a base model with scaled legs and torso mass) as a robot.

    Args:
        variant: Name from ``VARIANTS``, or a ``VariantSpec``.
        fixed_base: Whether to fix the base in the world, at the pose in the MJCF.

    Returns:
        Robot.

    Raises:
        VariantError: If the name is unknown, or the scales give no valid model.
        ConfigurationError: If ``fixed_base`` is not a bool.
        ModelError: If a base file is missing, for example.
        OutputError: If this run of the command line also writes a base file.
    """
    spec = get_variant_spec(variant)
    check_type("fixed_base", fixed_base, bool)
    base = BASE_MODELS[spec.base]
    robot = build_robot(
        describe_variant(spec), fixed_base=fixed_base, foot_depth=base.foot_depth(spec.leg_scale)
    )
    notes = (*base.remarks(), *robot.notes)
    return replace(robot, notes=notes, published=PublishedFile(None))


_MODEL_SUFFIXES: Final = (".urdf", ".xml", ".mjcf", ".xacro")
"""Suffixes by which a word names a file, even if no such file exists."""

_MJCF_PACKAGE_SUFFIX: Final = "_mj_description"
"""Suffix of the names of public description packages that contain an MJCF."""

_NUM_HEAD_BYTES: Final = 4096
"""Number of bytes at the start of an .xml file that are searched for ``<robot``. If the text is
found, the file counts as a URDF. Chosen, not tuned.
"""

_PAIR_SEPARATOR: Final = "+"
"""Separator between the two files of a robot in one command-line word: ``robot.urdf+robot.xml``."""


def parse_robot_word(word: str) -> str | tuple[str, ...]:
    """Return the variant (text), or the files of a robot (tuple), that a command-line word names.

    Plus signs in the word separate the files, as in ``robot.urdf+robot.xml``, unless a file has the
    name of the whole word. The number of files is not checked.

    Raises:
        VariantError: If the word names neither a variant nor files. Also if it is a missing file
            with the name of a variant, such as ``v3.xml``.
    """
    if word in VARIANTS:
        return word
    files = (word,) if is_input(Path(word)) else tuple(word.split(_PAIR_SEPARATOR))
    if all(map(_names_file, files)):
        path = Path(word)
        if path.name == word and path.stem in VARIANTS and not is_input(path):
            raise make_known_robots_error(word, (path.stem,), ())
        return files
    with suppress(OSError, ValueError):  # for example a name that is too long
        if Path(word).is_dir():
            raise VariantError("name", word, diagnose("file-is-folder"))
    raise make_unknown_robot_error(word)


def parse_robot_words(words: Sequence[str]) -> list[str | tuple[str, ...]]:
    """Return the robots that command-line words name: variants by name, files as tuples of paths.

    A URDF followed by an MJCF is one robot. An MJCF followed by a URDF is one robot if the words
    name exactly these two files. A robot that is named twice is returned once; the repetition of a
    word is ignored.

    Raises:
        VariantError: If a word names no robot.
    """
    robots: list[str | tuple[str, ...]] = []
    for robot, _ in groupby(map(parse_robot_word, words)):
        previous = robots[-1] if robots else None
        if _guess_format(previous) == "urdf" and _guess_format(robot) == "mjcf":
            assert isinstance(previous, tuple)
            assert isinstance(robot, tuple)
            robots[-1] = (*previous, *robot)
        else:
            robots.append(robot)
    robots = list(dict.fromkeys(robots))
    if [_guess_format(robot) for robot in robots] == ["mjcf", "urdf"]:
        return [tuple(str(file) for robot in robots for file in robot)]
    return robots


def parse_single_robot(words: Sequence[str]) -> str | tuple[str, ...] | None:
    """Return the variant or the files of the only robot that command-line words name.

    None without words.

    Raises:
        ConfigurationError: If the words name several robots.
        VariantError: If a word names no robot.
    """
    robots = parse_robot_words(words)
    if len(robots) > 1:
        kept = (robots[0], *robots[0]) if isinstance(robots[0], tuple) else (robots[0],)
        problem = diagnose(
            "one-robot-at-a-time",
            robots=list(words),
            names=[Path(word).name for word in words],
            others=[word for word in words if not {word, parse_robot_word(word)} & {*kept}],
        )
        raise ConfigurationError("ROBOT", problem)
    return robots[0] if robots else None


def _guess_format(robot: str | tuple[str, ...] | None) -> str | None:
    """Guess the format, ``"urdf"`` or ``"mjcf"``, of a robot that is a single file.

    None for variants, pairs of files, and other suffixes.
    """
    if not isinstance(robot, tuple) or len(robot) != 1:
        return None
    [word] = robot
    if is_published_name(word):
        menagerie = is_menagerie_name(word)
        return "mjcf" if menagerie or word.endswith(_MJCF_PACKAGE_SUFFIX) else "urdf"
    suffix = Path(word).suffix.lower()
    if suffix == ".xml" and is_input(Path(word)):  # either format
        # The reader of the file reports a file that cannot be opened.
        with suppress(OSError), Path(word).open("rb") as file:
            return "urdf" if b"<robot" in file.read(_NUM_HEAD_BYTES) else "mjcf"
    return {".urdf": "urdf", ".xacro": "urdf", ".xml": "mjcf", ".mjcf": "mjcf"}.get(suffix)


def _names_file(word: str) -> bool:
    """Return True if a command-line word names model files, such as a path or a published robot."""
    path = Path(word)
    return (
        is_published_name(word)
        or is_uri(word)
        or path == STANDARD_INPUT
        or path.suffix.lower() in _MODEL_SUFFIXES
        or len(path.parts) > 1
        or is_input(path)
    )
