"""The live page of Pupper's variants, besides that of any pair of files."""

from __future__ import annotations

from collections.abc import Mapping

from pupper_analysis.pupper.variant_files import load_variant
from pupper_analysis.pupper.variants import VARIANTS, Scaled, VariantSpec
from pupper_analysis.robot.robot import Robot


class LiveVariants(Scaled):
    """The robots that scales make of a variant."""

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
            f"pa.load_variant(pa.pupper.VariantSpec(base={spec.base!r}, "
            f"leg_scale={spec.leg_scale!r}, torso_mass_scale={spec.torso_mass_scale!r}))"
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
        """Returns the variant of some scales, by the name that it has, if any."""
        made = self.scaled(scales)
        return {spec: spec for spec in VARIANTS.values()}.get(made, made)
