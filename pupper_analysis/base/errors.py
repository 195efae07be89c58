"""Typed errors: one base class; each names what is wrong and what would be valid."""

from __future__ import annotations

import reprlib
from collections.abc import Iterable, Mapping
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
"""What is wrong: a diagnostic, or words of another program's, which are in its language."""

_E = TypeVar("_E", bound="PupperAnalysisError")


class PupperAnalysisError(Exception):
    """Base class of every error that the package raises on purpose.

    Errors survive pickling, whatever arguments their classes take, so that they come back whole
    from other processes.

    Attributes:
        diagnostic: The same as data: a code, values with units, and words in both languages.
        where: In which part of a longer task it happened ("at 0.50 s, ..."); empty otherwise.
    """

    diagnostic: Diagnostic
    where: str = ""

    def __init__(self, problem: Problem) -> None:
        self.diagnostic = as_diagnostic(problem)
        super().__init__(str(self.diagnostic))

    def at(self, where: Problem) -> Self:
        """Returns the same error, with all it carries, whose message begins with where it was."""
        message = diagnose("error-at", where=where, what=vars(self).get("diagnostic", str(self)))
        error = _restore(type(self), (str(message),), vars(self))
        error.diagnostic = message
        error.where = str(where)
        return error

    def __reduce__(self) -> tuple[Any, ...]:
        return _restore, (type(self), self.args, vars(self))


def as_diagnostic(problem: Problem) -> Diagnostic:
    """Returns what is wrong as a diagnostic, which words of another program's become, too."""
    return problem if isinstance(problem, Diagnostic) else diagnose("problem", problem=problem)


def _restore(kind: type[_E], args: tuple[Any, ...], data: dict[str, Any]) -> _E:
    """Makes an error of what it carries, without its constructor, which makes up the message."""
    error = kind.__new__(kind, *args)
    error.__dict__.update(data)
    return error


class VariantError(PupperAnalysisError):
    """A variant's name or scale is not valid.

    Attributes:
        field: What was given (``"name"``, ``"base"``, ``"leg_scale"``, ``"torso_mass_scale"``).
        value: The offending value.
    """

    def __init__(self, field: str, value: object, valid: Problem) -> None:
        self.field = field
        self.value = value
        given = reprlib.repr(value)
        super().__init__(diagnose("variant-not-valid", field=field, value=given, valid=valid))


class ModelError(PupperAnalysisError):
    """A model file cannot be used.

    Attributes:
        source: The file (or the model) at fault.
        problem: What is wrong, and what would be valid.
        cause: The same, without its words where a diagnostic was given.
    """

    def __init__(self, source: str | PathLike[str], problem: Problem) -> None:
        self.source = str(source)
        self.problem = str(problem)
        self.cause = as_diagnostic(problem)
        super().__init__(
            diagnose("model-unusable", source=self.source, problem=problem, sources=self.source)
        )


class InputError(PupperAnalysisError):
    """A file cannot be read: it is not there, no regular file, too large, or no text.

    Who reads a file of some kind raises it as the error of that kind.

    Attributes:
        path: The file.
        cause: What is wrong, and what would be valid.
        line: Where, from 1; None of the file as a whole.
    """

    def __init__(
        self, path: str | PathLike[str], cause: Diagnostic, line: int | None = None
    ) -> None:
        self.path, self.cause, self.line = str(path), cause, line
        source = self.path if line is None else f"{self.path}:{line}"
        super().__init__(
            diagnose("model-unusable", source=source, problem=cause, sources=self.path)
        )


class UnknownNameError(ModelError):
    """A name is not in the model.

    Attributes:
        kind: ``"joint"``, ``"frame"``, ``"foot"``, ``"body"`` ...
        name: The unknown name.
        known: The names that would have been valid.
    """

    def __init__(
        self, source: str | PathLike[str], kind: str, name: str, known: Iterable[str]
    ) -> None:
        self.kind = kind
        self.name = name
        self.known = tuple(known)
        problem = diagnose("name-unknown", kind=Term(kind), unknown=name, known=self.known)
        super().__init__(source, problem)


class ConfigurationError(PupperAnalysisError):
    """A coordinate vector, or a value of a request, has a wrong shape or is out of its bounds.

    Attributes:
        field: The name of the argument.
        problem: What is wrong with it.
    """

    def __init__(self, field: str, problem: Problem) -> None:
        self.field, self.problem = field, problem
        super().__init__(diagnose("argument-not-valid", field=field, problem=problem))


_SEEN = 1e-3
"""Of the farthest foot's miss: less is how closely the search ends, and is in no message."""


class StanceUnreachableError(PupperAnalysisError):
    """No configuration inside the joint limits, and clear of obstacles, satisfies a stand task.

    Attributes:
        shortfall: How far each foot that cannot be planted ends from its target, in metres.
        at_limit: Joints that are at a limit in the best configuration found, with the limit (rad).
        possible: {demand: how far it can go}, for each demand that alone may give; if there is
            none, for as few as are found that together do ("height and roll"); none of them can be
            kept. Some may become more than the nominal stand has. Diagnostics.
        limits: The same as values of the task's fields, such as {"roll": {"roll": 0.337}}:
            ``replace(task, **limits["roll"])`` is in reach.
        nearest: The stand of the one of ``limits`` that gives least; None if there is none, or it
            was not asked for.
        blocked: What is in the way where the feet could be planted: a part in the ground, parts
            too near to each other, or a com too near to tipping. Diagnostics.
        lacks: What the robot would need that it has not; None if nothing is known.
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
    ) -> None:
        self.lacks = lacks
        self.limits = dict(limits or {})
        self.blocked = tuple(blocked)
        self.shortfall = dict(shortfall)
        self.at_limit = dict(at_limit)
        self.possible = dict(possible or {})
        self.nearest = nearest
        missing: dict[str, float] = {}  # of a sole's contact points, "foot/3", the one farthest off
        for point, gap in self.shortfall.items():
            name, _, number = point.rpartition("/")
            foot = name if name and number.isdigit() else point
            if gap > 0:
                missing[foot] = max(gap, missing.get(foot, 0.0))
        least = _SEEN * max(missing.values(), default=0.0)
        missed = [
            diagnose("foot-misses-target", subject=("foot", foot), gap=Quantity(gap, "m"))
            for foot, gap in missing.items()
            if gap >= least
        ]
        joints = [
            diagnose("joint-at-limit", subject=("joint", name), limit=Quantity(limit, "rad"))
            for name, limit in self.at_limit.items()
        ]
        feet = [diagnose("feet-miss-targets", feet=missed)] if missed else []
        super().__init__(
            diagnose(
                "stance-out-of-reach",
                task=task,
                obstacles=(*feet, *self.blocked),
                joints=joints,
                possible=self.possible.values(),
                advice=None if self.possible else lacks or diagnose("try-another-height"),
            )
        )


class Infeasibility(StrEnum):
    """Why no set of contact forces keeps a robot in balance."""

    NO_CONTACT = "no contact"
    COM_OUTSIDE = "com outside the support polygon"
    ZMP_OUTSIDE = "zero-moment point outside the support polygon"
    FRICTION = "friction too low"
    PULL = "a foot would have to pull"
    GRIP = "a grip is too weak"


class StaticsInfeasibleError(PupperAnalysisError):
    """No unilateral contact forces inside the friction cones balance the robot.

    Attributes:
        reason: The cause.
        margin: Signed distance of the com's projection to the support polygon's edge, in metres
            (negative: outside).
        friction_needed: The least friction coefficient that would do, or None where none would.
        feet: The feet concerned.
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
    """A file or folder cannot be written.

    Attributes:
        path: The file or folder.
    """

    def __init__(self, path: str | PathLike[str], problem: object) -> None:
        self.path = path
        message = problem if isinstance(problem, Diagnostic) else str(problem)
        super().__init__(diagnose("output-not-written", path=str(path), problem=message))


class NoEquilibriumError(PupperAnalysisError):
    """A servo-driven robot has no equilibrium near its stand.

    Attributes:
        share: Of the feed-forward, how much could be taken away before the equilibrium ended; None
            where that is not how it was looked for.
    """

    def __init__(self, share: float | None, problem: Problem) -> None:
        self.share = share
        super().__init__(diagnose("no-equilibrium", problem=problem))


class NotStandingError(PupperAnalysisError):
    """A servo-driven robot does not stay up where its stand lets it come to rest.

    Attributes:
        problems: Why: ``failures`` of the ``SteadyState``.
    """

    def __init__(self, problems: tuple[Problem, ...]) -> None:
        self.problems = problems
        super().__init__(diagnose("not-standing", problems=problems))


class NoStiffnessError(PupperAnalysisError):
    """Servos of no stiffness carry a robot in its stand without feed-forward.

    Attributes:
        kp: The stiffest servos that were tried (N m/rad).
        problem: Why it does not stand so with these.
    """

    def __init__(self, robot: str, kp: float, problem: Problem) -> None:
        self.kp = kp
        self.problem = problem
        stiffest = Quantity(kp, "N m/rad")
        super().__init__(diagnose("no-stiffness", robot=robot, kp=stiffest, problem=problem))


class NotSettlingError(PupperAnalysisError):
    """Quantities that determine each other do not settle by repeated substitution.

    Attributes:
        change: How much they still change from round to round, in their unit.
    """

    def __init__(self, change: float, problem: Problem) -> None:
        self.change = change
        super().__init__(diagnose("not-settling", problem=problem))


class MissingPackageError(PupperAnalysisError):
    """A package is not installed that only some users need.

    Attributes:
        package: Its name.
        extra: Which extra of ``pupper-analysis`` brings it.
    """

    def __init__(self, package: str, extra: str) -> None:
        self.package, self.extra = package, extra
        super().__init__(diagnose("package-missing", package=package, extra=extra))


class StudyError(PupperAnalysisError):
    """A study cannot be run, gone on with or read.

    Attributes:
        folder: Its folder.
        problem: What is wrong, and what would help.
    """

    def __init__(self, folder: str | PathLike[str], problem: Problem) -> None:
        self.folder = str(folder)
        self.problem = str(problem)
        super().__init__(diagnose("study-unusable", folder=self.folder, problem=problem))


class MeasurementError(PupperAnalysisError):
    """Measurements of a robot (stands, a log) cannot be used.

    Attributes:
        source: The file, or what stands for it.
        problem: What is wrong, and what would be valid.
        cause: The same, without its words where a diagnostic was given.
    """

    def __init__(self, source: str | PathLike[str], problem: Problem) -> None:
        self.source = str(source)
        self.problem = str(problem)
        self.cause = as_diagnostic(problem)
        message = diagnose("measurements-unusable", source=self.source, problem=problem)
        super().__init__(message)


class FitError(PupperAnalysisError):
    """A fit to measurements cannot be made: they contradict the robot, or lead nowhere.

    Attributes:
        problem: What is wrong, and what would help.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = str(problem)
        super().__init__(problem)
