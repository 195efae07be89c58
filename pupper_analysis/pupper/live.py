"""The live page of Pupper's variants, besides that of any pair of files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from pupper_analysis.pupper.load import load_variant
from pupper_analysis.pupper.variants import VARIANTS, VariantSpec
from pupper_analysis.robot.robot import Robot


@dataclass(frozen=True)
class Variants:
    """The robots that scales make of a variant.

    Attributes:
        spec: The variant where nothing is scaled otherwise.
    """

    spec: VariantSpec

    @property
    def scales(self) -> Mapping[str, float]:
        """Those of a ``VariantSpec``."""
        return {name: getattr(self.spec, name) for name in ("leg_scale", "torso_mass_scale")}

    def robot(self, scales: Mapping[str, float]) -> Robot:
        """Makes the variant of some scales.

        Raises:
            VariantError: If a scale is not a finite positive number, or nothing can be made so.
        """
        return load_variant(self._spec(scales))

    def python(self, scales: Mapping[str, float]) -> str:
        """Returns the call of ``load_variant``."""
        spec = self._spec(scales)
        if spec.name in VARIANTS:
            return f"pa.load_variant({spec.name!r})"
        return (
            f"pa.load_variant(pa.VariantSpec(base={spec.base!r}, leg_scale={spec.leg_scale!r}, "
            f"torso_mass_scale={spec.torso_mass_scale!r}))"
        )

    def arguments(self, scales: Mapping[str, float]) -> list[str]:
        """Returns a variant's name, or the options of its scales."""
        spec = self._spec(scales)
        if spec.name in VARIANTS:
            return [spec.name]
        words = ["--base", spec.base]
        for name, value in (
            ("--leg-scale", spec.leg_scale),
            ("--torso-mass-scale", spec.torso_mass_scale),
        ):
            words += [name, repr(value)] if value != 1.0 else []
        return words

    def _spec(self, scales: Mapping[str, float]) -> VariantSpec:
        wanted = {**self.scales, **scales}
        made = VariantSpec(self.spec.base, wanted["leg_scale"], wanted["torso_mass_scale"])
        known = {(v.base, v.leg_scale, v.torso_mass_scale): v for v in VARIANTS.values()}
        return known.get((made.base, made.leg_scale, made.torso_mass_scale), made)
