"""Masses that the files of a robot do not state."""

from __future__ import annotations

import numpy as np

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.models.mjcf import compile_spec, lower_boundmass
from pupper_analysis.robot.robot import Robot, get_loaded_robot


def describe_missing_masses(robot: Robot) -> Diagnostic | None:
    """Create the message about links that got a mass, or whose negative mass was moved, in loading.

    Bodies whose mass is the ``boundmass`` of the MJCF's compiler also got a mass. The robot as
    loaded is evaluated, since a payload at such a body does not state the mass of the body.

    Returns:
        The message; None without such links.
    """
    robot = get_loaded_robot(robot)
    given = [
        note.subject.name for note in robot.notes if note.code == "mass-given" and note.subject
    ]
    moved = (note for note in robot.notes if note.code == "inertia-moved" and note.subject)
    negative = [
        note.subject.name
        for note in moved
        if note.subject and isinstance(mass := note.values["mass"], Quantity) and mass.value < 0
    ]
    bounded, bound = robot.compute_once(_list_bounded_bodies)
    if not given and not negative and not bounded:
        return None
    return diagnose(
        "link-masses-unknown",
        links=given,
        count=len(given),
        bounded=bounded,
        bound=bound,
        before_bounded=bool(given and bounded),
        both=bool((given or bounded) and negative),
        negative=negative,
    )


def _list_bounded_bodies(robot: Robot) -> tuple[tuple[str, ...], Quantity]:
    """Return the moving bodies whose mass is only the compiler's ``boundmass``, and the bound.

    A body that is fixed to a body with a stated mass is omitted, and also a base that the robot
    holds fixed.
    """
    spec = robot.description.mjcf.copy()
    bound = Quantity(float(spec.compiler.boundmass), "kg")
    smaller = lower_boundmass(spec)
    if not smaller:
        return (), bound
    spec.compiler.settotalmass = -1.0
    model = compile_spec(spec, robot.description.mjcf_source)
    base = model.body(robot.mj_base).id
    at_bound = model.body_mass == smaller
    groups = {
        int(group): at_bound[model.body_weldid == group].all()
        for group in np.unique(model.body_weldid[model.body_dofnum > 0])
        if model.body_rootid[group] == model.body_rootid[base]
        and (robot.floating or group != model.body_weldid[base])
    }
    return tuple(model.body(group).name for group, missing in groups.items() if missing), bound
