"""Reading of URDF files: validation with line numbers, mesh paths, joints without limits.

Input is a path or an XML tree. Output is a `UrdfFile` whose XML Pinocchio can read. Missing efforts
and velocities of limits are completed. Unused xacro declarations and repeated ``<origin>`` elements
are removed. A mimic of an unknown joint is noted. Other detected errors raise a `ModelError` with
file and, if known, line.
"""

from __future__ import annotations

import difflib
import math
import os
from collections.abc import Iterator, Mapping, Sequence
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
from pupper_analysis.models.attributes import JOINT_ATTRIBUTES, known_limit
from pupper_analysis.models.places import (
    Place,
    innermost_element,
    line_of,
    make_element_error,
    make_file_error,
    quote_short,
)
from pupper_analysis.models.published import existing_file, find_package_folders
from pupper_analysis.models.urdf_tree import UNSTATED_LIMITS, UrdfJoint, UrdfTree
from pupper_analysis.models.xacro_declarations import remove_declarations
from pupper_analysis.models.xml import MAX_DEPTH, MAX_NUMBER, NUMBER_PATTERN, parse_xml, to_text


@dataclass(frozen=True, eq=False)
class UrdfFile:
    """Valid URDF file, with the location of each element.

    Attributes:
        path: The file.
        text: XML for the engines. The text may differ from the file: for example, a joint without a
            range is made continuous.
        root: Root element without comments; ``sourceline`` is the line of an element.
        packages: Folders of ROS packages, for ``package://``.
        notes: Diagnostics of assumptions.
        unknown: {kind of a joint parameter: joints with an unknown value}. Set if the URDF was
            converted from a format in which a missing parameter is unknown, and not zero.
        stands_for: Word that messages use for the original file of a converted robot; "" for a
            URDF.
        gains: {joint: (stiffness, damping) of the servo} (N m/rad, N m s/rad; N/m, N s/m), from the
            original file of a converted robot. None for a URDF, and for a format without servos.
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
        """Links and joints of this URDF."""
        return UrdfTree(self.root)

    def place(self, kind: str, name: str, child: str | None = None) -> Place:
        """Return the location (file and line) of an element of this URDF, by tag and name.

        The line is missing if there is no such element.

        Args:
            kind: Tag: ``"link"``, ``"joint"``, ``"material"`` ...
            name: Name of the element.
            child: Path below the element (``"limit"``, ``"inertial/mass"``); the innermost existing
                element counts.
        """
        element = self._elements_by_name.get((kind, name))
        if element is None:
            return Place(self.path)
        found = innermost_element(element, child, lambda parent, tag: parent.find(tag))
        return Place(self.path, line_of(found))

    def place_of_nth(self, link: str, tag: str, number: int) -> Place:
        """Return the location of the n-th child of a link with a tag, such as the second visual.

        If the link has fewer children with the tag, the result is the location of the link.

        Args:
            link: Name of the link.
            tag: Tag of the element.
            number: Number of the element, from 0.
        """
        element = self._elements_by_name.get(("link", link))
        found = [] if element is None else element.findall(tag)
        if number >= len(found):
            return self.place("link", link)
        return Place(self.path, line_of(found[number]))

    @cached_property
    def _elements_by_name(self) -> dict[tuple[str, str | None], etree._Element]:
        """{(tag, name): element}; children of the root have priority over deeper elements."""
        elements = [*self.root, *self.root.iter()]
        return {(e.tag, e.get("name")): e for e in reversed(elements)}

    def resolve_mesh(self, filename: str) -> Path | None:
        """Return the existing file to which a mesh's ``filename`` refers.

        ``package://NAME/...`` and ``model://NAME/...`` are searched in ``packages``,
        ``ROS_PACKAGE_PATH``, and the folders above the URDF. A relative name without scheme starts
        at the folder of the URDF.

        Returns:
            The file; None if it is not found, or is a Git LFS pointer.

        Raises:
            OutputError: If this run of the command line also writes the file.
        """
        return next(filter(None, map(existing_file, self.list_mesh_places(filename))), None)

    def list_mesh_places(self, filename: str) -> Iterator[Path]:
        """Yield the paths of a mesh's ``filename`` that `resolve_mesh` tries, in order."""
        scheme, separator, rest = filename.partition("://")
        if not separator:
            yield self.path.parent / filename
        if separator and scheme == "file":
            yield self.path.parent / rest
        if scheme not in ("package", "model") or not separator:
            return
        package, _, inside = rest.lstrip("/").partition("/")
        for folder in self._package_folders(package):
            yield folder / inside
        parts = Path(inside).parts
        suffixes = (Path(*parts[start:]) for start in range(1, len(parts) - 1))
        for suffix in suffixes:
            yield from (folder / suffix for folder in self.path.absolute().parents)

    def _package_folders(self, package: str) -> Iterator[Path]:
        """Yield the folders that may contain a ROS package for a mesh, by descending priority."""
        if package in self.packages:
            yield Path(self.packages[package])
        for entry in filter(None, os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)):
            yield from find_package_folders(Path(entry), package)
        # If the URDF is a symbolic link, both its folder and the folder of the target are
        # searched: in a workspace built from links, either may be in the package.
        for path in dict.fromkeys((self.path.absolute(), self.path.resolve())):
            for folder in path.parents:
                yield from find_package_folders(folder, package)
        yield from self.path.absolute().parents


def describe_missing_meshes(files: Sequence[str]) -> Diagnostic | None:
    """Create the message about missing mesh files of a URDF, with the remedy; None without any.

    ``files`` are values of ``filename``, such as ``package://NAME/foot.stl``.
    """
    packages = any("://" in file for file in files)
    return diagnose("meshes-missing", files=files, packages=packages) if files else None


def read_urdf(path: str | Path, packages: Mapping[str, Path] | None = None) -> UrdfFile:
    """Read and validate a URDF.

    Args:
        path: The file.
        packages: Folders of ROS packages, for ``package://``.

    Raises:
        ConfigurationError: If ``path`` is no path.
        ModelError: If the file cannot be loaded, or is not valid. The message is a single line with
            location and reason.
        OutputError: If this run of the command line also writes this file, or for example a mesh.
    """
    check_type("urdf", path, str | Path)
    path = Path(path)
    text, root = parse_xml(path)
    return urdf_from(path, text, root, packages)


def urdf_from(
    path: Path, text: str, root: etree._Element, packages: Mapping[str, Path] | None
) -> UrdfFile:
    """Validate the root element of a URDF, and return its `UrdfFile`.

    Args:
        path: The file.
        text: Text of the file.
        root: Root element; modified, for example missing efforts and velocities are completed.
        packages: Folders of ROS packages, for ``package://``.

    Raises:
        ModelError: If the URDF is not valid. The message is a single line with location and reason.
        OutputError: If this run of the command line also writes a file that the URDF uses.
    """
    if root.tag != "robot":
        mjcf = root.tag == "mujoco"
        raise make_element_error(path, root, diagnose("no-urdf", tag=str(root.tag), mjcf=mjcf))
    if not root.get("name"):
        raise make_element_error(path, root, diagnose("robot-without-name"))
    if root.get("version") not in (None, "1", "1.0"):
        raise make_element_error(
            path, root, diagnose("version-unknown", version=root.get("version"))
        )
    found = UrdfFile(path, text, root, MappingProxyType(dict(packages or {})))
    notes = remove_declarations(path, root, found.resolve_mesh)
    completed = complete_limits(root)
    notes += [] if completed is None else [completed]
    notes += remove_repeated_origins(root)
    rewritten = bool(notes) or text[:1].isspace()  # engines read no XML behind a blank line
    materials = distinct_children(path, root, "material")
    links = distinct_children(path, root, "link")
    joints = distinct_children(path, root, "joint")
    if not links:
        semantic = not joints and any(child.tag in _SRDF_TAGS for child in root)
        raise make_file_error(Place(path), diagnose("no-links", semantic=semantic))
    if len(links) > MAX_LINKS:
        raise make_file_error(
            Place(path), diagnose("too-many-links", count=len(links), most=MAX_LINKS)
        )
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
        text = to_engine_xml(root)
    file = UrdfFile(path, text, root, MappingProxyType(dict(packages or {})), tuple(notes))
    if current_run() is not None:  # registers the meshes as inputs, which must not be overwritten
        for element in root.iter("mesh", "texture"):
            file.resolve_mesh(element.get("filename") or "")
    return file


_SRDF_TAGS: Final = ("group", "group_state", "end_effector", "disable_collisions", "virtual_joint")
"""Elements of an SRDF, the semantic description of MoveIt, whose root is also ``<robot>``."""

MAX_LINKS: Final = 2000
"""Largest number of links of a URDF; a file with more is refused. Bounds the computing time.
Chosen, not tuned."""

_JOINT_TYPES: Final = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
"""Valid types of a joint."""

_INERTIA_ATTRIBUTES: Final = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
"""Required attributes of ``<inertia>``."""


_NUM_VALUES: Final[Mapping[str, Mapping[str, int]]] = {
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "mass": {"value": 1},
    "inertia": dict.fromkeys(_INERTIA_ATTRIBUTES, 1),
    **{
        tag: dict.fromkeys(
            (row.urdf[1] for row in JOINT_ATTRIBUTES if row.urdf and row.urdf[0] == tag), 1
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
"""{tag: {numerical attribute: number of values}}."""

_REQUIRED_ATTRIBUTES: Final[Mapping[str, tuple[str, ...]]] = {
    "mass": ("value",),
    "inertia": _INERTIA_ATTRIBUTES,
    "mimic": ("joint",),
    "box": ("size",),
    "cylinder": ("radius", "length"),
    "capsule": ("radius", "length"),
    "sphere": ("radius",),
    "mesh": ("filename",),
    "parent": ("link",),
    "child": ("link",),
}
"""{tag: attributes that must be present}."""


_UNIQUE_CHILDREN: Final[Mapping[str, tuple[str, ...]]] = {
    "link": ("inertial",),
    "inertial": ("origin", "mass", "inertia"),
    "visual": ("origin", "geometry"),
    "collision": ("origin", "geometry"),
    "joint": ("origin", "parent", "child", "axis", "limit", "dynamics", "mimic"),
}
"""{tag: children of which `check_element` accepts only one}."""

_REQUIRED_CHILDREN: Final[Mapping[str, tuple[str, ...]]] = {
    "inertial": ("mass", "inertia"),
    "visual": ("geometry",),
    "collision": ("geometry",),
    "joint": ("parent", "child"),
}
"""{tag: children that must be present}."""

_KNOWN_TAGS: Final = frozenset(
    (
        *_NUM_VALUES,
        *_REQUIRED_ATTRIBUTES,
        *_UNIQUE_CHILDREN,
        *_REQUIRED_CHILDREN,
        "geometry",
        "material",
    )
)
"""Tags that are validated; other elements are ignored."""


def distinct_children(path: Path, root: etree._Element, tag: str) -> dict[str, etree._Element]:
    """Index the root's children with a tag by name, and check that the names are unique.

    Raises:
        ModelError: If a child has no name, or two children have the same name.
    """
    children: dict[str, etree._Element] = {}
    for element in root.findall(tag):
        name = element.get("name")
        if not name:
            raise make_element_error(path, element, diagnose("element-without-name", tag=tag))
        if name in children:
            first = line_of(children[name])
            problem = diagnose("name-taken", subject=(tag, name), line=first)
            raise make_element_error(path, element, problem)
        children[name] = element
    return children


def check_element(path: Path, element: etree._Element) -> bool:
    """Check children and numbers of a link, joint or material; normalise white space in numbers.

    Args:
        path: The file, for messages.
        element: Element; modified in place.

    Returns:
        True if the text of the URDF must be rewritten, because white space was removed.

    Raises:
        ModelError: If the element is not valid.
    """
    rewritten = False
    subject = str(element.tag), str(element.get("name"))
    pending = [element]
    while pending:
        part = pending.pop()
        children = [child for child in part if child.tag in _KNOWN_TAGS]
        tags = [child.tag for child in children]
        for tag in _UNIQUE_CHILDREN.get(part.tag, ()):
            if tags.count(tag) > 1:
                second = [child for child in children if child.tag == tag][1]
                problem = diagnose("child-more-than-once", subject=subject, tag=tag)
                raise make_element_error(path, second, problem)
        for tag in _REQUIRED_CHILDREN.get(part.tag, ()):
            if tag not in tags:
                problem = diagnose("child-missing", subject=subject, tag=part.tag, child=tag)
                raise make_element_error(path, part, problem)
        for attribute in _REQUIRED_ATTRIBUTES.get(part.tag, ()):
            if part.get(attribute) is None:
                missing = {"tag": part.tag, "attribute": attribute}
                raise make_element_error(
                    path, part, diagnose("attribute-missing", subject=subject, **missing)
                )
        for attribute, count in _NUM_VALUES.get(part.tag, {}).items():
            value = part.get(attribute)
            if value is None:
                continue
            _check_numbers(path, part, attribute, value, count, subject)
            normalised = " ".join(value.split())
            if normalised != value:
                part.set(attribute, normalised)
                rewritten |= count == 1
        if part.tag == "dynamics" and not (part.get("damping") or part.get("friction")):
            raise make_element_error(
                path, part, diagnose("dynamics-states-nothing", subject=subject)
            )
        pending.extend(children)
    return rewritten


def _check_numbers(
    path: Path,
    part: etree._Element,
    attribute: str,
    value: str,
    count: int,
    subject: tuple[str, str],
) -> None:
    """Raise a ModelError unless the text ``value`` of an attribute has ``count`` valid numbers.

    ``part`` is the element with the attribute, and ``subject`` the (tag, name) of the enclosing
    link, joint or material.
    """
    values = {"tag": part.tag, "attribute": attribute, "value": quote_short(value)}
    numbers = value.split()
    if len(numbers) != count:
        problem = diagnose(
            "wrong-count-of-numbers", subject=subject, **values, count=len(numbers), wanted=count
        )
        raise make_element_error(path, part, problem)
    for number in numbers:
        if "${" in number or "$(" in number:
            raise make_element_error(
                path, part, diagnose("value-is-xacro", subject=subject, **values)
            )
        if not NUMBER_PATTERN.fullmatch(number) or not math.isfinite(float(number)):
            values |= {"number": quote_short(number)}
            raise make_element_error(
                path, part, diagnose("number-not-finite", subject=subject, **values)
            )
        # Limits may be larger, because exporters write the largest number for "no limit".
        if part.tag != "limit" and abs(float(number)) > MAX_NUMBER:
            values |= {"number": quote_short(number)}
            problem = diagnose("number-too-large", subject=subject, **values, most=MAX_NUMBER)
            raise make_element_error(path, part, problem)


def check_joint(
    path: Path,
    name: str,
    joint: etree._Element,
    links: Mapping[str, etree._Element],
) -> None:
    """Validate type, limit, name and links of a joint.

    Raises:
        ModelError: If the joint is not valid.
    """
    subject = "joint", name
    kind = joint.get("type")
    if kind not in _JOINT_TYPES:
        problem = diagnose("joint-type-unknown", subject=subject, kind=kind, valid=_JOINT_TYPES)
        raise make_element_error(path, joint, problem)
    if kind in ("revolute", "prismatic") and joint.find("limit") is None:
        turns = kind == "revolute"
        problem = diagnose("limit-missing", subject=subject, kind=Term(kind), turns=turns)
        raise make_element_error(path, joint, problem)
    moves = kind in ("revolute", "continuous", "prismatic")
    # Names of Pinocchio's world and of its free joint: Pinocchio would confuse the joints, or
    # ignore masses.
    if name == "universe" or (name == "root_joint" and moves):
        raise make_element_error(path, joint, diagnose("joint-name-reserved", subject=subject))
    for tag in ("parent", "child"):
        element = joint.find(tag)
        if element.get("link") not in links:
            link = str(element.get("link"))
            alike = difflib.get_close_matches(link, links, 1)
            problem = diagnose(
                "joint-end-no-link", subject=subject, end=Term(tag), link=link, alike=alike
            )
            raise make_element_error(path, element, problem)


def check_tree(
    path: Path, links: Mapping[str, etree._Element], joints: Mapping[str, etree._Element]
) -> None:
    """Check that the joints of a URDF connect the links to a single tree.

    Raises:
        ModelError: If the links form no single tree, or a chain is too long.
    """
    parent_of: dict[str, str] = {}
    joint_of: dict[str, str] = {}
    for name, joint in joints.items():
        child = joint.find("child").get("link")
        if child in parent_of:
            conflicting_joints = (joint_of[child], name)
            problem = diagnose(
                "link-of-two-joints", subject=("link", child), joints=conflicting_joints
            )
            raise make_element_error(path, joint, problem)
        parent_of[child] = joint.find("parent").get("link")
        joint_of[child] = name
    depth: dict[str, int] = {}
    try:
        for link in TopologicalSorter(
            {link: [parent_of[link]] for link in parent_of}
        ).static_order():
            depth[link] = depth[parent_of[link]] + 1 if link in parent_of else 0
            if depth[link] > MAX_DEPTH:
                problem = diagnose("chain-too-long", subject=("link", link), most=MAX_DEPTH)
                raise make_element_error(path, links[link], problem)
    except CycleError as error:
        link = next(name for name in links if name in error.args[1])
        problem = diagnose("links-in-a-loop", subject=("joint", joint_of[link]), link=link)
        raise make_element_error(path, joints[joint_of[link]], problem) from error
    roots = [link for link in links if link not in parent_of]
    if len(roots) > 1:
        problem = diagnose("several-roots", links=roots, count=len(roots))
        raise make_element_error(path, links[roots[1]], problem)


# Joints without limits: normalisation for the readers of the engines.

MAX_SLIDE_POSITION = 1e3
"""Absolute limit that is written to a URDF for a slide without limits [m], because a URDF requires
two limits, whose defaults are 0. Chosen: no robot moves as far, and with 12 digits smaller
positions have a resolution of a nanometre.
"""


def complete_limits(root: etree._Element) -> Diagnostic | None:
    """Complete missing efforts and velocities of ``<limit>`` in a URDF, in place.

    The new value (``UNSTATED_LIMITS``) means an unknown limit. Reason: the format requires both
    attributes, some exporters omit them, and Pinocchio's reader rejects the joint.

    Returns:
        Diagnostic with the names of the joints; None if no ``<limit>`` was incomplete.
    """
    names = []
    for name, joint in UrdfTree(root).joints.items():
        for limit in joint.element.findall("limit"):
            missing = {k: v for k, v in UNSTATED_LIMITS.items() if limit.get(k) is None}
            names += [name] if missing else []
            limit.attrib.update(missing)
    return diagnose("effort-or-velocity-unstated", names=names) if names else None


def remove_repeated_origins(root: etree._Element) -> list[Diagnostic]:
    """Remove repeated ``<origin>`` elements of links, joints and their children, in place.

    The first ``<origin>`` in each parent element remains. Reason: urdfdom, the reader of ROS and
    Pinocchio, evaluates the first ``<origin>``; MuJoCo refuses the file.

    Returns:
        Warning for each element with more than one ``<origin>``.
    """
    notes = []
    for element in (*root.iterfind("link"), *root.iterfind("joint")):
        for part in (element, *element.iterfind("*")):
            first, *rest = part.findall("origin") or [None]
            for origin in rest:
                part.remove(origin)
            if rest:
                notes.append(
                    diagnose(
                        "origin-more-than-once",
                        subject=(str(element.tag), str(element.get("name"))),
                        tag=str(part.tag),
                        line=line_of(rest[0]),
                        read=_describe_origin(first),
                        ignored=[_describe_origin(origin) for origin in rest],
                    )
                )
    return notes


def _describe_origin(origin: etree._Element) -> str:
    """Return the attributes of an ``<origin>`` as text for a message; long values are cut."""
    words = [f"{name}={quote_short(origin.get(name))}" for name in origin.attrib]
    return " ".join(words) or "without attributes"


def states_no_limits(joint: UrdfJoint) -> bool:
    """Return True if a revolute joint has a ``<limit>`` without information about the range.

    ``lower`` and ``upper`` are missing, or are zero together with a zero or unknown effort:
    exporters omit these attributes, or write zeros, if the limits are unknown.
    """
    limit = joint.element.find("limit")
    if joint.kind != "revolute" or limit is None:
        return False
    ends = [limit.get(name) for name in ("lower", "upper")]
    if ends == [None, None]:
        return True
    try:
        effort = known_limit(float(limit.get("effort") or 0.0))
        return not any(float(end or 0.0) for end in ends) and effort in (0.0, math.inf)
    except ValueError:
        return False  # invalid number, reported by the validation


def unlimited_joints(root: etree._Element) -> list[UrdfJoint]:
    """Return the revolute joints of a URDF whose ``<limit>`` specifies no range.

    `states_no_limits` is the criterion.
    """
    return [joint for joint in UrdfTree(root).joints.values() if states_no_limits(joint)]


def to_engine_xml(root: etree._Element) -> str:
    """Return the XML of a URDF for the engines: `unlimited_joints` become continuous.

    ``root`` is not modified.
    """
    if unlimited_joints(root):
        root = deepcopy(root)
        for joint in unlimited_joints(root):
            joint.element.set("type", "continuous")
    return to_text(root)
