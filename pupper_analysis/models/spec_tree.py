"""``SpecTree``: bodies and joints of an MJCF, with queries, edits and additions for simulation.

``join_free_base`` replaces the slides and hinges that together make a base free by one free joint.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.arrays import inertia_entries
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.models.attributes import (
    BY_KIND,
    COUPLING_TIME_CONSTANT,
    FLOOR_NAME,
    HOME_KEYFRAME,
    IMU_SENSORS,
    AttributeValue,
    JointAttribute,
)
from pupper_analysis.models.mjcf import (
    GEOM_CONTACT_WORDS,
    JointKind,
    add_geom,
    add_plane,
    add_site,
    compile_spec,
)
from pupper_analysis.models.xml import make_unique_name

_OPTION_VALUES: Final[dict[tuple[str, AttributeValue], Any]] = {
    ("cone", "elliptic"): mujoco.mjtCone.mjCONE_ELLIPTIC,
    ("cone", "pyramidal"): mujoco.mjtCone.mjCONE_PYRAMIDAL,
    ("integrator", "implicitfast"): mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    ("jacobian", "dense"): mujoco.mjtJacobian.mjJAC_DENSE,
}
"""{(option, text in the XML): value in MuJoCo's editable model}."""

MIN_RANGE = 1e-9
"""Smallest half width [N m, N] of a force range that `write_joint_parameter` writes, and width
[rad, m] of a joint range that is written for equal limits. Reason: MuJoCo rejects an enabled range
with equal ends. Chosen, not tuned.
"""


def set_inertia(body: mujoco.MjsBody, inertia: pin.Inertia) -> None:
    """Replace mass, CoM and rotational inertia of a body in a spec.

    Args:
        body: Body of a spec; modified.
        inertia: Spatial inertia [kg, m, kg m^2], expressed in the frame of the body.
    """
    entries = inertia_entries(np.array(inertia.inertia))
    body.explicitinertial, body.mass = True, float(inertia.mass)
    body.ipos, body.iquat = np.array(inertia.lever), (1.0, 0.0, 0.0, 0.0)
    body.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    has_products = bool(entries[3:].any())
    body.inertia = np.zeros(3) if has_products else entries[:3]
    body.fullinertia = entries if has_products else np.full(6, np.nan)


def write_joint_parameter(joint: mujoco.MjsJoint, attribute: JointAttribute, value: float) -> None:
    """Write the value of a joint parameter, for example damping or effort, into an MJCF spec.

    An effort becomes a symmetric force range of the joint, at least ``MIN_RANGE`` to each side. If
    MuJoCo stores the parameter as a polynomial, all higher coefficients become zero.

    Args:
        joint: Joint without ``springdamper``; modified.
        attribute: Parameter that an MJCF can specify, except a position limit.
        value: Value in SI units.
    """
    if attribute.kind == "effort":
        value = max(value, MIN_RANGE)
        joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_TRUE
        joint.actfrcrange = (-value, value)
        return
    word = attribute.mjcf[0]
    # Some parameters are polynomials of speed or position; the value is the first coefficient.
    coefficients = np.zeros(np.size(getattr(joint, word)))
    coefficients[0] = value
    setattr(joint, word, coefficients if len(coefficients) > 1 else value)


@dataclass(frozen=True, eq=False)
class SpecTree:
    """Bodies and joints of an MJCF, with queries, edits, and additions for simulation.

    Most queries and edits have the names of the methods of `UrdfTree`, so that a change of both
    files is written once. Edits of mass and inertia change an existing ``<inertial>``, which MuJoCo
    ignores if the attribute ``inertiafromgeom`` of the compiler is true.

    Attributes:
        spec: MuJoCo's editable model.
    """

    spec: mujoco.MjSpec

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the bodies except the world, in the order of the file."""
        return tuple(body.name for body in self.spec.bodies[1:])

    def parent(self, link: str) -> str | None:
        """Return the name of the parent body of a body; None for a child of the world."""
        parent = self.spec.body(link).parent
        return None if parent.name == self.spec.worldbody.name else str(parent.name)

    def movers(self, link: str) -> tuple[str, ...]:
        """Return the names of the joints between a body and its parent, without free joints."""
        joints = self.spec.body(link).joints
        return tuple(joint.name for joint in joints if joint.type != JointKind.FREE)

    def moved_by(self, joint: str) -> str | None:
        """Return the name of the body that a joint moves; None if there is no such joint."""
        element = self.spec.joint(joint)
        return None if element is None else str(element.parent.name)

    def fixed_group(self, link: str) -> list[str]:
        """Return the names of a body, and of all descendants that are fixed to this body."""
        group = [link]
        for name in group:
            children = self.spec.body(name).bodies
            group += [child.name for child in children if not list(child.joints)]
        return group

    def subtree(self, link: str) -> Iterator[str]:
        """Yield the names of a body and of all its descendants, the body first."""
        body = self.spec.body(link)
        yield link
        for child in body.find_all(mujoco.mjtObj.mjOBJ_BODY):
            yield child.name

    def link_mass(self, link: str) -> float:
        """Return the mass of a body [kg], as specified or as computed from geoms by MuJoCo."""
        return float(self._compiled_model.body(link).mass[0])

    def read_inertia(self, link: str) -> pin.Inertia:
        """Return the spatial inertia of a body [kg, m, kg m^2] in the frame of the body."""
        body = self._compiled_model.body(link)
        rotation = pin.Quaternion(body.iquat[[1, 2, 3, 0]]).toRotationMatrix()
        tensor = rotation @ np.diag(body.inertia) @ rotation.T
        return pin.Inertia(float(body.mass[0]), np.array(body.ipos), tensor)

    @cached_property
    def _compiled_model(self) -> mujoco.MjModel:
        """Model of a copy of the spec, cached until `_clear_cache` is called."""
        return compile_spec(self.spec.copy(), Path(self.spec.modelname))

    def _clear_cache(self) -> None:
        """Discard the compiled model, after a change of the spec."""
        self.__dict__.pop("_compiled_model", None)

    def remove_subtree(self, link: str) -> None:
        """Delete a body, all descendants, and all elements that refer to the deleted bodies."""
        self.spec.delete(self.spec.body(link))
        self._clear_cache()

    def add_link(
        self, name: str, parent: str, joint: str, place: Array, inertia: pin.Inertia | None = None
    ) -> None:
        """Add a body that is fixed to another body, with parallel axes.

        Args:
            name: Name of the new body.
            parent: Parent body.
            joint: Ignored; a fixed body of an MJCF has no joint.
            place: Position of the new body in the parent frame, shape (3,) [m].
            inertia: Spatial inertia in the frame of the new body; None if not specified.
        """
        del joint
        body = self.spec.body(parent).add_body(name=name, pos=place)
        if inertia is not None:
            set_inertia(body, inertia)
        self._clear_cache()

    def scale_mass(self, link: str, factor: float) -> None:
        """Multiply mass and rotational inertia of a body by a factor, in place.

        If the body has no ``<inertial>``, density and mass of its geoms are scaled.
        """
        body = self.spec.body(link)
        self._clear_cache()
        if body.explicitinertial:
            body.mass = factor * body.mass
            self.scale_inertia(link, factor)
            return
        for geom in body.geoms:
            geom.density = factor * geom.density
            if not math.isnan(geom.mass):
                geom.mass = factor * geom.mass

    def scale_inertia(self, link: str, factor: float) -> None:
        """Multiply the rotational inertia of a body about its CoM by a factor, in place.

        Raises:
            ValueError: If the body has geoms, and no ``<inertial>``.
        """
        body = self.spec.body(link)
        if not body.explicitinertial and list(body.geoms):
            raise ValueError(f"the inertia of {link} follows from its geoms")
        self._clear_cache()
        body.inertia = factor * np.array(body.inertia)
        body.fullinertia = factor * np.array(body.fullinertia)

    def move_com(self, link: str, offset: Array) -> None:
        """Translate the CoM of a body, in place; the inertia about the CoM is unchanged.

        A body without ``<inertial>`` gets one, as MuJoCo computes the inertia from the geoms.

        Args:
            link: Name of the body.
            offset: Displacement, shape (3,) [m], expressed in the frame of the body.
        """
        body = self.spec.body(link)
        self._clear_cache()
        if not body.explicitinertial:
            self.spec.adopt_inertial(body)
        body.ipos = np.array(body.ipos) + offset

    def scale(self, joint: str, attribute: JointAttribute, factor: float) -> None:
        """Multiply a joint parameter by a factor, in place.

        For the effort, the force ranges of the joint and its actuators are scaled, and the control
        ranges of torque motors.
        """
        element = self.spec.joint(joint)
        if attribute == BY_KIND["effort"]:
            element.actfrcrange = np.array(element.actfrcrange) * factor
            for actuator in _list_actuators_at(self.spec, joint):
                actuator.forcerange = np.array(actuator.forcerange) * factor
                if actuator.biastype == mujoco.mjtBias.mjBIAS_NONE:  # the control is a force
                    actuator.ctrlrange = np.array(actuator.ctrlrange) * factor
            self._clear_cache()
            return
        if "springdamper" in attribute.mjcf and np.any(element.springdamper):
            self._expand_springdamper(element)
        word = attribute.mjcf[0]
        value = getattr(element, word)
        setattr(element, word, np.array(value) * factor if np.ndim(value) else value * factor)
        self._clear_cache()

    def _expand_springdamper(self, element: mujoco.MjsJoint) -> None:
        """Replace ``springdamper`` of a joint by the resulting stiffness and damping."""
        model = self._compiled_model
        joint = model.joint(element.name).id
        for kind in ("spring", "damping"):
            attribute = BY_KIND[kind]
            values = np.atleast_1d(np.array(getattr(element, attribute.mjcf[0]), dtype=float))
            values[0] = attribute.read_compiled_value(model, joint)
            setattr(element, attribute.mjcf[0], values if len(values) > 1 else values[0])
        element.springdamper = (0.0, 0.0)

    def set_options(self, values: Mapping[str, AttributeValue]) -> None:
        """Set attributes of the MJCF's ``<option>``.

        Args:
            values: {attribute: value}, for example ``{"cone": "elliptic"}``. For accepted texts,
                such as ``elliptic``, see `_OPTION_VALUES`.
        """
        for name, value in values.items():
            setattr(self.spec.option, name, _OPTION_VALUES.get((name, value), value))

    def add_floor(self, beneath: float | None = None) -> mujoco.MjsGeom:
        """Add a plane with MuJoCo's default contact parameters as floor (`add_plane`).

        The contact bits permit collisions with each geom whose ``contype`` is not 0. The friction
        of the plane is at most the friction of each geom. MuJoCo uses the larger coefficient of two
        geoms with equal priority, so the friction of a foot has an effect.

        Args:
            beneath: Height z [m] of a new body to which the plane is added; existing bodies keep
                their ids. If None, the plane is added to the world body.
        """
        bits, name = 1, make_unique_name(FLOOR_NAME, {geom.name for geom in self.spec.geoms})
        frictions = [geom.friction for geom in self.spec.geoms]
        for geom in self.spec.geoms:
            bits |= int(geom.contype)
        body = self.spec.worldbody
        floor = add_plane(
            body if beneath is None else body.add_body(pos=(0, 0, beneath)), name, bits
        )
        floor.friction = np.min([floor.friction, *frictions], axis=0)
        return floor

    def add_imu(self, body: str, site: str) -> None:
        """Add a gyro and an accelerometer at a site.

        Args:
            body: Body to whose origin a missing site is added.
            site: Name of the site.
        """
        if self.spec.site(site) is None:
            add_site(self.spec.body(body), name=site)
        for kind in IMU_SENSORS:
            sensor = getattr(mujoco.mjtSensor, f"mjSENS_{kind.upper()}")
            object_type = mujoco.mjtObj.mjOBJ_SITE
            self.spec.add_sensor(name=kind, type=sensor, objtype=object_type, objname=site)

    def add_coupling(
        self, follower: str, leader: str, multiplier: AttributeValue, offset: AttributeValue
    ) -> mujoco.MjsEquality:
        """Couple a joint to another joint: q_follower = offset + multiplier q_leader.

        Args:
            follower: Joint that is coupled.
            leader: Joint whose position the follower follows.
            multiplier: Factor of the leader's position.
            offset: Position of the follower with the leader at zero [rad, m].

        Returns:
            The new equality constraint, stiff as by `stiffen_couplings`.
        """
        # MuJoCo's polynomial uses coordinates relative to ``ref``.
        follower_ref, leader_ref = (
            _reference_position(self.spec.joint(name)) for name in (follower, leader)
        )
        constant = float(offset) - follower_ref + float(multiplier) * leader_ref
        equality = self.spec.add_equality(
            type=mujoco.mjtEq.mjEQ_JOINT, name1=follower, name2=leader
        )
        equality.data[:5] = (constant, float(multiplier), 0.0, 0.0, 0.0)
        equality.objtype = mujoco.mjtObj.mjOBJ_JOINT
        self._set_stiffness(equality)
        return equality

    def stiffen_couplings(self) -> None:
        """Make all joint couplings (equality constraints of type ``joint``) stiff, in place.

        The time constant is ``COUPLING_TIME_CONSTANT`` [s], but at least two time steps. Reason:
        MuJoCo's couplings are soft, whereas a mimic joint of a URDF follows exactly.
        """
        for equality in self.spec.equalities:
            if equality.type == mujoco.mjtEq.mjEQ_JOINT:
                self._set_stiffness(equality)

    def _set_stiffness(self, equality: mujoco.MjsEquality) -> None:
        """Set ``solref`` of an equality constraint to a stiff, critically damped spring."""
        equality.solref = (max(COUPLING_TIME_CONSTANT, 2 * float(self.spec.option.timestep)), 1.0)

    def motor_at(self, joint: str) -> mujoco.MjsActuator | None:
        """Return the last actuator with transmission ``joint`` at a joint, or None."""
        transmission = mujoco.mjtTrn.mjTRN_JOINT
        motors = [
            motor
            for motor in self.spec.actuators
            if motor.trntype == transmission and motor.target == joint
        ]
        return motors[-1] if motors else None

    def add_motor(self, joint: str) -> mujoco.MjsActuator:
        """Add a torque motor without limits at a joint, and return it."""
        motor = self._add_actuator(joint)
        # The defaults of the MJCF may enable a limit, which would have no range here.
        motor.ctrllimited = motor.forcelimited = motor.actlimited = (
            mujoco.mjtLimited.mjLIMITED_FALSE
        )
        motor.set_to_motor()
        return motor

    def _add_actuator(self, joint: str) -> mujoco.MjsActuator:
        """Add an actuator with transmission ``joint``; the caller sets the force law."""
        transmission = mujoco.mjtTrn.mjTRN_JOINT
        return self.spec.add_actuator(name=f"{joint} (servo)", target=joint, trntype=transmission)

    def add_position_servo(
        self,
        joint: str,
        kp: float,
        kd: float,
        limits: tuple[AttributeValue, AttributeValue] | None = None,
    ) -> None:
        """Convert the actuator at a joint (`motor_at`) to a position servo, or add a servo.

        Limits of the control and of the activation, and the delay, are removed. A gear of 0, which
        transmits no torque, becomes 1: `null_efforts` then limits the torque to 0.

        Args:
            joint: Joint.
            kp: Stiffness at the joint [N m/rad, N/m].
            kd: Damping at the joint [N m s/rad, N s/m].
            limits: Lower and upper bound of the torque or force at the joint [N m, N]. If None, the
                existing force range of the actuator stays.
        """
        motor = self.motor_at(joint) or self._add_actuator(joint)
        gear = motor.gear[0] = float(motor.gear[0]) or 1.0
        motor.set_to_position(kp=float(kp) / gear**2, kv=float(kd) / gear**2, inheritrange=0.0)
        motor.ctrllimited = motor.actlimited = mujoco.mjtLimited.mjLIMITED_FALSE
        motor.actrange, motor.delay, motor.nsample = (0.0, 0.0), 0.0, 0
        if limits is not None:
            motor.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
            motor.forcerange = sorted(float(limit) / gear for limit in limits)

    def limit_effort(self, joint: str, effort: float) -> None:
        """Replace the force limits of a joint by a symmetric limit of the sum of its actuators.

        Control ranges of torque motors at the joint are disabled. A joint without an actuator of
        its own, for example one that a tendon drives, gets the limit as ``actuatorfrcrange``.

        Args:
            joint: Joint.
            effort: Limit at the joint [N m, N].
        """
        unlimited, limited = mujoco.mjtLimited.mjLIMITED_FALSE, mujoco.mjtLimited.mjLIMITED_TRUE
        self.spec.joint(joint).actfrclimited = unlimited
        transmissions = mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT
        motors = [
            motor
            for motor in self.spec.actuators
            if motor.trntype in transmissions and motor.target == joint
        ]
        if not motors:
            self.spec.joint(joint).actfrclimited = limited
            self.spec.joint(joint).actfrcrange = (-effort, effort)
        for motor in motors:
            max_force = effort / len(motors) / abs(float(motor.gear[0]) or 1.0)
            motor.forcelimited, motor.forcerange = limited, (-max_force, max_force)
            if motor.biastype == mujoco.mjtBias.mjBIAS_NONE:  # the control is a force
                motor.ctrllimited = unlimited

    def exclude_contact(self, first: str, second: str) -> None:
        """Exclude contacts between two bodies of this MJCF, with the element ``<exclude>``."""
        self.spec.add_exclude(bodyname1=first, bodyname2=second)

    def add_ball(
        self,
        name: str,
        body: str,
        radius: float,
        place: ArrayLike,
        like: str | None = None,
    ) -> mujoco.MjsGeom:
        """Add a sphere of zero mass with contact parameters, group and colour of another geom.

        Args:
            name: Name of the sphere.
            body: Body of the sphere.
            radius: Radius [m].
            place: Centre, shape (3,) [m], in the frame of the body.
            like: Geom whose contact parameters, group and colour are copied; None for the defaults
                of the MJCF.
        """
        model_geom = None if like is None else self.spec.geom(like)
        ball = add_geom(
            self.spec.body(body),
            name=name,
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=(radius, 0.0, 0.0),
            pos=place,
            mass=0.0,
        )
        for word in () if model_geom is None else ("rgba", *GEOM_CONTACT_WORDS):
            setattr(ball, word, getattr(model_geom, word))
        return ball

    def turn_off_contact(self, geoms: Sequence[str]) -> None:
        """Disable the contacts of geoms by zero contact bits; pairs (``<pair>``) still collide."""
        for geom in self.spec.geoms:
            if geom.name in geoms:
                geom.contype = geom.conaffinity = 0

    def set_home(self, qpos: ArrayLike, ctrl: Sequence[float] = ()) -> None:
        """Replace all keyframes by a single keyframe ``home`` (`HOME_KEYFRAME`), the start pose.

        Args:
            qpos: Configuration in MuJoCo's order.
            ctrl: Controls of the actuators, MuJoCo's ``ctrl``; zero if empty.
        """
        for key in list(self.spec.keys):
            self.spec.delete(key)
        self.spec.add_key(name=HOME_KEYFRAME, qpos=qpos, **({"ctrl": ctrl} if len(ctrl) else {}))


# Replacement of the joints of a free base by one free joint.


_MIN_SINGULAR_VALUE: Final = 0.1
"""Lower bound of the smallest singular value of the matrix (3, 3) of the axes of three slides or
hinges, with which these joints count as a free base. For orthogonal unit axes the value is 1.
Chosen, not tuned.
"""

_THREE_SLIDES: Final = [JointKind.SLIDE] * 3
"""Types of three slides, by which MJCFs without a free joint let a base translate in all
directions."""

_FREE_BASE_JOINTS: Final = (
    [*_THREE_SLIDES, JointKind.BALL],
    [*_THREE_SLIDES, *[JointKind.HINGE] * 3],
)
"""Types of the joints that together move a base freely: three slides, then a ball or three hinges.
"""


def join_free_base(spec: mujoco.MjSpec, *, stated: Collection[str] = ()) -> Diagnostic | None:
    """Replace the joints of a free base by a single free joint, and delete all keyframes.

    The spec is changed in place. Models converted from OpenSim, and some exporters, use three
    slides and three hinges (or a ball), which other modules do not support.

    Args:
        spec: The MJCF.
        stated: Joints that the URDF contains, too. A base with such a joint is not changed.

    Returns:
        Diagnostic of the replacement; None if there is no such base.
    """
    base = find_free_base(spec, stated)
    if base is None:
        return None
    for key in list(spec.keys):
        spec.delete(key)
    for joint in list(base.joints):
        delete_joint(spec, joint)
    base.add_freejoint()
    return diagnose("base-joints-joined", subject=("body", base.name))


def _reference_position(joint: mujoco.MjsJoint) -> float:
    """Return ``ref`` of a hinge or slide joint [rad, m]; a spec can contain angles in degrees."""
    in_degrees = joint.type == JointKind.HINGE and joint.compiler.degree
    return math.radians(joint.ref) if in_degrees else float(joint.ref)


def delete_joint(spec: mujoco.MjSpec, joint: mujoco.MjsJoint) -> None:
    """Delete a joint of a spec, in place, with its actuators, joint equalities and sensors."""
    name = joint.name
    for actuator in _list_actuators_at(spec, name):
        _delete_sensors(spec, mujoco.mjtObj.mjOBJ_ACTUATOR, actuator.name)
        spec.delete(actuator)
    for equality in list(spec.equalities):
        # Connect and weld refer to bodies, which may have the names of joints.
        couples_joints = equality.type == mujoco.mjtEq.mjEQ_JOINT
        # The second name of an equality with a single joint is empty, as is the name of a joint.
        if couples_joints and name and name in (equality.name1, equality.name2):
            spec.delete(equality)
    _delete_sensors(spec, mujoco.mjtObj.mjOBJ_JOINT, name)
    spec.delete(joint)


def _list_actuators_at(spec: mujoco.MjSpec, joint: str) -> list[mujoco.MjsActuator]:
    """Return the actuators that act on a joint, directly or with axes of the parent frame."""
    kinds = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
    return [
        actuator
        for actuator in spec.actuators
        if actuator.trntype in kinds and actuator.target == joint
    ]


def _delete_sensors(spec: mujoco.MjSpec, kind: mujoco.mjtObj, name: str) -> None:
    """Delete the sensors that refer to an element by type and name; an empty name deletes none."""
    for sensor in list(spec.sensors):
        references = ((sensor.objtype, sensor.objname), (sensor.reftype, sensor.refname))
        if name and (kind, name) in references:
            spec.delete(sensor)


def find_free_base(spec: mujoco.MjSpec, stated: Collection[str]) -> mujoco.MjsBody | None:
    """Return the base that three slides, and three hinges or a ball, move freely; else None.

    The base is the body in the world whose subtree has the most joints. It is not returned if its
    joints are driven or sprung, or contained in ``stated``, or if its subtree has no other joint.

    Args:
        spec: The MJCF.
        stated: Joints that the other model contains.
    """
    joint_type = mujoco.mjtObj.mjOBJ_JOINT
    bodies = list(spec.worldbody.bodies)
    base = max(bodies, key=lambda body: len(body.find_all(joint_type)), default=None)
    if base is None:
        return None
    joints = list(base.joints)
    if [joint.type for joint in joints] not in _FREE_BASE_JOINTS:
        return None
    names = {joint.name for joint in joints}
    driven = {actuator.target for actuator in spec.actuators}
    if names & (driven | set(stated)) - {""} or any(np.any(j.stiffness) for j in joints):
        return None
    if len(base.find_all(joint_type)) == len(joints):  # an object without joints, no robot
        return None
    axes = [
        [j.axis for j in joints if j.type == kind] for kind in (JointKind.SLIDE, JointKind.HINGE)
    ]
    if any(np.linalg.matrix_rank(rows, tol=_MIN_SINGULAR_VALUE) < 3 for rows in axes if rows):
        return None
    return base
