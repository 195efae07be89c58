"""Reads a URDF: what it must be, where its elements stand, and what its meshes are."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass, field
from functools import cached_property
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from types import MappingProxyType
from typing import Final

from lxml import etree

from pupper_analysis.base.arguments import check_type
from pupper_analysis.base.diagnostics import Diagnostic, Term, diagnose
from pupper_analysis.base.runs import current_run
from pupper_analysis.models.attributes import JOINT_ATTRIBUTES
from pupper_analysis.models.places import (
    Place,
    innermost_element,
    line_of,
    quote_short,
    refusal_at,
    refuse_file,
)
from pupper_analysis.models.published import existing_file, folders_of_package
from pupper_analysis.models.urdf_tree import UrdfJoint, UrdfTree
from pupper_analysis.models.xml import MAX_DEPTH, MAX_NUMBER, NUMBER_PATTERN, parse_xml, to_text


@dataclass(frozen=True, eq=False)
class UrdfFile:
    """A URDF that can be loaded.

    Attributes:
        path: The file.
        text: Its XML.
        root: The parsed XML, without comments; ``sourceline`` is an element's line.
        packages: Folders of packages, for ``package://``.
        notes: What was assumed on reading.
        unknown: {kind of a joint's number: the joints of which it is not known}, where this stands
            for a file of another format that can leave open what a URDF takes for none.
        stands_for: What the file of another format is called for which this stands, such as
            ``"the SDF"``; "" if for none.
        gains: {joint: stiffness and damping of its servo} (N m/rad, N m s/rad; N/m, N s/m) that
            such a file states; None where its format states none.
    """

    path: Path
    text: str = field(repr=False)
    root: etree._Element = field(repr=False)
    packages: Mapping[str, Path] = field(default_factory=dict)
    notes: tuple[Diagnostic, ...] = ()
    unknown: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    stands_for: str = ""
    gains: Mapping[str, tuple[float, float]] | None = None

    @cached_property
    def tree(self) -> UrdfTree:
        """Its links and joints."""
        return UrdfTree(self.root)

    def place(self, kind: str, name: str, child: str | None = None) -> Place:
        """Finds an element.

        Args:
            kind: Its tag: ``"link"``, ``"joint"``, ``"material"`` ...
            name: Its name.
            child: A path below it (``"limit"``, ``"inertial/mass"``): the innermost that exists.

        Returns:
            Its file and line; the file alone where there is no such element.
        """
        element = self._named.get((kind, name))
        if element is None:
            return Place(self.path)
        found = innermost_element(element, child, lambda parent, tag: parent.find(tag))
        return Place(self.path, line_of(found))

    def nth(self, link: str, tag: str, number: int) -> Place:
        """Finds the n-th element of a tag, from 0, in a link; the link where it has no so many."""
        element = self._named.get(("link", link))
        found = [] if element is None else element.findall(tag)
        if number >= len(found):
            return self.place("link", link)
        return Place(self.path, line_of(found[number]))

    @cached_property
    def _named(self) -> dict[tuple[str, str | None], etree._Element]:
        """{(tag, name): element}; those below the root go before those deeper down."""
        elements = [*self.root, *self.root.iter()]
        return {(e.tag, e.get("name")): e for e in reversed(elements)}

    def resolve_mesh(self, filename: str) -> Path | None:
        """Finds the file that a mesh's ``filename`` means.

        ``package://NAME/...`` and ``model://NAME/...`` are looked up in ``packages``, then in the
        folders of ``ROS_PACKAGE_PATH``, then in the folders above the URDF, as it is named and as
        its links lead; last, these folders are taken for the package or a folder of it, as a copy
        may be called otherwise. Other names are relative to the URDF.

        Returns:
            The file, or None where there is none.
        """
        scheme, separator, rest = filename.partition("://")
        if not separator:
            return existing_file(self.path.parent / filename)
        if scheme == "file":
            return existing_file(self.path.parent / rest)
        if scheme not in ("package", "model"):
            return None
        package, _, inside = rest.lstrip("/").partition("/")
        for folder in self._package_folders(package):
            found = existing_file(folder / inside)
            if found is not None:
                return found
        parts = Path(inside).parts
        copied = (Path(*parts[below:]) for below in range(1, len(parts) - 1))
        places = (folder / part for part in copied for folder in self.path.absolute().parents)
        return next(filter(None, map(existing_file, places)), None)

    def _package_folders(self, package: str) -> Iterator[Path]:
        if package in self.packages:
            yield Path(self.packages[package])
        for entry in filter(None, os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)):
            yield from folders_of_package(Path(entry), package)
        # A link is looked up from where it is, and from where it leads to: of a workspace that is
        # linked together, either may be the package's.
        for path in dict.fromkeys((self.path.absolute(), self.path.resolve())):
            for folder in path.parents:
                yield from folders_of_package(folder, package)
        yield from self.path.absolute().parents


def read_urdf(path: str | Path, packages: Mapping[str, Path] | None = None) -> UrdfFile:
    """Reads a URDF.

    Args:
        path: The file.
        packages: Folders of packages, for ``package://``.

    Raises:
        ModelError: If it cannot be loaded; one line that tells where and why.
    """
    check_type("urdf", path, str | Path)
    path = Path(path)
    text, root = parse_xml(path)
    return urdf_from(path, text, root, packages)


def urdf_from(
    path: Path, text: str, root: etree._Element, packages: Mapping[str, Path] | None
) -> UrdfFile:
    """Makes a URDF of its root element, after all checks.

    Raises:
        ModelError: If it cannot be loaded; one line that tells where and why.
    """
    if root.tag != "robot":
        mjcf = root.tag == "mujoco"
        raise refusal_at(path, root, diagnose("no-urdf", tag=str(root.tag), mjcf=mjcf))
    if not root.get("name"):
        raise refusal_at(path, root, diagnose("robot-without-name"))
    if root.get("version") not in (None, "1", "1.0"):
        raise refusal_at(path, root, diagnose("version-unknown", version=root.get("version")))
    completed = complete_limits(root)
    notes = [] if completed is None else [completed]
    rewritten = bool(notes)
    materials = distinct_children(path, root, "material")
    links = distinct_children(path, root, "link")
    joints = distinct_children(path, root, "joint")
    if not links:
        raise refuse_file(Place(path), diagnose("no-links"))
    if len(links) > MAX_LINKS:
        raise refuse_file(Place(path), diagnose("too-many-links", count=len(links), most=MAX_LINKS))
    for element in (*links.values(), *joints.values(), *materials.values()):
        rewritten |= check_element(path, element)
    for name, joint in joints.items():
        check_joint(path, name, joint, links)
        mimic = joint.find("mimic")
        if mimic is not None and mimic.get("joint") not in joints.keys() - {name}:
            leader = str(mimic.get("joint"))
            notes.append(diagnose("mimic-of-no-joint", subject=("joint", name), leader=leader))
    check_tree(path, links, joints)
    unlimited = [joint.name for joint in unlimited_joints(root)]
    notes += [diagnose("range-unstated", names=unlimited)] if unlimited else []
    if rewritten or unlimited:
        text = for_engines(root)
    file = UrdfFile(path, text, root, MappingProxyType(dict(packages or {})), tuple(notes))
    if current_run() is not None:  # a command may not look at them, and must not lose them
        for element in root.iter("mesh", "texture"):
            file.resolve_mesh(element.get("filename") or "")
    return file


MAX_LINKS: Final = 2000
"""Most links of a URDF."""

_JOINT_TYPES: Final = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
_INERTIA: Final = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")

# The attributes that hold numbers, and how many; and those that must be there.
_NUMBERS: Final[Mapping[str, Mapping[str, int]]] = {
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "mass": {"value": 1},
    "inertia": dict.fromkeys(_INERTIA, 1),
    **{
        tag: dict.fromkeys(
            (one.urdf[1] for one in JOINT_ATTRIBUTES if one.urdf and one.urdf[0] == tag), 1
        )
        for tag in ("limit", "dynamics")
    },
    "mimic": {"multiplier": 1, "offset": 1},
    "box": {"size": 3},
    "cylinder": {"radius": 1, "length": 1},
    "capsule": {"radius": 1, "length": 1},
    "sphere": {"radius": 1},
    "mesh": {"scale": 3},
    "color": {"rgba": 4},
}

_REQUIRED: Final[Mapping[str, tuple[str, ...]]] = {
    "mass": ("value",),
    "inertia": _INERTIA,
    "mimic": ("joint",),
    "box": ("size",),
    "cylinder": ("radius", "length"),
    "capsule": ("radius", "length"),
    "sphere": ("radius",),
    "mesh": ("filename",),
    "parent": ("link",),
    "child": ("link",),
}

# Which children an element may have once only, and which it must have.
_ONCE: Final[Mapping[str, tuple[str, ...]]] = {
    "link": ("inertial",),
    "inertial": ("origin", "mass", "inertia"),
    "visual": ("origin", "geometry"),
    "collision": ("origin", "geometry"),
    "joint": ("origin", "parent", "child", "axis", "limit", "dynamics", "mimic"),
}

_MUST: Final[Mapping[str, tuple[str, ...]]] = {
    "inertial": ("mass", "inertia"),
    "visual": ("geometry",),
    "collision": ("geometry",),
    "joint": ("parent", "child"),
}

_KNOWN: Final = frozenset((*_NUMBERS, *_REQUIRED, *_ONCE, *_MUST, "geometry", "material"))


def distinct_children(path: Path, root: etree._Element, tag: str) -> dict[str, etree._Element]:
    """Returns the root's children of a kind by name; the names are to be distinct."""
    found: dict[str, etree._Element] = {}
    for element in root.findall(tag):
        name = element.get("name")
        if not name:
            raise refusal_at(path, element, diagnose("element-without-name", tag=tag))
        if name in found:
            first = line_of(found[name])
            problem = diagnose("name-taken", subject=(tag, name), line=first)
            raise refusal_at(path, element, problem)
        found[name] = element
    return found


def check_element(path: Path, element: etree._Element) -> bool:
    """Checks the children and numbers of a link or joint; returns whether it had to rewrite any."""
    rewritten = False
    what = str(element.tag), str(element.get("name"))
    pending = [element]
    while pending:
        part = pending.pop()
        children = [child for child in part if child.tag in _KNOWN]
        tags = [child.tag for child in children]
        for tag in _ONCE.get(part.tag, ()):
            if tags.count(tag) > 1:
                again = [child for child in children if child.tag == tag][1]
                problem = diagnose("child-more-than-once", subject=what, tag=tag)
                raise refusal_at(path, again, problem)
        for tag in _MUST.get(part.tag, ()):
            if tag not in tags:
                problem = diagnose("child-missing", subject=what, tag=part.tag, child=tag)
                raise refusal_at(path, part, problem)
        for attribute in _REQUIRED.get(part.tag, ()):
            if part.get(attribute) is None:
                missing = {"tag": part.tag, "attribute": attribute}
                raise refusal_at(path, part, diagnose("attribute-missing", subject=what, **missing))
        for attribute, count in _NUMBERS.get(part.tag, {}).items():
            value = part.get(attribute)
            if value is None:
                continue
            _check_numbers(path, part, attribute, value, count, what)
            tidy = " ".join(value.split())
            if tidy != value:
                part.set(attribute, tidy)
                rewritten |= count == 1
        if part.tag == "dynamics" and not (part.get("damping") or part.get("friction")):
            raise refusal_at(path, part, diagnose("dynamics-states-nothing", subject=what))
        pending.extend(children)
    return rewritten


def _check_numbers(
    path: Path, part: etree._Element, attribute: str, value: str, count: int, what: tuple[str, str]
) -> None:
    where = {"tag": part.tag, "attribute": attribute, "value": quote_short(value)}
    numbers = value.split()
    if len(numbers) != count:
        problem = diagnose(
            "wrong-count-of-numbers", subject=what, **where, count=len(numbers), wanted=count
        )
        raise refusal_at(path, part, problem)
    for number in numbers:
        if "${" in number or "$(" in number:
            raise refusal_at(path, part, diagnose("value-is-xacro", subject=what, **where))
        if not NUMBER_PATTERN.fullmatch(number) or not math.isfinite(float(number)):
            where |= {"number": quote_short(number)}
            raise refusal_at(path, part, diagnose("number-not-finite", subject=what, **where))
        # A limit may be as large as can be: exporters write that for none.
        if part.tag != "limit" and abs(float(number)) > MAX_NUMBER:
            where |= {"number": quote_short(number)}
            problem = diagnose("number-too-large", subject=what, **where, most=MAX_NUMBER)
            raise refusal_at(path, part, problem)


def check_joint(
    path: Path,
    name: str,
    joint: etree._Element,
    links: Mapping[str, etree._Element],
) -> None:
    """Refuses an unknown type, a missing limit, and ends that are no links."""
    what = "joint", name
    kind = joint.get("type")
    if kind not in _JOINT_TYPES:
        problem = diagnose("joint-type-unknown", subject=what, kind=kind, valid=_JOINT_TYPES)
        raise refusal_at(path, joint, problem)
    if kind in ("revolute", "prismatic") and joint.find("limit") is None:
        turns = kind == "revolute"
        problem = diagnose("limit-missing", subject=what, kind=Term(kind), turns=turns)
        raise refusal_at(path, joint, problem)
    moves = kind in ("revolute", "continuous", "prismatic")
    # Pinocchio's world, and its joint of a free base: it takes this one for them, or drops masses.
    if name == "universe" or (name == "root_joint" and moves):
        raise refusal_at(path, joint, diagnose("joint-name-reserved", subject=what))
    for tag in ("parent", "child"):
        end = joint.find(tag)
        if end.get("link") not in links:
            link = str(end.get("link"))
            problem = diagnose("joint-end-no-link", subject=what, end=Term(tag), link=link)
            raise refusal_at(path, end, problem)


def check_tree(
    path: Path, links: Mapping[str, etree._Element], joints: Mapping[str, etree._Element]
) -> None:
    """Refuses joints that do not make the links one tree."""
    above: dict[str, str] = {}
    through: dict[str, str] = {}
    for name, joint in joints.items():
        child = joint.find("child").get("link")
        if child in above:
            joints_of = (through[child], name)
            problem = diagnose("link-of-two-joints", subject=("link", child), joints=joints_of)
            raise refusal_at(path, joint, problem)
        above[child] = joint.find("parent").get("link")
        through[child] = name
    depth: dict[str, int] = {}
    try:
        for link in TopologicalSorter({link: [above[link]] for link in above}).static_order():
            depth[link] = depth[above[link]] + 1 if link in above else 0
            if depth[link] > MAX_DEPTH:
                problem = diagnose("chain-too-long", subject=("link", link), most=MAX_DEPTH)
                raise refusal_at(path, links[link], problem)
    except CycleError as error:
        link = next(name for name in links if name in error.args[1])
        problem = diagnose("links-in-a-loop", subject=("joint", through[link]), link=link)
        raise refusal_at(path, joints[through[link]], problem) from error
    roots = [link for link in links if link not in above]
    if len(roots) > 1:
        problem = diagnose("several-roots", links=roots, count=len(roots))
        raise refusal_at(path, links[roots[1]], problem)


# URDFs as they are used, for readers that know less of joints without limits.

ENDLESS_SLIDE = 1e3
"""Limit of a slide that has none (m): a URDF's must have two, which are 0 where left out. No robot
slides so far, and a number with 12 digits is a nanometre still."""

_DEMANDED = ("effort", "velocity")
"""What the format demands of a <limit>, and some exporters leave out."""


def complete_limits(root: etree._Element) -> Diagnostic | None:
    """Gives each <limit> the effort and the velocity that it lacks, in place: 0, which is none.

    Pinocchio's reader refuses a joint without them, though nobody's effort is known.

    Returns:
        Which joints they were; None if there was none.
    """
    names = []
    for name, joint in UrdfTree(root).joints.items():
        for limit in joint.element.findall("limit"):
            missing = [word for word in _DEMANDED if limit.get(word) is None]
            names += [name] if missing else []
            limit.attrib.update(dict.fromkeys(missing, "0"))
    return diagnose("effort-or-velocity-unstated", names=names) if names else None


def states_no_limits(joint: UrdfJoint) -> bool:
    """Tells whether a revolute joint's <limit> says nothing of its range.

    ``lower`` and ``upper`` count as 0 where they are left out, as many exporters do where nothing
    is known, and some write all of 0 there, the effort too. A range of 0 to 0 with an effort stays
    what it says.
    """
    limit = joint.element.find("limit")
    if joint.kind != "revolute" or limit is None:
        return False
    words = [limit.get(name) for name in ("lower", "upper", "effort")]
    if words[:2] == [None, None]:
        return True
    try:
        return not any(float(word or 0.0) for word in words)
    except ValueError:
        return False  # no number: whoever reads it says so


def unlimited_joints(root: etree._Element) -> list[UrdfJoint]:
    """Returns the joints of a URDF that state no limits; see ``states_no_limits``."""
    return [joint for joint in UrdfTree(root).joints.values() if states_no_limits(joint)]


def for_engines(root: etree._Element) -> str:
    """Writes a URDF as it is understood here: hinges without limits are continuous."""
    if unlimited_joints(root):
        root = deepcopy(root)
        for joint in unlimited_joints(root):
            joint.element.set("type", "continuous")
    return to_text(root)
