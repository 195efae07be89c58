"""What a robot's file does as it was published, against what is computed of it.

From the stand that was computed, held there. Made when a verdict is first asked for, as is what
the file does by itself (``own_run``).
"""

from __future__ import annotations

import contextlib
import copy
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.errors import ModelError, PupperAnalysisError
from pupper_analysis.models.transmission import Drive
from pupper_analysis.prepare.causes import (
    COMMAND_CODES,
    NUMERICS_CODES,
    CauseCandidate,
    add_line,
    list_candidate_causes,
    list_loading_changes,
    list_physical_causes,
    list_soft_servos,
)
from pupper_analysis.prepare.own_run import (
    as_loaded,
    get_published_model,
    own_run,
    simulate_model_from_keyframe,
)
from pupper_analysis.prepare.published_model import (
    PublishedModel,
    compute_hold_commands,
    find_self_controlled_joints,
    has_few_servos,
    place_fixed_base,
    place_published,
    simulate_published,
    with_requested_gains,
    with_unstated_options,
)
from pupper_analysis.robot.as_published import (
    MIN_POSTURE_DEVIATION,
    Cause,
    OwnCommands,
    OwnRun,
    Published,
    PublishedRun,
    ServoSource,
    ServosUsed,
)
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.fall import InitialHeight, measure_motion, nudge_velocity
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import list_position_servos, resolve_servo_gains
from pupper_analysis.simulation.verify import JOINT_TOLERANCE, dry_friction, torque_scale
from pupper_analysis.stance.sag.steady_state import steady_state
from pupper_analysis.stance.soft_ground import solve_stand_on_soft_ground
from pupper_analysis.stance.stand import Stand, solve_stand, stand_statics
from pupper_analysis.statics.equilibrium import gravity_compensation

Array = NDArray[np.float64]

SETTLING_TIME = 1.0
"""Of the run from the computed stand before it is nudged (s): servos of some hertz have come to
rest, and what slides has slid."""

NUDGED_TIME = 4.0
"""Of it after the nudge (s), which is forgotten by then or never."""

TORQUE_RTOL = 0.01
"""Share of the largest torque within which the file does as predicted: a verified stand's."""

MAX_REMAINING_SINKAGE = 1e-3
"""By which feet may sink otherwise in what is mended (m)."""

HEIGHT_RTOL = 1e-3
"""Share of its height within which the base is where it is predicted (v3: 0.13 mm)."""


def compare_as_published(
    robot: Robot,
    stand: Stand,
    servos: ServosUsed,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
) -> Published | None:
    """Compare the published file with the prediction for a stand.

    The nominal stand of the robot as loaded is compared instead if the robot was changed since, or
    if the ground is not level. If the caller passed gains, the published model gets these gains.

    Args:
        robot: Prepared robot.
        stand: Stand.
        servos: Servos on which the verdict rests.
        kp: Requested servo stiffness [N m/rad], one or (nu,); None: that of the model.
        kd: Requested servo damping [N m s/rad], one or (nu,); None: that of the model.

    Returns:
        Comparison. None if the robot has no file, or if the file is what is simulated. See
        ``_compare_in`` for further cases.
    """
    if robot.published is None or robot.published.as_prepared:
        return None
    gains = (kp, kd) if servos.source is ServoSource.GIVEN else None
    loaded = as_loaded(robot)
    if not (loaded.floating or stand.stance_feet):  # in a posture
        return _compare_in(loaded, stand, gains)
    if robot.published.loaded is not None or robot.welds or not stand.task.ground.level:
        if gains is None:
            return loaded.once(compare_nominal_stand)
        return _compare_nominal(loaded, gains)
    return _compare_in(robot, stand, gains)


RequestedGains = tuple[ArrayLike | None, ArrayLike | None]
"""Servo stiffness kp [N m/rad] and damping kd [N m s/rad] that the caller passed."""


def compare_nominal_stand(robot: Robot) -> Published | None:
    """Compare the published file with the nominal stand; None without a nominal stand."""
    return _compare_nominal(robot, None)


def _compare_nominal(robot: Robot, gains: RequestedGains | None) -> Published | None:
    """Compare the published file with the nominal stand; None without a nominal stand."""
    with contextlib.suppress(PupperAnalysisError):
        return _compare_in(robot, solve_stand(robot, explain=False), gains)
    return None


def _compare_in(robot: Robot, stand: Stand, gains: RequestedGains | None) -> Published | None:
    """Compare the published file with the prediction for a stand, with the causes of differences.

    Returns:
        Comparison. None if nothing is predicted for the stand, if MuJoCo refuses the URDF, or if
        the file frees a base that the robot has fixed.
    """
    if robot.published is None or (robot.floating and not robot.feet):
        return None
    model = robot.once(get_published_model)
    if model is None and (robot.published.file is None or not robot.floating):
        return None
    published = (
        None if model is None else with_unstated_options(PublishedModel.of(model, robot), robot)
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
    """Returns causes with the lines where they stand in a robot's MJCF, if it has one."""
    file = None if robot.published is None else robot.published.file
    return tuple(cause if file is None else add_line(cause, file) for cause in causes)


def compare_with_file(
    published: PublishedModel, robot: Robot, wanted: Sequence[PredictedRest]
) -> Published:
    """Simulates the MJCF as it was published from where it is predicted to rest."""
    if controlled := find_self_controlled_joints(published, robot):
        return Published((), (Cause("other-drive", controlled),), differs=True)
    if published.floating and published.ground_height is None:
        return Published((), (Cause("ground", ()),), differs=True)
    found = [(one, simulate_prediction(published, robot, one)) for one in wanted]
    runs = tuple(run for _, run in found if run is not None)
    off = [(one, run) for one, run in found if run is not None and run.differs]
    causes: tuple[Cause, ...] = ()
    if off:
        causes = find_difference_causes(published, robot, *off[0]) or _of_loading(
            published, robot, *off[0]
        )
    return Published(runs, causes, differs=bool(off))


def _of_loading(
    published: PublishedModel, robot: Robot, wanted: PredictedRest, run: PublishedRun
) -> tuple[Cause, ...]:
    """Returns what was altered on loading, or in what the two files differ, if that is why.

    What was altered is if what is computed of the MJCF does as predicted. The files are if that is
    as far off the prediction, which is the URDF's, as the MJCF is (or would be if what is computed
    without were taken out of it), and ``crosscheck`` finds a difference that a body's weight or
    place feels, or a part that one of them lacks.
    """
    file = None if robot.published is None else robot.published.file
    computed = simulate_prediction(
        PublishedModel.of(copy.copy(robot.mj_model), robot), robot, wanted
    )
    if computed is None:
        return ()
    if not computed.differs:
        return list_loading_changes(published, robot)
    if file is None or robot.description.converted:
        return ()
    model = copy.copy(published.model)
    for candidate in list_candidate_causes(published, robot):
        candidate.switch_off(model)
    stripped = simulate_prediction(replace(published, model=model), robot, wanted)
    alike = (one for one in (run, stripped) if one is not None)
    if not any(abs(computed.torque_error - one.torque_error) <= TORQUE_RTOL for one in alike):
        return ()
    # Forty modules, which hardly a verdict needs.
    from pupper_analysis.robot.compare.compare import compare_files

    with contextlib.suppress(PupperAnalysisError):
        found = compare_files(robot.description.urdf_source, file.path).result
        felt = [one.diagnostic for one in found.differences if one.weight[0] > 0]
        felt += found.parts
        if felt:
            return (Cause("pair", (), difference=felt[0]),)
    return ()


@dataclass(frozen=True, eq=False)
class PredictedRest:
    """What a stand is predicted to be at rest.

    Attributes:
        feedforward: Whether its servos are given its torques, too.
        qpos: (nq,) where it rests, sunk into the ground.
        torques: (nu,) N m.
        targets: (nu,) the positions that are commanded (rad).
    """

    feedforward: bool
    qpos: Array
    torques: Array
    targets: Array


def predict_stand(robot: Robot, stand: Stand) -> list[PredictedRest]:
    """Returns what is predicted of a stand, with feed-forward and on position commands alone.

    Of a posture with feed-forward.
    """
    if not robot.floating:
        joints = stand.qpos[-robot.nu :]
        torques = gravity_compensation(Configuration(robot, joints), contacts=()).joint_torques
        return [PredictedRest(True, joints, torques, joints)]
    try:
        held = solve_stand_on_soft_ground(robot, stand, explain=False)
    except PupperAnalysisError:
        return []  # where it comes to rest is not predicted
    torques = stand_statics(robot, held).joint_torques
    found = [PredictedRest(True, held.qpos, torques, held.joint_positions(robot))]
    made = robot.description.made_servos
    replaced = any(servo.instead_of is Drive.SERVO for servo in made)
    if len(list_position_servos(robot)) < robot.nu or replaced:
        return found  # it sags otherwise on its own than on those that were added
    with contextlib.suppress(PupperAnalysisError):
        # Feet that are predicted pinned creep, by fractions of a millimetre, to where these are.
        rest = steady_state(robot, held, feet="sliding")
        if not rest.failures:
            targets = held.joint_positions(robot)
            found.append(PredictedRest(False, rest.qpos, rest.joint_torques, targets))
    return found


def simulate_prediction(
    published: PublishedModel, robot: Robot, wanted: PredictedRest
) -> PublishedRun | None:
    """Simulates the MJCF from where it is predicted to rest, and compares.

    Returns:
        What comes of it; None if its base cannot be put there, as where it is held in the world.
    """
    model = published.model
    qpos = wanted.qpos
    place = place_published if robot.floating else place_fixed_base
    data = place(published, robot, qpos)
    if data is None:
        return None
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    start = copy.copy(data)
    ahead = wanted.torques if wanted.feedforward else None
    hold = compute_hold_commands(published, robot, data, ahead, wanted.targets)
    try:
        simulate_published(published, data, hold, SETTLING_TIME)
        data.qvel[:] += nudge_velocity(model)
        low, high = simulate_published(published, data, hold, NUDGED_TIME)
    except mujoco.FatalError:  # a contact of shapes without directions, say
        return None
    joints = [model.joint(name).id for name in robot.joint_names]
    dofs, places = model.jnt_dofadr[joints], model.jnt_qposadr[joints]
    driven = robot.mj_convention.actuator_index >= 0
    off = np.maximum(high[dofs] - wanted.torques, wanted.torques - low[dofs])[driven]
    moved, sticks = np.abs(data.qpos[places] - qpos[-robot.nu :]), np.zeros(robot.nu)
    error, collapses, alike = None, not float(moved.max()) <= MIN_POSTURE_DEVIATION, True
    if robot.floating:
        com = float(start.subtree_com[published.base_body][2])
        predicted = InitialHeight(com, 0.0, published.ground_height or 0.0)
        motion = measure_motion(
            model, start, data, published.base_body, SETTLING_TIME + NUDGED_TIME, predicted
        )
        error, collapses = motion.end_height - motion.height, motion.collapses
        alike = abs(error) <= HEIGHT_RTOL * motion.height
    else:  # where it may stick after a nudge
        with contextlib.suppress(ModelError):
            sticks = resolve_servo_gains(robot).kp
        rubbing, sticks = dry_friction(robot, sticks)
        off = np.maximum(off - rubbing[driven], 0.0)
    torque = float(off.max(initial=0.0)) / torque_scale(robot, wanted.torques)
    joint = float(moved.max())
    alike = alike and (not wanted.feedforward or joint <= JOINT_TOLERANCE + float(sticks.max()))
    return PublishedRun(
        feedforward=wanted.feedforward,
        duration=SETTLING_TIME + NUDGED_TIME,
        torque_error=torque,
        height_error=error,
        joint_error=joint,
        collapses=collapses,
        differs=collapses or not (alike and torque <= TORQUE_RTOL),
        imported=robot.published is not None and robot.published.imported is not None,
        worst_joint=_worst_joint(robot, moved, off, collapses=collapses),
    )


def _worst_joint(robot: Robot, moved: Array, torque_error: Array, *, collapses: bool) -> str:
    """Return the name of the joint that deviates most.

    Args:
        robot: Prepared robot.
        moved: Displacement of each joint, shape (nu,) [rad, m].
        torque_error: Torque deviation of each driven joint, shape (n,) [N m].
        collapses: Whether the displacement counts, and not the torque.
    """
    names = np.array(robot.joint_names)
    if collapses or not torque_error.size:
        return str(names[int(np.argmax(moved))])
    return str(names[robot.mj_convention.actuator_index >= 0][int(np.argmax(torque_error))])


def explain_own_run(robot: Robot) -> OwnRun | None:
    """Returns what a robot's file does by itself, and if it fails by what; made once."""
    return as_loaded(robot).once(_own_run_explained)


def _own_run_explained(robot: Robot) -> OwnRun | None:
    """Compute the run of the unmodified file, with a named cause if it fails."""
    run = own_run(robot)
    model = robot.once(get_published_model)
    if run is None or not run.fails or model is None:
        return run
    published = PublishedModel.of(model, robot)
    if any(drive.bad for drive in published.drives):
        return run  # the bad servos are reported, and make other causes meaningless
    causes = list_command_causes(run, published) or _find_causes(run, published, robot)
    return replace(run, causes=add_lines(causes, robot))


def list_command_causes(run: OwnRun, published: PublishedModel) -> tuple[Cause, ...]:
    """Return the causes that are in the commands of the keyframe.

    These are a missing ctrl, if the robot stands with the joint angles as commands, and joint
    angles as ctrl of torque motors.
    """
    if run.commands is OwnCommands.ABSENT and run.held is not None and not run.held.falls:
        return (Cause("ctrl-absent", (run.keyframe,)),)
    if run.commands is OwnCommands.STATED and has_few_servos(published):
        return (Cause("angles-to-motors", (run.keyframe,)),)
    return ()


def name_remaining_cause(
    robot: Robot, own: OwnRun | None, published: Published | None
) -> tuple[OwnRun | None, Published | None]:
    """Name a cause of a failure that no other finding explains.

    Of the run from the keyframe this is too soft a servo, if the robot stands with stiffer ones.
    Otherwise it is the joint that deviates most.

    Args:
        robot: Prepared robot.
        own: Run of the unmodified file.
        published: Comparison with the published file.

    Returns:
        Both, the failing one with a cause.
    """
    if own is not None and own.fails:
        return replace(own, causes=robot.once(_too_soft) or _deviating_joint(own)), published
    run = None if published is None else published.worst
    if published is None or run is None or run.close:
        return own, published
    return own, replace(published, causes=(Cause("gives-way", (run.worst_joint,)),))


def _too_soft(robot: Robot) -> tuple[Cause, ...]:
    """Return the servos of the unmodified file as a cause, if it stands with stiffer ones."""
    loaded = as_loaded(robot)
    model = loaded.once(get_published_model)
    if model is None or not loaded.floating:
        return ()
    published = PublishedModel.of(model, loaded)
    for candidate in list_soft_servos(published, loaded):
        stiffer = copy.copy(model)
        candidate.switch_off(stiffer)
        run = simulate_model_from_keyframe(replace(published, model=stiffer), loaded)
        if run is not None and not run.fails:
            return add_lines([candidate.to_cause(0.0)], loaded)
    return ()


def _deviating_joint(run: OwnRun) -> tuple[Cause, ...]:
    """Return the joint that deviates most, and how."""
    joint = run.unheld or run.worst
    if joint is None:
        return (Cause("diverges", ()),)
    if run.unheld is not None:
        return (Cause("joint-unheld", (joint.joint,)),)
    if joint.drive.has_other_law:
        return (Cause("other-drive", (joint.joint,)),)
    return (Cause("ctrl-elsewhere" if joint.commanded_away else "gives-way", (joint.joint,)),)


def _find_causes(run: OwnRun, published: PublishedModel, robot: Robot) -> tuple[Cause, ...]:
    """Find what makes the run of the unmodified file fail, by changes of copies of the model."""
    model = published.model
    known, physics = list_candidate_causes(published, robot), list_physical_causes(published, robot)
    if run.unheld is not None or (run.worst is not None and run.worst.commanded_away):
        # Nothing holds a joint, or its ctrl is of another pose; on the way there any other change
        # may let it stand.
        known, physics = (
            [one for one in of if one.code in COMMAND_CODES] for of in (known, physics)
        )

    def tried(changed: mujoco.MjModel) -> float | None:
        # Another step alone may leave what falls on the other side of an edge, by chance.
        finer = changed.opt.timestep < model.opt.timestep
        for parts in (1, 2, 4) if finer else (1,):
            one = copy.copy(changed)
            one.opt.timestep /= parts
            again = simulate_model_from_keyframe(replace(published, model=one), robot)
            if again is None or again.fails:
                return None
        return 0.0

    return _tested_causes(published, known, physics, tried)


def find_difference_causes(
    published: PublishedModel, robot: Robot, wanted: PredictedRest, run: PublishedRun
) -> tuple[Cause, ...]:
    """Finds what makes the file differ, tested both ways."""

    def tried(model: mujoco.MjModel) -> float | None:
        again = simulate_prediction(replace(published, model=model), robot, wanted)
        if again is None or again.collapses:
            return None
        # Pyramids of more friction are stiffer ground: what is mended may sink by less.
        sunk = (
            abs(again.height_error or 0.0) <= MAX_REMAINING_SINKAGE
            and again.joint_error <= JOINT_TOLERANCE
        )
        mended = sunk and again.torque_error <= TORQUE_RTOL < run.torque_error
        return again.torque_error if mended or not again.differs else None

    if any(drive.bad for drive in published.drives):
        return ()  # that is told, and what makes it fall later is none
    known, physics = list_candidate_causes(published, robot), list_physical_causes(published, robot)
    return _tested_causes(published, known, physics, tried)


def _tested_causes(
    published: PublishedModel,
    known: list[CauseCandidate],
    physics: list[CauseCandidate],
    tried: Callable[[mujoco.MjModel], float | None],
) -> tuple[Cause, ...]:
    """Finds what is wrong with a file, tested both ways, in copies in which it is switched off.

    A cause is what, put alone into the sound file, breaks it; and with the causes alone taken out
    of the file, it must be mended. The sound file is the one with all switched off that may be, or
    with all but what its robot is computed with, too. How MuJoCo integrates and solves is tried
    first, and by itself; then the rest with that as it is; what is computed with comes last.

    Args:
        published: The file.
        known: What may be switched off.
        physics: What of it is computed with.
        tried: Returns what deviation is left of a model that is sound; None of another.
    """

    @cache
    def without(gone: frozenset[CauseCandidate]) -> float | None:
        model = copy.copy(published.model)
        for candidate in gone:
            candidate.switch_off(model)
        return tried(model)

    numerics = [one for one in known if one.code in NUMERICS_CODES]
    rest = [one for one in known if one.code not in NUMERICS_CODES]
    for group in (numerics, rest, known, [*known, *physics]):
        if not group or without(frozenset(group)) is None:
            continue
        sound = next(
            whole
            for whole in (frozenset([*known, *physics]), frozenset(known), frozenset(group))
            if whole.issuperset(group) and without(whole) is not None
        )
        breaking = [
            one
            for one in group
            if without(frozenset(group) - {one}) is None and without(sound - {one}) is None
        ]
        left = without(frozenset(breaking)) if breaking else None
        if left is not None:
            return tuple(one.to_cause(left) for one in breaking)
    return ()
