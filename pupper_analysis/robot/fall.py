"""Detect whether a simulated robot has fallen, sunk, risen, or moved away horizontally.

Heights are heights of the robot's centre of mass (CoM) above the supporting ground. The height of
the base frame is not used, because a file may place that frame anywhere.

Each reference value is measured at reset, before the judged motion. The initial height is the CoM
height above the ground at reset, minus the clearance at reset.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.array_types import Array
from pupper_analysis.robot.contact import find_acting_contacts, list_contact_bodies

FALLEN_TILT = 0.5
"""Tilt of the base, relative to its initial or requested orientation [rad], above which a robot has
fallen over, or a keyframe counts as tilted. Chosen, not tuned."""

MAX_HEIGHT_LOSS_RATIO = 0.3
"""Largest accepted change of the CoM height, upward or downward, relative to the initial height
[1]. With a larger change, the robot has sunk or risen. The value lies between two cases: servo sag
is a tenth of the height (Pupper v3 at kp 5: 9 %), and a robot on its shanks has half of its
height."""


def tilt_between(first: Array, second: Array) -> float:
    """Return the relative tilt [rad] of two orientations; a yaw about the world's z has no effect.

    The tilt is the angle between the world's z axes, each expressed in body axes: the third rows of
    the two matrices.

    Args:
        first: Rotation matrix, body to world, shape (3, 3).
        second: Rotation matrix, body to world, shape (3, 3).
    """
    return math.acos(min(1.0, max(-1.0, float(first[2] @ second[2]))))


MAX_KEYFRAME_DURATION = 5.0
"""Longest simulated time of a run from a keyframe [s]. Files with short time steps are simulated
for a shorter time (`keyframe_duration`). After 5 s, a drop by centimetres has ended, and slow
failures are visible (a knee without torque: 2 cm/s after 2 s)."""

_MAX_KEYFRAME_STEPS = 5000
"""Maximum number of time steps of a run from a keyframe, unless the run would be shorter than
`_MIN_KEYFRAME_DURATION`. This bounds the computing time. Chosen, not tuned."""

_MIN_KEYFRAME_DURATION = 2.0
"""Lower bound of the simulated time of a run from a keyframe [s]. Chosen, not tuned: a robot that
topples quickly lies on the ground by then."""

MAX_TRAVEL_RATIO = 1.0
"""Horizontal travel of the CoM, relative to the initial CoM height [1], above which a robot has
moved away. Chosen, not tuned: on planted feet, a robot would fall earlier. (Sideways gravity moves
a robot by 20 m in 2 s.)"""

NUDGE_SPEED = 1e-3
"""Largest component of a nudge, a small change of the initial velocities [m/s, rad/s]; also the
tolerance of velocities in `_are_equal_states`. The nudge must upset unstable equilibria: some
survive changes of 1e-9 and fall after changes of 1e-7. Chosen, not tuned."""

MAX_CLEARANCE = 5.0
"""Longest vertical distance (m) over which the ground below a robot is searched. Chosen, not tuned:
a free fall over 5 m takes 1 s."""

_MAX_RUN_DISTANCE = 1e-4
"""Largest difference of a coordinate [m, rad] with which two runs from the same keyframe count as
equal, halfway through the runs. Reason: if a nudge upsets a robot by the end of a run, the
difference grows exponentially from about 1e-4 to `FALLEN_TILT`. Halfway, the difference then
exceeds 1e-3."""

_SEARCH_MARGIN = 0.05
"""Longest downward step [m] of the search for the ground below a robot (`initial_height`). Chosen,
not tuned."""

_CONTACT_DISTANCE = 1e-6
"""Distance between robot and ground [m] below which the search for the ground (`initial_height`)
ends. Chosen, not tuned."""

_MIN_UPWARD_NORMAL = 0.1
"""Vertical component of a contact's unit normal [1] above which the contact counts as ground in the
search below a robot. The normal of a wall has a smaller component. Chosen, not tuned."""


_RESET_WARNINGS = slice(
    mujoco.mjtWarning.mjWARN_BADQPOS.value, mujoco.mjtWarning.mjWARN_BADQACC.value + 1
)
"""MuJoCo's warnings BADQPOS, BADQVEL and BADQACC: numbers of the state are not finite or too large.
MuJoCo resets the state after such a warning, unless the MJCF disables ``autoreset``."""


def nudge_velocity(model: mujoco.MjModel) -> Array:
    """Return a nudge: small pseudo-random velocities of base and joints, shape (nv,) [m/s, rad/s].

    No absolute value exceeds 1e-3 m/s or rad/s (``NUDGE_SPEED``). The vector is random, so that it
    excites modes in spite of symmetry. The seed is constant, so that results are repeatable.
    """
    nudge = np.random.default_rng(0).uniform(-1.0, 1.0, model.nv)
    return np.asarray(NUDGE_SPEED * nudge / np.abs(nudge).max(initial=0.5))


def keyframe_duration(model: mujoco.MjModel) -> float:
    """Return the simulated time [s] of a run from a keyframe, from 2 to 5 s.

    The time is shorter for a model with short time steps, to bound the computing time.
    """
    affordable = _MAX_KEYFRAME_STEPS * float(model.opt.timestep)
    return min(MAX_KEYFRAME_DURATION, max(_MIN_KEYFRAME_DURATION, affordable))


@dataclass(frozen=True)
class BodyMotion:
    """Motion of a robot that is expected to stay in place, from reset to the end of a simulation.

    Attributes:
        duration: Simulated time (s).
        height: CoM height above the ground at reset, minus ``clearance`` (m).
        end_height: CoM height at the end above the ground height at reset (m).
        lean: Tilt of the base at the end relative to reset (rad); a yaw about the world's z axis
            has no effect (`tilt_between`).
        away: Horizontal distance of the CoM at the end from the CoM at reset (m).
        diverged: Whether numbers of the state were not finite or too large (MuJoCo then resets the
            state), or MuJoCo stopped with an error.
        clearance: Vertical distance by which the robot could move downward to the ground at reset
            (m); negative if the robot penetrates the ground; 0 if no ground was found.
        lies: Whether the robot ends on its base or hips. Also True if bodies touch the ground, but
            no limb end. If True, the drop by ``clearance`` counts as lost height.
    """

    duration: float = field(metadata={"unit": "s"})
    height: float = field(metadata={"unit": "m"})
    end_height: float = field(metadata={"unit": "m"})
    lean: float = field(metadata={"unit": "rad"})
    away: float = field(metadata={"unit": "m"})
    diverged: bool
    clearance: float = field(default=0.0, metadata={"unit": "m"})
    lies: bool = False

    @property
    def collapses(self) -> bool:
        """Whether the robot has fallen over, sunk, risen, moved away horizontally, or diverged."""
        return self.diverged or self._has_collapsed(self.away)

    @property
    def has_left_place(self) -> bool:
        """True if the robot collapses only because its CoM moved too far horizontally."""
        return self.collapses and not self.diverged and not self._has_collapsed(0.0)

    @property
    def is_lifted(self) -> bool:
        """Whether the robot ends upright, with its CoM far above the initial height."""
        return not self.diverged and is_lifted(
            self.lean, self.height - self.end_height, self.height
        )

    def _has_collapsed(self, away: float) -> bool:
        """Return True if this motion, with the horizontal travel ``away`` [m], is a collapse."""
        size = self.height + max(self.clearance, 0.0) if self.lies else self.height
        return has_collapsed(self.lean, size - self.end_height, away, size)


def simulate_keyframe(
    model: mujoco.MjModel,
    start: mujoco.MjData,
    base: int,
    ground: float,
    advance: Callable[[mujoco.MjData, float], object],
) -> tuple[BodyMotion, mujoco.MjData]:
    """Simulate a robot from a keyframe, up to three times, to test whether it stays in place.

    The first run starts with a nudge (`nudge_velocity`), the second with the opposite nudge,
    because a robot may fall to one side only. The third run has no nudge. The result is the first
    run in which the robot collapses, otherwise the first run. In a model without activations, a run
    that nearly equals the first run halfway is not completed.

    Args:
        model: MuJoCo model.
        start: State with commands; not changed.
        base: Body id of the base.
        ground: Height of the ground [m] that is assumed if no ground is found below the robot.
        advance: Function that simulates a state for a time [s], in place. The time is a multiple of
            the time step.

    Returns:
        Motion of the robot, and the state at the end.
    """
    seconds, before = keyframe_duration(model), _copy_with_kinematics(model, start)
    timestep = float(model.opt.timestep)
    num_steps = round(seconds / timestep)
    # ``advance`` resets activations at each call, so such a run is not divided into two calls.
    first_steps = 0 if model.na else num_steps // 2
    initial = initial_height(model, start, base, ground)
    runs: list[tuple[BodyMotion, mujoco.MjData]] = []
    reference: tuple[Array, Array] | None = None
    for sign in (1.0, -1.0, 0.0):
        data, diverged = copy.copy(start), False
        data.qvel[:] += sign * nudge_velocity(model)
        try:
            if first_steps:
                advance(data, first_steps * timestep)
                halfway = data.qpos.copy(), data.qvel.copy()
                if reference is not None and _are_equal_states(model, reference, halfway):
                    continue
                reference = halfway if reference is None else reference
            advance(data, (num_steps - first_steps) * timestep)
        except mujoco.FatalError:  # for example degenerate contacts
            diverged = True
        moved = measure_motion(model, before, data, base, seconds, initial)
        lies = _lies_on_trunk(model, data, base)
        runs.append((replace(moved, diverged=moved.diverged or diverged, lies=lies), data))
        if runs[-1][0].collapses:
            return runs[-1]
    return runs[0]


def _are_equal_states(
    model: mujoco.MjModel, first: tuple[Array, Array], second: tuple[Array, Array]
) -> bool:
    """Return True if two states (qpos, qvel) are nearly equal; False if values are not finite."""
    distance = np.empty(model.nv)
    mujoco.mj_differentiatePos(model, distance, 1.0, first[0], second[0])
    return bool(
        np.abs(distance).max(initial=0.0) <= _MAX_RUN_DISTANCE
        and np.abs(second[1] - first[1]).max(initial=0.0) <= NUDGE_SPEED
    )


def simulate_held_keyframe(
    model: mujoco.MjModel,
    start: mujoco.MjData,
    advance: Callable[[mujoco.MjData, float], object],
) -> tuple[BodyMotion, mujoco.MjData]:
    """Simulate a robot with a fixed base after a nudge (small velocities), to detect divergence.

    Args:
        model: MuJoCo model.
        start: State with commands; not changed.
        advance: Function that simulates a state for a time [s], in place.

    Returns:
        Motion of the robot, in which heights, distance and tilt are 0; state at the end.
    """
    data, seconds = copy.copy(start), keyframe_duration(model)
    data.qvel[:] += nudge_velocity(model)
    diverged = False
    try:
        advance(data, seconds)
    except mujoco.FatalError:
        diverged = True
    return BodyMotion(seconds, 0.0, 0.0, 0.0, 0.0, diverged or was_reset_by_mujoco(data)), data


def was_reset_by_mujoco(data: mujoco.MjData) -> bool:
    """Return True if MuJoCo has found numbers of a state that were not finite, or too large.

    MuJoCo then resets the state, unless the MJCF disables ``autoreset``.
    """
    return bool(count_resets(data).any())


def count_resets(data: mujoco.MjData) -> NDArray[np.int32]:
    """Return MuJoCo's counters of warnings about bad qpos, qvel and qacc, shape (3,).

    The result is a view into ``data``: the values change while MuJoCo simulates.
    """
    counters: NDArray[np.int32] = data.warning.number[_RESET_WARNINGS]
    return counters


def _copy_with_kinematics(model: mujoco.MjModel, data: mujoco.MjData) -> mujoco.MjData:
    """Return a copy of a state with evaluated positions of bodies and centres of mass."""
    placed = copy.copy(data)
    mujoco.mj_kinematics(model, placed)
    mujoco.mj_comPos(model, placed)
    return placed


def measure_motion(
    model: mujoco.MjModel,
    start: mujoco.MjData,
    end: mujoco.MjData,
    base: int,
    seconds: float,
    initial: InitialHeight,
) -> BodyMotion:
    """Compute the motion of a robot's base and CoM between reset and the end of a simulation.

    Args:
        model: MuJoCo model.
        start: State at reset.
        end: State at the end of the simulation.
        base: Body id of the base.
        seconds: Simulated time [s].
        initial: CoM height, clearance and ground height at reset, from the function
            `initial_height`.
    """
    first, last = (_copy_with_kinematics(model, data) for data in (start, end))
    there, here = first.subtree_com[base], last.subtree_com[base]
    return BodyMotion(
        duration=seconds,
        height=initial.com - initial.clearance - initial.ground,
        end_height=float(here[2]) - initial.ground,
        clearance=initial.clearance,
        lean=tilt_between(first.xmat[base].reshape(3, 3), last.xmat[base].reshape(3, 3)),
        away=horizontal_distance(there, here),
        diverged=was_reset_by_mujoco(end),
    )


@dataclass(frozen=True)
class InitialHeight:
    """Heights of a robot at reset, expressed in the world frame.

    Attributes:
        com: CoM height at reset (m).
        clearance: Vertical distance by which the robot can move downward to the ground (m);
            negative if the robot penetrates the ground; 0 if no ground is found within
            ``MAX_CLEARANCE``.
        ground: Height of the ground (m) at the point that the robot would touch first; the height
            that the caller assumes if no ground is found.
    """

    com: float
    clearance: float
    ground: float


def initial_height(
    model: mujoco.MjModel, start: mujoco.MjData, base: int, ground: float
) -> InitialHeight:
    """Measure CoM height, clearance and ground height at reset, without simulation.

    The clearance is the vertical distance by which the robot can move downward to the ground.

    Method: a copy of the robot is moved downward in steps of at most 5 cm (``_SEARCH_MARGIN``),
    until its distance from the ground is below 1 um (``_CONTACT_DISTANCE``). A contact with a fixed
    geom counts as ground if its normal points upward (``_MIN_UPWARD_NORMAL``).

    Args:
        model: MuJoCo model. The option ``o_margin`` and the flag ``override`` are changed during
            the call.
        start: State at reset; not changed.
        base: Body id of the base.
        ground: Ground height [m] of the result if no ground is found below the robot.
    """
    trial = _copy_with_kinematics(model, start)
    com, clearance = float(trial.subtree_com[base][2]), 0.0
    with _override_margin(model, _SEARCH_MARGIN):
        while clearance < MAX_CLEARANCE:
            mujoco.mj_collision(model, trial)
            distance, height = _distance_above_ground(model, trial, base)
            if distance < _CONTACT_DISTANCE:
                clearance += distance if clearance == 0.0 else 0.0
                return InitialHeight(com, clearance, height)
            clearance += distance
            _lower_geometry(model, trial, distance)
    return InitialHeight(com, 0.0, ground)


@contextmanager
def _override_margin(model: mujoco.MjModel, margin: float) -> Iterator[None]:
    """Set the contact margin [m] of all geoms of a model within a ``with`` block."""
    flags, previous = model.opt.enableflags, float(model.opt.o_margin)
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_OVERRIDE.value
    model.opt.o_margin = margin
    try:
        yield
    finally:
        model.opt.enableflags, model.opt.o_margin = flags, previous


def _lower_geometry(model: mujoco.MjModel, data: mujoco.MjData, distance: float) -> None:
    """Move the evaluated positions of all moving bodies and geoms downward by a distance [m]."""
    moving = model.body_weldid != 0
    for positions in (data.xpos, data.xipos, data.geom_xpos):
        rows = moving[model.geom_bodyid] if positions is data.geom_xpos else moving
        positions[rows, 2] -= distance


def find_bodies_near_world(
    model: mujoco.MjModel, data: mujoco.MjData, margin: float, lowered: float = 0.0
) -> set[int]:
    """Return the ids of moving bodies whose distance from a fixed geom is below a margin.

    Only geoms that can collide are compared. A body that is fixed to a moving body counts as this
    moving body.

    Args:
        model: MuJoCo model. The option ``o_margin`` and the flag ``override`` are changed during
            the call.
        data: State; not changed.
        margin: Upper bound of the distance [m].
        lowered: Distance by which the bodies are moved downward before [m].
    """
    placed = _copy_with_kinematics(model, data)
    _lower_geometry(model, placed, lowered)
    with _override_margin(model, margin):
        mujoco.mj_collision(model, placed)
        return find_touching_bodies(model, placed)


def _distance_above_ground(
    model: mujoco.MjModel, data: mujoco.MjData, base: int
) -> tuple[float, float]:
    """Return the vertical distance between robot and ground, and the ground height z, both in m.

    The distance is at most ``_SEARCH_MARGIN``, and negative if the robot penetrates the ground.
    Without a contact, the height is 0.
    """
    bodies = list_contact_bodies(model, data)
    fixed = model.body_weldid[bodies] == 0
    robot = model.body_rootid[bodies] == model.body_rootid[base]
    below = fixed.any(axis=1) & (robot & ~fixed).any(axis=1)
    # The normal points from the first geom to the second.
    upward = data.contact.frame.reshape(-1, 9)[:, 2] * np.where(fixed[:, 0], 1.0, -1.0)
    below &= upward > _MIN_UPWARD_NORMAL
    if not below.any():
        return _SEARCH_MARGIN, 0.0
    gaps, normals = data.contact.dist[below], upward[below]
    distances = np.where(gaps > 0, gaps / normals, gaps * normals)
    lowest = int(distances.argmin())
    # A contact point is midway between the two surfaces.
    height = float(data.contact.pos[below][lowest, 2] - distances[lowest] / 2)
    return min(float(distances[lowest]), _SEARCH_MARGIN), height


def _find_world_contacts(model: mujoco.MjModel, data: mujoco.MjData) -> NDArray[np.bool_]:
    """Return a mask (ncon,) of the contacts with fixed bodies that can exert a force."""
    bodies = model.body_weldid[list_contact_bodies(model, data)]
    return np.asarray((bodies == 0).any(axis=1)) & find_acting_contacts(data)


def find_touching_bodies(model: mujoco.MjModel, data: mujoco.MjData) -> set[int]:
    """Return the ids of moving bodies that touch the world.

    A body that is fixed to a moving body counts as this moving body.
    """
    bodies = model.body_weldid[list_contact_bodies(model, data)]
    return set(bodies[_find_world_contacts(model, data)].ravel().tolist()) - {0}


def _lies_on_trunk(model: mujoco.MjModel, data: mujoco.MjData, base: int) -> bool:
    """Return True if a robot lies on its base or hips, or touches the world without limb ends."""
    own, above = int(model.body_weldid[base]), model.body_weldid[model.body_parentid]
    moving = [body for body in range(1, model.nbody) if model.body_weldid[body] == body]
    carrying = {int(above[body]) for body in moving}
    trunk = {own} | {body for body in moving if above[body] == own and body in carrying}
    touching = find_touching_bodies(model, data)
    return bool(touching & trunk) or (bool(touching) and touching <= carrying)


def horizontal_distance(start: Array, end: Array) -> float:
    """Return the horizontal distance [m] between two positions, shape (3,)."""
    return float(np.linalg.norm((end - start)[:2]))


def is_lifted(leaning: float, lost: float, size: float) -> bool:
    """Return True if a robot is upright, and its CoM is far above the initial height.

    A possible cause is a constraint that ties the robot to the world.

    Args:
        leaning: Tilt of the base relative to the start [rad]. Limit: ``FALLEN_TILT`` (0.5 rad).
        lost: Height loss of the CoM [m], negative if the CoM rises. The CoM must rise by more than
            ``MAX_HEIGHT_LOSS_RATIO`` (0.3) times ``size``.
        size: Initial height of the CoM above the ground [m].
    """
    return leaning <= FALLEN_TILT and -lost > MAX_HEIGHT_LOSS_RATIO * size


def has_collapsed(leaning: float, lost: float, away: float, size: float) -> bool:
    """Return True if a robot has fallen over, sunk, risen, or moved away horizontally.

    Also True if tilt, height loss or distance is NaN, as after a divergence.

    Args:
        leaning: Tilt of the base relative to the start [rad]. Limit: ``FALLEN_TILT`` (0.5 rad).
        lost: Height loss of the CoM [m], negative if the CoM rises. Limit of the absolute value:
            ``MAX_HEIGHT_LOSS_RATIO`` (0.3) times ``size``.
        away: Horizontal distance of the CoM from the start [m]. Limit: ``MAX_TRAVEL_RATIO`` (1.0)
            times ``size``.
        size: Initial height of the CoM above the ground [m].
    """
    upright = abs(lost) <= MAX_HEIGHT_LOSS_RATIO * size and leaning <= FALLEN_TILT
    return not (upright and away <= MAX_TRAVEL_RATIO * size)
