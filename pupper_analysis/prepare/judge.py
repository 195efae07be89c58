"""Form the verdict of a stand or posture from simulations, static limits and the published file.

Inputs are the statics, and the results of two simulations of the prepared robot: with feed-forward
torques, and with position commands alone. Output is a `Verdict`. The verdict also depends on
simulations of the published file (the user's MJCF or URDF). They start at a keyframe or the start
pose, and at the predicted equilibrium of the stand, with which the result is compared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, Term, contains_error, diagnose
from pupper_analysis.prepare.causes import TIE_CODES
from pupper_analysis.prepare.limits import (
    describe_loaded_passive_joints,
    describe_unknown_limits,
    describe_zero_torque_limits,
    list_overloaded_joints,
    loads_motor_without_torque,
    springs_replace_motors,
)
from pupper_analysis.prepare.notes import report_joints_without_actuator, report_tendon_joints
from pupper_analysis.prepare.own_run import (
    describe_import_failure,
    find_posture_keyframe,
    simulate_fixed_base,
)
from pupper_analysis.prepare.self_check import (
    compare_as_published,
    explain_own_run,
    name_remaining_cause,
    report_posture_ties,
    report_ties,
)
from pupper_analysis.robot.alike import report_limbs_without_feet
from pupper_analysis.robot.as_published import (
    MAX_POSTURE_DEVIATION,
    MIN_UNHELD_DISPLACEMENT,
    OwnCommands,
    OwnRun,
    ServoSource,
)
from pupper_analysis.robot.build import (
    compile_with_visuals,
    report_placeholder_efforts,
    report_placeholder_inertias,
)
from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.joints import joint_unit
from pupper_analysis.robot.masses import describe_missing_masses
from pupper_analysis.robot.robot import Robot, compute_added_mass, get_loaded_robot
from pupper_analysis.robot.servos import find_servos_used
from pupper_analysis.simulation.settling import LARGE_NUDGE_SPEED
from pupper_analysis.simulation.trial import (
    BASE_NUDGE_SPEED,
    NudgeTrial,
    is_near_limit,
    saturates_after_nudge,
    simulate_large_nudges,
    simulate_nudges,
)
from pupper_analysis.simulation.verdict import (
    LOAD_QUESTIONS,
    Outcome,
    Question,
    Verdict,
    find_overloaded_motors,
    judge_stance,
)
from pupper_analysis.simulation.verify import verify_stand
from pupper_analysis.stance.soft_ground import solve_stand_as_simulated
from pupper_analysis.stance.stand import Stand, stand_statics
from pupper_analysis.statics.equilibrium import GravityCompensation


def judge_simulation(
    robot: Robot,
    stand: Stand,
    fed: Outcome,
    alone: Outcome | None = None,
    *,
    statics: GravityCompensation | None = None,
    question: Question = Question.STANDS,
    trial: NudgeTrial | None = None,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
) -> Verdict:
    """Create the verdict of a simulated stand or posture: holds, fails or cannot be judged.

    The verdict combines the simulations of the caller, nudges (simulations in which the base has an
    initial velocity), and simulations of the published file, the user's unmodified MJCF or URDF.

    Args:
        robot: Robot.
        stand: Stand or posture.
        fed: Simulation with feed-forward torques; for a payload or a path an ``Outcome``.
        alone: Simulation with position commands alone; None if there is none.
        statics: Static motor torques; None if torque limits are not part of the question.
        question: Question that the verdict answers.
        trial: Result of ``simulate_nudges``; None to simulate these nudges here, if necessary.
            If larger nudges are necessary, these are simulated here in both cases.
        kp: Servo stiffness [N m/rad, N/m], scalar or (nu,); None: value of the model.
        kd: Servo damping [N m s/rad, N s/m], scalar or (nu,); None: value of the model.

    Raises:
        StaticsInfeasibleError: If the stand is nudged here, and slides or tips.
        NotSettlingError: If the stand is nudged here, and the penetration depths do not converge.
        ConfigurationError: If an argument is not valid for the robot.
        ModelError: If a joint has no motor, for example.
    """
    robot = stand.check(robot)
    servos, loaded = find_servos_used(robot, kp, kd), get_loaded_robot(robot)
    joints = stand.qpos[-robot.nu :]
    keyframe_run = (
        explain_own_run(robot) if loaded.floating else simulate_fixed_base(loaded, joints)
    )
    fed, alone, null = _add_failures(robot, stand, fed, alone, statics, trial, kp, kd)
    published = compare_as_published(robot, stand, servos, kp, kd)
    unknown = None if statics is None else describe_unknown_limits(robot, statics)
    masses = describe_missing_masses(robot)
    loaded_more = compute_added_mass(robot) > 0
    given = servos.source is ServoSource.GIVEN
    overloaded_motors = (
        ()
        if statics is None
        else _list_overloaded_joints(
            robot, statics, None if given else stand.joint_positions(robot)
        )
    )
    remarks = (
        *(remark for remark in (null, masses, unknown) if remark is not None),
        *_report_distant_command(keyframe_run),
        *_list_model_remarks(robot, stand, statics, given_gains=given),
    )
    causes = (
        *(() if keyframe_run is None else keyframe_run.causes),
        *(() if published is None else published.causes),
    )
    if not any(cause.code in TIE_CODES for cause in causes):
        remarks = (*_report_world_ties(robot, joints), *remarks)
    errors = contains_error(remarks)
    # With given gains, the run from the keyframe is information only.
    if fed.passed and not (errors or causes or overloaded_motors or servos.replacement_servos):
        named, published = name_remaining_cause(robot, None if given else keyframe_run, published)
        keyframe_run = keyframe_run if given else named
    return judge_stance(
        fed,
        alone,
        servos,
        question=question,
        overloaded_motors=overloaded_motors,
        keyframe_run=keyframe_run,
        published=published,
        converted=robot.description.converted,
        unknown=unknown is not None and (loaded_more or question in LOAD_QUESTIONS),
        masses_unknown=masses is not None,
        remarks=remarks,
    )


def _add_failures(
    robot: Robot,
    stand: Stand,
    fed: Outcome,
    alone: Outcome | None,
    statics: GravityCompensation | None,
    trial: NudgeTrial | None,
    kp: ArrayLike | None,
    kd: ArrayLike | None,
) -> tuple[Outcome, Outcome | None, Diagnostic | None]:
    """Add failures of a stand that its simulations do not contain.

    These are failures after a nudge, by feet without friction, by a keyframe that violates
    constraints, and by motors with a torque limit of zero. If the simulation ``fed`` fails, loaded
    joints without motor are added as a possible cause.

    Returns:
        Both simulations, and the message of `_apply_zero_torque_limits`.
    """
    loaded, joints = get_loaded_robot(robot), stand.qpos[-robot.nu :]
    if statics is not None and fed.passed:
        fragile = alone is not None and not alone.passed
        fed = _fail_if_upset(robot, stand, fed, statics, trial, kp, kd, fragile=fragile)
    if (slippery := describe_frictionless_feet(robot, stand.stance_feet)) is not None:
        fed = replace(fed, passed=False, stays=False, failures=(slippery, *fed.failures))
    if not loaded.floating and (moved := describe_violated_keyframe(loaded, joints)) is not None:
        fed = replace(fed, passed=False, failures=(moved, *fed.failures))
    fed, alone, null = _apply_zero_torque_limits(robot, fed, alone, statics)
    if statics is not None and not fed.passed:
        strained = describe_loaded_passive_joints(robot, statics)
        if strained is not None:
            fed = replace(fed, failures=(*fed.failures, strained))
    return fed, alone, null


def _apply_zero_torque_limits(
    robot: Robot, fed: Outcome, alone: Outcome | None, statics: GravityCompensation | None
) -> tuple[Outcome, Outcome | None, Diagnostic | None]:
    """Add failures by motors with a torque limit of zero to two simulations of a stand.

    Returns:
        Both simulations, and the message about the motors. The message is None without such motors,
        or if ``fed`` contains the message.
    """
    null = describe_zero_torque_limits(robot)
    if null is None:
        return fed, alone, None
    if statics is None or loads_motor_without_torque(robot, statics):
        springs = statics is not None and springs_replace_motors(robot, statics)
        fed = _fail_without_torque(fed, null, springs=springs)
        alone = None if alone is None else _fail_without_torque(alone, null, springs=springs)
        return fed, alone, None
    if fed.passed:
        return fed, alone, null
    joints = null.values["joints"]
    is_cause = isinstance(joints, tuple) and 2 * len(joints) > robot.nu
    failures = (null, *fed.failures) if is_cause else (*fed.failures, null)
    return replace(fed, failures=failures), alone, None


def _list_model_remarks(
    robot: Robot, stand: Stand, statics: GravityCompensation | None, *, given_gains: bool
) -> tuple[Diagnostic, ...]:
    """Return the remarks of a verdict on the robot: actuators, limbs, soles, files and feet."""
    return (
        *(() if given_gains else report_tendon_joints(robot)),
        *report_joints_without_actuator(robot),
        *report_limbs_without_feet(robot),
        *(robot.description.report_replaced_soles() if stand.stance_feet else ()),
        *list_file_remarks(robot),
        *_report_buried_foot(robot, stand, statics),
    )


def _report_distant_command(run: OwnRun | None) -> tuple[Diagnostic, ...]:
    """Report that the ctrl of a keyframe moves a joint far from the qpos of the same keyframe.

    The robot may stand nevertheless, for example if the joint belongs to an arm.
    """
    if run is None or run.fails or run.commands is not OwnCommands.STATED:
        return ()
    joint = run.redirected
    if joint is None or abs(joint.off) <= MAX_POSTURE_DEVIATION:
        return ()
    moved = Quantity(abs(joint.off), joint.unit)
    return (
        diagnose(
            "keyframe-commands-elsewhere", keyframe=run.keyframe, joint=joint.joint, off=moved
        ),
    )


def _fail_without_torque(run: Outcome, null: Diagnostic, *, springs: bool) -> Outcome:
    """Mark a simulation as failed because motors without torque must hold a load; return a copy.

    The field ``stays`` remains True only if ``springs`` act on the loaded joints.
    """
    stays = run.stays and springs
    return replace(
        run, passed=False, stays=stays, failures=(null, *run.failures) if stays else (null,)
    )


def describe_frictionless_feet(robot: Robot, feet: Sequence[str]) -> Diagnostic | None:
    """Create the message that no contact point of a stand has friction: a push moves the robot.

    Returns:
        The message; None if a contact point has friction, for example.
    """
    if not feet or robot.fixed_parts or robot.is_base_fixed:
        return None
    if any(robot.contacts[foot].sliding_friction > 0 for foot in feet):
        return None
    return diagnose("feet-without-friction", feet=feet)


def describe_ties(robot: Robot, stand: Stand) -> tuple[Diagnostic, ...]:
    """Describe the constraints of the file that tie the robot to the world, as in a verdict.

    Messages have the severity ERROR if the unmodified file keeps the stand only with these
    constraints, or if these move a keyframe of a robot with a fixed base to another posture.
    """
    joints = stand.qpos[-robot.nu :]
    loaded = get_loaded_robot(robot)
    moved = None if loaded.floating else describe_violated_keyframe(loaded, joints)
    return (*filter(None, [moved]), *_report_world_ties(robot, joints))


def _report_world_ties(robot: Robot, joints: Array) -> tuple[Diagnostic, ...]:
    """Report the ties to the world of a free base, or of a link of a robot with a fixed base.

    ``joints`` are the joint positions of the stand or posture, shape (nu,) [rad, m].
    """
    loaded = get_loaded_robot(robot)
    return report_ties(robot) if loaded.floating else report_posture_ties(loaded, joints)


def describe_violated_keyframe(
    robot: Robot, joints: Array, requested: Sequence[str] = ()
) -> Diagnostic | None:
    """Create the message that constraints move driven joints of a keyframe to another posture.

    The servos of the unmodified file then press against the constraints, with torques that the
    statics of the posture do not contain.

    Args:
        robot: Prepared robot with a fixed base, as loaded.
        joints: Joint positions of the keyframe with closed loops, shape (nu,) [rad, m].
        requested: Names of joints with requested positions, which replace positions of the
            keyframe.

    Returns:
        The message; None if the posture was not computed from a keyframe, or if no displacement
        exceeds 0.05 rad or m (``MIN_UNHELD_DISPLACEMENT``).
    """
    found = None if robot.closure is None else find_posture_keyframe(robot, joints)
    if found is None or robot.closure is None:
        return None
    judged = (robot.mj_convention.actuator_index >= 0) & ~np.isin(robot.joint_names, requested)
    moved = np.where(judged, np.abs(found.moved), 0.0)
    worst = int(np.argmax(moved))
    if not moved[worst] > MIN_UNHELD_DISPLACEMENT:
        return None
    name = robot.joint_names[worst]
    return diagnose(
        "keyframe-violates-constraints",
        keyframe=found.name,
        joint=name,
        moved=Quantity(float(moved[worst]), joint_unit(robot, name)),
        bonds=robot.closure.constraint_names,
    )


def _list_overloaded_joints(
    robot: Robot, statics: GravityCompensation, positions: NDArray[np.float64] | None
) -> tuple[str, ...]:
    """Return the joints whose motors exceed the torque limits; limits of zero or below are ignored.

    The forces of actuators at tendons are evaluated at ``positions``, shape (nu,) [rad, m]. None:
    servos at the joints replace these actuators.
    """
    null = {limit.joint for limit in robot.efforts if limit.without_torque}
    overloaded = (
        find_overloaded_motors(statics)
        if positions is None
        else list_overloaded_joints(robot, statics, positions)
    )
    return tuple(name for name in overloaded if name not in null)


def _report_buried_foot(
    robot: Robot, stand: Stand, statics: GravityCompensation | None
) -> tuple[Diagnostic, ...]:
    """Report the first contact point that sinks by more than its contact radius, if any."""
    if statics is None:
        return ()
    for foot, force in statics.contact_forces.items():
        radius, normal_force = robot.contact_radius[foot], float(force @ stand.normals[foot])
        depth = GroundLaw.of_contact(robot, foot).depth(max(0.0, normal_force))
        if depth > radius > 0:
            deep, size = Quantity(depth, "m"), Quantity(radius, "m")
            return (diagnose("foot-buried", subject=("foot", foot), depth=deep, radius=size),)
    return ()


def _fail_if_upset(
    robot: Robot,
    stand: Stand,
    fed: Outcome,
    statics: GravityCompensation,
    trial: NudgeTrial | None,
    kp: ArrayLike | None,
    kd: ArrayLike | None,
    *,
    fragile: bool,
) -> Outcome:
    """Mark a simulation as failed if the stand fails after a nudge; return the result.

    A nudge is an initial velocity of the base. ``trial`` is the result of ``simulate_nudges``; if
    None, these nudges are simulated here, if necessary. Large nudges are simulated here in both
    cases: after survived nudges if the servos are stiff, or if no other nudges are necessary.
    ``fragile`` is True for a stand that fails without feed-forward.
    """
    speed = BASE_NUDGE_SPEED
    # Stiff servos saturate at small deviations, and may shake after large nudges.
    is_open = trial is None or (trial.survived and saturates_after_nudge(robot, statics, kp))
    if is_open and statics.com_margin is not None and not robot.is_base_fixed:
        held = solve_stand_as_simulated(robot, stand)
        if trial is None and (fragile or is_near_limit(robot, held, statics, kp)):
            trial = simulate_nudges(robot, held, kp=kp, kd=kd)
        stiff = trial is not None and trial.survived and saturates_after_nudge(robot, statics, kp)
        if trial is None or stiff:
            trial, speed = simulate_large_nudges(robot, held, kp=kp, kd=kd), LARGE_NUDGE_SPEED
    if trial is None or trial.failure is None:
        return fed
    moment = Quantity(trial.time or 0.0, "s")
    if trial.shaking_speed is not None:
        upset = diagnose(
            "shakes-after-nudge",
            speed=Quantity(speed, "m/s"),
            part=trial.failing_parts[0],
            left=Quantity(trial.shaking_speed, trial.shaking_unit),
            time=moment,
            fell=trial.failed_nudges,
            nudges=trial.nudges,
            timestep=Quantity(float(robot.mj_model.opt.timestep), "s"),
        )
    else:
        upset = diagnose(
            "upset-by-nudge",
            speed=Quantity(speed, "m/s"),
            fell=trial.failed_nudges,
            nudges=trial.nudges,
            failure=Term(trial.failure.value),
            where=trial.failing_parts,
            time=moment,
        )
    return replace(fed, passed=False, stays=False, failures=(upset,))


_FILE_ERROR_CODES = {
    *("inertia-repaired", "meshes-left", "files-missing", "points-made-spheres"),
    *("flat-shape-left", "shape-left", "empty-shape-left", "empty-range-left", "effort-negative"),
}
"""Codes of loading notes about errors of the file that do not prevent a simulation. Verdicts
contain these notes, since the results depend on assumptions that replace the erroneous values."""


def list_file_remarks(robot: Robot) -> tuple[Diagnostic, ...]:
    """Return messages about errors and assumptions in a robot's files, for verdicts.

    Examples are impossible masses and inertias, negative friction or damping, joints with an empty
    range, and placeholder torque limits or inertias.
    """
    loaded = get_loaded_robot(robot)
    messages = [note for note in loaded.notes if note.code in _FILE_ERROR_CODES]
    joint_names, model = np.array(loaded.joint_names), loaded.mj_model
    dofs = model.jnt_dofadr[[model.joint(name).id for name in joint_names]]
    negative_friction, negative_damping = (
        joint_names[model.dof_frictionloss[dofs] < 0],
        joint_names[model.dof_damping[dofs] < 0],
    )
    if negative_friction.size:
        messages.insert(0, diagnose("joints-rub-negatively", joints=negative_friction.tolist()))
    if negative_damping.size:
        messages.insert(0, diagnose("joints-damped-negatively", joints=negative_damping.tolist()))
    locked = joint_names[loaded.upper_limits <= loaded.lower_limits]
    if locked.size:
        messages.insert(0, diagnose("joints-locked-by-range", joints=locked.tolist()))
    assumptions = (diagnose("rests-on-made-up", findings=messages),) if messages else ()
    gravity_notes = (note for note in loaded.notes if note.code in _GRAVITY_CODES)
    return (
        *loaded.compute_once(_list_impossible_bodies),
        *assumptions,
        *gravity_notes,
        *report_placeholder_efforts(robot),
        *report_placeholder_inertias(robot),
        *describe_import_failure(robot),
    )


_GRAVITY_CODES = ("gravity-not-the-earths", "weight-is-compensated")
"""Codes of notes about an MJCF that reduces or changes the weight of the robot."""


def _list_impossible_bodies(robot: Robot) -> tuple[Diagnostic, ...]:
    """Return messages about impossible masses and inertias; visual geoms count as shapes."""
    model = robot.compute_once(compile_with_visuals)
    messages = describe_impossible_masses(model), describe_impossible_inertias(model)
    return tuple(message for message in messages if message is not None)


_MAX_DENSITY, _MIN_RADIUS = 19_300.0, 0.02
"""Upper bound of the mean density of the ball around a body [kg/m^3], and lower bound of the radius
of this ball [m]. A body with a larger density is reported as impossible. Tungsten has this density.
The radius is chosen, not tuned."""


def describe_impossible_masses(model: mujoco.MjModel) -> Diagnostic | None:
    """Create the message about bodies that are denser than tungsten for any possible shape.

    The volume of a body is that of a ball around the CoM, of at least a minimum radius. The ball
    contains the geoms, the frame of the body and the frames of the child bodies. Bodies without
    geoms, for example, are omitted.

    Returns:
        The message; None without such bodies.
    """
    radii = np.linalg.norm(model.body_ipos, axis=1)
    for body in range(1, model.nbody):
        parent = int(model.body_parentid[body])
        reach = float(np.linalg.norm(model.body_pos[body] - model.body_ipos[parent]))
        radii[parent] = max(radii[parent], reach)
    for geom in np.flatnonzero(model.geom_rbound > 0).tolist():
        body = int(model.geom_bodyid[geom])
        reach = float(np.linalg.norm(model.geom_pos[geom] - model.body_ipos[body]))
        radii[body] = max(radii[body], reach + float(model.geom_rbound[geom]))
    volumes = 4 / 3 * np.pi * np.maximum(radii, _MIN_RADIUS) ** 3
    shaped = np.isin(np.arange(model.nbody), model.geom_bodyid[model.geom_rbound > 0])
    densities = np.where(shaped & (model.body_weldid > 0), model.body_mass / volumes, 0.0)
    bodies = np.flatnonzero(densities > _MAX_DENSITY)
    if not bodies.size:
        return None
    worst = int(bodies[np.argmax(densities[bodies])])
    return diagnose(
        "mass-beyond-metal",
        count=int(bodies.size),
        worst=model.body(worst).name,
        mass=Quantity(float(model.body_mass[worst]), "kg"),
        radius=Quantity(max(float(radii[worst]), _MIN_RADIUS), "m"),
        density=Quantity(float(densities[worst]), "kg/m^3"),
    )


def describe_impossible_inertias(model: mujoco.MjModel) -> Diagnostic | None:
    """Create the message about bodies with a radius of gyration larger than the robot.

    The radius of gyration is sqrt(I / m), with the largest principal moment I. The size of the
    robot is the diagonal of a box around the moving bodies in ``qpos0``.

    Returns:
        The message; None without such bodies.
    """
    moving = model.body_weldid > 0
    heavy = moving & (model.body_mass > 0)
    if not heavy.any():
        return None
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    own = (model.body_weldid[model.geom_bodyid] > 0) & (model.geom_rbound > 0)
    radii = model.geom_rbound[own, None]
    ends = (data.xpos[moving], data.geom_xpos[own] - radii, data.geom_xpos[own] + radii)
    extent = float(np.linalg.norm(np.ptp(np.concatenate(ends), axis=0)))
    moments = model.body_inertia.max(axis=1)
    gyration = np.sqrt(moments / np.where(heavy, model.body_mass, np.inf))
    bodies = np.flatnonzero(heavy & (gyration > extent))
    if not bodies.size:
        return None
    worst = int(bodies[np.argmax(gyration[bodies])])
    return diagnose(
        "inertia-beyond-robot",
        count=int(bodies.size),
        worst=model.body(worst).name,
        moment=Quantity(float(moments[worst]), "kg m^2"),
        mass=Quantity(float(model.body_mass[worst]), "kg"),
        gyration=Quantity(float(gyration[worst]), "m"),
        extent=Quantity(extent, "m"),
    )


@check_arguments
def judge_stand(
    robot: Robot,
    stand: Stand,
    *,
    trial: NudgeTrial | None = None,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
) -> Verdict:
    """Simulate a stand with and without feed-forward torques, and return the verdict.

    The verdict includes the comparison with the published file (the user's MJCF or URDF without the
    changes of the preparation).

    Args:
        robot: Robot.
        stand: Stand.
        trial: Result of ``simulate_nudges``; None to simulate these nudges here, if necessary.
            If larger nudges are necessary, these are simulated here in both cases.
        kp: Servo stiffness [N m/rad, N/m], scalar or (nu,); None: value of the model.
        kd: Servo damping [N m s/rad, N s/m], scalar or (nu,); None: value of the model.

    Raises:
        StaticsInfeasibleError: If the stand slides or tips.
        NotSettlingError: If the penetration depths do not converge.
        ConfigurationError: If an argument is not valid for the robot.
        ModelError: If a joint has no motor, or has no position servo and kp and kd are not both
            given, for example.
    """
    held = solve_stand_as_simulated(robot, stand)
    fed, alone = (
        verify_stand(robot, held, kp=kp, kd=kd, feedforward=ahead) for ahead in (True, False)
    )
    statics = stand_statics(robot, held)
    return judge_simulation(robot, stand, fed, alone, statics=statics, trial=trial, kp=kp, kd=kd)
