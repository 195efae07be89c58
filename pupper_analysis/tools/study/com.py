"""Bodies whose centres of mass are elsewhere, in a robot's URDF and its MJCF alike."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Vector, diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.spec_tree import SpecTree
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.study.named import bodies_of

Array = NDArray[np.float64]

_COM_TOLERANCE = 1e-9
"""m: the centres of mass of both models have moved alike to rounding."""


def move_coms(robot: Robot, trees: tuple[UrdfTree, SpecTree], offsets: Mapping[str, Array]) -> None:
    """Moves centres of mass in both files, in place.

    What is fixed to a link moves with it, each part by the same offset in the world, so that the
    whole's centre moves by it, and no inertia about a centre of mass changes.

    Args:
        robot: The robot of which the files are: its links are turned as its pose of zeros has them.
        trees: Of the URDF and of the MJCF.
        offsets: {joint: (3,) m, in the axes of the URDF's link that it moves}; ``""``: the base.
    """
    config, data = Configuration(robot, robot.neutral()), mujoco.MjData(robot.mj_model)
    robot.mj_convention.set_state(data, robot.neutral())
    mujoco.mj_kinematics(robot.mj_model, data)
    urdf, mjcf = trees
    for joint, offset in offsets.items():
        link = urdf.moved_by(joint) or robot.base
        moved = config.frame_rotation(link) @ offset
        for one in urdf.fixed_group(link):
            urdf.move_com(one, config.frame_rotation(one).T @ moved)
        for one in mjcf.fixed_group(mjcf.moved_by(joint) or robot.mj_base):
            mjcf.move_com(one, data.body(one).xmat.reshape(3, 3).T @ moved)


def check_coms(before: Robot, after: Robot, offsets: Mapping[str, Array]) -> None:
    """Checks that the whole's centre of mass has moved as asked, in both engines.

    Args:
        before: The robot of before.
        after: That with the offsets, of the same masses.
        offsets: As ``move_coms`` has them.

    Raises:
        ModelError: If not.
    """
    config = Configuration(before, before.neutral())
    links = UrdfTree.of(before.description.urdf).moved_links
    shares = {joint: _shares(after, joint) for joint in offsets}
    both = zip(("URDF", "MJCF"), _centres(before), _centres(after), strict=True)
    for at, (place, old, new) in enumerate(both):
        asked = sum(
            (shares[joint][at] * config.frame_rotation(links.get(joint, before.base)) @ offset
             for joint, offset in offsets.items()), np.zeros(3),
        )  # fmt: skip
        if np.abs(new - old - asked).max() > _COM_TOLERANCE:
            told = diagnose(
                "com-moved-otherwise",
                file=place,
                moved=Vector(tuple(new - old), "m"),
                asked=Vector(tuple(asked), "m"),
            )
            raise ModelError(before.description.mjcf_source, told)


def _shares(robot: Robot, joint: str) -> tuple[float, float]:
    """Returns the share of a body in the whole's mass, by either file: they may differ."""
    pin_model, model = robot.pin_model, robot.mj_model
    body = model.body(bodies_of(robot)[joint] if joint else robot.mj_base).id
    welded = model.body_mass[model.body_weldid == model.body_weldid[body]].sum()
    own = pin_model.inertias[pin_model.getJointId(joint) if joint else 1].mass
    return (
        float(own / sum(one.mass for one in pin_model.inertias)),
        float(welded / model.body_subtreemass[model.body(robot.mj_base).id]),
    )


def _centres(robot: Robot) -> tuple[Array, Array]:
    """Returns the whole's centre of mass by either model, in the pose of zeros (m)."""
    data = mujoco.MjData(robot.mj_model)
    robot.mj_convention.set_state(data, robot.neutral())
    mujoco.mj_kinematics(robot.mj_model, data)
    mujoco.mj_comPos(robot.mj_model, data)
    base = robot.mj_model.body(robot.mj_base).id
    own = Configuration(robot, robot.neutral()).center_of_mass()
    return own, np.array(data.subtree_com[base])
