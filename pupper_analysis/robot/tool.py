"""``Tool``: a point of a robot at which a load is attached or a force acts; payloads of a robot.

Input: the name of a frame of either file, or a position in such a frame. `find_tool` and
`find_place` return a `Tool` with link, offset and the joints that move the point. `with_payload`
returns a robot with a point mass at the point in both models. By default, the tool is the link at
the end of the longest chain of joints, or the link that carries the fingers at this end.
"""

from __future__ import annotations

import copy
import functools
import math
import operator
import reprlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments, check_length, real_array
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError, UnknownNameError
from pupper_analysis.base.results import Result
from pupper_analysis.models.description import ModelTree
from pupper_analysis.models.mjcf import find_invalid_number
from pupper_analysis.models.xml import to_text
from pupper_analysis.robot.build import compile_with_visuals, copy_metadata, rebuild_robot
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot

_MIN_ARM_JOINTS = 3
"""Minimum number of joints that move a link with fingers, for the link to count as a hand (the
default tool). A free base counts as two joints. Chosen, not tuned."""

_MAX_FINGER_JOINTS = 4
"""Maximum number of joints of a finger. A branch of the joint tree with more joints is no finger.
Chosen, not tuned."""


_NUM_FRAMED_VALUES = 4
"""Number of elements of a position with frame: (name of the frame, x, y, z)."""


@dataclass(frozen=True, eq=False)
class Tool(Result):
    """Point of a robot, at which a load is attached or a force acts.

    Attributes:
        name: Name of the frame from which the point was found: a link of the URDF, or a site, body
            or geom of the MJCF.
        link: Link of the URDF to which the point is fixed.
        offset: Vector from the frame of the link to the point, in the axes of the link, shape (3,)
            (m).
        chain: Joints that move the point, from the base outwards.
    """

    name: str
    link: str
    offset: Array = field(metadata={"unit": "m"})
    chain: tuple[str, ...]

    def translated(self, way: ArrayLike) -> Tool:
        """Return a copy of this point, displaced in the axes of its link.

        Args:
            way: Displacement, shape (3,) [m].

        Raises:
            ConfigurationError: If ``way`` is no finite vector (3,), or too large.
        """
        return replace(self, offset=self.offset + check_point(way))

    def position(self, config: Configuration) -> Array:
        """Return the position (3,) [m] of this point in the world frame."""
        rotated_offset = config.frame_rotation(self.link) @ self.offset
        position: Array = config.frame_position(self.link) + rotated_offset
        return position

    def locate_in_mjcf(self, robot: Robot) -> tuple[str, Array]:
        """Return the MJCF body to which this point is fixed, and the point in the body frame.

        Returns:
            Name of the body that the last joint of ``chain`` moves, or of the base if no joint
            moves the point; position of the point in the frame of this body, shape (3,) [m].
        """
        model, data = robot.mj_model, robot.compute_kinematics()
        body = model.body(robot.mj_base).id
        if self.chain:
            body = int(model.jnt_bodyid[model.joint(self.chain[-1]).id])
        world = self.position(Configuration(robot, robot.neutral()))
        position: Array = data.xmat[body].reshape(3, 3).T @ (world - data.xpos[body])
        return str(model.body(body).name), position

    def jacobian(self, config: Configuration) -> Array:
        """Return the Jacobian J (3, nv) of this point.

        J qvel is the velocity of the point [m/s], in world axes.
        """
        return self.twist_jacobian(config)[:3]

    def twist_jacobian(self, config: Configuration) -> Array:
        """Return the Jacobian J, shape (6, nv), of this point and of the rotation of its link.

        J qvel = (velocity of the point [m/s], angular velocity of the link [rad/s]), in world axes.
        """
        return config.frame_jacobian(self.link, config.frame_rotation(self.link) @ self.offset)

    def load_per_mass(self, config: Configuration) -> Array:
        """Return the generalised force that supports a mass at this point, per unit mass.

        The force is -J^T g, shape (nv,) [N/kg, N m/kg], with the Jacobian J of the point and the
        gravity vector g [m/s^2].
        """
        load: Array = -config.robot.gravity @ self.jacobian(config)
        return load


FramePoint = Sequence[float] | Sequence[str | float] | Tool
"""Point of a robot: (x, y, z) [m] in the base frame; (frame, x, y, z) [m] in the axes of a named
frame, from its origin; or a `Tool`."""


@check_arguments
def find_tool(robot: Robot, name: str | None = None) -> Tool:
    """Return the tool at a named frame; by default, the tool at the end of the longest limb.

    Args:
        robot: The robot.
        name: Name of a link of the URDF, or of a site, body or geom of the MJCF. By default, the
            link at the end of the longest chain of joints, or the link that carries the fingers at
            this end.

    Raises:
        ConfigurationError: If an argument has another type.
        UnknownNameError: If there is no such frame.
    """
    return _find_frame(robot, _find_end_link(robot) if name is None else name)[0]


def _find_frame(robot: Robot, name: str) -> tuple[Tool, Array]:
    """Return the `Tool` at a named frame, and the rotation (3, 3) from frame axes to link axes."""
    if name in robot.structure.links:
        return Tool(name, name, np.zeros(3), _find_chain(robot, name)), np.eye(3)
    model, data = _compute_kinematics_with_visuals(robot)
    for kind, places, rotations, bodies in (
        (mujoco.mjtObj.mjOBJ_SITE, data.site_xpos, data.site_xmat, model.site_bodyid),
        (mujoco.mjtObj.mjOBJ_BODY, data.xpos, data.xmat, range(model.nbody)),
        (mujoco.mjtObj.mjOBJ_GEOM, data.geom_xpos, data.geom_xmat, model.geom_bodyid),
    ):
        frame_id = mujoco.mj_name2id(model, kind, name)
        if frame_id >= 0:
            link, position, rotation = _express_in_link(
                *(robot, int(bodies[frame_id])),
                *(np.array(places[frame_id]), rotations[frame_id].reshape(3, 3)),
            )
            return Tool(name, link, position, _find_chain(robot, link)), rotation
    sites = [model.site(index).name for index in range(model.nsite)]
    known = dict.fromkeys([*robot.structure.links, *filter(None, sites)])
    raise UnknownNameError(robot.name, "frame", name, tuple(known), base=robot.base)


MAX_DISTANCE_RATIO = 10.0
"""Largest distance of a point from the origin of its frame, relative to the robot's size
(`measure_size`) [1]. A point that is farther away is rejected, as a length in mm. Chosen, not
tuned."""


def measure_size(robot: Robot) -> float:
    """Return the largest distance [m] of a point of the robot from the origin of its base.

    The joints are in the neutral configuration. The points are origins and CoMs of the moving
    bodies, and the bounding spheres of the geoms of these bodies.
    """
    return robot.compute_once(_compute_size)


def _compute_size(robot: Robot) -> float:
    """Compute the size of a robot [m], which `measure_size` returns."""
    model, data = _compute_kinematics_with_visuals(robot)
    bodies = model.body_weldid > 0
    geoms = bodies[model.geom_bodyid]
    centres = np.vstack([data.xpos[bodies], data.xipos[bodies], data.geom_xpos[geoms]])
    radii = np.r_[np.zeros(2 * int(bodies.sum())), model.geom_rbound[geoms]]
    distances = np.linalg.norm(centres - data.body(robot.mj_base).xpos, axis=1) + radii
    return float(distances.max(initial=0.0))


def _compute_kinematics_with_visuals(robot: Robot) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return the model with visual geoms, and its data in the neutral configuration."""
    model, data = robot.compute_once(compile_with_visuals), robot.compute_kinematics()
    if model is robot.mj_model:
        return model, data
    complete = mujoco.MjData(model)
    complete.qpos[:] = data.qpos
    mujoco.mj_kinematics(model, complete)
    return model, complete


def find_place(robot: Robot, point: FramePoint) -> Tool:
    """Convert a position on a robot to a `Tool`, which names the link of the position.

    Args:
        robot: The robot.
        point: One of three forms:

            - (x, y, z) [m] in the base frame.
            - ``(frame, x, y, z)``: position [m] expressed in the frame of a link, site, body or
              geom: from the origin of the frame, in the axes of the frame.
            - A `Tool`, which is returned unchanged.

    Raises:
        ConfigurationError: If the coordinates are not three finite numbers, or too large; or if the
            distance from the frame exceeds ``MAX_DISTANCE_RATIO`` sizes of the robot.
        UnknownNameError: If the robot has no such frame, or no link with the name of the tool's
            link.
    """
    if not isinstance(point, Tool):
        frame, at = split_place(point)
        place = check_point(at)
        distance = float(np.linalg.norm(place))
        # The size of the robot needs the postponed stages: no point at the origin is too far.
        size = measure_size(robot) if distance else math.inf
        if 0 < MAX_DISTANCE_RATIO * size < distance:
            problem = diagnose(
                "point-too-far",
                distance=Quantity(distance, "m"),
                frame=frame or robot.base,
                ratio=MAX_DISTANCE_RATIO,
                size=Quantity(size, "m"),
            )
            raise ConfigurationError("point", problem)
        if frame:
            tool, rotation = _find_frame(robot, frame)
            return tool.translated(rotation @ place)
        return Tool(robot.base, robot.base, place, ())
    if point.link not in robot.structure.links:
        links = tuple(robot.structure.links)
        raise UnknownNameError(robot.name, "link", point.link, links, base=robot.base)
    return point


def split_place(point: Any) -> tuple[str, Any]:
    """Split a position of a robot into the name of its frame and its coordinates.

    The coordinates are not checked (`check_point`).

    Args:
        point: (frame, x, y, z) [m], or coordinates (x, y, z) [m] in the base frame.

    Returns:
        Name of the frame, "" for the base; coordinates (x, y, z) [m].
    """
    if (
        isinstance(point, Sequence)
        and len(point) == _NUM_FRAMED_VALUES
        and isinstance(point[0], str)
    ):
        return point[0], point[1:]
    return "", point


def check_point(point: ArrayLike) -> Array:
    """Convert the coordinates of a point to an array, shape (3,) [m], after a check.

    Raises:
        ConfigurationError: If the point has another shape, or a coordinate is not a finite number
            or too large.
    """
    place = real_array("point", point)
    if place.shape != (3,) or not np.isfinite(place).all():
        raise ConfigurationError("point", diagnose("no-point", given=reprlib.repr(point)))
    return np.array([check_length("point", value) for value in place])


def _express_in_link(
    robot: Robot, body: int, position: Array, rotation: Array
) -> tuple[str, Array, Array]:
    """Return the link that moves with a body; origin (3,) [m] and rotation (3, 3) of a frame in it.

    ``position`` and ``rotation`` are the pose of the frame in the world, in the neutral
    configuration.
    """
    link, config = _find_carrying_link(robot, body), Configuration(robot, robot.neutral())
    to_link = config.frame_rotation(link).T
    return link, to_link @ (position - config.frame_position(link)), to_link @ rotation


def _find_carrying_link(robot: Robot, body: int) -> str:
    """Return the name of the URDF link that moves with an MJCF body, or of the base."""
    model = robot.mj_model
    while body and not model.body_jntnum[body]:
        body = int(model.body_parentid[body])
    if not body:
        return robot.base
    last = int(model.body_jntadr[body] + model.body_jntnum[body]) - 1  # last joint of the body
    joint = robot.structure.joints.get(model.joint(last).name)
    if joint is None:  # a joint of the free base
        return robot.base
    frames = robot.structure.model.frames
    return str(
        next(
            frame.name
            for index, frame in _list_link_frames(robot)
            if frames[index].parentJoint == joint
        )
    )


def _list_link_frames(robot: Robot) -> list[tuple[int, pin.Frame]]:
    """Return (index, frame) of the links of the URDF, parents first."""
    frames = robot.structure.model.frames
    return [(index, frames[index]) for index in sorted(robot.structure.links.values())]


def _find_chain(robot: Robot, link: str) -> tuple[str, ...]:
    """Return the names of the joints that move a link, from the base to the link."""
    model = robot.structure.model
    joint = model.frames[robot.structure.links[link]].parentJoint
    names = (model.names[support] for support in model.supports[joint])
    return tuple(name for name in names if name in robot.structure.joints)


def _find_end_link(robot: Robot) -> str:
    """Find the default tool link: the end of the longest joint chain, or a hand with fingers."""
    model = robot.structure.model
    lengths = [len(support) - 1 for support in model.supports]
    last = int(np.argmax(lengths))  # the first of equals
    for joint in list(model.supports[last])[_MIN_ARM_JOINTS:]:
        children = [child for child in range(model.njoints) if model.parents[child] == joint]
        deepest = max(lengths[child] for child in model.subtrees[joint]) - lengths[joint]
        if len(children) > 1 and deepest <= _MAX_FINGER_JOINTS:
            last = int(joint)
            break
    # The last of the links on a joint; fixed links follow their parents.
    return str(
        [frame.name for _, frame in _list_link_frames(robot) if frame.parentJoint == last][-1]
    )


MAX_MASS_RATIO = 20.0
"""Mass of a payload, relative to the mass of the robot [1], above which the loaded robot has a
note. Chosen, not tuned: a mass in g is 1000 times the mass in kg."""

_PAYLOAD_NAME = "payload"
"""Name of the link and of the body of a payload; underscores are appended if the name is in use."""


@check_arguments
def with_payload(
    robot: Robot,
    mass: float,
    point: FramePoint = (0.0, 0.0, 0.0),
) -> Robot:
    """Return a robot with a point mass welded to both models, as a payload.

    Joints, limits, gains, feet, and the default base height are unchanged. Exception: MuJoCo
    computes the damping of servos with ``dampratio`` anew. Contacts may become stiffer or softer,
    because MuJoCo derives their softness from the masses (``body_invweight0``).

    Args:
        robot: The robot.
        mass: Mass of the payload [kg], finite and >= 0.
        point: Position of the payload: (x, y, z) [m] in the base frame; (frame, x, y, z) [m]
            expressed in the frame of a link, site, body or geom, for example
            ``("right_hand", 0.0, 0.0, 0.05)``; or a ``Tool``.

    Returns:
        The loaded robot; the robot itself if the mass is zero. If the mass exceeds
        ``MAX_MASS_RATIO`` times the robot's mass, the loaded robot has a note in ``notes``.

    Raises:
        ConfigurationError: If the mass or the point is not valid; or if the base is fixed, and no
            joint moves the point.
        UnknownNameError: If the robot has no such frame.
        ModelError: If the loaded model cannot be built.
    """
    tool = find_place(robot, point)
    if not 0 <= mass < math.inf:
        raise ConfigurationError("mass", diagnose("payload-not-valid", mass=repr(mass)))
    if mass == 0.0:
        return robot
    if not tool.chain:  # on the base, or on a link that is fixed to the base
        robot.check_floating()
    link, offset = tool.link, tool.offset
    body, mj_offset = tool.locate_in_mjcf(robot)
    (urdf, mjcf), name = robot.description.trees(), _PAYLOAD_NAME
    sides: tuple[tuple[ModelTree, str, Array], ...] = (
        (urdf, link, offset),
        (mjcf, body, mj_offset),
    )
    while any(name in tree.names for tree, _, _ in sides):
        name += "_"
    mass = float(mass)  # Pinocchio does not accept NumPy scalars
    weight = pin.Inertia(mass, np.zeros(3), np.zeros((3, 3)))
    for tree, carrier, position in sides:
        tree.add_link(name, carrier, f"{name}_weld", position, weight)
    changes = {"urdf": to_text(urdf.root), "mjcf": mjcf.spec}
    built = _build_loaded_robot(robot, (link, offset.tobytes(), name), mass, changes)
    # Keep changes of Pinocchio's model since the files were read, such as limits.
    model = robot.pin_model.copy()
    frame = model.frames[model.getFrameId(link, pin.FrameType.BODY)]
    welded = frame.placement.act(pin.Inertia(mass, offset, np.zeros((3, 3))))
    model.inertias[frame.parentJoint] = model.inertias[frame.parentJoint] + welded

    notes = built.notes
    if mass > MAX_MASS_RATIO * robot.total_mass:
        own = Quantity(robot.total_mass, "kg")
        note = diagnose("payload-heavy", mass=Quantity(mass, "kg"), ratio=MAX_MASS_RATIO, own=own)
        notes = (*notes, note)
    return replace(built, pin_model=model, fingerprint=robot.fingerprint, notes=notes)


@dataclass(eq=False)
class _LoadedModel:
    """Cached model of a robot with a payload, which is reused for other masses at the same place.

    Attributes:
        place: Link, bytes of the offset, and name of the payload's body; None without a payload.
        robot: Robot with the payload, without its published file; None without a payload.
        is_exact: Whether a change of the mass in the compiled model gives the same model as
            compiling with the new mass. None before this comparison.
    """

    place: tuple[str, bytes, str] | None = None
    robot: Robot | None = None
    is_exact: bool | None = None


def _make_cache(_: Robot) -> _LoadedModel:
    """Return an empty cache of the model of a robot with its last payload."""
    return _LoadedModel()


def _build_loaded_robot(
    robot: Robot, place: tuple[str, bytes, str], mass: float, changes: dict[str, Any]
) -> Robot:
    """Build a robot with a payload, if possible without compiling the model again.

    Searches try many masses at a place: if a copy with a changed mass was equal to the compiled
    model, further masses are written into copies. ``place``: link, bytes of the offset, name of the
    payload's body.
    """
    cache = robot.compute_once(_make_cache)
    if cache.place != place:
        cache.place, cache.robot, cache.is_exact = place, None, None
    model = None
    if cache.robot is not None and cache.is_exact is not False:
        model = _change_payload_mass(cache.robot, place[-1], mass)
        if cache.is_exact and model is not None:
            description = replace(robot.description, **changes)
            built = replace(cache.robot, mj_model=model, description=description)
            return copy_metadata(built, robot)
    built = rebuild_robot(robot, **changes)
    if cache.robot is None:
        cache.robot = replace(built, published=None)
    elif cache.is_exact is None:
        cache.is_exact = model is not None and np.array_equal(
            _serialize_model(model), _serialize_model(built.mj_model)
        )
    return built


def _change_payload_mass(loaded: Robot, name: str, mass: float) -> mujoco.MjModel | None:
    """Return a copy of a robot's MuJoCo model with another mass [kg] of the payload ``name``.

    Constants that depend on the mass are computed again, also ``meaninertia`` and ``meanmass``,
    which ``mj_setConst`` does not change. None if the copy would not be valid.
    """
    statistic = loaded.description.mjcf.stat
    body = mujoco.mj_name2id(loaded.mj_model, mujoco.mjtObj.mjOBJ_BODY, name)
    if body < 0 or loaded.description.mjcf.compiler.boundmass > 0:
        return None
    model = copy.copy(loaded.mj_model)
    model.body_mass[body] = mass
    if find_invalid_number(model) is not None:
        return None
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)
    mujoco.mj_resetData(model, data)
    mujoco.mj_fwdPosition(model, data)
    mass_matrix = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass_matrix)
    # Added one by one, as MuJoCo's compiler does, so that the last digits are equal: `sum` of
    # Python 3.12 or newer compensates rounding errors.
    if math.isnan(statistic.meaninertia):
        model.stat.meaninertia = functools.reduce(operator.add, np.diag(mass_matrix)) / model.nv
    if math.isnan(statistic.meanmass):
        total = functools.reduce(operator.add, model.body_mass[1:])
        model.stat.meanmass = total / (model.nbody - 1)
    return model


def _serialize_model(model: mujoco.MjModel) -> NDArray[np.uint8]:
    """Return the bytes of a MuJoCo model, as ``mj_saveModel`` writes them to a file."""
    content = np.empty(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return content
