"""PlaCo's robots, lent to one user at a time: what PlaCo makes of a URDF it never gives back.

A ``RobotWrapper`` keeps its 375 kB for good, whoever lets go of it; and reading the URDF takes
milliseconds. Robots whose joints and links hang together in the same way, as the thousand designs
of a study do, differ in numbers alone: these can be set in place.
"""

from __future__ import annotations

from collections.abc import Hashable

import pinocchio as pin
import placo

from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml import to_text
from pupper_analysis.robot.robot import Robot

_spare: dict[Hashable, list[placo.RobotWrapper]] = {}
"""{structure: PlaCo's robots that nobody uses}. They are never let go: that would free nothing."""


class Wrapper:
    """PlaCo's robot with a robot's numbers; it belongs to its holder alone, in one thread.

    Whoever uses ``placo`` holds this: when it goes, another robot may have PlaCo's.

    Attributes:
        placo: PlaCo's robot, without shapes.
    """

    def __init__(self, robot: Robot) -> None:
        self._spare = _spare.setdefault(_structure(robot.pin_model), [])
        try:
            self.placo = self._spare.pop()
        except IndexError:
            self.placo = _load(robot)
        _take_numbers(self.placo.model, robot.pin_model)

    def __del__(self) -> None:
        if hasattr(self, "placo"):
            self._spare.append(self.placo)


def _load(robot: Robot) -> placo.RobotWrapper:
    """Has PlaCo read a robot's URDF, without shapes: no file is needed."""
    tree = UrdfTree.of(robot.description.urdf)
    tree.remove_shapes()
    wrapper = placo.RobotWrapper("", placo.Flags.ignore_collisions, to_text(tree.root))
    _leave_names_to_links(wrapper.model)
    return wrapper


def _leave_names_to_links(model: pin.Model) -> None:
    """Renames frames of joints that are named like a link: PlaCo asks for names alone."""
    links = {frame.name for frame in model.frames if frame.type == pin.FrameType.BODY}
    taken = {frame.name for frame in model.frames}
    for frame in model.frames:
        if frame.type != pin.FrameType.BODY and frame.name in links:
            while frame.name in taken:
                frame.name += " (joint)"
            taken.add(frame.name)


def _structure(model: pin.Model) -> Hashable:
    """Returns what cannot be changed in place: joints, their axes and order, and links' names."""
    axes = tuple(tuple(joint.createData().S.ravel().tolist()) for joint in list(model.joints)[1:])
    kinds = tuple(joint.shortname() for joint in list(model.joints)[1:])
    links = tuple(
        (frame.name, int(frame.parentJoint))
        for frame in model.frames
        if frame.type == pin.FrameType.BODY
    )
    return tuple(model.names), tuple(model.parents), kinds, axes, links


def _take_numbers(model: pin.Model, given: pin.Model) -> None:
    """Gives a model the numbers of another one of its structure, in place."""
    for joint in range(given.njoints):
        model.inertias[joint] = given.inertias[joint]
        model.jointPlacements[joint] = given.jointPlacements[joint]
    places = {f.name: f.placement for f in given.frames if f.type == pin.FrameType.BODY}
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY and frame.name in places:
            frame.placement = places[frame.name]
    model.lowerPositionLimit = given.lowerPositionLimit
    model.upperPositionLimit = given.upperPositionLimit
