"""Results about the robot as published: own simulation, servos, and causes of deviations.

A prepared robot differs from the published file. For a verdict, the published file is therefore
simulated, too. An `OwnRun` starts from a keyframe of the file. A `PublishedRun` starts from a
computed equilibrium, and is compared with this equilibrium. The module contains these results, and
the limits above which a run counts as failed or deviating. `ServosUsed` describes the servos of a
result.

Other modules compute, evaluate and format these results.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum

from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.base.units import DAMPING_UNIT, HINGE_UNITS, POSITION_UNIT, STIFFNESS_UNIT
from pupper_analysis.models.transmission import Drive, MadeServo
from pupper_analysis.robot.fall import BodyMotion


class ServoSource(StrEnum):
    """Origin of servo gains: from the MJCF, added by this package, or given by the caller."""

    FILE = "the MJCF's"
    ADDED = "added"
    GIVEN = "given"


@dataclass(frozen=True)
class ServosUsed:
    """Origin and gains of the servos that a result depends on.

    Attributes:
        source: Origin of the gains. ``FILE``: the MJCF. ``ADDED``: this package added servos at
            joints for which the MJCF has no servo or an invalid servo. ``GIVEN``: passed by the
            caller.
        kp: Minimum and maximum stiffness (N m/rad or N/m) of the added servos if ``source`` is
            ``ADDED``, otherwise of the servos in use.
        kd: Minimum and maximum damping (N m s/rad or N s/m) of these servos.
        made: Added servos whose stiffness is in use; empty if the caller passed ``kp``.
        stiffness_unit: Unit of ``kp``; both units if the servos are at hinges and slides.
        damping_unit: Unit of ``kd``; both units if the servos are at hinges and slides.
        hangs: Whether the base is fixed for this result only, so that the gains of added servos
            differ from those of a stand.
    """

    source: ServoSource
    kp: tuple[float, float] = field(metadata={"unit": STIFFNESS_UNIT})
    kd: tuple[float, float] = field(metadata={"unit": DAMPING_UNIT})
    made: tuple[MadeServo, ...] = ()
    stiffness_unit: str = HINGE_UNITS.stiffness
    damping_unit: str = HINGE_UNITS.damping
    hangs: bool = False

    def _field_units(self) -> dict[str, str]:
        """Return the units of the gains."""
        return {"kp": self.stiffness_unit, "kd": self.damping_unit}

    @property
    def replacement_servos(self) -> tuple[MadeServo, ...]:
        """Added servos that replace a servo of the MJCF with an invalid stiffness."""
        return tuple(servo for servo in self.made if servo.instead_of.has_invalid_stiffness)


MIN_UNHELD_DISPLACEMENT = 0.05
"""Displacement [rad, m] above which a joint counts as displaced, in a simulation of a published
file from its keyframe. Chosen, not tuned."""


MAX_TORQUE_DEVIATION = 0.05
"""Largest `PublishedRun.torque_error` [1] with which a simulation of the published MJCF agrees with
the computed equilibrium. The error of Solo 12 is 0.016, because this package replaces its mesh feet
by spheres."""

MAX_IMPORTED_TORQUE_DEVIATION = 0.1
"""Largest `PublishedRun.torque_error` [1] with which a simulation of a URDF agrees with the
computed equilibrium; replaces ``MAX_TORQUE_DEVIATION``. The equilibrium is computed with foot
spheres, but MuJoCo's import of a URDF keeps the collision meshes of the file. Their contacts are at
slightly different positions (error of Go2: 0.065)."""

MAX_PUBLISHED_DEVIATION = 0.02
"""Largest deviation of a joint position [rad, m] with which a simulation with feed-forward agrees
with the computed equilibrium (`PublishedRun.agrees_with_equilibrium`). Pupper v3 deviates by 5e-5.
Chosen, not tuned."""

MAX_POSTURE_DEVIATION = 0.5
"""Upper bound of the displacement [rad, m] of a joint, or of a lifted leg (norm over the joints).
With a larger displacement, the posture is lost. Chosen, not tuned."""


class OwnCommands(StrEnum):
    """Commands of the actuators in a simulation of a published file from its keyframe."""

    STATED = "the keyframe's ctrl"
    ABSENT = "the zeros of a keyframe without ctrl"
    ANGLES = "its joints' angles"


@dataclass(frozen=True)
class JointOff:
    """Displacement of a joint in a simulation, with its command.

    Attributes:
        joint: Name of the joint.
        off: Final minus initial position (rad, m).
        drive: Actuator type in the file.
        commanded: Commanded minus initial position (rad, m). None unless a single actuator with
            positive stiffness drives the joint.
        unit: Unit of ``off`` and ``commanded``: rad for a hinge, m for a slide.
    """

    joint: str
    off: float = field(metadata={"unit": POSITION_UNIT})
    drive: Drive
    commanded: float | None = field(default=None, metadata={"unit": POSITION_UNIT})
    unit: str = HINGE_UNITS.position

    @property
    def commanded_away(self) -> bool:
        """True if the servo's command explains the displacement of this joint in the simulation.

        The displacement exceeds 0.05 rad or m (``MIN_UNHELD_DISPLACEMENT``). The commanded
        displacement has the same direction, and is more than half as large.
        """
        if self.commanded is None or abs(self.off) <= MIN_UNHELD_DISPLACEMENT:
            return False
        return self.commanded * math.copysign(1.0, self.off) > abs(self.off) / 2


@dataclass(frozen=True)
class Cause:
    """Cause of a deviation from equilibrium: an element of the MJCF, or a change on loading.

    Attributes:
        code: Code of the cause; ``present.verdict.describe_cause`` has a text for each code.
        elements: Names of the elements.
        line: Line of the first element in the file; None if unknown.
        remaining: Torque error (`PublishedRun.torque_error`) that remains with all causes disabled.
            0 or None for a simulation from a keyframe; None if no cause was disabled.
        difference: First difference between the two files, if that is the cause.
    """

    code: str
    elements: tuple[str, ...]
    line: int | None = None
    remaining: float | None = field(default=None, metadata={"unit": "1"})
    difference: Diagnostic | None = None


PREPARATION_CODES = {"shapes-beside-feet", "balls", "other-drive"}
"""Codes (`Cause.code`) of changes that this package makes when it loads a robot. The published file
lacks these changes, so its simulation may deviate from the computed equilibrium:

- contacts of shapes other than feet are disabled
- mesh feet are replaced by spheres (``balls``)
- other actuators are replaced by servos (``other-drive``)

If the published robot does not collapse and all causes have these codes, the verdict reports the
deviation, which alone does not make the verdict FAILS."""


MAX_OWN_TILT = math.radians(10.0)
"""Largest accepted tilt of the base [rad] at the end of a simulation of the published file from its
keyframe (`BodyMotion.lean`). With a larger tilt, a standing robot is tilted (`OwnRun.is_tilted`).
Chosen, not tuned: a knee angle with a wrong sign gives 18 to 21 deg (Solo 12, Go1)."""

MAX_OWN_TRAVEL_RATIO = 0.5
"""Largest accepted horizontal travel of a robot, relative to its initial CoM height [1], in a
simulation of the published file from its keyframe. With a larger travel, the robot has left its
stance (`OwnRun.has_left_stance`). Chosen between measured values: public MJCFs that stand give at
most 0.04 (Spot with arm). Pupper v3 with 1.2 times its leg length leans on its soft servos, which
gives 0.36. A knee servo of ANYmal C with a gear of -1 gives 0.54."""


@dataclass(frozen=True)
class OwnRun(BodyMotion):
    """Simulation of a published file from its keyframe, with small nudges (`simulate_keyframe`).

    The tilt ``lean`` is the smaller of the tilts relative to the upright start pose and relative to
    reset. If the robot ends fallen, the tilt is relative to the upright start pose. Fallen: tilted
    by more than ``FALLEN_TILT`` (0.5 rad) and lying on its trunk, or tilted by more than 90 deg.

    Attributes:
        imported: Whether the model is MuJoCo's import of a URDF, completed by free base, floor,
            servos etc., but with its own shapes.
        timestep: Time step (s) of an import, if its shapes require a smaller time step than the
            robot's; otherwise None.
        keyframe: Name of the keyframe, such as "keyframe 1" if it has none. "" without a keyframe:
            the simulation starts at the start pose (`Robot.home`), or, for a fixed base, at a given
            posture.
        commands: Commands of the actuators.
        limp: Whether more than half of the joints have no actuator that can hold a position: for
            example a torque motor, or no actuator. Unless the simulation starts at a given posture,
            False without a keyframe, or if its ctrl contains joint angles instead of torques.
        worst: Joint with the largest displacement; None if the simulation diverged.
        unheld: Joint with the largest displacement among the joints that a servo should hold, but
            does not. None if no such displacement exceeds 0.05 rad or m
            (``MIN_UNHELD_DISPLACEMENT``), if at most half of the joints have a servo, or if the
            simulation diverged.
        held: If the keyframe has no ctrl, a second run in which the servos hold the joint
            positions. None otherwise, if most joints have no servo, or if an actuator has a
            built-in controller such as ``pid``.
        standing: Whether the base is free, so that the robot stands on the ground.
        causes: Causes of a failure, if found.
        missing: Missing files that the published MJCF requires, such as meshes.
        redirected: Joint with the largest displacement among the joints that the ctrl moves away
            from the initial position (`JointOff.commanded_away`); None if there is none.
        lifted_leg: Joint with the largest displacement in the legs that are on the ground at
            reset, but not at the end. None without such a leg, or if the displacements of its
            joints are small: norm (rad and m mixed) at most 0.5 (``MAX_POSTURE_DEVIATION``).
        stance_travel: Horizontal travel [m] of the CoM of the robot, or of the base body if this is
            smaller: the motion of an arm moves the CoM of a robot on planted feet.
    """

    imported: bool = False
    timestep: float | None = field(default=None, metadata={"unit": "s"})
    keyframe: str = ""
    commands: OwnCommands = OwnCommands.STATED
    limp: bool = False
    worst: JointOff | None = None
    unheld: JointOff | None = None
    held: OwnRun | None = None
    standing: bool = True
    causes: tuple[Cause, ...] = ()
    missing: tuple[str, ...] = ()
    redirected: JointOff | None = None
    lifted_leg: JointOff | None = None
    stance_travel: float = field(default=0.0, metadata={"unit": "m"})

    @property
    def has_left_posture(self) -> bool:
        """True if a joint of a robot with a fixed base has moved far, without command.

        The largest displacement exceeds 0.5 rad or m (``MAX_POSTURE_DEVIATION``), and the command
        does not explain this displacement.
        """
        worst = None if self.standing else self.worst
        return (
            worst is not None
            and abs(worst.off) > MAX_POSTURE_DEVIATION
            and not worst.commanded_away
        )

    @property
    def is_lifted(self) -> bool:
        """True if a robot on the ground ends upright, with its CoM far above the initial height.

        The increase exceeds ``MAX_HEIGHT_LOSS_RATIO`` (30 %) of the initial CoM height.
        """
        return self.standing and super().is_lifted

    @property
    def is_tilted(self) -> bool:
        """True if the base of a standing robot ends tilted by more than ``MAX_OWN_TILT`` (10 deg).

        False if the simulation diverged.
        """
        return self.standing and not self.diverged and self.lean > MAX_OWN_TILT

    @property
    def has_left_stance(self) -> bool:
        """True if a standing robot ends in another stance than the initial one; also after a fall.

        Either CoM and base have both travelled horizontally by more than half of the initial CoM
        height (``MAX_OWN_TRAVEL_RATIO``), or a leg has moved away from the ground (``lifted_leg``).
        False if the simulation diverged.
        """
        if not self.standing or self.diverged:
            return False
        travels = self.stance_travel > MAX_OWN_TRAVEL_RATIO * self.height
        return travels or self.lifted_leg is not None

    @property
    def falls(self) -> bool:
        """True if the robot collapses (``collapses``), or a joint does not stay in place."""
        return self.collapses or self.has_left_posture or self.unheld is not None

    @property
    def fails(self) -> bool:
        """True if the published file does not stand in this simulation.

        - If most joints cannot hold a position (``limp``): False.
        - With a keyframe: True if the robot ``falls``, ``is_tilted`` or ``has_left_stance``.
        - Without a keyframe: True if a joint is not held (``unheld``).
        """
        if self.limp:
            return False
        return not self.keeps_stance if self.keyframe else self.unheld is not None

    @property
    def keeps_stance(self) -> bool:
        """True if the robot neither ``falls``, nor ``is_tilted``, nor ``has_left_stance``."""
        return not (self.falls or self.is_tilted or self.has_left_stance)


@dataclass(frozen=True)
class PublishedRun:
    """Simulation of the published file from a computed equilibrium, compared with this state.

    Attributes:
        feedforward: Whether the commands include feed-forward; otherwise positions only.
        duration: Simulated time (s), without the time after large nudges. The first nudge is
            applied after the first second.
        torque_error: Largest torque deviation within the last second, divided by a scale [1]. The
            scale is the largest computed torque, or a fraction of the weight times 1 m if this
            product is larger. With a fixed base, the dry friction of the joint is subtracted from
            the deviation.
        height_error: Final minus computed height of the CoM (m); None if the base is fixed.
        joint_error: Largest joint deviation.
        collapses: Whether the robot has fallen over, has sunk or risen by 30 % of its height
            (``MAX_HEIGHT_LOSS_RATIO``), or has travelled by its height. Also True if the simulation
            diverged. For a fixed base, whether a joint has left the posture.
        differs: Whether the robot collapses, or deviates by more than a verified stand may.
        imported: Whether the model is MuJoCo's import of a URDF.
        worst_joint: Joint with the largest displacement if the robot collapses or has no actuators;
            otherwise the joint with the largest torque deviation.
        joint_error_unit: Unit of ``joint_error``: rad, or m for a slide.
    """

    feedforward: bool
    duration: float = field(metadata={"unit": "s"})
    torque_error: float = field(metadata={"unit": "1"})
    height_error: float | None = field(metadata={"unit": "m"})
    joint_error: float = field(metadata={"unit": POSITION_UNIT})
    collapses: bool
    differs: bool
    imported: bool = False
    worst_joint: str = ""
    joint_error_unit: str = HINGE_UNITS.position
    _keeps_moving: bool = False
    _is_lifted: bool = False

    @property
    def keeps_moving(self) -> bool:
        """True if motor torques still vary at the end of this run, as with chattering contacts."""
        return self._keeps_moving

    @property
    def is_lifted(self) -> bool:
        """True if the robot ends this run upright, with its CoM more than 30 % higher."""
        return self._is_lifted

    @property
    def agrees_with_equilibrium(self) -> bool:
        """True if the robot does not collapse in this run, and is near the computed equilibrium.

        Limits of ``torque_error``: 0.05 (``MAX_TORQUE_DEVIATION``); for MuJoCo's import of a URDF
        0.1 (``MAX_IMPORTED_TORQUE_DEVIATION``). With feed-forward, the joint error must also be at
        most 0.02 rad or m (``MAX_PUBLISHED_DEVIATION``).
        """
        near = not self.feedforward or self.joint_error <= MAX_PUBLISHED_DEVIATION
        most = MAX_IMPORTED_TORQUE_DEVIATION if self.imported else MAX_TORQUE_DEVIATION
        return not self.collapses and self.torque_error <= most and near


@dataclass(frozen=True)
class Published:
    """Simulations of the published file from a computed equilibrium, and causes of deviations.

    Attributes:
        runs: Simulations.
        causes: Causes of a deviation; empty if there is none, or none was found.
        differs: Whether the file deviates, or cannot be simulated without changes.
    """

    runs: tuple[PublishedRun, ...]
    causes: tuple[Cause, ...]
    differs: bool

    @property
    def is_altered_only(self) -> bool:
        """True if only changes that this package makes on loading cause the deviation.

        The published file then deviates from the computed equilibrium without a collapse.
        """
        codes = {cause.code for cause in self.causes}
        run = self.worst
        return run is not None and not run.collapses and bool(codes) and codes <= PREPARATION_CODES

    @property
    def worst(self) -> PublishedRun | None:
        """Worst simulation that deviates from the computed equilibrium; None if none does.

        A collapse is worst, then the simulation with feed-forward torques.
        """
        deviating = (run for run in self.runs if run.differs)
        return max(deviating, key=lambda run: (run.collapses, run.feedforward), default=None)
