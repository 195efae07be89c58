"""What is to be written where, for chosen differences."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.results import Result
from pupper_analysis.models.attributes import BY_KIND, JOINT_ATTRIBUTES
from pupper_analysis.models.mjcf_file import MjcfFile, read_mjcf
from pupper_analysis.models.urdf_file import UrdfFile, read_urdf
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.robot.build import placeholders_among
from pupper_analysis.robot.compare.attribution import align_robot
from pupper_analysis.robot.compare.differences import LIMITS, OF_BODIES_AND_PLACES, OF_INERTIALS
from pupper_analysis.robot.matching.match import match_models
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.tools.sync.digits import Digits
from pupper_analysis.tools.sync.frames import Key, MatchedRobots, pair_robots
from pupper_analysis.tools.sync.mjcf_in_place import MjcfInPlace
from pupper_analysis.tools.sync.mjcf_side import MjcfSide
from pupper_analysis.tools.sync.urdf_side import UrdfSide
from pupper_analysis.tools.sync.xml_bytes import Element, XmlDocument, read_document

_OF_BOTH = tuple(one.kind for one in JOINT_ATTRIBUTES if one.in_both)

_WRITTEN = (*OF_BODIES_AND_PLACES, *_OF_BOTH, "zero")
"""Kinds of differences that are numbers of both formats."""

_REASONS = {
    "type": diagnose("joint-type-unwritten"),
    "parent": diagnose("parent-unwritten"),
    "name": diagnose("name-unwritten"),
    "base frame": diagnose("base-frame-unwritten"),
    "gravity": diagnose("urdf-without-gravity"),
    "velocity": diagnose("mjcf-without-velocity"),
    "armature": diagnose("urdf-without-armature"),
    "mimic": diagnose("mimic-unwritten"),
    "collision": diagnose("collision-unwritten"),
}


class UnwrittenCause(StrEnum):
    """Why a difference is left."""

    NOT_CHOSEN = "not chosen"
    NOT_STATED = "not stated"
    """The file whose value was chosen states none."""
    NO_WORDS = "no words"
    """It is no number of both formats: structure, a convention, or what one of them lacks."""
    NOT_MENDED = "not mended"
    """It is a number of both, but cannot be written, or was tried and mends nothing."""
    NEW = "new"
    """It is there since other differences were mended."""


@dataclass(frozen=True)
class Edit(Result):
    """One attribute that is written.

    Attributes:
        file: The file.
        line: Of the element; of the element around it, where it is new.
        element: ``link base > inertial > mass``.
        attribute: Its name.
        old: What it was; None where there was none.
        new: What it is.
    """

    file: str
    line: int
    element: str
    attribute: str
    old: str | None
    new: str


@dataclass(frozen=True, eq=False)
class Files:
    """Two files, and how they are to be matched; the fields are those of `sync_models`."""

    urdf: Path
    mjcf: Path
    names: Mapping[str, str]
    packages: Mapping[str, Path]
    feet: tuple[str, ...]


@dataclass(eq=False)
class Plan:
    """What is to be written.

    Attributes:
        files: The files.
        urdf: {file: its document} of the URDF.
        mjcf: {file: its document} of the MJCF and what it includes, the main file first.
        left: {difference: why it is not written}.
        causes: {difference that is left: the kind of reason}; the others are not mended.
        notes: {difference: what is to be said}.
    """

    files: Files
    urdf: dict[Path, XmlDocument]
    mjcf: dict[Path, XmlDocument]
    left: dict[Key, Diagnostic] = field(default_factory=dict)
    causes: dict[Key, UnwrittenCause] = field(default_factory=dict)
    notes: dict[Key, Diagnostic] = field(default_factory=dict)

    def cause(self, key: Key) -> UnwrittenCause:
        """Returns why a difference is not written."""
        return self.causes.get(key, UnwrittenCause.NOT_MENDED)

    def documents(self) -> Iterator[XmlDocument]:
        """Yields all documents."""
        yield from self.urdf.values()
        yield from self.mjcf.values()

    def edits(self) -> tuple[Edit, ...]:
        """Returns what is written, file by file."""
        return edits_of(self.documents())


def edits_of(documents: Iterable[XmlDocument]) -> tuple[Edit, ...]:
    """Returns what is written into documents, one by one."""
    return tuple(
        edit for document in documents for element in document.elements for edit in _edits(element)
    )


def make_plan(
    files: Files, tolerances: Tolerances, taken: Mapping[Key, str], *, absent: bool = False
) -> Plan:
    """Plans what is to be written.

    Args:
        files: The files.
        tolerances: With which their differences were found.
        taken: {kind and element of a difference: ``"urdf"`` or ``"mjcf"``, whose value is taken}.
        absent: Whether what a file does not state is taken, too.
    """
    urdf, mjcf = read_urdf(files.urdf, files.packages), read_mjcf(files.mjcf)
    matched = match_models(urdf, mjcf, names=files.names, feet=files.feet, tolerances=tolerances)
    both = pair_robots(matched, align_robot(matched.robot, tolerances))
    theirs = list(mjcf.files)
    elements = MjcfInPlace(mjcf, Digits.of([urdf.path], theirs))
    document = read_document(urdf.path)
    plan = Plan(files, {files.urdf: document}, elements.documents)
    into_urdf = UrdfSide(
        tree=UrdfTree(document.root),
        sides=both,
        wanted=both.urdf,
        digits=Digits.of(theirs, [urdf.path]),
    )
    into_mjcf = MjcfSide(
        file=mjcf,
        elements=elements,
        sides=both,
        wanted=both.mjcf,
        digits=elements.digits,
    )
    for side, other in ((into_urdf, "mjcf"), (into_mjcf, "urdf")):
        keys = [key for key, whose in taken.items() if whose == other]
        for key in keys:
            if reason := _reason(key, other, both):
                plan.left[key], plan.causes[key] = reason, UnwrittenCause.NO_WORDS
            elif not absent and is_absent(key, other, both, urdf, mjcf):
                plan.left[key], plan.causes[key] = _unstated(other), UnwrittenCause.NOT_STATED
        keys = [key for key in keys if key not in plan.left]
        side.wanted = both.wanted("urdf" if other == "mjcf" else "mjcf", keys)
        side.plan(keys)
        plan.left |= side.left
        plan.notes |= side.notes
        stated = (both.urdf if other == "urdf" else both.mjcf).joints
        efforts = {name: stated[name].effort for name in matched.robot.joint_names}
        warned = dict[Key, Diagnostic]()
        for name, why in placeholders_among(matched.robot, efforts).items():
            note = diagnose("effort-taken-is-placeholder", why=why)
            if ("effort", name) in keys and note not in warned.values():  # one for all alike
                warned["effort", name] = note
        plan.notes = warned | plan.notes | warned  # before what is said of how it is written
    return plan


def _reason(key: Key, whose: str, both: MatchedRobots) -> Diagnostic | None:
    """Says why a difference is nothing to write; None if it is."""
    kind, name = key
    if kind not in _WRITTEN:
        if kind in _REASONS:
            return _REASONS[kind]
        if whose == "mjcf":
            return diagnose("urdf-without-words")
        return diagnose("mjcf-alone-states-it")
    if kind in ("position", "rotation"):
        one, two = both.urdf.joints[name], both.mjcf.joints[name]
        if one.parent != two.parent:
            return diagnose("parent-is-another")
    return None


def _unstated(whose: str) -> Diagnostic:
    one, two = ("URDF", "MJCF") if whose == "urdf" else ("MJCF", "URDF")
    return diagnose("stated-in-one-file", lacking=one, stating=two)


def _edits(element: Element) -> Iterator[Edit]:
    """Yields what is written of an element, and of its children that are new."""
    taken = {new: old for old, new in element.renamed.items()}
    for attribute, text in element.changes.items():
        old = element.attributes.get(taken.get(attribute, attribute))
        name = attribute if attribute not in taken else f"{taken[attribute]} -> {attribute}"
        yield Edit(str(element.file), element.line, _words(element), name, old, text)
    for child in element.children:
        if child.start < 0:
            yield from _edits(child)


def _words(element: Element) -> str:
    """Names an element by those around it, up to the first that has a name."""
    words = []
    here: Element | None = element
    while here is not None:
        name = here.attributes.get("name") or here.attributes.get("joint")
        words.append(f"{here.tag} {name}" if name else here.tag)
        here = None if name else here.parent
    return " > ".join(reversed(words))


def is_absent(key: Key, whose: str, both: MatchedRobots, urdf: UrdfFile, mjcf: MjcfFile) -> bool:
    """Says whether the file whose value shall be taken states none.

    A limit that is not there is infinite, a damping or a friction 0, and so is the mass of a body
    without an <inertial>: that is how the engines read it, and not what anybody has written. A
    URDF must state an effort, and 0 is what exporters write where they know none.

    Args:
        key: The kind and the element of a difference.
        whose: ``"urdf"`` or ``"mjcf"``.
        both: Both robots.
        urdf: The URDF.
        mjcf: The MJCF.
    """
    kind, name = key
    side = both.urdf if whose == "urdf" else both.mjcf
    if kind == "effort" and whose == "urdf" and name in side.joints:
        return not 0 < side.joints[name].effort < math.inf
    attribute = BY_KIND.get(kind)
    if kind in LIMITS and attribute is not None:
        return name in side.joints and math.isinf(getattr(side.joints[name], attribute.field))
    if kind in OF_INERTIALS:
        return name in side.bodies and not side.bodies[name].mass > 0
    if attribute is None or attribute.urdf is None or name not in side.joints:
        return False
    if getattr(side.joints[name], attribute.field):
        return False
    if whose == "mjcf":
        return mjcf.stated("joint", name, attribute.mjcf) is None
    return urdf.tree.joints[both.matched.urdf_joint[name]].stated(attribute) is None
