"""The robots that scales make of a variant: what pages and studies of Pupper vary."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from pupper_analysis.pupper.variants import VariantSpec


@dataclass(frozen=True)
class Scaled:
    """A variant that can be scaled.

    Attributes:
        spec: The variant where nothing is scaled otherwise.
    """

    spec: VariantSpec

    @property
    def scales(self) -> Mapping[str, float]:
        """Those of a ``VariantSpec``."""
        return {name: getattr(self.spec, name) for name in ("leg_scale", "torso_mass_scale")}

    def scaled(self, scales: Mapping[str, float]) -> VariantSpec:
        """Returns the variant of some scales; where not given, they are the variant's.

        Raises:
            VariantError: If a scale is not a finite positive number.
        """
        wanted = {**self.scales, **scales}
        return VariantSpec(self.spec.base, wanted["leg_scale"], wanted["torso_mass_scale"])
