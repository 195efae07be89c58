"""What acts on a robot in MuJoCo and has no words in a URDF: springs, tendons, fluid, loops.

A URDF states a tree of bodies, and damping and friction of its joints. MuJoCo's smooth dynamics
have more terms: passive forces (``qfrc_spring``, ``qfrc_damper``, ``qfrc_gravcomp``,
``qfrc_fluid``, and those of flexes and plugins), inertia through tendons and motors, and equality
constraints. Here they are found in a compiled model, one by one, each with the numbers that have
to be zero for it to be gone. Nothing rests on the list being complete: who uses it switches all of
it off, and compares what is left with a model that has none of it.

Source: MuJoCo documentation, "Computation: Passive forces" and "Constraint model: Equality"; the
arrays are those of ``mjModel``.
"""

from __future__ import annotations

from pupper_analysis.robot.compare.mjcf_only.effect import MjcfOnlyEffect, NamedModel
from pupper_analysis.robot.compare.mjcf_only.joints import (
    find_damping_polynomials,
    find_gravity_compensation,
    find_springs,
    free_joint_friction,
)
from pupper_analysis.robot.compare.mjcf_only.others import (
    find_equalities,
    find_flags,
    find_flexes,
    find_fluid,
    find_plugins,
)
from pupper_analysis.robot.compare.mjcf_only.transmissions import find_actuators, find_tendons
from pupper_analysis.robot.matching.trees import Reference


def mjcf_only_effects(reference: Reference) -> list[MjcfOnlyEffect]:
    """Finds all that acts on the robot and that a URDF cannot state."""
    scene = NamedModel(reference)
    return [
        *find_springs(scene),
        *find_damping_polynomials(scene),
        *find_gravity_compensation(scene),
        *free_joint_friction(scene),
        *find_tendons(scene),
        *find_actuators(scene),
        *find_fluid(scene),
        *find_equalities(scene),
        *find_flexes(scene),
        *find_plugins(scene),
        *find_flags(scene),
    ]
