"""A point of a robot where it carries, or is pushed: its tool."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments, check_length, real_array
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, UnknownNameError
from pupper_analysis.base.results import Result
from pupper_analysis.models.description import ModelTree
from pupper_analysis.models.xml import to_text
from pupper_analysis.robot.build import rebuild_robot
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]

_STEM, _FINGER = 3, 4
"""A chain of three joints or more that ends in several of four at most is an arm with a hand: its
tool is what carries the fingers."""


_FRAMED = 4
"""Parts of a place in a frame: its name, x, y and z."""


@dataclass(frozen=True, eq=False)
class Tool(Result):
    """A point of a robot.

    Attributes:
        name: Of the frame that was given or found: a link of the URDF, or a site, body or geom of
            the MJCF.
        link: The link of the URDF that carries it.
        offset: (3,) from that link's frame to the point, in its axes (m).
        chain: The joints that move it, from the base outwards.
    """

    name: str
    link: str
    offset: Array = field(metadata={"unit": "m"})
    chain: tuple[str, ...]

    def moved(self, way: ArrayLike) -> Tool:
        """Returns the point that is so far (3,) from it, in its link's axes (m)."""
        return replace(self, offset=self.offset + check_point(way))

    def position(self, config: Configuration) -> Array:
        """Returns where the point is (3,), in the world (m)."""
        turned = config.frame_rotation(self.link) @ self.offset
        place: Array = config.frame_position(self.link) + turned
        return place

    def in_mjcf(self, robot: Robot) -> tuple[str, Array]:
        """Returns the body of the MJCF that carries the point, and its place (3,) in it (m)."""
        model, data = robot.mj_model, robot.placed()
        body = model.body(robot.mj_base).id
        if self.chain:
            body = int(model.jnt_bodyid[model.joint(self.chain[-1]).id])
        world = self.position(Configuration(robot, robot.neutral()))
        place: Array = data.xmat[body].reshape(3, 3).T @ (world - data.xpos[body])
        return str(model.body(body).name), place

    def jacobian(self, config: Configuration) -> Array:
        """Returns the Jacobian (3, nv) of the point, in world axes."""
        return self.twist_jacobian(config)[:3]

    def twist_jacobian(self, config: Configuration) -> Array:
        """Returns the Jacobian (6, nv) of the point and of its link's turning, in world axes."""
        return config.frame_jacobian(self.link, config.frame_rotation(self.link) @ self.offset)

    def load_per_mass(self, config: Configuration) -> Array:
        """Returns what a mass at the point asks of the robot at rest (nv,) (N/kg)."""
        load: Array = -config.robot.gravity @ self.jacobian(config)
        return load


Place = Sequence[float] | Sequence[str | float] | Tool
"""A point of a robot, as ``find_place`` takes it."""


@check_arguments
def find_tool(robot: Robot, name: str | None = None) -> Tool:
    """Finds a robot's tool.

    Args:
        robot: The robot.
        name: A link of the URDF, or a site, body or geom of the MJCF. By default the link at the
            end of the longest chain of joints; where that is a finger of a gripper, the link that
            carries the fingers.

    Raises:
        UnknownNameError: If there is no such frame; the message lists the links and sites.
    """
    link = _end(robot) if name is None else name
    if link in robot.structure.links:
        return Tool(link, link, np.zeros(3), _chain(robot, link))
    model, data = robot.mj_model, robot.placed()
    for kind, places, bodies in (
        (mujoco.mjtObj.mjOBJ_SITE, data.site_xpos, model.site_bodyid),
        (mujoco.mjtObj.mjOBJ_BODY, data.xpos, range(model.nbody)),
        (mujoco.mjtObj.mjOBJ_GEOM, data.geom_xpos, model.geom_bodyid),
    ):
        found = mujoco.mj_name2id(model, kind, link)
        if found >= 0:
            carrier, offset = _carried(robot, int(bodies[found]), np.array(places[found]))
            return Tool(link, carrier, offset, _chain(robot, carrier))
    sites = [model.site(index).name for index in range(model.nsite)]
    known = dict.fromkeys([*robot.structure.links, *filter(None, sites)])
    raise UnknownNameError(robot.name, "frame", link, tuple(known))


def find_place(robot: Robot, point: Place) -> Tool:
    """Returns a point of a robot.

    Args:
        robot: The robot.
        point: One of the base (3,), in its frame (m), or ``(frame, x, y, z)`` in the frame of a
            link, site, body or geom, or a tool.

    Raises:
        ConfigurationError: If it is none.
        UnknownNameError: If the robot has no such frame, or no link that carries the tool.
    """
    if not isinstance(point, Tool):
        frame, at = split_place(point)
        if frame:
            return find_tool(robot, frame).moved(at)
        return Tool(robot.base, robot.base, check_point(at), ())
    if point.link not in robot.structure.links:
        raise UnknownNameError(robot.name, "link", point.link, tuple(robot.structure.links))
    return point


def split_place(point: Any) -> tuple[str, Any]:
    """Returns the frame of a place, "" for the base's, and the point in it; see ``find_place``."""
    if isinstance(point, Sequence) and len(point) == _FRAMED and isinstance(point[0], str):
        return point[0], point[1:]
    return "", point


def check_point(point: ArrayLike) -> Array:
    """Returns a point (3,).

    Raises:
        ConfigurationError: If it is none.
    """
    place = real_array("point", point)
    if place.shape != (3,) or not np.isfinite(place).all():
        raise ConfigurationError("point", diagnose("no-point", given=reprlib.repr(point)))
    return np.array([check_length("point", value) for value in place])


def _carried(robot: Robot, body: int, world: Array) -> tuple[str, Array]:
    """Returns the link that moves with a body, and where a point (3,) of the world is in it."""
    link, config = _carrier(robot, body), Configuration(robot, robot.neutral())
    return link, config.frame_rotation(link).T @ (world - config.frame_position(link))


def _carrier(robot: Robot, body: int) -> str:
    """Returns the link of the URDF that moves with a body of the MJCF."""
    model = robot.mj_model
    while body and not model.body_jntnum[body]:
        body = int(model.body_parentid[body])
    if not body:
        return robot.base
    last = int(model.body_jntadr[body] + model.body_jntnum[body]) - 1  # of several at one body
    joint = robot.structure.joints[model.joint(last).name]
    frames = robot.structure.model.frames
    return str(next(f.name for n, f in _links(robot) if frames[n].parentJoint == joint))


def _links(robot: Robot) -> list[tuple[int, pin.Frame]]:
    """Returns the frames of the URDF's links, and their numbers, carriers first."""
    frames = robot.structure.model.frames
    return [(number, frames[number]) for number in sorted(robot.structure.links.values())]


def _chain(robot: Robot, link: str) -> tuple[str, ...]:
    """Returns the joints that move a link, from the base outwards."""
    model = robot.structure.model
    joint = model.frames[robot.structure.links[link]].parentJoint
    names = (model.names[one] for one in model.supports[joint])
    return tuple(name for name in names if name in robot.structure.joints)


def _end(robot: Robot) -> str:
    """Returns the link at the end of the longest chain, or that carries the fingers there."""
    model = robot.structure.model
    lengths = [len(support) - 1 for support in model.supports]
    last = int(np.argmax(lengths))  # the first of equals
    for joint in list(model.supports[last])[_STEM:]:
        beyond = [other for other in range(model.njoints) if model.parents[other] == joint]
        deepest = max(lengths[other] for other in model.subtrees[joint]) - lengths[joint]
        if len(beyond) > 1 and deepest <= _FINGER:
            last = int(joint)
            break
    # Fixed links come after those that carry them.
    return str([frame.name for _, frame in _links(robot) if frame.parentJoint == last][-1])


# A robot with a payload welded to it, in both of its models.

_NAME = "payload"


@check_arguments
def with_payload(
    robot: Robot,
    mass: float,
    point: Place = (0.0, 0.0, 0.0),
) -> Robot:
    """Welds a point mass to a robot, in the URDF's model and in the MJCF's.

    All else stays: joints, limits, gains, feet, and the height of the nominal stand. MuJoCo derives
    the softness of a contact from the mass behind it (``body_invweight0``): that is the loaded
    robot's, so that every prediction and simulation of the robot returned is of the loaded one.

    Args:
        robot: The robot.
        mass: Of the payload (kg), finite and >= 0.
        point: (3,) where it is, in the base's frame (m); or in that of a link, site or body, as
            ``("right_hand", 0.0, 0.0, 0.05)``, or a ``Tool``.

    Returns:
        The loaded robot; the robot itself for no mass.

    Raises:
        ConfigurationError: If the mass or the point is none, or it is for a base that is fixed.
        UnknownNameError: If the robot has no such link.
        ModelError: If the MJCF's base is not where the URDF's is.
    """
    tool = find_place(robot, point)
    if not 0 <= mass < math.inf:
        raise ConfigurationError("mass", diagnose("payload-not-valid", mass=repr(mass)))
    if mass == 0.0:
        return robot
    if tool.link == robot.base:
        robot.check_floating()
    link, place = tool.link, tool.offset
    body, there = tool.in_mjcf(robot)
    (urdf, mjcf), name = robot.description.trees(), _NAME
    sides: tuple[tuple[ModelTree, str, Array], ...] = ((urdf, link, place), (mjcf, body, there))
    while any(name in tree.names for tree, _, _ in sides):
        name += "_"
    mass = float(mass)  # pinocchio takes no NumPy's
    weight = pin.Inertia(mass, np.zeros(3), np.zeros((3, 3)))
    for tree, carrier, at in sides:
        tree.add_link(name, carrier, f"{name}_weld", at, weight)
    built = rebuild_robot(robot, urdf=to_text(urdf.root), mjcf=mjcf.spec)
    # What was changed in Pinocchio's model since it was read, such as a limit, stays.
    model = robot.pin_model.copy()
    on = model.frames[model.getFrameId(link, pin.FrameType.BODY)]
    welded = on.placement.act(pin.Inertia(mass, place, np.zeros((3, 3))))
    model.inertias[on.parentJoint] = model.inertias[on.parentJoint] + welded
    # The unloaded robot's stands are its own.
    return replace(built, pin_model=model, fingerprint=robot.fingerprint)
