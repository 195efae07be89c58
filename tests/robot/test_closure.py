"""Closed loops and couplings of joints: torques in closed form, compliance and sag against MuJoCo's
simulation.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.prepare.judge import judge_stand
from pupper_analysis.robot.closure import find_closure
from pupper_analysis.robot.coordinates import MujocoConvention
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import model_with_servos
from pupper_analysis.simulation.rollout import place_on_ground, simulate_commands
from pupper_analysis.stance.problem import compute_targets
from pupper_analysis.stance.relaxation import explain_refusal
from pupper_analysis.stance.search import minimise_foot_errors
from pupper_analysis.stance.solver import SearchContext
from tests.support.bound import LEGS, belts, four_bars
from tests.support.commands import run_command
from tests.support.legged import Pair, quadruped, rewrite_file


def load(pair: Pair) -> Robot:
    return pa.load_robot(*pair)


def joint_value(robot: Robot, values: np.ndarray, joint: str) -> float:
    """Return the entry of a joint in a vector whose last `nu` entries are the joints in order."""
    return float(values[len(values) - robot.nu + robot.joint_names.index(joint)])


def verify_held_stand(robot: Robot, task: pa.StandTask | None = None) -> pa.Stand:
    """Return the stand on soft ground, and assert that MuJoCo holds it with relative torque and
    force errors below 1e-5.
    """
    stand = pa.stance.solve_stand_on_soft_ground(robot, task)
    found = pa.verify_stand(robot, stand)
    assert found.passed, found.failures
    assert max(found.torque_error, found.force_error) < 1e-5
    assert found.joint_error < 1e-6
    assert found.mujoco_residual < 1e-9
    return stand


EYE = (
    '<link name="{0}_eye"><inertial><mass value="0.01"/><inertia ixx="1e-5" ixy="0" ixz="0" '
    'iyy="1e-5" iyz="0" izz="1e-5"/></inertial></link><joint name="{0}_end" type="revolute">'
    '<origin xyz="0 0 -0.2"/><parent link="{0}_rod"/><child link="{0}_eye"/><axis xyz="0 1 0"/>'
    '<limit lower="-3" upper="3" effort="30" velocity="20"/></joint>'
)


def hinge_rods(pair: Pair) -> Pair:
    """Give each rod a light eye that turns at its end; the MJCF's weld ties that to the calf."""
    rewrite_file(pair.urdf, ("</robot>", "".join(map(EYE.format, LEGS)) + "</robot>"))
    root = ElementTree.parse(pair.mjcf).getroot()
    (equality,) = root.iter("equality")
    for leg in LEGS:
        rod = next(body for body in root.iter("body") if body.get("name") == f"{leg}_rod")
        eye = (
            f'<body name="{leg}_eye" pos="0 0 -0.2"><inertial pos="0 0 0" mass="0.01" diaginertia='
            f'"1e-5 1e-5 1e-5"/><joint name="{leg}_end" axis="0 1 0" range="-3 3"/></body>'
        )
        rod.append(ElementTree.fromstring(eye))
        equality.remove(
            next(constraint for constraint in equality if constraint.get("body1") == f"{leg}_rod")
        )
        weld = f'<weld body1="{leg}_eye" body2="{leg}_calf" solref="0.005 1"/>'
        equality.append(ElementTree.fromstring(weld))
    pair.mjcf.write_text(ElementTree.tostring(root, encoding="unicode"))
    return pair


def without_loops(robot: Robot, qpos: np.ndarray, forces: dict[str, np.ndarray]) -> np.ndarray:
    """Return the joint torques of the tree without loops, shape (nu,) [N m]: g - J^T f by MuJoCo's
    kinematics.
    """
    model, data = robot.mj_model, mujoco.MjData(robot.mj_model)
    robot.mj_convention.set_state(data, qpos)
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fwdVelocity(model, data)
    left, jacobian = data.qfrc_bias.copy(), np.zeros((3, model.nv))
    for foot, force in forces.items():
        body, place = robot.contact_places[foot]
        point = data.xpos[body] + data.xmat[body].reshape(3, 3) @ place
        point[2] -= robot.contact_radius[foot]
        mujoco.mj_jac(model, data, jacobian, None, point, body)
        left -= jacobian.T @ force
    return left[robot.mj_convention.qvel_index[6:]]


@pytest.mark.slow
def test_motor_of_a_belt_has_the_torque_of_the_closed_form(tmp_path: Path) -> None:
    """In closed form: q_knee = -0.2 - 0.8 q_motor, so tau_motor = tau'_motor - 0.8 tau'_knee."""
    robot = load(belts(tmp_path))
    assert any(note.code == "joints-follow" for note in robot.notes)
    stand = pa.solve_stand(robot)
    held = pa.stance.stand_statics(robot, stand)
    tree = without_loops(robot, stand.qpos, held.contact_forces)
    for leg in LEGS:
        knee, motor = (
            joint_value(robot, stand.qpos, f"{leg}_{name}") for name in ("knee", "motor")
        )
        assert knee == pytest.approx(-0.2 - 0.8 * motor, abs=1e-9)
        own, its = (joint_value(robot, tree, f"{leg}_{name}") for name in ("motor", "knee"))
        assert abs(its) > 1
        assert joint_value(robot, held.joint_torques, f"{leg}_motor") == pytest.approx(
            own - 0.8 * its
        )
        assert joint_value(robot, held.joint_torques, f"{leg}_knee") == 0.0
        assert joint_value(robot, held.joint_torques, f"{leg}_pitch") == pytest.approx(
            joint_value(robot, tree, f"{leg}_pitch"), abs=1e-9
        )


@pytest.mark.slow
def test_stand_with_elastic_belts_is_as_predicted(tmp_path: Path) -> None:
    """Reference: simulation.

    The belts yield by 1 to 50 mrad; the stand that ignores this has wrong motor torques.
    """
    robot = load(belts(tmp_path))
    stand = verify_held_stand(robot)
    assert robot.closure is not None
    assert 1e-3 < robot.closure.largest_violation(stand.qpos) < 0.05
    rigid = pa.verify_stand(robot, pa.solve_stand(robot))
    assert not rigid.passed
    assert "motor-torque-off" in {failure.code for failure in rigid.failures}


@pytest.mark.slow
@pytest.mark.parametrize("pair", [belts, four_bars])
def test_soft_loop_stand_sags_as_predicted_by_steady_state(pair, tmp_path: Path) -> None:
    """Loops are 30 times as compliant when closed as when open. Reference: 20 s of MuJoCo."""
    words = 'solref="0.0173 1.936" solimp="0.814 0.986 0.00042 0.47 1"'
    robot = load(pair(tmp_path, words=words))
    stand = verify_held_stand(robot)
    assert robot.closure is not None
    assert robot.closure.largest_violation(stand.qpos) > 2e-3
    sag = pa.steady_state(robot, stand, feet="sliding")
    found = pa.verify_stand(robot, stand, feedforward=False, duration=20.0, nudged=0)
    assert found.base_height == pytest.approx(sag.base_height, abs=1e-6)
    if pair is four_bars:
        with pytest.raises(pa.NoEquilibriumError, match="or cannot be found from closed loops"):
            pa.steady_state(robot, pa.solve_stand(robot), feet="sliding")


@pytest.mark.slow
@pytest.mark.parametrize("polynomial", [(0.0, -0.7, -0.08), (-0.1, -0.9, 0.05, 0.01, -0.002)])
def test_stand_satisfies_a_nonlinear_coupling(
    polynomial: tuple[float, ...], tmp_path: Path
) -> None:
    """Reference: the polynomial of the file, knee(motor) [rad], at the solved stand; and the
    simulation.
    """
    robot = load(belts(tmp_path, polynomial))
    stand = pa.solve_stand(robot)
    for leg in LEGS:
        motor = joint_value(robot, stand.qpos, f"{leg}_motor")
        wanted = sum(factor * motor**power for power, factor in enumerate(polynomial))
        assert joint_value(robot, stand.qpos, f"{leg}_knee") == pytest.approx(wanted, abs=1e-9)
    verify_held_stand(robot)


@pytest.mark.slow
def test_crank_of_a_parallelogram_has_the_torque_of_the_closed_form(tmp_path: Path) -> None:
    """In closed form: knee = motor - pitch and pin = pitch - motor, by virtual work."""
    robot = load(four_bars(tmp_path))
    stand = pa.solve_stand(robot)
    held = pa.stance.stand_statics(robot, stand)
    tree = without_loops(robot, stand.qpos, held.contact_forces)
    for leg in LEGS:
        q = {
            n: joint_value(robot, stand.qpos, f"{leg}_{n}")
            for n in ("pitch", "knee", "motor", "pin")
        }
        assert q["knee"] == pytest.approx(q["motor"] - q["pitch"], abs=1e-8)
        assert q["pin"] == pytest.approx(-q["knee"], abs=1e-8)
        tau = {n: joint_value(robot, held.joint_torques, f"{leg}_{n}") for n in q}
        was = {n: joint_value(robot, tree, f"{leg}_{n}") for n in q}
        assert tau["motor"] == pytest.approx(was["motor"] + was["knee"] - was["pin"], abs=1e-8)
        assert tau["pitch"] == pytest.approx(was["pitch"] - was["knee"] + was["pin"], abs=1e-8)
        assert (tau["knee"], tau["pin"]) == (0.0, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("crank", [0.05, 0.04])
def test_four_bars_stand_as_predicted(crank: float, tmp_path: Path) -> None:
    """Reference: simulation of three stands. Four-bar loops open by 0.1 to 2 mm under load."""
    robot = load(four_bars(tmp_path, crank))
    stand = verify_held_stand(robot)
    assert robot.closure is not None
    assert 1e-4 < robot.closure.largest_violation(stand.qpos) < 2e-3
    verify_held_stand(robot, pa.StandTask(height=0.95 * robot.stand_height))
    verify_held_stand(robot, pa.StandTask(swing={"FL_calf": 0.03}, com_margin=0.005))


@pytest.mark.slow
def test_a_dead_point_is_the_cause_of_a_refusal(tmp_path: Path) -> None:
    """A crank of 30 mm folds the knee no further than to 0.336 m: "the feet miss by 2e-05 mm"."""
    robot = load(four_bars(tmp_path, 0.03))
    pa.solve_stand(robot, pa.StandTask(height=0.3361))
    for height in (0.33606829, 0.3):
        with pytest.raises(pa.StanceUnreachableError) as refused:
            pa.solve_stand(robot, pa.StandTask(height=height), explain=False)
        assert [obstacle.code for obstacle in refused.value.blocked] == ["motors-at-dead-point"]
        assert bool(refused.value.shortfall) is (height < 0.33)
    with pytest.raises(pa.StanceUnreachableError) as refused:
        pa.solve_stand(robot, pa.StandTask(height=0.42), explain=False)
    assert refused.value.blocked == ()


def test_foot_that_couplings_hold_is_not_at_a_dead_point(tmp_path: Path) -> None:
    """All legs follow the pitch and knee of one leg, without roll: two independent joints, which
    never move a foot sideways.
    """
    pair, first = quadruped(tmp_path), LEGS[0]
    couplings = [
        f'<joint joint1="{leg}_{joint}" joint2="{first}_{joint}"/>'
        for leg in LEGS[1:]
        for joint in ("pitch", "knee")
    ]
    couplings += [f'<joint joint1="{leg}_roll"/>' for leg in LEGS]
    equality = f"<equality>{''.join(couplings)}</equality></mujoco>"
    rewrite_file(pair.mjcf, ("</mujoco>", equality))
    robot = load(pair)
    assert robot.closure is not None
    assert robot.closure.null_space(robot.home).shape == (robot.nu, 2)
    aside = pa.StandTask(foot_offsets={robot.contact_points[0]: (0.0, 0.05)})
    with pytest.raises(pa.StanceUnreachableError) as refused:
        pa.solve_stand(robot, aside, explain=False)
    assert refused.value.shortfall[robot.contact_points[0]] > 0.02
    assert refused.value.blocked == ()


@pytest.mark.slow
def test_nearest_configuration_satisfies_the_loop_closure(tmp_path: Path) -> None:
    """Without loop constraints, the nearest configuration has all feet in place, and the refusal
    has no cause. A stand with its feet in place is reported if its loops are open."""
    robot = load(four_bars(tmp_path))
    task = pa.StandTask(
        height=0.273, yaw=-0.44, swing={"FL_calf": 0.203}, joint_margin=0.1, com="inside"
    )
    context, targets = SearchContext(robot), compute_targets(robot, task, {})
    nearest = minimise_foot_errors(context, targets, robot.home)
    assert robot.closure is not None
    assert robot.closure.largest_violation(nearest.qpos) < 1e-6
    refusal = explain_refusal(context, targets, nearest, explain=False)
    assert max(refusal.shortfall.values()) == pytest.approx(nearest.foot_error, abs=1e-6)
    # A stand whose feet are in place may have loops that are not.
    stand = pa.solve_stand(robot)
    there = replace(stand, foot_error=0.03)
    message = explain_refusal(context, compute_targets(robot, None, {}), there, explain=False)
    assert [obstacle.code for obstacle in message.blocked] == ["loops-stay-open"]


@pytest.mark.slow
def test_loop_jacobian_equals_the_finite_difference_of_the_residual(tmp_path: Path) -> None:
    """Central differences of 1e-6 rad.

    The null space of eight loop rows is tangent to the loops, and the torque Jacobian of the loop
    springs is symmetric: they have a potential.
    """
    robot = load(four_bars(tmp_path, 0.04))
    closure, qpos = robot.closure, pa.solve_stand(robot).qpos
    assert closure is not None
    rows, step = closure.jacobian(qpos), 1e-6
    for joint in range(robot.nu):
        ends = []
        for way in (step, -step):
            moved = qpos.copy()
            moved[7 + joint] += way
            ends.append(closure.residual(moved))
        np.testing.assert_allclose(rows[:, joint], (ends[0] - ends[1]) / (2 * step), atol=1e-8)
    basis = closure.null_space(qpos)
    assert basis.shape == (robot.nu, robot.nu - 8)
    np.testing.assert_allclose(rows @ basis, 0, atol=1e-9)
    stiffness = closure.constraint_torque_jacobian(qpos)
    assert np.abs(stiffness).max() > 1000  # N m/rad
    np.testing.assert_allclose(stiffness, stiffness.T, rtol=0, atol=1e-3)


@pytest.mark.slow
def test_constraint_opening_equals_mujoco_at_rest(tmp_path: Path) -> None:
    """Reference: force and opening of MuJoCo's equality constraints after 2,000 steps."""
    robot = load(belts(tmp_path, words=""))
    stand = pa.solve_stand(robot)
    drive = model_with_servos(robot)
    torques = pa.stance.stand_statics(robot, stand).joint_torques
    start = place_on_ground(robot, drive, stand, torques)
    ctrl = drive.command(robot, stand.joint_positions(robot), torques)
    end = simulate_commands(drive.model, start, np.tile(ctrl, (2000, 1)))[-1]
    model, data = drive.model, mujoco.MjData(drive.model)
    mujoco.mj_setState(model, data, end, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    data.ctrl[:] = ctrl
    mujoco.mj_forward(model, data)
    rows = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY.value
    opened, forces = data.efc_pos[rows], data.efc_force[rows]
    assert np.abs(opened).min() > 5e-3
    assert robot.closure is not None
    qpos = data.qpos[robot.mj_convention.qpos_index]
    load_on_knees = np.zeros(robot.nu)
    load_on_knees[robot.closure.dependent_joints] = forces  # A_F is 1 for joint1
    np.testing.assert_allclose(robot.closure.residual(qpos), opened, atol=1e-12)
    np.testing.assert_allclose(
        robot.closure.static_deflection(qpos, load_on_knees), opened, rtol=1e-3
    )


@pytest.mark.slow
@pytest.mark.parametrize("pair", [belts, four_bars])
def test_sag_with_closed_loops_equals_mujoco(pair, tmp_path: Path) -> None:
    """Reference: base height and torques after 20 s of MuJoCo, when tangential forces have
    vanished.
    """
    robot = load(pair(tmp_path))
    stand = pa.solve_stand(robot)
    sag = pa.steady_state(robot, stand, feet="sliding")
    assert not sag.failures
    found = pa.verify_stand(robot, stand, feedforward=False, duration=20.0, nudged=0)
    assert found.base_height == pytest.approx(sag.base_height, abs=1e-7)
    np.testing.assert_allclose(found.joint_torques, sag.joint_torques, atol=1e-4)
    assert float(stand.qpos[2]) - sag.base_height > 2e-3
    assert pa.stance.minimum_stiffness(robot, stand, feet="sliding") > 1


@pytest.mark.slow
def test_stand_on_soft_ground_is_refused_if_coupled_knees_yield(tmp_path: Path) -> None:
    """The right knees follow the left knees; as the couplings yield under load, the feet cannot be
    level."""
    pair = quadruped(tmp_path)
    motors = ((f'<motor joint="{end}R_knee" ctrlrange="-30 30"/>', "") for end in "FR")
    ties = "".join(f'<joint joint1="{end}R_knee" joint2="{end}L_knee"/>' for end in "FR")
    rewrite_file(pair.mjcf, *motors, ("</mujoco>", f"<equality>{ties}</equality></mujoco>"))
    robot = load(pair)
    assert pa.solve_stand(robot).solved
    with pytest.raises(pa.StanceUnreachableError, match="couplings, the stance is in"):
        pa.stance.solve_stand_on_soft_ground(robot)


@pytest.mark.slow
def test_inactive_coupling_constrains_no_joint(tmp_path: Path) -> None:
    """The knee then has a torque of its own [N m]."""
    robot = load(belts(tmp_path, words='active="false"'))
    assert robot.closure is None
    assert any(note.code == "mimics-taken-as-free" for note in robot.notes)
    held = pa.stance.stand_statics(robot, pa.solve_stand(robot))
    assert joint_value(robot, held.joint_torques, "FL_knee") != 0


@pytest.mark.slow
def test_configuration_that_violates_its_loops_is_refused(tmp_path: Path) -> None:
    """One knee is moved by 0.2 rad off its belt."""
    robot = load(belts(tmp_path))
    qpos = pa.solve_stand(robot).qpos.copy()
    qpos[7 + robot.joint_names.index("FL_knee")] += 0.2
    for contacts in (tuple(robot.contacts), ()):
        with pytest.raises(pa.ConfigurationError, match="opens coupled joints"):
            pa.gravity_compensation(pa.Configuration(robot, qpos), contacts)
    with pytest.raises(pa.ConfigurationError):  # the default contacts are not level, either
        pa.gravity_compensation(pa.Configuration(robot, qpos))


@pytest.mark.slow
def test_unsupported_computation_for_coupled_joints_is_refused_by_name(tmp_path: Path) -> None:
    robot = load(belts(tmp_path))
    stand = pa.solve_stand(robot)
    config = pa.Configuration(robot, stand.qpos)
    asked = {
        "a path": lambda: pa.stance.stance_path(robot, [pa.StandTask(), pa.StandTask()], 1.0),
        "inverse dynamics": lambda: pa.statics.inverse_dynamics(config, np.zeros(robot.nv)),
        "the best stance": lambda: pa.best_stance(robot),
    }
    for what, ask in asked.items():
        with pytest.raises(pa.ConfigurationError, match=rf"{what} is not computed .*coupled"):
            ask()


@pytest.mark.slow
def test_mimic_of_the_urdf_alone_is_added_to_the_mjcf(tmp_path: Path) -> None:
    """Closed form knee = -0.2 - 0.8 motor [rad]: exact for a rigid stand, within 0.05 rad if the
    coupling yields.
    """
    robot = load(belts(tmp_path, in_mjcf=False))
    assert any("were also coupled in the MJCF: FL_knee" in str(note) for note in robot.notes)
    for stand, give in ((verify_held_stand(robot), 0.05), (pa.solve_stand(robot), 1e-9)):
        motor, knee = (joint_value(robot, stand.qpos, f"FL_{name}") for name in ("motor", "knee"))
        assert knee == pytest.approx(-0.2 - 0.8 * motor, abs=give)


@pytest.mark.slow
def test_mimic_joint_with_its_own_motor_is_free_with_a_note(tmp_path: Path) -> None:
    """The MJCF drives the knees, which the URDF couples to other motors."""
    pair = belts(tmp_path, in_mjcf=False)
    knees = "".join(f'<motor joint="{leg}_knee" ctrlrange="-30 30"/>' for leg in LEGS)
    rewrite_file(pair.mjcf, ("<actuator>", f"<actuator>{knees}"))
    robot = load(pair)
    assert robot.closure is None
    assert any(note.code == "mimics-taken-as-free" for note in robot.notes)


@pytest.mark.slow
@pytest.mark.parametrize("make", [belts, four_bars])
def test_stand_command_holds_and_names_the_coupled_joints(
    make: Callable[[Path], Pair], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    files = make(tmp_path)
    status, out, err = run_command(
        capfd, "stand", "-v", "--urdf", str(files.urdf), "--mjcf", str(files.mjcf)
    )
    assert status == 0, err
    printed = " ".join((out + err).split())
    assert "HOLDS in MuJoCo" in printed
    assert "joints that follow other joints" in printed


@pytest.mark.slow
def test_coupled_legs_squat_shift_lift_a_foot_and_lean_on_a_slope(tmp_path: Path) -> None:
    """Reference: simulation of each stand; on the slope the feet creep."""
    robot = load(belts(tmp_path))
    verify_held_stand(robot, pa.StandTask(height=0.9 * robot.stand_height))
    verify_held_stand(robot, pa.StandTask(offset=(0.02, 0.01)))
    verify_held_stand(robot, pa.StandTask(swing={"FL_calf": 0.03}, com_margin=0.005))
    task = pa.StandTask(ground=pa.Ground(slope=0.02))
    found = pa.verify_stand(robot, pa.stance.solve_stand_on_soft_ground(robot, task))
    assert max(found.torque_error, found.force_error) < 1e-3


def test_loops_with_hinges_that_the_urdf_lacks_are_refused_unless_the_mjcf_is_alone(
    tmp_path: Path,
) -> None:
    pair = four_bars(tmp_path, in_urdf=False)
    with pytest.raises(pa.ModelError, match=r"FL_pin.*: give the MJCF alone"):
        load(pair)
    assert pa.load_robot(pair.mjcf).closure is not None


@pytest.mark.parametrize("is_alone", [False, True])
def test_loops_with_ball_joints_are_refused_with_advice_that_helps(
    tmp_path: Path, is_alone: bool
) -> None:
    """Cassie's Achilles rods have ball joints, which would lock the loop if fixed.

    Reference: the MJCF loads if a hinge replaces each ball joint.
    """
    pair = four_bars(tmp_path, in_urdf=False)
    axis = '<joint name="{}_pin" axis="0 1 0" range="-3 3" />'
    ball = '<joint name="{}_rod" type="ball" />'
    rewrite_file(pair.mjcf, *((axis.format(leg), ball.format(leg)) for leg in LEGS))
    with pytest.raises(pa.ModelError, match=r"FL_rod.*: replace each ball joint by three hinges"):
        pa.load_robot(pair.mjcf) if is_alone else load(pair)


@pytest.mark.slow
def test_weld_in_a_plane_closes_a_loop_like_a_connect(tmp_path: Path) -> None:
    """A weld ties three ways in the plane: with another hinge at the rod's end it is a connect."""
    folders = [tmp_path / name for name in ("one", "two")]
    for folder in folders:
        folder.mkdir()
    first, second = load(four_bars(folders[0])), load(hinge_rods(four_bars(folders[1])))
    assert second.closure is not None
    assert len(second.closure.dependent_joints) == 12
    stand = pa.stance.solve_stand_on_soft_ground(second)
    # It stands as predicted, and for no longer than some 20 s: welds are softer, and it buckles.
    seen = pa.verify_stand(second, stand)
    assert max(seen.torque_error, seen.force_error) < 1e-5
    (mode,) = seen.stability.modes_growing_within()[:1]
    assert not mode.shakes
    task = pa.StandTask(height=stand.task.height)
    wanted, torques = (
        pa.stance.stand_statics(variant, pa.solve_stand(variant, task)).joint_torques
        for variant in (first, second)
    )
    for name in (f"{leg}_{joint}" for leg in LEGS for joint in ("roll", "pitch", "motor")):
        assert joint_value(second, torques, name) == pytest.approx(
            joint_value(first, wanted, name), abs=1e-2
        )


@pytest.mark.slow
def test_four_bar_pins_may_be_continuous_or_without_limits(tmp_path: Path) -> None:
    """Reference: simulation of the stand."""
    pair = four_bars(tmp_path)
    limited = pair.mjcf.read_text()
    free = re.sub(r'(_pin" axis="0 1 0") range="-3 3"', r"\1", limited)
    assert free != limited
    pair.mjcf.write_text(free)
    text = pair.urdf.read_text()
    pair.urdf.write_text(re.sub(r'("\w\w_pin" type=)"revolute"', r'\1"continuous"', text))
    verify_held_stand(load(pair))
    ending = r'("\w\w_pin".*?<limit )lower="-?[\d.]+" upper="[\d.]+" '
    silent, count = re.subn(ending, r"\1", text, flags=re.DOTALL)
    assert count == 4
    pair.urdf.write_text(silent)
    verify_held_stand(load(pair))


@pytest.mark.slow
def test_equality_of_tendon_lengths_couples_joints(tmp_path: Path) -> None:
    """Closed form: knee + 0.8 motor = -0.2 rad, from two fixed tendons; and the simulation."""
    pair = belts(tmp_path)
    text = pair.mjcf.read_text()
    begin, end = text.index("<equality>"), text.index("</equality>")
    tendons = "".join(
        f'<fixed name="{leg}"><joint joint="{leg}_knee" coef="1"/>'
        f'<joint joint="{leg}_motor" coef="0.8"/></fixed>'
        for leg in LEGS
    )
    ties = "".join(f'<tendon tendon1="{leg}" polycoef="-0.2" solref="0.01 1"/>' for leg in LEGS)
    pair.mjcf.write_text(f"{text[:begin]}<tendon>{tendons}</tendon><equality>{ties}{text[end:]}")
    robot = load(pair)
    assert not any("<mimic>" in str(note) for note in robot.notes)
    qpos = pa.solve_stand(robot).qpos
    motor = joint_value(robot, qpos, "FL_motor")
    assert joint_value(robot, qpos, "FL_knee") == pytest.approx(-0.2 - 0.8 * motor, abs=1e-9)
    verify_held_stand(robot)


@pytest.mark.slow
def test_constraint_to_the_world_is_named_if_the_stand_fails(tmp_path: Path) -> None:
    """The unmodified file ties the trunk to the world; the verdict fails and names the
    constraint.
    """
    pair = quadruped(tmp_path)
    tie = '<equality><connect name="tied" body1="trunk" anchor="0.1 0 0"/></equality><actuator>'
    rewrite_file(pair.mjcf, ("<actuator>", tie))
    robot = load(pair)
    found = judge_stand(robot, pa.stance.solve_stand_on_soft_ground(robot))
    assert not found.passed
    assert found.published is not None
    assert ("connect", ("tied",)) in [
        (cause.code, cause.elements) for cause in found.published.causes
    ]


@pytest.mark.parametrize("active", ["true", "false"])
def test_dependent_joint_of_an_inactive_coupling_is_not_preferred(active: str) -> None:
    """Without the coupling of "a" to "c", only "b" follows "a", as the active coupling states."""
    rod = '<geom type="capsule" fromto="0 0 0 0 0 -.2" size=".02"/>'
    links = "".join(f'<body><joint name="{name}" axis="0 1 0"/>{rod}' for name in "abc")
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><worldbody>{links}{"</body>" * 3}</worldbody><equality>
        <joint joint1="a" joint2="c" active="{active}"/><joint joint1="b" joint2="a"/></equality>
        <actuator><motor joint="c"/></actuator></mujoco>"""
    )
    closure = find_closure(model, MujocoConvention.from_model(model, "abc"), "abc")
    assert closure is not None
    dependent = ["abc"[joint] for joint in closure.dependent_joints]
    assert dependent == (["a", "b"] if active == "true" else ["b"])


@pytest.mark.slow
def test_motors_of_a_fixed_base_hold_the_coupled_joints(tmp_path: Path) -> None:
    """Reference: virtual work, with a knee that turns -0.8 times as far as its motor."""
    pair = belts(tmp_path)
    robot = pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf, fixed_base=True)
    qpos = np.zeros(robot.nq)
    for leg in LEGS:
        qpos[robot.joint_names.index(f"{leg}_motor")] = 1.0
        qpos[robot.joint_names.index(f"{leg}_knee")] = -1.0
    config = pa.Configuration(robot, qpos)
    torques, tree = pa.gravity_compensation(config).joint_torques, config.gravity()
    for leg in LEGS:
        assert joint_value(robot, torques, f"{leg}_knee") == 0.0
        assert joint_value(robot, torques, f"{leg}_motor") == pytest.approx(
            joint_value(robot, tree, f"{leg}_motor") - 0.8 * joint_value(robot, tree, f"{leg}_knee")
        )


@pytest.mark.slow
def test_robot_without_loops_or_connected_to_the_world_has_no_closure(tmp_path: Path) -> None:
    assert load(quadruped(tmp_path)).closure is None
    (tmp_path / "tied").mkdir()
    pair = belts(tmp_path / "tied")
    tie = '<equality><connect body1="trunk" anchor="0 0 0" solref="0.1 1"/>'
    pair.mjcf.write_text(pair.mjcf.read_text().replace("<equality>", tie))
    assert load(pair).closure is None


@pytest.mark.slow
def test_motors_at_both_ends_of_a_belt_hold_the_stand(tmp_path: Path) -> None:
    """Statics has no unique distribution: each motor exerts its commanded torque."""
    pair = belts(tmp_path)
    knees = "".join(f'<motor joint="{leg}_knee" ctrlrange="-30 30"/>' for leg in LEGS)
    pair.mjcf.write_text(pair.mjcf.read_text().replace("<actuator>", f"<actuator>{knees}"))
    robot = load(pair)
    assert robot.closure is not None
    stand = verify_held_stand(robot)
    torques = pa.stance.stand_statics(robot, stand).joint_torques
    assert abs(joint_value(robot, torques, "FL_knee")) > 1


@pytest.mark.slow
def test_robot_with_belts_withstands_a_push_and_a_sweep_of_gains(tmp_path: Path) -> None:
    """Reference: MuJoCo's simulation of a push and of one pair of gains."""
    robot = load(belts(tmp_path))
    stand = pa.stance.solve_stand_on_soft_ground(robot)
    sweep = pa.simulation.sweep_gains(robot, stand, kp=[110.0], kd=[5.5], duration=2.0)
    assert sweep.height_deviation.max() < 1e-3
    assert not pa.simulation.simulate_push(robot, stand, 1.0, duration=3.0).failure
