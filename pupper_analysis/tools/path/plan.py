"""Paths through stances: configurations, motor torques and contact forces over time.

`stance_path` computes the geometry of a path (`geometry`) and, for each sample, the inverse
dynamics at the given speed (`dynamics`). The load of a foot is faded out smoothly before the foot
lifts, and faded in after the foot lands.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.arguments import (
    check_arguments,
    check_type,
)
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.csv_text import csv_text
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, StaticsInfeasibleError
from pupper_analysis.base.files import write_atomically
from pupper_analysis.base.progress import report_progress
from pupper_analysis.base.results import Tabular
from pupper_analysis.base.units import (
    EFFORT_UNIT,
    POSITION_UNIT,
    find_joint_units,
)
from pupper_analysis.models.motors.motor import Motor
from pupper_analysis.models.motors.region import compute_motor_utilisation
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.joints import list_position_units
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.stand import Stand
from pupper_analysis.stance.task import StandTask
from pupper_analysis.statics.cone_program import BALANCE_TOLERANCE
from pupper_analysis.statics.equilibrium import friction_utilisation_of
from pupper_analysis.statics.support_polygon import com_margin
from pupper_analysis.tools.path.dynamics import InverseDynamics, inverse_dynamics
from pupper_analysis.tools.path.geometry import PathPlace, clearance, minimum_jerk, path_geometry
from pupper_analysis.tools.path.kinds import PATH_TABLE

MIN_FADED_LOAD = 1e-3
"""Largest weight [1] at which `compute_path_sample` omits the solution with fewer loaded feet. With
such a weight, the zero-moment point may be close to the edge of the support polygon. Chosen, not
tuned.
"""


def compute_path_sample(
    robot: Robot,
    place: PathPlace,
    rate: float,
    acceleration: float,
) -> dict[str, Array]:
    """Compute torques, contact forces and margins of a sample of a path, as in `StancePath`.

    The forces have minimum tangential components. If fewer feet carry load in the previous or next
    segment, the forces are a weighted mean of the solutions with all feet and with the fewer feet.
    The weights change along the path, so that torques do not jump. Equilibrium is linear in the
    forces, so the mean satisfies the equilibrium.

    Args:
        robot: Robot.
        place: Geometry of the sample.
        rate: ds/dt of the path parameter [1/s].
        acceleration: d2s/dt2 of the path parameter [1/s^2].

    Returns:
        {array attribute of `StancePath`: value at this sample}, except ``time`` and ``qpos``.

    Raises:
        StaticsInfeasibleError: If no contact forces exist.
    """
    qvel, qacc = place.compute_motion(rate, acceleration)
    config, stand = Configuration(robot, place.qpos, qvel), place.stand

    def balance(feet: Sequence[str], *, held: bool = False) -> InverseDynamics:
        """Return the inverse dynamics of this path sample with load only on the points ``feet``.

        If ``held``, friction cones and unilateral limits are omitted.
        """
        return inverse_dynamics(config, qacc, feet, normals=stand.normals, held=held)

    whole = balance(stand.stance_feet)
    parts = [(1.0, whole)]
    for feet, near, full in _find_fading_sets(place):
        # Fewer feet can carry the load only if the zero-moment point is inside their polygon. Their
        # fraction grows with the distance to its edge, and along the segment.
        inside = max(0.0, balance(feet, held=True).zmp_margin or 0.0)
        share = near * minimum_jerk(min(1.0, inside / full))[0] if full > 0 else 0.0
        if share > MIN_FADED_LOAD:
            parts.append((share, balance(feet)))
    parts[0] = (1.0 - sum(share for share, _ in parts[1:]), whole)
    feet, zero_force = robot.contact_points, np.zeros(3)

    def mean(tables: Sequence[Mapping[str, Array]]) -> Array:
        """Return the weighted mean vector of each contact point over solutions, shape (feet, 3).

        ``tables``: {contact point: vector (3,)} of each solution; the weights are in ``parts``.
        """
        weighted = list(zip([share for share, _ in parts], tables, strict=True))
        rows = [[share * table.get(foot, zero_force) for foot in feet] for share, table in weighted]
        mixed: Array = np.sum(rows, axis=0)
        return mixed

    forces, points = mean([part.contact_forces for _, part in parts]), whole.contact_points
    rounding = BALANCE_TOLERANCE * float(np.linalg.norm(forces, axis=1).sum())
    utilisations = [
        friction_utilisation_of(
            force, stand.normals[foot].tolist(), robot.contacts[foot].sliding_friction, rounding
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
        "friction_utilisation": np.array(utilisations),
        "zero_moment_point": whole.zero_moment_point,
        "zmp_margin": np.array(com_margin(whole.zero_moment_point, points)),
        "clearance": np.array([clearance(place, robot.foot_of(point)) for point in feet]),
        "com_margin": np.array(com_margin(config.center_of_mass(), points)),
    }


def _find_fading_sets(place: PathPlace) -> list[tuple[tuple[str, ...], float, float]]:
    """Find the segments before and after a path sample in which fewer feet carry load.

    Returns:
        For each such segment (previous, then next): the loaded feet; nearness of the sample to the
        stance between both segments, from 0 (other end of the sample's segment) to 1 (at the
        stance); CoM margin [m] of this stance on these feet alone.
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


MAX_PATH_SAMPLES = 20_000
"""Approximate upper bound of the number of samples of a path, which bounds time and memory. Chosen,
not tuned.
"""

MIN_SAMPLES_PER_SEGMENT = 16
"""Lower bound of the number of samples per segment. With the minimum-jerk law, the largest sampled
second time derivative of the path parameter is then at most 1.1 % below the true maximum."""


_MIN_MOTION_SPEED = 1e-6
"""Largest speed of base and joints [m/s, rad/s] of a path without motion. The speeds between equal
stances are rounding errors. Chosen, not tuned.
"""


@dataclass(frozen=True, eq=False)
class StancePath(Tabular):
    """Path through stances with n samples, and the dynamics at the path's speed.

    ``qvel`` and ``qacc`` are derivatives of ``qpos`` in the public convention: linear velocity of
    the base in the world frame, angular velocity in the frame of the base.

    Attributes:
        stances: Solved stances.
        joint_names: Names of the joints, in actuator order.
        units: (nu,) units of the joint positions: rad, or m for a slide, whose motor force is in N
            in place of N m.
        feet: Names of the contact points.
        time: Shape (n,); from 0, evenly spaced. Each stance is a sample.
        qpos: Shape (n, nq); configurations.
        qvel: Shape (n, nv); generalised velocities.
        qacc: Shape (n, nv); generalised accelerations.
        torques: Shape (n, nu); motor torques of the motion.
        stance_feet: Shape (n, feet); True if a foot is loaded.
        forces: Shape (n, feet, 3); force of the ground on each foot, in world axes.
        moments: Shape (n, feet, 3); moment with which the ground resists rolling and spinning, in
            world axes.
        loads: Shape (n, feet); vertical component of ``forces``.
        friction_utilisation: Shape (n, feet); tangential force / (friction coefficient x normal
            force). Zero for an unloaded foot.
        zero_moment_point: Shape (n, 3), in the world frame. NaN if balance requires the ground to
            pull.
        zmp_margin: Shape (n,); distance from the projected zero-moment point to the edge of the
            support polygon, positive inside.
        clearance: Shape (n, feet); height of each foot above the ground. Zero if the foot touches
            the ground.
        com_margin: Shape (n,); distance from the projected CoM to the edge of the support polygon,
            positive inside.
        peak_utilisation: Largest torque / effort limit; of joints in ``motors``, largest torque /
            torque that the motor exerts at its speed. Above 1 the motors are too weak; NaN if no
            limit is known.
        peak_joint: Joint with the largest utilisation; the first joint if no limit is known.
        peak_time: Time of the largest utilisation; 0 if no limit is known.
        peak_speed_utilisation: Largest joint speed / velocity limit of the URDF; NaN if the URDF
            states none.
        fastest_joint: Joint with the largest speed utilisation; the first joint if no limit is
            known.
        motors: {joint: name of the motor whose torque-speed region is used}.
    """

    _units_of_columns: ClassVar[dict[str, str]] = {"q *": POSITION_UNIT, "tau *": EFFORT_UNIT}

    stances: tuple[Stand, ...]
    joint_names: tuple[str, ...]
    units: tuple[str, ...]
    feet: tuple[str, ...]
    time: Array = field(metadata={"unit": "s"})
    qpos: Array = field(metadata={"unit": "m, 1 (quaternion) and rad"})
    qvel: Array = field(metadata={"unit": "m/s and rad/s"})
    qacc: Array = field(metadata={"unit": "m/s^2 and rad/s^2"})
    torques: Array = field(metadata={"unit": EFFORT_UNIT})
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
    motors: dict[str, str] = field(default_factory=dict)

    def _columns(self) -> dict[str, Array]:
        """Return {column: values, shape (n,)} of the samples, in SI units.

        Columns: time, joint positions, motor torques, and the margins of zero-moment point and CoM.
        """
        angles = dict(zip(self.joint_names, self.joint_positions().T, strict=True))
        torques = dict(zip(self.joint_names, self.torques.T, strict=True))
        return {
            "time": self.time,
            **{f"q {name}": values for name, values in angles.items()},
            **{f"tau {name}": values for name, values in torques.items()},
            "zmp_margin": self.zmp_margin,
            "com_margin": self.com_margin,
        }

    @property
    def has_motion(self) -> bool:
        """Whether the largest speed of base and joints exceeds `_MIN_MOTION_SPEED`."""
        return bool(np.abs(self.qvel).max() > _MIN_MOTION_SPEED)

    def joint_positions(self) -> Array:
        """Return the joint positions of all n samples of the path, shape (n, nu) [rad, m]."""
        return self.qpos[:, self.qpos.shape[1] - len(self.joint_names) :]

    def to_csv(self, path: str | Path, *, force: bool = False) -> None:
        """Write time, joint positions and motor torques of a path as CSV, with units in the header.

        Args:
            path: Output file.
            force: True to replace an existing file of any content, except an input file of the
                running command. If False, only an earlier table of a path or an empty file is
                replaced.

        Raises:
            OutputError: If the file cannot be written, or would replace other content.
        """
        units = dict(zip(self.joint_names, self.units, strict=True))
        header = ["time (s)", *(f"q {name} ({unit})" for name, unit in units.items())]
        efforts = {name: find_joint_units(unit).effort for name, unit in units.items()}
        header += [f"tau {name} ({unit})" for name, unit in efforts.items()]
        rows = np.column_stack([self.time, self.joint_positions(), self.torques])
        with write_atomically(Path(path), PATH_TABLE, force=force) as file:
            file.write(csv_text([header, *rows.tolist()]).encode())


@check_arguments
def stance_path(
    robot: Robot,
    stances: Sequence[StandTask],
    seconds: float,
    *,
    rate: float = 50.0,
    rolling: bool = True,
    motors: Mapping[str, Motor] | None = None,
) -> StancePath:
    """Compute a smooth path through stances, with torques and contact forces.

    The path parameter of a segment follows a minimum-jerk law with zero velocity and acceleration
    at each stance. All segments have the same duration. The horizontal position of the CoM, not of
    the base, is linear in the path parameter.

    Torques and contact forces are those of the motion (``inverse_dynamics``), including damping and
    dry friction of the joints and the ground's resistance to rolling feet, with minimum tangential
    forces.

    A foot that is lifted in a stance is unloaded from the previous to the next stance. In these
    stances, the CoM must already be above the other feet. On the segments before and after, its
    load fades out or in, so that torques are continuous.

    A loaded foot does not slip, but the sphere of the foot (radius r) rolls as the leg rotates with
    angular velocity omega. The centre moves with omega x r n, with the normal n of the ground.
    After the first stance, feet therefore deviate from their positions in the stances by the rolled
    distance.

    Args:
        robot: Robot with a floating base.
        stances: Two or more stand tasks on the same ground, without an offset of the base. To wait
            in a stance, pass it twice. ``ik_seed`` of the first task is used; later tasks start
            from the previous solution.
        seconds: Duration of the path [s].
        rate: Minimum sampling rate [Hz]. A segment has at least `MIN_SAMPLES_PER_SEGMENT` samples.
        rolling: Feet roll without slipping. If False, the centres of the foot spheres do not move.
        motors: {joint: motor}, for the utilisation in the torque-speed region of the motors.

    Raises:
        StanceUnreachableError: If a stance or sample is out of reach. The error contains the number
            of the stance, or the time of the sample.
        StaticsInfeasibleError: If a sample cannot be held at this speed, or the CoM margin of a
            sample is smaller than the tasks require. The error contains the time.
    """
    for joint, motor in (motors or {}).items():
        check_type(f"motors[{joint!r}]", motor, Motor)
    if not robot.fixed_parts:
        robot.check_floating()
    robot.check_tree("a path")
    per_segment = _count_samples(seconds, rate, stances)
    if robot.fixed_parts or any(task.contacts for task in stances):
        raise ConfigurationError("contacts", diagnose("no-path-with-contacts"))
    if any(task.offset is not None for task in stances):
        raise ConfigurationError("offset", diagnose("no-path-with-offsets"))
    geometry = path_geometry(robot, stances, per_segment, float(seconds), rolling=rolling)
    duration = float(seconds) / len(geometry.segments)
    efforts = []
    for index, place in enumerate(geometry.places):
        report_progress("path", index, len(geometry.places))
        _, rate, acceleration = minimum_jerk(place.progress)
        motion = rate / duration, acceleration / duration**2
        try:
            efforts.append(compute_path_sample(robot, place, *motion))
        except StaticsInfeasibleError as error:
            raise error.with_location(geometry.describe_sample(index)) from None
    time = np.linspace(0.0, float(seconds), len(efforts))
    tables = {name: np.array([effort[name] for effort in efforts]) for name in efforts[0]}
    used = divide_by_limits(tables["torques"], robot.effort_limits)
    joints = slice(robot.nv - robot.nu, None)
    regions = compute_motor_utilisation(
        motors or {}, robot.joint_names, tables["torques"], tables["qvel"][:, joints]
    )
    used = np.where(np.isnan(regions), used, regions)
    speeds = divide_by_limits(tables["qvel"][:, joints], robot.velocity_limits)
    peak, fastest = (
        np.unravel_index(int(np.nan_to_num(table, nan=-1.0, posinf=np.inf).argmax()), table.shape)
        for table in (used, speeds)
    )
    return StancePath(
        stances=geometry.stances,
        joint_names=robot.joint_names,
        units=list_position_units(robot),
        feet=robot.contact_points,
        time=time,
        qpos=np.array([place.qpos for place in geometry.places]),
        **tables,
        peak_utilisation=float(used[peak]),
        peak_joint=robot.joint_names[int(peak[1])],
        peak_time=float(time[peak[0]]),
        peak_speed_utilisation=float(speeds[fastest]),
        fastest_joint=robot.joint_names[int(fastest[1])],
        motors={joint: motor.name for joint, motor in (motors or {}).items()},
    )


def divide_by_limits(values: Array, limits: Array) -> Array:
    """Compute the utilisation abs(values) / limits of torques or velocities, shape (n, nu).

    Args:
        values: Torques or velocities of the joints, shape (n, nu).
        limits: Limits in the same unit, shape (nu,); infinite for an unknown limit.

    Returns:
        Utilisation: NaN for an unknown limit; for a limit of zero or less, 0 if the value is at
        most `_ZERO_ATOL`, else infinity.
    """
    sizes = np.abs(values)
    with np.errstate(divide="ignore", invalid="ignore"):
        null = np.where(sizes > _ZERO_ATOL, np.inf, 0.0)
        shares: Array = np.where(limits > 0, sizes / limits, null)
    return np.where(np.isinf(limits), np.nan, shares)


_ZERO_ATOL = 1e-9
"""Largest torque [N m, or N for a slide] or speed [rad/s, m/s] that counts as zero at a joint whose
limit is zero (rounding). Chosen, not tuned.
"""


MIN_DURATION = 1e-3
"""Lower bound of the duration of a path [s]. Chosen, not tuned."""


def _count_samples(seconds: float, rate: float, stances: Sequence[StandTask]) -> int:
    """Return the number of samples per segment, from the duration [s] and the minimum rate [Hz]."""
    if len(stances) < 2:
        raise ConfigurationError("stances", diagnose("path-of-one-stance"))
    for name, value in (("seconds", seconds), ("rate", rate)):
        if not 0 < value < math.inf:
            raise ConfigurationError(name, diagnose("not-finite-above-0", value=repr(value)))
    if seconds < MIN_DURATION:
        message = diagnose("shorter-than-least", seconds=seconds, least=MIN_DURATION)
        raise ConfigurationError("seconds", message)
    if max(seconds * rate, MIN_SAMPLES_PER_SEGMENT * len(stances)) > MAX_PATH_SAMPLES:
        message = diagnose("too-many-samples", most=MAX_PATH_SAMPLES)
        raise ConfigurationError("seconds, rate", message)
    return max(MIN_SAMPLES_PER_SEGMENT, math.ceil(seconds * rate / (len(stances) - 1) - 1e-9))
