"""Reads anybody's URDF or MJCF: what is malformed is refused with its file and line."""

from __future__ import annotations

import copy
import itertools
import math
import os
import re
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Final

import mujoco
from lxml import etree

from pupper_analysis.errors import ModelError

MAX_BYTES: Final = 20_000_000
"""Largest file that is read."""

MAX_DEPTH: Final = 250
"""Deepest nesting of XML elements, and longest chain of a URDF's joints."""

MAX_ELEMENTS: Final = 30_000
"""Most elements of a file with all it includes."""

MAX_LINKS: Final = 2000
"""Most links of a URDF."""

MAX_INCLUDES: Final = 1000
"""Most includes and attached models of an MJCF."""

MAX_INCLUDE_DEPTH: Final = 30
"""Deepest nesting of an MJCF's includes, and of the models it attaches."""

MAX_COPIES: Final = 10_000
"""Most elements that an MJCF's replicates and attached models make."""

_NUMBER: Final = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")


@dataclass(frozen=True)
class Place:
    """Where something stands.

    Attributes:
        file: The file.
        line: Its line, from 1; None where the file as a whole is meant.
    """

    file: Path
    line: int | None = None

    def __str__(self) -> str:
        return self.file.name if self.line is None else f"{self.file.name}:{self.line}"


@dataclass(frozen=True, eq=False)
class UrdfFile:
    """A URDF that can be loaded.

    Attributes:
        path: The file.
        text: Its XML.
        root: The parsed XML, without comments; ``sourceline`` is an element's line.
        packages: Folders of packages, for ``package://``.
        notes: What was assumed on reading, in plain words.
    """

    path: Path
    text: str = field(repr=False)
    root: etree._Element = field(repr=False)
    packages: Mapping[str, Path] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def place(self, kind: str, name: str, child: str | None = None) -> Place:
        """Finds an element.

        Args:
            kind: Its tag: ``"link"``, ``"joint"``, ``"material"`` ...
            name: Its name.
            child: A path below it (``"limit"``, ``"inertial/mass"``): the innermost that exists.

        Returns:
            Its file and line; the file alone where there is no such element.
        """
        named = (e for e in (*self.root, *self.root.iter(kind)) if e.tag == kind)
        element = next((e for e in named if e.get("name") == name), None)
        if element is None:
            return Place(self.path)
        for tag in child.split("/") if child else ():
            below = element.find(tag)
            if below is None:
                break
            element = below
        return Place(self.path, _line(element))

    def resolve_mesh(self, filename: str) -> Path | None:
        """Finds the file that a mesh's ``filename`` means.

        ``package://NAME/...`` and ``model://NAME/...`` are looked up in ``packages``, then in the
        folders of ``ROS_PACKAGE_PATH``, then in the folders above the URDF. Other names are
        relative to the URDF.

        Returns:
            The file, or None where there is none.
        """
        scheme, separator, rest = filename.partition("://")
        if not separator:
            return _existing(self.path.parent / filename)
        if scheme == "file":
            return _existing(self.path.parent / rest)
        if scheme not in ("package", "model"):
            return None
        package, _, inside = rest.lstrip("/").partition("/")
        for folder in self._package_folders(package):
            found = _existing(folder / inside)
            if found is not None:
                return found
        return None

    def _package_folders(self, package: str) -> Iterator[Path]:
        if package in self.packages:
            yield Path(self.packages[package])
        for entry in filter(None, os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)):
            yield from _folders_of_package(Path(entry), package)
        for folder in self.path.absolute().parents:
            yield from _folders_of_package(folder, package)


@dataclass(frozen=True)
class _Node:
    """An element of an MJCF with its includes put in."""

    tag: str
    attributes: Mapping[str, str]
    place: Place
    children: list[_Node]


@dataclass(frozen=True, eq=False)
class MjcfFile:
    """An MJCF that MuJoCo has parsed.

    Attributes:
        path: The file.
        spec: What MuJoCo read, not compiled, without what needs files that are missing.
        files: The file and all it includes.
        notes: What was left out on reading, in plain words.
        refusal: Why MuJoCo does not compile the file as it is, and where; None if it does.
            ``MjSpec.copy()`` drops elements that refer to nothing, so that a copy of the spec may
            compile where the file does not.
    """

    path: Path
    spec: mujoco.MjSpec = field(repr=False)
    files: tuple[Path, ...] = ()
    notes: tuple[str, ...] = ()
    refusal: tuple[str, Place] | None = None
    _model: mujoco.MjModel | None = field(default=None, repr=False)
    _index: Mapping[tuple[str, str], _Node] = field(default_factory=dict, repr=False)
    _roots: tuple[_Node, ...] = field(default=(), repr=False)

    def place(self, kind: str, name: str, child: str | None = None) -> Place:
        """Finds an element, in the file where it really stands.

        Args:
            kind: Its tag: ``"body"``, ``"joint"``, ``"geom"``, ``"site"``, ``"key"`` ..., or its
                section: ``"actuator"``, ``"sensor"``, ``"equality"``, ``"tendon"``, ``"contact"``.
            name: Its name; an actuator's joint will do, a default's class, and for a joint
                without a name its body.
            child: A path below it (``"inertial"``): the innermost that exists.

        Returns:
            Its file and line; the file alone where there is no such element.
        """
        node = self._index.get((kind, name))
        if node is None:
            return Place(self.path)
        for tag in child.split("/") if child else ():
            tags = ("joint", "freejoint") if tag == "joint" else (tag,)
            below = next((c for c in node.children if c.tag in tags), None)
            if below is None:
                break
            node = below
        return node.place

    def elements(self, tag: str) -> Iterator[tuple[Mapping[str, str], Place]]:
        """Yields the attributes and the place of every element of a kind, as they are written.

        In the file, in what it includes, and in the models it attaches.
        """
        for root in self._roots:
            for node in _walk(root):
                if node.tag == tag:
                    yield node.attributes, node.place

    def numbered(self, section: str, number: int) -> Place:
        """Returns the place of an element without a name.

        Args:
            section: ``"actuator"``, ``"equality"`` or ``"tendon"``.
            number: Its place in the section, from 0.

        Returns:
            Its file and line; the file alone where attached models or replicates add elements.
        """
        if len(self._roots) > 1 or any(True for _ in self.elements("replicate")):
            return Place(self.path)
        tops = (node for node in self._roots[0].children if node.tag == section)
        found = [node.place for top in tops for node in top.children]
        return found[number] if number < len(found) else Place(self.path)

    def compile(self) -> mujoco.MjModel:
        """Returns what MuJoCo compiles the file to, as it is (without what files are missing for).

        Raises:
            ModelError: If MuJoCo refuses it; the message is MuJoCo's.
        """
        if self.refusal is not None:
            message, place = self.refusal
            raise ModelError(_source(place.file, place.line), message)
        assert self._model is not None
        return copy.copy(self._model)


def read_model(path: str | Path, packages: Mapping[str, Path] | None = None) -> UrdfFile | MjcfFile:
    """Reads a URDF or an MJCF; the root element tells which it is.

    An MJCF that MuJoCo parses but does not compile is returned, too, with its ``refusal``.

    Args:
        path: The file.
        packages: Folders of packages, for a URDF's ``package://``.

    Raises:
        ModelError: If it cannot be loaded; one line that tells where and why.
    """
    path = Path(path)
    text, root = _parse(path)
    if root.tag in ("mujoco", "mujocoinclude"):
        return _read_mjcf(path, root)
    if root.tag != "robot":
        problem = f"the root element is <{root.tag}>; a URDF's is <robot>, an MJCF's <mujoco>"
        raise _refusal(path, root, problem)
    return _read_urdf(path, text, root, packages)


def read_urdf(path: str | Path, packages: Mapping[str, Path] | None = None) -> UrdfFile:
    """Reads a URDF.

    Args:
        path: The file.
        packages: Folders of packages, for ``package://``.

    Raises:
        ModelError: If it cannot be loaded; one line that tells where and why.
    """
    path = Path(path)
    text, root = _parse(path)
    return _read_urdf(path, text, root, packages)


def read_mjcf(path: str | Path) -> MjcfFile:
    """Reads an MJCF with all it includes, and compiles it as it is.

    Raises:
        ModelError: If it cannot be loaded, or MuJoCo does not compile it; one line that tells where
            and why.
    """
    path = Path(path)
    _, root = _parse(path)
    file = _read_mjcf(path, root)
    if file.refusal is not None:
        file.compile()  # raises
    return file


# ------------------------------------------------------------------------------------- URDF

_JOINT_TYPES: Final = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")

_INERTIA: Final = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")

# The attributes that hold numbers, and how many; and those that must be there.
_NUMBERS: Final[Mapping[str, Mapping[str, int]]] = {
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "mass": {"value": 1},
    "inertia": dict.fromkeys(_INERTIA, 1),
    "limit": {"effort": 1, "velocity": 1, "lower": 1, "upper": 1},
    "dynamics": {"damping": 1, "friction": 1},
    "mimic": {"multiplier": 1, "offset": 1},
    "calibration": {"rising": 1, "falling": 1, "reference_position": 1},
    "safety_controller": {
        "k_velocity": 1,
        "k_position": 1,
        "soft_lower_limit": 1,
        "soft_upper_limit": 1,
    },
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
    "limit": ("effort", "velocity"),
    "mimic": ("joint",),
    "safety_controller": ("k_velocity",),
    "box": ("size",),
    "cylinder": ("radius", "length"),
    "capsule": ("radius", "length"),
    "sphere": ("radius",),
    "mesh": ("filename",),
    "parent": ("link",),
    "child": ("link",),
}
# Line breaks and tabs in numbers; an XML parser makes them spaces, Pinocchio's does not.
_WHITE_SPACE: Final = re.compile(
    rf"""\b(?:{"|".join(name for names in _NUMBERS.values() for name in names)})"""
    r"""\s*=\s*(?:"[^"<\t\r\n]*[\t\r\n]|'[^'<\t\r\n]*[\t\r\n])"""
)
# Which children an element may have once only, and which it must have.
_ONCE: Final[Mapping[str, tuple[str, ...]]] = {
    "link": ("inertial",),
    "inertial": ("origin", "mass", "inertia"),
    "visual": ("origin", "geometry", "material"),
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


def _read_urdf(
    path: Path, text: str, root: etree._Element, packages: Mapping[str, Path] | None
) -> UrdfFile:
    if root.tag != "robot":
        hint = "; it is an MJCF" if root.tag == "mujoco" else ""
        raise _refusal(path, root, f"a URDF's root element is <robot>, not <{root.tag}>{hint}")
    if not root.get("name"):
        raise _refusal(path, root, 'the robot has no name; write <robot name="...">')
    if root.get("version") not in (None, "1", "1.0"):
        raise _refusal(path, root, f"version {root.get('version')!r} is unknown; valid: 1.0")
    notes: list[str] = []
    rewritten = _leave_out_undeclared(root, notes)
    materials = _distinct(path, root, "material")
    links = _distinct(path, root, "link")
    joints = _distinct(path, root, "joint")
    if not links:
        raise ModelError(_source(path), "it has no <link>; a robot has at least one")
    if len(links) > MAX_LINKS:
        raise ModelError(_source(path), f"it has {len(links)} links; at most {MAX_LINKS} are read")
    spaces = False
    for element in (*links.values(), *joints.values(), *materials.values()):
        spaces |= _check_element(path, element)
    for name, joint in joints.items():
        _check_joint(path, name, joint, links)
        mimic = joint.find("mimic")
        if mimic is not None and mimic.get("joint") not in joints.keys() - {name}:
            notes.append(f"joint {name!r} mimics {mimic.get('joint')!r}, not another joint here")
    _check_tree(path, links, joints)
    if spaces or _WHITE_SPACE.search(text):
        rewritten = True
        notes.append("white space in numbers was normalised: Pinocchio takes single spaces only")
    if rewritten:
        text = etree.tostring(root, encoding="unicode")
    return UrdfFile(path, text, root, MappingProxyType(dict(packages or {})), tuple(notes))


def _leave_out_undeclared(root: etree._Element, notes: list[str]) -> bool:
    """Takes out what has a prefix that is not declared: Pinocchio skips it, other parsers refuse.

    Returns:
        Whether there was any.
    """
    gone: dict[str, None] = {}
    for element in list(root.iter()):
        for name in [str(name) for name in element.attrib if ":" in str(name).rpartition("}")[2]]:
            gone[name] = None
            del element.attrib[name]
        parent = element.getparent()
        if ":" in element.tag.rpartition("}")[2] and parent is not None:
            gone[element.tag] = None
            parent.remove(element)
    if gone:
        notes.append(f"left out, for their prefixes are not declared: {', '.join(gone)}")
    return bool(gone)


def _distinct(path: Path, root: etree._Element, tag: str) -> dict[str, etree._Element]:
    """Returns the root's children of a kind by name; the names are to be distinct."""
    found: dict[str, etree._Element] = {}
    for element in root.findall(tag):
        name = element.get("name")
        if not name:
            raise _refusal(path, element, f'the {tag} has no name; write <{tag} name="...">')
        if name in found:
            first = _line(found[name])
            raise _refusal(
                path, element, f"{tag} {name!r} is there already (line {first}); rename one"
            )
        found[name] = element
    return found


def _check_element(path: Path, element: etree._Element) -> bool:
    """Checks the children and numbers of a link or joint; returns whether it had to rewrite any."""
    rewritten = False
    what = f"{element.tag} {element.get('name')!r}"
    pending = [element]
    while pending:
        part = pending.pop()
        children = [child for child in part if child.tag in _KNOWN]
        tags = [child.tag for child in children]
        for tag in _ONCE.get(part.tag, ()):
            if tags.count(tag) > 1:
                again = [child for child in children if child.tag == tag][1]
                raise _refusal(path, again, f"{what} has <{tag}> more than once; keep one")
        for tag in _MUST.get(part.tag, ()):
            if tag not in tags:
                raise _refusal(path, part, f"{what}: <{part.tag}> has no <{tag}>; add it")
        for attribute in _REQUIRED.get(part.tag, ()):
            if part.get(attribute) is None:
                raise _refusal(path, part, f"{what}: <{part.tag}> has no {attribute}; add it")
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
            raise _refusal(path, part, f"{what}: <dynamics> has neither damping nor friction")
        pending.extend(children)
    return rewritten


def _check_numbers(
    path: Path, part: etree._Element, attribute: str, value: str, count: int, what: str
) -> None:
    where = f"{what}: <{part.tag} {attribute}={_short(value)}>"
    numbers = value.split()
    if len(numbers) != count:
        wanted = "a number" if count == 1 else f"{count} numbers"
        raise _refusal(path, part, f"{where} has {len(numbers)} values; it takes {wanted}")
    for number in numbers:
        if "${" in number or "$(" in number:
            raise _refusal(path, part, f"{where} is xacro; expand the file with xacro first")
        if not _NUMBER.fullmatch(number) or not math.isfinite(float(number)):
            raise _refusal(path, part, f"{where}: {_short(number)} is not a finite number")


def _check_joint(
    path: Path,
    name: str,
    joint: etree._Element,
    links: Mapping[str, etree._Element],
) -> None:
    what = f"joint {name!r}"
    kind = joint.get("type")
    if kind not in _JOINT_TYPES:
        problem = f"{what} has " + ("no type" if kind is None else f"the unknown type {kind!r}")
        raise _refusal(path, joint, f"{problem}; valid: {', '.join(_JOINT_TYPES)}")
    if kind in ("revolute", "prismatic") and joint.find("limit") is None:
        raise _refusal(
            path,
            joint,
            f'{what} is {kind} without a <limit>; add <limit lower="" upper="" effort="" '
            'velocity=""/>' + (', or make it "continuous"' if kind == "revolute" else ""),
        )
    for tag in ("parent", "child"):
        end = joint.find(tag)
        if end.get("link") not in links:
            raise _refusal(path, end, f"{what}: its {tag} {end.get('link')!r} is not a link here")


def _check_tree(
    path: Path, links: Mapping[str, etree._Element], joints: Mapping[str, etree._Element]
) -> None:
    """Refuses joints that do not make the links one tree."""
    above: dict[str, str] = {}
    through: dict[str, str] = {}
    for name, joint in joints.items():
        child = joint.find("child").get("link")
        if child in above:
            raise _refusal(
                path,
                joint,
                f"link {child!r} is the child of two joints, {through[child]!r} and {name!r}; "
                "the links are to form a tree",
            )
        above[child] = joint.find("parent").get("link")
        through[child] = name
    depth: dict[str, int] = {}
    for link in links:
        chain: list[str] = []
        at = link
        while at in above and at not in depth:
            depth[at] = -1
            chain.append(at)
            at = above[at]
        if depth.get(at) == -1:
            raise _refusal(
                path,
                joints[through[at]],
                f"joint {through[at]!r} closes a loop of links at {at!r}; the links are to form a "
                "tree",
            )
        base = depth.setdefault(at, 0)
        for steps, passed in enumerate(reversed(chain), start=1):
            depth[passed] = base + steps
        if depth[link] > MAX_DEPTH:
            raise _refusal(
                path, links[link], f"link {link!r} is at the end of more than {MAX_DEPTH} joints"
            )
    roots = [link for link in links if link not in above]
    if len(roots) > 1:
        raise _refusal(
            path,
            links[roots[1]],
            f"{len(roots)} links have no parent ({', '.join(map(repr, roots[:3]))}"
            f"{', ...' if len(roots) > 3 else ''}); join them, so that one root is left",
        )


def _short(value: str) -> str:
    return repr(value if len(value) <= 40 else value[:37] + "...")


# ------------------------------------------------------------------------------------- MJCF

# The product of the whole numbers in these attributes has a limit: MuJoCo would hang, or take all
# the memory. The tag "*" means any.
_LARGEST: Final = (
    ("texture", ("width", "height"), 2**26),
    ("hfield", ("nrow", "ncol"), 10**7),
    ("numeric", ("size",), 10**6),
    ("mesh", ("params",), 10**4),
    ("flexcomp", ("count",), 10**4),
    ("flexcomp", ("cellcount",), 10**4),
    ("composite", ("count",), 10**4),
    ("camera", ("resolution",), 10**7),
    ("size", ("nkey",), 10**4),
    *(
        ("size", (f"nuser_{kind}",), 10**4)
        for kind in ("body", "jnt", "geom", "site", "cam", "tendon", "actuator", "sensor")
    ),
    ("size", ("nuserdata",), 10**7),
    *(("*", (attribute,), 10**6) for attribute in ("nsample", "num", "dim", "actdim")),
)

_SECTIONS: Final = ("actuator", "sensor", "equality", "tendon", "contact", "deformable")

_MUJOCO_ERRORS: Final = (ValueError, RuntimeError, TypeError, OSError, MemoryError)


class _Tree:
    """The elements of an MJCF, with its includes put in.

    Attributes:
        files: The file and all it includes or attaches.
        attached: The root elements of the models that it attaches, and that these attach.
        folders: The folders of the file and of the models it attaches.
        root: The root element.
        copies: How many elements MuJoCo will make of its replicates and attached models.
    """

    def __init__(
        self,
        path: Path,
        root: etree._Element,
        within: tuple[Path, ...] = (),
        includes: Iterator[int] | None = None,
    ) -> None:
        self.path = path
        self.files: dict[Path, None] = {path: None}
        self.folders: dict[Path, None] = {path.parent: None}
        self._within = (*within, path.resolve())
        self.attached: list[_Node] = []
        self._models: dict[str, int] = {}
        self._parsed: dict[Path, etree._Element] = {}
        self._count = 0
        self._includes = includes or itertools.count(1)
        if len(self._within) > MAX_INCLUDE_DEPTH:
            raise ModelError(
                _source(path), f"models are attached more than {MAX_INCLUDE_DEPTH} deep"
            )
        self.root = self._node(root, path, self._within, 0)
        self.copies = self._copies(self.root)
        if self.copies > self._count + MAX_COPIES:
            raise ModelError(
                _source(path),
                f"replicates and attached models make more than {MAX_COPIES} elements",
            )

    def _node(
        self, element: etree._Element, path: Path, within: tuple[Path, ...], depth: int
    ) -> _Node:
        attributes = {str(name): str(value) for name, value in element.attrib.items()}
        node = _Node(str(element.tag), attributes, Place(path, _line(element)), [])
        self._count += 1
        if self._count > MAX_ELEMENTS:
            raise ModelError(_source(self.path), f"it has more than {MAX_ELEMENTS} elements")
        if depth > MAX_DEPTH:
            raise _refusal(path, element, f"elements are nested deeper than {MAX_DEPTH}")
        _refuse_large(path, element)
        if element.tag == "model" and element.get("file", "").endswith(".xml"):
            self._attach(element, path)
        pending = [(child, path, within) for child in reversed(element)]
        while pending:
            child, file, inside = pending.pop()
            if child.tag == "include":
                included, top = self._include(child, file, inside)
                opened = (*inside, included.resolve())
                pending.extend((below, included, opened) for below in reversed(top))
            else:
                node.children.append(self._node(child, file, inside, depth + 1))
        return node

    def _include(
        self, element: etree._Element, path: Path, within: tuple[Path, ...]
    ) -> tuple[Path, etree._Element]:
        included = self._file(element, path)
        resolved = included.resolve()
        if resolved in within:
            raise _refusal(path, element, f"{included.name!r} includes itself; take this out")
        if len(within) > MAX_INCLUDE_DEPTH:
            raise _refusal(path, element, f"includes are nested deeper than {MAX_INCLUDE_DEPTH}")
        if resolved not in self._parsed:
            self.files[included] = None
            _, self._parsed[resolved] = _parse(included)
        return included, self._parsed[resolved]

    def _attach(self, element: etree._Element, path: Path) -> None:
        attached = self._file(element, path)
        if attached.resolve() in self._within:
            raise _refusal(path, element, f"{attached.name!r} attaches itself; take this out")
        _, root = _parse(attached)
        tree = _Tree(attached, root, self._within, self._includes)
        self.files |= tree.files
        self.attached += [tree.root, *tree.attached]
        self.folders |= tree.folders
        name = element.get("name") or root.get("model") or attached.stem
        self._models[name] = tree.copies

    def _file(self, element: etree._Element, path: Path) -> Path:
        """Counts and finds an include: by the main file first, then by its own file."""
        if next(self._includes) > MAX_INCLUDES:
            raise _refusal(path, element, f"there are more than {MAX_INCLUDES} includes")
        name = element.get("file")
        if not name:
            raise _refusal(path, element, f"<{element.tag}> has no file; add file=...")
        for folder in (self.path.parent, path.parent):
            found = _existing(folder / name)
            if found is not None:
                return found
        raise _refusal(
            path, element, f"<{element.tag} file={_short(name)}>: no such file; put it there"
        )

    def _copies(self, node: _Node) -> int:
        number = 1 + sum(self._copies(child) for child in node.children)
        if node.tag == "replicate":
            number *= max(_product(node.attributes.get("count", "1")), 1)
        if node.tag == "attach":
            number += self._models.get(node.attributes.get("model", ""), 0)
        return number


def _refuse_large(path: Path, element: etree._Element) -> None:
    for tag, attributes, limit in _LARGEST:
        if tag in ("*", element.tag):
            text = " ".join(element.get(attribute, "") for attribute in attributes)
            if _product(text) > limit:
                names = " x ".join(attributes)
                raise _refusal(
                    path, element, f"<{element.tag}>: {names} is too large; at most {limit}"
                )


def _product(text: str) -> int:
    numbers = [abs(float(word)) for word in text.split() if _NUMBER.fullmatch(word)]
    product = math.prod(max(number, 1.0) for number in numbers)
    return int(min(product, 1e18))


def _read_mjcf(path: Path, root: etree._Element) -> MjcfFile:
    if root.tag != "mujoco":
        hint = {
            "robot": "; it is a URDF",
            "mujocoinclude": "; it is a part, give the file that includes it",
        }.get(str(root.tag), "")
        raise _refusal(path, root, f"an MJCF's root element is <mujoco>, not <{root.tag}>{hint}")
    tree = _Tree(path, root)
    index = _index(tree.root)
    spec, notes = _spec(tree, index)
    model, refusal = None, None
    try:
        with quiet():
            # Another spec, for compiling changes it; and no copy, which lacks what is dangling.
            model = _spec(tree, index)[0].compile()
    except _MUJOCO_ERRORS as error:
        refusal = _mujoco_refusal(tree, index, "MuJoCo cannot compile it", error)
    return MjcfFile(
        path,
        spec,
        tuple(tree.files),
        tuple(notes),
        refusal,
        model,
        index,
        (tree.root, *tree.attached),
    )


def _spec(tree: _Tree, index: Mapping[tuple[str, str], _Node]) -> tuple[mujoco.MjSpec, list[str]]:
    """Returns what MuJoCo reads, without what needs files that are missing, and what that is."""
    try:
        with quiet():
            spec = mujoco.MjSpec.from_file(str(tree.path))
    except _MUJOCO_ERRORS as error:
        if "could not find decoder" in str(error):
            problem = "MuJoCo reads files *.xml only; rename it"
            raise ModelError(_source(tree.path), problem) from error
        message, place = _mujoco_refusal(tree, index, "not a valid MJCF", error)
        raise ModelError(_source(place.file, place.line), message) from error
    return spec, _leave_out_missing(spec, tree, index)


def _walk(root: _Node) -> Iterator[_Node]:
    """Yields an element and all below it, in the order of the file."""
    pending = [root]
    while pending:
        node = pending.pop()
        yield node
        pending.extend(reversed(node.children))


def _index(root: _Node) -> dict[tuple[str, str], _Node]:
    """Finds the elements by kind and name; the first counts where there are several."""
    index: dict[tuple[str, str], _Node] = {}
    fallback: dict[tuple[str, str], _Node] = {}
    pending: list[tuple[_Node, _Node]] = [(child, root) for child in reversed(root.children)]
    while pending:
        node, parent = pending.pop()
        pending.extend((child, node) for child in reversed(node.children))
        name = node.attributes.get("class" if node.tag == "default" else "name")
        kinds = [node.tag]
        if parent.tag in _SECTIONS:
            kinds.append(parent.tag)
        if node.tag == "freejoint":
            kinds.append("joint")
        if not name and node.tag in ("mesh", "texture", "hfield"):
            name = Path(node.attributes.get("file", "")).stem
        for kind in kinds:
            if name:
                index.setdefault((kind, name), node)
            if parent.tag == "actuator" and "joint" in node.attributes:
                fallback.setdefault((kind, node.attributes["joint"]), node)
            if not name and kind in ("joint", "freejoint") and "name" in parent.attributes:
                fallback.setdefault((kind, parent.attributes["name"]), node)
    return fallback | index


def _leave_out_missing(
    spec: mujoco.MjSpec, tree: _Tree, index: Mapping[tuple[str, str], _Node]
) -> list[str]:
    """Takes out of a spec what needs files that are missing; returns what it took out."""
    folders = tuple(tree.folders)

    def missing(file: str, folder: str) -> bool:
        name = Path(file).name if spec.strippath else file
        return bool(file) and not any(_existing(top / folder / name) for top in folders)

    meshes = {m.name: m.file for m in spec.meshes if missing(m.file, m.compiler.meshdir)}
    hfields = {h.name: h.file for h in spec.hfields if missing(h.file, h.compiler.meshdir)}
    textures = {
        t.name: next(filter(None, (t.file, *t.cubefiles)))
        for t in spec.textures
        if any(missing(file, t.compiler.texturedir) for file in (t.file, *t.cubefiles))
    }
    skins = {s.name: s.file for s in spec.skins if missing(s.file, s.compiler.meshdir)}
    if not (meshes or hfields or textures or skins):
        return []
    geoms = [g for g in spec.geoms if g.meshname in meshes or g.hfieldname in hfields]
    for geom in geoms:
        if geom.meshname in meshes and _gives_mass(spec, geom):
            body = geom.parent.name
            place = index[("body", body)].place if ("body", body) in index else Place(tree.path)
            raise ModelError(
                _source(place.file, place.line),
                f"body {body!r} takes its mass from geom {geom.name!r}, whose mesh file "
                f"{meshes[geom.meshname]!r} is missing; give the body an <inertial>, or put the "
                "mesh there",
            )
    names = {geom.name for geom in geoms if geom.name}
    _refuse_wrapped(tree.root, names)
    users = _users(spec, tree.root, names)
    notes = []
    for what, files in (
        ("mesh file", meshes),
        ("height field file", hfields),
        ("texture file", textures),
        ("skin file", skins),
    ):
        if files:
            some = ", ".join(list(dict.fromkeys(files.values()))[:2])
            more = ", ..." if len(set(files.values())) > 2 else ""
            notes.append(
                f"{len(set(files.values()))} {what}(s) missing ({some}{more}): what uses them was "
                "left out"
            )
    if users:
        notes.append(f"left out, for they refer to such a geom: {', '.join(users)}")
    for element in geoms:
        spec.delete(element)
    for name in textures:
        for material in spec.materials:
            if name in list(material.textures):
                material.textures = ["" if t == name else t for t in material.textures]
    for elements, gone in (
        (spec.meshes, meshes),
        (spec.hfields, hfields),
        (spec.textures, textures),
        (spec.skins, skins),
    ):
        for element in list(elements):
            if element.name in gone:
                spec.delete(element)
    return notes


def _gives_mass(spec: mujoco.MjSpec, geom: mujoco.MjsGeom) -> bool:
    """Says whether MuJoCo would take (part of) a body's inertia from a geom."""
    body = geom.parent
    if body.name == spec.worldbody.name:
        return False
    from_geom = geom.compiler.inertiafromgeom
    if from_geom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE or (
        from_geom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO and body.explicitinertial
    ):
        return False
    low, high = geom.compiler.inertiagrouprange
    weight = geom.density if math.isnan(geom.mass) else geom.mass
    return bool(low <= geom.group <= high and weight != 0)


def _refuse_wrapped(root: _Node, names: set[str]) -> None:
    for section in root.children:
        for tendon in section.children if section.tag == "tendon" else ():
            for part in tendon.children:
                if part.attributes.get("geom") in names:
                    raise ModelError(
                        _source(part.place.file, part.place.line),
                        f"the tendon wraps geom {part.attributes['geom']!r}, whose mesh file is "
                        "missing; put the mesh there",
                    )


def _users(spec: mujoco.MjSpec, root: _Node, names: set[str]) -> list[str]:
    """Deletes the sensors, contact pairs and tuples that refer to geoms; returns what they are."""
    kind = mujoco.mjtObj.mjOBJ_GEOM
    tuples = {
        node.attributes.get("name")
        for section in root.children
        if section.tag == "custom"
        for node in section.children
        if any(part.attributes.get("objname") in names for part in node.children)
    }
    users = [
        *(
            ("sensor", sensor)
            for sensor in spec.sensors
            if (sensor.objtype == kind and sensor.objname in names)
            or (sensor.reftype == kind and sensor.refname in names)
        ),
        *(("contact pair", p) for p in spec.pairs if {p.geomname1, p.geomname2} & names),
        *(("tuple", element) for element in spec.tuples if element.name in tuples),
    ]
    words = [f"{what} {user.name!r}" for what, user in users]
    for _, user in users:
        spec.delete(user)
    return words


def _mujoco_refusal(
    tree: _Tree, index: Mapping[tuple[str, str], _Node], what: str, error: BaseException
) -> tuple[str, Place]:
    """Returns MuJoCo's message, and the place of the element that it is about.

    MuJoCo tells the line in the main file, or in an unnamed one, and 0 of what is included; and the
    name that it tells may be the one that is not there.
    """
    message = _one_line(error)
    found = re.search(r"(?:, line |Line number=)([1-9][0-9]*)", message)
    line = int(found[1]) if found else None
    said = set(re.findall(r"'([^']+)'", message))
    name = re.search(r"Element name '([^']+)'", message)
    named = [node.place for (_, known), node in index.items() if name and known == name[1]]
    nodes = [node for root in (tree.root, *tree.attached) for node in _walk(root)]
    meant = [
        node.place
        for node in nodes
        if said & {v for k, v in node.attributes.items() if k != "name" or line is not None}
        and line in (None, node.place.line)
    ]
    place = Place(tree.path)
    if line is not None and len(tree.files) == 1:
        place = Place(tree.path, line)
    elif line is not None and len({where.file for where in meant}) == 1:
        place = meant[0]
    elif named or meant:
        place = (named or meant)[0]
    elif line is not None and len({n.place.file for n in nodes if n.place.line == line}) == 1:
        place = next(node.place for node in nodes if node.place.line == line)
    return f"{what}: {message}", place


@contextmanager
def quiet() -> Iterator[None]:
    """Keeps MuJoCo from writing its warnings to a file MUJOCO_LOG.TXT, and from issuing them."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        mujoco.set_mju_user_warning(before)


# ------------------------------------------------------------------------------------- XML


def _parse(path: Path) -> tuple[str, etree._Element]:
    """Returns a file's text, and its root element without comments and default namespace."""
    text = _text(path)
    _refuse_doctype(path, text)
    parser = _parser(recover=False)
    try:
        root = etree.fromstring(text.encode(), parser)
    except etree.XMLSyntaxError as error:
        errors = [entry for entry in parser.error_log if entry.domain_name != "NAMESPACE"]
        if errors or not len(parser.error_log):
            line, message = (errors[0].line, errors[0].message) if errors else (1, str(error))
            if "Excessive depth" in message:
                message = f"elements are nested deeper than {MAX_DEPTH}"
            raise ModelError(
                _source(path, line or None), f"not well-formed XML: {_one_line(message)}"
            ) from error
        # A prefix is used that is not declared, which neither Pinocchio nor MuJoCo minds.
        root = etree.fromstring(text.encode(), _parser(recover=True))
    count = 0
    ends = etree.iterwalk(root, events=("start", "end"))
    depth = 0
    for event, element in ends:
        depth += 1 if event == "start" else -1
        count += event == "start"
        if depth > MAX_DEPTH:
            raise _refusal(path, element, f"elements are nested deeper than {MAX_DEPTH}")
        name = etree.QName(element) if ":" not in element.tag.rpartition("}")[2] else None
        if element.prefix == "xacro" or element.tag.startswith("xacro:"):
            raise _refusal(
                path,
                element,
                "it is a xacro file; expand it first: xacro robot.urdf.xacro > robot.urdf",
            )
        if name is not None and name.namespace and element.prefix is None:
            element.tag = name.localname
    if count > MAX_ELEMENTS:
        raise ModelError(_source(path), f"it has {count} elements; at most {MAX_ELEMENTS} are read")
    return text, root


def _text(path: Path) -> str:
    try:
        if path.is_dir():
            raise ModelError(_source(path), "it is a folder; give the path of a URDF or MJCF file")
        if not path.exists():
            raise ModelError(
                _source(path), "there is no such file; give the path of a URDF or MJCF file"
            )
        if not path.is_file():
            raise ModelError(
                _source(path), "it is no regular file; give the path of a URDF or MJCF file"
            )
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        raise ModelError(_source(path), f"cannot be read: {_one_line(error)}") from error
    if len(data) > MAX_BYTES:
        raise ModelError(
            _source(path), f"it has more than {MAX_BYTES // 10**6} MB, the most that is read"
        )
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise ModelError(_source(path), "it is encoded in UTF-16; save it as UTF-8")
    if b"\0" in data:
        line = data.count(b"\n", 0, data.index(b"\0")) + 1
        raise ModelError(
            _source(path, line), "it has a zero byte, so it is no text; give an XML file"
        )
    if not data.strip():
        raise ModelError(_source(path), "it is empty; give a URDF or an MJCF")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise ModelError(
            _source(path, line),
            f"byte 0x{data[error.start]:02x} is not UTF-8; save the file as UTF-8",
        ) from error


def _refuse_doctype(path: Path, text: str) -> None:
    """Refuses a DOCTYPE, which can only stand before the root element; none is ever needed."""
    at = 0
    while True:
        at = _SPACE.match(text, at).end()  # type: ignore[union-attr]
        closing = "-->" if text.startswith("<!--", at) else "?>"
        if closing == "?>" and not text.startswith("<?", at):
            break
        end = text.find(closing, at + len(closing) + 1 - (closing == "?>"))
        if end < 0:
            return
        at = end + len(closing)
    if text.startswith("<!", at):
        line = text.count("\n", 0, at) + 1
        raise ModelError(_source(path, line), "it has a DOCTYPE, which is refused; take it out")


_SPACE: Final = re.compile(r"\s*")


def _parser(recover: bool) -> etree.XMLParser:
    return etree.XMLParser(
        encoding="utf-8",
        recover=recover,
        resolve_entities=False,
        no_network=True,
        load_dtd=False,
        dtd_validation=False,
        huge_tree=False,
        remove_comments=True,
        remove_pis=True,
    )


def _line(element: etree._Element) -> int | None:
    """Returns an element's line; lxml is not sure of lines after 65534."""
    line = element.sourceline
    return line if line is not None and line < 65535 else None


def _refusal(path: Path, element: etree._Element, problem: str) -> ModelError:
    return ModelError(_source(path, _line(element)), _one_line(problem))


def _source(path: Path, line: int | None = None) -> str:
    name = str(path) if str(path).isprintable() else repr(str(path))
    return name if line is None else f"{name}:{line}"


def _one_line(text: object) -> str:
    return " ".join(str(text).split())


# ------------------------------------------------------------------------------------- files


def _existing(path: Path) -> Path | None:
    try:
        return path if path.is_file() else None
    except (OSError, ValueError):
        return None


def _folders_of_package(folder: Path, package: str) -> Iterator[Path]:
    """Yields the folders of that package that are a folder or stand in it."""
    if folder.name == package or _package_name(folder) == package:
        yield folder
    if package not in ("", ".", "..") and (folder / package).is_dir():
        yield folder / package


def _package_name(folder: Path) -> str | None:
    """Returns the name that a folder's package.xml gives."""
    manifest = _existing(folder / "package.xml")
    if manifest is None:
        return None
    try:
        _, root = _parse(manifest)
    except ModelError:
        return None
    return str(root.findtext("name", "")).strip()
