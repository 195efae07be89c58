"""What one of two files leaves open, and is given of the other's."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from pathlib import Path

import mujoco
from lxml import etree

from pupper_analysis.base.diagnostics import Diagnostic, Term, diagnose
from pupper_analysis.models.attributes import BY_KIND, PASSIVE
from pupper_analysis.models.multibody import TreeJoint
from pupper_analysis.models.spec_tree import state_number
from pupper_analysis.models.urdf_tree import UrdfTree


def take_unstated(
    root: etree._Element,
    theirs: Mapping[str, TreeJoint],
    unknown: Mapping[str, tuple[str, ...]],
    pairs: Mapping[str, str],
) -> dict[str, tuple[str, ...]]:
    """Gives a URDF's joints the MJCF's damping and dry friction where it states none, in place.

    Args:
        root: The URDF, with the MJCF's names of joints.
        theirs: The MJCF's joints.
        unknown: What the URDF leaves open, see `UrdfFile.unknown`: its efforts become the MJCF's.
        pairs: {joint in the URDF's file: in the MJCF}.

    Returns:
        {``damping`` or ``friction``: the joints that were given it}.
    """
    optional = [one for one in PASSIVE if one.in_both]
    given: dict[str, list[str]] = {one.kind: [] for one in optional}
    mine = [joint for joint in UrdfTree(root).joints.values() if not joint.is_fixed]
    lacking = [joint for joint in mine if any(joint.stated(one) is None for one in optional)]
    if not (lacking or unknown.get("effort")):
        return dict.fromkeys(given, ())
    effort = BY_KIND["effort"]
    for name in (pairs.get(name, name) for name in unknown.get("effort", ())):
        if name in theirs and math.isfinite(theirs[name].effort):
            UrdfTree(root).joints[name].state(effort, theirs[name].effort)
    for joint in lacking:
        for one in optional if joint.name in theirs else ():
            value = float(getattr(theirs[joint.name], one.field))
            if value and joint.stated(one) is None:
                joint.state(one, value)
                given[one.kind].append(joint.name)
    return {kind: tuple(names) for kind, names in given.items()}


def take_unknown(
    root: etree._Element,
    spec: mujoco.MjSpec,
    models: Collection[mujoco.MjModel],
    unknown: Mapping[str, tuple[str, ...]],
    source: Path,
) -> list[Diagnostic]:
    """Gives an MJCF's joints the URDF's numbers where its file leaves them open, in place.

    Args:
        root: The URDF, with the MJCF's names of joints.
        spec: The MJCF.
        models: What MuJoCo makes of it; they are given them, too.
        unknown: {kind: joints}, see `MjcfFile.unknown`.
        source: The MJCF's file.

    Returns:
        What was given to which.
    """
    told, mine = [], UrdfTree(root).joints
    theirs = {joint.name: joint for joint in spec.joints}
    for kind, names in unknown.items():
        one = BY_KIND[kind]
        stated = {name: mine[name].stated(one) for name in names if name in mine.keys() & theirs}
        given = {name: float(value) for name, value in stated.items() if value is not None}
        if kind == "effort":  # of 0 is how a URDF says that it states none
            given = {name: value for name, value in given.items() if value > 0}
        for name, value in given.items():
            state_number(theirs[name], one, value)
            for model in models if one.mujoco else ():
                getattr(model, one.mujoco)[model.jnt_dofadr[model.joint(name).id]] = value
        if given:
            told.append(
                diagnose("unknown-taken-from-urdf", file=source.name, what=Term(kind), joints=given)
            )
    return told
