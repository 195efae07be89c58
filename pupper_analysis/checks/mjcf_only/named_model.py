"""What asking a compiled MJCF for its elements takes: names, units, switches."""

from __future__ import annotations

import mujoco

from pupper_analysis.matching.reference import Reference
from pupper_analysis.models.joint_kinds import JointKind

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
