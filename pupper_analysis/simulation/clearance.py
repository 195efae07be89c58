"""Lower bounds of the distance [m] between the ground and a moving robot, without the feet.

`ClearanceBounds` shows without collision detection that no part touches the ground. `distance`
computes the distance of all parts except the feet from the ground, at a reference state.
`displacements` bounds the motion of the robot between the reference state and other states of a
simulation. A part cannot reach the ground while its displacement is smaller than this distance.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.models.mjcf import JointKind
from pupper_analysis.robot.robot import Robot
from pupper_analysis.simulation.rollout import STATE_SPEC


class ClearanceBounds:
    """Bounds of distance and motion that prove, without collision detection, that only feet touch.

    The parts are the geoms of all bodies except the world that can collide, without the feet. The
    ground consists of the geoms of the world body that can collide. The distance is measured
    between planes and the bounding boxes of the geoms. Between two states no point of the robot
    moves by more than

        |dp| + 2 L sin(a / 2) + L sum |dq_hinge| + sum |dq_slide|

    with the displacement dp and the rotation angle a of the base, and the length L of the longest
    chain of bodies. A slide joint is assumed to stay within twice its limits (`_MAX_LIMIT_RATIO`).
    The bounds are not available if a geom of the ground is no plane, or if a joint is a ball joint,
    a second free joint, or a slide joint without limits.

    Attributes:
        is_available: Whether the bounds are available.

    Args:
        robot: Robot.
        model: MuJoCo model that is simulated.
    """

    def __init__(self, robot: Robot, model: mujoco.MjModel) -> None:
        self._model, self._data = model, mujoco.MjData(model)
        collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
        collides[[*model.pair_geom1, *model.pair_geom2]] = True
        fixed = model.geom_bodyid == 0
        moving = collides & ~fixed
        moving[list(robot.foot_geoms)] = False
        self._parts, self._ground = np.flatnonzero(moving), np.flatnonzero(collides & fixed)
        margins = model.geom_margin.max(initial=0.0), model.pair_margin.max(initial=0.0)
        self._margin = 2 * float(margins[0]) + float(margins[1])
        kinds = model.jnt_type
        hinges, slides = kinds == JointKind.HINGE, kinds == JointKind.SLIDE
        free = np.flatnonzero(~hinges & ~slides)
        self._base = None if len(free) == 0 else 1 + model.jnt_qposadr[free[0]] + np.arange(7)
        self._hinges, self._slides = (1 + model.jnt_qposadr[kind] for kind in (hinges, slides))
        self._length = _chain_length(model)
        is_plane = (model.geom_type[self._ground] == mujoco.mjtGeom.mjGEOM_PLANE.value).all()
        is_free_base = len(free) == 0 or (len(free) == 1 and kinds[free[0]] == JointKind.FREE)
        self.is_available = bool(is_plane and is_free_base and math.isfinite(self._length))

    def distance(self, state: Array) -> float:
        """Compute a lower bound of the distance [m] between the ground and the robot without feet.

        Args:
            state: State of a simulation (mjSTATE_FULLPHYSICS).

        Returns:
            Lower bound [m]. 0 if ``is_available`` is False, or if a bounding box is within the
            contact margins of the ground. Otherwise infinite if the model has no ground, or no geom
            except the feet that can collide.
        """
        if not self.is_available:
            return 0.0
        if not len(self._parts) or not len(self._ground):
            return math.inf
        model, data = self._model, self._data
        mujoco.mj_setState(model, data, state, STATE_SPEC)
        mujoco.mj_kinematics(model, data)
        rotations = data.geom_xmat[self._parts].reshape(-1, 3, 3)
        boxes = model.geom_aabb[self._parts]
        centres = data.geom_xpos[self._parts] + (rotations @ boxes[:, :3, None])[..., 0]
        normals = data.geom_xmat[self._ground].reshape(-1, 3, 3)[:, :, 2]
        heights = (centres[:, None] - data.geom_xpos[self._ground]) @ normals.T
        heights = np.diagonal(heights, axis1=1, axis2=2)
        extents = np.einsum("pij,gi->pgj", rotations, normals)
        lowest = heights - np.einsum("pgj,pj->pg", np.abs(extents), boxes[:, 3:])
        return max(float(lowest.min()) - self._margin, 0.0)

    def displacements(self, states: Array, reference: Array) -> Array:
        """Compute an upper bound of the distance that any robot point moves from a reference state.

        Valid only if ``is_available``.

        Args:
            states: States of a simulation (mjSTATE_FULLPHYSICS), shape (n, size).
            reference: Reference state (mjSTATE_FULLPHYSICS), shape (size,).

        Returns:
            Upper bound for each state, shape (n,) [m].
        """
        moved = np.abs(states - reference)
        total = self._length * moved[:, self._hinges].sum(axis=1)
        total += moved[:, self._slides].sum(axis=1)
        if self._base is not None:
            place, turn = self._base[:3], self._base[3:]
            cosines = states[:, turn] @ reference[turn]
            total += np.linalg.norm(moved[:, place], axis=1)
            total += 2 * self._length * np.sqrt(np.maximum(1 - cosines**2, 0.0))
        return np.asarray(total)


def _chain_length(model: mujoco.MjModel) -> float:
    """Compute an upper bound of the distance [m] between the base and any point of the robot.

    The bound is infinite with a slide joint without limits.
    """
    reach = np.zeros(model.nbody)
    longest = 0.0
    for body in range(1, model.nbody):
        parent = int(model.body_parentid[body])
        # The place of a first body is the position of the base, not a length of the robot.
        offset = float(np.linalg.norm(model.body_pos[body])) if parent else 0.0
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        for joint in range(first, first + count):
            offset += 2 * float(np.linalg.norm(model.jnt_pos[joint]))
            if model.jnt_type[joint] == JointKind.SLIDE:
                limited = bool(model.jnt_limited[joint])
                offset += (
                    _MAX_LIMIT_RATIO * float(np.abs(model.jnt_range[joint]).max())
                    if limited
                    else math.inf
                )
        reach[body] = reach[parent] + offset
        start, number = int(model.body_geomadr[body]), int(model.body_geomnum[body])
        for geom in range(start, start + number):
            size = float(np.linalg.norm(model.geom_pos[geom]) + model.geom_rbound[geom])
            longest = max(longest, reach[body] + size)
    return longest


_MAX_LIMIT_RATIO = 2.0
"""Upper bound of the absolute position of a slide joint in a simulation, divided by the larger
absolute value of its two limits [1]. Used for the upper bound of the robot's displacements, because
limits in MuJoCo are soft. Chosen, not tuned."""
