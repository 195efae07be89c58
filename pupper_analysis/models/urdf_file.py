"""Reads a URDF: where its elements stand, and what its meshes are."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from types import MappingProxyType

from lxml import etree

from pupper_analysis.base.arguments import check_type
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.runs import current_run
from pupper_analysis.models.capsules import for_engines
from pupper_analysis.models.packages import existing_file, folders_of_package
from pupper_analysis.models.places import (
    Place,
    innermost_element,
    line_of,
    refusal_at,
    refuse_file,
)
from pupper_analysis.models.unlimited import complete_limits, taken_as_unlimited
from pupper_analysis.models.urdf_checks import (
    MAX_LINKS,
    UNTIDY_NUMBER,
    check_element,
    check_joint,
    check_tree,
    distinct_children,
    leave_out_odd_materials,
    leave_out_undeclared,
)
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml import parse_xml


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
    """

    path: Path
    text: str = field(repr=False)
    root: etree._Element = field(repr=False)
    packages: Mapping[str, Path] = field(default_factory=dict)
    notes: tuple[Diagnostic, ...] = ()
    unknown: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

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

    @cached_property
    def _named(self) -> dict[tuple[str, str | None], etree._Element]:
        """{(tag, name): element}; those below the root go before those deeper down."""
        elements = [*self.root, *self.root.iter()]
        return {(e.tag, e.get("name")): e for e in reversed(elements)}

    def resolve_mesh(self, filename: str) -> Path | None:
        """Finds the file that a mesh's ``filename`` means.

        ``package://NAME/...`` and ``model://NAME/...`` are looked up in ``packages``, then in the
        folders of ``ROS_PACKAGE_PATH``, then in the folders above the URDF, as it is named and as
        its links lead. Other names are relative to the URDF.

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
        return None

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
    undeclared, completed = leave_out_undeclared(root), complete_limits(root)
    notes = [note for note in (undeclared, completed) if note is not None]
    rewritten = leave_out_odd_materials(root) or bool(notes)
    materials = distinct_children(path, root, "material")
    links = distinct_children(path, root, "link")
    joints = distinct_children(path, root, "joint")
    if not links:
        raise refuse_file(Place(path), diagnose("no-links"))
    if len(links) > MAX_LINKS:
        raise refuse_file(Place(path), diagnose("too-many-links", count=len(links), most=MAX_LINKS))
    spaces = False
    for element in (*links.values(), *joints.values(), *materials.values()):
        spaces |= check_element(path, element)
    for name, joint in joints.items():
        check_joint(path, name, joint, links)
        mimic = joint.find("mimic")
        if mimic is not None and mimic.get("joint") not in joints.keys() - {name}:
            leader = str(mimic.get("joint"))
            notes.append(diagnose("mimic-of-no-joint", subject=("joint", name), leader=leader))
    check_tree(path, links, joints)
    if spaces or UNTIDY_NUMBER.search(text):
        rewritten = True
        notes.append(diagnose("white-space-normalised"))
    unlimited = taken_as_unlimited(root)
    notes += [] if unlimited is None else [unlimited]
    if rewritten or unlimited or next(root.iter("capsule"), None) is not None:
        text = for_engines(root)
    file = UrdfFile(path, text, root, MappingProxyType(dict(packages or {})), tuple(notes))
    if current_run() is not None:  # a command may not look at them, and must not lose them
        for element in root.iter("mesh", "texture"):
            file.resolve_mesh(element.get("filename") or "")
    return file
