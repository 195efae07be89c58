"""Robots with a fixed base: torques, worst postures, payloads and forces, compared with independent
computations.

    python benchmarks/arms.py panda.urdf shadow_hand/right_hand.xml ...

For each file (a URDF, an MJCF, or both joined by a comma), with a fixed base, the table contains:

- apart: largest difference between the static joint torques of both engines in 100 postures,
  relative to the largest gravity torque (without MuJoCo's gravity compensation);
- beyond: largest static torque of any joint in 10^5 random postures (5,000 for nonlinear loops),
  relative to the result of the search for the worst posture; at most 1, except for rounding;
- motors, servos: payload [kg] at the tool that the motors, or the servos, hold in the posture;
- 0.98, 1.02: whether MuJoCo holds this fraction of the smaller payload as long as ``hold``
  simulates. With dry friction in the model, the result without friction is added;
- edges: largest relative difference between the force polytope in 50 directions and linear
  programs with MuJoCo's Jacobian and torques;
- weakest: relative difference between the smallest maximal force and the distance of the nearest
  face of the polytope.

Times are processor times: of loading, and of loading and ``hold`` together.
"""

from __future__ import annotations

import time
from pathlib import Path

import click
import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

import pupper_analysis as pa
from pupper_analysis.present.verdict import verdict_word
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tool import with_payload
from pupper_analysis.simulation.verify import verify_stand
from pupper_analysis.stance.posture import held_stand
from pupper_analysis.stance.soft_ground import solve_stand_as_simulated
from pupper_analysis.statics.polytope import force_inequalities, force_limits_along
from pupper_analysis.tools.hold.hold import Hold, hold_posture
from pupper_analysis.tools.hold.motions import JointMotions

Array = NDArray[np.float64]

POSTURES, SAMPLES, BOUND, DIRECTIONS = 100, 100_000, 5_000, 50
"""Number of postures in which both engines are compared; number of random postures for the worst
torque, without and with nonlinear loops; number of random directions of the force. Chosen, not
tuned."""


class MujocoStatics:
    """Statics of a robot with a fixed base, evaluated by MuJoCo alone."""

    def __init__(self, robot: Robot) -> None:
        self.robot, self.data = robot, mujoco.MjData(robot.mj_model)

    def load(self, qpos: Array) -> Array:
        """Return the joint torques (nu,) [N m, N] that hold a configuration at rest."""
        self.robot.mj_convention.set_state(self.data, qpos)
        mujoco.mj_fwdPosition(self.robot.mj_model, self.data)
        mujoco.mj_fwdVelocity(self.robot.mj_model, self.data)
        held = self.data.qfrc_bias - self.data.qfrc_passive
        return np.array(held[self.robot.mj_convention.qvel_index])

    def gravity(self, postures: list[Array]) -> float:
        """Return the largest gravity torque [N m, N] of some postures, without gravity
        compensation.
        """
        found = 0.0
        for qpos in postures:
            self.load(qpos)
            found = max(found, float(np.abs(self.data.qfrc_bias).max()))
        return found

    def jacobian(self, held: Hold) -> Array:
        """Return the position Jacobian (3, nu) of the tool in the held posture, world frame."""
        model, rows = self.robot.mj_model, np.zeros((3, self.robot.mj_model.nv))
        self.load(held.posture.qpos)
        body, place = held.tool.locate_in_mjcf(self.robot)
        number = model.body(body).id
        point = self.data.xpos[number] + self.data.xmat[number].reshape(3, 3) @ place
        mujoco.mj_jac(model, self.data, rows, None, point, number)
        return np.array(rows[:, self.robot.mj_convention.qvel_index])


def project_on_motors(robot: Robot, qpos: Array, forces: Array) -> Array:
    """Return the part of joint forces (nu,) that the motors bear; loops and couplings bear the
    rest.
    """
    return Configuration(robot, qpos).transfer_to_motors(forces)


def compare_with_samples(robot: Robot, held: Hold, own: MujocoStatics, gravity: float) -> float:
    """Return the largest static torque of random postures, relative to the worst posture that was
    found.

    Args:
        robot: Robot with a fixed base.
        held: Result of ``hold``, with the worst posture.
        own: Statics of the robot by MuJoCo.
        gravity: Largest gravity torque [N m, N]; smaller torques than 1e-9 of it count as
            rounding.
    """
    motions = JointMotions(robot, held.posture)
    rng = np.random.default_rng(1)
    alone = robot.closure is None
    if alone:
        postures = rng.uniform(*motions.ranges.T, size=(SAMPLES, robot.nu))
    else:  # each loop that bends is closed anew, by some 15 ms
        bends = bool(motions.nonlinear.any())
        postures = np.array(motions.draw_postures(BOUND if bends else SAMPLES))
    same = bool(motions.constant.all())  # couplings pass on the same parts everywhere
    parts = np.eye(robot.nu) if alone else project_on_motors(robot, postures[0], np.eye(robot.nu))
    most = np.zeros(robot.nu)
    for qpos in postures:
        load = own.load(qpos)
        most = np.maximum(
            most, np.abs(parts @ load if same else project_on_motors(robot, qpos, load))
        )
    found, scale = np.abs(held.worst.joint_torques), 1e-9 * max(gravity, 1e-300)
    return float((most / np.maximum(found, scale)).max())


def simulate_payload(robot: Robot, held: Hold, share: float) -> str:
    """Simulate a fraction of the payload limit, and return "holds", "fails" or "-" (no finite
    limit).
    """
    mass = share * min(held.payload.mass, held.payload.servos)
    if not 0 < mass < np.inf:
        return "-"
    loaded = with_payload(robot, mass, held.tool)
    word = simulate_posture(loaded, held)
    if word == "holds" and robot.mj_model.dof_frictionloss.any():
        loaded.mj_model.dof_frictionloss[:] = 0.0
        word += f" (without friction: {simulate_posture(loaded, held)})"
    return word


def simulate_posture(robot: Robot, held: Hold) -> str:
    """Simulate a robot in the held posture, and return "holds" or "fails"."""
    stand = solve_stand_as_simulated(robot, held_stand(robot, held.posture))
    return "holds" if verify_stand(robot, stand).passed else "fails"


def compare_polytope(robot: Robot, held: Hold, own: MujocoStatics) -> tuple[float, float]:
    """Compare the force polytope with linear programs that use MuJoCo's Jacobian and torques.

    Returns:
        Largest relative difference of the limits in `DIRECTIONS` random directions, and
        relative
        difference of the smallest maximal force.
    """
    qpos, limits = held.posture.qpos, robot.effort_limits
    limited = np.isfinite(limits)
    load = project_on_motors(robot, qpos, own.load(qpos))
    rows = project_on_motors(robot, qpos, own.jacobian(held).T)
    faces = np.concatenate([rows[limited], -rows[limited]])
    room = np.concatenate([(limits + load)[limited], (limits - load)[limited]])
    rng = np.random.default_rng(2)
    directions = rng.normal(size=(DIRECTIONS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    inequalities = force_inequalities(pa.Configuration(robot, qpos), held.tool)
    found, _ = force_limits_along(*inequalities, directions)
    off = 0.0
    for way, most in zip(directions, found, strict=True):
        programme = linprog([-1.0], A_ub=(faces @ way)[:, None], b_ub=room, bounds=(0, None))
        edge = float(programme.x[0]) if programme.status == 0 else np.inf
        off = max(off, 0.0 if edge == most else abs(edge - most) / max(edge, 1e-9))
    # The nearest face is the greatest ball's: centred at the origin, its radius by a programme.
    lengths = np.linalg.norm(faces, axis=1)
    feels = lengths > 1e-9
    ball = linprog([-1.0], A_ub=lengths[feels][:, None], b_ub=room[feels], bounds=(0, None))
    least = float(ball.x[0]) if ball.status == 0 else np.inf
    weakest = held.force.weakest
    return off, 0.0 if least == weakest else abs(least - weakest) / max(least, 1e-9)


def make_row(files: str) -> str:
    """Return the row of a robot in the Markdown table."""
    models, name = [Path(one) for one in files.split(",")], files.split(",")[0]
    name = "/".join(Path(name).parts[-2:])
    begin = time.process_time()
    try:
        robot = pa.load_robot(*models)
        robot = pa.load_robot(*models, fixed_base=True) if robot.floating else robot
        loaded = time.process_time() - begin
        held = hold_posture(robot)
    except pa.PupperAnalysisError as error:
        return f"| {name} | | {type(error).__name__}: {str(error)[:110]} |"
    took, own = time.process_time() - begin, MujocoStatics(robot)
    postures = JointMotions(robot, held.posture).draw_postures(POSTURES)
    both = [(Configuration(robot, qpos).static_load(), own.load(qpos)) for qpos in postures]
    gravity = own.gravity(postures)
    apart = max(float(np.abs(one - other).max()) for one, other in both) / max(gravity, 1e-300)
    beyond = compare_with_samples(robot, held, own, gravity)
    edge, least = compare_polytope(robot, held, own)
    lasts, breaks = simulate_payload(robot, held, 0.98), simulate_payload(robot, held, 1.02)
    payload = held.payload
    return (
        f"| {name} | {robot.nu} | {verdict_word(held.verdict).en} | {loaded:.1f} | {took:.1f} "
        f"| {apart:.0e} | {beyond:.6f} | {payload.mass:.3g} "
        f"| {payload.servos:.3g} | {lasts} | {breaks} | {edge:.0e} | {least:.0e} |"
    )


@click.command()
@click.argument("files", nargs=-1, required=True)
def main(files: tuple[str, ...]) -> None:
    """Print a Markdown table with a row for each of FILES."""
    columns = (
        *("file", "joints", "verdict", "load (s)", "hold (s)", "apart", "beyond"),
        *("motors (kg)", "servos (kg)", "0.98", "1.02", "edges", "weakest"),
    )
    print(f"| {' | '.join(columns)} |")
    print("|" + "---|" * len(columns))
    for one in files:
        print(make_row(one), flush=True)


if __name__ == "__main__":
    main()
