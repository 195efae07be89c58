"""What a new file has besides what is simulated: an IMU, and a base above the ground."""

from __future__ import annotations

import mujoco

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.models.mjcf_xml import MjcfXml
from pupper_analysis.models.xml import write_numbers
from pupper_analysis.prepare.contact_points import lowest_point
from pupper_analysis.prepare.convert.from_urdf import UrdfBodies

_KEY_DIGITS = 6
"""Decimals of the base's height: a micrometre."""


def add_imu(mjcf: MjcfXml, bodies: UrdfBodies) -> Diagnostic:
    """Adds an IMU: on the link that is named after one, otherwise at the base's origin.

    Returns:
        What was added.
    """
    named = sorted(
        (name for name in bodies.frames if "imu" in name.lower()),
        key=lambda name: (len(name), name),
    )
    mjcf.add_imu(named[0] if named else bodies.root, named[0] if named else "imu")
    return diagnose("imu-added", link=named[0] if named else None)


def lift_base(mjcf: MjcfXml, bodies: UrdfBodies, model: mujoco.MjModel) -> None:
    """Puts the base where nothing is in the ground, with all joints at zero or as it stands.

    A simulation that is begun without the keyframe would throw it up by what is in the ground.

    Args:
        mjcf: The MJCF, with its keyframe if it has one.
        bodies: What is known of the URDF.
        model: What MuJoCo compiles of it, so far.
    """
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    touching = [
        geom
        for geom in range(model.ngeom)
        if model.body_weldid[model.geom_bodyid[geom]]
        and (model.geom_contype[geom] or model.geom_conaffinity[geom])
    ]
    heights = [-lowest_point(model, data, touching)] if touching else []
    home = mjcf.home
    if home is not None:
        heights.append(float(home[2]))
    if heights and max(heights) > 0:
        height = write_numbers([0.0, 0.0, float(f"{max(heights):.{_KEY_DIGITS}f}")])
        mjcf.body(bodies.root).element.set("pos", height)
