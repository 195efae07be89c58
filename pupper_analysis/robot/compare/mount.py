"""How a fixed base stands as each file is loaded, and what that does to gravity.

Where a robot is mounted is no difference of robots: for the comparison the URDF is put where the
MJCF stands. But who loads the URDF as it is computes other torques, if that is tilted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from lxml import etree
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.results import Result
from pupper_analysis.base.units import DOWN
from pupper_analysis.models.multibody import MultibodyTree
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.robot.matching.match import Match
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.robot.matching.trees import base_pose, kinematic_trees, poses_at_zero

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Mount(Result):
    """A fixed base that is tilted in one of the files.

    Attributes:
        tilt: Angle between the two files' verticals, as seen from the base (rad).
        torques: {joint: what it needs against gravity at zero angles by the URDF, and by the MJCF,
            each as it is loaded (N m; N of a slide)}; the one that differs most is the first.
        unit: Unit of the torques of the first.
    """

    tilt: float
    torques: dict[str, tuple[float, float]]
    unit: str

    @property
    def diagnostic(self) -> Diagnostic:
        """What the tilt does to gravity."""
        joint, (one, two) = next(iter(self.torques.items()))
        return diagnose(
            "base-tilted",
            subject=("joint", joint),
            tilt=Quantity(self.tilt, "rad"),
            urdf=Quantity(one, self.unit),
            mjcf=Quantity(two, self.unit),
        )


def mount_of(matched: Match, urdf: etree._Element, tolerances: Tolerances) -> Mount | None:
    """Returns how the base of the MJCF is tilted against the URDF's; None if it is not.

    Args:
        matched: The files.
        urdf: The URDF as it is.
        tolerances: What counts as a difference.
    """
    robot = matched.robot
    if robot.floating:
        return None
    stands = base_pose(robot).rotation
    if matched.conventions.base is not None:
        stands = stands @ matched.conventions.base.rotation
    turn = stands @ _in_root(urdf, matched.urdf_link[robot.base]).T
    one, two = kinematic_trees(robot)
    down = turn @ DOWN
    tilt = math.atan2(float(np.linalg.norm(np.cross(down, two.gravity))), float(down @ two.gravity))
    if not two.gravity.any() or tilt <= tolerances.rotation:
        return None
    first, second = gravity_torques(one, down), gravity_torques(two, two.gravity)
    names = sorted(one.joints, key=lambda name: -abs(second[name] - first[name]))
    unit = "N" if one.joints[names[0]].slides else "N m"
    return Mount(tilt, {name: (first[name], second[name]) for name in names}, unit)


def gravity_torques(tree: MultibodyTree, gravity: Array) -> dict[str, float]:
    """Returns {joint: what it needs to hold against gravity at zero angles (N m; N)}.

    Args:
        tree: A robot on a fixed base.
        gravity: (3,) in the base's frame (m/s^2).
    """
    poses = poses_at_zero(tree)
    carried = {name: np.zeros(4) for name in tree.bodies}  # mass, and first moments
    torques = {}
    for name in reversed(tree.parents_first()):
        body, joint, pose = tree.bodies[name], tree.joints[name], poses[name]
        carried[name] += body.mass * np.array([1.0, *pose.act(body.com)])
        mass, moment = carried[name][0], carried[name][1:]
        axis = pose.rotation @ joint.axis
        lever = moment - mass * pose.translation
        torques[name] = -float(
            axis @ (mass * gravity if joint.slides else np.cross(lever, gravity))
        )
        carried[joint.parent] += carried[name]
    return torques


def _in_root(urdf: etree._Element, link: str) -> Array:
    """Returns the axes (3, 3) of a link on fixed joints, as seen from the URDF's root."""
    axes = np.eye(3)
    for joint in UrdfTree(urdf).chain(link):
        axes = joint.origin.rotation @ axes
    return axes
