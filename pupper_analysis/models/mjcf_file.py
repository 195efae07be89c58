"""Reads an MJCF: what MuJoCo makes of it, and where its elements stand.

Includes are put in and attached models too. What needs files that are missing (meshes,
textures) is left out, and flat meshes, which MuJoCo refuses as solids, become shells.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import mujoco
from lxml import etree

from pupper_analysis.base.arguments import check_type
from pupper_analysis.base.diagnostics import Diagnostic, Term, diagnose
from pupper_analysis.models.mjcf import (
    compile_spec,
    no_number,
    silence_mujoco,
    spec_of,
)
from pupper_analysis.models.places import (
    Place,
    innermost_element,
    line_of,
    one_line,
    quote_short,
    refusal_at,
    refuse_file,
)
from pupper_analysis.models.published import existing_file
from pupper_analysis.models.xml import (
    MAX_DEPTH,
    MAX_ELEMENTS,
    NUMBER_PATTERN,
    parse_xml,
)


def leave_out_missing(
    spec: mujoco.MjSpec, tree: Tree, index: Mapping[tuple[str, str], Node]
) -> list[Diagnostic]:
    """Takes out of a spec what needs files that are missing; returns what it took out."""
    folders = tuple(tree.folders)

    def missing(file: str, folder: str) -> bool:
        name = Path(file).name if spec.strippath else file
        return bool(file) and not any(existing_file(top / folder / name) for top in folders)

    meshes = {m.name: m.file for m in spec.meshes if missing(m.file, m.compiler.meshdir)}
    textures = {
        t.name: next(filter(None, (t.file, *t.cubefiles)))
        for t in spec.textures
        if any(missing(file, t.compiler.texturedir) for file in (t.file, *t.cubefiles))
    }
    if not (meshes or textures):
        return []
    geoms = [geom for geom in spec.geoms if geom.meshname in meshes]
    for geom in geoms:
        if gives_mass(spec, geom):
            body = geom.parent.name
            place = index[("body", body)].place if ("body", body) in index else Place(tree.path)
            raise refuse_file(
                place,
                diagnose(
                    "mass-of-missing-mesh",
                    subject=("body", body),
                    geom=geom.name,
                    file=meshes[geom.meshname],
                ),
            )
    files = {"mesh": meshes, "texture": textures}
    touching = dict.fromkeys(
        meshes[geom.meshname]
        for geom in geoms
        if (geom.contype or geom.conaffinity) and geom.parent.name != "world"
    )
    notes = [
        diagnose(
            "files-missing",
            kind=Term(kind),
            files=dict.fromkeys(named.values()),
            touching=touching if kind == "mesh" else (),
            bodies=dict.fromkeys(geom.parent.name for geom in geoms),
        )
        for kind, named in files.items()
        if named
    ]
    for element in geoms:
        spec.delete(element)
    for name in textures:
        for material in spec.materials:
            if name in list(material.textures):
                material.textures = ["" if t == name else t for t in material.textures]
    for elements, gone in ((spec.meshes, meshes), (spec.textures, textures)):
        for element in list(elements):
            if element.name in gone:
                spec.delete(element)
    return notes


def gives_mass(spec: mujoco.MjSpec, geom: mujoco.MjsGeom) -> bool:
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


_FLAT: Final = re.compile(r"mesh volume is too small: (.*?) \. Try setting inertia to shell")


def flat_mesh(error: BaseException) -> str | None:
    """Returns the mesh whose volume is too small for MuJoCo; None if the error is another."""
    found = _FLAT.search(str(error))
    return found[1] if found else None


def compile_with_shells(make: Callable[[], mujoco.MjSpec]) -> tuple[mujoco.MjModel, list[str], str]:
    """Compiles a spec with its flat meshes as shells.

    A mesh gives its geom a centre and axes, a mass only where a body has no <inertial>: then a
    shell would weigh something else, and it stays refused.

    Args:
        make: Makes the spec, anew each time, for compiling changes it.

    Returns:
        The model, the meshes that were taken as shells, and what MuJoCo says of the first.
    """
    shells: list[str] = []
    said = ""
    while True:
        spec = make()
        put_shells(spec, shells)
        try:
            with silence_mujoco():
                return spec.compile(), shells, said
        except ValueError as error:
            name = flat_mesh(error)
            if name is None or name in shells or _weighs(spec, name):
                raise
            shells.append(name)
            said = said or str(error)


def put_shells(spec: mujoco.MjSpec, names: Collection[str]) -> None:
    """Makes shells of some meshes, in place."""
    for mesh in spec.meshes:
        if mesh.name in names:
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL


def taken_as_shells(names: list[str]) -> Diagnostic:
    """Tells which meshes are taken as shells."""
    return diagnose("flat-meshes-as-shells", names=names, version=mujoco.__version__)


def _weighs(spec: mujoco.MjSpec, name: str) -> bool:
    return any(geom.meshname == name and gives_mass(spec, geom) for geom in spec.geoms)


MAX_INCLUDES: Final = 1000
"""Most includes and attached models of an MJCF."""

MAX_INCLUDE_DEPTH: Final = 30
"""Deepest nesting of an MJCF's includes, and of the models it attaches."""

MAX_COPIES: Final = 10_000
"""Most elements that an MJCF's replicates and attached models make."""


@dataclass(frozen=True)
class Node:
    """An element of an MJCF with its includes put in.

    Attributes:
        tag: Its tag.
        attributes: As they are written.
        place: Where it stands.
        children: Those below it.
        childclass: The default class that reaches it from the bodies around it.
    """

    tag: str
    attributes: Mapping[str, str]
    place: Place
    children: list[Node]
    childclass: str | None = None


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


class Tree:
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
        self.attached: list[Node] = []
        self._models: dict[str, int] = {}
        self._parsed: dict[Path, etree._Element] = {}
        self._count = 0
        self._includes = includes or itertools.count(1)
        if len(self._within) > MAX_INCLUDE_DEPTH:
            raise refuse_file(Place(path), diagnose("attached-too-deep", most=MAX_INCLUDE_DEPTH))
        self.root = self._node(root, path, self._within, 0)
        self.copies = self._copies(self.root)
        if self.copies > self._count + MAX_COPIES:
            raise refuse_file(Place(path), diagnose("too-many-copies", most=MAX_COPIES))

    def _node(
        self,
        element: etree._Element,
        path: Path,
        within: tuple[Path, ...],
        depth: int,
        childclass: str | None = None,
    ) -> Node:
        attributes = {str(name): str(value) for name, value in element.attrib.items()}
        place = Place(path, line_of(element))
        node = Node(str(element.tag), attributes, place, [], childclass)
        childclass = attributes.get("childclass", childclass)
        self._count += 1
        if self._count > MAX_ELEMENTS:
            raise refuse_file(
                Place(self.path), diagnose("too-many-elements", count=None, most=MAX_ELEMENTS)
            )
        if depth > MAX_DEPTH:
            raise refusal_at(path, element, diagnose("nested-too-deep", most=MAX_DEPTH))
        _refuse_large(path, element)
        _refuse_formats(path, element)
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
                node.children.append(self._node(child, file, inside, depth + 1, childclass))
        return node

    def _include(
        self, element: etree._Element, path: Path, within: tuple[Path, ...]
    ) -> tuple[Path, etree._Element]:
        included = self._file(element, path)
        resolved = included.resolve()
        if resolved in within:
            raise refusal_at(path, element, diagnose("includes-itself", file=included.name))
        if len(within) > MAX_INCLUDE_DEPTH:
            raise refusal_at(path, element, diagnose("includes-too-deep", most=MAX_INCLUDE_DEPTH))
        if resolved not in self._parsed:
            self.files[included] = None
            _, self._parsed[resolved] = parse_xml(included)
        return included, self._parsed[resolved]

    def _attach(self, element: etree._Element, path: Path) -> None:
        attached = self._file(element, path)
        if attached.resolve() in self._within:
            raise refusal_at(path, element, diagnose("attaches-itself", file=attached.name))
        _, root = parse_xml(attached)
        tree = Tree(attached, root, self._within, self._includes)
        self.files |= tree.files
        self.attached += [tree.root, *tree.attached]
        self.folders |= tree.folders
        name = element.get("name") or root.get("model") or attached.stem
        self._models[name] = tree.copies

    def _file(self, element: etree._Element, path: Path) -> Path:
        """Counts and finds an include: by the main file first, then by its own file."""
        if next(self._includes) > MAX_INCLUDES:
            raise refusal_at(path, element, diagnose("too-many-includes", most=MAX_INCLUDES))
        name = element.get("file")
        if not name:
            raise refusal_at(path, element, diagnose("element-without-file", tag=element.tag))
        for folder in (self.path.parent, path.parent):
            found = existing_file(folder / name)
            if found is not None:
                return found
        missing = diagnose("included-file-missing", tag=element.tag, file=quote_short(name))
        raise refusal_at(path, element, missing)

    def _copies(self, node: Node) -> int:
        number = 1 + sum(self._copies(child) for child in node.children)
        if node.tag == "replicate":
            number *= max(_product(node.attributes.get("count", "1")), 1)
        if node.tag == "attach":
            number += self._models.get(node.attributes.get("model", ""), 0)
        return number


_HEXADECIMAL: Final = re.compile("0[xX][0-9a-fA-F]+")


def _refuse_large(path: Path, element: etree._Element) -> None:
    for tag, attributes, limit in _LARGEST:
        if tag in ("*", element.tag):
            text = " ".join(element.get(attribute, "") for attribute in attributes)
            if _product(text) > limit:
                names = " x ".join(attributes)
                problem = diagnose("size-too-large", tag=element.tag, names=names, most=limit)
                raise refusal_at(path, element, problem)


_FORMAT: Final = re.compile(r"%[-+ #0-9.*'$hlLqjzt]*[nsS]")
"""What printf writes to memory for, or takes for the address of a text."""

_FREE_TEXT: Final = ("data", "file", "meshdir", "texturedir", "assetdir")


def _refuse_formats(path: Path, element: etree._Element) -> None:
    """Refuses words that MuJoCo's reader takes for a format of its own messages, and dies of."""
    for attribute, value in element.attrib.items():
        if attribute not in _FREE_TEXT and _FORMAT.search(str(value)):
            where = {"tag": element.tag, "attribute": attribute, "value": quote_short(str(value))}
            raise refusal_at(path, element, diagnose("format-in-attribute", **where))


def _product(text: str) -> int:
    # MuJoCo reads 0x10, too.
    words = text.split()
    numbers = [abs(float(word)) for word in words if NUMBER_PATTERN.fullmatch(word)]
    numbers += [float(int(word, 16)) for word in words if _HEXADECIMAL.fullmatch(word)]
    product = math.prod(max(number, 1.0) for number in numbers)
    return int(min(product, 1e18))


def walk_elements(root: Node) -> Iterator[Node]:
    """Yields an element and all below it, in the order of the file."""
    pending = [root]
    while pending:
        node = pending.pop()
        yield node
        pending.extend(reversed(node.children))


def index_of(root: Node) -> dict[tuple[str, str], Node]:
    """Finds the elements by kind and name; the first counts where there are several."""
    index: dict[tuple[str, str], Node] = {}
    fallback: dict[tuple[str, str], Node] = {}
    pending: list[tuple[Node, Node]] = [(child, root) for child in reversed(root.children)]
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


def stating_element(root: Node, node: Node, attributes: Collection[str]) -> Node | None:
    """Returns the element that states one of an element's attributes: itself, or a default class.

    The class is its own, or the childclass of a body above it; what a class does not state is that
    of the class around it.

    Args:
        root: The root element.
        node: The element.
        attributes: Any of them will do.
    """
    if set(attributes) & set(node.attributes):
        return node
    name = node.attributes.get("class") or node.childclass
    nested = _classes(root, name)
    for default in reversed(nested):
        for child in default.children:
            if child.tag == node.tag and set(attributes) & set(child.attributes):
                return child
    return None


def _classes(root: Node, name: str | None) -> list[Node]:
    """Returns a default class with those around it, the outermost first."""
    tops = [child for child in root.children if child.tag == "default"]
    pending = [[top] for top in tops]
    while name is not None and pending:
        path = pending.pop()
        if path[-1].attributes.get("class") == name:
            return path
        pending.extend([*path, child] for child in path[-1].children if child.tag == "default")
    return tops[:1]


@dataclass(frozen=True, eq=False)
class MjcfFile:
    """An MJCF that MuJoCo has parsed.

    Attributes:
        path: The file.
        spec: What MuJoCo read, not compiled, without what needs files that are missing.
        files: The file and all it includes.
        notes: What was left out on reading, or made up for.
        refusal: Why MuJoCo does not compile the file as it is, and where; None if it does.
            ``MjSpec.copy()`` drops elements that refer to nothing, so that a copy of the spec may
            compile where the file does not.
        as_it_is: The same of what was made up for, as `notes` tell: flat meshes.
        unknown: {kind of a joint's number: the joints of which it is not known}, where this stands
            for a file of another format that can leave open what an MJCF sets to zero.
        stands_for: What the file of another format is called for which this stands, such as
            ``"the SDF"``; "" if for none.
        gains: {joint: stiffness and damping of its servo} (N m/rad, N m s/rad; N/m, N s/m) that
            such a file states; None where its format states none.
        of_urdf: Whether it was made of a URDF, which states nothing of ground and contacts.
    """

    path: Path
    spec: mujoco.MjSpec = field(repr=False)
    files: tuple[Path, ...] = ()
    notes: tuple[Diagnostic, ...] = ()
    refusal: tuple[Diagnostic, Place] | None = None
    as_it_is: tuple[Diagnostic, Place] | None = None
    unknown: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    _model: mujoco.MjModel | None = field(default=None, repr=False)
    _index: Mapping[tuple[str, str], Node] = field(default_factory=dict, repr=False)
    _roots: tuple[Node, ...] = field(default=(), repr=False)
    of_urdf: bool = False
    stands_for: str = ""
    gains: Mapping[str, tuple[float, float]] | None = None

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
        return Place(self.path) if node is None else innermost_element(node, child, _child).place

    def stated(self, kind: str, name: str, attributes: Collection[str]) -> Place | None:
        """Finds where an element's attributes are stated: in itself, or in a default class.

        Args:
            kind: Its tag or section, as in `place`.
            name: Its name, as in `place`.
            attributes: Any of them will do.

        Returns:
            The place; None where nothing states any of them.
        """
        node = self._index.get((kind, name))
        if node is None or not self._roots:
            return None
        found = stating_element(self._roots[0], node, attributes)
        return None if found is None else found.place

    def nth(self, body: str, tag: str, number: int, attributes: Collection[str] = ()) -> Place:
        """Finds an element without a name: the n-th of its tag, from 0, directly in a body.

        Args:
            body: The body's name; ``"world"`` is the worldbody.
            tag: The element's.
            number: Which.
            attributes: Where one of these is stated is asked for: in itself, or a default class.

        Returns:
            Its file and line; those of the body where it has no so many, as within a ``<frame>``.
        """
        node = self._index.get(("body", body))
        tops = (top for root in self._roots for top in root.children if top.tag == "worldbody")
        above = list(tops) if body == "world" else [] if node is None else [node]
        found = [one for top in above for one in top.children if one.tag == tag]
        if number >= len(found):
            return self.place("body", body)
        stating = stating_element(self._roots[0], found[number], attributes) if attributes else None
        return (stating or found[number]).place

    @property
    def lacking(self) -> tuple[str, ...]:
        """The files of meshes with which the robot touches, and which are missing."""
        return self._of_missing("touching")

    @property
    def bare(self) -> tuple[str, ...]:
        """The bodies with geoms that are left out, as the files of their meshes are missing."""
        return self._of_missing("bodies")

    def _of_missing(self, word: str) -> tuple[str, ...]:
        named = [note.values.get(word) for note in self.notes if note.code == "files-missing"]
        return tuple(str(name) for names in named if isinstance(names, tuple) for name in names)

    def elements(self, tag: str) -> Iterator[tuple[Mapping[str, str], Place]]:
        """Yields the attributes and the place of every element of a kind, as they are written.

        In the file, in what it includes, and in the models it attaches.
        """
        for root in self._roots:
            for node in walk_elements(root):
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

    @property
    def model(self) -> mujoco.MjModel:
        """What MuJoCo compiles the file to, as it is (without what files are missing for).

        It is shared: who changes it takes a copy, which is as long as its meshes are large.

        Raises:
            ModelError: If MuJoCo refuses it; the message is MuJoCo's.
        """
        self.check_compiled()
        assert self._model is not None
        return self._model

    def check_compiled(self) -> None:
        """Passes on MuJoCo's refusal, if there is one.

        Raises:
            ModelError: If MuJoCo refuses the file; the message is MuJoCo's.
        """
        if self.refusal is not None:
            problem, place = self.refusal
            raise refuse_file(place, problem)


def read_mjcf(path: str | Path) -> MjcfFile:
    """Reads an MJCF with all it includes, and compiles it as it is.

    Raises:
        ModelError: If it cannot be loaded, or MuJoCo does not compile it; one line that tells where
            and why.
    """
    check_type("mjcf", path, str | Path)
    path = Path(path)
    _, root = parse_xml(path)
    file = mjcf_from(path, root)
    _ = file.model  # raises
    return file


def mjcf_of_text(path: Path, text: str, assets: Mapping[str, bytes]) -> MjcfFile:
    """Makes an MJCF that was written here, in memory.

    Args:
        path: The file that it was made from, of which its errors tell; all places are its.
        text: Its XML, whose paths are absolute or names of ``assets``.
        assets: {name: content} of files that it names.

    Raises:
        ModelError: If MuJoCo refuses it; the message is MuJoCo's.
    """
    try:
        with silence_mujoco():
            spec, same = (mujoco.MjSpec.from_string(text, assets=dict(assets)) for _ in range(2))
    except _MUJOCO_ERRORS as error:
        message = one_line(error)
        raise refuse_file(Place(path), diagnose("mjcf-not-valid", message=message)) from error
    return MjcfFile(path, spec, _model=compile_spec(same, path))


_MUJOCO_ERRORS: Final = (ValueError, RuntimeError, TypeError, OSError, MemoryError)


def mjcf_from(path: Path, root: etree._Element) -> MjcfFile:
    """Makes an MJCF of its root element; ``refusal`` tells if MuJoCo does not compile it.

    Raises:
        ModelError: If MuJoCo cannot read it.
    """
    if root.tag != "mujoco":
        urdf, part = root.tag == "robot", root.tag == "mujocoinclude"
        tag = str(root.tag)
        raise refusal_at(path, root, diagnose("no-mjcf", tag=tag, urdf=urdf, part=part))
    tree = Tree(path, root)
    index = index_of(tree.root)
    spec, notes = _spec(tree, index)
    model, refused, as_it_is = None, None, None
    try:
        # Another spec, for compiling changes it; and no copy, which lacks what is dangling.
        model, shells, said = compile_with_shells(lambda: _spec(tree, index)[0])
        if shells:
            put_shells(spec, shells)
            notes.append(taken_as_shells(shells))
            as_it_is = _not_compiled(tree, index, ValueError(said))
    except _MUJOCO_ERRORS as error:
        refused = _not_compiled(tree, index, error)
    problem = None if model is None else no_number(model)
    if problem is not None:
        model, refused = None, (problem, Place(path))
    return MjcfFile(
        path,
        spec,
        tuple(tree.files),
        tuple(notes),
        refused,
        as_it_is,
        {},
        model,
        index,
        (tree.root, *tree.attached),
    )


def _spec(
    tree: Tree, index: Mapping[tuple[str, str], Node]
) -> tuple[mujoco.MjSpec, list[Diagnostic]]:
    """Returns what MuJoCo reads, without what needs files that are missing, and what that is."""
    try:
        with silence_mujoco():
            spec = spec_of(tree.path)
    except _MUJOCO_ERRORS as error:
        message, place = _mujoco_message(tree, index, error)
        raise refuse_file(place, diagnose("mjcf-not-valid", message=message)) from error
    return spec, leave_out_missing(spec, tree, index)


def _not_compiled(
    tree: Tree, index: Mapping[tuple[str, str], Node], error: BaseException
) -> tuple[Diagnostic, Place]:
    message, place = _mujoco_message(tree, index, error)
    return diagnose("mjcf-not-compiled", message=message), place


def _mujoco_message(
    tree: Tree, index: Mapping[tuple[str, str], Node], error: BaseException
) -> tuple[str, Place]:
    """Returns MuJoCo's message, and the place of the element that it is about.

    MuJoCo tells the line in the main file, or in an unnamed one, and 0 of what is included; and the
    name that it tells may be the one that is not there.
    """
    message = one_line(error)
    found = re.search(r"(?:, line |Line number=)([1-9][0-9]*)", message)
    if found and len(tree.files) == 1:
        return message, Place(tree.path, int(found[1]))
    said = set(re.findall(r"'([^']+)'", message))
    name = re.search(r"Element name '([^']+)'", message)
    named = [node.place for (_, known), node in index.items() if name and known == name[1]]
    nodes = [node for root in (tree.root, *tree.attached) for node in walk_elements(root)]
    meant = [
        node.place
        for node in nodes
        if said & {v for k, v in node.attributes.items() if k != "name" or found}
        and (not found or node.place.line == int(found[1]))
    ]
    return message, (*named, *meant, Place(tree.path))[0]


def _child(node: Node, tag: str) -> Node | None:
    """Returns a node's first child of a tag; a free joint is a joint."""
    tags = ("joint", "freejoint") if tag == "joint" else (tag,)
    return next((child for child in node.children if child.tag in tags), None)
