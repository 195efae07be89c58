"""Exported names of the package and of its public modules."""

from types import ModuleType

import pupper_analysis as pa


def public(module: ModuleType) -> dict[str, object]:
    """Return {name: object} of the names that a module exports, without modules."""
    values = {name: getattr(module, name) for name in module.__all__}
    return {name: value for name, value in values.items() if not isinstance(value, ModuleType)}


def public_modules() -> list[ModuleType]:
    """Return the exported modules of the package that have an ``__all__`` of their own."""
    modules = [value for name in pa.__all__ if isinstance(value := getattr(pa, name), ModuleType)]
    return [module for module in modules if hasattr(module, "__all__")]
