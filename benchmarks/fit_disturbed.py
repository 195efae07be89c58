"""Fits to stands of robots with effects that the fit does not model: stiction, backlash, cables,
swapped plugs.

    python benchmarks/fit_disturbed.py [--robot v3] [--kp 60] [--only none --only stiction-0.1]
        [--seeds 2] [--single] [--csv docs/data/fit-disturbances.csv]

Stands are planned by ``fit --plan``, and simulated in MuJoCo alone: with the bodies and contacts of
the MJCF, random errors of masses (15 %), CoM positions (10 mm), encoder offsets (1.5 deg) and kp
(15 %, half of it common), and ``noslip``. Servos are explicit torques. Dry friction is a bristle: a
spring to a point that is dragged along above the friction torque (MuJoCo's own friction creeps).
Each stand is released 1 cm above the ground. After 4 s the commands lead by 1.3 and then by 0.7
times their lead, and return within 2 s each; an encoder of 14 bits is read 1 s later, and the mean
is the measurement, as the recorder of `fit --record` does it. With ``--single`` the positions are
read once, after 4 s. Each seed has a plan of its own, because dry friction at rest belongs to the
posture. The feet that carry load are known; stands with fewer than three such feet, or that move,
are left out. The stands are then fitted with default priors and ``--weight``.

For each disturbance, the number of EXPLAINED fits is counted, the number of measured 95 % intervals
that contain the true value, the diagnostics of other fits, and the refusals. Of the encoder zeros,
which share a weak direction, also chi2 of all zeros together is printed: its mean is their number.
"""

from __future__ import annotations

import argparse
import csv
import functools
import math
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
import numpy as np

import pupper_analysis as pa
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import model_with_servos, resolve_servo_gains
from pupper_analysis.tools.fit.measurements.stands import MeasuredStands, format_stands, read_stands
from pupper_analysis.tools.fit.parameters import PARAMETER_KINDS, list_bodies
from pupper_analysis.tools.fit.record.recorder import LEAD_RATIOS
from pupper_analysis.tools.fit.stands.fit import (
    KNOWN_MASS_FRACTION,
    SCALE_RTOL,
    StandFit,
    fit_stands,
)
from pupper_analysis.tools.fit.stands.plan import PlannedStand, StandPlan, plan_stands
from pupper_analysis.tools.study.parameters import scale_robot

MASS, COM, OFFSET, KP = 0.15, 0.01, math.radians(1.5), 0.15
"""Standard deviations of the errors of masses (relative), CoM positions [m], encoder offsets [rad]
and kp (relative)."""

MAX_OFFSET_TORQUE = 0.05
"""Mean torque that an encoder offset causes in a servo, relative to weight times height. With more
torque the robot slides or lifts a foot when released, so the error is known before the fit."""

V3_TORQUE = 3.17 * 9.81 * 0.158
"""Weight times height of Pupper v3 [N m], by which friction is scaled to other robots."""

BRISTLE_DEFLECTION = 2e-3
"""Joint displacement [rad] at which the bristle has the full friction torque."""

FOOT_FRICTION = (1e-3, 2e-4)
"""Torsional and rolling friction of a rubber foot [m]."""

TIMESTEP = 1e-3
"""Time step of the simulation [s]."""

RAMP_SECONDS, RETURN_SECONDS, REST_SECONDS = 0.5, 2.0, 1.0
"""Durations [s] in which the commands lead, return, and rest before a reading."""


@dataclass(frozen=True, eq=False)
class Planted:
    """Robot with known errors.

    Attributes:
        stated: Robot as specified by its files.
        robot: Robot with the true masses and CoM positions.
        kp: True stiffness (nu,) [N m/rad].
        offsets: True encoder offsets (nu,) [rad].
        truth: {name of an estimate: true value}.
        scale: Ratio of the weighed to the true mass.
        added: Errors of a known mass (4,): factor of the mass, and displacement [m].
    """

    stated: Robot
    robot: Robot
    kp: np.ndarray
    offsets: np.ndarray
    truth: dict[str, float]
    scale: float
    added: np.ndarray


def offset_std(robot: Robot) -> float:
    """Return the standard deviation of the encoder offsets [rad]."""
    weight = robot.total_mass * float(np.linalg.norm(robot.gravity))
    return min(
        OFFSET,
        MAX_OFFSET_TORQUE
        * weight
        * robot.stand_height
        / float(resolve_servo_gains(robot).kp.mean()),
    )


def plant_errors(robot: Robot, rng: np.random.Generator) -> Planted:
    """Return a robot with random errors."""
    factors, truth, names = {}, {}, robot.joint_names
    for link, number in list_bodies(robot):
        body = robot.structure.model.inertias[number]
        factor, moved = max(0.3, 1 + MASS * rng.normal()), COM * rng.normal(size=3)
        factors[f"mass:{link}"], truth[f"mass {link}"] = factor, body.mass * factor
        for axis, stated, off in zip("xyz", body.lever, moved, strict=True):
            factors[f"com_{axis}:{link}"], truth[f"com.{axis} {link}"] = off, stated + off
    common, own = rng.normal(), rng.normal(size=robot.nu)
    stiffness = resolve_servo_gains(robot).kp * (1 + KP * math.sqrt(0.5) * (common + own))
    rng.normal(size=robot.nu)  # of friction, once: seeds are of the same robots still
    offsets = offset_std(robot) * rng.normal(size=robot.nu)
    for kind, values in (("kp", stiffness), ("offset", offsets)):
        truth |= {f"{kind} {n}": float(one) for n, one in zip(names, values, strict=True)}
    true = replace(scale_robot(robot, factors), fingerprint=robot.fingerprint)
    scale = 1 + SCALE_RTOL * rng.normal()
    widths = [PARAMETER_KINDS[kind].width for kind in ("added", "place", "place", "place")]
    added = np.array([1.0, 0.0, 0.0, 0.0]) + widths * rng.normal(size=4)
    return Planted(robot, true, stiffness, offsets, truth, scale, added)


@dataclass(frozen=True)
class Disturbance:
    """Effects in the robot and its stands that the fit does not model.

    Attributes:
        stiction: Static friction [N m on v3]; the friction of the files is removed.
        deadband: Servo error without torque [rad].
        cable: Force on the base, backwards and up, relative to the weight.
        pack: Mass on the base that is added after weighing, relative to the robot's mass.
        weight: Factor of the weighed mass.
        backlash: Backlash of the gears [rad]; the encoder is on the side of the motor.
        plate: Height of the ground below the first foot [m].
        slope: Slope of the ground [rad].
        swapped: Whether two plugs are exchanged.
        negated: Whether a joint has the opposite sign.
        soft: Factor of the kp of one servo.
        calf: Factor of the length of the last link of one leg.
        calves: Factor of the length of the last link of all legs.
        lean: Lateral force on the base, relative to the weight.
        drop: Height from which the robot is released [m].
        bits: Resolution of the encoders [bit].
        seconds: Time of the measurement after the release [s].
        added: Known mass that is added for some stands, relative to the robot's mass.
        belt: Compliance of the belts, relative to 1 / kp; the encoder is on the side of the motor.
        drift: Relative decrease of all kp from the first to the last stand.
        integral: Rate of an integral action [1/s], relative to kp.
        command_step: Resolution of the commands [rad].
        nonlinearity: Amplitude of an encoder error with two periods per turn [rad].
        sag: Relative decrease of all torques if all motors have full torque.
    """

    stiction: float = 0.02
    deadband: float = 0.0
    cable: tuple[float, float] = (0.0, 0.0)
    pack: float = 0.0
    weight: float = 1.0
    backlash: float = 0.0
    plate: float = 0.0
    slope: float = 0.0
    swapped: bool = False
    negated: bool = False
    soft: float = 1.0
    calf: float = 1.0
    calves: float = 1.0
    lean: float = 0.0
    drop: float = 0.01
    bits: int = 14
    seconds: float = 4.0
    added: float = 0.0
    belt: float = 0.0
    drift: float = 0.0
    integral: float = 0.0
    command_step: float = 0.0
    nonlinearity: float = 0.0
    sag: float = 0.0


PLAIN = Disturbance()
"""Disturbance with the default values."""

DISTURBANCES: Mapping[str, Disturbance] = {
    "none": PLAIN,
    "none, known mass": replace(PLAIN, added=KNOWN_MASS_FRACTION),
    "dead band 0.3 deg": replace(PLAIN, deadband=math.radians(0.3)),
    "cable carries 5 %": replace(PLAIN, cable=(0.0, 0.05)),
    "cable carries 5 %, known mass": replace(PLAIN, cable=(0.0, 0.05), added=KNOWN_MASS_FRACTION),
    "cable back 2 %, up 3 %": replace(PLAIN, cable=(0.02, 0.03)),
    "pack of 10 % after weighing": replace(PLAIN, pack=0.1),
    "pack of 10 % after weighing, known mass": replace(PLAIN, pack=0.1, added=KNOWN_MASS_FRACTION),
    "weight 2.15 times": replace(PLAIN, weight=2.15),
    "weight 2.15 times, known mass": replace(PLAIN, weight=2.15, added=KNOWN_MASS_FRACTION),
    "stiction 0.05 N m": replace(PLAIN, stiction=0.05),
    "stiction 0.1 N m": replace(PLAIN, stiction=0.1),
    "stiction 0.2 N m": replace(PLAIN, stiction=0.2),
    "backlash 0.5 deg": replace(PLAIN, backlash=math.radians(0.5)),
    "foot on 2 mm": replace(PLAIN, plate=2e-3),
    "slope 0.5 deg": replace(PLAIN, slope=math.radians(0.5)),
    "slope 1 deg": replace(PLAIN, slope=math.radians(1.0)),
    "slope 1.5 deg": replace(PLAIN, slope=math.radians(1.5)),
    "swapped plugs": replace(PLAIN, swapped=True),
    "wrong sign": replace(PLAIN, negated=True),
    "one kp -30 %": replace(PLAIN, soft=0.7),
    "one calf 4 % longer": replace(PLAIN, calf=1.04),
    "all calves 4 % longer": replace(PLAIN, calves=1.04),
    "leans by 2 %": replace(PLAIN, lean=0.02),
    "dropped from 3 cm": replace(PLAIN, drop=0.03),
    "12 bits": replace(PLAIN, bits=12),
    "read after 2 s": replace(PLAIN, seconds=2.0),
    "belt of 10 kp": replace(PLAIN, belt=0.1),
    "kp drifts by 5 %": replace(PLAIN, drift=0.05),
    "integral action 1 % per s": replace(PLAIN, integral=0.01),
    "commands of 0.3 deg": replace(PLAIN, command_step=math.radians(0.3)),
    "encoder off by 0.2 deg": replace(PLAIN, nonlinearity=math.radians(0.2)),
    "supply sags by 10 %": replace(PLAIN, sag=0.1),
}
"""{name: disturbance}."""


DRAWN = "drawn"
"""Name of a random disturbance."""


def draw_disturbance(planted: Planted, kp: np.ndarray, seed: int) -> tuple[Planted, Disturbance]:
    """Draw the quantities that no file specifies from the priors of the fit.

    Load (8 % of the weight), slope (0.2 deg), dead band (1 deg; a negative value is static friction
    with the same effect), and lengths of the last links (0.5 %).

    Args:
        planted: Robot with errors.
        kp: Specified stiffness (nu,) [N m/rad].
        seed: Seed of the random numbers.
    """
    load, slope, band, *legs = np.random.default_rng([seed, 77]).normal(size=8)[:7]
    robot, width = (
        planted.stated,
        {one: PARAMETER_KINDS[one].width for one in ("load", "slope", "deadband")},
    )
    lasts = [robot.joint_names[joint] for joint in last_joints(robot)]
    longer = {f"length:{n}": 1 + 0.005 * one for n, one in zip(lasts, legs, strict=False)}
    true = replace(scale_robot(planted.robot, longer), fingerprint=robot.fingerprint)
    truth = dict(planted.truth)
    for link, number in list_bodies(true):
        lever = true.structure.model.inertias[number].lever
        truth |= {f"com.{axis} {link}": float(at) for axis, at in zip("xyz", lever, strict=True)}
    band *= width["deadband"]
    sticks = -band * float(kp.mean()) / (robot.weight * robot.stand_height / V3_TORQUE)
    other = replace(
        PLAIN,
        cable=(0.0, -width["load"] * load),
        slope=width["slope"] * slope,
        deadband=max(0.0, band),
        stiction=PLAIN.stiction if band > 0 else max(0.005, sticks),
    )
    return replace(planted, robot=true, truth=truth), other


class Rig:
    """Robot in MuJoCo alone, with explicit servos and friction.

    Args:
        planted: Robot with known errors.
        other: Disturbance.
    """

    def __init__(self, planted: Planted, other: Disturbance, *, single: bool = False) -> None:
        self.single = single
        stated, self.other = planted.stated, other
        factors = {}
        last = [stated.joint_names[j] for j in last_joints(stated)]
        if other.calf != 1:
            factors[f"length:{last[0]}"] = other.calf
        if other.calves != 1:
            factors |= {f"length:{name}": other.calves for name in last}
        true = scale_robot(planted.robot, factors) if factors else planted.robot
        self.robot, self.planted = true, planted
        self.kp = planted.kp.copy()
        self.kp[last_joints(stated)[-1]] *= other.soft
        drive = model_with_servos(true, self.kp, resolve_servo_gains(stated, self.kp, None).kd)
        self.model = drive.model
        at = true.mj_convention
        self.qpos, self.dofs = at.qpos_index[7:], at.qvel_index[6:]
        self.every = at.qpos_index
        self.model.opt.timestep = TIMESTEP
        self.model.opt.noslip_iterations = 20
        self.model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        self.model.actuator_gainprm[:] = self.model.actuator_biasprm[:] = 0  # torques are our own
        self.model.dof_frictionloss[:] = 0
        # Feet of rubber: a patch of some millimetres turns and rolls. (With the 10 cm of v3's file
        # feet that grip would carry moments of 12 mm of their force.)
        self.model.geom_friction[:, 1:] = np.minimum(self.model.geom_friction[:, 1:], FOOT_FRICTION)
        self.model.pair_friction[:, 2:] = np.minimum(
            self.model.pair_friction[:, 2:], [FOOT_FRICTION[0], FOOT_FRICTION[1], FOOT_FRICTION[1]]
        )
        self.model.dof_damping[self.dofs] += drive.kd
        self.weight = true.weight
        scale = self.weight * stated.stand_height / V3_TORQUE
        self.friction = other.stiction * scale
        self.base = int(self.model.jnt_bodyid[self.model.jnt_type.argmin()])
        if other.plate:
            geom = next(g for g, f in true.foot_geoms.items() if f == next(iter(true.feet)))
            self.model.geom_margin[geom] += other.plate
        if other.pack:
            self.add_mass(
                other.pack * true.total_mass, np.array([0.3, 0.0, 0.3]) * stated.stand_height
            )
        self.limits = np.where(np.isfinite(true.effort_limits), true.effort_limits, 1e6)
        self.height = math.nan  # of the base (m), in the stand that was taken last
        self.progress = 0.0  # of the stands, from 0 to 1
        self.wiring, self.signs = np.arange(true.nu), np.ones(true.nu)
        if other.swapped:
            first, second = last_joints(stated)[:2]
            self.wiring[[first, second]] = second, first
        if other.negated:
            self.signs[last_joints(stated)[1]] = -1.0

    def add_mass(self, mass: float, place: np.ndarray) -> None:
        """Add a point mass to the base.

        Args:
            mass: Mass [kg].
            place: Position (3,) [m] in the base frame.
        """
        model, body = self.model, self.base
        had, com = float(model.body_mass[body]), model.body_ipos[body].copy()
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, model.body_iquat[body])
        turn = turn.reshape(3, 3)
        whole = (had * com + mass * place) / (had + mass)
        inertia = turn @ np.diag(model.body_inertia[body]) @ turn.T
        for m, at in ((had, com - whole), (mass, place - whole)):
            inertia += m * (at @ at * np.eye(3) - np.outer(at, at))
        values, axes = np.linalg.eigh(inertia)
        axes[:, 0] *= np.sign(np.linalg.det(axes))
        model.body_mass[body], model.body_ipos[body] = had + mass, whole
        model.body_inertia[body] = values
        mujoco.mju_mat2Quat(model.body_iquat[body], axes.ravel())
        mujoco.mj_setConst(model, mujoco.MjData(model))

    def simulate_stand(
        self, one: PlannedStand, place: np.ndarray
    ) -> tuple[np.ndarray, tuple[str, ...]] | None:
        """Simulate a planned stand, with its known mass.

        Args:
            one: Planned stand.
            place: Position of the known mass (3,) [m] in the base frame.

        Returns:
            Encoder readings (nu,) [rad], and the feet without load; None if the robot does not
            stand.
        """
        model = self.model
        had = {
            n: getattr(model, n).copy()
            for n in ("body_mass", "body_ipos", "body_inertia", "body_iquat")
        }
        if one.added:
            self.add_mass(one.added, place)
        try:
            return self._simulate_commands(one)
        finally:
            for name, values in had.items():
                getattr(model, name)[:] = values
            mujoco.mj_setConst(model, mujoco.MjData(model))

    def _simulate_commands(self, one: PlannedStand) -> tuple[np.ndarray, tuple[str, ...]] | None:
        """Simulate the commands of a stand; see `simulate_stand`."""
        other, true, model = self.other, self.robot, self.model
        offset = self.planted.offsets
        said = np.array([one.command[name] for name in true.joint_names])
        command = (self.signs * said)[self.wiring] - offset  # of each motor, true
        data = self._release_robot(one, command)
        if other.command_step:
            command = (
                np.round((command + offset) / other.command_step) * other.command_step - offset
            )
        limits, kp = self.limits, self.kp * (1 - other.drift * self.progress)
        sum_limits = float(np.minimum(limits, self.weight * true.stand_height).sum())
        torque, integral = np.zeros(true.nu), np.zeros(true.nu)
        bristle, friction = data.qpos[self.qpos].copy(), self.friction
        side = np.zeros(true.nu)

        def simulate(first: np.ndarray, last: np.ndarray, seconds: float) -> None:
            """Simulate the servos while the command moves from one position to another."""
            nonlocal bristle, side, torque, integral
            steps = max(1, int(seconds / TIMESTEP))
            for step in range(1, steps + 1):
                q = data.qpos[self.qpos]
                motor = q + other.backlash / 2 * side + other.belt * torque / kp
                error = first + step / steps * (last - first) - motor
                error = np.sign(error) * np.maximum(np.abs(error) - other.deadband, 0.0)
                integral += other.integral * TIMESTEP * error
                torque = np.clip(kp * (error + integral), -limits, limits)
                torque *= 1 - other.sag * float(np.abs(torque).sum()) / sum_limits
                side += 0.02 * (np.clip(torque / (0.05 * friction + 1e-9), -1, 1) - side)
                stretch = q - bristle
                held = np.clip(stretch / BRISTLE_DEFLECTION, -1, 1)
                bristle = q - BRISTLE_DEFLECTION * held
                data.qfrc_applied[self.dofs] = torque - friction * held
                mujoco.mj_step(model, data)

        def read() -> np.ndarray:
            """Return the positions of the motors (nu,) [rad]."""
            return np.asarray(
                data.qpos[self.qpos] + other.backlash / 2 * side + other.belt * torque / kp
            )

        simulate(command, command, other.seconds)
        readings = [read()]
        if not self.single:
            lead = command - readings.pop()
            for ratio in LEAD_RATIOS:
                beyond = command + (ratio - 1) * lead
                simulate(command, beyond, RAMP_SECONDS)
                simulate(beyond, command, RETURN_SECONDS)
                simulate(command, command, REST_SECONDS)
                readings.append(read())
        if not np.isfinite(data.qpos).all() or np.abs(data.qvel).max() > 0.02:
            return None
        self.height = float(data.qpos[self.every[2]])
        on = self._find_carrying_feet(data)
        if on is None or len(on) < 3:
            return None
        shown = [q + offset + other.nonlinearity * np.sin(2 * q) for q in readings]
        step = 2 * math.pi / 2**other.bits
        mean = np.mean([np.round(angles / step) * step for angles in shown], axis=0)
        back = np.empty_like(mean)
        back[self.wiring] = mean
        return self.signs * back, tuple(foot for foot in true.feet if foot not in on)

    def _find_carrying_feet(self, data: mujoco.MjData) -> set[str] | None:
        """Return the feet that carry load; None if another part of the robot touches the ground."""
        carry, force = Counter[str](), np.zeros(6)
        for number in range(data.ncon):
            contact = data.contact[number]
            mujoco.mj_contactForce(self.model, data, number, force)
            feet = {self.robot.foot_geoms.get(int(geom)) for geom in contact.geom} - {None}
            if not feet:
                return None
            carry[str(feet.pop())] += force[0]
        return {foot for foot, value in carry.items() if value > 0.005 * self.weight}

    def _release_robot(self, one: PlannedStand, command: np.ndarray) -> mujoco.MjData:
        """Return the state above the ground in the commanded posture, with gravity and cable."""
        other, true, model = self.other, self.robot, self.model
        data = mujoco.MjData(model)
        data.qpos[self.every] = self._pose_above_ground(command, one.swing, other.drop)
        size, along = float(np.linalg.norm(true.gravity)), math.sin(other.slope)
        c, s = math.cos(one.heading), math.sin(one.heading)
        model.opt.gravity[:] = size * np.array([c * along, -s * along, -math.cos(other.slope)])
        data.xfrc_applied[self.base, :3] = self.weight * np.array(
            [-other.cable[0], other.lean, other.cable[1]]
        )
        return data

    def _pose_above_ground(self, q: np.ndarray, swing: tuple[str, ...], drop: float) -> np.ndarray:
        """Return qpos with the carrying feet level.

        Args:
            q: Joint positions (nu,) [rad].
            swing: Feet without contact.
            drop: Height of the lowest foot above the ground [m].
        """
        robot = self.robot
        qpos = robot.make_qpos(q)
        data, model = mujoco.MjData(self.model), self.model
        geoms = [g for g, foot in robot.foot_geoms.items() if foot not in swing]
        every = list(robot.foot_geoms)
        for _ in range(3):
            data.qpos[self.every] = qpos
            mujoco.mj_kinematics(model, data)
            at = data.geom_xpos[geoms]
            (a, b, _c), *_ = np.linalg.lstsq(
                np.column_stack([at[:, :2], np.ones(len(at))]), at[:, 2], rcond=None
            )
            normal = np.array([-a, -b, 1.0]) / math.sqrt(1 + a * a + b * b)
            axis = np.cross(normal, [0, 0, 1.0])
            turn, new = np.array([1 + normal[2], *axis]), np.zeros(4)
            mujoco.mju_mulQuat(new, turn / np.linalg.norm(turn), qpos[3:7])
            qpos[3:7] = new
        data.qpos[self.every] = qpos
        mujoco.mj_kinematics(model, data)
        low = (data.geom_xpos[every, 2] - model.geom_rbound[every]).min()
        qpos[2] += drop - low
        return qpos


def last_joints(robot: Robot) -> list[int]:
    """Return the indices of the joints next to the feet, a joint per leg."""
    from pupper_analysis.robot.joints import leg_joints

    points = [own[0] for own in robot.feet.values()]
    return [robot.joint_names.index(leg_joints(robot, point)[-1]) for point in points]


def compute_effective_kp(rig: Rig) -> np.ndarray:
    """Return the ratio of torque to servo error in the measurements, shape (nu,) [N m/rad].

    Drift: the mean over the stands. Integral action of rate r [1/s]: the torque kp (e + r int e dt)
    of a robot at rest is constant, so that the error e decreases with exp(-r t). The measurement is
    the mean of the readings at the times t_i after the release:

        kp_effective = kp / mean(exp(-r t_i))
    """
    other = rig.other
    each = RAMP_SECONDS + RETURN_SECONDS + REST_SECONDS
    leads = range(1, len(LEAD_RATIOS) + 1)
    times = [other.seconds] if rig.single else [other.seconds + each * n for n in leads]
    decrease = float(np.mean(np.exp(-other.integral * np.array(times))))
    return np.asarray(rig.kp * (1 - other.drift / 2) / decrease)


def true_values(rig: Rig) -> dict[str, float]:
    """Return {name of an estimate: true value} of a simulated robot."""
    truth, robot = dict(rig.planted.truth), rig.planted.stated
    kp = compute_effective_kp(rig)
    truth |= {f"kp {n}": float(k) for n, k in zip(robot.joint_names, kp, strict=True)}
    truth["mass"] = rig.robot.total_mass  # of what was weighed; a pack is the load
    truth["load scale"] = rig.other.pack - rig.other.cable[1]
    base = robot.base
    if rig.other.pack:
        pack = rig.other.pack * rig.robot.total_mass
        had = truth[f"mass {base}"]
        at = np.array([0.3, 0.0, 0.3]) * robot.stand_height
        for axis, place in zip("xyz", at, strict=True):
            own = truth[f"com.{axis} {base}"]
            truth[f"com.{axis} {base}"] = (had * own + pack * place) / (had + pack)
        truth[f"mass {base}"] = had + pack
    return truth


def measure_stands(rig: Rig, plan: StandPlan) -> MeasuredStands | None:
    """Simulate the planned stands, and return the measurements; None if fewer than five succeed."""
    place = np.zeros(3) if plan.place is None else np.array(plan.place.offset)
    taken = []
    for number, one in enumerate(plan.stands):
        rig.progress = number / max(1, len(plan.stands) - 1)
        if (found := rig.simulate_stand(one, place)) is not None:
            taken.append((one, found))
    if len(taken) < 5:
        return None
    names, robot = rig.robot.joint_names, rig.robot
    loads = np.array([[one.added, *place] if one.added else [0.0] * 4 for one, _ in taken])
    return MeasuredStands(
        source="rig",
        names=tuple(one.name for one, _ in taken),
        joints=names,
        command=np.array([[one.command[n] for n in names] for one, _ in taken]),
        position=np.array([read for _, (read, _) in taken]),
        swing=tuple(swing for _, (_, swing) in taken),
        heading=np.array([one.heading for one, _ in taken]),
        added={robot.base: loads} if loads.any() else {},
    )


def load_or_measure_stands(
    name: str, title: str, seed: int, rig: Rig, plan: Callable[[], StandPlan], keep: Path | None
) -> MeasuredStands | None:
    """Return the measured stands from a file; simulate them and write the file if it is missing.

    Disturbances that differ only in the weighed mass share their stands.

    Args:
        name: Name of the robot.
        title: Name of the disturbance.
        seed: Seed of the robot.
        rig: Simulated robot.
        plan: Function that returns the plan.
        keep: Folder of the files; None for a temporary folder.
    """
    first = title
    if title != DRAWN:
        other = replace(DISTURBANCES[title], weight=1.0)
        first = next(own for own, one in DISTURBANCES.items() if one == other)
    with TemporaryDirectory() as folder:
        file = (keep or Path(folder)) / f"{name}-{first.replace(' ', '_')}-{seed}.csv"
        if not file.exists():
            file.parent.mkdir(parents=True, exist_ok=True)
            found = measure_stands(rig, plan())
            file.write_text("" if found is None else format_stands(found))
        return (
            misread_known_masses(read_stands(file), rig.planted.added)
            if file.stat().st_size
            else None
        )


def misread_known_masses(stands: MeasuredStands, off: np.ndarray) -> MeasuredStands:
    """Return stands whose known masses and positions have measurement errors.

    Args:
        stands: Stands with the true masses.
        off: Errors (4,): factor of the mass, and displacement [m].
    """
    added = {
        link: np.where(own[:, :1] > 0, np.hstack([own[:, :1] / off[0], own[:, 1:] - off[1:]]), 0.0)
        for link, own in stands.added.items()
    }
    return replace(stands, added=added)


@dataclass(frozen=True)
class Row:
    """Result of a fit.

    Attributes:
        robot: Name of the robot.
        disturbance: Name of the disturbance.
        seed: Seed of the robot.
        stands: Number of measured stands.
        outcome: EXPLAINED, named, NOT EXPLAINED, refused, or "does not stand".
        codes: Codes of the failures.
        held: Number of intervals that contain the true value, of values that the measurements
            determine.
        determined: Number of these intervals.
        spread: Root mean square of the errors of these values, in standard deviations.
        kp: Relative error of the common factor of all kp.
        kp_said: Half width of its 95 % interval, relative.
        zeros_held, zeros_determined: As ``held`` and ``determined``, of encoder zeros alone.
        zeros_chi2: d^T C^-1 d of the errors d of all encoder zeros, with their covariance C.
        zeros: Number of encoder zeros, the mean of this chi2.
    """

    robot: str
    disturbance: str
    seed: int
    stands: int
    outcome: str
    codes: str
    held: int = 0
    determined: int = 0
    spread: float = math.nan
    kp: float = math.nan
    kp_said: float = math.nan
    zeros_held: int = 0
    zeros_determined: int = 0
    zeros_chi2: float = math.nan
    zeros: int = 0


def run_fits(name: str, robot: Robot, kp: float | None, given: argparse.Namespace) -> Iterator[Row]:
    """Yield the result of each fit.

    Args:
        name: Name of the robot.
        robot: Robot.
        kp: Stiffness of all servos [N m/rad]; None for those of the file.
        given: Options of the command line.
    """

    @functools.cache
    def plan(added: float, seed: int) -> StandPlan:
        return plan_stands(robot, given.stands, kp=kp, added=added * robot.total_mass, seed=seed)

    had = set()
    if given.csv and given.csv.exists():
        with given.csv.open(newline="") as file:
            had = {(r["robot"], r["disturbance"], r["seed"]) for r in csv.DictReader(file)}
    for seed in range(given.first, given.first + given.seeds):
        for title, other in ({DRAWN: PLAIN} if given.drawn else DISTURBANCES).items():
            if (given.only and title not in given.only) or (name, title, str(seed)) in had:
                continue
            rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
            planted = plant_errors(robot, rng)
            if kp is not None:  # and not that of servos which were added
                planted = replace(planted, kp=planted.kp * kp / resolve_servo_gains(robot).kp)
            if given.drawn:
                planted, other = draw_disturbance(planted, resolve_servo_gains(robot, kp).kp, seed)
            longer = replace(other, seconds=max(other.seconds, given.seconds))
            rig = Rig(planted, longer, single=given.single)
            stands = load_or_measure_stands(
                name, title, seed, rig, partial(plan, other.added, seed), given.keep
            )
            if stands is None:
                yield Row(name, title, seed, 0, "does not stand", "")
                continue
            yield evaluate_fit(name, title, seed, robot, rig, stands, kp)


def evaluate_fit(
    name: str,
    title: str,
    seed: int,
    robot: Robot,
    rig: Rig,
    stands: MeasuredStands,
    kp: float | None,
) -> Row:
    """Fit the stands of a robot, and compare the estimates with the true values."""
    truth = true_values(rig)
    weight = rig.robot.total_mass * rig.other.weight * rig.planted.scale
    try:
        fit: StandFit = fit_stands(robot, stands, weight=weight, kp=kp)
    except pa.PupperAnalysisError as error:
        code = getattr(getattr(error, "cause", None), "code", type(error).__name__)
        return Row(name, title, seed, len(stands), "refused", code)
    stated = resolve_servo_gains(robot, kp, None if kp is None else 0.0).kp
    factor = float(np.exp(np.log(compute_effective_kp(rig) / stated).mean()))
    carried = truth["mass"] / robot.total_mass * (1 + truth["load scale"])
    truth["kp over mass"] = factor / carried
    derived = [replace(fit.total_mass, name="mass")]
    if fit.kp_over_mass is not None:
        derived.append(replace(fit.kp_over_mass, name="kp over mass"))
    determined = [
        one for one in (*derived, *fit.estimates) if one.name in truth and one.determined == "data"
    ]
    held = sum(one.low <= truth[one.name] <= one.high for one in determined)
    off = np.array([(one.mean - truth[one.name]) / one.std for one in determined])
    spread = math.sqrt(float(np.mean(off**2))) if len(off) else math.nan
    outcome = "EXPLAINED" if fit.explained else "named"
    codes = " ".join(dict.fromkeys(one.code for one in fit.failures))
    if not fit.explained and set(codes.split()) <= {"residuals-too-large", "far-from-the-file"}:
        outcome = "NOT EXPLAINED"
    by, half = math.nan, math.nan
    if fit.kp_factor is not None:
        by, half = fit.kp_factor.mean / factor - 1, 1.96 * fit.kp_factor.std / factor
    counts = int(held), len(determined), round(spread, 3)
    zeros = [one for one in determined if one.kind == "offset"]
    zeros_held = sum(one.low <= truth[one.name] <= one.high for one in zeros)
    posterior = fit.posterior
    rows = np.flatnonzero(posterior.kinds == "offset")
    errors = np.array([posterior.mean[r] - truth[posterior.parameters[r].name] for r in rows])
    chi2 = float(errors @ np.linalg.solve(posterior.covariance[np.ix_(rows, rows)], errors))
    return Row(
        *(name, title, seed, len(stands), outcome, codes, *counts, round(by, 4), round(half, 4)),
        *(zeros_held, len(zeros), round(chi2, 1), len(rows)),
    )


def main() -> None:
    """Run the fits that the command line selects, and print a row for each."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--robot", default="v3", help="a variant, or a file")
    parser.add_argument("--kp", type=float, help="of the servos, where the file states none")
    parser.add_argument("--only", action="append", help="a disturbance; may be repeated")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="seed")
    parser.add_argument("--stands", type=int, default=16)
    parser.add_argument("--drawn", action="store_true", help="draw what else there is, by the seed")
    parser.add_argument(
        "--seconds", type=float, default=0.0, help="read no sooner than after these"
    )
    parser.add_argument("--single", action="store_true", help="read each stand once")
    parser.add_argument("--keep", type=Path, help="a folder of measurements: what it has is used")
    parser.add_argument("--csv", type=Path, help="a file to add rows to, but for those that it has")
    given = parser.parse_args()
    known = given.robot in pa.VARIANTS
    robot = pa.load_variant(given.robot) if known else pa.load_robot(given.robot)
    for row in run_fits(Path(given.robot).stem, robot, given.kp, given):
        cells = list(vars(row).values())
        print(*cells, sep=" | ", flush=True)
        if given.csv:
            new = not given.csv.exists()
            with given.csv.open("a", newline="") as file:
                writer = csv.writer(file, lineterminator="\n")
                if new:
                    writer.writerow(vars(row))
                writer.writerow(cells)


if __name__ == "__main__":
    main()
