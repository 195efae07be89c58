"""Parameters of a fit: kinds, priors, and the order in a vector.

A parameter is a scalar of the robot (for example a link's mass) or of the surroundings (for example
the slope of the ground). The prior is a normal distribution about the stated value: the value of
the robot's files, or the value that is assumed for the surroundings. `ParameterTable` maps
parameters to entries of a vector.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin

from pupper_analysis.base.arguments import check_type, match_names
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.units import UNIT_FACTORS
from pupper_analysis.robot.robot import Robot


@dataclass(frozen=True)
class ParameterKind:
    """Kind of an estimated parameter (mass, kp, encoder offset, ...), with its default prior.

    The default standard deviation is the larger of ``share`` times the stated value and ``width``.

    Attributes:
        name: Name of the kind.
        unit: SI unit of the values.
        share: Default standard deviation, as a fraction of the stated value.
        width: Smallest default standard deviation, in the kind's unit.
        positive: Whether negative values are impossible.
        factor: Whether errors are multiplicative. If True, a fit of stands estimates the logarithm,
            so that twice and half the stated value are equally probable.
        common: Prior correlation between two parameters of this kind.
    """

    name: str
    unit: str
    share: float = 0.0
    width: float = 0.0
    positive: bool = False
    factor: bool = False
    common: float = 0.0


PARAMETER_KINDS: Mapping[str, ParameterKind] = {
    kind.name: kind
    for kind in (
        # Published masses may be wrong by half; the base of Stretch has 7 times its published mass.
        ParameterKind("mass", "kg", share=0.5, positive=True, factor=True),
        # Centimetres: a battery mounted elsewhere, a payload plate. Chosen, not tuned.
        ParameterKind("com", "m", width=0.03),
        # Encoders are zeroed by hand or against a mechanical stop. Chosen, not tuned.
        ParameterKind("offset", "rad", width=math.radians(2.0)),
        # Servo gains are set in the driver's units of current, not torque: a wrong conversion
        # changes all gains by one factor. Without correlation the mean of twelve gains would be
        # known too well.
        ParameterKind("kp", "N m/rad", share=0.3, positive=True, factor=True, common=0.5),
        # Gearboxes of small servos: Pupper's upstream model with backlash has 12 times the friction
        # of the model without.
        ParameterKind("friction", "N m", share=1.0, width=0.05, positive=True),
        # Includes an error of kd, which a wrong conversion changes by one factor, as kp.
        ParameterKind("damping", "N m s/rad", share=1.0, width=0.02, positive=True, common=0.5),
        ParameterKind("armature", "kg m^2", share=1.0, width=0.002, positive=True),
        ParameterKind("delay", "s", width=0.01, positive=True),
        # Time constant of a lag: about 1 ms for drives of large motors, 2 to 10 ms for bus loops,
        # velocity filters and small servos.
        ParameterKind("lag", "s", width=0.005, positive=True),
        # Accuracy of a spirit level or a phone's level.
        ParameterKind("slope", "rad", width=math.radians(0.2)),
        # Factor on the penetration that the MJCF's contact softness gives. 0 is a rigid floor, as
        # far from 1 as a floor twice as soft.
        ParameterKind("softness", "1", width=0.5),
        # Factor on the distance from the axis of a leg's last joint to its foot. Legs of another
        # variant are some per cent longer; encoder offsets and uneven ground have similar effects.
        ParameterKind("length", "1", width=0.02),
        # Contact moment that is the same in all stands, divided by the normal force: the friction
        # of a foot that turned or rolled on the ground.
        ParameterKind("moment", "m", width=3e-4),
        # Servo error below which a servo gives no torque: 0.1 deg in data sheets of hobby servos.
        # Negative values describe dry friction that holds all joints against their load, for
        # example on Go1 1.5 deg of servo error.
        ParameterKind("deadband", "rad", width=math.radians(1.0)),
        # Dry friction of loaded joints in stands with a known mass, beyond the friction that is
        # common to all stands, as a fraction of the stated friction. Uniform in [-1, 1], hence 1 /
        # sqrt(3).
        ParameterKind("settling", "1", width=3**-0.5),
        # Load on the feet that the scale did not show, as a fraction of the weight: a pack attached
        # later (positive) or a cable that carries (negative). Only a known mass contradicts it. A
        # sideways force would act like a slope, which is estimated as well.
        ParameterKind("load", "1", width=0.08),
        # Factor on a known mass, measured on a kitchen scale.
        ParameterKind("added", "1", width=0.005, positive=True),
        # Displacement of a known mass from its stated position, measured with a ruler.
        ParameterKind("place", "m", width=3e-3),
    )
}
"""Parameter kinds by name, with default priors. A `Prior` replaces the default."""

SURROUNDINGS_KINDS = (
    *("slope", "softness", "length", "moment", "deadband", "settling", "load", "added", "place"),
)
"""Keys of `PARAMETER_KINDS` for the surroundings: ground, leg lengths, dead band and friction of
the servos, scale and known masses. Results list parameters of the surroundings last. Such
parameters are not written to robot files.
"""


@dataclass(frozen=True)
class Parameter:
    """Scalar of a robot or its surroundings that a fit estimates.

    Attributes:
        kind: Key of ``PARAMETER_KINDS``.
        subject: Link, joint or foot to which the value belongs, or ``floor``, ``servos`` or
            ``scale``.
        component: ``x``, ``y`` or ``z``; ``command`` or ``position`` of a lag; empty for a scalar.
        stated: Mean of the prior, in the kind's unit: the value of the model, or the assumed value
            of the surroundings.
        width: Standard deviation of the prior, in the kind's unit.
    """

    kind: str
    subject: str
    component: str
    stated: float = field(metadata={"unit": "varies"})
    width: float = field(metadata={"unit": "varies"})

    @property
    def name(self) -> str:
        """Name of the parameter in tables, for example ``com.x base``."""
        kind = f"{self.kind}.{self.component}" if self.component else self.kind
        return f"{kind} {self.subject}"

    @property
    def unit(self) -> str:
        """SI unit of the values of a parameter, for example ``kg``; ``1`` for a factor."""
        return PARAMETER_KINDS[self.kind].unit


@dataclass(frozen=True)
class Prior:
    """Prior of all parameters of a kind that match a pattern, for example ``com:base=5mm``.

    Attributes:
        kind: Key of ``PARAMETER_KINDS``.
        subject: Subject of a `Parameter`, or a pattern (``*knee*``); all by default.
        share: Standard deviation as a fraction of the stated value; NaN if ``width`` is set.
        width: Standard deviation in the kind's unit; NaN if ``share`` is set.
    """

    kind: str
    subject: str = "*"
    share: float = math.nan
    width: float = math.nan

    def compute_std(self, stated: float) -> float:
        """Compute the prior standard deviation of a parameter, in the unit of its kind, such as kg.

        A relative width (``share``) is a fraction of the absolute value of ``stated``.
        """
        return self.share * abs(stated) if math.isnan(self.width) else self.width


_PRIOR_PATTERN = re.compile(
    r"(?P<kind>[a-z]+)(?::(?P<subject>[^=]+))?=(?P<value>[-+.\d]+(?:[eE][-+]?\d+)?)(?P<unit>.*)"
)
"""Option that changes a prior: ``KIND[:SUBJECT]=VALUE[UNIT]``."""


_MIN_PRIOR_WIDTH = 1e-9
"""Lower bound of a nonzero prior width that a user enters as ``KIND=VALUE[UNIT]``, in the entered
unit. The upper bound is the reciprocal. Chosen, not tuned.
"""


def parse_prior(text: str) -> Prior:
    """Parse ``KIND[:SUBJECT]=WIDTH``, for example ``mass=50%``, ``com:base=5mm`` or ``kp=0``.

    The width is the prior standard deviation. A width without unit is in the unit of the kind.

    Raises:
        ConfigurationError: If the argument is no text or does not have this form, the kind or the
            unit is unknown, or the value is out of range.
    """
    check_type("text", text, str)
    match = _PRIOR_PATTERN.fullmatch(text.strip())
    kind = match and PARAMETER_KINDS.get(match["kind"])
    if not match or kind is None:
        raise ConfigurationError(
            "prior", diagnose("no-prior", text=text, kinds=tuple(PARAMETER_KINDS))
        )
    unit, subject = match["unit"].strip(), match["subject"] or "*"
    try:
        value = float(match["value"])
    except ValueError:
        value = math.nan
    if value != 0 and not _MIN_PRIOR_WIDTH < value < 1 / _MIN_PRIOR_WIDTH:
        raise ConfigurationError(
            "prior", diagnose("no-prior", text=text, kinds=tuple(PARAMETER_KINDS))
        )
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
    """Parse the texts in a list of priors by ``parse_prior``; other entries are kept.

    Raises:
        ConfigurationError: If a text is not a prior.
    """
    return [parse_prior(prior) if isinstance(prior, str) else prior for prior in priors]


def apply_priors(
    stated: Iterable[tuple[str, str, str, float]], priors: Iterable[Prior] = ()
) -> tuple[Parameter, ...]:
    """Create the parameters of a fit with prior standard deviations (widths).

    The last matching prior determines the width of a parameter. Without a matching prior, the width
    is the default of the kind. A parameter whose width is not positive is left out: the stated
    value counts as exact, for example with the prior ``kp=0``.

    Args:
        stated: Kind, subject, component and stated value (in the kind's unit) of each possible
            parameter.
        priors: Priors that replace the defaults.

    Raises:
        ConfigurationError: If a prior matches no possible parameter, or a prior with a positive
            share applies to a parameter with the stated value 0.
    """
    candidates, prior_list, used = list(stated), tuple(priors), set()
    subjects_by_kind: dict[str, dict[str, None]] = {}
    for kind, subject, _, _ in candidates:
        subjects_by_kind.setdefault(kind, {})[subject] = None
    selected = [
        match_names(prior.subject, subjects_by_kind.get(prior.kind, {})) for prior in prior_list
    ]
    parameters = []
    for kind, subject, component, value in candidates:
        default = PARAMETER_KINDS[kind]
        width, last_prior = max(default.share * abs(value), default.width), None
        for prior, subjects in zip(prior_list, selected, strict=True):
            if prior.kind == kind and subject in subjects:
                width, last_prior = prior.compute_std(value), prior
                used.add(prior)
        if value == 0 and last_prior is not None and last_prior.share > 0:
            parameter = Parameter(kind, subject, component, 0.0, 0.0)
            finding = diagnose(
                "prior-share-of-zero",
                parameter=parameter.name,
                share=100 * last_prior.share,
                prior=f"{kind}:{subject}",
                example=default.width or 1.0,
                unit="" if default.unit == "1" else default.unit,
            )
            raise ConfigurationError("prior", finding)
        if width > 0:
            parameters.append(Parameter(kind, subject, component, float(value), float(width)))
    for prior in prior_list:
        if prior not in used:
            finding = diagnose(
                "prior-of-nothing",
                kind=prior.kind,
                pattern=prior.subject,
                known=tuple(subjects_by_kind.get(prior.kind, {})),
            )
            raise ConfigurationError("prior", finding)
    return tuple(parameters)


class ParameterTable:
    """Parameters of a fit in the order of a vector, with an index by kind and subject.

    Args:
        parameters: Parameters in the order of the vector.

    Attributes:
        parameters: Parameters in the order of the vector.
        stated: Stated values, shape (n,), in the parameters' units.
        width: Standard deviations of the priors, shape (n,), in the parameters' units.
        precision: Inverse of the prior correlation matrix, shape (n, n), in units of the widths.
    """

    def __init__(self, parameters: Iterable[Parameter]) -> None:
        self.parameters = tuple(parameters)
        self.stated = np.array([parameter.stated for parameter in self.parameters])
        self.width = np.array([parameter.width for parameter in self.parameters])
        kinds = np.array([parameter.kind for parameter in self.parameters])
        common = np.array([PARAMETER_KINDS[parameter.kind].common for parameter in self.parameters])
        correlation = np.where(kinds[:, None] == kinds, common, 0.0)
        np.fill_diagonal(correlation, 1.0)
        self.precision = np.linalg.inv(correlation) if len(kinds) else correlation
        self._indices = {
            (parameter.kind, parameter.subject, parameter.component): index
            for index, parameter in enumerate(self.parameters)
        }

    def __len__(self) -> int:
        return len(self.parameters)

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self.parameters)

    def find_index(self, kind: str, subject: str, component: str = "") -> int | None:
        """Return the index of a parameter in the parameter vector; None if not estimated.

        Kind, subject and component identify a `Parameter`. The component of a scalar is empty.
        """
        return self._indices.get((kind, subject, component))

    def find_columns(
        self, kind: str, subjects: Sequence[str], components: Sequence[str] = ("",)
    ) -> tuple[list[int], list[int]]:
        """Find the parameter-vector columns of all estimated parameters of a kind, by subject.

        Args:
            kind: Key of ``PARAMETER_KINDS``.
            subjects: Subjects, for example joints; an entry may occur several times.
            components: Components of each subject.

        Returns:
            Two lists of equal length: the positions of the estimated parameters among all pairs of
                subject and component (component varies fastest), and their indices in the parameter
                vector.
        """
        keys = [(kind, subject, component) for subject in subjects for component in components]
        indices = [*map(self._indices.get, keys)]
        positions = [position for position, index in enumerate(indices) if index is not None]
        return positions, [index for index in indices if index is not None]

    def with_scaled_widths(self, kind: str, factor: float) -> ParameterTable:
        """Return a copy in which the prior widths of the parameters of a kind are scaled."""
        scaled = copy(self)
        scaled.parameters = tuple(
            replace(parameter, width=factor * parameter.width)
            if parameter.kind == kind
            else parameter
            for parameter in self
        )
        scaled.width = np.array([parameter.width for parameter in scaled])
        return scaled

    def get_value(
        self, vector: Array, kind: str, subject: str, component: str, default: float
    ) -> float:
        """Return the value of a parameter from a parameter vector, in the unit of the parameter.

        ``kind``, ``subject`` and ``component`` select the `Parameter`. If the parameter is not
        estimated, the result is ``default``.
        """
        index = self._indices.get((kind, subject, component))
        return default if index is None else float(vector[index])

    def get_inertial(self, vector: Array, link: str, stated: pin.Inertia) -> tuple[float, Array]:
        """Return mass [kg] and CoM, shape (3,) [m], of a link's body from a parameter vector.

        Values that are not estimated are taken from ``stated``. The CoM is in the frame of
        ``stated``.
        """
        mass = self.get_value(vector, "mass", link, "", stated.mass)
        return mass, self.get_com(vector, link, stated.lever)

    def get_com(self, vector: Array, link: str, stated: Array) -> Array:
        """Return the CoM of a link's body from a parameter vector, shape (3,) [m].

        Components that are not estimated are taken from ``stated``, shape (3,) [m]. The CoM is in
        the frame of ``stated``, the frame of the Pinocchio joint.
        """
        axes = zip(AXES, stated.tolist(), strict=True)
        return np.array(
            [self.get_value(vector, "com", link, axis, default) for axis, default in axes]
        )

    def get_values(self, vector: Array, kind: str, subjects: Iterable[str], stated: Array) -> Array:
        """Return the values of a parameter kind for k joints or links, shape (k,).

        The values are in the unit of the kind. The value of a subject that is not estimated is
        taken from ``stated``.

        Args:
            vector: Parameters, shape (n,).
            kind: Key of ``PARAMETER_KINDS``; a kind without components.
            subjects: Names of k joints or links.
            stated: Stated values of the subjects, shape (k,).
        """
        pairs = zip(subjects, stated.tolist(), strict=True)
        return np.array(
            [self.get_value(vector, kind, subject, "", default) for subject, default in pairs]
        )


# Names of moving bodies.

AXES = ("x", "y", "z")
"""Components of a vector, for example of a CoM in the frame of the Pinocchio joint."""


def find_moved_link(model: pin.Model, number: int) -> str:
    """Return the URDF link that the Pinocchio joint with the index ``number`` moves.

    If fixed joints connect several links, a link whose frame coincides with the joint frame is
    preferred.
    """
    frames = [
        frame
        for frame in model.frames
        if frame.type == pin.FrameType.BODY and frame.parentJoint == number
    ]
    link_frame = next((frame for frame in frames if frame.placement.isIdentity(1e-12)), frames[0])
    return str(link_frame.name)


def list_bodies(robot: Robot) -> tuple[tuple[str, int], ...]:
    """Return link name and Pinocchio joint index of each moving body that has mass.

    A body consists of all links that fixed joints connect (`find_moved_link`).
    """
    model = robot.structure.model
    return tuple(
        (find_moved_link(model, number), number)
        for number in range(1, model.njoints)
        if model.inertias[number].mass > 0
    )
