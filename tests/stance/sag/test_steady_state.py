"""The predicted sag, compared with finite differences, force balances, and MuJoCo's simulations."""

import math
from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.base.diagnostics import Diagnostic, Subject
from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.servos import model_with_servos
from pupper_analysis.stance.posture import find_posture, held_stand
from pupper_analysis.stance.sag import steady_state as settle
from pupper_analysis.stance.sag.equilibrium import SagEquilibrium, SlipLaw, integrate_step
from pupper_analysis.stance.sag.steady_state import (
    HomotopyPath,
    find_slipping_points,
    steady_state,
)
from pupper_analysis.stance.sag.stiffness import minimum_stiffness
from pupper_analysis.stance.stand import stand_statics
from pupper_analysis.statics.equilibrium import ForceDistribution
from tests.support.engines import change_model, evaluate_mujoco
from tests.support.variants import NAMES, SKELETON_NAMES, load, stand_of

SETTLING = tuple(name for name in NAMES if name != "v3-long-leg")


def fast_creep(model: mujoco.MjModel) -> None:
    """Friction that creeps 50 or 100 times as fast, and holds no moments."""
    model.opt.impratio = 1
    model.geom_condim[:] = 3
    model.dof_frictionloss[:] = 0


def firm_grip(model: mujoco.MjModel) -> None:
    """Friction that hardly creeps, and holds no moments."""
    fast_creep(model)
    model.opt.impratio = 1e4


def without_friction(robot: pa.Robot, *feet: str) -> pa.Robot:
    """Return the robot with contacts of friction 0 at some feet; MuJoCo replaces 0 by 1e-5."""
    contacts = {
        foot: replace(contact, friction=(0.0,) * 5) if foot in feet else contact
        for foot, contact in robot.contacts.items()
    }

    def change(model: mujoco.MjModel) -> None:
        model.geom_friction[model.geom_bodyid == 0] = 0.0  # MuJoCo combines by the maximum
        for geom, foot in robot.foot_geoms.items():
            model.geom_friction[geom] = np.array(contacts[foot].friction)[[0, 2, 3]]

    return replace(change_model(robot, change), contacts=contacts)


@pytest.mark.parametrize("feet", [("FR",), ("FR", "RL"), ("FR", "RL", "FL")])
def test_feet_without_friction_rest_as_in_mujoco(feet: tuple[str, ...]) -> None:
    """Reference: MuJoCo, which moves by less than 10 um and 5e-4 rad in 0.25 s of creep.

    With friction at one foot, any yaw about this foot is an equilibrium.
    """
    robot = without_friction(load("v3"), *feet)
    stand = stand_of("v3")
    pose = steady_state(robot, stand)
    assert pose.failures == ()
    assert pose.release_margin > 0
    assert [pose.foot_creep[foot] for foot in feet] == [0.0] * len(feet)
    data = evaluate_mujoco(robot, pose.qpos)
    data.ctrl[:] = stand.joint_positions(robot)
    before = data.qpos.copy()
    mujoco.mj_step(robot.mj_model, data, round(0.25 / robot.mj_model.opt.timestep))
    assert data.qpos[2] == pytest.approx(before[2], abs=1e-5)
    assert data.qpos[7:] == pytest.approx(before[7:], abs=5e-4)
    assert data.actuator_force == pytest.approx(pose.joint_torques, abs=0.01)
    for contact, force in zip(data.contact, list_contact_forces(robot, data), strict=True):
        foot = robot.foot_geoms[max(contact.geom.tolist())]
        assert force[0] == pytest.approx(pose.contact_forces[foot][2], rel=5e-3)
        assert (foot in feet) == (np.hypot(*force[1:3]) < 2e-4)  # 1e-5 of 7 N


def list_contact_forces(robot: pa.Robot, data: mujoco.MjData) -> list[np.ndarray]:
    """Return the force of each contact in MuJoCo, in its contact frame: normal force first."""
    forces = []
    for index in range(data.ncon):
        forces.append(np.zeros(6))
        mujoco.mj_contactForce(robot.mj_model, data, index, forces[-1])
    return forces


def test_release_margin_of_a_foot_without_friction_is_its_normal_force() -> None:
    """Reference: 2 f - f_0, as such a foot can only lift; the other feet have larger reserves."""
    robot = without_friction(load("v3"), "RR")
    stand = pa.solve_stand_as_simulated(robot, pa.StandTask(offset=(0.04, 0.04)))
    before = stand_statics(robot, stand, distribution=ForceDistribution.MIN_TANGENTIAL)
    pose = steady_state(robot, stand, kp=7.0)
    overshot = 2 * pose.contact_forces["RR"][2] - before.contact_forces["RR"][2]
    assert pose.release_margin == pytest.approx(overshot / robot.weight)
    assert pose.release_margin < settle.RELEASE_MARGIN


def test_feet_without_friction_slip_before_they_have_moved() -> None:
    """Central differences at exactly zero slip and tangential force: no row is that of sticking."""
    robot = without_friction(load("v3"), "FR", "RL")
    system = SagEquilibrium(robot, stand_of("v3"), None, "pinned")
    forces = np.tile([0.0, 0.0, robot.weight / 4], (4, 1))
    rows = [row for row, *_ in system.find_slipping_contacts(forces, np.zeros((4, 3)))]
    assert [tuple(system.anchors)[row] for row in rows] == ["FR", "RL"]
    step = np.zeros_like(forces)
    for row in rows:
        step[row, :2] = 1e-3
        ends = [system.residual(system.stand.qpos, forces + sign * step) for sign in (1, -1)]
        change = (ends[0] - ends[1]) / 2
        derivative = system.derivative(system.stand.qpos, forces)[:, robot.nv :]
        np.testing.assert_allclose(change, derivative @ step.ravel(), atol=1e-12)
        assert change[robot.nv + 3 * row] == pytest.approx(1e-3)  # N of force, not m of slip


def test_steady_state_is_refused_if_no_foot_has_friction() -> None:
    robot = load("v3")
    with pytest.raises(pa.ConfigurationError, match="have no friction"):
        steady_state(without_friction(robot, *robot.feet), stand_of("v3"))


@pytest.mark.parametrize("feet", ["pinned", "sliding"])
@pytest.mark.parametrize("name", SETTLING)
def test_forces_of_a_steady_state_balance_in_mujoco(name: str, feet: SlipLaw) -> None:
    """Reference: MuJoCo's bias forces, Jacobians and penetrations at the predicted positions."""
    robot, stand = load(name), stand_of(name)
    pose = steady_state(robot, stand, feet=feet)
    data = evaluate_mujoco(robot, pose.qpos)
    rest = data.qfrc_bias[robot.mj_convention.qvel_index].copy()
    torques = model_with_servos(robot).kp * (stand.qpos[7:] - pose.qpos[7:])
    np.testing.assert_allclose(pose.joint_torques, torques, rtol=0, atol=1e-12)
    rest[6:] -= pose.joint_torques
    for touch in data.contact:
        if max(touch.geom) not in robot.foot_geoms:
            continue
        foot = robot.foot_geoms[max(touch.geom)]
        jacobian = np.zeros((3, robot.mj_model.nv))
        body = robot.contact_places[foot][0]
        mujoco.mj_jac(robot.mj_model, data, jacobian, None, touch.pos, body)
        force = pose.contact_forces[foot]
        rest -= jacobian[:, robot.mj_convention.qvel_index].T @ force
        assert GroundLaw.of_contact(robot, foot).force(-touch.dist) == pytest.approx(
            force[2], rel=1e-8
        )
        if feet == "sliding":
            assert np.linalg.norm(force[:2]) < 1e-4
    assert np.abs(rest).max() < 1e-9


def test_joints_of_a_robot_with_a_fixed_base_sag_until_the_servos_hold_its_weight() -> None:
    """Reference: MuJoCo's gravity torques at the predicted positions equal those of the servos."""
    robot = load("v3", fixed_base=True)
    stand = held_stand(robot, find_posture(robot))
    pose = steady_state(robot, stand)
    sag = stand.qpos - pose.qpos
    torques = model_with_servos(robot).kp * sag
    bias = evaluate_mujoco(robot, pose.qpos).qfrc_bias[robot.mj_convention.qvel_index]
    assert np.abs(sag).max() > 1e-3
    np.testing.assert_allclose(torques, bias, rtol=0, atol=1e-9)
    np.testing.assert_allclose(pose.joint_torques, torques, rtol=0, atol=1e-12)
    assert pose.contact_forces == {}


@pytest.mark.slow
@pytest.mark.parametrize("name", SETTLING)
def test_steady_states_of_nominal_stands_equal_the_simulation(name: str) -> None:
    """Reference: rest positions of simulations without feed-forward."""
    robot, stand = load(name), stand_of(name)
    pose, run = steady_state(robot, stand), pa.verify_stand(robot, stand, feedforward=False)
    assert pose.stable
    assert not pose.failures
    tolerance = 1e-6 if name in SKELETON_NAMES else 1e-4
    assert pose.base_height == pytest.approx(run.base_height, abs=tolerance)
    assert pose.contact_sag == pytest.approx(run.contact_sag, abs=1e-5 + 0.02 * tolerance)
    for foot, force in run.foot_forces.items():
        assert pose.contact_forces[foot][2] == pytest.approx(force[2], rel=0.02)


ANYWHERE = {
    "slope": pa.StandTask(pitch=-0.2, ground=pa.Ground(0.25, 0.3), com="inside"),
    "steps": pa.StandTask(ground=pa.Ground(heights={"FR": 0.012, "RL": 0.006})),
    "three legs": pa.StandTask(swing={"FL": 0.03}, com="inside", com_margin=0.01),
    "off the centre": pa.StandTask(offset=(-0.01, 0.02)),
}


@pytest.mark.slow
@pytest.mark.parametrize("what", ANYWHERE)
@pytest.mark.parametrize("name", ["original", "heavy", "v3"])
def test_steady_states_on_slopes_steps_and_three_legs_equal_the_simulation(
    name: str, what: str
) -> None:
    """Reference: simulations without feed-forward, in which the feet creep."""
    # On its own servos, v3 sinks until the lifted foot touches the ground.
    kp, kd = (20.0, 0.5) if name == "v3" else (None, None)
    robot, stand = load(name), pa.solve_stand(load(name), ANYWHERE[what])
    pose = steady_state(robot, stand, kp=kp, seconds=4.5)
    assert not pose.failures
    run = pa.verify_stand(robot, stand, feedforward=False, kp=kp, kd=kd)
    assert pose.base_height == pytest.approx(run.base_height, abs=1e-4)
    np.testing.assert_allclose(pose.joint_torques, run.joint_torques, atol=0.01)
    for foot, force in run.foot_forces.items():
        if foot in stand.stance_feet:
            np.testing.assert_allclose(pose.contact_forces[foot], force, atol=0.25)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["heavy", "v3"])
def test_creep_over_time_equals_the_simulation(name: str) -> None:
    """Reference: simulations of 2 and 8 s on a slope. On level ground, the height approaches that
    of the sliding equilibrium.
    """
    robot = load(name)
    stand = pa.solve_stand(robot, ANYWHERE["slope"])
    for seconds in (2.0, 8.0):
        run = pa.verify_stand(robot, stand, feedforward=False, duration=seconds, nudged=0)
        pose = steady_state(robot, stand, seconds=seconds - 0.5)
        assert pose.base_height == pytest.approx(run.base_height, abs=2e-4)
    drift = run.height_drift
    assert drift < -1e-5
    assert pose.height_drift == pytest.approx(drift, rel=0.1)
    stand = stand_of(name)
    away = [
        abs(steady_state(robot, stand, seconds=seconds).base_height - end)
        for end in (steady_state(robot, stand, feet="sliding").base_height,)
        for seconds in (0.0, 10.0, 1000.0)
    ]
    assert away[0] >= away[1] >= away[2]
    assert away[2] < 0.05 * away[0] + 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("name", ["original", "heavy"])
def test_reported_slip_margin_agrees_with_simulation(name: str) -> None:
    """Reference: simulations.

    The height is exact within 10 um above the margin, and wrong below zero.
    """
    robot = load(name)
    seen = set()
    for y in np.linspace(0.0, 0.055, 6):
        stand = pa.solve_stand(robot, pa.StandTask(offset=(-0.6 * float(y), float(y))))
        pose = steady_state(robot, stand, seconds=4.5)
        if pose.failures:
            break
        run = pa.verify_stand(robot, stand, feedforward=False)
        error = abs(pose.base_height - run.base_height)
        if pose.release_margin > settle.RELEASE_MARGIN:
            assert error < 1e-5
            seen.add("firm")
        if pose.release_margin < -0.02:
            assert error > 1e-5
            seen.add("slips")
    assert seen == {"firm", "slips"}
    still = steady_state(robot, stand_of(name), feedforward=True)
    assert still.release_margin > 0.2


def lift_foot(name: str, foot: str, height: float, **task: object) -> pa.Stand:
    """Return a stand with a lifted foot and the CoM 10 mm inside the triangle of the other feet."""
    requested = pa.StandTask(swing={foot: height}, com="inside", com_margin=0.01, **task)
    return pa.solve_stand(load(name), requested)


LANDING = [
    ("v3", "FR", 0.006, 8.0),  # it slips
    ("v3-heavy", "RL", 0.002, 6.6),
    ("v3-long-leg", "RR", 0.006, 9.0),
    ("original", "FL", 0.002, 12.0),  # it slips
    ("long-leg", "RR", 0.002, 12.0),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "foot", "height", "kp"), LANDING)
def test_lifted_foot_that_sinks_to_the_ground_carries_load(
    name: str, foot: str, height: float, kp: float
) -> None:
    """Reference: height and foot forces of a simulation of 8 s."""
    robot, stand = load(name), lift_foot(name, foot, height)
    pose = steady_state(robot, stand, kp=kp, seconds=7.5)
    assert pose.stance_feet == robot.contact_points
    presses = [
        failure.subject for failure in pose.failures if failure.code == "lifted-foot-presses"
    ]
    assert presses == [Subject("foot", foot)]
    run = pa.verify_stand(robot, stand, feedforward=False, kp=kp, duration=8, nudged=0)
    assert pose.base_height == pytest.approx(run.base_height, abs=2e-4)
    for other, force in run.foot_forces.items():
        assert pose.contact_forces[other][2] == pytest.approx(force[2], abs=0.25)


def test_friction_of_a_slipping_foot_is_at_its_limit_and_opposes_the_slip() -> None:
    """References: Coulomb's law, and the slip as displacement of the centre minus the rolling."""
    robot, stand = load("original"), lift_foot("original", "FL", 0.002)
    way = HomotopyPath(SagEquilibrium(robot, stand, 12.0, "pinned"))
    way.follow(1.0)
    system, solution = way.system, way.solution
    assert find_slipping_points(system, solution) == ("FL",)
    force = solution.forces["FL"]
    mu = robot.contacts["FL"].sliding_friction
    assert np.linalg.norm(force[:2]) == pytest.approx(mu * force[2], rel=1e-9)
    # The contact point moves as the centre does, less what the sphere rolls: r (turn x up).
    frame, anchor = robot.contact_frames["FL"], system.anchors["FL"]
    config = pa.Configuration(robot, solution.qpos)
    turned = config.frame_rotation(frame) @ anchor.rotation.T
    turn = np.array([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], 0]) / 2
    rolled = robot.contact_radius["FL"] * np.cross(turn, (0, 0, 1))
    slip = (config.frame_position(frame) - anchor.position - rolled)[:2]
    assert np.linalg.norm(slip) > 1e-4
    assert force[:2] @ slip < -0.99 * np.linalg.norm(force[:2]) * np.linalg.norm(slip)


def test_foot_that_would_have_to_pull_is_released() -> None:
    """Reference: the simulation, in which this foot carries no load."""
    robot = load("original")
    stand = pa.solve_stand(robot, pa.StandTask(offset=(0.055, 0.055)))
    assert pa.stance.stand_statics(robot, stand).contact_forces["RR"][2] > 0
    pose = steady_state(robot, stand, seconds=4.5)
    assert pose.stance_feet == ("FL", "FR", "RL")
    assert [str(failure) for failure in pose.failures] == ["foot RR carries no load"]
    np.testing.assert_array_equal(pose.contact_forces["RR"], 0)
    run = pa.verify_stand(robot, stand, feedforward=False)
    assert run.foot_forces["RR"][2] == 0
    assert pose.base_height == pytest.approx(run.base_height, abs=2e-5)


@pytest.mark.slow
def test_minimum_stiffness_keeps_a_swing_foot_off_the_ground() -> None:
    """Reference: steady states at, and 5 % below, the minimum stiffness."""
    robot, stand = load("v3"), lift_foot("v3", "RR", 0.02)
    kp = minimum_stiffness(robot, stand, tolerance=0.02)
    assert steady_state(robot, stand, kp=kp).stance_feet == stand.stance_feet
    assert "RR" in steady_state(robot, stand, kp=0.95 * kp).stance_feet
    with pytest.raises(
        pa.NoStiffnessError, match="foot RR is lifted but presses on the ground"
    ) as caught:
        minimum_stiffness(robot, lift_foot("v3", "RR", 0.0005))  # the others sink deeper than that
    assert caught.value.kp > 5e3
    assert "RR" in str(caught.value.problem)


@pytest.mark.slow
def test_steady_state_exists_for_each_stiffness_above_the_minimum() -> None:
    """A long step of the continuation may end on another branch. Reference: MuJoCo's height after
    12 s with the smallest of these values, 0.1004 m.
    """
    robot, stand = load("v3"), stand_of("v3")
    found = [steady_state(robot, stand, kp=kp) for kp in np.arange(2.30, 2.72, 0.02)]
    assert all(state.stable for state in found)
    # Failures are those of later creep only, in which a knee reaches the ground.
    assert not any(state.failures for state in found if math.isinf(state.lasts))
    lasting = [state.lasts for state in found]
    assert lasting == sorted(lasting)
    assert lasting[0] < 12
    heights = [float(state.qpos[2]) for state in found]
    assert (np.diff(heights) > 0).all()
    assert heights[0] == pytest.approx(0.1004, abs=5e-4)  # MuJoCo's, after 12 s: 0.1004 m


def test_steady_state_fails_if_creep_ends_the_equilibrium() -> None:
    """Reference: 8 s in MuJoCo, with a stiffness 2 % above the smallest.

    The robot falls; with the no-slip solver, contacts do not creep, and the robot stands.
    """
    robot, stand = load("original"), stand_of("original")
    pose = steady_state(robot, stand, kp=2.38)
    assert pose.stable
    assert pose.lasts == pytest.approx(6.0, abs=1.0)
    assert len(pose.failures) == 1
    heights = {}
    for noslip in (0, 20):  # contacts do not creep with the no-slip solver

        def grip(model: mujoco.MjModel, noslip: int = noslip) -> None:
            model.opt.noslip_iterations = noslip

        still = change_model(robot, grip)
        drive = model_with_servos(still, 2.38, 0.1)
        data = mujoco.MjData(drive.model)
        robot.mj_convention.set_state(data, pose.qpos)
        data.ctrl[:] = drive.command(robot, stand.joint_positions(robot))
        while data.time < 8.0:
            mujoco.mj_step(drive.model, data)
        heights[noslip] = float(data.qpos[2])
        assert bool(steady_state(still, stand, kp=2.38).failures) == (noslip == 0)
    assert heights[0] < 0.125 < pose.base_height
    assert heights[20] == pytest.approx(pose.base_height, abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(("noslip", "marked"), [(0, False), (20, True)])
def test_rolling_friction_that_the_no_slip_solver_keeps_is_marked(
    noslip: int, marked: bool
) -> None:
    """Reference: 6 s in MuJoCo without dry friction of joints, 11.38 mm instead of 11.88 mm.

    Without the no-slip solver, the feet creep by some 0.1 mm.
    """
    robot, stand = load("v3"), stand_of("v3")

    def grip(model: mujoco.MjModel) -> None:
        model.opt.noslip_iterations = noslip
        model.dof_frictionloss[:] = 0.0

    changed = change_model(robot, grip)
    pose = steady_state(changed, stand)
    assert bool(pose.rolling_feet) == marked
    drive = model_with_servos(changed, 5.0, 0.1)
    data = mujoco.MjData(drive.model)
    robot.mj_convention.set_state(data, stand.qpos)
    data.ctrl[:] = drive.command(changed, stand.joint_positions(changed))
    while data.time < 6.0:
        mujoco.mj_step(drive.model, data)
    error = abs(float(data.qpos[2]) - pose.base_height)
    assert (error > 2e-4) == marked


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "feet", "kd", "ground"),
    [("long-leg", "pinned", 1.0, firm_grip), ("v3", "sliding", 0.1, fast_creep)],
)
def test_simulation_collapses_below_the_minimum_stiffness(
    name: str, feet: SlipLaw, kd: float, ground: Callable[[mujoco.MjModel], None]
) -> None:
    """Reference: simulations with stiffness 5 % above and 10 % below the minimum."""
    robot, stand = load(name), stand_of(name)
    kp = minimum_stiffness(robot, stand, feet=feet, tolerance=0.05)
    above, below = (
        pa.verify_stand(
            change_model(robot, ground), stand, feedforward=False, kp=share * kp, kd=kd,
            integrator="implicitfast", duration=8.0,
        )
        for share in (1.05, 0.9)
    )  # fmt: skip
    assert above.passed
    if feet == "pinned":  # creeping feet reach the sliding equilibrium later
        loss = steady_state(robot, stand, kp=1.05 * kp).height_loss
        assert loss == pytest.approx(above.height_loss, abs=2e-4)
    assert any(failure.code == "body-touches-ground" for failure in below.failures)


def test_instability_is_reported() -> None:
    """With full feed-forward, the stand is an equilibrium with any kp, and unstable with a low kp.
    Reference: a simulation of 20 s, in which the robot falls over.
    """
    robot, stand = load("original"), stand_of("original")
    pose = steady_state(robot, stand, kp=0.1, feedforward=True)
    assert not pose.stable
    assert any(failure.code == "equilibrium-not-stable" for failure in pose.failures)
    run = pa.verify_stand(robot, stand, kp=0.1, kd=0.1, duration=20, nudged=0)
    assert any(failure.code == "fell-over" for failure in run.failures)


@pytest.mark.slow
def test_a_missing_equilibrium_names_the_feet_that_begin_to_slide() -> None:
    """Reference: symmetry. Facing up a slope, left and right feet slide together."""
    robot = load("v3")
    stand = pa.solve_stand(robot, pa.StandTask(ground=pa.Ground(slope=0.6)))
    with pytest.raises(pa.NoEquilibriumError) as caught:
        steady_state(robot, stand, kp=0.3)
    problem = caught.value.diagnostic.values["problem"]
    assert isinstance(problem, Diagnostic)
    assert problem.code == "feed-forward-needed"
    assert set(problem.values["sliding"]) == {"RR", "RL"}  # type: ignore[arg-type]


def test_steady_state_refuses_invalid_arguments() -> None:
    """The message names the argument."""
    robot, stand = load("v3"), stand_of("v3")
    slope = pa.solve_stand(robot, pa.StandTask(pitch=-0.1, ground=pa.Ground(0.1)))
    no_grip = {one: replace(of, friction=(0.0,) * 5) for one, of in robot.contacts.items()}
    for argument, at_stand, options, message in (
        (robot, stand, {"feet": "glued"}, "feet"),
        (load("v3", fixed_base=True), stand, {}, "robot"),
        (robot, slope, {"feet": "sliding"}, "slope"),
        (robot, stand, {"seconds": -1.0}, "seconds"),
        (robot, stand, {"seconds": np.inf}, "seconds"),
        (robot, stand, {"seconds": 1.0, "feet": "sliding"}, "seconds"),
        (robot, stand, {"kp": -1}, "kp"),
        (replace(robot, contacts=no_grip), stand, {}, "no friction"),
    ):
        with pytest.raises(pa.ConfigurationError, match=message):
            steady_state(argument, at_stand, **options)  # type: ignore[arg-type]
    for tolerance in (0.0, 1.0, -0.1, np.nan):
        with pytest.raises(pa.ConfigurationError, match="tolerance"):
            minimum_stiffness(robot, stand, tolerance=tolerance)
    named = {foot.lower(): place for foot, place in stand.foot_targets.items()}
    with pytest.raises(pa.UnknownNameError, match="fr"):
        steady_state(robot, replace(stand, foot_targets=named))


@pytest.mark.parametrize("name", ["original", "v3"])
def test_steady_state_with_sliding_feet_is_a_minimum_of_the_energy(name: str) -> None:
    """Reference: potential energy of weight, servos and ground in random directions.

    Without friction, the energy is a function of qpos alone, and grows in every direction.
    """
    robot, stand = load(name), stand_of(name)
    pose = steady_state(robot, stand, feet="sliding")
    kp, gravity = model_with_servos(robot).kp, -robot.gravity[2]
    laws = {foot: GroundLaw.of_contact(robot, foot) for foot in robot.contact_points}

    def energy(qpos: np.ndarray) -> float:
        config = pa.Configuration(robot, qpos)
        total = robot.total_mass * gravity * config.center_of_mass()[2]
        total += 0.5 * kp @ (qpos[7:] - stand.qpos[7:]) ** 2
        for foot, place in config.foot_positions().items():
            depths = np.linspace(0, robot.contact_radius[foot] - place[2], 401)
            total += np.trapezoid([laws[foot].force(float(depth)) for depth in depths], depths)
        return float(total)

    least, random = energy(pose.qpos), np.random.default_rng(0)
    for _ in range(8):
        step = 1e-4 * random.standard_normal(robot.nv)
        up, down = (energy(integrate_step(pose.qpos, sign * step)) for sign in (1, -1))
        assert up > least
        assert down > least
        assert abs(up - down) < 0.1 * (up + down - 2 * least)


@pytest.mark.parametrize("name", NAMES)
def test_feedforward_leaves_the_contact_sag_in_a_steady_state(name: str) -> None:
    """Reference: height and torques of a simulation with feed-forward."""
    robot, stand = load(name), stand_of(name)
    pose = steady_state(robot, stand, feedforward=True)
    run = pa.verify_stand(robot, stand, duration=2.0, nudged=0)
    assert pose.height_loss == pytest.approx(run.height_loss, abs=2e-5)
    assert abs(pose.servo_sag) < 2e-5
    np.testing.assert_allclose(pose.joint_torques, run.predicted_torques, atol=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["original", "heavy", "v3"])
def test_steady_state_with_sliding_feet_equals_the_end_of_fast_creep(name: str) -> None:
    """Reference: a simulation of 8 s, in which contacts creep 50 or 100 times as fast."""
    robot, stand = load(name), stand_of(name)
    pose = steady_state(robot, stand, feet="sliding")
    quick = change_model(robot, fast_creep)
    run = pa.verify_stand(quick, stand, feedforward=False, duration=8.0, nudged=0)
    assert pose.base_height == pytest.approx(run.base_height, abs=5e-6)
    assert pose.contact_sag == pytest.approx(run.contact_sag, abs=1e-5)
    for foot, force in run.foot_forces.items():
        assert pose.contact_forces[foot][2] == pytest.approx(force[2], rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["v3", "v3-heavy"])
def test_height_drift_of_pinned_feet_on_level_ground_equals_the_simulation(name: str) -> None:
    """Reference: a simulation of 8 s, in which the dry friction of the joints has crept away."""
    pose = steady_state(load(name), stand_of(name))
    run = pa.verify_stand(load(name), stand_of(name), feedforward=False, duration=8.0, nudged=0)
    assert run.height_drift == pytest.approx(pose.height_drift, rel=0.15)


@pytest.mark.parametrize("kp", [3.0, 5.0, 20.0, 100.0])
def test_feet_of_a_steady_state_carry_load_only_in_the_ground(kp: float) -> None:
    """References: penetrations of MuJoCo's collisions, the law of the ground, and the weight."""
    robot, stand = load("v3"), lift_foot("v3", "RR", 0.006)
    pose = steady_state(robot, stand, kp=kp)
    depths = {}
    for touch in evaluate_mujoco(robot, pose.qpos).contact:
        depths[robot.foot_geoms[max(touch.geom)]] = -touch.dist
    assert set(pose.stance_feet) == set(depths)
    assert ("RR" in depths) == (kp < 50)  # on stiff servos only the ground gives
    for foot, force in pose.contact_forces.items():
        if foot in depths:
            assert force[2] == pytest.approx(GroundLaw.of_contact(robot, foot).force(depths[foot]))
        else:
            np.testing.assert_array_equal(force, 0)
    weight = robot.total_mass * robot.gravity
    np.testing.assert_allclose(sum(pose.contact_forces.values()), -weight, atol=1e-8)


@pytest.mark.slow
def test_foot_force_begins_at_zero_if_a_lifted_foot_just_touches() -> None:
    """Bisection of the lift height [m] to 1 um: height and force have no step."""
    robot = load("v3")

    def pose(height: float) -> settle.SteadyState:
        return steady_state(robot, lift_foot("v3", "RR", height), kp=4.0)

    low, high = 0.006, 0.03  # with and without contact
    assert "RR" in pose(low).stance_feet
    assert "RR" not in pose(high).stance_feet
    while high - low > 1e-6:
        middle = (low + high) / 2
        low, high = (middle, high) if "RR" in pose(middle).stance_feet else (low, middle)
    assert 0 < pose(low).contact_forces["RR"][2] < 5e-3
    assert pose(low).height_loss == pytest.approx(pose(high).height_loss, abs=2e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    "ground", [pa.Ground(heights={"RR": 0.006}), pa.Ground(0.1, 0.5)], ids=["step", "slope"]
)
def test_lifted_foot_that_sinks_to_a_step_or_slope_carries_load(ground: pa.Ground) -> None:
    """Reference: height and foot force of a simulation of 6 s."""
    robot, stand = load("v3"), lift_foot("v3", "RR", 0.004, ground=ground)
    pose = steady_state(robot, stand, kp=5.0, seconds=5.5)
    assert "RR" in pose.stance_feet
    run = pa.verify_stand(robot, stand, feedforward=False, kp=5.0, duration=6.0, nudged=0)
    assert pose.base_height == pytest.approx(run.base_height, abs=2e-4)
    assert pose.contact_forces["RR"][2] == pytest.approx(run.foot_forces["RR"][2], abs=0.2)


@pytest.mark.parametrize(
    ("name", "foot", "kp", "slippery"),
    [("original", "FL", 12.0, ()), ("v3", "RR", 4.0, ()), ("v3", "RR", 4.0, ("RR", "FL"))],
)
def test_derivative_of_slipping_and_creeping_feet_equals_central_differences(
    name: str, foot: str, kp: float, slippery: tuple[str, ...]
) -> None:
    """Central differences of the residual at a solution in which the lifted foot has landed.

    Steps of 1e-6 in all coordinates and forces, and of 1e-3 N in the forces alone, with which the
    compliance of the contacts [m/N] is compared as well.
    """
    robot = without_friction(load(name), *slippery)
    way = HomotopyPath(SagEquilibrium(robot, lift_foot(name, foot, 0.002), kp, "pinned"))
    way.follow(1.0)
    system, solution = way.system, way.solution
    forces = np.array(list(solution.forces.values()))
    n, random = system.robot.nv, np.random.default_rng(0)

    def change(step: np.ndarray) -> np.ndarray:
        ends = [
            system.residual(
                integrate_step(solution.qpos, sign * step[:n]),
                forces + sign * step[n:].reshape(-1, 3),
            )
            for sign in (1, -1)
        ]
        return np.asarray((ends[0] - ends[1]) / 2)

    for _ in range(2):
        derivative = system.derivative(solution.qpos, forces)
        for _ in range(4):
            step = 1e-6 * random.standard_normal(len(derivative))
            np.testing.assert_allclose(change(step), derivative @ step, atol=2e-9)
            step = np.r_[np.zeros(n), 1e3 * step[n:]]
            np.testing.assert_allclose(change(step), derivative @ step, rtol=1e-3, atol=1e-12)
        system.begin_creep(solution, 1.0)


@pytest.mark.slow
def test_stand_of_v3_with_long_legs_has_no_steady_state_and_sinks_in_mujoco() -> None:
    """Reference: a simulation of 10 s without feed-forward, in which a body comes to the ground."""
    robot, stand = load("v3-long-leg"), stand_of("v3-long-leg")
    with pytest.raises(pa.NoEquilibriumError, match="sliding") as caught:
        steady_state(robot, stand, feet="sliding")
    assert 0 < caught.value.share < 0.1
    with pytest.raises(pa.NoEquilibriumError, match="FR and FL begin to slide") as caught:
        steady_state(robot, stand)
    assert 0.8 < caught.value.share < 0.9
    for ground in (robot, change_model(robot, firm_grip)):
        run = pa.verify_stand(ground, stand, feedforward=False, duration=10.0, nudged=0)
        assert any(failure.code == "body-touches-ground" for failure in run.failures)


def test_dictionary_of_a_steady_state_states_the_parts_of_the_height_loss() -> None:
    """Reference: the sum of both parts, and the base height that was recorded [m]."""
    result = steady_state(load("v3"), stand_of("v3")).to_dict()
    assert result["base_height"] == pytest.approx(0.11963, abs=1e-5)
    assert result["height_loss"] == pytest.approx(result["servo_sag"] + result["contact_sag"])


def test_contact_changes_of_earlier_searches_do_not_end_a_path() -> None:
    """A search for the least stiffness follows one path many times, from the same contacts."""
    robot = load("v3")
    stand = pa.stance.solve_stand_on_soft_ground(robot)
    path = settle.make_homotopy_path(robot, stand, None, "pinned", exact=True)
    path.follow(1.0)
    anchors, start = dict(path.system.anchors), path.solution
    foot = next(iter(anchors))
    for _ in range(60):
        path.reset_creep(anchors)
        path.solution = start
        path._switch_contact(foot, start)  # opens the contact
    assert foot not in path.system.anchors
