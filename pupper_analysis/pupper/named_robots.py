"""Variants by name where model files are expected."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import ParamSpec

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.prepare.convert import load
from pupper_analysis.pupper.variant_files import load_variant, write_variant
from pupper_analysis.pupper.variants import BASES, VARIANTS, model_folder, variant_spec
from pupper_analysis.robot.robot import Robot

P = ParamSpec("P")


def is_variant(word: object) -> bool:
    """Return True if a word is the name of a variant, and not of a file in the current folder."""
    return isinstance(word, str) and word in VARIANTS and not Path(word).exists()


@contextmanager
def variant_model_files(name: str) -> Iterator[tuple[Path, Path]]:
    """Yield the URDF and the MJCF of a variant.

    A base model has files of its own. Those of a scaled one are written to a temporary folder,
    which is removed at the end.
    """
    spec = variant_spec(name)
    if spec.leg_scale == spec.torso_mass_scale == 1.0:
        base = BASES[spec.base]
        yield model_folder("urdf") / base.urdf, model_folder("mjcf") / base.mjcf
        return
    with TemporaryDirectory() as folder:
        yield write_variant(name, folder)


def _accept_variants(load_files: Callable[P, Robot]) -> Callable[P, Robot]:
    """Let ``load_robot`` accept the name of a variant in place of files."""

    @wraps(load_files)
    def load_named(*models: P.args, **options: P.kwargs) -> Robot:
        if len(models) != 1 or not is_variant(models[0]):
            return load_files(*models, **options)
        given = {name: value for name, value in options.items() if value not in (None, False)}
        fixed_base = bool(given.pop("fixed_base", False))
        if given:
            raise ConfigurationError(next(iter(given)), diagnose("options-of-files-alone"))
        return load_variant(str(models[0]), fixed_base=fixed_base)

    return load_named


load_robot = _accept_variants(load.load_robot)
