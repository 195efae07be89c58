"""An element of an MJCF that a URDF cannot state, and how to switch it off."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from dataclasses import dataclass, field

import mujoco
import numpy as np

from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.models.joint_kinds import JointKind
from pupper_analysis.robot.matching.trees import Reference

Slot = tuple[str, int | slice]
"""An array of ``mjModel`` (or a number of its ``opt``), and which of its rows."""


@dataclass(frozen=True, eq=False)
class MjcfOnlyEffect:
    """An element of an MJCF that a URDF cannot state.

    Attributes:
        kind: ``spring``, ``damping polynomial``, ``gravity compensation``, ``dry friction`` (of the
            free joint), ``tendon``, ``fluid``, ``actuator``, ``equality``, ``flex``, ``plugin`` or
            ``flag``.
        element: The joint, body, tendon ... by name; ``#3`` where it has none.
        value: Its numbers.
        unit: Of the numbers, where they have one in common.
        diagnostic: What it is, with its numbers.
        slots: What has to be zero for it to be gone; none if it does not act on the unconstrained
            robot, or cannot be taken away.
    """

    kind: str
    element: str
    value: object
    unit: str
    diagnostic: Diagnostic
    slots: tuple[Slot, ...] = field(default=())

    def switch(self, model: mujoco.MjModel, like: mujoco.MjModel | None) -> None:
        """Takes it away in a model (of `as_it_is`), in place; or takes another's numbers again."""
        for name, where in self.slots:
            if name.startswith("opt."):
                option = name.removeprefix("opt.")
                setattr(model.opt, option, 0.0 if like is None else getattr(like.opt, option))
            else:
                getattr(model, name)[where] = 0 if like is None else getattr(like, name)[where]


def as_it_is(model: mujoco.MjModel) -> mujoco.MjModel:
    """Returns a copy whose ``mj_forward`` gives the accelerations that the motors do not make.

    All that acts is left as it is; but no contact, joint or tendon limit, or dry friction acts, and
    the motors' control does not (their inertia and damping, the gravity compensation that goes
    through them, and what a DC motor does without a command, do). The integrator is set to Euler,
    for ``discrete`` would give accelerations that depend on the timestep.
    """
    result = copy.copy(model)
    for bit in (DISABLE.mjDSBL_CONTACT, DISABLE.mjDSBL_LIMIT, DISABLE.mjDSBL_FRICTIONLOSS):
        result.opt.disableflags |= bit.value
    result.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER.value
    # MuJoCo takes a com within 1e-6 m of its body's frame for the frame itself; not here.
    result.body_sameframe[:] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE.value
    # By groups: mjDSBL_ACTUATION would take away the gravity compensation of actuatorgravcomp, too.
    passive = [acts_without_command(model, motor) for motor in range(model.nactuator)]
    result.actuator_group[:] = np.where(passive, 1, 0)
    result.opt.disableactuator = 1
    return result


def acts_without_command(model: mujoco.MjModel, motor: int) -> bool:
    """Says whether a motor is a DC motor without a controller: its back-EMF brakes all the same."""
    dc = model.actuator_gaintype[motor] == mujoco.mjtGain.mjGAIN_DCMOTOR.value
    # Its inputs are a sum of 1 and 2 (setpoints of a controller), 4, 8 and 16 (none).
    controlled = bool(model.actuator_ctrlspec[motor] & 3)
    group = int(model.actuator_group[motor])
    switched_off = 0 <= group < 31 and bool(model.opt.disableactuator >> group & 1)
    return bool(dc) and not controlled and not switched_off


def without_effects(model: mujoco.MjModel, effects: Iterable[MjcfOnlyEffect]) -> mujoco.MjModel:
    """Returns ``as_it_is(model)`` with some effects taken away."""
    result = as_it_is(model)
    for effect in effects:
        effect.switch(result, None)
    return result


DISABLE = mujoco.mjtDisableBit


class NamedModel:
    """One reference, and what asking it takes: its names, units and switches."""

    def __init__(self, reference: Reference) -> None:
        self.reference, self.model, self.names = reference, reference.model, reference.names
        self.bodies = reference.bodies()

    def off(self, bit: mujoco.mjtDisableBit) -> bool:
        """Says whether the file switches a term of the dynamics off."""
        return bool(self.model.opt.disableflags & bit.value)

    def name(self, kind: str, index: int) -> str:
        """An element's name, or its number: ``#3``."""
        what = getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}").value
        return mujoco.mj_id2name(self.names, what, index) or f"#{index}"

    def joint_name(self, joint: int) -> str:
        """A joint's name; the base's for its free joint."""
        if self.model.jnt_type[joint] == JointKind.FREE:
            return self.reference.base
        return self.name("joint", joint)

    def unit(self, joint: int) -> tuple[str, str]:
        """The units of a joint's force and coordinate."""
        slides = self.model.jnt_type[joint] == JointKind.SLIDE
        return ("N", "m") if slides else ("N m", "rad")
