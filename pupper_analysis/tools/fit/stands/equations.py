"""What must be zero of measured stands at rest, as a function of the parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.fit.estimate import Linearised
from pupper_analysis.tools.fit.measurements.stands import APPROACHES, MeasuredStands
from pupper_analysis.tools.fit.parameters import AXES, ParameterTable, bodies_of, give_widths
from pupper_analysis.tools.fit.stands.rows import (
    GravityRegressor,
    Numbers,
    Reading,
    StandNoise,
    StandRows,
    readings_of,
)

Array = NDArray[np.float64]

_SHOWS = 1.0
"""Standard deviations that the robot's weight makes: forces that show less are within a sole."""

_LOOKS = 2
"""Steps of a stand's own unknowns for each of the parameters': equations are linear in forces."""

_HARDLY_MOVES = 0.2
"""Of the fastest joint's: a joint that moves no faster may have come from either side. Of v3, which
is let down slowly in MuJoCo, on friction that does not creep, joints between 0.05 and 0.2 have 0.4
of their friction on the side that this says, with a standard deviation of 0.8."""

_MOBILISED = 0.9
"""Of dry friction: how much of it holds a joint that came slowly from a known side, on average:
0.94 and 0.88 of v3 with its own kp and with four times that, 0.8 of Go2."""


class StandEquations:
    """Balance of forces, contact with the ground, and what else was measured, of every stand.

    A stand's unknowns are the parameters, that all stands share, and its own: how the base is
    tilted and how high it is (3), and the force on every contact point (3 each). Its equations:

        S tau - g(q; masses, coms) + passive + sum J_p^T f_p = 0          (nv)
        z_p(q) - r_p + softness depth(f_p) = 0                            (one a contact point)
        tau = measured torque,  sum of f_z = scale's force,  tilt = IMU's    (where measured)

    with q = position - offset, tau = kp (command - position) + friction. The encoder's noise acts
    by both. The unknowns of a stand are eliminated: what is left of its equations are those
    combinations that no contact force, and no motion of the base, changes.

    Args:
        robot: The robot, as its files have it.
        stands: The measurements.
        table: What is estimated.
        kp: (nu,) stated stiffness of the servos (N m/rad); 0 without a servo.
        friction: (nu,) stated dry friction of the joints (N m).
        noise: Of the measurements; may be set to another.
    """

    def __init__(
        self,
        robot: Robot,
        stands: MeasuredStands,
        table: ParameterTable,
        kp: Array,
        friction: Array,
        noise: StandNoise,
    ) -> None:
        self.robot, self.table, self.noise = robot, table, noise
        self._kp, self._friction, self._stiff = kp, friction, kp
        self._heaviness = robot.total_mass
        model = robot.structure.model
        self._bodies = [(link, at, model.inertias[at].copy()) for link, at in bodies_of(robot)]
        self._laws = {point: GroundLaw.of(robot, point) for point in robot.contact_points}
        self._regressor = GravityRegressor(robot)
        readings = list(readings_of(robot, stands))
        self._own = [self._begin(reading) for reading in readings]
        self._readings = [
            replace(reading, sides=self._sides(reading, base, approach))
            for reading, (base, _), approach in zip(
                readings, self._own, stands.approach, strict=True
            )
        ]

    def linearise(self, x: Array, about: Array, looks: int = _LOOKS) -> Linearised:
        """Returns the whitened residuals of all stands; see ``estimate_parameters``.

        Where they are only tried (x is not ``about``), stands' own unknowns stay as they are. Where
        these are known for about these parameters, one look is enough.
        """
        numbers, total, had = self._numbers(x), Linearised.nothing(len(x)), list(self._own)
        try:
            for stand in range(len(self._readings)):
                total += self.stand(stand, numbers, looks)
        except np.linalg.LinAlgError:  # far from anything that stands
            total = replace(total, chi2=math.inf)
        if x is not about:
            self._own = had
        return total

    def weigh_at(self, x: Array) -> None:
        """Takes kp and weight, by which noise becomes torque, the stated ones before, from x.

        If it followed the parameters from step to step, steps would go where noise is large.
        """
        self._stiff, self._heaviness = self._per_joint(x, "kp", self._kp), self._mass(x)

    def stand(self, stand: int, numbers: Numbers, looks: int = _LOOKS) -> Linearised:
        """Returns the whitened residuals of one stand, its own unknowns eliminated."""
        least = _SHOWS / (self.robot.total_mass * float(np.linalg.norm(self.robot.gravity)))
        for _ in range(looks):
            residual, by_x, by_own, log_noise = self._look(stand, numbers).rows.whiten()
            left, lengths, right = np.linalg.svd(by_own, full_matrices=True)
            rank = int(np.count_nonzero(lengths > least))
            step = right[:rank].T @ (left[:, :rank].T @ -residual / lengths[:rank])
            self._move(stand, step)
        rest = left[:, rank:].T
        # That of the combinations which are left: det(P' C P) = det(C) det(B' C^-1 B) / det(B' B),
        # and the last depends on no noise.
        log_noise += 2 * float(np.log(lengths[:rank]).sum())
        return Linearised.of(rest @ residual, rest @ by_x, log_noise)

    def _look(self, stand: int, numbers: Numbers) -> StandRows:
        base, forces = self._own[stand]
        return StandRows(
            self.table,
            numbers,
            self._readings[stand],
            self._laws,
            base,
            forces,
            self.noise,
            self._regressor,
        )

    def _numbers(self, x: Array) -> Numbers:
        robot, table = self.robot, self.table
        model, bodies = robot.pin_model.copy(), []
        for link, number, stated in self._bodies:
            mass = table.value(x, "mass", link, "", stated.mass)
            com = np.array(
                [
                    table.value(x, "com", link, axis, own)
                    for axis, own in zip(AXES, stated.lever, strict=True)
                ]
            )
            bodies.append((link, number, mass, com))
            at = model.frames[model.getFrameId(link, pin.FrameType.BODY)].parentJoint
            model.inertias[at] = pin.Inertia(mass, com, stated.inertia)  # at rest nothing turns
        size = float(np.linalg.norm(robot.gravity))
        one, two = (table.value(x, "slope", "floor", axis, 0.0) for axis in "xy")
        upright = math.sqrt(1 - one * one - two * two)
        return Numbers(
            robot=replace(robot, pin_model=model),
            bodies=tuple(bodies),
            kp=self._per_joint(x, "kp", self._kp),
            friction=self._per_joint(x, "friction", self._friction),
            offset=self._per_joint(x, "offset", np.zeros(robot.nu)),
            softness={foot: table.value(x, "softness", foot, "", 1.0) for foot in robot.feet},
            moment={
                foot: np.array([table.value(x, "moment", foot, axis, 0.0) for axis in AXES])
                for foot in robot.feet
            },
            down=size * np.array([one, two, -upright]),
            tilts=size * np.array([[1.0, 0.0, one / upright], [0.0, 1.0, two / upright]]),
            imu=np.array([table.value(x, "imu", "imu", axis, 0.0) for axis in ("roll", "pitch")]),
            mass=self._mass(x),
            heaviness=self._heaviness,
            stiff=self._stiff,
            rubbing=self._friction,  # as stated: where little is estimated, torques were sure
        )

    def _mass(self, x: Array) -> float:
        """Returns the mass of the whole robot (kg)."""
        masses = [place for place, one in enumerate(self.table) if one.kind == "mass"]
        return self.robot.total_mass + float((x - self.table.stated)[masses].sum())

    def _per_joint(self, x: Array, kind: str, stated: Array) -> Array:
        names = self.robot.joint_names
        return np.array(
            [
                self.table.value(x, kind, name, "", own)
                for name, own in zip(names, stated, strict=True)
            ]
        )

    def _begin(self, reading: Reading) -> tuple[Array, Array]:
        """Returns a stand's own unknowns to begin with: on its feet, as the encoders have it."""
        robot, points = self.robot, reading.points
        flat = Configuration(robot, robot.posed(reading.position))
        places = flat.foot_places(points)
        places[:, 2] -= [robot.contact_radius[point] for point in points]
        (a, b, c), *_ = np.linalg.lstsq(
            np.column_stack([places[:, :2], np.ones(len(points))]), places[:, 2]
        )
        # The plane z = a x + b y + c through the feet is turned level, and brought to the ground.
        normal = np.array([-a, -b, 1.0]) / math.sqrt(1 + a * a + b * b)
        turn = pin.Quaternion.FromTwoVectors(normal, np.array([0.0, 0.0, 1.0]))
        height = -(turn.matrix() @ np.array([0.0, 0.0, c]))[2]
        forces = np.zeros((len(points), 3))
        forces[:, 2] = robot.total_mass * float(np.linalg.norm(robot.gravity)) / len(points)
        return np.array([turn.w, turn.x, turn.y, turn.z, height]), forces

    def _sides(self, reading: Reading, base: Array, approach: str) -> Array:
        """Returns how much of its dry friction holds each joint (nu,), on average.

        Against the motion that brought the base to where it is, on feet that stay. It is taken
        where encoders have it: joints that change sides from step to step would let no fit end.
        """
        robot = self.robot
        if not approach:
            return np.zeros(robot.nu)
        qpos = robot.posed(reading.position)
        qpos[2], qpos[3:7] = base[4], base[:4]
        rates = Configuration(robot, qpos).foot_twists(reading.points)[:, :3].reshape(-1, robot.nv)
        motion, *_ = np.linalg.lstsq(rates[:, 6:], rates[:, 2])  # base down: J_j v = J_z
        fast = np.abs(motion) > _HARDLY_MOVES * np.abs(motion).max(initial=0.0)
        against = np.where(fast, -_MOBILISED * np.sign(motion), 0.0)
        return against if approach == "above" else -against

    def informations(self, x: Array) -> list[Array]:
        """Returns what each stand tells (n, n), where the priors' widths are the units."""
        numbers, width = self._numbers(x), self.table.width
        found = [self.stand(stand, numbers).information for stand in range(len(self._readings))]
        return [width[:, None] * one * width for one in found]

    def normal_forces(self, stand: int) -> dict[str, float]:
        """Returns the normal force on each foot that carries in a stand (N)."""
        forces = dict(zip(self._readings[stand].points, self._own[stand][1], strict=True))
        return {
            foot: float(sum(forces[point][2] for point in points if point in forces))
            for foot, points in self.robot.feet.items()
            if any(point in forces for point in points)
        }

    def heights_in_the_air(
        self, stand: int, x: Array, offsets: Array
    ) -> dict[str, tuple[float, float]]:
        """Returns how high each foot is that is in the air in a stand, its lowest point.

        Args:
            stand: Its number.
            x: The parameters.
            offsets: (nu,) standard deviations of the encoders' zeros (rad).

        Returns:
            {foot: height above the ground and its standard deviation (m)}.
        """
        carrying, config = self._readings[stand].points, self._look(stand, self._numbers(x)).config
        robot, found = self.robot, {}
        for foot, points in robot.feet.items():
            if not set(points) & set(carrying):
                radius = [robot.contact_radius[point] for point in points]
                heights = config.foot_places(points)[:, 2] - radius
                lowest = int(heights.argmin())
                rates = config.foot_twists(points)[lowest, 2, 6:]
                off = math.hypot(float(np.linalg.norm(rates * offsets)), self.noise.flatness)
                found[foot] = float(heights[lowest]), off
        return found

    def residuals(self, x: Array) -> list[float]:
        """Returns the root mean square of each stand's whitened residuals."""
        numbers, found = self._numbers(x), []
        for stand in range(len(self._readings)):
            left = self.stand(stand, numbers)
            found.append(math.sqrt(left.chi2 / max(left.rows, 1)))
        return found

    def joint_residuals(self, x: Array) -> tuple[Array, Array]:
        """Returns by how much measured positions are beyond predicted ones, and noise.

        (m, nu) each (rad), the second as standard deviations; NaN of joints without a command.
        """
        numbers, nu = self._numbers(x), self.robot.nu
        off, noise = np.full((2, len(self._readings), nu), np.nan)
        for stand, reading in enumerate(self._readings):
            left, deviation = self._look(stand, numbers).rows.left(slice(6, 6 + nu))
            # Rows of motors are torques: kp (command - position) less what is needed.
            told = np.isfinite(reading.command) & (numbers.stiff > 0)
            off[stand, told] = -left[told] / numbers.stiff[told]
            noise[stand, told] = deviation[told] / numbers.stiff[told]
        return off, noise

    def reading(
        self, readings: Sequence[Reading], own: Sequence[tuple[Array, Array]] | None = None
    ) -> StandEquations:
        """Returns the same with other readings of the same stands, or of others.

        Args:
            readings: The readings.
            own: Of other stands: their own unknowns, the base (5,) and the forces (p, 3).
        """
        other = copy(self)
        other._readings = list(readings)
        other._own = list(self._own if own is None else own)
        return other

    @property
    def lifted(self) -> bool:
        """Whether a foot is in the air in any of the stands."""
        every = len(self.robot.contact_points)
        return any(len(reading.points) < every for reading in self._readings)

    def of_stands(
        self,
        stands: Sequence[tuple[Array, Array, Mapping[str, Array], tuple[str, ...]]],
        x: Array,
    ) -> StandEquations:
        """Returns the same of other stands that servos hold, read as these were.

        Args:
            stands: Configuration (nq,), torques (nu,) (N m), forces on contact points (3,) (N), and
                the feet in the air, of each.
            x: (n,) parameters.
        """
        numbers, like, readings, own = self._numbers(x), self._readings[0], [], []
        for qpos, torque, forces, swing in stands:
            lead = np.divide(torque, numbers.kp, out=np.zeros_like(torque), where=numbers.kp > 0)
            read = qpos[7:] + numbers.offset
            points = tuple(
                point
                for foot, own_points in self.robot.feet.items()
                if foot not in swing
                for point in own_points
            )
            readings.append(
                replace(
                    like,
                    position=read,
                    command=np.where(np.isfinite(like.command), read + lead, np.nan),
                    torque=np.where(np.isfinite(like.torque), torque, np.nan),
                    force={},
                    tilt=np.full(2, np.nan),
                    points=points,
                    sides=np.zeros(self.robot.nu),
                )
            )
            own.append((qpos[[3, 4, 5, 6, 2]], np.array([forces[point] for point in points])))
        return self.reading(readings, own)

    def from_both_sides(self, x: Array) -> StandEquations | None:
        """Returns the same with each stand from above and from below; None if a side is known.

        Dry friction is then estimated, too: its parameters follow the others in the table. Servos
        are commanded what holds them there.
        """
        if any(reading.sides.any() for reading in self._readings):
            return None
        names, kp = self.robot.joint_names, self._numbers(x).kp
        stated = zip(names, self._friction.tolist(), strict=True)
        rubbing = give_widths(("friction", name, "", own) for name, own in stated)
        readings = []
        for approach in APPROACHES:
            for reading, (base, _) in zip(self._readings, self._own, strict=True):
                sides = self._sides(reading, base, approach)
                lead = np.divide(sides * self._friction, kp, out=np.zeros_like(kp), where=kp > 0)
                readings.append(replace(reading, sides=sides, command=reading.command - lead))
        other = self.reading(readings, [*self._own, *self._own])
        other.table = ParameterTable((*self.table, *rubbing))
        return other

    def further_readings(self, x: Array) -> dict[str, list[Reading]]:
        """Returns what else could be read of the stands, as it should be: {what: readings}."""
        numbers, robot = self._numbers(x), self.robot
        torques, forces, tilts = [], [], []
        for stand, one in enumerate(self._readings):
            torque = numbers.kp * np.nan_to_num(one.command - one.position)
            torques.append(replace(one, torque=torque))
            forces.append(replace(one, force=self.normal_forces(stand)))
            rows = self._look(stand, numbers)
            tilts.append(replace(one, tilt=rows.tilt))
        had = self._readings
        return {
            what: readings
            for what, readings, lacking in (
                ("measure-torques", torques, not any(np.isfinite(r.torque).any() for r in had)),
                ("weigh-the-feet", forces, not any(r.force for r in had)),
                ("read-an-imu", tilts, not any(np.isfinite(r.tilt).any() for r in had)),
            )
            if lacking and robot.feet
        }

    def _move(self, stand: int, step: Array) -> None:
        base, forces = self._own[stand]
        one, two = step[:2] / 2
        turned = pin.Quaternion(*base[:4]) * pin.Quaternion(1.0, one, two, 0.0)
        turned.normalize()
        moved = np.array([turned.w, turned.x, turned.y, turned.z, base[4] + step[2]])
        self._own[stand] = moved, forces + step[3:].reshape(-1, 3)
