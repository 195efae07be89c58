"""Add position servos to a robot whose MJCF has, for example, torque motors or no actuators.

Input is a robot with a stand; output is a robot with position servos at the independent joints,
whose positions do not follow from closed loops or couplings. Candidates of gains and time step are
tried in order, until the robot comes to rest in the predicted equilibrium (`add_position_servos`).
Independent joints of robots with closed loops get motors first, to fix the joint order.
"""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import replace
from typing import NamedTuple

import mujoco
import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import PupperAnalysisError
from pupper_analysis.base.progress import report_progress
from pupper_analysis.models.additions import (
    Addition,
    Options,
    Servo,
)
from pupper_analysis.models.attributes import BY_KIND, MIN_UNSTATED_LIMIT
from pupper_analysis.models.efforts import EffortCode
from pupper_analysis.models.mjcf import JointKind
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.spec_tree import SpecTree
from pupper_analysis.models.transmission import Drive, MadeServo, classify_joint_drive
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml import to_text
from pupper_analysis.prepare import notes, start
from pupper_analysis.prepare.notes import describe_spans
from pupper_analysis.prepare.own_run import settles_in_place
from pupper_analysis.prepare.published_model import compile_published_model
from pupper_analysis.prepare.servo_tuning import (
    TIMESTEP_DIVISORS,
    suggest_fixed_base_gains,
    suggest_standing_gains,
)
from pupper_analysis.robot.build import rebuild_robot
from pupper_analysis.robot.joints import get_joint_units
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import list_position_servos
from pupper_analysis.simulation.settling import calms_after_base_nudges, comes_to_rest
from pupper_analysis.simulation.verify import (
    MAX_BALANCE_RESIDUAL_RATIO,
    StandVerification,
    verify_stand,
)
from pupper_analysis.stance.soft_ground import solve_stand_on_soft_ground
from pupper_analysis.stance.stand import Stand, stand_statics

_SAG_CANDIDATES = (0.02, 0.05, 0.1)
"""Permitted deflections [rad, m] of the most loaded joint in the nominal stand, in the order of the
trials. Stiffer servos hold the posture better, but may oscillate on soft contacts. With softer
servos a biped may tip over at the ankles. Chosen, not tuned.
"""

_LIGHT_DAMPING_FACTOR = 0.25
"""Factor [1] on the default damping of added servos in the trials with reduced damping. These
trials are needed since the time step bounds the damping of a light leg. Measured at 2 ms: a tripod
oscillates with kd = 130 N m s/rad, and not with 25.
"""

_LIGHT_SAG_CANDIDATES = (0.02, 0.035, 0.05)
"""Permitted deflections [rad, m] of the most loaded joint in the trials with reduced damping
(`_LIGHT_DAMPING_FACTOR`), in the order of the trials. Chosen, not tuned.
"""

_BRIEF_DURATION = 2.0
"""Duration [s] of the first simulation that tests if candidate gains lead to the predicted
equilibrium. Chosen, not tuned.
"""


def list_dependent_joints(robot: Robot) -> list[int]:
    """Return the indices (actuator order) of dependent joints, which need no servo.

    The position of a dependent joint follows from closed loops or couplings.
    """
    return [] if robot.closure is None else robot.closure.dependent_joints.tolist()


def add_loop_motors(robot: Robot) -> Robot:
    """Add missing torque motors at independent joints, if there are closed loops or couplings.

    Reason: in the actuator order, joints with motors come first. With the motors, the order does
    not change when servos are added after stands have been solved.
    """
    lacking = set(np.flatnonzero(robot.mj_convention.actuator_index < 0)) - set(
        list_dependent_joints(robot)
    )
    if robot.closure is None or not lacking:
        return robot
    spec = robot.description.mjcf.copy()
    for joint in sorted(lacking):
        SpecTree(spec).add_motor(robot.joint_names[joint])
    return rebuild_robot(robot, mjcf=spec)


class _ServoCandidate(NamedTuple):
    """Gains and time step that are tried for a robot with added servos.

    Attributes:
        divisor: Number by which the time step of the file is divided.
        kp: Stiffness of all servos, shape (nu,) [N m/rad, N/m].
        kd: Damping of all servos, shape (nu,) [N m s/rad, N s/m].
    """

    divisor: int
    kp: Array
    kd: Array


class AddedServos(NamedTuple):
    """Robot with added servos, and a measure of how well the servos hold the stand.

    Attributes:
        robot: Robot with servos.
        kp: Stiffness of all servos, zero for dependent joints, shape (nu,) [N m/rad, N/m].
        kd: Damping of all servos, zero for dependent joints, shape (nu,) [N m s/rad, N s/m].
        num_rest_modes: Number of command modes in which the robot comes to rest in a simulation. 2:
            with and without feed-forward torques. 1: only with feed-forward. 0: no tried gains let
            the robot come to rest with feed-forward.
    """

    robot: Robot
    kp: Array
    kd: Array
    num_rest_modes: int


def add_position_servos(robot: Robot, stand: Stand, original: MjcfFile) -> AddedServos:
    """Add position servos to independent joints without a servo, with gains that hold a stand.

    Candidates of gains and time step are tried in order. A good candidate brings the robot to rest
    in the predicted equilibrium, with feed-forward torques and with position commands alone, and
    the motion after nudges of the base decays. The published MJCF should come to rest, too. If no
    candidate meets all conditions, a candidate that meets some of them is preferred.
    """
    trials = _ServoTrials(robot, stand, original)
    file = None if original.of_urdf else compile_published_model(original, robot)
    resting = chattering = None
    good: _ServoCandidate | None = None

    def is_wanted(candidate: _ServoCandidate) -> bool:
        """Return False for a reduced time step if gains for the time step of the file exist."""
        return good is None or candidate.divisor == 1

    for candidate in trials.find_resting_candidates(False, True, is_wanted=is_wanted):
        resting = resting or candidate
        if not trials.agrees_with_prediction(candidate):
            continue
        if not trials.calms_down(candidate):
            chattering = chattering or candidate
            continue
        good = good or candidate
        made = _build_with_servos(robot, candidate)
        _, kp, kd = candidate
        if candidate.divisor > 1 or file is None:
            return AddedServos(made, kp, kd, 2)
        if settles_in_place(file, _record_added_servos(made, kp, kd, original), stand.qpos):
            return AddedServos(made, kp, kd, 2)
    fed = None if resting else trials.choose_calm_candidate()
    chosen = good or chattering or resting or fed or trials.candidates[0]
    made = _build_with_servos(robot, chosen)
    return AddedServos(made, chosen.kp, chosen.kd, 2 if resting else int(fed is not None))


def _list_candidates(robot: Robot, stand: Stand, *, of_urdf: bool) -> list[_ServoCandidate]:
    """Return the candidates of gains and time step, in the order in which they are tried."""
    own_gains = list_position_servos(robot)
    torques = stand_statics(robot, stand).joint_torques
    usual = list(itertools.product(TIMESTEP_DIVISORS, _SAG_CANDIDATES, (1.0,)))
    light = itertools.product(
        TIMESTEP_DIVISORS[:1], _LIGHT_SAG_CANDIDATES, (_LIGHT_DAMPING_FACTOR,)
    )
    num_undivided = len(_SAG_CANDIDATES)
    candidates = []
    for divisor, sag, damping_factor in [
        *usual[:num_undivided],
        *([] if of_urdf else light),
        *usual[num_undivided:],
    ]:
        gains = suggest_standing_gains(robot, stand, torques, sag, divisor, damping_factor)
        candidates.append(_ServoCandidate(divisor, *_merge_gains(robot, own_gains, *gains)))
    return candidates


def _build_with_servos(robot: Robot, candidate: _ServoCandidate) -> Robot:
    """Add position servos with the gains and time step of a candidate; return the robot."""
    divisor, kp, kd = candidate
    timestep = float(robot.description.mjcf.option.timestep) / divisor
    given = robot.description.with_additions(*make_missing_servos(robot, kp, kd, timestep))
    efforts = {limit.joint: limit for limit in robot.efforts}
    return rebuild_robot(robot, mjcf=given.mjcf, added=given.added, efforts=efforts)


class _ServoTrials:
    """Simulations of a robot in a stand with candidate gains of added servos.

    Attributes:
        candidates: Gains and time steps, in the order of the trials.
    """

    def __init__(self, robot: Robot, stand: Stand, original: MjcfFile) -> None:
        self.candidates = _list_candidates(robot, stand, of_urdf=original.of_urdf)
        self._stand, self._has_urdf_alone = stand, original.of_urdf
        self._timestep = float(robot.mj_model.opt.timestep)
        _, kp, kd = self.candidates[0]
        description = robot.description.with_additions(
            *make_missing_servos(robot, kp, kd, self._timestep)
        )
        efforts = {limit.joint: limit for limit in robot.efforts}
        self._robot = rebuild_robot(robot, mjcf=description.mjcf, efforts=efforts)
        self._results: dict[tuple[int, bool], bool] = {}
        self._chattering_divisors: set[int] = set()

    def find_resting_candidates(
        self,
        *feedforward: bool,
        is_wanted: Callable[[_ServoCandidate], bool] | None = None,
    ) -> Iterator[_ServoCandidate]:
        """Yield the candidates with which a simulated robot comes to rest in the stand.

        The robot must come to rest for each value of ``feedforward``: with (True) or without
        (False) feed-forward torques. Candidates for which ``is_wanted`` returns False are skipped.
        For a URDF alone, time steps at which a candidate chattered are skipped, too. The robot gets
        the time step of the candidate.
        """
        for number, candidate in enumerate(self.candidates):
            report_progress("servos", number, len(self.candidates))
            if self._has_urdf_alone and candidate.divisor in self._chattering_divisors:
                continue
            if is_wanted is not None and not is_wanted(candidate):
                continue
            # Without feed-forward first: most bad candidates then fall within seconds.
            if all(self._comes_to_rest(number, fed=fed) for fed in sorted(feedforward)):
                yield candidate

    def _comes_to_rest(self, number: int, *, fed: bool) -> bool:
        """Simulate candidate ``number`` in the stand; return True if the robot comes to rest.

        ``fed``: with feed-forward torques. The result is cached.
        """
        divisor, kp, kd = self.candidates[number]
        self._robot.mj_model.opt.timestep = self._timestep / divisor
        if (number, fed) not in self._results:
            self._results[number, fed] = comes_to_rest(
                self._robot, self._stand, feedforward=fed, kp=kp, kd=kd
            )
        return self._results[number, fed]

    def agrees_with_prediction(self, candidate: _ServoCandidate) -> bool:
        """Return True if a candidate leads to the predicted equilibrium in a simulation.

        The result is also True if URDF and MJCF describe different robots. The time step is that of
        the candidate that `find_resting_candidates` yielded last.
        """
        return _is_as_predicted(self._robot, self._stand, candidate.kp, candidate.kd)

    def calms_down(self, candidate: _ServoCandidate) -> bool:
        """Return True if the motion after nudges of the base decays, with the gains of a candidate.

        The time-step divisor of a candidate that chatters is recorded. The time step is that of the
        candidate that `find_resting_candidates` yielded last.
        """
        _, kp, kd = candidate
        is_calm = calms_after_base_nudges(self._robot, self._stand, kp=kp, kd=kd)
        if not is_calm:
            self._chattering_divisors.add(candidate.divisor)
        return is_calm

    def choose_calm_candidate(self) -> _ServoCandidate | None:
        """Choose a candidate with which the robot comes to rest with feed-forward torques.

        A candidate with which the motion after nudges decays is preferred. None if the robot comes
        to rest with no candidate.
        """
        first = None
        for candidate in self.find_resting_candidates(True):
            if self.calms_down(candidate):
                return candidate
            first = first or candidate
        return first


def add_suggested_servos(robot: Robot, mjcf: MjcfFile) -> tuple[Robot, list[Diagnostic]]:
    """Add position servos with suggested gains at the joints without a servo, for a robot on feet.

    The gains are chosen so that the robot comes to rest in the nominal stand (the default
    `StandTask`), if possible. The time step may be reduced. Dependent joints (of closed loops and
    couplings) get no servo. Passive joints, which have no motor, get servos without torque.

    Returns:
        Robot with servos, and notes on added servos and passive joints.
    """
    robot = mark_passive_joints(robot, mjcf)
    made, messages = _add_servos_of_stand(_remove_zero_limits(robot), mjcf)
    return _restore_zero_limits(made, robot), [*notes.report_passive_joints(robot), *messages]


def mark_passive_joints(robot: Robot, mjcf: MjcfFile) -> Robot:
    """Detect passive joints, which no motor drives; list them in the robot's description.

    A passive joint has an effort limit of zero, and no actuator in an MJCF with other actuators.
    The list is `Description.passive_joints`.
    """
    model, dependent = mjcf.model, list_dependent_joints(robot)
    if mjcf.of_urdf or not model.nactuator:
        return robot
    passive = []
    for index, limit in enumerate(robot.efforts):
        name = robot.joint_names[index]
        joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
        is_driven = joint < 0 or classify_joint_drive(model, joint) is not Drive.NONE
        if limit.code is EffortCode.ZERO and not is_driven and index not in dependent:
            passive.append(name)
    if not passive:
        return robot
    return replace(robot, description=replace(robot.description, passive_joints=tuple(passive)))


def _remove_zero_limits(robot: Robot) -> Robot:
    """Return a robot whose torque limits of zero or below are changed to "unknown".

    The choice of servo gains must not depend on such limits. Passive joints keep their limits.
    """
    passive = robot.description.passive_joints
    null = [
        limit.joint
        for limit in robot.efforts
        if limit.without_torque and limit.joint not in passive
    ]
    if not null:
        return robot
    urdf = UrdfTree.of(robot.description.urdf)
    for name in null:
        urdf.joints[name].set_parameter(BY_KIND["effort"], MIN_UNSTATED_LIMIT)
    return rebuild_robot(robot, urdf=to_text(urdf.root), null_efforts={})


def _restore_zero_limits(made: Robot, robot: Robot) -> Robot:
    """Return the robot with servos, ``made``, with the torque limits of ``robot`` again."""
    if not any(limit.without_torque for limit in robot.efforts):
        return made
    return rebuild_robot(
        made,
        urdf=robot.description.urdf,
        efforts={limit.joint: limit for limit in robot.efforts},
        null_efforts=robot.description.null_efforts,
    )


def _add_servos_of_stand(robot: Robot, mjcf: MjcfFile) -> tuple[Robot, list[Diagnostic]]:
    """Add position servos with suggested gains to a robot, and return notes about the servos.

    The gains hold the nominal stand (default `StandTask`), if possible.
    """
    stand = start.solve_nominal_stand(robot)
    if stand is None:
        return add_fixed_base_servos(robot, mjcf)
    added = add_position_servos(robot, stand, mjcf)
    made, messages = _report_added_servos(robot, added.robot, mjcf, added.kp, added.kd)
    if not added.num_rest_modes:
        messages.append(diagnose("no-servos-bring-it-to-rest"))
    elif added.num_rest_modes == 1:
        messages.append(diagnose("rests-with-feed-forward-alone"))
    return made, messages


def list_fixed_base_gains(robot: Robot) -> tuple[Array, Array]:
    """Compute suggested servo gains for a robot without a stand, such as an arm with a fixed base.

    Returns:
        kp, shape (nu,) [N m/rad, N/m]; kd, shape (nu,) [N m s/rad, N s/m]. Both are in actuator
        order.
    """
    model = robot.mj_model
    ids = np.array([model.joint(name).id for name in robot.joint_names])
    joints_with_gains = np.flatnonzero(model.jnt_type != JointKind.FREE)  # joints with gains
    order = np.searchsorted(joints_with_gains, ids)
    kp, kd = suggest_fixed_base_gains(model)
    return kp[order], kd[order]


def add_fixed_base_servos(robot: Robot, mjcf: MjcfFile) -> tuple[Robot, list[Diagnostic]]:
    """Add position servos to a robot without a stand, at independent joints without a servo.

    The gains are computed by `list_fixed_base_gains`, which regards the base as fixed. Passive
    joints, which have no motor, get servos without torque.

    Returns:
        Robot with the servos; notes on added servos and passive joints.
    """
    robot = mark_passive_joints(robot, mjcf)
    made, messages = _add_servos_of_fixed_base(_remove_zero_limits(robot), mjcf)
    return _restore_zero_limits(made, robot), [*notes.report_passive_joints(robot), *messages]


def _add_servos_of_fixed_base(robot: Robot, mjcf: MjcfFile) -> tuple[Robot, list[Diagnostic]]:
    """Add position servos to a robot without a stand; return the robot, and notes on servos."""
    kp, kd = list_fixed_base_gains(robot)
    timestep = float(robot.mj_model.opt.timestep)
    given = robot.description.with_additions(*make_missing_servos(robot, kp, kd, timestep))
    stated = {limit.joint: limit for limit in robot.efforts}
    built = rebuild_robot(robot, mjcf=given.mjcf, added=given.added, efforts=stated)
    return _report_added_servos(robot, built, mjcf, kp, kd)


def _report_added_servos(
    robot: Robot, built: Robot, mjcf: MjcfFile, kp: Array, kd: Array
) -> tuple[Robot, list[Diagnostic]]:
    """List the added servos in the description of a robot, and create the notes about the servos.

    ``built`` is the robot with the servos. The gains of all servos are ``kp`` [N m/rad, N/m] and
    ``kd`` [N m s/rad, N s/m], shape (nu,) each.
    """
    recorded = _record_added_servos(built, kp, kd, mjcf)
    added = recorded.description.made_servos
    if not added:  # all are at passive joints, and exert no torque
        return recorded, []
    num_passive = len(robot.description.passive_joints)
    num_own = robot.nu - len(added) - num_passive - len(list_dependent_joints(robot))
    units = [get_joint_units(robot, servo.joint) for servo in added]
    timestep = built.mj_model.opt.timestep
    return recorded, [*notes.report_added_servos(added, num_own, timestep, units)]


def _record_added_servos(built: Robot, kp: Array, kd: Array, mjcf: MjcfFile) -> Robot:
    """Return a robot whose description lists the added servos with their gains.

    Servos at passive joints, which exert no torque, are not listed. The gains of all servos are
    ``kp`` [N m/rad, N/m] and ``kd`` [N m s/rad, N s/m], shape (nu,) each.
    """
    added = {addition.joint for addition in built.description.added if isinstance(addition, Servo)}
    added -= set(built.description.passive_joints)
    records = []
    for index, name in enumerate(built.joint_names):
        if name in added:
            joint = mujoco.mj_name2id(mjcf.model, mujoco.mjtObj.mjOBJ_JOINT, name)
            drive = Drive.NONE if joint < 0 else classify_joint_drive(mjcf.model, joint)
            records.append(MadeServo(name, float(kp[index]), float(kd[index]), drive))
    described = replace(built.description, made_servos=tuple(records))
    return replace(built, description=described)


def _merge_gains(
    robot: Robot, own_gains: Mapping[str, tuple[float, float]], kp: Array, kd: Array
) -> tuple[Array, Array]:
    """Combine the gains of the MJCF's servos with suggested gains; return kp and kd, (nu,) each.

    ``own_gains`` is {joint: (kp, kd)} of the MJCF's servos. The gains of dependent joints are 0.
    """
    gains = zip(robot.joint_names, kp.tolist(), kd.tolist(), strict=True)
    merged = np.array(
        [own_gains.get(name, (stiffness, damping)) for name, stiffness, damping in gains]
    )
    merged[list_dependent_joints(robot)] = 0.0
    return merged[:, 0], merged[:, 1]


def _is_as_predicted(robot: Robot, stand: Stand, kp: Array, kd: Array) -> bool:
    """Return True if servo gains lead to the predicted equilibrium of a stand in a simulation.

    The result is also True if URDF and MJCF describe different robots, since no gains help then.
    ``kp`` [N m/rad, N/m] and ``kd`` [N m s/rad, N s/m] have shape (nu,).
    """
    with contextlib.suppress(PupperAnalysisError):
        stand = solve_stand_on_soft_ground(robot, stand, explain=False)
    brief = verify_stand(robot, stand, kp=kp, kd=kd, duration=_BRIEF_DURATION, nudged=0.0)
    if brief.passed or _are_different_robots(robot, brief):
        return True
    return verify_stand(robot, stand, kp=kp, kd=kd, until_failure=True).passed


def _are_different_robots(robot: Robot, verification: StandVerification) -> bool:
    """Return True if URDF and MJCF describe different robots, by the statics of a stand.

    MuJoCo's unbalanced generalised force in the stand is then large.
    """
    weight = robot.usual_weight
    return verification.mujoco_residual > MAX_BALANCE_RESIDUAL_RATIO * weight


def make_missing_servos(
    robot: Robot,
    kp: Array,
    kd: Array,
    timestep: float,
    own: Collection[str] | None = None,
) -> list[Addition]:
    """Create the position servos that an MJCF lacks, and the options that the servos need.

    Dependent joints of closed loops and couplings get no servo. The integrator becomes
    ``implicitfast``, since explicit damping makes light joints oscillate.

    Args:
        robot: Robot.
        kp: Stiffness, shape (nu,) [N m/rad, N/m]; ignored at joints with a servo.
        kd: Damping, shape (nu,) [N m s/rad, N s/m]; ignored at joints with a servo.
        timestep: Time step of the robot with servos [s].
        own: Names of the joints that have a servo; None: joints with a servo in the robot model.
    """
    dependent = {robot.joint_names[joint] for joint in list_dependent_joints(robot)}
    excluded = {*(list_position_servos(robot) if own is None else own), *dependent}
    missing = [index for index, name in enumerate(robot.joint_names) if name not in excluded]
    units = [get_joint_units(robot, robot.joint_names[index]) for index in missing]
    message = diagnose(
        "servos-made",
        kp=describe_spans(kp[missing].tolist(), [unit.stiffness for unit in units]),
        kd=describe_spans(kd[missing].tolist(), [unit.damping for unit in units]),
        timestep=Quantity(timestep, "s"),
    )
    additions: list[Addition] = [
        Options(message, {"integrator": "implicitfast", "timestep": timestep}),
    ]
    for index in missing:
        limit = robot.efforts[index]
        # A range from 0 to 0 does not compile; the simulation applies it to the compiled model.
        bounded = math.isfinite(limit.lower) and limit.lower < limit.upper < math.inf
        limits = (limit.lower, limit.upper) if bounded else None
        name = robot.joint_names[index]
        additions.append(Servo(message, name, float(kp[index]), float(kd[index]), limits))
    return additions
