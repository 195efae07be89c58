"""Writes a body's mass into an MJCF: into an inertial, a geom that weighs, or a new inertial."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.arrays import inertia_entries
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.models.conversion import inertia_of_body
from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.models.mjcf_in_place import elements_within
from pupper_analysis.models.orientation import AngleUnits, orientation_change, stated_rotation
from pupper_analysis.models.xml_bytes import Element
from pupper_analysis.models.xml_text import Digits
from pupper_analysis.tools.sync.frames import Key
from pupper_analysis.tools.sync.inertia import (
    is_physical,
    is_same_body,
    spread_alike,
    turned_like,
    without_parts,
)

if TYPE_CHECKING:
    from pupper_analysis.tools.sync.mjcf_side import MjcfSide

Array = NDArray[np.float64]

_NEW_INERTIAL_COST = 100
"""What a new <inertial> counts, in attributes: any change of what is there goes before it."""

_Plan = tuple[int, Element, dict[str, str], Diagnostic | None]
"""How many attributes change, of which element, which, and what to say."""


def write_inertial(side: MjcfSide, mover: str, keys: list[Key]) -> None:
    """Notes the changes that give what moves with a joint, or the base, another mass."""
    keys = [key for key in keys if key[0] in ("mass", "com", "inertia")]
    model = side.model
    if side.file.spec.compiler.settotalmass > 0:
        for key in keys:
            side.left[key] = diagnose("masses-scaled-to-total")
        return
    wanted = side.sides.mjcf_frames[mover].actInv(side.wanted.bodies[mover].rigid)
    top = model.body(side.sides.matched.mjcf_body[mover]).id
    group = [b for b in range(1, model.nbody) if model.body_weldid[b] == model.body_weldid[top]]
    placed = {body: _pose(side, body).act(inertia_of_body(model, body)) for body in group}
    heavy = sorted((b for b in group if placed[b].mass > 0), key=lambda b: -placed[b].mass)
    if is_same_body(sum((placed[body] for body in heavy), pin.Inertia.Zero()), wanted):
        return
    plans: list[_Plan] = []
    copied = False
    for body in heavy or [top]:
        others = [placed[other] for other in heavy if other != body]
        left = without_parts(wanted, others)
        if left is None or (others and not is_physical(left)):
            continue
        element = side.elements.body(str(model.body(body).name))
        if element is None:
            copied = True
            continue
        inside = _pose(side, body).actInv(left)
        plans += _plans(side, body, element, inside)
    if not plans:
        alike = spread_alike({body: placed[body] for body in heavy}, wanted)
        spread = [] if alike is None else list(_spread(side, alike))
        if not spread or None in spread:
            reason = diagnose("body-is-a-copy" if copied else "no-body-to-change")
            side.left.update(dict.fromkeys(keys, reason))
            return
        for plan in spread:
            _write(side, plan)
        told = diagnose("bodies-changed-alike", bodies=len(spread))
        side.notes.update(dict.fromkeys(keys, told))
        return
    best = min(plans, key=lambda plan: plan[0])
    _write(side, best)
    how = best[3]
    if len(heavy) > 1:
        how = diagnose("one-body-changed", how=how, bodies=len(heavy))
    if how is not None:
        side.notes.update(dict.fromkeys(keys, how))


def _spread(side: MjcfSide, alike: Mapping[int, pin.Inertia]) -> Iterator[_Plan | None]:
    """Yields how each of several bodies gets its own mass; None where one cannot."""
    for body, part in alike.items():
        element = side.elements.body(str(side.model.body(body).name))
        inside = _pose(side, body).actInv(part)
        plans = [] if element is None else _plans(side, body, element, inside)
        yield min(plans, key=lambda plan: plan[0], default=None)


def _write(side: MjcfSide, plan: _Plan | None) -> None:
    assert plan is not None
    _, element, changes, _ = plan
    if element.start < 0 and element.parent is not None:
        element.parent.children.insert(0, element)
    side.elements.write_all(element, changes)


def _pose(side: MjcfSide, body: int) -> pin.SE3:
    return side.sides.bodies[str(side.model.body(body).name)]


def _plans(side: MjcfSide, body: int, element: Element, wanted: pin.Inertia) -> list[_Plan]:
    """Returns the ways to give a body a mass, by the file's own words."""
    inertial = element.find("inertial")
    by_geoms = side.file.spec.compiler.inertiafromgeom
    ignored = by_geoms == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    if inertial is not None and not ignored:
        now = inertia_of_body(side.model, body)
        changes = inertial_changes(inertial, now, wanted, side.elements.units, side.digits)
        return [(len(changes), inertial, changes, None)]
    plans = list(_by_a_geom(side, body, element, wanted))
    if plans or ignored:
        return plans
    if by_geoms == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE and wanted.mass == 0:
        return []
    new = Element("inertial", {}, element.file, -1, element.line, element)
    words = {
        "pos": side.digits.words([], wanted.lever, 1.0),
        "mass": side.digits.words([], np.array([wanted.mass])),
        "fullinertia": side.digits.words([], inertia_entries(wanted.inertia)),
    }
    stated = {name: text for name, text in words.items() if text is not None}
    return [(_NEW_INERTIAL_COST, new, stated, diagnose("inertial-put-in"))]


def _by_a_geom(side: MjcfSide, body: int, element: Element, wanted: pin.Inertia) -> list[_Plan]:
    """Returns how the mass of one geom makes a body's mass, com and inertia right, if it does."""
    spec = side.robot.description.mjcf
    name = str(side.model.body(body).name)
    elements = [e for e in elements_within(element) if e.tag == "geom"]
    geoms = list(spec.body(name).geoms)
    if len(geoms) != len(elements):
        return []
    more = wanted.mass - float(side.model.body_mass[body])
    plans: list[_Plan] = []
    for index, (geom, there) in enumerate(zip(geoms, elements, strict=True)):
        if math.isnan(geom.mass) or geom.mass + more <= 0:
            continue
        text = side.digits.words((there.get("mass") or "").split(), np.array([geom.mass + more]))
        if text is None:
            continue
        tried = spec.copy()
        tried.body(name).geoms[index].mass = float(text)
        try:
            with silence_mujoco():
                model = copy.copy(tried.compile())
        except (ValueError, RuntimeError):
            continue
        if is_same_body(inertia_of_body(model, model.body(name).id), wanted, 1e-10):
            own = "mass" in there.attributes
            how = None if own else diagnose("mass-of-class-stays")
            plans.append((1, there, {"mass": text}, how))
    return plans


def inertial_changes(
    element: Element, now: pin.Inertia, wanted: pin.Inertia, units: AngleUnits, digits: Digits
) -> dict[str, str]:
    """Returns the fewest changes by which an <inertial> states a mass, in the form that it has."""
    changes = {}
    for attribute, values, floor in (("pos", wanted.lever, 1.0), ("mass", [wanted.mass], 0.0)):
        words = (element.get(attribute) or "").split()
        text = digits.words(words, np.array(values), floor)
        if text is not None:
            changes[attribute] = text
    size = float(np.abs(wanted.inertia).max())
    if float(np.abs(wanted.inertia - now.inertia).max()) <= 1e-11 * size:
        return changes
    if element.get("diaginertia") is None:
        words = (element.get("fullinertia") or "").split()
        text = digits.words(words, inertia_entries(wanted.inertia))
        return changes if text is None else changes | {"fullinertia": text}
    return changes | _principal(element, wanted.inertia, units, digits)


def _principal(
    element: Element, wanted: Array, units: AngleUnits, digits: Digits
) -> dict[str, str]:
    """Returns the changes of principal moments, or of their axes, or of both."""
    moments = np.array([float(word) for word in (element.get("diaginertia") or "").split()])
    own = stated_rotation(element, units)
    size = float(np.abs(wanted).max())
    inside = own.T @ wanted @ own
    if float(np.abs(inside - np.diag(np.diag(inside))).max()) <= 1e-11 * size:
        text = digits.words((element.get("diaginertia") or "").split(), np.diag(inside))
        return {} if text is None else {"diaginertia": text}
    turn = turned_like(wanted, np.diag(moments), own)
    if turn is not None:
        return orientation_change(element, own, turn, units, digits)
    values, axes = np.linalg.eigh(wanted)
    order = list(np.argsort(np.argsort(moments)))
    values, axes = values[order], axes[:, order]
    # Of the axes and their opposites, those near to the file's own.
    axes = axes * np.where(np.sum(axes * own, axis=0) < 0, -1.0, 1.0)
    if np.linalg.det(axes) < 0:
        axes[:, int(np.argmin(np.abs(np.sum(axes * own, axis=0))))] *= -1
    text = digits.words((element.get("diaginertia") or "").split(), values)
    changes = {} if text is None else {"diaginertia": text}
    return changes | orientation_change(element, own, axes, units, digits)
