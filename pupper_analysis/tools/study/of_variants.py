"""Studies of Pupper's variants, besides those of any pair of files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.models.description import Description
from pupper_analysis.pupper.named import split_word
from pupper_analysis.pupper.variant_files import describe_variant
from pupper_analysis.pupper.variants import BASES, Scaled, VariantSpec, variant_spec
from pupper_analysis.robot.build import build_robot
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.study import study
from pupper_analysis.tools.study.design import RobotSource, load_source
from pupper_analysis.tools.study.parameters import without_visuals


class Variants(Scaled):
    """The robots that scales make of a variant."""

    def robot(self, scales: Mapping[str, float]) -> Robot:
        """Makes the variant of some scales, without what is only looked at.

        Raises:
            VariantError: If a scale is not a finite positive number, or nothing can be made so.
        """
        return self._made(scales, without_visuals)

    def _made(
        self, scales: Mapping[str, float], kept: Callable[[Description], Description]
    ) -> Robot:
        spec = self.scaled(scales)
        depth = BASES[spec.base].foot_depth(spec.leg_scale)
        return build_robot(kept(describe_variant(spec)), foot_depth=depth)

    def asked(self) -> dict[str, Any]:
        """Returns the spec."""
        return {"base": self.spec.base, **self.scales}


class WholeVariants(Variants):
    """The same robots with all that is only looked at."""

    def robot(self, scales: Mapping[str, float]) -> Robot:
        """Makes the variant of some scales.

        Raises:
            VariantError: As ``Variants.robot``.
        """
        return self._made(scales, lambda whole: whole)


class Study(study.DesignStudy):
    """Designs of a robot that are measured alike.

    Its ``robot`` may also be a file, two files with a plus between them, a variant's name, a
    ``VariantSpec``, or {``base``, ``leg_scale``, ``torso_mass_scale``}, where ``base`` may be files
    as well, with other arguments of ``load_robot``; of variants ``leg_scale`` and
    ``torso_mass_scale`` can be varied, too.
    """

    def whole_source(self) -> RobotSource:
        """Returns the source of the same robots with all that is only looked at."""
        if isinstance(self.source, Variants):
            return WholeVariants(self.source.spec)
        return super().whole_source()

    def _source(self, robot: Any) -> RobotSource:
        if isinstance(robot, str):
            meant = split_word(robot)
            if isinstance(meant, tuple):
                return load_source({"models": meant})
            return Variants(variant_spec(meant))
        if isinstance(robot, VariantSpec):
            return Variants(robot)
        if isinstance(robot, Mapping) and "base" in robot:
            base, others = robot["base"], {n: one for n, one in robot.items() if n != "base"}
            meant = split_word(base) if isinstance(base, str) else base
            if isinstance(meant, tuple):
                return load_source({"models": meant, **others})
            known = [field.name for field in fields(VariantSpec)]
            unknown = [name for name in robot if name not in known]
            if unknown:
                problem = diagnose("variant-has-no-field", known=known, unknown=unknown[0])
                raise ConfigurationError("robot", problem)
            return Variants(VariantSpec(**robot))
        return super()._source(robot)
