"""``Description``: URDF and MJCF of a robot, with contact points, frames and additions.

A description is the input from which a ``Robot`` is built. It contains the URDF as text, the MJCF
as MuJoCo spec, and the names of contact points in both files. It also lists the elements that the
preparation has added to the MJCF.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import mujoco

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.models.additions import Addition, Ball, apply_additions
from pupper_analysis.models.efforts import EffortLimit, EffortStatement
from pupper_analysis.models.spec_tree import SpecTree
from pupper_analysis.models.transmission import MadeServo
from pupper_analysis.models.urdf_tree import UrdfTree

ModelTree = UrdfTree | SpecTree
"""Tree of the links and joints of a URDF, or of the bodies and joints of an MJCF. Both classes have
common methods, so that one function can change either file."""


@dataclass(frozen=True, eq=False)
class Description:
    """URDF and MJCF of a robot, with names of feet and frames in both; input of a ``Robot``.

    Attributes:
        name: Name of the robot.
        urdf: Text of the URDF.
        urdf_source: File of the URDF.
        mjcf: Spec of the MJCF; must not be modified (use ``mjcf.copy()``). A pickled copy is parsed
            from XML with all digits.
        mjcf_source: File of the MJCF.
        contact_points: {contact point: (link in the URDF, site, body or geom in the MJCF)}. A
            spherical foot has a single contact point, with the name of the foot.
        frames: {frame: (name in the URDF, name in the MJCF)} of further frames in both files.
        feet: {foot: contact points} of the feet with several contact points.
        foot_geoms: {contact point: (geom in the MJCF, radius [m])}. The radius of a corner of a box
            is 0. A contact point without an entry is the centre of a collision sphere.
        nominal: {joint: position [rad, m]} of the nominal stand, the pose in which the robot stands
            by default; missing joints are at zero.
        made_frames: Names of the frames (links of ``urdf``, sites of ``mjcf``) that were added for
            contact points.
        added: Additions to ``mjcf`` for simulation, each with a reason.
        made_servos: Servos in ``mjcf`` that the file does not contain, except servos of
            ``passive_joints``.
        passive_joints: Joints that no motor drives: the torque limit is zero, and the MJCF has
            actuators at other joints only. Dependent joints of closed loops and couplings are not
            included.
        efforts: {joint: effort limit} in place of the limits in ``mjcf``: requested limits, and
            limits of motors that were replaced by servos.
        null_efforts: {joint: force or control range of the MJCF that permits no force}, because its
            ends are equal or inverted. MuJoCo drops such a range when it compiles. Or a gear of 0.
        mimics: {joint: (leader, multiplier, offset [rad, m])} of mimic couplings that matching
            removed from ``urdf``, with the joint names and zero positions of ``mjcf``.
        converted: ``"urdf"`` or ``"mjcf"`` if this model has no file and was generated from the
            other model; "" if both models have files.
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
    passive_joints: tuple[str, ...] = ()
    efforts: Mapping[str, EffortLimit] = field(default_factory=dict)
    null_efforts: Mapping[str, EffortStatement] = field(default_factory=dict)
    mimics: Mapping[str, tuple[str, float, float]] = field(default_factory=dict)
    converted: str = ""

    def with_additions(self, *additions: Addition) -> Description:
        """Return a copy whose MJCF has further additions, for example a floor or servos."""
        spec = self.mjcf.copy()
        apply_additions(additions, SpecTree(spec))
        return replace(self, mjcf=spec, added=(*self.added, *additions))

    def report_replaced_soles(self) -> tuple[Diagnostic, ...]:
        """Return a diagnostic with the number of spheres that replace soles in ``mjcf``.

        The preparation may replace the collision mesh of a foot by spheres at its sole. Empty if
        there are none.
        """
        balls = [addition for addition in self.added if isinstance(addition, Ball)]
        count = sum(ball.reason.code == "balls-for-soles" for ball in balls)
        return (diagnose("on-balls-for-soles", count=count),) if count else ()

    def trees(self) -> tuple[UrdfTree, SpecTree]:
        """Return copies of the URDF and the MJCF as trees of links, which the caller may modify.

        Returns:
            URDF; MJCF.
        """
        return UrdfTree.of(self.urdf), SpecTree(self.mjcf.copy())
