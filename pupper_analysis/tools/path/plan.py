"""From stance to stance: a smooth path through them, with what it takes at its speed.

Of each sample: torques, contact forces, the zero-moment point.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.csv_text import csv_text
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, StaticsInfeasibleError
from pupper_analysis.base.files import whole_file
from pupper_analysis.base.results import Tabular
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.stand import Stand
from pupper_analysis.stance.task import StandTask
from pupper_analysis.statics.cone_program import BALANCE_TOLERANCE
from pupper_analysis.statics.equilibrium import friction_utilisation_of
from pupper_analysis.statics.support_polygon import com_margin
from pupper_analysis.tools.path.dynamics import InverseDynamics, inverse_dynamics
from pupper_analysis.tools.path.geometry import PathPlace, clearance, minimum_jerk, path_geometry
from pupper_analysis.tools.path.kinds import PATH_TABLE

Array = NDArray[np.float64]

FAINT = 1e-3
"""Share of the load that is too small to pass on: where it begins, the zero-moment point is so near
the edge that moments of resistance decide whether fewer feet can carry."""


def path_effort(
    robot: Robot,
    place: PathPlace,
    rate: float,
    acceleration: float,
) -> dict[str, Array]:
    """Returns a row of each table of a ``StancePath``, with minimum tangential forces.

    Towards a segment of the path on which fewer feet carry, the load passes to those: a mean of two
    sets of forces that balance the robot does so too.

    Args:
        robot: The robot.
        place: The sample.
        rate: Of the segment's share (1/s).
        acceleration: Of it (1/s^2).

    Raises:
        StaticsInfeasibleError: If no contact forces do.
    """
    qvel, qacc = place.motion(rate, acceleration)
    config, stand = Configuration(robot, place.qpos, qvel), place.stand

    def balance(feet: Sequence[str], *, held: bool = False) -> InverseDynamics:
        return inverse_dynamics(config, qacc, feet, normals=stand.normals, held=held)

    whole = balance(stand.stance_feet)
    parts = [(1.0, whole)]
    for feet, near, full in _fading(place):
        # Fewer feet can carry only where the zero-moment point is between them; so their share
        # grows with its distance from the edge, and with the way.
        inside = max(0.0, balance(feet, held=True).zmp_margin or 0.0)
        share = near * minimum_jerk(min(1.0, inside / full))[0] if full > 0 else 0.0
        if share > FAINT:
            parts.append((share, balance(feet)))
    parts[0] = (1.0 - sum(share for share, _ in parts[1:]), whole)
    feet, none = robot.contact_points, np.zeros(3)

    def mean(tables: Sequence[Mapping[str, Array]]) -> Array:
        weighted = list(zip([share for share, _ in parts], tables, strict=True))
        rows = [[share * table.get(foot, none) for foot in feet] for share, table in weighted]
        mixed: Array = np.sum(rows, axis=0)
        return mixed

    forces, points = mean([part.contact_forces for _, part in parts]), whole.contact_points
    nothing = BALANCE_TOLERANCE * float(np.linalg.norm(forces, axis=1).sum())
    using = [
        friction_utilisation_of(
            force, stand.normals[foot].tolist(), robot.contacts[foot].sliding_friction, nothing
        )
        if foot in points
        else 0.0
        for foot, force in zip(feet, forces.tolist(), strict=True)
    ]
    return {
        "qvel": qvel,
        "qacc": qacc,
        "torques": np.sum([share * part.joint_torques for share, part in parts], axis=0),
        "stance_feet": np.array([foot in points for foot in feet]),
        "forces": forces,
        "moments": mean([part.contact_moments for _, part in parts]),
        "loads": forces[:, 2],
        "friction_utilisation": np.array(using),
        "zero_moment_point": whole.zero_moment_point,
        "zmp_margin": np.array(com_margin(whole.zero_moment_point, points)),
        "clearance": np.array([clearance(place, foot) for foot in feet]),
        "com_margin": np.array(com_margin(config.center_of_mass(), points)),
    }


def _fading(place: PathPlace) -> list[tuple[tuple[str, ...], float, float]]:
    """Returns feet that are left carrying beside the segment, how near that is, and its margin.

    Near is from 0 to 1; the margin is that of the com in the stance between the segments (m).
    """
    segment, stance_feet = place.segment, place.stand.stance_feet
    return [
        (feet, near, key.margin(feet))
        for feet, key, near in (
            (segment.before, segment.start, 1 - place.share),
            (segment.after, segment.end, place.share),
        )
        if set(feet) < set(stance_feet)
    ]


MAX_SAMPLES = 20_000
"""The most samples that a path may have."""

LEAST_PER_SEGMENT = 16
"""Samples that a segment has at least: its peaks of acceleration are then met to 1 %."""


@dataclass(frozen=True, eq=False)
class StancePath(Tabular):
    """A path through stances, and what it takes at its speed, inertia included.

    qvel and qacc are the derivatives of qpos in the public convention: linear velocity of the base
    in the world, its angular velocity in the base's frame.

    Attributes:
        stances: The stances, solved.
        joint_names: In actuator order.
        feet: The robot's feet.
        time: (n,) from 0 (s), evenly spaced; every stance is at a sample.
        qpos: (n, nq) the configurations.
        qvel: (n, nv) generalised velocities.
        qacc: (n, nv) generalised accelerations.
        torques: (n, nu) of the motors, in motion (N m).
        stance_feet: (n, feet) which feet carry.
        forces: (n, feet, 3) of the ground on each foot, in motion, in world axes (N).
        moments: (n, feet, 3) with which the ground resists feet that roll and spin (N m).
        loads: (n, feet) the forces' vertical parts (N).
        friction_utilisation: (n, feet) tangential force / (friction coefficient x normal force);
            zero where a foot does not carry.
        zero_moment_point: (n, 3) on the ground (m); not a number where the ground would have to
            pull.
        zmp_margin: (n,) distance of its projection from the edge of the support polygon (m).
        clearance: (n, feet) height of each foot above the ground (m); zero where it carries.
        com_margin: (n,) distance of the com's projection from that edge (m).
        peak_utilisation: The largest torque / effort limit; above 1 the motors are too weak.
        peak_joint: The joint with that.
        peak_time: When (s).
        peak_speed_utilisation: The largest joint speed / velocity limit of the URDF.
        fastest_joint: The joint with that.
    """

    stances: tuple[Stand, ...]
    joint_names: tuple[str, ...]
    feet: tuple[str, ...]
    time: Array = field(metadata={"unit": "s"})
    qpos: Array = field(metadata={"unit": "m, 1 (quaternion) and rad"})
    qvel: Array = field(metadata={"unit": "m/s and rad/s"})
    qacc: Array = field(metadata={"unit": "m/s^2 and rad/s^2"})
    torques: Array = field(metadata={"unit": "N m"})
    stance_feet: NDArray[np.bool_]
    forces: Array = field(metadata={"unit": "N"})
    moments: Array = field(metadata={"unit": "N m"})
    loads: Array = field(metadata={"unit": "N"})
    friction_utilisation: Array = field(metadata={"unit": "1"})
    zero_moment_point: Array = field(metadata={"unit": "m"})
    zmp_margin: Array = field(metadata={"unit": "m"})
    clearance: Array = field(metadata={"unit": "m"})
    com_margin: Array = field(metadata={"unit": "m"})
    peak_utilisation: float = field(metadata={"unit": "1"})
    peak_joint: str
    peak_time: float = field(metadata={"unit": "s"})
    peak_speed_utilisation: float = field(metadata={"unit": "1"})
    fastest_joint: str

    def _columns(self) -> dict[str, Array]:
        angles = dict(zip(self.joint_names, self.joint_positions().T, strict=True))
        torques = dict(zip(self.joint_names, self.torques.T, strict=True))
        return {
            "time": self.time,
            **{f"q {name}": values for name, values in angles.items()},
            **{f"tau {name}": values for name, values in torques.items()},
            "zmp_margin": self.zmp_margin,
            "com_margin": self.com_margin,
        }

    def joint_positions(self) -> Array:
        """Returns the joints' part (n, nu) of ``qpos`` (rad)."""
        return self.qpos[:, self.qpos.shape[1] - len(self.joint_names) :]

    def to_csv(self, path: str | Path, *, force: bool = False) -> None:
        """Writes time, joint positions and torques, with a header line that names the units.

        Args:
            path: The file.
            force: Replace what is no such table, too.

        Raises:
            OutputError: If the file cannot be written, or is no such table.
        """
        header = ["time (s)", *(f"q {name} (rad)" for name in self.joint_names)]
        header += [f"tau {name} (N m)" for name in self.joint_names]
        rows = np.column_stack([self.time, self.joint_positions(), self.torques])
        with whole_file(Path(path), PATH_TABLE, force=force) as file:
            file.write(csv_text([header, *rows.tolist()]).encode())


@check_arguments
def stance_path(
    robot: Robot,
    stances: Sequence[StandTask],
    seconds: float,
    *,
    rate: float = 50.0,
    rolling: bool = True,
) -> StancePath:
    """Finds a smooth path through stances, solved on the whole body at every sample.

    All numbers of the tasks move along a minimum-jerk law, which is at rest, without velocity or
    acceleration, in every stance; each segment of the path takes the same time. The place that
    moves evenly is the com's.

    Torques and contact forces are those of the motion (``inverse_dynamics``): inertia, damping and
    dry friction of the joints, and the ground's resistance to feet that roll are in them. Of the
    forces that balance it, they are the minimum-tangential ones.

    A foot that is lifted in a stance carries nothing from the stance before to the one after: the
    com must be over the other feet there already. On a segment before or after, its load fades out
    or in, so that the torques are continuous.

    A foot that carries stays where it is, but a sphere that friction holds rolls as its leg turns:
    its centre moves with omega x r n, by 2 mm as v3 squats by a fifth of its height. So after the
    first one the feet are beside their places in the stances by what they have rolled, while base
    and com are where the stances have them.

    Args:
        robot: A robot with a floating base.
        stances: The tasks, at least two, of feet on one ground, without an offset of the base; to
            stay in one, give it twice. The ik_seed of the first counts, the others follow from it.
        seconds: Time for all (s).
        rate: Least number of samples per second (Hz); a segment has ``LEAST_PER_SEGMENT`` or more.
        rolling: Whether the feet roll; otherwise their centres stay, and they must slip.

    Raises:
        ConfigurationError: If an argument is out of its range; or the stances cannot follow each
            other: a foot that carries moves, fewer than three carry, a joint jumps.
        NoEquilibriumError: If feet roll away.
        UnknownNameError: If a task names a foot that the robot does not have.
        StanceUnreachableError: If a sample is out of reach; says when.
        StaticsInfeasibleError: If a sample cannot be held, or not at this speed; says when.
    """
    robot.check_tree("a path")
    per_segment = _samples(seconds, rate, stances)
    if robot.welds or any(task.contacts for task in stances):
        raise ConfigurationError("contacts", diagnose("no-path-with-contacts"))
    if any(task.offset is not None for task in stances):
        raise ConfigurationError("offset", diagnose("no-path-with-offsets"))
    geometry = path_geometry(robot, stances, per_segment, float(seconds), rolling=rolling)
    duration = float(seconds) / len(geometry.segments)
    efforts = []
    for index, place in enumerate(geometry.places):
        _, rate, acceleration = minimum_jerk(place.progress)
        motion = rate / duration, acceleration / duration**2
        try:
            efforts.append(path_effort(robot, place, *motion))
        except StaticsInfeasibleError as error:
            raise error.at(geometry.where(index)) from None
    time = np.linspace(0.0, float(seconds), len(efforts))
    tables = {name: np.array([effort[name] for effort in efforts]) for name in efforts[0]}
    used = shares_of(tables["torques"], robot.effort_limits)
    joints = slice(robot.nv - robot.nu, None)
    speeds = shares_of(tables["qvel"][:, joints], robot.velocity_limits)
    peak, fastest = (np.unravel_index(int(table.argmax()), table.shape) for table in (used, speeds))
    return StancePath(
        stances=geometry.stances,
        joint_names=robot.joint_names,
        feet=robot.contact_points,
        time=time,
        qpos=np.array([place.qpos for place in geometry.places]),
        **tables,
        peak_utilisation=float(used[peak]),
        peak_joint=robot.joint_names[int(peak[1])],
        peak_time=float(time[peak[0]]),
        peak_speed_utilisation=float(speeds[fastest]),
        fastest_joint=robot.joint_names[int(fastest[1])],
    )


def shares_of(values: Array, limits: Array) -> Array:
    """Returns |values| / limits: 0 for 0 of nothing, and inf for more than nothing."""
    with np.errstate(divide="ignore", invalid="ignore"):
        shares: Array = np.nan_to_num(np.abs(values) / limits, nan=0.0, posinf=np.inf)
    return shares


SHORTEST = 1e-3
"""s: no robot is so fast; of much less, accelerations overflow."""


def _samples(seconds: float, rate: float, stances: Sequence[StandTask]) -> int:
    """Checks the arguments; returns how many samples a segment has."""
    if len(stances) < 2:
        raise ConfigurationError("stances", diagnose("path-of-one-stance"))
    for name, value in (("seconds", seconds), ("rate", rate)):
        if not 0 < value < math.inf:
            raise ConfigurationError(name, diagnose("not-finite-above-0", value=repr(value)))
    if seconds < SHORTEST:
        message = diagnose("shorter-than-least", seconds=seconds, least=SHORTEST)
        raise ConfigurationError("seconds", message)
    if max(seconds * rate, LEAST_PER_SEGMENT * len(stances)) > MAX_SAMPLES:
        message = diagnose("too-many-samples", most=MAX_SAMPLES)
        raise ConfigurationError("seconds, rate", message)
    return max(LEAST_PER_SEGMENT, math.ceil(seconds * rate / (len(stances) - 1) - 1e-9))
