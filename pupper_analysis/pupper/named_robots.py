"""Variants by name where model files are expected.

An unscaled variant has the files of its base model. The models of a scaled variant are derived in
memory, without line numbers.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, VariantError
from pupper_analysis.base.inputs import find_similar_files, is_input
from pupper_analysis.models.published import (
    is_available,
    is_published_name,
    list_similar_published_names,
    list_source_problems,
    make_download_command,
)
from pupper_analysis.pupper.variants import (
    BASE_MODELS,
    VARIANTS,
    VariantSpec,
    find_model_folder,
    get_variant_spec,
    list_similar_variants,
)

if TYPE_CHECKING:
    from pupper_analysis.models.mjcf_file import MjcfFile
    from pupper_analysis.models.urdf_file import UrdfFile

_Model = TypeVar("_Model")
"""Type of a model of the caller: a path, a file in memory or another object, no ``VariantSpec``."""

_MAX_WORD_LENGTH = 200
"""Largest number of characters of a word that is checked as a misspelled variant name. Chosen, not
tuned.
"""

_WORD_PATTERN = re.compile(r"\w[\w-]*")
"""Pattern of a word that may be the name of a variant: letters, digits, underscores and hyphens."""


def is_variant(word: object) -> bool:
    """Return True if a word is a ``VariantSpec`` or the name of a Pupper variant, not a file.

    A name counts as a file, and the result is False, if a file or folder of that name exists in the
    current folder.
    """
    if isinstance(word, VariantSpec):
        return True
    return isinstance(word, str | Path) and str(word) in VARIANTS and not Path(word).exists()


def find_model(
    model: _Model | VariantSpec, model_format: Literal["urdf", "mjcf"]
) -> _Model | Path | UrdfFile | MjcfFile:
    """Return the URDF or the MJCF of a Pupper variant; return a model that is no variant unchanged.

    Args:
        model: Name of a variant, ``VariantSpec``, or any other model.
        model_format: Format of the model of a variant.

    Returns:
        Path of a file of a base model, derived model in memory, or ``model`` itself.

    Raises:
        VariantError: If the word is refused (`refuse_unknown_variant`), or the scales give no valid
            model.
        ModelError: If the folder of the base files is missing, for example.
        OutputError: If this run of the command line also writes a base file of a scaled variant.
    """
    if not is_variant(model):
        if isinstance(model, str | Path):
            refuse_unknown_variant(str(model))
        return model  # type: ignore[return-value]  # not a VariantSpec
    variant: Any = model
    spec = _get_spec(variant)
    if _is_base_model(spec):
        return _find_base_files(spec)[model_format == "mjcf"]
    from pupper_analysis.models.mjcf_file import mjcf_of_spec
    from pupper_analysis.models.places import forget_lines
    from pupper_analysis.models.urdf_file import urdf_from
    from pupper_analysis.models.xml import parse_file_text
    from pupper_analysis.pupper.variant_files import describe_variant

    derived = describe_variant(spec)
    if model_format == "mjcf":
        return mjcf_of_spec(derived.mjcf_source.with_name(f"{spec.name}.xml"), derived.mjcf)
    path = derived.urdf_source.with_name(f"{spec.name}.urdf")
    root = parse_file_text(path, derived.urdf)
    forget_lines(root)
    return urdf_from(path, derived.urdf, root, None)


def find_model_pair(
    urdf: _Model | VariantSpec, mjcf: _Model | VariantSpec | None
) -> tuple[Any, Any]:
    """Return a URDF and an MJCF from two arguments, or both files of one Pupper variant.

    Args:
        urdf: URDF, or a variant.
        mjcf: MJCF, or a variant; None for the MJCF of the variant ``urdf``.

    Returns:
        URDF; MJCF. Each is a path or a model in memory (see `find_model`).

    Raises:
        ConfigurationError: If there is no ``mjcf`` and ``urdf`` is no variant.
        VariantError: If a word is refused (`refuse_unknown_variant`), or the scales give no valid
            model.
        ModelError: If the folder of the base files is missing, for example.
        OutputError: If this run of the command line also writes a base file of a scaled variant.
    """
    first = find_model(urdf, "urdf")
    if mjcf is None and not is_variant(urdf):
        raise ConfigurationError("mjcf", diagnose("mjcf-missing"))
    return first, find_model(urdf if mjcf is None else mjcf, "mjcf")


def find_files(variant: str | Path | VariantSpec, folder: Path) -> tuple[Path, Path]:
    """Return paths of the URDF and the MJCF of a Pupper variant, for functions that need files.

    The files of a scaled variant are written first.

    Args:
        variant: Variant, or its name.
        folder: Temporary folder, to which the files of a scaled variant are written, as by
            ``write_variant``.

    Returns:
        Path of the URDF; path of the MJCF.

    Raises:
        VariantError: If the name is unknown, or the scales give no valid model.
        ModelError: If the folder of the base files is missing, for example.
        OutputError: If a file of a scaled variant cannot be written, or exists with other content.
    """
    from pupper_analysis.pupper.variant_files import write_variant

    spec = _get_spec(variant)
    return _find_base_files(spec) if _is_base_model(spec) else write_variant(spec, folder)


def _get_spec(variant: str | Path | VariantSpec) -> VariantSpec:
    """Return the spec of a variant that `is_variant` accepts."""
    return get_variant_spec(variant if isinstance(variant, VariantSpec) else str(variant))


def _is_base_model(spec: VariantSpec) -> bool:
    """Return True if a variant is not scaled, so that its files are the files of the base model."""
    return spec.leg_scale == spec.torso_mass_scale == 1.0


def _find_base_files(spec: VariantSpec) -> tuple[Path, Path]:
    """Return the URDF and the MJCF of the base model of a variant."""
    base = BASE_MODELS[spec.base]
    return find_model_folder("urdf") / base.urdf, find_model_folder("mjcf") / base.mjcf


def refuse_unknown_variant(word: str, *, is_robot: bool = True) -> None:
    """Raise an error if a word is probably the name of a variant that does not exist.

    Args:
        word: Text that a user has given, for example on the command line.
        is_robot: True if the word must name a robot. False if the word may also name another
            source: the word is then refused only if similar to the name of a robot.

    Raises:
        VariantError: If the word is refused; the message lists all variants, and similar names.
    """
    if len(word) > _MAX_WORD_LENGTH or not _WORD_PATTERN.fullmatch(word) or word in VARIANTS:
        return
    if Path(word).exists() or is_published_name(word):
        return
    if is_robot or list_similar_variants(word) or list_similar_published_names(word):
        raise make_unknown_robot_error(word)


def make_unknown_robot_error(word: str) -> VariantError:
    """Return the error for a word that names no robot, with similar variants, files and names.

    A published robot that is not downloaded is proposed only if nothing else is similar. The
    message also names the packages of published names that are not installed.
    """
    files = map(str, (*_find_models_of_name(word), *find_similar_files(Path(word))))
    published = list_similar_published_names(word)
    loadable = [name for name in published if is_available(name)]
    similar = dict.fromkeys((*list_similar_variants(word), *files, *loadable))
    return make_known_robots_error(word, similar, () if similar else published)


def make_known_robots_error(
    word: str, similar: Iterable[str], absent: Sequence[str], *, fixed: bool = False
) -> VariantError:
    """Return the error for a word that names no robot, from the robots to propose.

    Args:
        word: The word.
        similar: Names of robots and files that can be loaded.
        absent: Names of published robots that must be downloaded first; the first is proposed.
        fixed: True if the proposed robot has a fixed base, and the running command refuses it.
    """
    similar = tuple(similar)
    name = next(iter(absent), "")
    problem = diagnose(
        "known-robots",
        alike=similar,
        absent=name,
        download=make_download_command(name) if name else "",
        fixed=fixed,
        movable=bool(name) and not fixed,
        unknown=not (similar or name),
        variants=VARIANTS,
        missing=list_source_problems(),
    )
    return VariantError("name", word, problem)


_MODEL_SUFFIXES = (".urdf", ".xml", ".mjcf")
"""Suffixes of model files that a word without a suffix may mean."""


def _find_models_of_name(word: str) -> list[Path]:
    """Return the existing model files whose name is a word with a suffix: ``go2.urdf``."""
    paths = (Path(f"{word}{suffix}") for suffix in _MODEL_SUFFIXES)
    return [path for path in paths if is_input(path)]
