"""The tool of a robot whose base is held: where it carries, and is pushed."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.arguments import check_arguments
from pupper_analysis.errors import UnknownNameError
from pupper_analysis.results import Result
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]

_STEM, _FINGER = 3, 2
"""A chain of three joints or more that ends in several of two at most is an arm with a gripper: its
tool is what carries the fingers."""


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
    offset: Array
    chain: tuple[str, ...]

    def position(self, config: Configuration) -> Array:
        """Returns where the point is (3,), in the world (m)."""
        turned = config.frame_rotation(self.link) @ self.offset
        place: Array = config.frame_position(self.link) + turned
        return place

    def jacobian(self, config: Configuration) -> Array:
        """Returns the Jacobian (3, nv) of the point, in world axes."""
        return config.point_jacobian(self.link, self.position(config))


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
    model, data = robot.mj_model, mujoco.MjData(robot.mj_model)
    qpos = robot.neutral()
    robot.mj_convention.set_state(data, qpos)
    mujoco.mj_kinematics(model, data)
    for kind, places, bodies in (
        (mujoco.mjtObj.mjOBJ_SITE, data.site_xpos, model.site_bodyid),
        (mujoco.mjtObj.mjOBJ_BODY, data.xpos, range(model.nbody)),
        (mujoco.mjtObj.mjOBJ_GEOM, data.geom_xpos, model.geom_bodyid),
    ):
        found = mujoco.mj_name2id(model, kind, link)
        if found >= 0:
            carrier = _carrier(robot, int(bodies[found]))
            config = Configuration(robot, qpos)
            way = np.array(places[found]) - config.frame_position(carrier)
            offset = config.frame_rotation(carrier).T @ way
            return Tool(link, carrier, offset, _chain(robot, carrier))
    sites = [model.site(index).name for index in range(model.nsite)]
    known = dict.fromkeys([*robot.structure.links, *filter(None, sites)])
    raise UnknownNameError(robot.name, "frame", link, tuple(known))


def _carrier(robot: Robot, body: int) -> str:
    """Returns the link of the URDF that moves with a body of the MJCF."""
    model = robot.mj_model
    while body and not model.body_jntnum[body]:
        body = int(model.body_parentid[body])
    if not body:
        return robot.base
    joint = robot.structure.joints[model.joint(int(model.body_jntadr[body])).name]
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
    return tuple(model.names[one] for one in list(model.supports[joint])[1:])


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
