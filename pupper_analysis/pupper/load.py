"""Loads variants."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.arguments import check_type
from pupper_analysis.pupper.variant_files import describe_variant
from pupper_analysis.pupper.variants import BASES, VariantSpec, variant_spec
from pupper_analysis.robot.build import build_robot
from pupper_analysis.robot.robot import PublishedFile, Robot

Array = NDArray[np.float64]


def load_variant(variant: str | VariantSpec, *, fixed_base: bool = False) -> Robot:
    """Loads one of the package's variants, or any other one.

    Args:
        variant: A name from ``VARIANTS``, or a ``VariantSpec``.
        fixed_base: Fix the base in the world, at the height that the MJCF gives it.

    Returns:
        The robot.

    Raises:
        VariantError: If the name is unknown.
        ModelError: If a model file is missing or damaged.
    """
    spec = variant_spec(variant)
    check_type("fixed_base", fixed_base, bool)
    base = BASES[spec.base]
    robot = build_robot(
        describe_variant(spec), fixed_base=fixed_base, foot_depth=base.foot_depth(spec.leg_scale)
    )
    notes = (*base.remarks(), *robot.notes)
    return replace(robot, notes=notes, published=PublishedFile(None))
