"""The two model files of a robot, as text and spec."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import mujoco

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.models.additions import Addition, Ball, put_all
from pupper_analysis.models.efforts import EffortLimit
from pupper_analysis.models.spec_tree import SpecTree
from pupper_analysis.models.transmission import MadeServo
from pupper_analysis.models.urdf_tree import UrdfTree

ModelTree = UrdfTree | SpecTree
"""The links and joints of a URDF, or the bodies and joints of an MJCF: who changes both files of a
robot writes the change once, and does it to each tree in turn."""


@dataclass(frozen=True, eq=False)
class Description:
    """A robot's URDF and MJCF.

    Attributes:
        name: The robot's name.
        urdf: The URDF's text.
        urdf_source: The file it came from.
        mjcf: The MJCF's spec, not to be changed (take ``mjcf.copy()``). In copies it is read
            again from what MuJoCo writes of it, all digits kept.
        mjcf_source: The file it came from.
        contact_points: For each contact point, the URDF's link and the MJCF's site, body or geom. A
            foot that is a sphere has one, of its own name.
        frames: Likewise for further frames that both files have.
        feet: {foot with more than one contact point: their names}.
        foot_geoms: {contact point: the MJCF's geom that touches there, and its radius (m)}, where
            that is no sphere around the point: 0 for the corner of a box.
        nominal: {joint: position (rad)} at which the feet are where they stand by default; zero
            where not given.
        made_frames: The frames of contact points that neither file has.
        added: What ``mjcf`` has for a simulation that the file does not, each with its reason; a
            file that is written is given the same.
        made_servos: The servos in ``mjcf`` that the file does not have.
        efforts: {joint: what its motor can give}, of motors that were replaced by servos: what
            their own attributes stated is not in ``mjcf`` any more.
        converted: ``"urdf"`` or ``"mjcf"``: the model that was made of the other one in memory, as
            it has no file; empty if both have one.
    """

    name: str
    urdf: str = field(repr=False)
    urdf_source: Path
    mjcf: mujoco.MjSpec
    mjcf_source: Path
    contact_points: Mapping[str, tuple[str, str]]
    frames: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    feet: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    foot_geoms: Mapping[str, tuple[str, float]] = field(default_factory=dict)
    nominal: Mapping[str, float] = field(default_factory=dict)
    made_frames: frozenset[str] = frozenset()
    added: tuple[Addition, ...] = ()
    made_servos: tuple[MadeServo, ...] = ()
    efforts: Mapping[str, EffortLimit] = field(default_factory=dict)
    converted: str = ""

    def given(self, *added: Addition) -> Description:
        """Returns a description whose MJCF is given something for its simulation."""
        spec = self.mjcf.copy()
        put_all(added, SpecTree(spec))
        return replace(self, mjcf=spec, added=(*self.added, *added))

    def replaced_soles(self) -> tuple[Diagnostic, ...]:
        """Tells on how many balls it stands in the place of its soles, if it does."""
        balls = [one for one in self.added if isinstance(one, Ball)]
        count = sum(ball.reason.code == "balls-for-soles" for ball in balls)
        return (diagnose("on-balls-for-soles", count=count),) if count else ()

    def trees(self) -> tuple[UrdfTree, SpecTree]:
        """Returns both files' links and joints, to be changed: they are its own no more."""
        return UrdfTree.of(self.urdf), SpecTree(self.mjcf.copy())
