"""An MJCF's bodies and joints: what is fixed to what, what moves, and edits of that structure."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.models.attributes import BY_KIND, JointAttribute
from pupper_analysis.models.free_base import delete_joint
from pupper_analysis.models.joint_kinds import JointKind

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SpecTree:
    """The bodies and joints of an MJCF: a `ModelTree`.

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
        """Takes a body out, with all that it carries and what refers to its joints."""
        for name in list(self.subtree(link)):
            for joint in list(self.spec.body(name).joints):
                delete_joint(self.spec, joint)
        self.spec.delete(self.spec.body(link))
        self._forget()

    def add_link(
        self, name: str, parent: str, joint: str, place: Array, inertia: pin.Inertia | None = None
    ) -> None:
        """Adds a body that is fixed to another; an MJCF has no joint for that."""
        del joint
        body = self.spec.body(parent).add_body(name=name, pos=place)
        if inertia is not None:
            body.explicitinertial = True
            body.mass, body.ipos = float(inertia.mass), np.array(inertia.lever)
            tensor = np.array(inertia.inertia)
            off = tensor[[0, 0, 1], [1, 2, 2]]
            if off.any():
                body.fullinertia = [*np.diag(tensor), *off]
            else:
                body.inertia = np.diag(tensor)
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
            made = self._compiled.body(link)
            body.mass, body.ipos = float(made.mass[0]), np.array(made.ipos)
            body.iquat, body.inertia = np.array(made.iquat), np.array(made.inertia)
            body.explicitinertial = True
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
        for word in attribute.mjcf:
            value = getattr(element, word)
            setattr(element, word, np.array(value) * factor if np.ndim(value) else value * factor)
