"""What the package offers: its own names, and those of its public modules."""

from types import ModuleType

import pupper_analysis as pa


def public(module: ModuleType) -> dict[str, object]:
    """Return what a module offers, but for the modules in it."""
    values = {name: getattr(module, name) for name in module.__all__}
    return {name: value for name, value in values.items() if not isinstance(value, ModuleType)}


def public_modules() -> list[ModuleType]:
    """Return the modules that ``pa`` offers and that list names of their own."""
    modules = [value for name in pa.__all__ if isinstance(value := getattr(pa, name), ModuleType)]
    return [module for module in modules if hasattr(module, "__all__")]
