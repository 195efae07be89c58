"""Parts of closed loops that a URDF lacks: their weight is given to it, if that is all it lacks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np
import pinocchio as pin

from pupper_analysis.base.arrays import placement_of
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.models.conversion import inertia_of_body
from pupper_analysis.models.description import Description
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml import to_text
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.matching.match import Match

_MASS_TOLERANCE = 1e-3
"""Share of the weight within which the parts are what the URDF lacks; rounded files have 1e-4."""


def with_parts(matched: Match, spec: mujoco.MjSpec) -> tuple[Description | None, list[Diagnostic]]:
    """Returns the description with the weight of loops' parts, the MJCF's alone, in the URDF too.

    Rods and cranks behind motors, which a tree cannot close, are held at zero: they weigh there.
    Only where the two files then weigh the same, as a URDF may have their weight in other links.
    (A head that it lacks stays a difference of the files.)

    Args:
        matched: The two files.
        spec: The MJCF with all its joints.

    Returns:
        The description; None if there are no such parts, or the files differ otherwise. And what
        was done.
    """
    robot, model = matched.robot, matched.robot.mj_model
    names = [name for name in _part_bodies(spec, matched.cut_joints) if _known(model, name)]
    bodies = [model.body(name).id for name in names if model.body(name).mass[0] > 0]
    mass = float(sum(model.body_mass[body] for body in bodies))
    whole = float(model.body_subtreemass[model.body(robot.mj_base).id])
    if (
        mass <= _MASS_TOLERANCE * whole
        or abs(robot.total_mass + mass - whole) > _MASS_TOLERANCE * whole
    ):
        return None, []
    carriers = {
        int(model.body_weldid[model.body(body).id]): matched.urdf_link[moved]
        for moved, body in matched.mjcf_body.items()
    }
    if any(int(model.body_weldid[body]) not in carriers for body in bodies):
        return None, []
    data, config = mujoco.MjData(model), Configuration(robot, robot.neutral())
    robot.mj_convention.set_state(data, robot.neutral())
    mujoco.mj_kinematics(model, data)
    tree = UrdfTree.of(robot.description.urdf)
    for body in bodies:
        link = carriers[int(model.body_weldid[body])]
        inside = pin.SE3(config.frame_rotation(link), config.frame_position(link))
        place = placement_of(data.xquat[body], data.xpos[body])
        part = f"{model.body(body).name} (MJCF)"
        weight = inside.actInv(place.act(inertia_of_body(model, body)))
        tree.add_link(part, link, f"{part} (held)", np.zeros(3), weight)
    noted = [diagnose("parts-weigh-in-both", bodies=names, mass=Quantity(mass, "kg"))]
    return replace(robot.description, urdf=to_text(tree.root)), noted


def _part_bodies(spec: mujoco.MjSpec, joints: Sequence[str]) -> list[str]:
    """Returns the bodies that move with some joints, and with no others beyond these."""
    found: list[str] = []
    for name in joints:
        joint = spec.joint(name)
        ahead = [] if joint is None else [joint.parent]
        while ahead:
            body = ahead.pop()
            found.append(body.name)
            ahead += [
                child
                for child in body.bodies
                if all(other.name in joints for other in child.joints)
            ]
    return list(dict.fromkeys(found))


def _known(model: mujoco.MjModel, body: str) -> bool:
    return bool(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, body) >= 0)
