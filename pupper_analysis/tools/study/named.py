"""Names of factors on a robot's numbers, and the joints and bodies that they mean."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from fnmatch import fnmatchcase
from glob import escape

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, UnknownNameError
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.fields import FIELDS

OF_JOINTS = tuple(name for name, field in FIELDS.items() if field.per == "joint")
"""Kinds that are fields of the stance, of each joint."""

KINDS = {
    "mass": "mass and inertia of bodies",
    "inertia": "inertia of bodies about their centres of mass",
    "com_x": "offset of bodies' centres of mass along x of the URDF's link (m)",
    "com_y": "the same along y (m)",
    "com_z": "the same along z (m)",
    "effort": "effort limits of joints",
    "armature": "armature of joints",
    "damping": "damping of joints",
    "frictionloss": "dry friction of joints",
    "kp": "stiffness of servos",
    "kd": "damping of servos",
    **dict.fromkeys(OF_JOINTS, "position of joints that carry no foot (rad, m)"),
}
"""What ``KIND:PATTERN`` may say: factors on what the files say, but for the offsets of coms."""

EACH = "each"
"""``KIND:each:PATTERN`` is a number of its own for each that matches."""

AXES = ("com_x", "com_y", "com_z")
"""Kinds that are added, along these axes (m), and are no factors."""

ADDED = (*AXES, *OF_JOINTS)
"""Kinds that are no factors of what the files say, and have no bounds."""

BODIES = ("mass", "inertia", *AXES)
SERVOS = ("kp", "kd")


@dataclass(frozen=True)
class Named:
    """A factor's name, taken apart.

    Attributes:
        kind: One of ``KINDS``.
        pattern: What the names of bodies or joints must match, as file names do: ``*``, ``?``.
        each: Whether each that matches has a number of its own: ``KIND:each:PATTERN``, and
            ``KIND:each`` for all.
    """

    kind: str
    pattern: str
    each: bool = False

    @staticmethod
    def of(name: str) -> Named | None:
        """Takes a name apart; None if it is of another form.

        Raises:
            ConfigurationError: If there is no such kind.
        """
        kind, separator, pattern = name.partition(":")
        if not separator:
            return None
        if kind not in KINDS or not pattern:
            known = [f"{one}:NAME" for one in KINDS]
            told = diagnose("no-number-of-a-model", kind=kind, known=known)
            raise ConfigurationError(f"vary[{name!r}]", told)
        first, _, rest = pattern.partition(":")
        return Named(kind, rest or "*", each=True) if first == EACH else Named(kind, pattern)


def joints_of(robot: Robot, named: Named) -> tuple[str, ...]:
    """Returns the joints that a factor is for, or that move its bodies; ``""`` is the base.

    A body is matched by its link's name in the URDF, its body's in the MJCF, or its joint's.

    Raises:
        UnknownNameError: If none match; the message lists the names.
    """
    names = _names(robot, named.kind)
    found = tuple(
        joint for joint, own in names.items() if any(fnmatchcase(one, named.pattern) for one in own)
    )
    if not found:
        kind = "body" if named.kind in BODIES else "joint"
        raise UnknownNameError(
            robot.name, kind, named.pattern, dict.fromkeys(own[0] for own in names.values())
        )
    return found


def _names(robot: Robot, kind: str) -> dict[str, tuple[str, ...]]:
    """Returns {joint: by which names a factor may mean it, or what it moves}."""
    if kind not in BODIES:
        return {joint: (joint,) for joint in robot.joint_names}
    links, bodies = UrdfTree.of(robot.description.urdf).moved_links, bodies_of(robot)
    names = {"": (robot.base, robot.mj_base)}
    return names | {joint: (links[joint], bodies[joint], joint) for joint in robot.joint_names}


def expand_pattern(robot: Robot, named: Named) -> tuple[str, ...]:
    """Returns the names of the numbers that ``KIND:each:PATTERN`` stands for, one for each.

    Each has its link's name; where that also means another body, its body's or its joint's.

    Raises:
        UnknownNameError: If none match.
        ConfigurationError: If a body has no name that means it alone.
    """
    names = _names(robot, named.kind)
    found = []
    for joint in joints_of(robot, named):
        alone = [one for one in map(escape, names[joint])
                 if joints_of(robot, Named(named.kind, one)) == (joint,)]  # fmt: skip
        if not alone:
            problem = diagnose("no-name-of-its-own", body=names[joint][0])
            raise ConfigurationError(f"vary['{named.kind}:{EACH}:{named.pattern}']", problem)
        found.append(f"{named.kind}:{alone[0]}")
    return tuple(found)


def groups_of(robot: Robot, names: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """Returns {name: the numbers that it stands for}: itself, but for ``KIND:each:PATTERN``.

    Raises:
        UnknownNameError: If a pattern matches nothing.
        ConfigurationError: If two names stand for one number.
    """
    found: dict[str, tuple[str, ...]] = {}
    for name in names:
        named = Named.of(name)
        own = expand_pattern(robot, named) if named is not None and named.each else (name,)
        twice = next((one for one in own for other in found.values() if one in other), None)
        if twice is not None:
            raise ConfigurationError(f"vary[{name!r}]", diagnose("varies-already", name=twice))
        found[name] = own
    return found


def bodies_of(robot: Robot) -> dict[str, str]:
    """Returns {joint: the body that it moves in the MJCF}."""
    model = robot.mj_model
    return {
        joint: str(model.body(int(model.jnt_bodyid[model.joint(joint).id])).name)
        for joint in robot.joint_names
    }
