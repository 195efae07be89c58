"""What is estimated: numbers of a robot and its surroundings, with what is known of them before."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from copy import copy
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.arguments import check_type
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.units import UNIT_FACTORS
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ParameterKind:
    """A kind of number that measurements may tell.

    Attributes:
        name: Of the kind.
        unit: Of its values, in SI.
        share: Standard deviation of what is known before, in parts of the stated value.
        width: The same in the kind's unit; the larger of the two counts.
        positive: Whether a value below zero means nothing.
        factor: Whether it is off by a factor, rather than by an amount: twice is as probable as
            half.
        common: Correlation of what is known of two subjects: part of the variance that all have
            in common.
    """

    name: str
    unit: str
    share: float = 0.0
    width: float = 0.0
    positive: bool = False
    factor: bool = False
    common: float = 0.0


KINDS: Mapping[str, ParameterKind] = {
    kind.name: kind
    for kind in (
        # Published masses are off by half (stretch's base weighs 7 times what its file said).
        ParameterKind("mass", "kg", share=0.5, positive=True, factor=True),
        # A battery that is mounted elsewhere, a payload plate: centimetres.
        ParameterKind("com", "m", width=0.03),
        # Encoders are zeroed by hand, or against a mechanical stop.
        ParameterKind("offset", "rad", width=math.radians(2.0)),
        # Gains of servos are asked for in units of their driver, current and not torque: if one is
        # wrong by a factor, all are. Were they not bound, twelve would be known on average.
        ParameterKind("kp", "N m/rad", share=0.3, positive=True, factor=True, common=0.5),
        # Gearboxes of small servos: Pupper's upstream model with play has 12 times the other's.
        ParameterKind("friction", "N m", share=1.0, width=0.05, positive=True),
        ParameterKind("damping", "N m s/rad", share=1.0, width=0.02, positive=True),
        ParameterKind("armature", "kg m^2", share=1.0, width=0.002, positive=True),
        ParameterKind("delay", "s", width=0.01, positive=True),
        # Of torques: drives of large motors take a millisecond, loops over a bus, filters of
        # velocities and small servos 2 to 10.
        ParameterKind("lag", "s", width=0.005, positive=True),
        # What a spirit level leaves, or the one of a telephone.
        ParameterKind("slope", "rad", width=math.radians(0.2)),
        # Of the ground under the feet, in parts of what the MJCF says: 0 is a rigid floor, which
        # is as far away as twice as soft a one.
        ParameterKind("softness", "1", width=0.5),
        # Factor on a leg's last link, from its joint to the foot: legs of another variant are some
        # per cent longer, and hide in the zeros of encoders and in uneven ground.
        ParameterKind("length", "1", width=0.02),
        # What a foot that turned on the ground, or rolled, keeps in every stand alike, in parts of
        # the force on it.
        ParameterKind("moment", "m", width=3e-4),
        # Servos that give nothing for an error below it: 0.1 deg in hobby servos' data sheets.
        # Below zero it is dry friction that holds all joints against their load: on Go1 4 % of
        # weight times height is 1.5 deg of its servos.
        ParameterKind("deadband", "rad", width=math.radians(1.0)),
        # Dry friction of joints that yielded to their load, where a known mass is on, beyond what
        # all stands keep alike: it swings longer. Of what is stated, anywhere in its band.
        ParameterKind("settling", "1", width=3**-0.5),
        # What stands on the feet and no scale has shown, in parts of the weight: a pack that was
        # put on later; less, if a cable carries. A pack of a tenth is within that, and nothing but
        # a known mass speaks against it. Sideways it would be a slope, which is estimated.
        ParameterKind("load", "1", width=0.08),
        # A known mass that was put on, by a kitchen scale; and where, by a ruler.
        ParameterKind("added", "1", width=0.005, positive=True),
        ParameterKind("place", "m", width=3e-3),
    )
}
"""The kinds, each with what is known before anything is measured, unless a prior says otherwise."""

SURROUNDINGS_KINDS = (
    *("slope", "softness", "length", "moment", "deadband", "settling", "load", "added", "place"),
)
"""Kinds that are no number of the robot's files."""


@dataclass(frozen=True)
class Parameter:
    """A number that is estimated.

    Attributes:
        kind: One of ``KINDS``.
        subject: The link or joint; ``floor``, ``imu``, ``servos`` or ``scale`` of the surroundings.
        component: ``x``, ``y`` or ``z``, or ``roll`` or ``pitch``; empty of a scalar.
        stated: The model's value, about which the prior is (in the kind's unit).
        width: The prior's standard deviation (likewise).
    """

    kind: str
    subject: str
    component: str
    stated: float = field(metadata={"unit": "varies"})
    width: float = field(metadata={"unit": "varies"})

    @property
    def name(self) -> str:
        """As it is written in tables: ``com.x base``."""
        kind = f"{self.kind}.{self.component}" if self.component else self.kind
        return f"{kind} {self.subject}"

    @property
    def unit(self) -> str:
        """Of ``stated`` and ``width``."""
        return KINDS[self.kind].unit


@dataclass(frozen=True)
class Prior:
    """What is known of some parameters before: ``mass=50%``, ``com:base=5mm``, ``kp=0``.

    Attributes:
        kind: One of ``KINDS``.
        subject: A link or joint, or a pattern of several (``*knee*``); all by default.
        share: Standard deviation in parts of the stated value; NaN if it is a width.
        width: Standard deviation in the kind's unit; NaN if it is a share.
    """

    kind: str
    subject: str = "*"
    share: float = math.nan
    width: float = math.nan

    def compute_std(self, stated: float) -> float:
        """Returns the standard deviation for a stated value."""
        return self.share * abs(stated) if math.isnan(self.width) else self.width


_PRIOR = re.compile(
    r"(?P<kind>[a-z]+)(?::(?P<subject>[^=]+))?=(?P<value>[-+.\d]+(?:[eE][-+]?\d+)?)(?P<unit>.*)"
)


_NARROWEST = 1e-9
"""Of any unit: what is known better is known, and the square of a width is a number yet."""


def parse_prior(text: str) -> Prior:
    """Reads ``KIND[:SUBJECT]=WIDTH``, as ``mass=50%``, ``com:base=5mm`` or ``kp=0``.

    Raises:
        ConfigurationError: If it says nothing.
    """
    check_type("text", text, str)
    found = _PRIOR.fullmatch(text.strip())
    kind = found and KINDS.get(found["kind"])
    if not found or kind is None:
        raise ConfigurationError("prior", diagnose("no-prior", text=text, kinds=tuple(KINDS)))
    unit, subject = found["unit"].strip(), found["subject"] or "*"
    try:
        value = float(found["value"])
    except ValueError:
        value = math.nan
    if value != 0 and not _NARROWEST < value < 1 / _NARROWEST:
        raise ConfigurationError("prior", diagnose("no-prior", text=text, kinds=tuple(KINDS)))
    if unit == "%":
        return Prior(kind.name, subject, share=value / 100)
    sizes = next(
        (own for own in UNIT_FACTORS.values() if next(iter(own)) == kind.unit), {kind.unit: 1.0}
    )
    if unit and unit not in sizes:
        finding = diagnose("prior-unit", text=text, unit=unit, wanted=kind.unit)
        raise ConfigurationError("prior", finding)
    return Prior(kind.name, subject, width=value * (sizes[unit] if unit else 1.0))


def parse_priors(priors: Iterable[Prior | str]) -> list[Prior]:
    """Returns what is known before, read where it is text; see ``parse_prior``.

    Raises:
        ConfigurationError: If a text says nothing.
    """
    return [parse_prior(one) if isinstance(one, str) else one for one in priors]


def apply_priors(
    stated: Iterable[tuple[str, str, str, float]], priors: Iterable[Prior] = ()
) -> tuple[Parameter, ...]:
    """Returns parameters with the width that the last prior which means them gives, or their kind.

    What has no width (``kp=0``, a mass of nothing) is known, and no parameter.

    Args:
        stated: Kind, subject, component and stated value of each.
        priors: What is said of them.

    Raises:
        ConfigurationError: If a prior means none of them.
    """
    wanted, given, used = list(stated), tuple(priors), set()
    found = []
    for kind, subject, component, value in wanted:
        own = KINDS[kind]
        width = max(own.share * abs(value), own.width)
        for prior in given:
            if prior.kind == kind and fnmatchcase(subject, prior.subject):
                width = prior.compute_std(value)
                used.add(prior)
        if width > 0:
            found.append(Parameter(kind, subject, component, float(value), float(width)))
    for prior in given:
        if prior not in used:
            known = tuple(dict.fromkeys(one[1] for one in wanted if one[0] == prior.kind))
            finding = diagnose(
                "prior-of-nothing", kind=prior.kind, pattern=prior.subject, known=known
            )
            raise ConfigurationError("prior", finding)
    return tuple(found)


class ParameterTable:
    """Parameters by kind and subject, and where each stands in a vector.

    Args:
        parameters: In the vector's order.

    Attributes:
        parameters: Likewise.
        stated: (n,) their stated values.
        width: (n,) standard deviations before.
        precision: (n, n) inverse of their correlation before.
    """

    def __init__(self, parameters: Iterable[Parameter]) -> None:
        self.parameters = tuple(parameters)
        self.stated = np.array([one.stated for one in self.parameters])
        self.width = np.array([one.width for one in self.parameters])
        kinds = np.array([one.kind for one in self.parameters])
        common = np.array([KINDS[one.kind].common for one in self.parameters])
        correlation = np.where(kinds[:, None] == kinds, common, 0.0)
        np.fill_diagonal(correlation, 1.0)
        self.precision = np.linalg.inv(correlation) if len(kinds) else correlation
        self._at = {
            (one.kind, one.subject, one.component): place
            for place, one in enumerate(self.parameters)
        }

    def __len__(self) -> int:
        return len(self.parameters)

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self.parameters)

    def find_index(self, kind: str, subject: str, component: str = "") -> int | None:
        """Returns where a parameter is in the vector; None if it is known."""
        return self._at.get((kind, subject, component))

    def with_scaled_widths(self, kind: str, factor: float) -> ParameterTable:
        """Returns the same with other widths of a kind: less or more is known of it before."""
        found = copy(self)
        found.parameters = tuple(
            replace(one, width=factor * one.width) if one.kind == kind else one for one in self
        )
        found.width = np.array([one.width for one in found])
        return found

    def get_value(
        self, vector: Array, kind: str, subject: str, component: str, otherwise: float
    ) -> float:
        """Returns a parameter's value in a vector, or another if it is known."""
        place = self._at.get((kind, subject, component))
        return otherwise if place is None else float(vector[place])

    def get_inertial(self, vector: Array, link: str, stated: pin.Inertia) -> tuple[float, Array]:
        """Returns the mass (kg) and the com (3,) (m) of a link's body, as a vector has them."""
        mass = self.get_value(vector, "mass", link, "", stated.mass)
        return mass, self.get_com(vector, link, stated.lever)

    def get_com(self, vector: Array, link: str, stated: Array) -> Array:
        """Returns the com (3,) of a link's body, whose stated one is given (m)."""
        axes = zip(AXES, stated.tolist(), strict=True)
        return np.array([self.get_value(vector, "com", link, axis, own) for axis, own in axes])

    def get_values(self, vector: Array, kind: str, subjects: Iterable[str], stated: Array) -> Array:
        """Returns the values (k,) of a kind for some subjects, whose stated ones are given."""
        each = zip(subjects, stated.tolist(), strict=True)
        return np.array([self.get_value(vector, kind, one, "", own) for one, own in each])


# The links that bodies are named by: of all that a joint moves, the one whose frame is its own.

AXES = ("x", "y", "z")
"""Components of a com, in the link's frame."""


def find_moved_link(model: pin.Model, number: int) -> str:
    """Returns the URDF's link that a joint of Pinocchio's moves.

    Args:
        model: The model.
        number: The joint's.
    """
    frames = [
        frame
        for frame in model.frames
        if frame.type == pin.FrameType.BODY and frame.parentJoint == number
    ]
    own = next((frame for frame in frames if frame.placement.isIdentity(1e-12)), frames[0])
    return str(own.name)


def list_bodies(robot: Robot) -> tuple[tuple[str, int], ...]:
    """Returns the moving bodies of a robot: the link each is named by, and its joint's number.

    The links that are fixed to it are part of it. What has no mass is left out.
    """
    model = robot.structure.model
    return tuple(
        (find_moved_link(model, number), number)
        for number in range(1, model.njoints)
        if model.inertias[number].mass > 0
    )
