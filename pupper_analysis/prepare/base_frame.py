"""Lifts the frame of a base that is on the ground between the feet into the base."""

from __future__ import annotations

import mujoco
import numpy as np

from pupper_analysis.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.models.joint_kinds import JointKind
from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.prepare.contact_points import lowest_point
from pupper_analysis.robot.feet import limb_ends


def lift_base_frame(spec: mujoco.MjSpec) -> list[Diagnostic]:
    """Puts the frame of a free base to its com, in height, if no limb ends below the frame.

    The base's height is then one above the ground, as everywhere else. The URDF's frame follows, as
    it does where files have it in other places.

    Args:
        spec: The MJCF's, in which all bodies have names; it is changed.

    Returns:
        What was done.
    """
    base = next((joint.parent for joint in spec.joints if joint.type == JointKind.FREE), None)
    if base is None or list(base.frames):
        return []  # what is in a frame has its place in that
    whole = spec.copy()
    whole.compiler.discardvisual = False
    for one in (spec.copy(), whole):  # without what is only seen it takes a hundredth of the time
        with silence_mujoco():
            model = one.compile()
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        body = model.body(base.name).id
        ends = {end for end in limb_ends(model) if end != body}
        weld = model.body_weldid
        geoms = [g for g in range(model.ngeom) if int(weld[model.geom_bodyid[g]]) in ends]
        bottom = lowest_point(model, data, geoms)
        if data.xpos[body][2] > bottom:
            return []  # nor with what is only seen, with which a limb may end lower
    up = float(data.xipos[body][2] - data.xpos[body][2])
    turn = data.xmat[body].reshape(3, 3)
    hangs = bottom < data.xipos[body][2] - up / 2
    if not hangs or turn[2, 2] < 1 - 1e-9:
        return []
    shift = np.array([0.0, 0.0, up])
    if base.explicitinertial:
        base.ipos = base.ipos - shift
    for element in (*base.geoms, *base.sites, *base.cameras, *base.lights, *base.bodies):
        element.pos = element.pos - shift
    for geom in base.geoms:
        if np.isfinite(geom.fromto).all():
            geom.fromto = geom.fromto - np.tile(shift, 2)
    base.pos = base.pos + shift
    place = int(model.jnt_qposadr[model.body_jntadr[body]]) + 2
    for key in spec.keys:
        qpos = np.array(key.qpos)
        if len(qpos) > place:
            qpos[place] += up
            key.qpos = qpos
    return [diagnose("base-frame-lifted", subject=("body", base.name), height=Quantity(up, "m"))]
