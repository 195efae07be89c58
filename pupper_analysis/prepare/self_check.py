"""Compare a simulation of the published file with the predicted equilibrium, and name causes.

The published model (the user's file as compiled) is placed in the predicted equilibrium of a stand,
and is simulated with the servo commands that hold this equilibrium. Then torques, height and joint
positions are compared. The cause of a deviation is usually an element of the file: if it is
switched off in a copy of the model, the deviation disappears.
"""

from __future__ import annotations

import contextlib
import copy
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from pupper_analysis.base.array_types import Array, BoolArray, IntArray
from pupper_analysis.base.diagnostics import Diagnostic, Severity, diagnose
from pupper_analysis.base.errors import ModelError, PupperAnalysisError
from pupper_analysis.models.transmission import Drive
from pupper_analysis.prepare.causes import (
    COMMAND_CODES,
    NUMERICS_CODES,
    CauseCandidate,
    add_line,
    list_difference_causes,
    list_loading_changes,
    list_restraining_ties,
    list_shared_causes,
    list_soft_servos,
    list_ties,
)
from pupper_analysis.prepare.own_run import (
    get_published_model,
    keyframe_name,
    own_run,
    simulate_model_from_keyframe,
    simulate_posture,
)
from pupper_analysis.prepare.published_model import (
    FORCE_WINDOW,
    HoldCommands,
    PublishedModel,
    compute_hold_commands,
    find_self_controlled_joints,
    has_few_servos,
    lay_on_tilted_floor,
    place_fixed_base,
    place_published,
    simulate_published,
    with_requested_gains,
    with_unstated_options,
)
from pupper_analysis.robot.as_published import (
    MAX_POSTURE_DEVIATION,
    Cause,
    OwnCommands,
    OwnRun,
    Published,
    PublishedRun,
    ServoSource,
    ServosUsed,
)
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.fall import (
    FALLEN_TILT,
    BodyMotion,
    InitialHeight,
    measure_motion,
    nudge_velocity,
    tilt_between,
)
from pupper_analysis.robot.robot import Robot, get_loaded_robot
from pupper_analysis.robot.servos import list_position_servos, resolve_servo_gains
from pupper_analysis.simulation.settling import LARGE_NUDGE_SPEED
from pupper_analysis.simulation.verify import (
    JOINT_TOLERANCE,
    find_worst_unit,
    friction_and_deadband,
    torque_scale,
)
from pupper_analysis.stance.sag.steady_state import steady_state
from pupper_analysis.stance.soft_ground import solve_stand_as_simulated
from pupper_analysis.stance.stand import Stand, solve_stand, stand_statics
from pupper_analysis.statics.equilibrium import gravity_compensation

SETTLING_TIME = 1.0
"""Simulated time [s] between the start in the predicted equilibrium and the nudge (a small
velocity). Chosen, not tuned.
"""

NUDGED_TIME = 4.0
"""Lower bound of the simulated time [s] between the nudge and the comparison with the predicted
equilibrium, unless the simulation ends early (`_is_lasting`). Chosen, not tuned.
"""

_MAX_NUDGED_TIME = 40.0
"""Upper bound of the simulated time after the small nudge [s], while the torques approach the
predicted torques. Chosen, not tuned.
"""

_APPROACH_INTERVAL = 2.0
"""Simulated time between two evaluations of the deviation from the predicted torques [s]. Chosen as
a divisor of `NUDGED_TIME`.
"""

_MAX_APPROACH_RATIO = 0.9
"""Upper bound of the ratio of two successive torque deviations, `_APPROACH_INTERVAL` apart [1],
with which the torques count as approaching the predicted torques. Measured after the nudge of a
robot with six feet, elliptic cones and an ``impratio`` of 100: tangential forces relax with a time
constant of 6.8 s, which is a ratio of 0.75.
"""

_MAX_BASE_NUDGE_WINDOWS = 6
"""Upper bound of the simulated time after a large nudge of the base [1], in windows of
`FORCE_WINDOW` (1 s). Chosen equal to the time of ``settling.calms_after_base_nudges``."""

_MIN_LASTING_RATIO = 5.0
"""Lower bound of the torque deviation, divided by `TORQUE_RTOL` [1], with which the simulation of a
changed model may end early (`_is_lasting`). Chosen, not tuned: to agree with the predicted torques,
the deviation would still have to fall by a factor of five."""

TORQUE_RTOL = 0.01
"""Upper bound of the deviation from the predicted torques, divided by ``torque_scale`` [1], with
which the published file agrees with the predicted equilibrium. Chosen as for a verified stand
(``FORCE_TOLERANCE``).
"""

MAX_REMAINING_SINKAGE = 1e-3
"""Height error of the CoM [m] up to which switched-off elements count as the cause, if switching
them off repairs the torques, and the joint positions agree. Otherwise `HEIGHT_RTOL` applies.
Chosen, not tuned.
"""

HEIGHT_RTOL = 1e-3
"""Upper bound of the height error of the CoM, divided by the CoM height [1], with which the
published file agrees with the predicted equilibrium. Chosen, not tuned.
"""


def compare_as_published(
    robot: Robot,
    stand: Stand,
    servos: ServosUsed,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
) -> Published | None:
    """Simulate the unmodified model file in a stand; compare it with the predicted equilibrium.

    The nominal stand of the robot as loaded (default `StandTask`) may be compared instead of
    ``stand``, for example if the robot was changed after loading.

    Args:
        robot: Prepared robot.
        stand: Stand whose equilibrium is predicted.
        servos: Servos that the verdict uses, with their origin: file, caller or preparation.
        kp: Requested servo stiffness [N m/rad, N/m], scalar or (nu,); None: value of the model.
        kd: Requested servo damping [N m s/rad, N s/m], scalar or (nu,); None: value of the model.

    Returns:
        Comparison; None if there is nothing to compare, for example no file.
    """
    if robot.published is None or robot.published.is_unchanged:
        return None
    gains = (kp, kd) if servos.source is ServoSource.GIVEN else None
    loaded = get_loaded_robot(robot)
    if not loaded.floating:
        return _compare_stand(loaded, stand, gains)
    if robot.published.loaded is not None or robot.fixed_parts or not stand.task.ground.is_level:
        if gains is None:
            return loaded.compute_once(compare_nominal_stand)
        return _compare_nominal(loaded, gains)
    if gains is None and robot is loaded and _is_nominal_stand(robot, stand):
        return loaded.compute_once(
            compare_nominal_stand
        )  # not simulated again for a robot with payload
    return _compare_stand(robot, stand, gains)


def _is_nominal_stand(robot: Robot, stand: Stand) -> bool:
    """Return True if a stand has the task and qpos of the nominal stand (default `StandTask`)."""
    with contextlib.suppress(PupperAnalysisError):
        nominal = solve_stand(robot, explain=False)
        return nominal.task == stand.task and np.array_equal(nominal.qpos, stand.qpos)
    return False


RequestedGains = tuple[ArrayLike | None, ArrayLike | None]
"""Servo gains that the caller passed, scalar or (nu,): stiffness kp [N m/rad, N/m] and damping kd
[N m s/rad, N s/m]. None: value of the model.
"""


def compare_nominal_stand(robot: Robot) -> Published | None:
    """Compare MuJoCo's result for the published file with the predicted nominal stand.

    The nominal stand is the solution of the default `StandTask`.

    Returns:
        Comparison; None, for example, if the robot has no nominal stand.
    """
    return _compare_nominal(robot, None)


def _compare_nominal(robot: Robot, gains: RequestedGains | None) -> Published | None:
    """Compare the published file with the predicted equilibrium of the nominal stand, for gains.

    ``gains`` None: those of the model. The result is None if no comparison is possible.
    """
    with contextlib.suppress(PupperAnalysisError):
        return _compare_stand(robot, solve_stand(robot, explain=False), gains)
    return None


def _compare_stand(robot: Robot, stand: Stand, gains: RequestedGains | None) -> Published | None:
    """Compare the published file with the predicted equilibrium of a stand, and find causes.

    If the base is free in the robot, but not in the file, the result contains this cause without a
    simulation.

    Args:
        robot: Prepared robot.
        stand: Stand whose equilibrium is predicted.
        gains: Requested gains; None: gains of the model.

    Returns:
        Comparison; None, for example, if the robot has no feet, or the stand no equilibrium.
    """
    if robot.published is None or (robot.floating and not robot.feet):
        return None
    model = robot.compute_once(get_published_model)
    if model is None and (robot.published.file is None or not robot.floating):
        return None
    published = (
        None
        if model is None
        else with_unstated_options(PublishedModel.from_model(model, robot), robot)
    )
    if published is not None and gains is not None:
        published, robot = with_requested_gains(published, robot, *gains)
    predictions = predict_stand(robot, stand) if published is not None else []
    if published is not None and (not predictions or (published.floating and not robot.floating)):
        return None
    if published is None or published.floating != robot.floating:
        return Published((), (Cause("base-held", (robot.mj_base,)),), differs=True)
    found = compare_with_file(published, robot, predictions)
    return replace(found, causes=add_lines(found.causes, robot))


def add_lines(causes: Iterable[Cause], robot: Robot) -> tuple[Cause, ...]:
    """Add the line of the first element in the MJCF, if known, to each cause of a deviation."""
    file = None if robot.published is None else robot.published.file
    return tuple(cause if file is None else add_line(cause, file) for cause in causes)


def compare_with_file(
    published: PublishedModel, robot: Robot, predictions: Sequence[PredictedRest]
) -> Published:
    """Simulate the unmodified file from predicted equilibria, and list causes of a deviation.

    Of several simulations with a deviation, the first is explained. If the file cannot be
    simulated, the reason is listed as the cause. Without level ground, the ground is the cause, and
    the simulations on the tilted floor are included if the robot falls there. If no cause is
    found, the deviation counts as agreement if the prepared robot moves like the file
    (`_keep_moving_alike`).

    Args:
        published: Published model: the user's file as compiled.
        robot: Prepared robot.
        predictions: Predicted equilibria, in which the simulations start.
    """
    if controlled := find_self_controlled_joints(published, robot):
        return Published((), (Cause("other-drive", controlled),), differs=True)
    if published.floating and published.ground_height is None:
        on_floor = [simulate_prediction(published, robot, prediction) for prediction in predictions]
        falls = tuple(run for run in on_floor if run is not None and run.collapses)
        return Published(falls, (Cause("ground", ()),), differs=True)
    results = [
        (prediction, simulate_prediction(published, robot, prediction))
        for prediction in predictions
    ]
    runs = tuple(run for _, run in results if run is not None)
    differing = [
        (prediction, run) for prediction, run in results if run is not None and run.differs
    ]
    causes: tuple[Cause, ...] = ()
    prepared: PublishedRun | None = None
    if differing:
        causes = find_difference_causes(published, robot, *differing[0])
    if differing and not causes:
        prepared = _simulate_prepared_robot(robot, differing[0][0])
        causes = _find_loading_causes(published, robot, *differing[0], prepared)
    if differing and not causes and _keep_moving_alike(*differing[0], prepared):
        shared = differing[0][1]
        runs = tuple(replace(run, differs=run.differs and run is not shared) for run in runs)
    return Published(runs, causes, differs=any(run.differs for run in runs))


def _simulate_prepared_robot(robot: Robot, prediction: PredictedRest) -> PublishedRun | None:
    """Simulate the prepared robot from a predicted equilibrium; None if this is not possible."""
    model = PublishedModel.from_model(copy.copy(robot.mj_model), robot)
    return simulate_prediction(model, robot, prediction)


def _keep_moving_alike(
    prediction: PredictedRest, run: PublishedRun, prepared: PublishedRun | None
) -> bool:
    """Return True if published file and prepared robot keep moving alike, without feed-forward.

    The file is then no cause: the robot itself does not come to rest. ``run`` is the simulation of
    the file, ``prepared`` the simulation of the prepared robot. A collapse is not shared motion.
    """
    if prediction.feedforward or run.collapses or not run.keeps_moving:
        return False
    return (
        prepared is not None
        and prepared.keeps_moving
        and abs(prepared.torque_error - run.torque_error) <= TORQUE_RTOL
    )


def _find_loading_causes(
    published: PublishedModel,
    robot: Robot,
    prediction: PredictedRest,
    run: PublishedRun,
    prepared: PublishedRun | None,
) -> tuple[Cause, ...]:
    """Find causes of a deviation in the preparation, or in differences between URDF and MJCF.

    ``run`` is the simulation of the published file, ``prepared`` the simulation of the prepared
    robot. If the prepared robot agrees with the prediction, changes of the preparation are the
    probable cause. If the prepared robot deviates as well, a difference between URDF and MJCF may
    be the cause.
    """
    file = None if robot.published is None else robot.published.file
    if prepared is None:
        return ()
    if not prepared.differs:
        return list_loading_changes(published, robot)
    if file is None or robot.description.converted:
        return ()
    model = copy.copy(published.model)
    for candidate in list_difference_causes(published, robot):
        candidate.switch_off(model)
    stripped = simulate_prediction(replace(published, model=model), robot, prediction)
    similar_runs = (similar for similar in (run, stripped) if similar is not None)
    if not any(
        abs(prepared.torque_error - similar.torque_error) <= TORQUE_RTOL for similar in similar_runs
    ):
        return ()
    # Imports forty modules, which few verdicts need.
    from pupper_analysis.robot.compare.compare import find_first_difference

    difference = find_first_difference(robot)
    return () if difference is None else (Cause("pair", (), difference=difference),)


@dataclass(frozen=True, eq=False)
class PredictedRest:
    """Predicted equilibrium of a stand, with which a simulation is compared.

    Attributes:
        feedforward: True if the commands include feed-forward torques; False for position commands
            alone.
        qpos: Configuration, shape (nq,), with the feet in the soft ground; with a fixed base, the
            joint positions, shape (nu,).
        torques: Joint torques, shape (nu,) [N m, N].
        targets: Commanded positions, shape (nu,) [rad, m].
    """

    feedforward: bool
    qpos: Array
    torques: Array
    targets: Array


def predict_stand(robot: Robot, stand: Stand) -> list[PredictedRest]:
    """Predict the equilibrium of a stand or posture, with feed-forward torques and perhaps without.

    The stand of a free base is solved on soft ground if possible.

    Returns:
        Prediction with feed-forward. For a free base, a prediction with position commands alone may
        follow. Empty without equilibrium.
    """
    if not robot.floating:
        joints = stand.qpos[-robot.nu :]
        torques = gravity_compensation(Configuration(robot, joints), contacts=()).joint_torques
        return [PredictedRest(True, joints, torques, joints)]
    try:
        held = solve_stand_as_simulated(robot, stand)
        torques = stand_statics(robot, held).joint_torques
    except PupperAnalysisError:
        return []
    predictions = [PredictedRest(True, held.qpos, torques, held.joint_positions(robot))]
    added = robot.description.made_servos
    replaced = any(servo.instead_of in (Drive.SERVO, Drive.TENDON) for servo in added)
    if len(list_position_servos(robot)) < robot.nu or replaced:
        return predictions  # the file's joints deflect differently from those with added servos
    with contextlib.suppress(PupperAnalysisError):
        # Pinned feet creep by fractions of a millimetre to the positions of sliding feet.
        rest = steady_state(robot, held, feet="sliding")
        if not rest.failures:
            targets = held.joint_positions(robot)
            predictions.append(PredictedRest(False, rest.qpos, rest.joint_torques, targets))
    return predictions


def simulate_prediction(
    published: PublishedModel,
    robot: Robot,
    prediction: PredictedRest,
    *,
    until_decided: bool = False,
) -> PublishedRun | None:
    """Simulate the published model from a predicted equilibrium, and compare both.

    The model settles, is nudged (gets a small velocity), and may later get large nudges of the
    base. CoM height [m] and joint positions [rad, m] are compared at the end; joint torques [N m,
    N] over the last second.

    Args:
        published: Published model: the user's file as compiled.
        robot: Prepared robot.
        prediction: Predicted state of rest.
        until_decided: Whether the simulation may end early if the torque deviation is large and
            does not fall (`_is_lasting`).

    Returns:
        Comparison; None if the base cannot be placed, or if MuJoCo stops with a fatal error.
    """
    place_model = place_published if robot.floating else place_fixed_base
    data = place_model(published, robot, prediction.qpos)
    if data is None:
        return None
    tilted = robot.floating and published.ground_height is None
    if tilted and not lay_on_tilted_floor(published, data):
        return None
    mujoco.mj_kinematics(published.model, data)
    mujoco.mj_comPos(published.model, data)
    start = copy.copy(data)
    feedforward = prediction.torques if prediction.feedforward else None
    hold = compute_hold_commands(published, robot, data, feedforward, prediction.targets)
    torques = _PredictedTorques.from_prediction(published, robot, prediction)
    try:
        end = _simulate_nudges(
            published, robot, data, hold, torques, prediction, until_decided=until_decided
        )
    except mujoco.FatalError:  # for example contacts of shapes without extent
        return None
    return _compare_end_state(published, robot, prediction, start, end, torques)


@dataclass(frozen=True, eq=False)
class _PredictedTorques:
    """Predicted joint torques, with which the forces in a published model are compared.

    Attributes:
        torques: Predicted torques, shape (nu,) [N m, N].
        dofs: Degree of freedom of each joint in the published model, shape (nu,).
        driven: Whether the prepared robot has an actuator for each joint, shape (nu,).
        scale: Torque scale, by which deviations are divided (`torque_scale`).
    """

    torques: Array
    dofs: IntArray
    driven: BoolArray
    scale: float

    @classmethod
    def from_prediction(
        cls, published: PublishedModel, robot: Robot, prediction: PredictedRest
    ) -> _PredictedTorques:
        """Find the degrees of freedom, the actuators and the scale of predicted torques."""
        joints = [published.model.joint(name).id for name in robot.joint_names]
        return cls(
            torques=prediction.torques,
            dofs=published.model.jnt_dofadr[joints],
            driven=robot.mj_convention.actuator_index >= 0,
            scale=torque_scale(robot, prediction.torques),
        )

    def compute_deviations(self, low: Array, high: Array) -> Array:
        """Compute the largest deviation of each driven joint from its predicted torque.

        Args:
            low: Minimum force on each degree of freedom, shape (nv,) [N m, N].
            high: Maximum force on each degree of freedom, shape (nv,) [N m, N].

        Returns:
            Deviations, shape (number of driven joints,) [N m, N].
        """
        above, below = high[self.dofs] - self.torques, self.torques - low[self.dofs]
        return np.asarray(np.maximum(above, below)[self.driven])

    def compute_relative_deviation(self, low: Array, high: Array) -> float:
        """Compute the largest deviation of a driven joint's torque / torque scale [1].

        Args:
            low: Minimum force on each degree of freedom, shape (nv,) [N m, N].
            high: Maximum force on each degree of freedom, shape (nv,) [N m, N].
        """
        return float(self.compute_deviations(low, high).max(initial=0.0)) / self.scale

    def compute_relative_range(self, low: Array, high: Array) -> float:
        """Compute the largest range (high - low) of a driven joint's torque / torque scale [1]."""
        return float((high - low)[self.dofs][self.driven].max(initial=0.0)) / self.scale


@dataclass(frozen=True, eq=False)
class _NudgedState:
    """State of a published model at the end of a simulation with a nudge.

    Attributes:
        data: State.
        low: Minimum forces in the last `FORCE_WINDOW`, shape (model.nv,) [N m, N].
        high: Maximum forces in the last `FORCE_WINDOW`, shape (model.nv,) [N m, N].
        nudged_time: Simulated time after the first nudge [s], without the time after large nudges.
    """

    data: mujoco.MjData
    low: Array
    high: Array
    nudged_time: float


def _simulate_nudges(
    published: PublishedModel,
    robot: Robot,
    data: mujoco.MjData,
    hold: HoldCommands,
    torques: _PredictedTorques,
    prediction: PredictedRest,
    *,
    until_decided: bool,
) -> _NudgedState:
    """Simulate a published model with a nudge, and perhaps with large nudges of the base.

    ``data`` is the initial state, and is changed in place.
    """
    model = published.model
    low, high, nudged_time = _simulate_until_compared(
        published,
        data,
        hold,
        torques.compute_relative_deviation,
        # Activations are reset at the start of each part of a simulation.
        may_end_early=until_decided and robot.floating and not model.na,
    )
    is_longer = model.opt.timestep > robot.mj_model.opt.timestep * (1 + _TIMESTEP_RTOL)
    is_at_rest = torques.compute_relative_deviation(low, high) <= TORQUE_RTOL
    if robot.floating and prediction.feedforward and is_longer and is_at_rest:
        shaken = _find_shaken_state(published, data, hold, torques.compute_relative_deviation)
        data, low, high = shaken or (data, low, high)
    return _NudgedState(data, low, high, nudged_time)


def _compare_end_state(
    published: PublishedModel,
    robot: Robot,
    prediction: PredictedRest,
    start: mujoco.MjData,
    end: _NudgedState,
    torques: _PredictedTorques,
) -> PublishedRun:
    """Compare height, joint positions and torques at the end of a simulation with a prediction."""
    torque_deviations = torques.compute_deviations(end.low, end.high)
    joints = [published.model.joint(name).id for name in robot.joint_names]
    positions = end.data.qpos[published.model.jnt_qposadr[joints]]
    moved, stiction = np.abs(positions - prediction.qpos[-robot.nu :]), np.zeros(robot.nu)
    error, collapses, alike = None, not float(moved.max()) <= MAX_POSTURE_DEVIATION, True
    lifted, duration = False, SETTLING_TIME + end.nudged_time
    if robot.floating:
        motion = _measure_base_motion(published, start, end.data, duration)
        error, collapses = motion.end_height - motion.height, motion.collapses
        lifted = motion.is_lifted
        alike = abs(error) <= HEIGHT_RTOL * motion.height
    else:  # dry friction may hold a joint elsewhere after a nudge
        with contextlib.suppress(ModelError):
            stiction = resolve_servo_gains(robot).kp
        friction, stiction = friction_and_deadband(robot, stiction)
        torque_deviations = np.maximum(torque_deviations - friction[torques.driven], 0.0)
    torque = float(torque_deviations.max(initial=0.0)) / torques.scale
    joint = float(moved.max())
    alike = alike and (
        not prediction.feedforward or joint <= JOINT_TOLERANCE + float(stiction.max())
    )
    return PublishedRun(
        feedforward=prediction.feedforward,
        duration=duration,
        torque_error=torque,
        height_error=error,
        joint_error=joint,
        collapses=collapses,
        differs=collapses or not (alike and torque <= TORQUE_RTOL),
        imported=robot.published is not None and robot.published.imported is not None,
        worst_joint=_find_worst_joint(robot, moved, torque_deviations, collapses=collapses),
        joint_error_unit=find_worst_unit(robot, moved),
        _keeps_moving=torques.compute_relative_range(end.low, end.high) > TORQUE_RTOL,
        _is_lifted=lifted,
    )


def _measure_base_motion(
    published: PublishedModel, start: mujoco.MjData, end: mujoco.MjData, duration: float
) -> BodyMotion:
    """Measure the motion of a published model's base in ``duration`` [s] from start to end."""
    com = float(start.subtree_com[published.base_body][2])
    predicted = InitialHeight(com, 0.0, published.ground_height or 0.0)
    return measure_motion(published.model, start, end, published.base_body, duration, predicted)


def _simulate_until_compared(
    published: PublishedModel,
    data: mujoco.MjData,
    hold: HoldCommands,
    find_deviation: Callable[[Array, Array], float],
    *,
    may_end_early: bool,
) -> tuple[Array, Array, float]:
    """Simulate a published model before and after a nudge, until its torques can be compared.

    After the nudge, at least `NUDGED_TIME` is simulated, and at most `_MAX_NUDGED_TIME` while the
    torques approach the prediction. With ``may_end_early``, the simulation ends after
    `_APPROACH_INTERVAL` if a large deviation lasts (`_is_lasting`).

    ``data`` is changed to the final state. ``find_deviation`` converts minimum and maximum forces,
    shape (model.nv,) each [N m, N], to the torque deviation divided by the torque scale [1].

    Returns:
        Minimum and maximum forces in the last `FORCE_WINDOW`, shape (model.nv,) each [N m, N], and
        the simulated time after the nudge [s].
    """
    simulate_published(published, data, hold, SETTLING_TIME, record_forces=False)
    data.qvel[:] += nudge_velocity(published.model)
    nudged_time, deviation, approaches = 0.0, np.inf, True
    while nudged_time < _MAX_NUDGED_TIME and (nudged_time < NUDGED_TIME or approaches):
        remaining, earlier = _APPROACH_INTERVAL, None
        if may_end_early and not nudged_time:
            earlier = find_deviation(*simulate_published(published, data, hold, FORCE_WINDOW))
            remaining -= FORCE_WINDOW
        low, high = simulate_published(published, data, hold, remaining)
        nudged_time += _APPROACH_INTERVAL
        previous, deviation = deviation, find_deviation(low, high)
        if earlier is not None and _is_lasting(earlier, deviation):
            break
        approaches = TORQUE_RTOL < deviation < _MAX_APPROACH_RATIO * previous
    return low, high, nudged_time


_TIMESTEP_RTOL = 1e-9
"""Relative tolerance of two time steps that count as equal [1]. Chosen above rounding errors."""


def _find_shaken_state(
    published: PublishedModel,
    rest: mujoco.MjData,
    hold: HoldCommands,
    find_deviation: Callable[[Array, Array], float],
) -> tuple[mujoco.MjData, Array, Array] | None:
    """Nudge the base of a resting published model, and find a motion that shakes without decay.

    Returns:
        State, minimum and maximum forces, shape (model.nv,) each [N m, N]; None without such
        motion.
    """
    base = int(published.model.body_dofadr[published.base_body])
    for axis in range(3):
        for speed in (LARGE_NUDGE_SPEED, -LARGE_NUDGE_SPEED):
            data, deviations = copy.copy(rest), list[float]()
            data.qvel[base + axis] += speed
            for _ in range(_MAX_BASE_NUDGE_WINDOWS):
                low, high = simulate_published(published, data, hold, FORCE_WINDOW)
                deviations.append(find_deviation(low, high))
                if deviations[-1] <= TORQUE_RTOL:
                    break
            else:  # the extremes of chatter vary: intervals of `_APPROACH_INTERVAL` are compared
                if not max(deviations[-2:]) < _MAX_APPROACH_RATIO * max(deviations[-4:-2]):
                    return data, low, high
    return None


def _is_lasting(earlier: float, deviation: float) -> bool:
    """Return True if torques deviate much from the predicted torques, and hardly approach them.

    The arguments are the torque deviations, divided by the torque scale [1], in two successive
    windows of `FORCE_WINDOW`.
    """
    ratio = float(_MAX_APPROACH_RATIO ** (FORCE_WINDOW / _APPROACH_INTERVAL))
    return deviation > max(_MIN_LASTING_RATIO * TORQUE_RTOL, ratio * earlier)


def _find_worst_joint(robot: Robot, moved: Array, torque_error: Array, *, collapses: bool) -> str:
    """Return the joint that deviates most from the predicted equilibrium.

    If the robot collapses, the displacements ``moved``, shape (nu,) [rad, m], decide; otherwise
    usually ``torque_error`` of the driven joints [N m, N].
    """
    names = np.array(robot.joint_names)
    if collapses or not torque_error.size:
        return str(names[int(np.argmax(moved))])
    return str(names[robot.mj_convention.actuator_index >= 0][int(np.argmax(torque_error))])


def explain_own_run(robot: Robot) -> OwnRun | None:
    """Simulate a robot's unmodified file from its keyframe, and name the causes of a failure.

    The result is cached per loaded robot. Causes are elements of the file (`prepare.causes`).

    Returns:
        Simulation with the causes that were found; None, for example, for a fixed base.
    """
    return get_loaded_robot(robot).compute_once(_explain_own_run)


def _explain_own_run(robot: Robot) -> OwnRun | None:
    """Simulate the unmodified file from its keyframe (`explain_own_run`, uncached)."""
    run = own_run(robot)
    model = robot.compute_once(get_published_model)
    if run is None or not run.fails or model is None:
        return run
    published = PublishedModel.from_model(model, robot)
    if any(drive.has_invalid_stiffness for drive in published.drives):
        return run  # the bad servos are reported, and make other causes meaningless
    causes = (
        _list_pose_causes(run, published, robot)
        or list_command_causes(run, published)
        or _find_run_causes(run, published, robot)
    )
    return replace(run, causes=add_lines(causes, robot))


def _list_pose_causes(run: OwnRun, published: PublishedModel, robot: Robot) -> tuple[Cause, ...]:
    """Return the keyframe of a simulation as cause if it tilts the base far from the start pose."""
    upright = place_published(published, robot, robot.home)
    if not run.keyframe or upright is None:
        return ()
    model = published.model
    reset = mujoco.MjData(model)
    key = next(key for key in range(model.nkey) if keyframe_name(model, key) == run.keyframe)
    mujoco.mj_resetDataKeyframe(model, reset, key)
    for data in (reset, upright):
        mujoco.mj_kinematics(model, data)
    base = published.base_body
    tilt = tilt_between(reset.xmat[base].reshape(3, 3), upright.xmat[base].reshape(3, 3))
    return (Cause("keyframe-tilted", (run.keyframe,)),) if tilt > FALLEN_TILT else ()


def list_command_causes(run: OwnRun, published: PublishedModel) -> tuple[Cause, ...]:
    """Return the ctrl of the keyframe, if it causes the failure of a simulation from the keyframe.

    The ctrl may be absent, or may be meant for position servos that the file lacks.

    Returns:
        A single cause, or an empty tuple.
    """
    if run.commands is OwnCommands.ABSENT and run.held is not None and not run.held.falls:
        return (Cause("ctrl-absent", (run.keyframe,)),)
    if run.commands is OwnCommands.STATED and has_few_servos(published):
        return (Cause("angles-to-motors", (run.keyframe,)),)
    return ()


def name_remaining_cause(
    robot: Robot, own: OwnRun | None, published: Published | None
) -> tuple[OwnRun | None, Published | None]:
    """Add the most probable cause to a failed simulation for which no other cause was found.

    Possible causes are ball joints, too soft servos, and the joint that deviates most, for example.

    Args:
        robot: Prepared robot.
        own: Simulation from the keyframe, without causes; None if there is none.
        published: Simulations from the equilibrium, without causes; None if there are none.

    Returns:
        ``own`` and ``published``; a cause is added to one of them at most.
    """
    balls = list_ball_joints(robot)
    if own is not None and own.fails:
        return replace(
            own,
            causes=balls or robot.compute_once(_find_soft_servo_cause) or _name_probable_cause(own),
        ), published
    run = None if published is None else published.worst
    if published is None or run is None or run.agrees_with_equilibrium:
        return own, published
    return own, replace(published, causes=balls or (Cause("gives-way", (run.worst_joint,)),))


def list_ball_joints(robot: Robot) -> tuple[Cause, ...]:
    """Return ball joints of the published MJCF as causes of a failed simulation.

    The prepared robot holds these joints at rest. Empty without such joints.
    """
    loaded = get_loaded_robot(robot)
    model = loaded.compute_once(get_published_model)
    if model is None:
        return ()
    published = PublishedModel.from_model(model, loaded)
    return add_lines(
        [
            candidate.make_cause(0.0)
            for candidate in list_difference_causes(published, loaded)
            if candidate.code == "ball-joints"
        ],
        loaded,
    )


def report_ties(robot: Robot) -> tuple[Diagnostic, ...]:
    """Report elements of the file that tie a robot with a free base to the world or a mocap body.

    The severity is ERROR if the unmodified file stands from its keyframe, but not without these
    elements. The result is cached per loaded robot.
    """
    return get_loaded_robot(robot).compute_once(_report_ties)


def _report_ties(robot: Robot) -> tuple[Diagnostic, ...]:
    """Report the ties of a robot to the world (`report_ties`, uncached)."""
    model = robot.compute_once(get_published_model)
    ties = [] if model is None or not robot.floating else list(list_ties(model))
    if model is None or not ties:
        return ()
    untied = copy.copy(model)
    for tie in ties:
        tie.switch_off(untied)
    published = PublishedModel.from_model(untied, robot)
    tied_run, run = own_run(robot), simulate_model_from_keyframe(published, robot)
    falls = tied_run is not None and not tied_run.fails and run is not None and run.fails
    names = [name for tie in ties for name in tie.elements]
    line = add_lines([ties[0].make_cause(0.0)], robot)[0].line
    message = diagnose("base-tied", names=names, line=line, falls=falls)
    return (replace(message, severity=Severity.ERROR) if falls else message,)


def report_posture_ties(robot: Robot, joints: Array) -> tuple[Diagnostic, ...]:
    """Report constraints of the file that tie a link of a robot with a fixed base to the world.

    Constraints that close a loop with the base are not reported (`list_restraining_ties`). The
    severity is ERROR if the unmodified file, commanded to a posture, keeps the posture, but not
    without these constraints.

    Args:
        robot: Prepared robot with a fixed base, as loaded.
        joints: Joint positions of the posture, shape (nu,) [rad, m].
    """
    model = None if robot.closure is None else robot.compute_once(get_published_model)
    ties = [] if model is None else list_restraining_ties(model, robot)
    if model is None or not ties:
        return ()
    untied = copy.copy(model)
    for tie in ties:
        tie.switch_off(untied)
    tied_run, run = (
        simulate_posture(PublishedModel.from_model(changed, robot), robot, joints)
        for changed in (model, untied)
    )
    leaves = tied_run.keeps_stance and not run.keeps_stance
    message = diagnose(
        "link-tied",
        names=[name for tie in ties for name in tie.elements],
        line=add_lines([ties[0].make_cause(0.0)], robot)[0].line,
        leaves=leaves,
    )
    return (replace(message, severity=Severity.ERROR) if leaves else message,)


def _find_soft_servo_cause(robot: Robot) -> tuple[Cause, ...]:
    """Return too soft servos as cause if the file stands with stiffer servos; empty otherwise."""
    loaded = get_loaded_robot(robot)
    model = loaded.compute_once(get_published_model)
    if model is None or not loaded.floating:
        return ()
    published = PublishedModel.from_model(model, loaded)
    for candidate in list_soft_servos(published, loaded):
        stiffer = copy.copy(model)
        candidate.switch_off(stiffer)
        run = simulate_model_from_keyframe(replace(published, model=stiffer), loaded)
        if run is not None and not run.fails:
            return add_lines([candidate.make_cause(0.0)], loaded)
    return ()


def _name_probable_cause(run: OwnRun) -> tuple[Cause, ...]:
    """Return the probable cause of a failed simulation of the file, without further simulations."""
    joint = run.unheld or run.lifted_leg or run.worst
    if joint is None:
        return (Cause("diverges", ()),)
    if run.unheld is not None:
        return (Cause("joint-unheld", (joint.joint,)),)
    if joint.drive.has_other_law:
        return (Cause("other-drive", (joint.joint,)),)
    return (Cause("ctrl-elsewhere" if joint.commanded_away else "gives-way", (joint.joint,)),)


def _find_run_causes(run: OwnRun, published: PublishedModel, robot: Robot) -> tuple[Cause, ...]:
    """Find the elements of the file that cause the failure of its simulation from a keyframe."""
    model = published.model
    candidates, physical = (
        list_difference_causes(published, robot),
        list_shared_causes(published, robot),
    )
    if run.unheld is not None or (run.worst is not None and run.worst.commanded_away):
        # Nothing holds a joint, or its ctrl belongs to another pose: then other changes may let the
        # robot stand by chance.
        candidates, physical = (
            [copied for copied in group if copied.code in COMMAND_CODES]
            for group in (candidates, physical)
        )

    def test_model(changed: mujoco.MjModel) -> float | None:
        """Simulate a changed model from the keyframe; return 0.0 if it stands, None if not."""
        # A single other time step may let an unstable robot stand by chance.
        finer = changed.opt.timestep < model.opt.timestep
        for parts in (1, 2, 4) if finer else (1,):
            copied = copy.copy(changed)
            copied.opt.timestep /= parts
            again = simulate_model_from_keyframe(replace(published, model=copied), robot)
            if again is None or again.fails:
                return None
        return 0.0

    return _find_causes_by_removal(published, candidates, physical, test_model)


def find_difference_causes(
    published: PublishedModel, robot: Robot, prediction: PredictedRest, run: PublishedRun
) -> tuple[Cause, ...]:
    """Find elements of a published MJCF that cause the deviation from the predicted stand.

    Elements are switched off in copies of the model, which are simulated again
    (`_find_causes_by_removal`).

    Returns:
        Causes; empty if no cause is found.
    """

    def test_model(model: mujoco.MjModel) -> float | None:
        """Simulate a changed model; return its torque error [1], or None if it still deviates."""
        changed = replace(published, model=model)
        new_run = simulate_prediction(changed, robot, prediction, until_decided=True)
        if new_run is None or new_run.collapses:
            return None
        # Pyramidal cones with more friction make the ground stiffer: the height may change.
        in_place = (
            abs(new_run.height_error or 0.0) <= MAX_REMAINING_SINKAGE
            and new_run.joint_error <= JOINT_TOLERANCE
        )
        is_repaired = in_place and new_run.torque_error <= TORQUE_RTOL < run.torque_error
        return new_run.torque_error if is_repaired or not new_run.differs else None

    if any(drive.has_invalid_stiffness for drive in published.drives):
        return ()  # bad servos are reported, and make other causes meaningless
    candidates, physical = (
        list_difference_causes(published, robot),
        list_shared_causes(published, robot),
    )
    return _find_causes_by_removal(published, candidates, physical, test_model)


def _find_causes_by_removal(
    published: PublishedModel,
    candidates: list[CauseCandidate],
    physical: list[CauseCandidate],
    test_model: Callable[[mujoco.MjModel], float | None],
) -> tuple[Cause, ...]:
    """Find the causes of a failed simulation, by switching off candidates in copies of the model.

    Four groups are tested: numerical options, other candidates, all ``candidates``, and these with
    ``physical``. The causes belong to the first group with causes. With the causes switched off,
    the model passes the test. With all of the group switched off except one cause, it fails.

    Args:
        published: Published model: the user's file as compiled.
        candidates: Candidates from `list_difference_causes`.
        physical: Candidates from `list_shared_causes`, tested last.
        test_model: Function that returns the remaining deviation; None if a model fails the test.
    """

    @cache
    def deviation_without(removed: frozenset[CauseCandidate]) -> float | None:
        """Run ``test_model`` with candidates switched off; return its deviation or None."""
        model = copy.copy(published.model)
        for candidate in removed:
            candidate.switch_off(model)
        return test_model(model)

    numerics = [candidate for candidate in candidates if candidate.code in NUMERICS_CODES]
    rest = [candidate for candidate in candidates if candidate.code not in NUMERICS_CODES]
    for group in (numerics, rest, candidates, [*candidates, *physical]):
        if not group or deviation_without(frozenset(group)) is None:
            continue
        sound = next(
            group_of_all
            for group_of_all in (
                frozenset([*candidates, *physical]),
                frozenset(candidates),
                frozenset(group),
            )
            if group_of_all.issuperset(group) and deviation_without(group_of_all) is not None
        )
        breaking = [
            candidate
            for candidate in group
            if deviation_without(frozenset(group) - {candidate}) is None
            and deviation_without(sound - {candidate}) is None
        ]
        residual = deviation_without(frozenset(breaking)) if breaking else None
        if residual is not None:
            return tuple(candidate.make_cause(residual) for candidate in breaking)
    return ()
