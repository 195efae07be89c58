"""The same quantities from both models in both engines, side by side.

The four evaluations form a square: along two sides the engine is the same and the models differ,
along the other two the model is the same and the engines differ. So a deviation tells whose it is.

    URDF in Pinocchio --- models --- MJCF in Pinocchio
           |                                |
        engines                          engines
           |                                |
    URDF in MuJoCo ------ models --- MJCF in MuJoCo --- extras --- MJCF as it is

What a URDF cannot state (springs, tendons, fluid ...; see `passive`) is taken out of the MJCF for
the square, so that both engines are given the same model; the last side tells what it does.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError
from pupper_analysis.base.results import Result
from pupper_analysis.base.units import EARTH
from pupper_analysis.models.conversion import mujoco_from_urdf, pinocchio_from_mujoco
from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.models.mujoco_tree import MujocoTree
from pupper_analysis.models.multibody import from_pinocchio
from pupper_analysis.models.xml import parse_text
from pupper_analysis.robot.compare.evaluations import (
    Evaluation,
    QuantityValues,
    mujoco_evaluation,
    pinocchio_evaluation,
    yourdfpy_evaluation,
)
from pupper_analysis.robot.compare.mjcf_only import (
    as_it_is,
    mjcf_only_effects,
    split_mimics,
    without_effects,
)
from pupper_analysis.robot.compare.states import (
    States,
    affordable_states,
    check_states,
    is_large,
    random_states,
    size_notes,
    some_of,
)
from pupper_analysis.robot.coordinates import PinocchioConvention
from pupper_analysis.robot.matching.trees import Reference
from pupper_analysis.robot.matching.urdf import Mimics, urdf_mimics
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]

TOLERANCE = 1e-9
"""Deviation, relative to a quantity's scale, up to which two evaluations agree."""

URDF_PINOCCHIO = "URDF in Pinocchio"

MJCF_PINOCCHIO = "MJCF in Pinocchio"

URDF_MUJOCO = "URDF in MuJoCo"

MJCF_MUJOCO = "MJCF in MuJoCo"

MJCF_AS_IT_IS = "MJCF as it is"

URDF_YOURDFPY = "URDF in yourdfpy"

URDF_READ = "URDF, read by Pinocchio, in MuJoCo"
"""Takes the place of both evaluations in Pinocchio if the robot is large: see `size`."""

EXTRAS = "extras (MJCF)"
"""The side of springs, tendons, fluid and others that a URDF has no words for."""

EDGES = {
    (URDF_PINOCCHIO, MJCF_PINOCCHIO): "models (Pinocchio)",
    (URDF_MUJOCO, MJCF_MUJOCO): "models (MuJoCo)",
    (URDF_PINOCCHIO, URDF_MUJOCO): "engines (URDF)",
    (MJCF_PINOCCHIO, MJCF_MUJOCO): "engines (MJCF)",
    (URDF_PINOCCHIO, URDF_YOURDFPY): "yourdfpy (URDF)",
    (URDF_READ, MJCF_MUJOCO): "models (reader)",
    (URDF_READ, URDF_MUJOCO): "readers (URDF)",
    (URDF_READ, URDF_YOURDFPY): "yourdfpy (URDF)",
    (MJCF_MUJOCO, MJCF_AS_IT_IS): EXTRAS,
}
"""What a deviation between two evaluations is a deviation of."""

OF_ONE_MODEL = ("engines (URDF)", "engines (MJCF)", "readers (URDF)", "yourdfpy (URDF)")
"""Deviations of engines, which read one and the same model."""

OF_THE_MJCF = ("engines (MJCF)",)
"""Those of them in which MuJoCo's model is the MJCF's."""


@dataclass(frozen=True, eq=False)
class QuantityCheck(Result):
    """How far the evaluations on one quantity deviate.

    Attributes:
        name: The quantity.
        unit: Its unit.
        scale: What the deviation is relative to: the greatest absolute value.
        deviation: The worst absolute deviation.
        relative: The worst relative deviation.
        between: The two evaluations that deviate most.
        whose: What it is a deviation of: the models, or the engines.
        where: The body, joint or foot where it occurs, and the configuration's number.
        edges: {whose: worst relative deviation}.
        passed: Whether ``relative`` is within the tolerance.
    """

    name: str
    unit: str
    scale: float
    deviation: float
    relative: float
    between: tuple[str, str]
    whose: str
    where: str
    edges: dict[str, float]
    passed: bool


@dataclass(frozen=True, eq=False)
class CrossCheck(Result):
    """The comparison of a robot's two models in two engines, and of yourdfpy's kinematics.

    Attributes:
        passed: Whether all quantities agree.
        tolerance: Relative.
        configurations: Number of random configurations.
        seed: Of the random numbers.
        quantities: Per quantity.
        worst: The name of the quantity with the greatest relative deviation.
        notes: Where values come from that one of the files cannot state.
    """

    passed: bool
    tolerance: float
    configurations: int
    seed: int
    quantities: tuple[QuantityCheck, ...]
    worst: str
    notes: tuple[Diagnostic, ...]


@check_arguments
@silence_mujoco()
def cross_check(
    robot: Robot,
    *,
    configurations: int = 20,
    tolerance: float = TOLERANCE,
    seed: int = 0,
    mimics: Mimics | None = None,
    moved: Mapping[str, Array] | None = None,
) -> CrossCheck:
    """Compares the URDF and the MJCF, in Pinocchio and in MuJoCo.

    Configurations are random: joints inside their limits, the base anywhere (if it is free), with
    velocities and joint torques.

    Args:
        robot: The robot.
        configurations: How many.
        tolerance: Relative deviation that is let pass.
        seed: For the random numbers, 0 or more.
        mimics: The joints that follow others in the URDF; those of its text by default. A joint
            equality of the MJCF that says the same does not act here.
        moved: {joint: (3,) where its position is taken in the MJCF, from where the file puts it, in
            its body's axes}: on its own axis, where the URDF puts it.

    Returns:
        The worst deviation of each quantity, where it occurs, and the verdict.

    Raises:
        ConfigurationError: If an argument is out of its range.
    """
    check_states(configurations, seed)
    if not tolerance > 0:
        raise ConfigurationError("tolerance", diagnose("not-positive", value=tolerance))
    configurations, asked = affordable_states(robot, configurations), configurations
    states = random_states(robot, configurations, seed)
    reference = Reference(robot.mj_model, robot.mj_model, robot.joint_names, robot.mj_base)
    found = mjcf_only_effects(reference)
    if mimics is None:
        mimics = urdf_mimics(parse_text(robot.description.urdf))
    coupled, _ = split_mimics(found, reference, mimics, tolerance)
    evaluations, left_out = _evaluations(
        robot,
        states,
        without_effects(robot.mj_model, found),
        without_effects(robot.mj_model, coupled),
        moved or {},
    )
    first = URDF_READ if is_large(robot) else URDF_PINOCCHIO
    checks = tuple(_compare(name, evaluations, first, tolerance) for name in evaluations[first])
    return CrossCheck(
        passed=all(check.passed for check in checks),
        tolerance=tolerance,
        configurations=configurations,
        seed=seed,
        quantities=checks,
        worst=max(checks, key=lambda check: check.relative).name,
        notes=(
            *left_out,
            *size_notes(robot, asked, _pairs(robot)),
            diagnose("armature-is-the-mjcfs"),
            diagnose("gravity-is-the-mjcfs"),
            diagnose("forces-in-forward-dynamics"),
        ),
    )


def _evaluations(
    robot: Robot,
    states: States,
    square: mujoco.MjModel,
    whole: mujoco.MjModel,
    moved: Mapping[str, Array],
) -> tuple[dict[str, Evaluation], list[Diagnostic]]:
    """Evaluates both models in all backends.

    Args:
        robot: The robot.
        states: Where.
        square: MuJoCo's model of the MJCF, without what a URDF cannot state.
        whole: The same as it is, but for couplings that the URDF has, too.
        moved: Where joints of the MJCF are taken to be, from where it puts them.

    Returns:
        {backend: its evaluation}, and what was left out and why.
    """
    description = robot.description
    left_out = []
    in_mujoco: mujoco.MjModel | None = None
    try:
        in_mujoco = mujoco_from_urdf(
            description.urdf, description.urdf_source, robot.mj_model, robot.mj_base, robot.imu
        )
    except ModelError as error:
        told = error.diagnostic.values["problem"]
        left_out.append(diagnose("urdf-not-in-mujoco", problem=told))
    pairs = some_of(robot, _pairs(robot))
    urdf_frames = {name: pair[0] for name, pair in pairs.items()}
    mjcf_frames = {name: pair[1] for name, pair in pairs.items()}
    robot = replace(robot, contact_points=tuple(pairs), contact_frames=urdf_frames)
    base = robot.mj_base
    if is_large(robot):
        evaluations = {URDF_READ: _rebuilt_evaluation(robot, states)}
    else:
        in_pinocchio = pinocchio_from_mujoco(robot.mj_model)
        mjcf_robot = replace(
            robot,
            pin_model=in_pinocchio,
            pin_convention=PinocchioConvention.of(in_pinocchio, robot.joint_names),
            base=base,
            contact_frames=mjcf_frames,
        )
        evaluations = {
            URDF_PINOCCHIO: pinocchio_evaluation(robot, states, {}),
            MJCF_PINOCCHIO: pinocchio_evaluation(mjcf_robot, states, moved),
        }
    evaluations |= {
        MJCF_MUJOCO: mujoco_evaluation(robot, square, base, mjcf_frames, states, moved),
        MJCF_AS_IT_IS: mujoco_evaluation(robot, whole, base, mjcf_frames, states, moved),
    }
    if in_mujoco is not None:
        in_mujoco = as_it_is(in_mujoco)
        # MuJoCo's importer makes equalities of mimic joints, which Pinocchio leaves independent.
        in_mujoco.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT.value
        evaluations[URDF_MUJOCO] = mujoco_evaluation(
            robot, in_mujoco, robot.base, urdf_frames, states, {}
        )
    if pairs:
        evaluations[URDF_YOURDFPY] = yourdfpy_evaluation(robot, states)
    return evaluations, left_out


def _pairs(robot: Robot) -> dict[str, tuple[str, str]]:
    """Returns the frames that both files have, which are compared as the feet are."""
    return {**robot.description.contact_points, **robot.description.frames}


def _rebuilt_evaluation(robot: Robot, states: States) -> Evaluation:
    """Evaluates the URDF as Pinocchio reads it, in a MuJoCo model made of its numbers."""
    values = from_pinocchio(robot.pin_model, robot.base, robot.joint_names, robot.contact_frames)
    model = MujocoTree(values).model
    frames = {name: name for name in values.frames}
    return mujoco_evaluation(robot, model, values.base, frames, states, {})


def _compare(
    name: str, evaluations: Mapping[str, Evaluation], first: str, tolerance: float
) -> QuantityCheck:
    """Compares one quantity along every edge; the first evaluation gives scale and labels."""
    edges: dict[str, float] = {}
    least = _least_scale(name, evaluations[first])
    worst: tuple[float, float, float, tuple[str, str], str] | None = None
    for pair, whose in EDGES.items():
        if any(name not in evaluations.get(evaluation, {}) for evaluation in pair):
            continue
        one, two = (evaluations[evaluation][name] for evaluation in pair)
        found = _deviation(one, two, least)
        edges[whose] = found[0]
        if worst is None or found[0] > worst[0]:
            worst = (*found[:3], pair, found[3])
    assert worst is not None
    relative, deviation, scale, between, where = worst
    return QuantityCheck(
        name=name,
        unit=evaluations[first][name].unit,
        scale=scale,
        deviation=deviation,
        relative=relative,
        between=between,
        whose=EDGES[between],
        where=where,
        edges=edges,
        passed=bool(relative <= tolerance),
    )


def _least_scale(name: str, evaluation: Evaluation) -> float:
    """Returns below what a quantity is rounding alone: a ratio of that is no deviation."""
    if name in ("gravity", "bias forces"):  # a millionth of what the robot weighs
        return 1e-6 * EARTH * float(np.abs(evaluation["mass matrix"].values).max())
    return {"body masses": 1e-12, "body inertias": 1e-15, "mass matrix": 1e-15}.get(name, 1e-6)


def _deviation(
    one: QuantityValues, two: QuantityValues, least: float
) -> tuple[float, float, float, str]:
    """Returns the worst relative and absolute deviation, the scale, and the place."""
    with np.errstate(invalid="ignore"):
        difference = np.abs(one.values - two.values)
    difference[one.values == two.values] = 0.0  # infinite limits, too
    difference[~np.isfinite(difference)] = np.inf
    greatest = np.maximum(np.abs(one.values), np.abs(two.values))
    greatest[~np.isfinite(greatest)] = 0.0
    if one.per_row:
        scale = greatest.max(axis=-1, keepdims=True) + np.zeros_like(difference)
    else:
        scale = np.full_like(difference, greatest.max())
    scale = np.maximum(scale, least)
    with np.errstate(over="ignore", invalid="ignore"):
        relative = np.divide(
            difference, scale, out=np.where(difference > 0, np.inf, 0.0), where=scale > 0
        )
    place = np.unravel_index(int(np.argmax(relative)), relative.shape)
    where = one.labels[int(place[-2])]
    if one.of_state:
        where += f", #{place[0]}"
    return float(relative[place]), float(difference[place]), float(scale[place]), where
