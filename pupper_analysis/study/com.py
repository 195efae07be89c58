"""Bodies whose centres of mass are elsewhere, in a robot's URDF and its MJCF alike."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
from lxml import etree
from numpy.typing import NDArray

from pupper_analysis.diagnostics import Vector, diagnose
from pupper_analysis.errors import ModelError
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.study.named import bodies_of, welded_to

Array = NDArray[np.float64]

_SAME = 1e-9
"""m: the centres of mass of both models have moved alike to rounding."""


def move_coms(
    robot: Robot, tree: UrdfTree, spec: mujoco.MjSpec, offsets: Mapping[str, Array]
) -> None:
    """Moves centres of mass in both files, in place.

    What is fixed to a link moves with it, each part by the same offset in the world, so that the
    whole's centre moves by it, and no inertia about a centre of mass changes.

    Args:
        robot: The robot of which the files are: its links are turned as its pose of zeros has them.
        tree: Of the URDF.
        spec: Of the MJCF.
        offsets: {joint: (3,) m, in the axes of the URDF's link that it moves}; ``""``: the base.

    Raises:
        ModelError: If the MJCF cannot be compiled.
    """
    config = Configuration(robot, robot.neutral())
    compiled = _compiled(robot, spec)
    data = mujoco.MjData(compiled)
    robot.mj_convention.set_state(data, robot.neutral())
    mujoco.mj_kinematics(compiled, data)
    links, bodies = tree.moved_links, bodies_of(robot)
    for joint, offset in offsets.items():
        link = links.get(joint, robot.base)
        moved = config.frame_rotation(link) @ offset
        for one in tree.fixed_group(link):
            inertial = tree.links[one].inertial
            if inertial is not None:
                _move_origin(inertial, config.frame_rotation(one).T @ moved)
        for body in welded_to(spec.body(bodies[joint] if joint else robot.mj_base)):
            if not body.explicitinertial:  # what its geoms make of it is written out
                body.mass, body.ipos = compiled.body_mass[body.id], compiled.body_ipos[body.id]
                body.iquat, body.inertia = (
                    compiled.body_iquat[body.id],
                    compiled.body_inertia[body.id],
                )
                body.explicitinertial = True
            body.ipos = np.array(body.ipos) + data.xmat[body.id].reshape(3, 3).T @ moved


def _compiled(robot: Robot, spec: mujoco.MjSpec) -> mujoco.MjModel:
    try:
        return spec.compile()  # which numbers its bodies, too
    except ValueError as error:
        told = diagnose("mjcf-not-compiled", message=str(error))
        raise ModelError(robot.description.mjcf_source, told) from error


def _move_origin(inertial: etree._Element, offset: Array) -> None:
    origin = inertial.find("origin")
    if origin is None:
        origin = etree.SubElement(inertial, "origin")
    place = np.array((origin.get("xyz") or "0 0 0").split(), dtype=float) + offset
    origin.set("xyz", " ".join(repr(float(value)) for value in place))


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
        if np.abs(new - old - asked).max() > _SAME:
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
