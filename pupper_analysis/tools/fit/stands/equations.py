"""What must be zero of measured stands at rest, as a function of the parameters."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.arrays import cross_matrices
from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.joints import leg_joints
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.fit.estimate import LinearisedResiduals, Posterior
from pupper_analysis.tools.fit.measurements.stands import MeasuredStands
from pupper_analysis.tools.fit.parameters import AXES, KINDS, ParameterTable, list_bodies

Array = NDArray[np.float64]

_TURNS_AND_HEIGHT = [3, 4, 2]
"""Of qvel: turns about the base's own x and y, and how high it is. What a stand at rest leaves of
the base's motion: where it stands, and where it looks to, nothing of it shows."""

_LAST = 0.75
"""Of the friction in joints and on feet, for each motion of the base. Of v3, set down in MuJoCo,
all feet of a stand keep moments of one sign, and the joints that moved most their whole friction:
with this, and half of each one's variance by itself, residuals of true robots come out as 1."""

_FIXED, _STILL = 1e-6, 1e-9
"""Singular values and rates that are none: of motions that a leg does not take part in."""

_BALANCE = 1e-5
"""Of the weight, and of the weight times the height: standard deviation of what balances the base.
A robot at rest obeys statics; the number is so small that it hides nothing, and lets the base's
rows, which no measurement's noise reaches, be weighed."""

_LINEAR = 1e-4
"""Of a weight times a height: standard deviation of a servo's torque from kp times its error. A
joint of a leg carries a tenth of that product: it is a thousandth of what it carries."""

_UNKNOWN = 1e3
"""Likewise, of the torque of a motor whose command is not known: what it says is nothing."""

_TURNS_ROUND, _YIELDS = 1e-3, 0.7
"""rad, and of the dead band: where an error is no larger, which side it is on is not sure. Joints
of Go1 and MEVIUS that are held by less than their dry friction have from none to all of it."""

_ANYWHERE = 0.45
"""Of a dead band: standard deviation of what friction carries of a joint that has not yielded."""


@dataclass(frozen=True)
class StandNoise:
    """What measurements of a stand are off by, as standard deviations.

    Attributes:
        encoder: Of a joint position (rad).
        moment: Of the moment on a contact point, about each axis, in parts of the force on it (m):
            a foot that turns on the ground, or rolls, keeps some of what stopped it.
        flatness: Of the ground's height under a foot, and of the links' lengths (m).
        friction: Factor on the stated dry friction of joints, of which nobody knows where in its
            band a joint came to rest.
    """

    encoder: float
    moment: float = KINDS["moment"].width
    flatness: float = 3e-4
    friction: float = 1.0


@dataclass(frozen=True, eq=False)
class StandReading:
    """What was measured of one stand; NaN is not measured. See ``MeasuredStands``.

    Attributes:
        command: (nu,) rad.
        position: (nu,) rad.
        points: The contact points that carry.
        heading: How the robot is turned about the vertical (rad).
        added: {link: known mass on it (kg), and where in its frame (m)} (4,).
    """

    command: Array
    position: Array
    points: tuple[str, ...]
    heading: float = 0.0
    added: Mapping[str, Array] = field(default_factory=dict)


def make_readings(robot: Robot, stands: MeasuredStands) -> Iterator[StandReading]:
    """Yields what was measured of each stand."""
    for row in range(len(stands)):
        yield StandReading(
            command=stands.command[row],
            position=stands.position[row],
            points=tuple(
                point
                for foot, points in robot.feet.items()
                if foot not in stands.swing[row]
                for point in points
            ),
            heading=float(stands.heading[row]),
            added={link: own[row] for link, own in stands.added.items() if own[row, 0]},
        )


_SHOWS = 1.0
"""Standard deviations that the robot's weight makes: forces that show less are within a sole."""

_TOLD = 1e-4
"""Of what an encoder's noise allows: a reading of which all others tell less contradicts none."""


class StandRows:
    """The rows of one stand, at parameters and at own unknowns.

    Own unknowns are the turns of the base about its own x and y, its height, and three components
    of the force on each contact point, in the ground's axes.

    Args:
        table: The parameters.
        numbers: What they say.
        reading: What was measured.
        laws: {contact point: how far it sinks}.
        base: (5,) the base's quaternion (w, x, y, z) and height (m).
        forces: (p, 3) on the contact points (N).
        noise: Of the measurements.
        regressor: For gravity.

    Attributes:
        config: The configuration.
        jacobians: (p, 3, nv) of the contact points.
        kp: (nu,) of the servos (N m/rad).
        residual: (m,) r of each row: of the degrees of freedom, then of the contact points.
        by_x: (m, n) its derivatives by parameters, by_own by own unknowns, by_noise by what acts on
            several rows: encoders (nu,), moments on contact points (3 each), last motions (12).
        deviation: (m,) standard deviations of other noise.
    """

    def __init__(
        self,
        table: ParameterTable,
        numbers: StandValues,
        reading: StandReading,
        laws: dict[str, GroundLaw],
        base: Array,
        forces: Array,
        noise: StandNoise,
        regressor: GravityRegressor,
    ) -> None:
        self._table, self._numbers, self._reading = table, numbers, reading
        self._forces, self._regressor = forces, regressor
        robot, points = numbers.robot, reading.points
        self.kp = numbers.kp
        self._robot, self._names = robot, robot.joint_names
        qpos = robot.posed(reading.position - numbers.offset)
        qpos[2], qpos[3:7] = base[4], base[:4]
        self.config = Configuration(robot, qpos)
        self._feet = [robot.foot_of(point) for point in points]
        # Points of a sole sink as on average, and linearly about that: each by its own law they
        # would leave the ground and come back from step to step, and no fit would end.
        feet = np.array(self._feet)
        mean = np.array([forces[feet == foot, 2].mean() for foot in feet])
        level = [laws[p].depth(f) for p, f in zip(points, mean.tolist(), strict=True)]
        self._rates = np.array([laws[p].rate(d) for p, d in zip(points, level, strict=True)])
        self._deep = np.array(level) + (forces[:, 2] - mean) / self._rates
        self._softness = np.array([numbers.softness[foot] for foot in self._feet])
        self._radius = np.array([robot.contact_radius[point] for point in points])
        self._arms = np.zeros((len(points), 3))
        # MuJoCo has a contact half way into what the foot sinks.
        self._arms[:, 2] = self._softness * self._deep / 2 - self._radius
        self._twists = self.config.foot_twists(points)
        turns = self.config.foot_rotations(points)
        self._ahead = np.array([t @ numbers.ahead[p] for t, p in zip(turns, points, strict=True)])
        linear, turning = self._twists[:, :3], self._twists[:, 3:]
        self.jacobians = linear - cross_matrices(self._arms) @ turning
        known = np.isfinite(reading.command)
        lead = np.where(known, reading.command - reading.position, 0.0)
        band, stuck = numbers.deadband, _turned(numbers.stuck)
        self._signs = lead / (size := np.hypot(lead, _turned(band)))
        self._lead = lead - band * self._signs
        self._by_band = self._signs - (_YIELDS * band) ** 2 * lead / size**3
        self._stiff = np.where(known, numbers.stiff, 0.0)
        self._held = _ANYWHERE * numbers.stuck * self._stiff * stuck / np.hypot(lead, stuck)
        self._known = known
        self._scale = robot.weight
        own, sources = 3 + 3 * len(points), robot.nu + 3 * len(points) + 12
        rows = robot.nv + len(points)
        self.residual = np.zeros(rows)
        self.by_x, self.by_own, self.by_noise = (
            np.zeros((rows, size)) for size in (len(table), own, sources)
        )
        self._balance()
        self._contact()
        self.set_noise(noise)

    def set_noise(self, noise: StandNoise) -> None:
        """Takes noise to be another: nothing else of the rows depends on it."""
        pressed, length = np.maximum(self._forces[:, 2], 0.0), self._robot.stand_height
        own = math.sqrt(0.5) * noise.moment * np.repeat(pressed, 3)
        last = _LAST * np.repeat([noise.friction, noise.moment], 6)
        self._sources = np.concatenate([np.full(self._robot.nu, noise.encoder), own, last])
        # A joint rests anywhere in its band of dry friction; half of it is the last motion's.
        rubbing = noise.friction * self._numbers.rubbing
        torque = np.hypot(_LINEAR * self._scale * length, rubbing / math.sqrt(6.0))
        torque = np.hypot(torque, self._held)
        torque = np.where(self._known, torque, _UNKNOWN * self._scale * length)
        base = _BALANCE * self._scale * np.array([1.0, 1.0, 1.0, length, length, length])
        flatness = np.full(len(pressed), noise.flatness)
        self.deviation: Array = np.concatenate([base, torque, flatness])

    def _covariance(self) -> Array:
        found: Array = self._sources**2 * self.by_noise @ self.by_noise.T
        return found + np.diag(self.deviation**2)

    def eliminate_own_unknowns(self) -> tuple[LinearisedResiduals, Array]:
        """Returns residuals, whitened, that no own unknown changes; and the own unknowns' step."""
        rest, log_noise, step = self._without_own(np.column_stack([self.residual, self.by_x]))
        return LinearisedResiduals.from_residuals(rest[:, 0], rest[:, 1:], log_noise), step

    def _without_own(self, columns: Array) -> tuple[Array, float, Array]:
        """Returns columns of which the first is residuals: what is left of them, whitened.

        And the logarithm of noise's determinant in it, and the own unknowns' step.
        """
        factor, n = np.linalg.cholesky(self._covariance()), columns.shape[1]
        white = np.linalg.solve(factor, np.column_stack([columns, self.by_own]))
        left, lengths, right = np.linalg.svd(white[:, n:], full_matrices=True)
        rank = int(np.count_nonzero(lengths > _SHOWS / self._scale))
        step = right[:rank].T @ (left[:, :rank].T @ -white[:, 0] / lengths[:rank])
        # The determinant of noise in the combinations that are left: det(P' C P) =
        # det(C) det(B' C^-1 B) / det(B' B), and the last depends on no noise.
        log_noise = 2 * float(np.log(np.diag(factor)).sum() + np.log(lengths[:rank]).sum())
        return left[:, rank:].T @ white[:, :n], log_noise, step

    def find_contradictions(self, known: Array) -> tuple[Array, Array]:
        """Returns by how much each joint was read beyond what all other readings say, and how sure.

        (nu,) each (rad), the second as standard deviations: the error of that reading alone which
        leaves least, whatever the parameters are, whose covariance (n, n) is known by all readings.
        """
        columns = [self.residual, self.by_x, self.by_noise[:, : self._robot.nu]]
        rest = self._without_own(np.column_stack(columns))[0]
        by_x, moved = np.split(rest[:, 1:], [self.by_x.shape[1]], axis=1)
        taken = by_x.T @ moved
        told = (moved * moved).sum(axis=0) - (taken * (known @ taken)).sum(axis=0)
        told = np.maximum(told, _TOLD / self._sources[0] ** 2)
        return -(moved.T @ rest[:, 0]) / told, 1 / np.sqrt(told)

    def _put(self, rows: Array, by: Array | float, *name: str) -> None:
        """Adds what rows (k, n) change by with a parameter, if it is estimated."""
        place = self._table.find_index(*name)
        if place is not None:
            rows[..., place] += by

    def _balance(self) -> None:
        """S tau - g + passive + sum J_p^T f_p = 0."""
        numbers, nv = self._numbers, self._robot.nv
        moments = np.array([numbers.moment[foot] for foot in self._feet])
        kept = self._forces[:, 2:] * moments
        wrenches = np.hstack([self._forces, np.cross(self._arms, self._forces) + kept])
        stiffness = self.config.pushed_rates(self._twists, wrenches)
        gravity, by_mass, by_com, by_slope = self._regressor.evaluate(self.config, numbers)
        residual = self.config.passive() - gravity
        residual[2] -= numbers.load * numbers.mass * numbers.size
        residual += np.einsum("pij,pi->j", self.jacobians, self._forces)
        residual[6:] += numbers.kp * self._lead
        residual += np.einsum("pij,pi->j", self._twists[:, 3:], kept)
        by_x, by_own, by_noise = (one[:nv] for one in (self.by_x, self.by_own, self.by_noise))
        by_own[:, :3] = -stiffness[:, _TURNS_AND_HEIGHT]
        by_own[:, 3:] = self.jacobians.reshape(-1, nv).T
        # What a foot sinks further brings its contact nearer to its centre by half of that.
        nearer = np.cross([0.0, 0.0, 0.5], self._forces)
        moved = np.einsum("pij,pi->pj", self._twists[:, 3:], nearer)
        for point, foot in enumerate(self._feet):
            by_own[:, 3 + 3 * point + 2] += (
                self._softness[point] / self._rates[point] * moved[point]
            )
            self._put(by_x, self._deep[point] * moved[point], "softness", foot)
            turned = np.cross(self._ahead[point], self._forces[point])
            self._put(by_x, turned @ self._twists[point, 3:], "length", foot)
            for axis, name in enumerate(AXES):
                self._put(
                    by_x,
                    self._forces[point, 2] * self._twists[point, 3 + axis],
                    "moment",
                    foot,
                    name,
                )
            by_own[:, 3 + 3 * point + 2] += moments[point] @ self._twists[point, 3:]
        # A true position is the measured one less offset and noise; a servo's torque follows the
        # true one.
        nu = self._robot.nu
        by_noise[6:, :nu] += np.diag(self.kp * self._known)
        by_noise[:, :nu] += stiffness[:, 6:]
        for link in self._reading.added:
            yielded = numbers.rubbing * self._signs
            self._put(by_x[6:], yielded, "settling", link)
            residual[6:] += numbers.settling[link] * yielded
        turning = self._twists[:, 3:]
        by_noise[:, nu:-12] = turning.reshape(-1, nv).T
        joints, feet = self._last_motions()
        by_noise[6:, -12:-6] = (numbers.rubbing / math.sqrt(3.0))[:, None] * joints
        pressed = np.maximum(self._forces[:, 2], 0.0)
        by_noise[:, -6:] = np.einsum("p,pij,pik->jk", pressed, turning, feet)
        for joint, name in enumerate(self._names):
            row = 6 + joint
            self._put(by_x, stiffness[:, row], "offset", name)
            self._put(by_x[row], self._lead[joint], "kp", name)
            self._put(by_x[row], -(numbers.kp[joint] * self._by_band[joint]), "deadband", "servos")
        self._gravity(by_x, by_mass, by_com, by_slope)
        self._in_positions(residual, by_x, by_own, by_noise)
        self.residual[:nv] = residual

    def _last_motions(self) -> tuple[Array, Array]:
        """Returns how joints (nu, 6) and feet (p, 3, 6) turn with the base, on feet that stay.

        Each motion of the base by its fastest joint, and its fastest foot. A stand that comes to
        rest stops them together, and the last motion leaves its friction in all of them.
        """
        nv, twists = self._robot.nv, self._twists
        on = self.jacobians.reshape(-1, nv)
        joints, *_ = np.linalg.lstsq(on[:, 6:], -on[:, :6], rcond=_FIXED)
        feet = twists[:, 3:, :6] + twists[:, 3:, 6:] @ joints
        fastest = np.maximum(np.abs(joints).max(axis=0), _STILL)
        return joints / fastest, feet / np.maximum(np.abs(feet).max(axis=(0, 1)), _STILL)

    def _gravity(
        self, by_x: Array, by_mass: list[Array], by_com: list[Array], by_slope: list[Array]
    ) -> None:
        """Fills in what balance changes by with masses, coms, loads, and the slope."""
        numbers = self._numbers
        for body, (link, *_) in enumerate(numbers.bodies):
            self._put(by_x, -by_mass[body], "mass", link)
            self._put(by_x[2], -numbers.load * numbers.size, "mass", link)
            for axis, name in enumerate(AXES):
                self._put(by_x, -by_com[body][:, axis], "com", link, name)
        for body, one in enumerate(numbers.loads, len(numbers.bodies)):
            self._put(by_x, -one.stated * by_mass[body], "added", one.link)
            for axis, name in enumerate(AXES):
                self._put(by_x, -(by_com[body] @ one.turn[:, axis]), "place", one.link, name)
        for name, pull in zip("xy", by_slope, strict=True):
            self._put(by_x, -pull, "slope", "floor", name)
        self._put(by_x[2], -numbers.mass * numbers.size, "load", "scale")

    def _in_positions(self, residual: Array, by_x: Array, by_own: Array, by_noise: Array) -> None:
        """Takes motors' rows to what a position is off by, times the kp at which noise is taken.

        And the base's likewise to parts of the robot's weight. It is positions that are measured.
        By torques and forces, masses and kp that are all too small would fit best: what is off
        would be small with them, and noise is not.
        """
        numbers = self._numbers
        driven = self._known & (numbers.kp > 0)
        kp = np.where(driven, numbers.kp, 1.0)
        share = np.full(len(residual), numbers.heaviness / numbers.mass)
        share[6:] = np.where(driven, self._stiff / kp, 1.0)
        for joint, name in enumerate(self._names):
            if driven[joint]:
                self._put(by_x[6 + joint], -residual[6 + joint] / kp[joint], "kp", name)
        for link, *_ in numbers.bodies:
            self._put(by_x[:6], -residual[:6] / numbers.mass, "mass", link)
        for rows in (residual, by_x.T, by_own.T, by_noise.T):
            rows *= share

    def _contact(self) -> None:
        """z_p - r_p + softness depth(f_p) = 0."""
        points = self._reading.points
        heights = self._twists[:, 2]
        nv = self._robot.nv
        by_x, by_own, by_noise = (one[nv:] for one in (self.by_x, self.by_own, self.by_noise))
        self.residual[nv:] = self.config.foot_places(points)[:, 2] - self._radius
        self.residual[nv:] += self._softness * self._deep
        by_own[:, :3] = heights[:, _TURNS_AND_HEIGHT]
        by_noise[:, : self._robot.nu] -= heights[:, 6:]
        for joint, name in enumerate(self._names):
            self._put(by_x, -heights[:, 6 + joint], "offset", name)
        for point, foot in enumerate(self._feet):
            by_own[point, 3 + 3 * point + 2] += self._softness[point] / self._rates[point]
            self._put(by_x[point], self._deep[point], "softness", foot)
            self._put(by_x[point], self._ahead[point, 2], "length", foot)


def _turned(band: float) -> float:
    """Returns the error (rad) for which a dead band, or friction of one sign, is there in part."""
    return math.hypot(_TURNS_ROUND, _YIELDS * band)


# What parameters say of a robot and its surroundings, and how gravity pulls on it.


@dataclass(frozen=True, eq=False)
class KnownMass:
    """A known mass that was put on a link.

    Attributes:
        link: The link.
        number: Of the joint that moves it.
        stated: What it weighs by a scale (kg).
        mass: What it weighs (kg).
        place: (3,) where it is, in that joint's frame (m).
        turn: (3, 3) the link's axes there.
    """

    link: str
    number: int
    stated: float
    mass: float
    place: Array
    turn: Array


@dataclass(frozen=True, eq=False)
class StandValues:
    """What a vector of parameters says of a robot and its surroundings.

    Attributes:
        vector: (n,) the parameters.
        robot: The robot, with these masses in Pinocchio's model.
        bodies: (link, number of its joint, mass (kg), com (3,) in its frame (m)) of each.
        kp: (nu,) N m/rad.
        offset: (nu,) rad.
        softness: {foot: factor on how far it sinks}.
        moment: {foot: (3,) moment on it, in parts of the force on it (m)}.
        ahead: {contact point: (3,) its leg's last link, in its frame (m)}.
        down: (3,) gravity in the ground's axes (m/s^2).
        tilts: (2, 3) its derivatives by the slope.
        deadband: Error for which a servo gives nothing (rad).
        settling: {link: friction where a known mass is on it, in parts of ``rubbing``}.
        load: What stands on the feet beyond the masses, in parts of these.
        size: Of gravity (m/s^2).
        mass: Of the whole robot (kg).
        heaviness: The mass at which noise is taken (kg), as ``stiff`` is the kp.
        stiff: (nu,) kp, by which an encoder's noise becomes torque.
        stuck: Dead band by which friction of joints that have not yielded is noise (rad).
        rubbing: (nu,) friction, that nobody knows the place in.
        loads: Known masses that were put on.
    """

    vector: Array
    robot: Robot
    bodies: tuple[tuple[str, int, float, Array], ...]
    kp: Array
    offset: Array
    softness: dict[str, float]
    moment: dict[str, Array]
    ahead: Mapping[str, Array]
    down: Array
    tilts: Array
    deadband: float
    settling: Mapping[str, float]
    load: float
    size: float
    mass: float
    heaviness: float
    stiff: Array
    stuck: float
    rubbing: Array
    loads: tuple[KnownMass, ...] = ()

    def for_reading(self, reading: StandReading, table: ParameterTable) -> StandValues:
        """Returns the same as a stand has it: with known masses on, turned about the vertical."""
        if not reading.added and not reading.heading:
            return self
        robot, loads = self.robot, []
        if reading.added:
            robot = replace(robot, pin_model=robot.pin_model.copy())
        other = self.robot.structure.model  # whose joints the regressor numbers
        for link, (stated, *place) in reading.added.items():
            frame = other.frames[other.getFrameId(link, pin.FrameType.BODY)]
            mass = stated * table.get_value(self.vector, "added", link, "", 1.0)
            moved = [table.get_value(self.vector, "place", link, axis, 0.0) for axis in AXES]
            at = frame.placement.act(np.array(place) + moved)
            turn = frame.placement.rotation
            loads.append(KnownMass(link, frame.parentJoint, float(stated), mass, at, turn))
            model = robot.pin_model
            moves = model.frames[model.getFrameId(link, pin.FrameType.BODY)].parentJoint
            model.inertias[moves] += pin.Inertia(mass, at, np.zeros((3, 3)))
        back = pin.utils.rotate("z", -reading.heading)
        return replace(
            self,
            robot=robot,
            down=back @ self.down,
            tilts=self.tilts @ back.T,
            loads=tuple(loads),
        )


def _ahead_of(robot: Robot, point: str) -> Array:
    """Returns the way (3,) from its leg's last joint to a contact point, in its frame (m).

    In the plane of the leg: without what it is aside along the joint's axis.
    """
    rest, joints = Configuration(robot, robot.neutral()), leg_joints(robot, point)
    if not joints:
        return np.zeros(3)
    axis = rest.joint_axis(joints[-1])
    way = rest.foot_places([point])[0] - rest.joint_position(joints[-1])
    way -= (way @ axis) * axis
    found: Array = rest.foot_rotations([point])[0].T @ way
    return found


def compute_level_base(robot: Robot, joints: Array, points: Sequence[str]) -> Array:
    """Returns the base's quaternion (w, x, y, z) and height (m), with contact points on the ground.

    The plane z = a x + b y + c through them is turned level, and brought to the ground.
    """
    places = Configuration(robot, robot.posed(joints)).foot_places(points)
    places[:, 2] -= [robot.contact_radius[point] for point in points]
    plane = np.column_stack([places[:, :2], np.ones(len(points))])
    (a, b, c), *_ = np.linalg.lstsq(plane, places[:, 2])
    normal = np.array([-a, -b, 1.0]) / math.sqrt(1 + a * a + b * b)
    turn = pin.Quaternion.FromTwoVectors(normal, np.array([0.0, 0.0, 1.0]))
    height = -(turn.matrix() @ np.array([0.0, 0.0, c]))[2]
    return np.array([turn.w, turn.x, turn.y, turn.z, height])


class GravityRegressor:
    """Generalised forces of gravity, linear in masses and first moments, whichever way it pulls.

    Args:
        robot: The robot.
    """

    def __init__(self, robot: Robot) -> None:
        self._structure = robot.structure
        self._model = robot.structure.model.copy()
        self._data, self._rest = self._model.createData(), np.zeros(self._model.nv)

    def evaluate(
        self, config: Configuration, numbers: StandValues
    ) -> tuple[Array, list[Array], list[Array], list[Array]]:
        """Returns gravity's forces (nv,), and their derivatives.

        By each body's mass (nv,), by its com (nv, 3), those of known loads last, and by the slope
        along x and y (nv,).
        """
        bodies = [(number, mass, com) for _, number, mass, com in numbers.bodies]
        bodies += [(one.number, one.mass, one.place) for one in numbers.loads]
        at, mass, com = (np.array(column) for column in zip(*bodies, strict=True))
        moments = np.column_stack([mass, mass[:, None] * com])
        q, found = self._structure.convention.unit_q(config.qpos), []
        for pull in (numbers.down, *numbers.tilts):
            self._model.gravity.linear = pull
            rows = pin.computeJointTorqueRegressor(
                self._model, self._data, q, self._rest, self._rest
            )
            rows = self._structure.columns(rows.T).T
            found.append(rows.reshape(len(rows), -1, 10)[:, at - 1, :4])
        forces = [np.einsum("vbm,bm->v", rows, moments) for rows in found]
        by_moment = found[0][..., 1:]
        by_mass = found[0][..., 0] + np.einsum("vbi,bi->vb", by_moment, com)
        by_com = mass[:, None] * by_moment
        return forces[0], list(by_mass.T), list(np.moveaxis(by_com, 1, 0)), forces[1:]


_LOOKS = 2
"""Steps of a stand's own unknowns for each of the parameters': equations are linear in forces."""


class StandEquations:
    """Balance of forces, contact with the ground, and what else was measured, of every stand.

    A stand's unknowns are the parameters, that all stands share, and its own: how the base is
    tilted and how high it is (3), and the force on every contact point (3 each). Its equations:

        S tau - g(q; masses, coms) + passive + sum J_p^T f_p = 0          (nv)
        z_p(q) - r_p + softness depth(f_p) = 0                            (one a contact point)

    with q = position - offset, tau = kp (command - position - dead band), and what no
    scale has shown on the feet. The encoder's noise acts by both. The unknowns of a stand are
    eliminated: what is left of its equations are those combinations that no contact force, and no
    motion of the base, changes.

    Args:
        robot: The robot, as its files have it.
        stands: The measurements.
        table: What is estimated.
        kp: (nu,) stated stiffness of the servos (N m/rad); 0 without a servo.
        friction: (nu,) stated dry friction of the joints (N m).
        noise: Of the measurements; may be set to another.

    Attributes:
        stuck: Dead band by which friction of joints that have not yielded is noise (rad).
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
        self.stuck = 0.0
        model = robot.structure.model
        self._bodies = [(link, at, model.inertias[at].copy()) for link, at in list_bodies(robot)]
        self._laws = {point: GroundLaw.of(robot, point) for point in robot.contact_points}
        self._regressor = GravityRegressor(robot)
        self._ahead = {point: _ahead_of(robot, point) for point in robot.contact_points}
        self._readings = list(make_readings(robot, stands))
        self._own = [self._begin(reading) for reading in self._readings]

    def linearise(self, x: Array, about: Array, evaluations: int = _LOOKS) -> LinearisedResiduals:
        """Returns the whitened residuals of all stands; see ``estimate_parameters``.

        Where they are only tried (x is not ``about``), stands' own unknowns stay as they are. Where
        these are known for about these parameters, one look is enough.
        """
        total, had = LinearisedResiduals.empty(len(x)), list(self._own)
        try:
            numbers = self._numbers(x)
            for stand in range(len(self._readings)):
                total += self.linearise_stand(stand, numbers, evaluations)
        except (np.linalg.LinAlgError, ArithmeticError):  # far from anything that stands
            total = replace(total, chi2=math.inf)
        if x is not about:
            self._own = had
        return total

    def set_noise_point(self, x: Array) -> None:
        """Takes kp, weight and dead band, by which noise becomes torque, from x.

        Before it is the stated ones. If it followed the parameters from step to step, steps would
        go where noise is large.
        """
        names = self.robot.joint_names
        self._stiff = self.table.get_values(x, "kp", names, self._kp)
        self._heaviness = self._mass(x)
        self.stuck = abs(self.table.get_value(x, "deadband", "servos", "", 0.0))

    def linearise_stand(
        self, stand: int, numbers: StandValues, evaluations: int = _LOOKS
    ) -> LinearisedResiduals:
        """Returns the whitened residuals of one stand, its own unknowns eliminated."""
        for _ in range(evaluations):
            found, step = self._look(stand, numbers).eliminate_own_unknowns()
            self._move(stand, step)
        return found

    def evaluate_rows(self, x: Array) -> list[StandRows]:
        """Returns the rows of every stand at parameters, and at own unknowns as they are."""
        numbers = self._numbers(x)
        return [self._look(stand, numbers) for stand in range(len(self._readings))]

    def _look(self, stand: int, numbers: StandValues) -> StandRows:
        (base, forces), reading = self._own[stand], self._readings[stand]
        return StandRows(
            self.table,
            numbers.for_reading(reading, self.table),
            reading,
            self._laws,
            base,
            forces,
            self.noise,
            self._regressor,
        )

    def _numbers(self, x: Array) -> StandValues:
        robot, table = self.robot, self.table
        model, bodies = robot.pin_model.copy(), []
        for link, number, stated in self._bodies:
            mass, com = table.get_inertial(x, link, stated)
            bodies.append((link, number, mass, com))
            at = model.frames[model.getFrameId(link, pin.FrameType.BODY)].parentJoint
            model.inertias[at] = pin.Inertia(mass, com, stated.inertia)  # at rest nothing turns
        for point, ahead in self._ahead.items():
            longer = table.get_value(x, "length", robot.foot_of(point), "", 1.0) - 1.0
            if longer:
                at = model.getFrameId(robot.contact_frames[point], pin.FrameType.BODY)
                model.frames[at].placement *= pin.SE3(np.eye(3), longer * ahead)
        size = float(np.linalg.norm(robot.gravity))
        one, two = (table.get_value(x, "slope", "floor", axis, 0.0) for axis in "xy")
        if (squared := 1 - one * one - two * two) <= 0:
            raise np.linalg.LinAlgError("on a wall")
        upright = math.sqrt(squared)
        return StandValues(
            vector=x,
            robot=replace(robot, pin_model=model),
            bodies=tuple(bodies),
            kp=table.get_values(x, "kp", robot.joint_names, self._kp),
            offset=table.get_values(x, "offset", robot.joint_names, np.zeros(robot.nu)),
            softness={foot: table.get_value(x, "softness", foot, "", 1.0) for foot in robot.feet},
            moment={
                foot: np.array([table.get_value(x, "moment", foot, axis, 0.0) for axis in AXES])
                for foot in robot.feet
            },
            ahead=self._ahead,
            down=size * np.array([one, two, -upright]),
            tilts=size * np.array([[1.0, 0.0, one / upright], [0.0, 1.0, two / upright]]),
            deadband=table.get_value(x, "deadband", "servos", "", 0.0),
            settling={
                link: table.get_value(x, "settling", link, "", 0.0)
                for link in dict.fromkeys(link for one in self._readings for link in one.added)
            },
            load=table.get_value(x, "load", "scale", "", 0.0),
            size=size,
            mass=self._mass(x),
            heaviness=self._heaviness,
            stiff=self._stiff,
            stuck=self.stuck,
            rubbing=self._friction,  # as stated: where little is estimated, torques were sure
        )

    def _mass(self, x: Array) -> float:
        """Returns the mass of the whole robot (kg)."""
        masses = [place for place, one in enumerate(self.table) if one.kind == "mass"]
        return self.robot.total_mass + float((x - self.table.stated)[masses].sum())

    def _begin(self, reading: StandReading) -> tuple[Array, Array]:
        """Returns a stand's own unknowns to begin with: on its feet, as the encoders have it."""
        robot, points = self.robot, reading.points
        forces = np.zeros((len(points), 3))
        forces[:, 2] = robot.weight / len(points)
        return compute_level_base(robot, reading.position, points), forces

    def compute_informations(self, x: Array) -> list[Array]:
        """Returns what each stand tells (n, n), where the priors' widths are the units."""
        numbers, width = self._numbers(x), self.table.width
        found = [
            self.linearise_stand(stand, numbers).information for stand in range(len(self._readings))
        ]
        return [width[:, None] * one * width for one in found]

    def sum_normal_forces(self, stand: int) -> dict[str, float]:
        """Returns the normal force on each foot that carries in a stand (N)."""
        forces = dict(zip(self._readings[stand].points, self._own[stand][1], strict=True))
        return {
            foot: float(sum(forces[point][2] for point in points if point in forces))
            for foot, points in self.robot.feet.items()
            if any(point in forces for point in points)
        }

    def compute_swing_heights(
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

    def compute_rms_residuals(self, x: Array) -> list[float]:
        """Returns the root mean square of each stand's whitened residuals."""
        numbers = self._numbers(x)
        left = [self.linearise_stand(stand, numbers) for stand in range(len(self._readings))]
        return [math.sqrt(one.chi2 / max(one.rows, 1)) for one in left]

    def find_contradictions(self, known: Posterior) -> tuple[Array, Array]:
        """Returns by how much each joint in each stand was read beyond what all others say.

        (m, nu) (rad), and standard deviations; see ``StandRows``.
        """
        found = [
            rows.find_contradictions(known.covariance) for rows in self.evaluate_rows(known.mean)
        ]
        off, sure = np.moveaxis(np.array(found), 1, 0)
        return off, sure

    def _move(self, stand: int, step: Array) -> None:
        base, forces = self._own[stand]
        one, two = step[:2] / 2
        turned = pin.Quaternion(*base[:4]) * pin.Quaternion(1.0, one, two, 0.0)
        turned.normalize()
        moved = np.array([turned.w, turned.x, turned.y, turned.z, base[4] + step[2]])
        self._own[stand] = moved, forces + step[3:].reshape(-1, 3)
