"""``load_robot`` for files and for variants by name."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.prepare.convert import load
from pupper_analysis.pupper.named_robots import is_variant
from pupper_analysis.pupper.variant_files import load_variant
from pupper_analysis.robot.robot import Robot

P = ParamSpec("P")
"""Parameters of ``load_robot``."""


def _accept_variants(load_files: Callable[P, Robot]) -> Callable[P, Robot]:
    """Let ``load_robot`` accept the name of a variant in place of files."""

    @wraps(load_files)
    def load_named(*models: P.args, **options: P.kwargs) -> Robot:
        """Load a Pupper variant if a single variant name is given, else a robot from files."""
        if len(models) != 1 or not is_variant(models[0]):
            return load_files(*models, **options)
        given = {name: value for name, value in options.items() if value not in (None, False)}
        fixed_base = bool(given.pop("fixed_base", False))
        given.pop("visuals", None)  # MuJoCo reads the meshes of variants without conversion
        if given:
            raise ConfigurationError(next(iter(given)), diagnose("options-of-files-alone"))
        return load_variant(str(models[0]), fixed_base=fixed_base)

    return load_named


load_robot = _accept_variants(load.load_robot)
