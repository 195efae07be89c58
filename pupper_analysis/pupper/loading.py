"""``load_robot`` for files and for variants."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.models.objects import is_object
from pupper_analysis.prepare.convert import load
from pupper_analysis.pupper.named_robots import is_variant, refuse_unknown_variant
from pupper_analysis.pupper.variant_files import load_variant
from pupper_analysis.pupper.variants import VariantSpec
from pupper_analysis.robot.robot import Robot

P = ParamSpec("P")
"""Parameters of ``load_robot``."""


def _accept_variants(load_files: Callable[P, Robot]) -> Callable[P, Robot]:
    """Return a ``load_robot`` that also accepts a Pupper variant, or its name, instead of files."""

    @wraps(load_files)
    def load_named(*models: P.args, **options: P.kwargs) -> Robot:
        """Load a Pupper variant if a single variant is given, else a robot from files."""
        named = [*models, *(options.get(argument) for argument in ("urdf", "mjcf"))]
        given = [model for model in named if model is not None]
        for model in given:
            if isinstance(model, str | Path) and not is_object(model):
                refuse_unknown_variant(str(model))
            if is_variant(model) and (len(given) > 1 or not models):
                name = model.name if isinstance(model, VariantSpec) else str(model)
                raise ConfigurationError("model", diagnose("variant-with-models", variant=name))
        if len(models) != 1 or not is_variant(models[0]):
            return load_files(*models, **options)
        used = {
            name: value
            for name, value in options.items()
            if value is not None and value is not False
        }
        fixed_base: Any = used.pop("fixed_base", False)
        used.pop("visuals", None)  # MuJoCo reads the meshes of variants without conversion
        if used:
            message = diagnose("options-of-files-alone", options=tuple(used))
            raise ConfigurationError(next(iter(used)), message)
        variant: Any = models[0]
        if not isinstance(variant, VariantSpec):
            variant = str(variant)
        return load_variant(variant, fixed_base=fixed_base)

    return load_named


load_robot = _accept_variants(load.load_robot)
