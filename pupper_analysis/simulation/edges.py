"""Flat soles on legs that cannot lay them flat: MuJoCo has more contacts than one."""

from __future__ import annotations

import mujoco
import numpy as np

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.stand import Stand

_SAME_CONTACT = 1e-3
"""Contacts of a round foot are at one place (m)."""


def several_contacts(robot: Robot, stand: Stand) -> Diagnostic | None:
    """Says so if a foot that is one point in the prediction touches at several places in MuJoCo."""
    model, data = robot.mj_model, mujoco.MjData(robot.mj_model)
    robot.mj_convention.set_state(data, stand.qpos)
    mujoco.mj_fwdPosition(model, data)
    places: dict[str, list[np.ndarray]] = {}
    # A sole of several balls is one point, too, if its leg cannot lay it flat: that of one of them.
    bodies = {int(robot.contact_places[foot][0]): foot for foot in robot.contact_points}
    for touch in data.contact:
        if touch.dist >= 0 or 0 not in model.body_weldid[model.geom_bodyid[touch.geom]]:
            continue
        for geom in touch.geom.tolist():
            foot = robot.foot_geoms.get(geom) or bodies.get(int(model.geom_bodyid[geom]))
            if len(robot.feet.get(str(foot), ())) == 1:
                places.setdefault(str(foot), []).append(np.array(touch.pos))
    spread = {
        foot: max(float(np.linalg.norm(one - two)) for one in found for two in found)
        for foot, found in places.items()
    }
    foot = max(spread, key=spread.__getitem__, default=None)
    if foot is None or spread[foot] < _SAME_CONTACT:
        return None
    return diagnose(
        "foot-touches-at-several-places",
        subject=("foot", foot),
        count=len(places[foot]),
        spread=Quantity(spread[foot], "m"),
    )
