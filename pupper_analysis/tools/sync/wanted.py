"""Given numbers of a robot, by what moves, and what both of its models become with them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ModelError, UnknownNameError
from pupper_analysis.models.attributes import BY_KIND
from pupper_analysis.models.conversion import joint_armature, joint_damping
from pupper_analysis.models.multibody import MultibodyTree, TreeBody
from pupper_analysis.robot.matching.match import Match
from pupper_analysis.robot.matching.trees import kinematic_trees
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.sync.frames import Key, MatchedRobots

Array = NDArray[np.float64]

OF_BODIES = ("mass", "com", "inertia")
OF_JOINTS = ("damping", "friction", "armature")
OF_SERVOS = ("kp", "kd")

_OWN = 1e-6
"""Relative: a robot's number is that of its file. What an engine makes of a file, converted or
aligned, is good to some 1e-9; what was changed since differs by more than anybody writes digits."""


def refuse_numbers(robot: Robot, left: Mapping[Key, Diagnostic]) -> ModelError:
    """Returns the error that names the numbers that cannot be written, each with its reason."""
    problems = [diagnose("number-unwritten", what=" ".join(k), why=why) for k, why in left.items()]
    return ModelError(robot.name, diagnose("numbers-unwritten", problems=problems))


def resolve_numbers(matched: Match, numbers: Mapping[Key, ArrayLike]) -> dict[Key, Array]:
    """Returns the numbers by the names of base and joints that move what they are of.

    Raises:
        UnknownNameError: If an element is not there.
    """
    movers: dict[str, str] = {}
    for names in (matched.mjcf_body, matched.urdf_link):
        movers |= {name: mover for mover, name in names.items()}
    movers |= {mover: mover for mover in matched.urdf_link}
    model, found = matched.robot.pin_model, {}
    for (kind, element), value in numbers.items():
        mover = movers.get(element)
        if kind not in OF_BODIES:
            mover = element if element in matched.robot.joint_names else None
        elif mover is None and model.existFrame(element, pin.FrameType.BODY):
            at = model.frames[model.getFrameId(element, pin.FrameType.BODY)].parentJoint
            name = str(model.names[at])
            mover = name if name in matched.robot.joint_names else matched.robot.base
        if mover is None:
            known = movers if kind in OF_BODIES else matched.robot.joint_names
            what = "link" if kind in OF_BODIES else "joint"
            raise UnknownNameError(matched.robot.name, what, element, known)
        found[kind, mover] = np.array(value, dtype=float)
    return found


def check_own(robot: Robot, changes: NumberChanges) -> None:
    """Checks that a robot's bodies are those that its files state, in the same frames.

    All of them: where one is not, the files are another robot's, whatever is written.

    Raises:
        ModelError: If one is not: it was changed since, or derived.
    """
    both = changes.both
    own, base = kinematic_trees(robot)[0], both.matched.robot.base
    for mover in both.matched.urdf_link:
        stated = both.urdf.bodies[mover]
        body = own.bodies.get(own.base if mover == base else mover, stated)
        size = max(float(np.abs(stated.inertia).max()), 1e-300)
        if mover == base and not robot.floating:  # in the world's frame
            body = replace(body, com=stated.com, inertia=stated.inertia)
        if (
            abs(body.mass - stated.mass) > _OWN * stated.mass
            or float(np.abs(body.com - stated.com).max()) > _OWN
            or float(np.abs(body.inertia - stated.inertia).max()) > 1e3 * _OWN * size
        ):
            told = diagnose(
                "robot-is-not-its-files",
                subject=("link", both.matched.urdf_link.get(mover, mover)),
                file=both.matched.robot.description.urdf_source.name,
                mass=Quantity(body.mass, "kg"),
                stated=Quantity(stated.mass, "kg"),
            )
            raise ModelError(robot.name, told)


class NumberChanges:
    """What both robots shall be.

    Args:
        both: The robots, in the URDF's link frames.
        wanted: {(kind, base or joint): value}.
    """

    def __init__(self, both: MatchedRobots, wanted: Mapping[Key, Array]) -> None:
        self.both, self.wanted = both, wanted
        model = both.matched.robot.mj_model
        joints = both.matched.robot.joint_names
        dofs = [int(model.jnt_dofadr[model.joint(name).id]) for name in joints]
        self.movers = tuple(dict.fromkeys(name for kind, name in wanted if kind in OF_BODIES))
        more = {
            "damping": joint_damping(model) - model.dof_damping,
            "armature": joint_armature(model) - model.dof_armature,
        }
        self._of_motors = {
            kind: dict(zip(joints, values[dofs].tolist(), strict=True))
            for kind, values in more.items()
        }

    def tree(self, side: str) -> MultibodyTree:
        """Returns what a robot shall be, of ``"urdf"`` or ``"mjcf"``."""
        tree = self.both.urdf if side == "urdf" else self.both.mjcf
        bodies, joints = dict(tree.bodies), dict(tree.joints)
        for mover in self.movers:
            bodies[mover] = self._body(bodies[mover], mover)
        for (kind, name), value in self.wanted.items():
            if kind in OF_JOINTS:
                whole = float(value) + float(self._of_motors.get(kind, {}).get(name, 0.0))
                changed: dict[str, Any] = {BY_KIND[kind].field: whole}
                joints[name] = replace(joints[name], **changed)
        return replace(tree, bodies=bodies, joints=joints)

    def _body(self, body: TreeBody, mover: str) -> TreeBody:
        mass = float(self.wanted.get(("mass", mover), np.array(body.mass)))
        com = self.wanted.get(("com", mover), body.com)
        pattern = body.inertia * (mass / body.mass if body.mass > 0 else 1.0)
        return replace(
            body, mass=mass, com=com, inertia=self.wanted.get(("inertia", mover), pattern)
        )

    def step(self, side: str, mover: str) -> Array:
        """Returns by what a body changes in its file's frame, as its ten dynamic parameters."""
        frames = self.both.urdf_frames if side == "urdf" else self.both.mjcf_frames
        before = self.both.urdf if side == "urdf" else self.both.mjcf
        frame = frames[mover]
        one, two = (
            frame.actInv(tree.bodies[mover].rigid).toDynamicParameters()
            for tree in (before, self.tree(side))
        )
        return np.array(two - one)
