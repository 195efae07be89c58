"""Variants by name where model files are expected."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from pupper_analysis.pupper.variants import (
    BASE_MODELS,
    VARIANTS,
    VariantSpec,
    find_model_folder,
    get_variant_spec,
    list_similar_variants,
)


def is_variant(word: object) -> bool:
    """Return True if a word is the name of a variant, and not of a file in the current folder."""
    return isinstance(word, str) and word in VARIANTS and not Path(word).exists()


def refuse_unknown_variant(word: str) -> None:
    """Raise an error if a word is probably a misspelled variant name.

    Raises:
        VariantError: If the word has no suffix, names no file, and is similar to names of variants,
            which the message lists.
    """
    path = Path(word)
    may_be_variant = not path.suffix and len(path.parts) == 1 and not path.exists()
    if may_be_variant and word not in VARIANTS and list_similar_variants(word):
        get_variant_spec(word)


@contextmanager
def variant_model_files(name: str | VariantSpec) -> Iterator[tuple[Path, Path]]:
    """Yield the URDF and the MJCF of a variant.

    A base model has permanent files. The files of a scaled variant are written to a temporary
    folder, which is removed at the end.
    """
    spec = get_variant_spec(name) if isinstance(name, str) else name
    if spec.leg_scale == spec.torso_mass_scale == 1.0:
        base = BASE_MODELS[spec.base]
        yield find_model_folder("urdf") / base.urdf, find_model_folder("mjcf") / base.mjcf
        return
    # Imports PlaCo and Clarabel, which `audit` and `crosscheck` of files do not need.
    from pupper_analysis.pupper.variant_files import write_variant

    with TemporaryDirectory() as folder:
        yield write_variant(name, folder)
