"""First-order payload limit of a stance: motors, contacts, servo stiffness and ground contact.

`SmallPayload.compute_rows` returns linear constraints on the payload mass, `largest_feasible_mass`
the largest mass that satisfies the constraints. Torques and contact forces are extrapolated from
two equilibria; the buckling masses follow from eigenvalues of the stiffness. The limit is used only
as the objective of the search for the best stance; `payload_limit` computes the limit by
simulation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from scipy import linalg

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.arrays import cross_matrices
from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.configuration import UP, Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tool import Tool, with_payload
from pupper_analysis.stance.sag.equilibrium import Anchor, ContactKinematics
from pupper_analysis.stance.stand import Stand, stand_contacts
from pupper_analysis.statics.equilibrium import distribute_loads

SMALL_PAYLOAD_RATIO = 0.1
"""Mass of the payload with which `SmallPayload` computes the second equilibrium, relative to the
robot's mass [1]. Torques and forces at larger payloads are extrapolated from the equilibria without
and with this payload. It is small, since a mass that tips the robot has no equilibrium. Chosen, not
tuned.
"""

_SLIP_RTOL = 1e-3
"""Relative tolerance of the singular values of the tangential contact Jacobian (rad and m mixed),
up to which a motion counts as free of slip. The points of a flat sole sink by slightly different
depths, so a sole that tilts also slips. Measured on H1 and a biped of the tests: at most 5e-6 for
soles that tilt, at least 0.05 for soles that slide.
"""


class SmallPayload:
    """Small payload, from whose effect on torques and forces larger payloads are extrapolated.

    Args:
        robot: Robot without closed loops.
        point: Position of the payload.
        kp: Servo stiffness at the joints, shape (nu,) [N m/rad, N/m].

    Attributes:
        mass: Mass of the payload [kg]: `SMALL_PAYLOAD_RATIO` times the robot's mass.
    """

    def __init__(self, robot: Robot, point: Tool, kp: Array) -> None:
        self._robot, self._point, self._kp = robot, point, kp
        self.mass = SMALL_PAYLOAD_RATIO * robot.total_mass
        loaded = with_payload(robot, self.mass, point)
        self._laws = {foot: GroundLaw.of_contact(loaded, foot) for foot in robot.contact_points}

    def compute_rows(self, stand: Stand) -> Array | None:
        """Compute the inequalities a + b m >= 0 that a stand imposes on the payload mass m [kg].

        Torques and minimum-tangential contact forces are taken as linear in m, on the line through
        two equilibria, without and with ``mass``.

        Returns:
            Rows (a, b), shape (k, 2) [1, 1/kg], or None if the stand is not stable without payload.
            The rows limit buckling, torques, normal forces and the sinking of feet.

        Raises:
            StaticsInfeasibleError: If no contact forces balance the stand without payload or with
                ``mass``.
        """
        # On level ground the contact forces are vertical, and minimise the sum of squares under
        # three balance equations with a right-hand side that is linear in m.
        robot, mass = self._robot, self.mass
        config, carrying = Configuration(robot, stand.qpos), stand_contacts(robot, stand)
        load = config.static_load()
        loads = np.array([load, load + mass * self._point.load_per_mass(config)])
        (forces, loaded_forces), (torques, loaded_torques) = distribute_loads(
            config, loads, carrying
        )
        force_rates, limits = (loaded_forces - forces) / mass, robot.effort_limits
        limited = np.isfinite(limits)
        torque_lines = np.column_stack([torques, (loaded_torques - torques) / mass])
        utilisation_lines = torque_lines[limited] / limits[limited, None]
        normals, normal_rates = (
            np.einsum("ni,ni->n", vectors, carrying.normals) for vectors in (forces, force_rates)
        )
        laws = [self._laws[foot] for foot in stand.stance_feet]
        loaded_normals = np.maximum(normals + mass * normal_rates, 0.0)
        penetrations = np.array(
            [law.depth(load) for law, load in zip(laws, loaded_normals, strict=True)]
        )
        lines = forces, force_rates
        modes = _compute_buckling_modes(
            config, stand, self._kp, lines, self._point, laws, penetrations
        )
        if modes is None:
            return None
        normal_lines = np.column_stack([normals, normal_rates]) / robot.weight
        full_limit = np.array([1.0, 0.0])
        buckling = np.column_stack([np.ones(len(modes)), -modes])
        rows = [
            buckling,
            full_limit - utilisation_lines,
            full_limit + utilisation_lines,
            normal_lines,
        ]
        if (lowest := stand.ground_clearance) is not None:
            depths = [max(0.0, lowest.distance) + stand.depths[foot] for foot in stand.stance_feet]
            max_forces = [law.force(depth) for law, depth in zip(laws, depths, strict=True)]
            limit = np.column_stack([max_forces, np.zeros(len(laws))]) / robot.weight
            rows.append(limit - normal_lines)
        result: Array = np.concatenate(rows)
        return result


def largest_feasible_mass(rows: Array) -> float:
    """Compute the largest mass m [kg] that satisfies constraints a + b m >= 0 with b < 0.

    ``rows`` contains (a, b), shape (k, 2) [1, 1/kg]. The mass is infinite without such a
    constraint, and negative if one is violated without payload.
    """
    binding = rows[rows[:, 1] < 0]
    return float(np.min(-binding[:, 0] / binding[:, 1], initial=math.inf))


def _compute_buckling_modes(
    config: Configuration,
    stand: Stand,
    kp: Array,
    lines: tuple[Array, Array],
    point: Tool,
    laws: Sequence[GroundLaw],
    penetrations: Array,
) -> Array | None:
    """Compute 1 / m of the payloads m at which a stand with feed-forward torques buckles.

    The stiffness is linear in m: K(m) = K_0 + m G, with the geometric stiffness G of the payload's
    weight and its contact forces, on motions without slip. The stand buckles in a mode v if K(m) v
    = 0, which is the generalised eigenvalue problem -G v = mu K_0 v with mu = 1 / m. The ground
    stiffness is taken at constant ``penetrations``. On a slope K is not symmetric, and is replaced
    by its symmetric part.

    Args:
        config: Configuration of the stand.
        stand: Stand.
        kp: Servo stiffness at the joints, shape (nu,) [N m/rad, N/m].
        lines: Contact forces without payload, shape (n, 3) [N], and the derivative by the payload
            mass, shape (n, 3) [N/kg], in world axes.
        point: Position of the payload.
        laws: Ground law of each stance foot.
        penetrations: Penetration of each stance foot, shape (n,) [m].

    Returns:
        Values mu of the modes that a payload buckles [1/kg], in descending order, and zeros, shape
        (nv,). If mu[0] > 0, the smallest buckling mass is 1 / mu[0]. None if the stand is not
        stable without payload.
    """
    robot, feet = config.robot, stand.stance_feet
    rotations = [pin.Quaternion.FromTwoVectors(stand.normals[foot], UP) for foot in feet]
    frames = np.array([rotation.matrix() for rotation in rotations])
    centres = config.foot_centres(feet)
    poses = zip(feet, centres, config.foot_rotations(feet), strict=True)
    anchors = {foot: Anchor(position, rotation) for foot, position, rotation in poses}
    depths = dict(zip(feet, penetrations.tolist(), strict=True))
    crosses = cross_matrices(frames[:, 2])
    kinematics = ContactKinematics(config, anchors, centres, frames, crosses, depths)
    tangential = kinematics.jacobians[:, :2].reshape(-1, robot.nv)
    normal = kinematics.jacobians[:, 2]
    stiffnesses = np.array(
        [law.normal_stiffness(depth) for law, depth in zip(laws, depths.values(), strict=True)]
    )
    forces, force_rates = ((frames @ line[:, :, None])[:, :, 0] for line in lines)
    geometric = kinematics.balance_rates(forces)  # without servos and ground
    softening = geometric - kinematics.balance_rates(forces + force_rates)  # -G, for 1 kg
    twists, weight = point.twist_jacobian(config)[None], np.zeros((1, 6))
    softening += config.loaded_points_derivative(twists, weight)
    weight[0, :3] = robot.gravity
    softening -= config.loaded_points_derivative(twists, weight)
    stiffness = geometric + normal.T @ (stiffnesses[:, None] * normal)
    stiffness[6:, 6:] += np.diag(kp)
    basis = linalg.null_space(tangential, rcond=_SLIP_RTOL)
    left, right = (basis.T @ matrix @ basis for matrix in (softening, stiffness))
    try:
        modes: Array = linalg.eigh((left + left.T) / 2, (right + right.T) / 2, eigvals_only=True)
    except np.linalg.LinAlgError:
        return None
    # The number of motions without slip may differ between the stances of a search.
    padded: Array = np.zeros(robot.nv)
    padded[: len(modes)] = np.maximum(modes[::-1], 0.0)
    return padded
