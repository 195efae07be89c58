"""Writes numbers into an MJCF, and into what it includes; masses into inertials or geoms."""

from __future__ import annotations

import copy
import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arrays import inertia_entries, placement_of
from pupper_analysis.base.diagnostics import Diagnostic, Source, diagnose
from pupper_analysis.models.conversion import inertia_of_body, joint_armature, joint_damping
from pupper_analysis.models.efforts import (
    EffortStatement,
    effort_limit,
    stated_by_actuator,
    stated_by_joint,
)
from pupper_analysis.models.mjcf import free_joints, silence_mujoco
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.transmission import actuator_gear, drives_of
from pupper_analysis.robot.servos import own_servos
from pupper_analysis.tools.sync.digits import (
    SAME,
    AngleUnits,
    Digits,
    orientation_change,
    stated_rotation,
)
from pupper_analysis.tools.sync.frames import Key, Side, is_same_body, turned_like, ways_to_weigh
from pupper_analysis.tools.sync.mjcf_in_place import MjcfInPlace, elements_within
from pupper_analysis.tools.sync.xml_bytes import Element

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
    heavy = {body: part for body, part in placed.items() if part.mass > 0}
    if is_same_body(sum(heavy.values(), pin.Inertia.Zero()), wanted):
        return
    ways = ways_to_weigh(heavy, wanted, top)
    tries = [[_plan(side, body, part) for body, part in way.items()] for way in ways]
    found = [[one for one in way if one is not None] for way in tries if None not in way]
    if not found:
        copied = any(_element(side, body) is None for way in ways for body in way)
        reason = diagnose("body-is-a-copy" if copied else "no-body-to-change")
        side.left.update(dict.fromkeys(keys, reason))
        return
    best = min(found, key=lambda way: sum(plan[0] for plan in way))
    for plan in best:
        _write_plan(side, plan)
    how = best[0][3]
    if len(best) > 1:
        how = diagnose("bodies-changed-alike", bodies=len(best))
    elif len(heavy) > 1:
        how = diagnose("one-body-changed", how=how, bodies=len(heavy))
    if how is not None:
        side.notes.update(dict.fromkeys(keys, how))


def _element(side: MjcfSide, body: int) -> Element | None:
    return side.elements.body(str(side.model.body(body).name))


def _write_plan(side: MjcfSide, plan: _Plan) -> None:
    _, element, changes, _ = plan
    if element.start < 0 and element.parent is not None:
        element.parent.children.insert(0, element)
    side.elements.write_all(element, changes)


def _pose(side: MjcfSide, body: int) -> pin.SE3:
    return side.sides.bodies[str(side.model.body(body).name)]


def _plan(side: MjcfSide, body: int, part: pin.Inertia) -> _Plan | None:
    """Returns how to give a body a mass by the file's own words, by the fewest; None if not."""
    element, wanted = _element(side, body), _pose(side, body).actInv(part)
    if element is None:
        return None
    inertial = element.find("inertial")
    by_geoms = side.file.spec.compiler.inertiafromgeom
    ignored = by_geoms == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    if inertial is not None and not ignored:
        now = inertia_of_body(side.model, body)
        changes = inertial_changes(inertial, now, wanted, side.elements.units, side.digits)
        return len(changes), inertial, changes, None
    of_geom = next(_by_a_geom(side, body, element, wanted), None)
    none = by_geoms == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE and wanted.mass == 0
    if of_geom is not None or ignored or none:
        return of_geom
    new = Element("inertial", {}, element.file, -1, element.line, element)
    words = {
        "pos": side.digits.words([], wanted.lever, 1.0),
        "mass": side.digits.words([], np.array([wanted.mass])),
        "fullinertia": side.digits.words([], inertia_entries(wanted.inertia)),
    }
    stated = {name: text for name, text in words.items() if text is not None}
    return _NEW_INERTIAL_COST, new, stated, diagnose("inertial-put-in")


def _by_a_geom(side: MjcfSide, body: int, element: Element, wanted: pin.Inertia) -> Iterator[_Plan]:
    """Yields how the mass of one geom makes a body's mass, com and inertia right, if it does."""
    spec = side.robot.description.mjcf
    name = str(side.model.body(body).name)
    elements = [e for e in elements_within(element) if e.tag == "geom"]
    geoms = list(spec.body(name).geoms)
    if len(geoms) != len(elements):
        return
    more = wanted.mass - float(side.model.body_mass[body])
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
            yield 1, there, {"mass": text}, how


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


COPIED = diagnose("body-is-a-copy")


@dataclass(eq=False, kw_only=True)
class MjcfSide(Side):
    """An MJCF that gets numbers of a URDF.

    Attributes:
        file: The file.
        elements: Its elements.
        gains: {("kp" or "kd", joint): of its position servo, at the joint (N m/rad, N m s/rad)}.
    """

    file: MjcfFile
    elements: MjcfInPlace
    gains: Mapping[Key, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.robot = self.sides.matched.robot
        self.model: mujoco.MjModel = self.robot.mj_model

    def plan(self, taken: Collection[Key]) -> None:
        """Notes all changes in the documents: places first, for what is on them moves along."""
        done = move_anchors(self, taken)
        taken = [key for key in taken if key not in done]
        for key in taken:
            if key[0] == "frame":
                self._frame(key)
        for kind in ("position", "rotation", "zero"):
            for key in taken:
                if key[0] == kind:
                    self._place(key)
        for key in taken:
            kind, name = key
            if kind == "axis":
                self._axis(key)
            elif kind in ("lower limit", "upper limit", "zero"):
                self._limits(key)
            elif kind == "effort":
                write_effort(self, key)
            elif kind == "damping":
                self._damping(key)
            elif kind == "friction":
                value = self.wanted.joints[name].friction
                self._number(key, "frictionloss", [value])
            elif kind == "armature":
                self._armature(key)
        for name in dict.fromkeys(joint for _, joint in self.gains):
            write_gains(self, name, {key: k for key, k in self.gains.items() if key[1] == name})
        for name in dict.fromkeys(e for k, e in taken if k in ("mass", "com", "inertia")):
            write_inertial(self, name, [key for key in taken if key[1] == name])

    def write(
        self,
        key: Key,
        element: Element,
        attribute: str,
        value: ArrayLike,
        floor: float = 0.0,
    ) -> bool:
        """Writes numbers as an attribute of an element itself, unless it states them.

        Where a default class states it, what is reported of the difference says so.

        Args:
            key: The difference.
            element: The element.
            attribute: The attribute.
            value: The numbers.
            floor: The least scale of what counts as the same.

        Returns:
            Whether something was written.
        """
        written = self.elements.write(element, attribute, value, floor)
        place = self.elements.class_stating(element, attribute) if written else None
        if place is not None:
            source = Source(str(place.file), place.line)
            self.notes[key] = diagnose(
                "class-stays", attribute=attribute, place=str(place), sources=source
            )
        return written

    def _frame(self, key: Key) -> None:
        name = key[1]
        if not self.on_same_body(key):
            return
        owner, position = self.wanted.frames[name]
        inside = self.sides.mjcf_frames[owner].inverse() * position
        there = self.robot.description.frames[name][1]
        # As `models.conversion` names its frames: a body goes before a site of its name.
        bodies = [self.model.body(i).name for i in range(self.model.nbody)]
        if there in bodies:
            body = self.model.body(there).id
            element, now = self.elements.body(there), np.array(self.model.body_pos[body])
            parent = int(self.model.body_parentid[body])
        else:
            site = self.model.site(there).id
            element, now = self.elements.named("site", there), np.array(self.model.site_pos[site])
            parent = int(self.model.site_bodyid[site])
        if element is None:
            self.left[key] = COPIED
            return
        local = self._body_pose(parent).inverse() * inside
        around = self.elements.frame_of(element).inverse()
        self.set_position(key, element, around * now, around * local)

    def _body_pose(self, body: int) -> pin.SE3:
        """Returns where a body is in the frame of the body that a joint moves."""
        name = str(self.model.body(body).name)
        return pin.SE3.Identity() if body == 0 else self.sides.bodies[name]

    def set_position(self, key: Key, element: Element, now: Array, wanted: Array) -> bool:
        """Writes an element's place, unless it is there; says whether something was written."""
        if float(np.abs(now - wanted).max()) <= SAME:
            return False
        return self.write(key, element, "pos", wanted, 1.0)

    def _place(self, key: Key) -> None:
        """Moves the body of a joint, with all that is on it."""
        name = key[1]
        body = int(self.model.jnt_bodyid[self.model.joint(name).id])
        element = self.elements.body(str(self.model.body(body).name))
        first = int(self.model.body_jntadr[body])
        if element is None:
            self.left[key] = COPIED
            return
        if self.model.joint(name).id != first:
            self.left[key] = diagnose("joint-shares-its-place")
            return
        parent = self.sides.own.joints[name].parent
        before = self.sides.mjcf_frames[parent].inverse()
        frame = self._body_pose(int(self.model.body_parentid[body]))
        now = placement_of(self.model.body_quat[body], self.model.body_pos[body])
        joint = before * self.wanted.joints[name].placement * self.sides.mjcf_frames[name]
        own = self.sides.own.joints[name].placement
        wanted = frame.inverse() * joint * own.inverse() * frame * now
        around = self.elements.frame_of(element).inverse()
        now, wanted = around * now, around * wanted
        self.set_position(key, element, np.array(now.translation), np.array(wanted.translation))
        self.elements.turn(element, np.array(now.rotation), np.array(wanted.rotation))

    def joint_in_file(self, name: str) -> Element | None:
        """Returns the element of a joint."""
        body = int(self.model.jnt_bodyid[self.model.joint(name).id])
        return self.elements.joint(name, str(self.model.body(body).name))

    def _axis(self, key: Key) -> None:
        element = self.joint_in_file(key[1])
        if element is None:
            self.left[key] = COPIED
            return
        frame, joint = self.sides.mjcf_frames[key[1]], self.wanted.joints[key[1]]
        turn = np.array(frame.rotation).T
        index = self.model.joint(key[1]).id
        # MuJoCo's axis is in the body's frame, that of the file in the frames around it.
        around = self.elements.frame_of(element).inverse()
        into = np.array(around.rotation)
        now, wanted = into @ np.array(self.model.jnt_axis[index]), into @ turn @ joint.axis
        if float(np.abs(now - wanted).max()) <= SAME:
            return
        self.write(key, element, "axis", wanted, 1.0)
        if joint.slides:
            return
        # The files may put a hinge's origin elsewhere on its axis: it must be on the new one.
        off = np.array(frame.translation)
        step = float(joint.axis @ off) * joint.axis - off
        anchor = np.array(self.model.jnt_pos[index])
        self.set_position(key, element, around * anchor, around * (anchor + turn @ step))

    def _limits(self, key: Key) -> None:
        name = key[1]
        element, joint = self.joint_in_file(name), self.wanted.joints[name]
        if element is None:
            self.left[key] = COPIED
            return
        finite = math.isfinite(joint.lower), math.isfinite(joint.upper)
        if not any(finite):
            self.elements.write(element, "limited", "false")
            return
        if not all(finite):
            self.left[key] = diagnose("mjcf-one-limit-unwritten")
            return
        factor = 1.0 if joint.slides else self.elements.units.factor
        values = [joint.lower / factor, joint.upper / factor]
        index = self.model.joint(name).id
        limited = self.robot.description.mjcf.joint(name).limited
        auto = limited == mujoco.mjtLimited.mjLIMITED_AUTO.value and self.elements.autolimits
        if not self.model.jnt_limited[index]:
            if not auto:
                self.elements.write(element, "limited", "true")
        elif element.get("range") is None:
            scale = max(1.0, float(np.abs(values).max()))
            now = np.array(self.model.jnt_range[index]) / factor
            if float(np.abs(now - values).max()) <= SAME * scale:
                return
        self.write(key, element, "range", values, 1.0)

    def _damping(self, key: Key) -> None:
        name = key[1]
        if name not in self.wanted.joints:
            self._base_damping(key)
            return
        index = self.model.joint(name).id
        dof = int(self.model.jnt_dofadr[index])
        of_joint = float(self.model.dof_damping[dof])
        of_motors = float(joint_damping(self.model)[dof]) - of_joint
        if self.model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_DAMPER.value:
            self.left[key] = diagnose("damping-switched-off")
            return
        wanted = self.wanted.joints[name].damping - of_motors
        if wanted < 0:
            self.left[key] = diagnose("motors-damp-more")
            return
        element = self.joint_in_file(name)
        stated = ([] if element is None else (element.get("damping") or "").split())[1:]
        higher = [float(word) for word in stated]
        self._number(key, "damping", [wanted, *higher])

    def _armature(self, key: Key) -> None:
        index = self.model.joint(key[1]).id
        dof = int(self.model.jnt_dofadr[index])
        of_joint = float(self.model.dof_armature[dof])
        of_motors = float(joint_armature(self.model)[dof]) - of_joint
        wanted = self.wanted.joints[key[1]].armature - of_motors
        if wanted < 0:
            self.left[key] = diagnose("motors-weigh-more")
            return
        self._number(key, "armature", [wanted])

    def _base_damping(self, key: Key) -> None:
        bodies = [self.model.body(i).name for i in range(self.model.nbody)]
        free = [str(bodies[self.model.jnt_bodyid[index]]) for index in free_joints(self.model)]
        element = self.elements.joint("", free[0]) if free else None
        if element is None:
            body = self.elements.body(free[0]) if free else None
            children = [] if body is None else body.children
            element = next((e for e in children if e.tag == "joint"), None)
        if element is None:
            self.left[key] = COPIED
            return
        self.write(key, element, "damping", 0.0)

    def _number(self, key: Key, attribute: str, values: list[float]) -> None:
        element = self.joint_in_file(key[1])
        if element is None:
            self.left[key] = COPIED
            return
        self.write(key, element, attribute, values)


_ANCHOR_TOLERANCE = 1e-9
"""Up to which two steps are the same (m)."""


def move_anchors(side: MjcfSide, taken: Collection[Key]) -> set[Key]:
    """Notes the joints that are merely elsewhere in their bodies.

    A joint is where the file puts it in its body. If that is changed, its place differs, and so do
    the com and all that is on the body, all by one step: as many differences, whose one cause is
    mended here, lest the body is moved beneath its shapes.

    Returns:
        The differences that are mended by it.
    """
    mended: set[Key] = set()
    for kind, name in taken:
        if kind == "position":
            keys = {key for key, _ in _carried(side, name)} & set(taken)
            step = _step(side, name)
            if step is not None and _write(side, name, step):
                mended |= {(kind, name), *keys}
    return mended


def _carried(side: MjcfSide, name: str) -> Iterator[tuple[Key, tuple[Array, Array]]]:
    """Yields what is on a body: the difference it would be, what it is and shall be."""
    now, wanted = side.sides.mjcf, side.wanted
    yield ("com", name), (now.bodies[name].com, wanted.bodies[name].com)
    for child in now.children(name):
        places = now.joints[child].position, wanted.joints[child].position
        yield ("position", child), places
    for frame, (owner, position) in now.frames.items():
        if owner == name:
            yield ("frame", frame), (position, wanted.frames[frame][1])


def _step(side: MjcfSide, name: str) -> Array | None:
    """Returns how far a joint shall be moved in its body, in that's axes; None if it is not that.

    All that is on the body must say so, its com at least.
    """
    now, wanted = side.sides.mjcf.joints[name], side.wanted.joints[name]
    step = now.rotation.T @ (wanted.position - now.position)
    carried = [places for _, places in _carried(side, name)]
    apart = [there - here + step for here, there in carried]
    if float(np.abs(now.rotation - wanted.rotation).max()) > _ANCHOR_TOLERANCE:
        return None
    if any(float(np.abs(one).max()) > _ANCHOR_TOLERANCE for one in apart):
        return None
    return np.array(side.sides.mjcf_frames[name].rotation).T @ step


def _write(side: MjcfSide, name: str, step: Array) -> bool:
    index = side.model.joint(name).id
    element = side.joint_in_file(name)
    body = int(side.model.jnt_bodyid[index])
    if element is None or int(side.model.body_jntnum[body]) != 1:
        return False
    around = side.elements.frame_of(element).inverse()
    now = np.array(side.model.jnt_pos[index])
    return side.set_position(("position", name), element, around * now, around * (now + step))


# Writes the gains of position servos into an MJCF, in the words in which it states them.


def write_gains(side: MjcfSide, name: str, wanted: dict[Key, float]) -> None:
    """Notes the changes that give the servo of a joint other gains.

    Args:
        side: The MJCF.
        name: The joint.
        wanted: {("kp", joint): stiffness at the joint (N m/rad), ("kd", joint): damping there}.
    """
    model = side.model
    drives = drives_of(model, model.joint(name).id)
    elements = side.elements.drives(name)
    now = own_servos(side.robot).get(name)
    if now is None or len(drives) != 1:
        side.left.update(dict.fromkeys(wanted, diagnose("joint-without-one-servo")))
        return
    if len(elements) != 1:
        side.left.update(dict.fromkeys(wanted, diagnose("actuators-are-copies")))
        return
    squared = float(actuator_gear(model, drives[0])[0]) ** 2
    stiffness = wanted.get(("kp", name), now[0]) / squared
    damping = wanted.get(("kd", name), now[1]) / squared
    (element,) = elements
    if element.tag == "position":
        _position(side, element, name, wanted, stiffness, damping)
    elif element.tag == "general":
        key = next(iter(wanted))
        gain = _padded(element, "gainprm", [stiffness])
        side.write(key, element, "gainprm", gain)
        side.write(key, element, "biasprm", _padded(element, "biasprm", [0, -stiffness, -damping]))
    else:
        message = diagnose("servo-without-words", tag=element.tag)
        side.left.update(dict.fromkeys(wanted, message))


def _position(
    side: MjcfSide,
    element: Element,
    name: str,
    wanted: dict[Key, float],
    stiffness: float,
    damping: float,
) -> None:
    if ("kp", name) in wanted:
        side.write(("kp", name), element, "kp", stiffness)
    if ("kd", name) in wanted:
        text = side.digits.words((element.get("kv") or "").split(), np.array([damping]))
        if text is not None:  # a ratio of damping gives way to a damping
            element.rename_or_set("dampratio", "kv", text)


def _padded(element: Element, attribute: str, values: list[float]) -> list[float]:
    """Returns the parameters of an actuator with those behind them that the file states."""
    stated = [float(word) for word in (element.get(attribute) or "").split()]
    return [*values, *stated[len(values) :]]


# Writes the greatest torque of a joint into an MJCF: where it is stated, in whichever words.

_LIMITED = {
    "actuatorfrcrange": "actuatorfrclimited",
    "forcerange": "forcelimited",
    "ctrlrange": "ctrllimited",
}
"""{range: what says whether it is one}."""


def write_effort(side: MjcfSide, key: Key) -> None:
    """Notes the changes that give a joint another greatest torque.

    It is the least of what the joint's ``actuatorfrcrange``, the actuators' ``forcerange`` and the
    ``ctrlrange`` of plain motors allow: whichever is stated and is not right, is changed.
    """
    name, model, spec = key[1], side.model, side.robot.description.mjcf
    wanted = side.wanted.joints[name].effort
    joint = model.joint(name).id
    element = side.joint_in_file(name)
    drives, motors = drives_of(model, joint), side.elements.drives(name)
    if element is None or len(motors) != len(drives):
        side.left[key] = diagnose("actuators-are-copies")
        return
    of_joint = [(element, one) for one in stated_by_joint(model, joint)]
    of_motors = [
        (motor, one)
        for motor, drive in zip(motors, drives, strict=True)
        for one in stated_by_actuator(model, drive)
        if one.factor
    ]
    if not 0 < wanted < math.inf:  # a URDF's effort of 0 is none
        for owner, one in (*of_joint, *of_motors):
            side.elements.write(owner, _LIMITED[one.attribute], "false")
        side.notes[key] = diagnose("limit-switched-off")
        return
    now = effort_limit(model, joint)
    for owner, one in (*of_joint, *(of_motors if len(drives) == 1 else ())):
        # What is looser than the least bound does no harm, unless it is below what is wanted.
        off = abs(one.greatest - wanted) > SAME * max(wanted, one.greatest)
        if off and (one.greatest < wanted or one.greatest <= now * (1 + SAME)):
            _write_effort_element(side, key, owner, one.attribute, wanted / abs(one.factor), one)
    if len(drives) == 1:
        gear = abs(float(actuator_gear(model, drives[0])[0]))
        if gear == 0:
            side.left[key] = diagnose("gear-is-zero")
        elif not (of_motors or of_joint):
            motor = next(actuator for actuator in spec.actuators if actuator.target == name)
            _write_effort_element(side, key, motors[0], "forcerange", wanted / gear)
            _limit(side, motors[0], "forcelimited", motor.forcelimited)
    elif drives and now < wanted and not any(one.greatest == now for _, one in of_joint):
        side.left[key] = diagnose("actuators-share-it")
    elif not of_joint:
        _write_effort_element(side, key, element, "actuatorfrcrange", wanted)
        _limit(side, element, "actuatorfrclimited", spec.joint(name).actfrclimited)


def _write_effort_element(
    side: MjcfSide,
    key: Key,
    element: Element,
    attribute: str,
    value: float,
    stated: EffortStatement | None = None,
) -> None:
    """Writes a range whose greater end is a value; one that is not symmetric keeps its shape."""
    pair, old = np.array([-value, value]), np.array((0.0, 0.0) if stated is None else stated.stated)
    if abs(old.sum()) > SAME:
        pair = old * (value / float(np.abs(old).max()))
    side.write(key, element, attribute, pair)


def _limit(side: MjcfSide, element: Element, attribute: str, limited: int) -> None:
    """Says that a new range is one, where that does not follow from its being there."""
    automatic = limited == mujoco.mjtLimited.mjLIMITED_AUTO.value and side.elements.autolimits
    if limited != mujoco.mjtLimited.mjLIMITED_TRUE.value and not automatic:
        side.elements.write(element, attribute, "true")
