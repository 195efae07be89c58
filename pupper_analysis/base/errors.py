"""Exceptions with a common base class, ``PupperAnalysisError``.

Each exception contains a diagnostic, from which its message is formed. Most exceptions have
attributes with the values of the problem. Messages state the problem and, if known, valid
alternatives.
"""

from __future__ import annotations

import difflib
import re
import reprlib
from collections.abc import Iterable, Mapping, Sequence
from enum import StrEnum
from os import PathLike
from typing import Any, Self, TypeAlias, TypeVar

from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Term,
    diagnose,
)

Problem: TypeAlias = Diagnostic | str
"""Description of a problem: a diagnostic, or the message of another program."""

_E = TypeVar("_E", bound="PupperAnalysisError")
"""Type of an exception that `_restore_error` creates."""


class PupperAnalysisError(Exception):
    """Base class of the exceptions for invalid input and for failed computations.

    Exceptions can be pickled independently of the constructor arguments, so that worker processes
    can return exceptions.

    Attributes:
        diagnostic: Code, values with units, and message texts in both languages.
        where: Part of a longer computation in which the error occurred ("at 0.50 s, ..."); empty
            unless set by `with_location`.
    """

    diagnostic: Diagnostic
    where: str = ""

    def __init__(self, problem: Problem) -> None:
        self.diagnostic = as_diagnostic(problem)
        super().__init__(str(self.diagnostic))

    def with_location(self, where: Problem) -> Self:
        """Return a copy of the error whose message starts with the failed part of the computation.

        Args:
            where: Text or diagnostic that names the part, for example "tasks[3]" or "at 0.50 s".
        """
        message = diagnose("error-at", where=where, what=vars(self).get("diagnostic", str(self)))
        error = _restore_error(type(self), (str(message),), vars(self))
        error.diagnostic = message
        error.where = str(where)
        return error

    def __reduce__(self) -> tuple[Any, ...]:
        return _restore_error, (type(self), self.args, vars(self))


def as_diagnostic(problem: Problem) -> Diagnostic:
    """Convert a text, such as a message of MuJoCo, to a diagnostic; keep a diagnostic unchanged.

    The new diagnostic has the code ``problem`` and contains the text as a value.
    """
    return problem if isinstance(problem, Diagnostic) else diagnose("problem", problem=problem)


def _restore_error(error_type: type[_E], args: tuple[Any, ...], attributes: dict[str, Any]) -> _E:
    """Create an error from message and attributes, for unpickling and copying.

    The constructor is not called, because it would build a new message.
    """
    error = error_type.__new__(error_type, *args)
    error.__dict__.update(attributes)
    return error


class VariantError(PupperAnalysisError):
    """Invalid name or scale of a variant.

    Attributes:
        field: Argument (``"name"``, ``"base"``, ``"leg_scale"``, ``"torso_mass_scale"``), or both
            scales if each scale is accepted, but no valid model can be derived.
        value: Invalid value.
    """

    def __init__(self, field: str, value: object, valid: Problem) -> None:
        self.field = field
        self.value = value
        value_text = reprlib.repr(value)
        super().__init__(diagnose("variant-not-valid", field=field, value=value_text, valid=valid))


class ModelError(PupperAnalysisError):
    """Model file that cannot be used.

    Attributes:
        source: File or model.
        problem: Message text, with valid alternatives if known.
        cause: Diagnostic of the problem.
    """

    def __init__(self, source: str | PathLike[str], problem: Problem) -> None:
        self.source = str(source)
        self.problem = str(problem)
        self.cause = as_diagnostic(problem)
        super().__init__(
            diagnose("model-unusable", source=self.source, problem=problem, sources=self.source)
        )


MODEL_FAULT_CODES = (
    *("mjcf-not-compiled", "inertia-refused", "joint-limits-crossed"),
    *("link-without-mass", "moving-link-without-mass", "robot-without-mass"),
)
"""Codes of faults in a model file due to which no robot with a free base can be made. `audit`
reports each of these faults."""


class InputError(PupperAnalysisError):
    """File that cannot be read, for example missing, no regular file, too large, or no valid text.

    Attributes:
        path: The file.
        cause: Diagnostic of the problem.
        line: Line number, from 1; None if the problem concerns the whole file or the line is
            unknown.
    """

    def __init__(
        self, path: str | PathLike[str], cause: Diagnostic, line: int | None = None
    ) -> None:
        self.path, self.cause, self.line = str(path), cause, line
        source = self.path if line is None else f"{self.path}:{line}"
        super().__init__(
            diagnose("model-unusable", source=source, problem=cause, sources=self.path)
        )


MAX_LISTED_NAMES = 16
"""Largest number of valid names that the message about an unknown name lists completely. Chosen:
number of joints of a quadruped with four joints per leg."""

MAX_CLOSE_NAMES_WIDTH = 36
"""Largest width [characters] of the valid names in the short message about an unknown name, which
the command line prints; a single name may be wider. Chosen: the rest of the message takes about 64
of 100 characters."""

NUM_CLOSE_NAMES = 5
"""Number of similar names that the message of `UnknownNameError` lists if there are more than
`MAX_LISTED_NAMES` valid names. Chosen, not tuned.
"""


_BASE_NAMES = ("base", "base_link", "body", "pelvis", "root", "torso", "trunk")
"""Usual names of the base link of a robot, in lower case, which a user may write for a base with
another name. Source: names in public robots.
"""


_WORD = re.compile(r"[^\W_]+")
"""Pattern of a word of a name: letters and digits without underscores."""


class UnknownNameError(ModelError):
    """Name that a model, or another list of valid names, does not contain.

    The message lists valid names, names with common words first (`_find_by_words`); of more than
    `MAX_LISTED_NAMES` valid names, only the first `NUM_CLOSE_NAMES`, and the number of the omitted
    names. The short message lists the valid names if their width is at most
    `MAX_CLOSE_NAMES_WIDTH`, else the most similar names.

    Args:
        source: File or model.
        kind: Kind of element.
        name: Unknown name.
        known: Valid names.
        base: Valid name of the robot's base link. The message lists this name first if the unknown
            name is a usual name of a base, such as "base" or "trunk".
        first: Valid names that belong to the unknown name, such as the frames of a foot. The
            message lists these names first.

    Attributes:
        kind: Kind of element: ``"joint"``, ``"frame"``, ``"foot"``, ``"body"`` ...
        name: Unknown name; the given value, if the value is no text.
        known: Valid names.
        correction: Valid name that was probably meant: the base link or the first name in
            ``first``, else the most similar name; empty if no name is similar enough.
    """

    def __init__(
        self,
        source: str | PathLike[str],
        kind: str,
        name: str,
        known: Iterable[str],
        *,
        base: str | None = None,
        first: Sequence[str] = (),
    ) -> None:
        self.kind = kind
        self.name = name
        self.known = tuple(known)
        given = name if isinstance(name, str) else reprlib.repr(name)
        listed = _sort_by_words(given, self.known)
        if base is not None and given.lower() in _BASE_NAMES:
            first = (base, *first)
        listed = tuple(dict.fromkeys((*first, *listed)))
        if len(self.known) > MAX_LISTED_NAMES:
            listed = listed[:NUM_CLOSE_NAMES]
        similar = (
            *first,
            *_find_by_words(given, self.known),
            *_sort_by_similarity(given, self.known),
        )
        self.correction = next(iter(first), "") or _find_correction(given, self.known)
        fitting = _choose_fitting_names(self.known, tuple(dict.fromkeys(similar)))
        problem = diagnose(
            "name-unknown",
            kind=Term(kind),
            unknown=given,
            no_text=None if isinstance(name, str) else True,
            known=listed,
            others=len(self.known) - len(listed),
            fitting=fitting,
            omitted=len(self.known) - len(fitting),
        )
        super().__init__(source, problem)


_MIN_CORRECTION_SIMILARITY = 0.75
"""Smallest similarity (`difflib`, 0 to 1) of a valid name that an unknown name probably means.
Chosen, not tuned: the similarity of two names that differ in one of four characters."""


def _sort_by_similarity(unknown: str, known: Sequence[str], cutoff: float = 0.0) -> list[str]:
    """Return the valid names with a similarity of at least ``cutoff``, the most similar first.

    Upper and lower case are equal. Equally similar names keep their order.
    """
    matcher = difflib.SequenceMatcher(b=unknown.lower())
    similarity = {}
    for name in known:
        matcher.set_seq1(name.lower())
        similarity[name] = matcher.ratio()
    close = [name for name in similarity if similarity[name] >= cutoff]
    return sorted(close, key=lambda name: -similarity[name])


def _find_correction(unknown: str, known: Sequence[str]) -> str:
    """Return the valid name that an unknown name probably means; empty if there is none."""
    return next(iter(_sort_by_similarity(unknown, known, _MIN_CORRECTION_SIMILARITY)), "")


def _choose_fitting_names(known: Sequence[str], similar: Sequence[str]) -> tuple[str, ...]:
    """Return all valid names if they are short enough for a line, else the most similar names."""
    if len(", ".join(known)) <= MAX_CLOSE_NAMES_WIDTH:
        return tuple(known)
    counts = range(1, len(similar) + 1)
    fits = [count for count in counts if len(", ".join(similar[:count])) <= MAX_CLOSE_NAMES_WIDTH]
    return tuple(similar[: max(fits, default=1)])


def _sort_by_words(unknown: str, known: Sequence[str]) -> tuple[str, ...]:
    """Return valid names: first names with common words (`_find_by_words`), then other names.

    If there are many names, only the most similar of the other names are returned.
    """
    others: Iterable[str] = known
    if len(known) > MAX_LISTED_NAMES:
        others = _sort_by_similarity(unknown, known)[:NUM_CLOSE_NAMES]
    return tuple(dict.fromkeys((*_find_by_words(unknown, known), *others)))


def _find_by_words(unknown: str, known: Sequence[str]) -> tuple[str, ...]:
    """Return valid names that contain an unknown name, then names of which it has all words."""
    wanted = unknown.lower()
    words = set(_WORD.findall(wanted))
    containing = [name for name in known if wanted in name.lower()]
    contained = [
        name for name in known if (own := set(_WORD.findall(name.lower()))) and own <= words
    ]
    return (*containing, *contained)


class ConfigurationError(PupperAnalysisError):
    """Argument or coordinate vector with an invalid shape or value.

    Attributes:
        field: Name of the argument.
        problem: Description of the problem.
    """

    def __init__(self, field: str, problem: Problem) -> None:
        self.field, self.problem = field, problem
        super().__init__(diagnose("argument-not-valid", field=field, problem=problem))


_MIN_RELATIVE_FOOT_ERROR = 1e-3
"""Smallest position error of a foot, relative to the largest position error of all feet, that the
message about an unreachable stance lists. A smaller error is a residual of the search. Chosen, not
tuned."""


class StanceUnreachableError(PupperAnalysisError):
    """Stand task for which no solution within the joint limits and without collisions was found.

    Attributes:
        shortfall: {foot or contact point: remaining distance [m] to the target}, for targets that
            are not reached.
        at_limit: {joint: limit [rad, m]} of the joints at a limit in the best configuration found,
            without joints whose positions the task prescribes.
        possible: {requirement: diagnostic of its feasible value}. A requirement is a value that the
            task prescribes, such as the height. An entry alone makes the task feasible. If no
            single requirement suffices, the key names several requirements that must be relaxed
            together ("height and roll"). Empty if no relaxation was found or requested.
        limits: The feasible values as fields of the task, for example {"roll": {"roll": 0.337}}:
            ``replace(task, **limits["roll"])`` is feasible.
        nearest: Stand for the entry of ``limits`` with the smallest relaxation. None if ``limits``
            is empty.
        blocked: Diagnostics of obstacles other than foot errors: for example a part in the ground,
            parts too close to each other, a CoM too close to the edge of the support, loops that
            stay open, or motors at a dead point.
        lacks: Diagnostic of a property that the robot lacks; None if unknown.
    """

    def __init__(
        self,
        task: Problem,
        shortfall: Mapping[str, float],
        at_limit: Mapping[str, float],
        possible: Mapping[str, Diagnostic] | None = None,
        nearest: Any = None,
        blocked: Iterable[Diagnostic] = (),
        limits: Mapping[str, Mapping[str, Any]] | None = None,
        lacks: Diagnostic | None = None,
        units: Mapping[str, str] | None = None,
        lengths: Iterable[Diagnostic] = (),
    ) -> None:
        self.lacks = lacks
        self.limits = dict(limits or {})
        self.blocked = tuple(blocked)
        self.shortfall = dict(shortfall)
        self.at_limit = dict(at_limit)
        self.possible = dict(possible or {})
        self.nearest = nearest
        # The largest error of the contact points of a foot, which are named "foot/0", "foot/1" ...
        foot_errors: dict[str, float] = {}
        for point, error in self.shortfall.items():
            name, _, number = point.rpartition("/")
            foot = name if name and number.isdigit() else point
            if error > 0:
                foot_errors[foot] = max(error, foot_errors.get(foot, 0.0))
        min_shown_error = _MIN_RELATIVE_FOOT_ERROR * max(foot_errors.values(), default=0.0)
        foot_diagnostics = [
            diagnose("foot-misses-target", subject=("foot", foot), gap=Quantity(error, "m"))
            for foot, error in foot_errors.items()
            if error >= min_shown_error
        ]
        joints = [
            diagnose(
                "joint-at-limit",
                subject=("joint", name),
                limit=Quantity(limit, (units or {}).get(name, "rad")),
            )
            for name, limit in self.at_limit.items()
        ]
        feet = [diagnose("feet-miss-targets", feet=foot_diagnostics)] if foot_diagnostics else []
        super().__init__(
            diagnose(
                "stance-out-of-reach",
                task=task,
                obstacles=(*feet, *self.blocked),
                joints=joints,
                possible=self.possible.values(),
                advice=None if self.possible else lacks or diagnose("try-another-height"),
                lengths=tuple(lengths),
            )
        )


class PostureUnreachableError(PupperAnalysisError):
    """Posture for whose tasks no solution within the joint limits was found.

    Args:
        written: Text of the target in degrees, as Python code or option, if the user has probably
            written degrees.
        far: Whether the target is so far away that the user has probably written mm.

    Attributes:
        task: Required task, or kept contact, with the largest residual in the best configuration
            found.
        residual: The residual of this task, in ``unit``.
        unit: Unit of the residual: m or rad.
        residuals: {task: residual [m, rad]} of the tasks and kept contacts in the best
            configuration found.
        conflicting: Tasks and kept contacts whose residuals increase if the residual of ``task``
            decreases.
        at_limit: {joint: limit [rad, m]} of the joints at a limit in the best configuration found.
        blocking: {joint: limit [rad, m]} of the joints at a limit that a motion of ``task`` towards
            its target moves beyond this limit.
        out_of_reach: Whether no motion reduces the residual of ``task``, even without limits and
            other tasks: for example a stretched limb.
        qpos: The best configuration found, shape (nq,).
    """

    def __init__(
        self,
        task: str,
        residual: float,
        unit: str,
        residuals: Mapping[str, float],
        *,
        conflicting: Iterable[str],
        at_limit: Mapping[str, float],
        blocking: Mapping[str, float],
        out_of_reach: bool,
        units: Mapping[str, str],
        qpos: Any,
        written: str | None = None,
        far: bool = False,
    ) -> None:
        self.task, self.residual, self.unit = task, residual, unit
        self.residuals, self.conflicting = dict(residuals), tuple(conflicting)
        self.at_limit, self.blocking = dict(at_limit), dict(blocking)
        self.out_of_reach, self.qpos = out_of_reach, qpos
        joints = [
            diagnose(
                "posture-joint-at-limit",
                subject=("joint", name),
                limit=Quantity(limit, units[name]),
            )
            for name, limit in (self.at_limit if out_of_reach else self.blocking).items()
        ]
        super().__init__(
            diagnose(
                "posture-out-of-reach",
                task=task,
                residual=Quantity(residual, unit),
                conflicting=self.conflicting,
                joints=joints,
                stretched=out_of_reach,
                written=written,
                far=far,
            )
        )


class Infeasibility(StrEnum):
    """Reason why no contact forces balance the robot."""

    COM_OUTSIDE = "com outside the support polygon"
    ZMP_OUTSIDE = "zero-moment point outside the support polygon"
    FRICTION = "friction too low"
    PULL = "a foot would have to pull"
    GRIP = "a grip is too weak"


class StaticsInfeasibleError(PupperAnalysisError):
    """No unilateral contact forces inside the friction cones balance the robot.

    Attributes:
        reason: Reason.
        margin: Signed distance [m] between the projected CoM or zero-moment point and the edge of
            the support polygon; negative outside. Not finite if undefined, for example NaN if a
            grip or a prescribed force is the reason.
        friction_needed: Minimum friction coefficient with a solution, if friction is the reason;
            otherwise None.
        feet: Feet concerned.
    """

    def __init__(
        self,
        reason: Infeasibility,
        detail: Problem,
        *,
        margin: float,
        friction_needed: float | None = None,
        feet: Iterable[str] = (),
    ) -> None:
        self.reason = reason
        self.margin = margin
        self.friction_needed = friction_needed
        self.feet = tuple(feet)
        why = Term(reason.value)
        super().__init__(diagnose("no-static-balance", reason=why, detail=detail))


class OutputError(PupperAnalysisError):
    """File or folder that cannot be written.

    Attributes:
        path: File or folder.
    """

    def __init__(self, path: str | PathLike[str], problem: object) -> None:
        self.path = path
        message = problem if isinstance(problem, Diagnostic) else str(problem)
        super().__init__(diagnose("output-not-written", path=str(path), problem=message))


class NoEquilibriumError(PupperAnalysisError):
    """No static equilibrium of a servo-driven robot near the stand.

    Attributes:
        share: Fraction of the feed-forward torque that could be removed before the equilibrium was
            lost. None if the equilibrium was not computed by removing feed-forward.
    """

    def __init__(self, share: float | None, problem: Problem) -> None:
        self.share = share
        super().__init__(diagnose("no-equilibrium", problem=problem))


class NotStandingError(PupperAnalysisError):
    """Robot that does not remain standing in a simulation or at the computed equilibrium.

    Attributes:
        problems: Reasons, for example ``failures`` of the ``SteadyState``.
    """

    def __init__(self, problems: tuple[Problem, ...]) -> None:
        self.problems = problems
        super().__init__(diagnose("not-standing", problems=problems))


class NoStiffnessError(PupperAnalysisError):
    """No tested servo stiffness holds the stand without feed-forward.

    Attributes:
        kp: Largest tested stiffness [N m/rad].
        problem: Reason of the failure at this stiffness.
    """

    def __init__(self, robot: str, kp: float, problem: Problem) -> None:
        self.kp = kp
        self.problem = problem
        stiffest = Quantity(kp, "N m/rad")
        super().__init__(diagnose("no-stiffness", robot=robot, kp=stiffest, problem=problem))


class NotSettlingError(PupperAnalysisError):
    """Fixed-point iteration of quantities that depend on each other did not converge.

    Attributes:
        change: Largest change in the last iteration, in the unit of the quantities.
    """

    def __init__(self, change: float, problem: Problem) -> None:
        self.change = change
        super().__init__(diagnose("not-settling", problem=problem))


class MissingPackageError(PupperAnalysisError):
    """Optional package that is not installed.

    Attributes:
        package: Name of the package.
        extra: Extra of ``pupper-analysis`` that installs the package.
    """

    def __init__(self, package: str, extra: str) -> None:
        self.package, self.extra = package, extra
        super().__init__(diagnose("package-missing", package=package, extra=extra))


class StudyError(PupperAnalysisError):
    """Study that cannot be run, resumed or read.

    Attributes:
        folder: Folder of the study; for an error of workers, the name of the machine or ``-``.
        problem: Message text.
    """

    def __init__(self, folder: str | PathLike[str], problem: Problem) -> None:
        self.folder = str(folder)
        self.problem = str(problem)
        super().__init__(diagnose("study-unusable", folder=self.folder, problem=problem))


class MeasurementError(PupperAnalysisError):
    """Measurements of a robot (stands, a log) that cannot be used.

    Attributes:
        source: File, or a name that represents the measurements.
        problem: Message text, with valid alternatives if known.
        cause: Diagnostic of the problem.
    """

    def __init__(self, source: str | PathLike[str], problem: Problem) -> None:
        self.source = str(source)
        self.problem = str(problem)
        self.cause = as_diagnostic(problem)
        message = diagnose("measurements-unusable", source=self.source, problem=problem)
        super().__init__(message)


class FitError(PupperAnalysisError):
    """Fit to measurements that failed, for example without convergence.

    Attributes:
        problem: Message text.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = str(problem)
        super().__init__(problem)


def __dir__() -> list[str]:
    """Return the names for ``dir``, without imported objects and most constants."""
    return sorted(
        name
        for name, value in globals().items()
        if name.startswith("__") or getattr(value, "__module__", None) == __name__
    )
