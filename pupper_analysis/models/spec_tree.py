"""An MJCF's bodies and joints: what is fixed to what, what moves, and edits of that structure.

Among them: a base that is free by several joints gets a free one.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arrays import inertia_entries
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.models.attributes import (
    BY_KIND,
    COUPLING_TIME_CONSTANT,
    FLOOR_NAME,
    HOME_KEYFRAME,
    IMU_SENSORS,
    JointAttribute,
    Number,
)
from pupper_analysis.models.mjcf import CONTACT_OF_GEOM, JointKind, add_plane
from pupper_analysis.models.xml import free_name

Array = NDArray[np.float64]


_OPTION_WORDS: Final[dict[tuple[str, Number], Any]] = {
    ("cone", "elliptic"): mujoco.mjtCone.mjCONE_ELLIPTIC,
    ("cone", "pyramidal"): mujoco.mjtCone.mjCONE_PYRAMIDAL,
    ("integrator", "implicitfast"): mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    ("jacobian", "dense"): mujoco.mjtJacobian.mjJAC_DENSE,
}
"""What MuJoCo's editable model has for the words of ``<option>``."""

NARROW = 1e-9
"""MuJoCo refuses a range from 0 to 0, which converters write of a URDF without a range."""


def set_inertia(body: mujoco.MjsBody, inertia: pin.Inertia) -> None:
    """States an inertia of a body, in its own frame, in the place of what it states."""
    entries = inertia_entries(np.array(inertia.inertia))
    body.explicitinertial, body.mass = True, float(inertia.mass)
    body.ipos, body.iquat = np.array(inertia.lever), (1.0, 0.0, 0.0, 0.0)
    body.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    products = bool(entries[3:].any())
    body.inertia = np.zeros(3) if products else entries[:3]
    body.fullinertia = entries if products else np.full(6, np.nan)


def state_number(joint: mujoco.MjsJoint, attribute: JointAttribute, value: float) -> None:
    """Gives a joint of a spec a number, in SI units; an effort is a limit to either side."""
    if attribute.kind == "effort":
        value = max(value, NARROW)
        joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_TRUE
        joint.actfrcrange = (-value, value)
        return
    word = attribute.mjcf[0]
    # Some are polynomials of the speed or the way, of which this is the first coefficient.
    powers = np.zeros(np.size(getattr(joint, word)))
    powers[0] = value
    setattr(joint, word, powers if len(powers) > 1 else value)


@dataclass(frozen=True, eq=False)
class SpecTree:
    """The bodies and joints of an MJCF, as `UrdfTree` of a URDF, and what else it is given.

    Attributes:
        spec: MuJoCo's editable model.
    """

    spec: mujoco.MjSpec

    @property
    def names(self) -> tuple[str, ...]:
        """The bodies, in the file's order; the world is none."""
        return tuple(body.name for body in self.spec.bodies[1:])

    def parent(self, link: str) -> str | None:
        """Returns the body that carries one; None for a child of the world."""
        up = self.spec.body(link).parent
        return None if up.name == self.spec.worldbody.name else str(up.name)

    def movers(self, link: str) -> tuple[str, ...]:
        """Returns the joints of a body, but for a free one."""
        joints = self.spec.body(link).joints
        return tuple(joint.name for joint in joints if joint.type != JointKind.FREE)

    def moved_by(self, joint: str) -> str | None:
        """Returns the body that a joint moves; None if there is no such joint."""
        found = self.spec.joint(joint)
        return None if found is None else str(found.parent.name)

    def fixed_group(self, link: str) -> list[str]:
        """Returns a body, and all that is fixed to it and carried by it."""
        group = [link]
        for name in group:
            children = self.spec.body(name).bodies
            group += [child.name for child in children if not list(child.joints)]
        return group

    def subtree(self, link: str) -> Iterator[str]:
        """Yields a body and all that it carries."""
        body = self.spec.body(link)
        yield link
        for child in body.find_all(mujoco.mjtObj.mjOBJ_BODY):
            yield child.name

    def weight(self, link: str) -> float:
        """Returns the mass of a body (kg); its geoms' where none is stated."""
        return float(self._compiled.body(link).mass[0])

    @cached_property
    def _compiled(self) -> mujoco.MjModel:
        return self.spec.copy().compile()

    def _forget(self) -> None:
        self.__dict__.pop("_compiled", None)

    def remove_subtree(self, link: str) -> None:
        """Takes a body out, with all that it carries and what refers to that."""
        self.spec.delete(self.spec.body(link))
        self._forget()

    def add_link(
        self, name: str, parent: str, joint: str, place: Array, inertia: pin.Inertia | None = None
    ) -> None:
        """Adds a body that is fixed to another; an MJCF has no joint for that."""
        del joint
        body = self.spec.body(parent).add_body(name=name, pos=place)
        if inertia is not None:
            set_inertia(body, inertia)
        self._forget()

    def scale_mass(self, link: str, factor: float) -> None:
        """Multiplies the mass of one body, stated or its geoms', and its inertia with it."""
        body = self.spec.body(link)
        self._forget()
        if body.explicitinertial:
            body.mass = factor * body.mass
            self.scale_inertia(link, factor)
            return
        for geom in body.geoms:
            geom.density = factor * geom.density
            if not math.isnan(geom.mass):
                geom.mass = factor * geom.mass

    def scale_inertia(self, link: str, factor: float) -> None:
        """Multiplies the inertia of one body about its com.

        Raises:
            ValueError: If it is not stated, but follows from its geoms.
        """
        body = self.spec.body(link)
        if not body.explicitinertial and list(body.geoms):
            raise ValueError(f"the inertia of {link} follows from its geoms")
        body.inertia = factor * np.array(body.inertia)
        body.fullinertia = factor * np.array(body.fullinertia)

    def move_com(self, link: str, offset: Array) -> None:
        """Moves the com of one body; what its geoms make of it is written out."""
        body = self.spec.body(link)
        if not body.explicitinertial:
            self.spec.adopt_inertial(body)
        body.ipos = np.array(body.ipos) + offset

    def scale(self, joint: str, attribute: JointAttribute, factor: float) -> None:
        """Multiplies a number of a joint; an effort wherever it is stated."""
        element = self.spec.joint(joint)
        if attribute == BY_KIND["effort"]:
            element.actfrcrange = np.array(element.actfrcrange) * factor
            for actuator in self.spec.actuators:
                if actuator.target == joint:
                    actuator.forcerange = np.array(actuator.forcerange) * factor
                    if actuator.biastype == mujoco.mjtBias.mjBIAS_NONE:  # its command is a force
                        actuator.ctrlrange = np.array(actuator.ctrlrange) * factor
            return
        if "springdamper" in attribute.mjcf and np.any(element.springdamper):
            self._state_spring_and_damper(element)
        word = attribute.mjcf[0]
        value = getattr(element, word)
        setattr(element, word, np.array(value) * factor if np.ndim(value) else value * factor)
        self._forget()

    def _state_spring_and_damper(self, element: mujoco.MjsJoint) -> None:
        """States what ``springdamper`` makes of a joint in numbers of their own."""
        model = self._compiled
        joint = model.joint(element.name).id
        for kind in ("spring", "damping"):
            attribute = BY_KIND[kind]
            values = np.atleast_1d(np.array(getattr(element, attribute.mjcf[0]), dtype=float))
            values[0] = attribute.compiled(model, joint)
            setattr(element, attribute.mjcf[0], values if len(values) > 1 else values[0])
        element.springdamper = (0.0, 0.0)

    def set_options(self, values: Mapping[str, Number]) -> None:
        """States attributes of ``<option>``, by MuJoCo's words for them."""
        for name, value in values.items():
            setattr(self.spec.option, name, _OPTION_WORDS.get((name, value), value))

    def add_floor(self, beneath: float | None = None) -> mujoco.MjsGeom:
        """Adds a plane at z = 0 with MuJoCo's own contact, that all which touches anything touches.

        Shapes whose bits only let them touch each other (left legs and right ones, say) are seen to
        touch ground, too: scenes of such robots have a floor with those bits.

        Args:
            beneath: A body of its own at that height (m) has it, the last one: what was there
                before keeps its number.
        """
        bits, name = 1, free_name(FLOOR_NAME, {geom.name for geom in self.spec.geoms})
        for geom in self.spec.geoms:
            bits |= int(geom.contype)
        body = self.spec.worldbody
        return add_plane(
            body if beneath is None else body.add_body(pos=(0, 0, beneath)), name, bits
        )

    def add_imu(self, body: str, site: str) -> None:
        """Adds an IMU at a site of a body, which is added at its origin where there is none."""
        if self.spec.site(site) is None:
            self.spec.body(body).add_site(name=site)
        for kind in IMU_SENSORS:
            sensor = getattr(mujoco.mjtSensor, f"mjSENS_{kind.upper()}")
            at = mujoco.mjtObj.mjOBJ_SITE
            self.spec.add_sensor(name=kind, type=sensor, objtype=at, objname=site)

    def add_coupling(
        self, follower: str, leader: str, multiplier: Number, offset: Number
    ) -> mujoco.MjsEquality:
        """Makes a joint follow another: q = offset + multiplier q of the leader."""
        # MuJoCo's polynomial is of the coordinates less those of its zero pose.
        here, there = (float(self.spec.joint(name).ref) for name in (follower, leader))
        rest = float(offset) - here + float(multiplier) * there
        equality = self.spec.add_equality(
            type=mujoco.mjtEq.mjEQ_JOINT, name1=follower, name2=leader
        )
        equality.data[:5] = (rest, float(multiplier), 0.0, 0.0, 0.0)
        equality.objtype = mujoco.mjtObj.mjOBJ_JOINT
        self._stiffen(equality)
        return equality

    def stiffen_couplings(self) -> None:
        """Makes couplings of joints as stiff as ``add_coupling``: a URDF's mimics are exact."""
        for equality in self.spec.equalities:
            if equality.type == mujoco.mjtEq.mjEQ_JOINT:
                self._stiffen(equality)

    def _stiffen(self, equality: mujoco.MjsEquality) -> None:
        equality.solref = (max(COUPLING_TIME_CONSTANT, 2 * float(self.spec.option.timestep)), 1.0)

    def motor_at(self, joint: str) -> mujoco.MjsActuator | None:
        """Returns the last motor at a joint; None if there is none."""
        at = mujoco.mjtTrn.mjTRN_JOINT
        found = [m for m in self.spec.actuators if m.trntype == at and m.target == joint]
        return found[-1] if found else None

    def add_motor(self, joint: str) -> mujoco.MjsActuator:
        """Adds a motor at a joint; it has no limits, and does what is commanded."""
        motor = self._add_actuator(joint)
        # The MJCF's defaults are meant for its own: a limit of theirs has no range here.
        motor.ctrllimited = motor.forcelimited = motor.actlimited = (
            mujoco.mjtLimited.mjLIMITED_FALSE
        )
        motor.set_to_motor()
        return motor

    def _add_actuator(self, joint: str) -> mujoco.MjsActuator:
        at = mujoco.mjtTrn.mjTRN_JOINT
        return self.spec.add_actuator(name=f"{joint} (servo)", target=joint, trntype=at)

    def add_position_servo(
        self,
        joint: str,
        kp: float,
        kd: float,
        limits: tuple[Number, Number] | None = None,
    ) -> None:
        """Makes a joint's motor a position servo; where it has none, one is added."""
        motor = self.motor_at(joint) or self._add_actuator(joint)
        gear = float(motor.gear[0]) or 1.0
        motor.set_to_position(kp=float(kp) / gear**2, kv=float(kd) / gear**2, inheritrange=0.0)
        motor.ctrllimited = motor.actlimited = mujoco.mjtLimited.mjLIMITED_FALSE
        motor.actrange, motor.delay, motor.nsample = (0.0, 0.0), 0.0, 0
        if limits is not None:
            motor.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
            motor.forcerange = sorted(float(limit) / gear for limit in limits)

    def limit_effort(self, joint: str, effort: float) -> None:
        """Gives a joint's motors one limit either way, together, in place of all that is stated."""
        unlimited, limited = mujoco.mjtLimited.mjLIMITED_FALSE, mujoco.mjtLimited.mjLIMITED_TRUE
        self.spec.joint(joint).actfrclimited = unlimited
        at = mujoco.mjtTrn.mjTRN_JOINT
        motors = [m for m in self.spec.actuators if m.trntype == at and m.target == joint]
        for motor in motors:
            most = effort / len(motors) / abs(float(motor.gear[0]) or 1.0)
            motor.forcelimited, motor.forcerange = limited, (-most, most)
            if motor.biastype == mujoco.mjtBias.mjBIAS_NONE:  # its command is a force
                motor.ctrllimited = unlimited

    def exclude_contact(self, one: str, two: str) -> None:
        """Lets two bodies not touch each other."""
        self.spec.add_exclude(bodyname1=one, bodyname2=two)

    def add_ball(
        self,
        name: str,
        body: str,
        radius: float,
        place: ArrayLike,
        like: str | None = None,
    ) -> mujoco.MjsGeom:
        """Adds a sphere that weighs nothing; it touches, and is shown, as another geom."""
        known = None if like is None else self.spec.geom(like)
        ball = self.spec.body(body).add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=(radius, 0.0, 0.0),
            pos=place,
            mass=0.0,
        )
        for word in () if known is None else ("rgba", *CONTACT_OF_GEOM):
            setattr(ball, word, getattr(known, word))
        return ball

    def turn_off_contact(self, geoms: Sequence[str]) -> None:
        """Lets geoms touch nothing."""
        for geom in self.spec.geoms:
            if geom.name in geoms:
                geom.contype = geom.conaffinity = 0

    def set_home(self, qpos: ArrayLike, ctrl: Sequence[float] = ()) -> None:
        """Makes a pose the only keyframe."""
        for key in list(self.spec.keys):
            self.spec.delete(key)
        self.spec.add_key(name=HOME_KEYFRAME, qpos=qpos, **({"ctrl": ctrl} if len(ctrl) else {}))


# A base that is free in the world by slides and hinges, or slides and a ball: one free joint.


_SPAN: Final = 0.1
"""Least singular value of three axes that span space: those of coordinates have 1, 1 and 1."""

_SLIDES: Final = [JointKind.SLIDE] * 3
_IN_PARTS: Final = ([*_SLIDES, JointKind.BALL], [*_SLIDES, *[JointKind.HINGE] * 3])


def join_free_base(spec: mujoco.MjSpec, *, stated: Collection[str] = ()) -> Diagnostic | None:
    """Gives a base that is free in parts a free joint instead, in place; keyframes go.

    Models after OpenSim, and some exporters, free a base by three slides and three hinges (or a
    ball). All programs here know one free base; which joints make it is a convention.

    Args:
        spec: The MJCF.
        stated: Joints that the URDF has, too: if these are among them, they stay.

    Returns:
        What was done; None if there is no such base.
    """
    base = _free_in_parts(spec, stated)
    if base is None:
        return None
    for key in list(spec.keys):
        spec.delete(key)
    for joint in list(base.joints):
        delete_joint(spec, joint)
    base.add_freejoint()
    return diagnose("base-joints-joined", subject=("body", base.name))


def delete_joint(spec: mujoco.MjSpec, joint: mujoco.MjsJoint) -> None:
    """Deletes a joint with all that refers to it."""
    name = joint.name
    for actuator in list(spec.actuators):
        if actuator.target == name:
            _delete_sensors(spec, actuator.name)
            spec.delete(actuator)
    for equality in list(spec.equalities):
        # A connect or weld names bodies, which may be called like joints.
        joints = equality.type == mujoco.mjtEq.mjEQ_JOINT
        if joints and name in (equality.name1, equality.name2):
            spec.delete(equality)
    _delete_sensors(spec, name)
    spec.delete(joint)


def _delete_sensors(spec: mujoco.MjSpec, name: str) -> None:
    for sensor in list(spec.sensors):
        if name and name in (sensor.objname, sensor.refname):
            spec.delete(sensor)


def _free_in_parts(spec: mujoco.MjSpec, stated: Collection[str]) -> mujoco.MjsBody | None:
    """Returns the base of the largest robot if its joints leave it free, and nothing drives it."""
    joint_count = mujoco.mjtObj.mjOBJ_JOINT
    bodies = list(spec.worldbody.bodies)
    base = max(bodies, key=lambda body: len(body.find_all(joint_count)), default=None)
    if base is None:
        return None
    joints = list(base.joints)
    if [joint.type for joint in joints] not in _IN_PARTS:
        return None
    names = {joint.name for joint in joints}
    driven = {actuator.target for actuator in spec.actuators}
    if names & (driven | set(stated)) - {""} or any(np.any(j.stiffness) for j in joints):
        return None
    if len(base.find_all(joint_count)) == len(joints):  # a thing, and no robot
        return None
    axes = [
        [j.axis for j in joints if j.type == kind] for kind in (JointKind.SLIDE, JointKind.HINGE)
    ]
    if any(np.linalg.matrix_rank(rows, tol=_SPAN) < 3 for rows in axes if rows):
        return None
    return base
