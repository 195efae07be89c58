"""Registry of the audit rules, and the extent of the shapes of a link.

A rule consists of an entry in ``rules/catalogue.toml`` (severity, texts) and a check: a function
that yields the findings in a robot model. `rule` registers a check under the name of the function.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, Severity
from pupper_analysis.base.results import Result, Tabular
from pupper_analysis.base.tools import formats
from pupper_analysis.models.loading import Check
from pupper_analysis.models.places import Place
from pupper_analysis.models.stated.model import Link, RobotModel

MODEL_FORMATS = ("urdf", "mjcf", *formats())
"""Names of all supported file formats, including formats of other packages."""


@dataclass(frozen=True)
class Rule:
    """Rule of the audit: severity and texts of the catalogue entry, without the check function.

    Attributes:
        id: Name in kebab case.
        severity: Severity of a finding, unless the check states another.
        title: Violation, in a few words.
        why: Reason for the rule.
        todo: Recommended repair.
        chinese: {``"title"``, ``"why"`` or ``"todo"``: text in Simplified Chinese}.
        formats: Members of `MODEL_FORMATS` to which the rule applies.
        precedence: Position among findings of equal severity. 0: errors that cause other findings,
            such as a wrong unit of length. 1: wrong values. 2: differences between left and right.
            3: consequences, such as a robot that falls.
    """

    id: str
    severity: Severity
    title: str
    why: str
    todo: str
    chinese: Mapping[str, str]
    formats: tuple[str, ...] = MODEL_FORMATS
    precedence: int = 1


def _read_catalogue() -> dict[str, Rule]:
    """Read {id: rule} of the catalogue, and of ``rules.toml`` of further formats, such as USD."""
    own = Path(__file__).parent / "rules/catalogue.toml"
    entries = tomllib.loads(own.read_text(encoding="utf-8"))
    for format in formats().values():
        if (file := format.folder / "rules.toml").is_file():
            format_entries = tomllib.loads(file.read_text(encoding="utf-8"))
            entries |= {
                name: {"formats": [format.name], **entry} for name, entry in format_entries.items()
            }
    rules = {}
    for name, entry in entries.items():
        words = _merge_texts(entry, entries[entry.get("like", name)], " ")
        chinese = _merge_texts(entry.get("zh", {}), entries[entry.get("like", name)]["zh"], "")
        stated = tuple(entry.get("formats", MODEL_FORMATS))
        severity = Severity(entry["severity"])
        precedence = int(entry.get("precedence", 1))
        rules[name] = Rule(
            name, severity, **words, chinese=chinese, formats=stated, precedence=precedence
        )
    return rules


def _merge_texts(own: Mapping[str, str], model: Mapping[str, str], space: str) -> dict[str, str]:
    """Complete the texts {"title", "why" or "todo": text} of a rule with texts of a similar rule.

    ``space`` separates both parts of the reason: a space in English, none in Chinese.
    """
    why = space.join([model["why"], *([own["more"]] if "more" in own else [])])
    return {"title": own["title"], "why": why, "todo": model["todo"]}


_REGISTERED_CHECKS: dict[str, Check] = {}
"""{id of a rule: function that yields the findings of the rule}, filled by the decorator `rule`."""

RULES: Mapping[str, Rule] = MappingProxyType(_read_catalogue())
"""{id: rule} of all formats."""

CHECKS: Mapping[str, Check] = MappingProxyType(_REGISTERED_CHECKS)
"""{id of a rule: function that yields the findings of the rule}. Other packages may register
formats and additional checks.
"""


def rule(check: Check) -> Check:
    """Register a function as the check of an audit rule; used as a decorator.

    The name of the function determines the rule: ``axis_zero`` checks the rule ``axis-zero``.
    """
    name = check.__name__.replace("_", "-")
    assert name in RULES, f"catalogue.toml has no rule {name}"
    _REGISTERED_CHECKS[name] = check
    return check


@dataclass(frozen=True)
class ValueRepair(Result):
    """Proposed repair of a finding: new attribute values of an element, or a new element.

    Attributes:
        file: File to be changed.
        tag: Tag of the named element, for example ``link``.
        name: Name of the element.
        child: Path from the named element to the changed element, as visual[2]/origin; "" for the
            named element.
        old: {attribute: text in the file}; "" for an attribute that is missing in the file.
        new: {attribute: new text}.
        reason: Source of the new values.
        further: Changes of other elements that belong to the same repair.
    """

    file: str
    tag: str
    name: str
    child: str
    old: Mapping[str, str]
    new: Mapping[str, str]
    reason: Diagnostic
    further: tuple[ValueRepair, ...] = ()

    @property
    def is_estimate(self) -> bool:
        """Whether the new mass is guessed from the density of other links."""
        return self.reason.code == "repair-density"

    def list_changes(self) -> tuple[ValueRepair, ...]:
        """Return the changes of elements that form one repair: this change and ``further``."""
        return (self, *self.further)


@dataclass(frozen=True, eq=False)
class Finding(Result):
    """Violation of an audit rule in a file, with place, message and repairs.

    Attributes:
        rule: Id of the rule.
        severity: Severity of the rule, unless the check states another.
        file: File that contains the violation, possibly an included file.
        line: Line from 1; None if the finding has no line.
        prim: Path of the prim in a USD; None in other files.
        repairs: Proposed new values: a single repair if unique, otherwise several candidates. Empty
            without a proposal.
        element: Kind and name of the element, for example ``link 'FL_calf'``; kind only, if the
            element has no name.
        why: Reason for the rule.
        todo: Recommended repair.
        diagnostic: Message as code and values with units. A rule may use several codes.
    """

    _key_fields: ClassVar[tuple[str, ...]] = ("rule", "severity")

    rule: str
    severity: Severity
    file: str
    line: int | None
    element: str
    why: str
    todo: str
    diagnostic: Diagnostic
    prim: str | None = None
    repairs: tuple[ValueRepair, ...] = ()

    _reported = ("message",)

    @property
    def message(self) -> str:
        """Description of the finding in English."""
        return str(self.diagnostic)

    @property
    def place(self) -> Place:
        """File and line of the finding, or file and path of the prim in a USD."""
        return Place(Path(self.file), self.line, self.prim)

    def __str__(self) -> str:
        return f"{self.severity} {self.place} {self.element}: {self.message} [{self.rule}]"


@dataclass(frozen=True, eq=False)
class Audit(Tabular):
    """Result of the audit of a model file: findings, and rules that were run.

    Attributes:
        file: Path of the file.
        format: Format of the file.
        passed: True if there is no finding of severity ERROR.
        counts: Number of findings of each severity.
        findings: Findings, sorted by severity, then causes before consequences (`Rule.precedence`),
            file and line.
        rules_run: Ids of the rules that were run.
        disabled: Ids of the rules that the caller disabled.
        notes: Messages from reading the file, for example about elements that were left out.
        floating: True if the base counts as free, for example if a URDF or MJCF contains a free
            joint, or if two or more limbs are attached to the base.
    """

    _key_fields: ClassVar[tuple[str, ...]] = ("passed", "counts", "findings")

    file: str
    format: str
    passed: bool
    counts: Mapping[str, int]
    findings: tuple[Finding, ...]
    rules_run: tuple[str, ...]
    disabled: tuple[str, ...]
    notes: tuple[Diagnostic, ...]
    floating: bool

    def _columns(self) -> dict[str, list[object]]:
        """Return the columns of a table of the findings of an audit, a row per finding."""
        names = ("rule", "severity", "file", "line", "element", "message")
        return {name: [getattr(found, name) for found in self.findings] for name in names}


# Extent of shapes.


def list_extent_points(bodies: Sequence[Link], frame: Link) -> Array | None:
    """Return points that span approximately the convex hull of all shapes of some links.

    The joints between the links have zero angles.

    Args:
        bodies: Links with visual and collision shapes.
        frame: Link; the points are expressed in the frame of this link.

    Returns:
        Points, shape (n, 3) [m]. None if there are no shapes, or the size of a shape is unknown.
    """
    points, is_complete = list_known_points(bodies, frame)
    return points if is_complete else None


def list_known_points(bodies: Sequence[Link], frame: Link) -> tuple[Array | None, bool]:
    """Return points that span approximately the convex hull of the links' shapes of known size.

    The joints between the links have zero angles.

    Args:
        bodies: Links with visual and collision shapes.
        frame: Link; the points are expressed in the frame of this link.

    Returns:
        Points, shape (n, 3) [m], or None if no size is known; True if the sizes of all shapes are
        known.
    """
    to_frame, parts, is_complete = frame.pose.inverse(), [], True
    for body in bodies:
        for shape in body.shapes:
            points = shape.points
            if points is None:
                is_complete = False
            else:
                parts.append((to_frame * body.pose).point(points))
    return (np.concatenate(parts) if parts else None), is_complete


def list_link_points(robot: RobotModel, body: Link) -> Array:
    """Return the origins of a link, of the link's frames and of the child links, as points.

    Returns:
        Points, shape (n, 3) [m], in the frame of the link.
    """
    to_frame = body.pose.inverse()
    points = [np.zeros(3), *(frame.position for frame in body.frames)]
    points += [to_frame.point(child.pose.position) for child in robot.children(body.name)]
    return np.array(points)


def compute_hull_volume(points: Array) -> float:
    """Compute the volume of the convex hull of points, shape (n, 3) [m], in m^3; 0 if flat."""
    from pupper_analysis.base.qhull import ConvexHull, QhullError  # loads SciPy

    try:
        return float(ConvexHull(points).volume)
    except (QhullError, ValueError):
        return 0.0


def compute_hull_distance(points: Array, point: Array) -> float:
    """Compute a lower bound of the distance between a point and the convex hull of points.

    Args:
        points: Points, shape (n, 3) [m], or (n, 2) in a plane.
        point: Point, shape (3,) or (2,) [m].

    Returns:
        Largest signed distance [m] to the planes of the hull's faces: positive outside the hull,
        negative inside. For a flat hull, the largest signed distance to the sides of the bounding
        box.
    """
    from pupper_analysis.base.qhull import ConvexHull, QhullError  # loads SciPy

    try:
        faces = ConvexHull(points).equations
    except (QhullError, ValueError):
        return float(np.max(np.maximum(points.min(0) - point, point - points.max(0))))
    return float(np.max(faces[:, :-1] @ point + faces[:, -1]))
