"""Typed errors: one base class; each names what is wrong and what would be valid."""

from __future__ import annotations

import reprlib
from collections.abc import Iterable, Mapping
from enum import StrEnum
from os import PathLike
from typing import Any, Self, TypeVar

_E = TypeVar("_E", bound="PupperAnalysisError")


class PupperAnalysisError(Exception):
    """Base class of every error that the package raises on purpose.

    Errors survive pickling, whatever arguments their classes take, so that they come back whole
    from other processes.

    Attributes:
        where: In which part of a longer task it happened ("at 0.50 s, ..."); empty otherwise.
    """

    where: str = ""

    def at(self, where: str) -> Self:
        """Returns the same error, with all it carries, whose message begins with where it was."""
        error = _restore(type(self), (f"{where}: {self}",), vars(self))
        error.where = where
        return error

    def __reduce__(self) -> tuple[Any, ...]:
        return _restore, (type(self), self.args, vars(self))


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

    def __init__(self, field: str, value: object, valid: str) -> None:
        self.field = field
        self.value = value
        super().__init__(f"{field} {reprlib.repr(value)} is not valid; {valid}")


class ModelError(PupperAnalysisError):
    """A model file cannot be used.

    Attributes:
        source: The file (or the model) at fault.
        problem: What is wrong, and what would be valid.
    """

    def __init__(self, source: str | PathLike[str], problem: str) -> None:
        self.source = str(source)
        self.problem = problem
        super().__init__(f"{self.source}: {problem}")


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
        super().__init__(source, f"no {kind} {name!r}; there are: {', '.join(self.known) or '-'}")


class ConfigurationError(PupperAnalysisError):
    """A coordinate vector, or a value of a request, has a wrong shape or is out of its bounds.

    Attributes:
        field: The name of the argument.
    """

    def __init__(self, field: str, problem: str) -> None:
        self.field = field
        super().__init__(f"{field}: {problem}")


class StanceUnreachableError(PupperAnalysisError):
    """No configuration inside the joint limits, and clear of obstacles, satisfies a stand task.

    Attributes:
        shortfall: How far each foot that cannot be planted ends from its target, in metres.
        at_limit: Joints that are at a limit in the best configuration found, with the limit (rad).
        possible: {demand: how far it can go}, for each demand that alone is in the way, in words;
            if there is none, for each two that are together ("height and roll"), or each three ...
        limits: The same as values of the task's fields, such as {"roll": {"roll": 0.337}}:
            ``replace(task, **limits["roll"])`` is in reach.
        nearest: A stand that is in reach, with all demands shrunk alike towards the nominal stand;
            None if there is none, or it was not asked for.
        blocked: What is in the way where the feet could be planted: a part in the ground, parts
            too near to each other, or a com too near to tipping, in words.
        lacks: What the robot would need that it has not, in words; empty if nothing is known.
    """

    def __init__(
        self,
        task: str,
        shortfall: Mapping[str, float],
        at_limit: Mapping[str, float],
        possible: Mapping[str, str] | None = None,
        nearest: Any = None,
        blocked: Iterable[str] = (),
        limits: Mapping[str, Mapping[str, Any]] | None = None,
        lacks: str = "",
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
        feet = ", ".join(f"{foot} by {_short(1e3 * gap)} mm" for foot, gap in missing.items())
        missed = [f"the feet miss their targets: {feet}"] if feet else []
        text = f"stance out of reach ({task}): {'; '.join((*missed, *self.blocked))}"
        if self.at_limit:
            joints = ", ".join(
                f"{name} ({limit:+.2f} rad)" for name, limit in self.at_limit.items()
            )
            text += f"; joints at a limit: {joints}"
        if self.possible:
            text += f". Possible with all else as asked: {', or '.join(self.possible.values())}"
        elif lacks:
            text += f". {lacks}"
        else:
            text += ". Try another height, or less roll, pitch or yaw"
        super().__init__(f"{text}.")


def _short(value: float) -> str:
    """Returns a number with one decimal; a smaller one with one digit, as it is not zero."""
    return f"{value:.1f}" if value >= 0.05 else f"{value:.0e}"


class Infeasibility(StrEnum):
    """Why no set of contact forces keeps a robot in balance."""

    NO_CONTACT = "no contact"
    COM_OUTSIDE = "com outside the support polygon"
    ZMP_OUTSIDE = "zero-moment point outside the support polygon"
    FRICTION = "friction too low"
    PULL = "a foot would have to pull"
    MOTOR = "a motor is too weak"


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
        detail: str,
        *,
        margin: float,
        friction_needed: float | None = None,
        feet: Iterable[str] = (),
    ) -> None:
        self.reason = reason
        self.margin = margin
        self.friction_needed = friction_needed
        self.feet = tuple(feet)
        super().__init__(f"no static balance: {reason.value}: {detail}")


class OutputError(PupperAnalysisError):
    """A file or folder cannot be written.

    Attributes:
        path: The file or folder.
    """

    def __init__(self, path: str | PathLike[str], problem: object) -> None:
        self.path = path
        super().__init__(f"cannot write {path}: {problem}")


class NoEquilibriumError(PupperAnalysisError):
    """A servo-driven robot has no equilibrium near its stand.

    Attributes:
        share: Of the feed-forward, how much could be taken away before the equilibrium ended; None
            where that is not how it was looked for.
    """

    def __init__(self, share: float | None, problem: str) -> None:
        self.share = share
        super().__init__(f"no equilibrium: {problem}")


class NotStandingError(PupperAnalysisError):
    """A servo-driven robot does not stay up where its stand lets it come to rest.

    Attributes:
        problems: Why: ``failures`` of the ``SteadyState``.
    """

    def __init__(self, problems: tuple[str, ...]) -> None:
        self.problems = problems
        super().__init__("; ".join(problems))


class NoStiffnessError(PupperAnalysisError):
    """Servos of no stiffness carry a robot in its stand without feed-forward.

    Attributes:
        kp: The stiffest servos that were tried (N m/rad).
        problem: Why it does not stand so with these.
    """

    def __init__(self, robot: str, kp: float, problem: str) -> None:
        self.kp = kp
        self.problem = problem
        super().__init__(
            f"{robot} does not stand so without feed-forward with any kp: with {kp:.3g} N m/rad "
            f"{problem}"
        )


class NotSettlingError(PupperAnalysisError):
    """Quantities that determine each other do not settle by repeated substitution.

    Attributes:
        change: How much they still change from round to round, in their unit.
    """

    def __init__(self, change: float, problem: str) -> None:
        self.change = change
        super().__init__(problem)


class MissingPackageError(PupperAnalysisError):
    """A package is not installed that only some users need.

    Attributes:
        package: Its name.
        extra: Which extra of ``pupper-analysis`` brings it.
    """

    def __init__(self, package: str, extra: str) -> None:
        self.package, self.extra = package, extra
        super().__init__(
            f"{package} is not installed: pip install {package}, or pip install "
            f"'pupper-analysis[{extra}]'"
        )


class StudyError(PupperAnalysisError):
    """A study cannot be run, gone on with or read.

    Attributes:
        folder: Its folder.
        problem: What is wrong, and what would help.
    """

    def __init__(self, folder: str | PathLike[str], problem: str) -> None:
        self.folder = str(folder)
        self.problem = problem
        super().__init__(f"study {self.folder}: {problem}")
