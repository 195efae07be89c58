"""Robots whose base is held: torques, worst postures, payloads and forces, proven otherwise.

    python benchmarks/arms.py panda.urdf shadow_hand/right_hand.xml ...

For each file (a URDF, an MJCF, or both joined by a comma), held by its base:

- apart: what is held by both engines at 100 postures, in parts of gravity's largest torque, which
  gravity compensation may take away;
- beyond: 10^5 postures' torques by MuJoCo (5,000 where loops bend), the most of any joint in parts
  of what the search for its worst posture found (1 or less, but for rounding);
- motors, servos: what either hold at the tool in the posture; 0.98, 1.02: whether MuJoCo holds
  such parts of the lesser, for as long as ``hold`` simulates; dry friction, where there is some,
  may hold more: then it is told what is held without;
- force: the polytope's edge in 50 directions, in parts by which it differs from linear
  programmes with MuJoCo's Jacobian and torques; then its least against the least of their nearest
  faces.

Times are the processor's: of loading, and of the whole of ``hold``.
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


class ByMujoco:
    """What MuJoCo says of a robot at rest."""

    def __init__(self, robot: Robot) -> None:
        self.robot, self.data = robot, mujoco.MjData(robot.mj_model)

    def load(self, qpos: Array) -> Array:
        """Returns what is held (nu,)."""
        self.robot.mj_convention.set_state(self.data, qpos)
        mujoco.mj_fwdPosition(self.robot.mj_model, self.data)
        mujoco.mj_fwdVelocity(self.robot.mj_model, self.data)
        held = self.data.qfrc_bias - self.data.qfrc_passive
        return np.array(held[self.robot.mj_convention.qvel_index])

    def gravity(self, postures: list[Array]) -> float:
        """Returns the greatest torque of gravity in postures, without its compensation."""
        found = 0.0
        for qpos in postures:
            self.load(qpos)
            found = max(found, float(np.abs(self.data.qfrc_bias).max()))
        return found

    def jacobian(self, held: Hold) -> Array:
        """Returns that of the tool (3, nu), at the posture."""
        model, rows = self.robot.mj_model, np.zeros((3, self.robot.mj_model.nv))
        self.load(held.posture.qpos)
        body, place = held.tool.locate_in_mjcf(self.robot)
        number = model.body(body).id
        point = self.data.xpos[number] + self.data.xmat[number].reshape(3, 3) @ place
        mujoco.mj_jac(model, self.data, rows, None, point, number)
        return np.array(rows[:, self.robot.mj_convention.qvel_index])


def by_motors(robot: Robot, qpos: Array, forces: Array) -> Array:
    """Returns what motors hold of forces, of which loops and couplings carry the rest."""
    return Configuration(robot, qpos).transfer_to_motors(forces)


def sampled(robot: Robot, held: Hold, own: ByMujoco, gravity: float) -> float:
    """Returns the most of random postures' torques in parts of what was found."""
    motions = JointMotions(robot, held.posture)
    rng = np.random.default_rng(1)
    alone = robot.closure is None
    if alone:
        postures = rng.uniform(*motions.ranges.T, size=(SAMPLES, robot.nu))
    else:  # each loop that bends is closed anew, by some 15 ms
        bends = bool(motions.nonlinear.any())
        postures = np.array(motions.draw_postures(BOUND if bends else SAMPLES))
    same = bool(motions.constant.all())  # couplings pass on the same parts everywhere
    parts = np.eye(robot.nu) if alone else by_motors(robot, postures[0], np.eye(robot.nu))
    most = np.zeros(robot.nu)
    for qpos in postures:
        load = own.load(qpos)
        most = np.maximum(most, np.abs(parts @ load if same else by_motors(robot, qpos, load)))
    found, scale = np.abs(held.worst.joint_torques), 1e-9 * max(gravity, 1e-300)
    return float((most / np.maximum(found, scale)).max())


def carried(robot: Robot, held: Hold, share: float) -> str:
    """Tells whether a part of the payload is held in simulation."""
    mass = share * min(held.payload.mass, held.payload.servos)
    if not 0 < mass < np.inf:
        return "-"
    loaded = with_payload(robot, mass, held.tool)
    word = held_by(loaded, held)
    if word == "holds" and robot.mj_model.dof_frictionloss.any():
        loaded.mj_model.dof_frictionloss[:] = 0.0
        word += f" (without friction: {held_by(loaded, held)})"
    return word


def held_by(robot: Robot, held: Hold) -> str:
    """Tells whether a robot holds the posture in simulation."""
    stand = solve_stand_as_simulated(robot, held_stand(robot, held.posture))
    return "holds" if verify_stand(robot, stand).passed else "fails"


def pushed(robot: Robot, held: Hold, own: ByMujoco) -> tuple[float, float]:
    """Returns by how much edges, and the weakest force, differ from linear programmes, in parts."""
    qpos, limits = held.posture.qpos, robot.effort_limits
    limited = np.isfinite(limits)
    load = by_motors(robot, qpos, own.load(qpos))
    rows = by_motors(robot, qpos, own.jacobian(held).T)
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


def row(files: str) -> str:
    """Returns a robot's row of the table."""
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
    took, own = time.process_time() - begin, ByMujoco(robot)
    postures = JointMotions(robot, held.posture).draw_postures(POSTURES)
    both = [(Configuration(robot, qpos).static_load(), own.load(qpos)) for qpos in postures]
    gravity = own.gravity(postures)
    apart = max(float(np.abs(one - other).max()) for one, other in both) / max(gravity, 1e-300)
    beyond = sampled(robot, held, own, gravity)
    edge, least = pushed(robot, held, own)
    lasts, breaks = carried(robot, held, 0.98), carried(robot, held, 1.02)
    payload = held.payload
    return (
        f"| {name} | {robot.nu} | {verdict_word(held.verdict).en} | {loaded:.1f} | {took:.1f} "
        f"| {apart:.0e} | {beyond:.6f} | {payload.mass:.3g} "
        f"| {payload.servos:.3g} | {lasts} | {breaks} | {edge:.0e} | {least:.0e} |"
    )


@click.command()
@click.argument("files", nargs=-1, required=True)
def main(files: tuple[str, ...]) -> None:
    """Prints a row of a Markdown table for each of FILES."""
    columns = (
        *("file", "joints", "verdict", "load (s)", "hold (s)", "apart", "beyond"),
        *("motors (kg)", "servos (kg)", "0.98", "1.02", "edges", "weakest"),
    )
    print(f"| {' | '.join(columns)} |")
    print("|" + "---|" * len(columns))
    for one in files:
        print(row(one), flush=True)


if __name__ == "__main__":
    main()
