"""The register of rules: each has its reasons in the catalogue, and a small function."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np

from pupper_analysis.base.diagnostics import Diagnostic, Severity
from pupper_analysis.base.results import Result, Tabular
from pupper_analysis.base.tools import formats
from pupper_analysis.models.loading import Check
from pupper_analysis.models.places import Place
from pupper_analysis.models.stated.model import Array, Link, RobotModel

MODEL_FORMATS = ("urdf", "mjcf", *formats())


@dataclass(frozen=True)
class Rule:
    """One thing that can be wrong in a file.

    Attributes:
        id: Its name in kebab case.
        severity: How bad it is, at its worst.
        title: What is wrong, in a few words.
        why: Why it matters.
        todo: What to do.
        chinese: {``"title"``, ``"why"`` or ``"todo"``: the same in Simplified Chinese}.
        formats: Which of ``MODEL_FORMATS`` it is for.
    """

    id: str
    severity: Severity
    title: str
    why: str
    todo: str
    chinese: Mapping[str, str]
    formats: tuple[str, ...] = MODEL_FORMATS


def _catalogue() -> dict[str, Rule]:
    """Reads what the rules are called, how bad they are, and their reasons and remedies.

    Those for a format of its own stand in ``rules.toml`` of its folder.
    """
    own = Path(__file__).parent / "rules/catalogue.toml"
    entries = tomllib.loads(own.read_text(encoding="utf-8"))
    for format in formats().values():
        if (file := format.folder / "rules.toml").is_file():
            theirs = tomllib.loads(file.read_text(encoding="utf-8"))
            entries |= {name: {"formats": [format.name], **entry} for name, entry in theirs.items()}
    rules = {}
    for name, entry in entries.items():
        words = _words(entry, entries[entry.get("like", name)], " ")
        chinese = _words(entry.get("zh", {}), entries[entry.get("like", name)]["zh"], "")
        stated = tuple(entry.get("formats", MODEL_FORMATS))
        severity = Severity(entry["severity"])
        rules[name] = Rule(name, severity, **words, chinese=chinese, formats=stated)
    return rules


def _words(own: Mapping[str, str], model: Mapping[str, str], space: str) -> dict[str, str]:
    """Returns title, reason and remedy in one language; what is not its own is the model's."""
    why = space.join([model["why"], *([own["more"]] if "more" in own else [])])
    return {"title": own["title"], "why": why, "todo": model["todo"]}


_CHECKS: dict[str, Check] = {}

RULES: Mapping[str, Rule] = MappingProxyType(_catalogue())
"""All rules, by id."""

CHECKS: Mapping[str, Check] = MappingProxyType(_CHECKS)
"""The function of each rule that is not of a format of its own."""


def rule(check: Check) -> Check:
    """Registers a check as that of the rule of its name: ``axis_zero`` of ``axis-zero``."""
    name = check.__name__.replace("_", "-")
    assert name in RULES, f"catalogue.toml has no rule {name}"
    _CHECKS[name] = check
    return check


@dataclass(frozen=True, eq=False)
class Finding(Result):
    """One thing that is wrong in a file.

    Attributes:
        rule: The id of the rule that found it.
        severity: The rule's, or a lesser one where the case is less bad.
        file: The file in which it stands (an included one, perhaps).
        line: Its line, from 1; None where it is nowhere in particular.
        prim: The path of its prim, in a USD; None in other files.
        element: ``link 'FL_calf'``.
        why: Why it matters.
        todo: What to do.
        diagnostic: What is wrong, as a code, of which a rule may have several, and numbers with
            units, of that element and place.
    """

    rule: str
    severity: Severity
    file: str
    line: int | None
    element: str
    why: str
    todo: str
    diagnostic: Diagnostic
    prim: str | None = None

    _reported = ("message",)

    @property
    def message(self) -> str:
        """One sentence with the numbers."""
        return str(self.diagnostic)

    @property
    def place(self) -> Place:
        """Where it stands: file and line, or file and prim."""
        return Place(Path(self.file), self.line, self.prim)

    def __str__(self) -> str:
        return f"{self.severity} {self.place} {self.element}: {self.message} [{self.rule}]"


@dataclass(frozen=True, eq=False)
class Audit(Tabular):
    """What is wrong in one file.

    Attributes:
        file: The file.
        format: One of ``MODEL_FORMATS``.
        passed: Whether nothing of severity ERROR was found.
        counts: How many findings of each severity.
        findings: The worst first, then by line.
        rules_run: The ids of the rules that were run.
        disabled: The ids of those that were not, on demand.
        notes: What was left out.
    """

    file: str
    format: str
    passed: bool
    counts: Mapping[str, int]
    findings: tuple[Finding, ...]
    rules_run: tuple[str, ...]
    disabled: tuple[str, ...]
    notes: tuple[Diagnostic, ...]

    def _columns(self) -> dict[str, list[object]]:
        names = ("rule", "severity", "file", "line", "element", "message")
        return {name: [getattr(found, name) for found in self.findings] for name in names}


# How far shapes reach.


def list_extent_points(bodies: Sequence[Link], frame: Link) -> Array | None:
    """Returns points (n, 3) that span all shapes of some bodies, in the frame of one of them (m).

    Returns:
        None if they have no shapes, or the extent of one is not known.
    """
    points, whole = list_known_points(bodies, frame)
    return points if whole else None


def list_known_points(bodies: Sequence[Link], frame: Link) -> tuple[Array | None, bool]:
    """Returns points of those shapes whose extent is known, and whether that is all of them.

    Returns:
        Points, shape (n, 3) [m], in the frame of ``frame``; None if no extent is known. True if the
        extents of all shapes are known; False for example if a mesh was not read.
    """
    to_frame, parts, whole = frame.pose.inverse(), [], True
    for body in bodies:
        for shape in body.shapes:
            points = shape.points
            if points is None:
                whole = False
            else:
                parts.append((to_frame * body.pose).point(points))
    return (np.concatenate(parts) if parts else None), whole


def list_link_points(robot: RobotModel, body: Link) -> Array:
    """Returns a body's origin, frames and children's origins (n, 3), in its frame (m)."""
    to_frame = body.pose.inverse()
    points = [np.zeros(3), *(frame.position for frame in body.frames)]
    points += [to_frame.point(child.pose.position) for child in robot.children(body.name)]
    return np.array(points)


def compute_hull_distance(points: Array, point: Array) -> float:
    """Returns how far a point is outside the convex hull of others, at least; <= 0 if inside (m).

    Of points that lie in a plane the bounding box is taken.
    """
    from scipy.spatial import ConvexHull, QhullError  # slow to import

    try:
        faces = ConvexHull(points).equations
    except (QhullError, ValueError):
        return float(np.max(np.maximum(points.min(0) - point, point - points.max(0))))
    return float(np.max(faces[:, :3] @ point + faces[:, 3]))
