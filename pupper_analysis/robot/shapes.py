"""The shapes with which a robot touches, as MuJoCo has them, in the frames of its links.

What MuJoCo's collisions know of a robot is in its compiled model: primitives, and of each mesh the
convex hull. Those are its shapes here, so that what is judged before a simulation is what the
simulation finds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Term, diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.shapes import CONVEX, Pose, Shape, read_shape
from pupper_analysis.robot import contact
from pupper_analysis.robot.coordinates import MujocoConvention
from pupper_analysis.robot.structure import Structure

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CarriedShape:
    """A geom that touches things, and the link that carries it.

    Attributes:
        geom: Its id in ``mj_model``.
        body: The body that it belongs to (its id).
        link: The URDF's link that moves with it.
        joint: The joint that moves it; empty for the base.
        form: The shape, in the link's frame.
        on_ground: Whether MuJoCo lets it touch the ground.
    """

    geom: int
    body: int
    link: str
    joint: str
    form: Shape
    on_ground: bool


def shapes_of(
    model: mujoco.MjModel,
    convention: MujocoConvention,
    structure: Structure,
    bases: tuple[str, str],
    neutral: Array,
    source: Path,
) -> tuple[CarriedShape, ...]:
    """Returns the shapes of a robot's moving bodies that touch anything, in MuJoCo's order.

    Feet included. Where a body is in its link's frame is found at zero angles, at which both models
    are one robot.

    Args:
        model: MuJoCo's model of the MJCF.
        convention: Its maps.
        structure: Of the URDF's model.
        bases: The base's link and its body.
        neutral: (nq,) with every joint at zero.
        source: The MJCF's file.

    Raises:
        ModelError: If one is a signed distance field, whose distances nothing here can tell.
    """
    data = mujoco.MjData(model)
    convention.set_state(data, neutral)
    mujoco.mj_kinematics(model, data)
    ground = contact.ground_geom(model)
    carriers = _Carriers(model, structure, bases, neutral)
    paired = {int(geom) for pair in (model.pair_geom1, model.pair_geom2) for geom in pair}
    found = []
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        touches = model.geom_contype[geom] or model.geom_conaffinity[geom] or geom in paired
        moving = int(model.body_weldid[body])
        if not touches or moving not in carriers.joints:
            continue
        form = read_shape(model, geom, data)
        if form.kind not in CONVEX:
            problem = diagnose(
                "geom-without-distances",
                geom=form.name,
                body=model.body(body).name,
                kind=Term(form.kind),
            )
            raise ModelError(source, problem)
        link, place = carriers.link(model.body(body).name, moving)
        found.append(
            CarriedShape(
                geom=geom,
                body=body,
                link=link,
                joint=carriers.joints[moving],
                form=replace(form, pose=Pose.of(place.actInv(form.pose.placed))),
                on_ground=ground is not None and may_touch(model, geom, ground),
            )
        )
    return tuple(found)


class _Carriers:
    """Which links carry what of a robot at zero angles, the base's and those that it carries.

    Attributes:
        joints: {moving body: the joint that moves it}; the base's is "".
    """

    def __init__(
        self, model: mujoco.MjModel, own: Structure, bases: tuple[str, str], neutral: Array
    ) -> None:
        base, mj_base = bases
        self._links, self._frames = own.links, own.model.frames
        self._data = own.model.createData()
        pin.framesForwardKinematics(own.model, self._data, own.convention.unit_q(neutral))
        moving = {int(model.jnt_bodyid[model.joint(name).id]): name for name in own.joints}
        self.joints = {int(model.body(mj_base).id): ""} | moving
        self._first = {"": base}
        names = {number: name for name, number in own.joints.items()}
        for name, number in sorted(own.links.items(), key=lambda link: link[1]):
            joint = names.get(int(self._frames[number].parentJoint))
            if joint is not None:
                self._first.setdefault(joint, name)

    def link(self, body: str, moving: int) -> tuple[str, pin.SE3]:
        """Returns the link that carries a body, and where it is.

        It is the link of the body's name, if that moves with it, or else what the joint moves.

        Args:
            body: The body's name.
            moving: The moving body (its id) to which it belongs.
        """
        first = self._first[self.joints[moving]]
        joint = self._frames[self._links[first]].parentJoint
        own = body in self._links and self._frames[self._links[body]].parentJoint == joint
        link = body if own else first
        return link, self._data.oMf[self._links[link]]


def may_touch(model: mujoco.MjModel, geom: int, ground: int | None) -> bool:
    """Tells whether MuJoCo looks for contacts of a geom and a ground, by bits or in a pair.

    A ground that the model lacks (None) has MuJoCo's own bits, as scenes have it.
    """
    if ground is None:
        return bool((model.geom_contype[geom] | model.geom_conaffinity[geom]) & 1)
    for one, two in zip(model.pair_geom1.tolist(), model.pair_geom2.tolist(), strict=True):
        if {one, two} == {geom, ground}:
            return True
    bits, floor = model.geom_contype, model.geom_conaffinity
    met = (bits[geom] & floor[ground]) or (bits[ground] & floor[geom])
    bodies = frozenset(model.geom_bodyid[[geom, ground]].tolist())
    return bool(met) and bodies not in excluded_pairs(model)


def excluded_pairs(model: mujoco.MjModel) -> set[frozenset[int]]:
    """Returns the pairs of bodies (ids) that the MJCF excludes from touching each other."""
    return {
        frozenset((int(signature) >> 16, int(signature) & 0xFFFF))
        for signature in model.exclude_signature
    }
