"""Reading of MJCF files: compiled model, and location (file and line) of each element.

Includes are expanded, and attached models are read. Meshes and textures with missing files are
removed, with the geoms that use these meshes. MuJoCo rejects flat meshes as solids; the reader
turns flat meshes that determine no mass into shells.
"""

from __future__ import annotations

import itertools
import math
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import mujoco
import numpy as np
from lxml import etree
from numpy.typing import ArrayLike

from pupper_analysis.base.arguments import check_type
from pupper_analysis.base.diagnostics import Diagnostic, Term, diagnose
from pupper_analysis.models.mjcf import (
    compile_spec,
    find_invalid_number,
    parse_spec,
    silence_mujoco,
    to_xml,
)
from pupper_analysis.models.places import (
    Place,
    forget_lines,
    innermost_element,
    line_of,
    make_element_error,
    make_file_error,
    one_line,
    quote_short,
    shorten_message,
)
from pupper_analysis.models.published import existing_file
from pupper_analysis.models.xml import (
    MAX_DEPTH,
    MAX_ELEMENTS,
    NUMBER_PATTERN,
    parse_text,
    parse_xml,
)


def leave_out_missing(
    spec: mujoco.MjSpec, tree: IncludeTree, index: Mapping[tuple[str, str], XmlNode]
) -> list[Diagnostic]:
    """Remove meshes with missing files, their geoms, and textures with missing files from a spec.

    Args:
        spec: Spec; modified.
        tree: Elements of the file, whose folders are searched.
        index: {(tag or section, name): element}, from `index_of`.

    Returns:
        Notes on the missing files.

    Raises:
        ModelError: If the mass of a body depends on a missing mesh.
        OutputError: If this run of the command line also writes a mesh or a texture.
    """
    meshes, textures = _find_missing_files(spec, tree, index)
    if not (meshes or textures):
        return []
    geoms = [geom for geom in spec.geoms if geom.meshname in meshes]
    for geom in geoms:
        if gives_mass(spec, geom):
            body = geom.parent.name
            place = index[("body", body)].place if ("body", body) in index else Place(tree.path)
            raise make_file_error(
                place,
                diagnose(
                    "mass-of-missing-mesh",
                    subject=("body", body),
                    geom=geom.name,
                    file=meshes[geom.meshname],
                ),
            )
    notes = _describe_missing_files(meshes, textures, geoms)
    for element in geoms:
        spec.delete(element)
    for name in textures:
        for material in spec.materials:
            if name in list(material.textures):
                material.textures = ["" if t == name else t for t in material.textures]
    for elements, removed in ((spec.meshes, meshes), (spec.textures, textures)):
        for element in list(elements):
            if element.name in removed:
                spec.delete(element)
    return notes


def _find_missing_files(
    spec: mujoco.MjSpec, tree: IncludeTree, index: Mapping[tuple[str, str], XmlNode]
) -> tuple[dict[str, str], dict[str, str]]:
    """Return {mesh: file} and {texture: first missing file} for elements with missing files."""
    folders = tuple(tree.folders)
    in_memory = {Path(name).name for name in spec.assets}

    def is_missing(file: str, folder: str) -> bool:
        """Return True if a mesh or texture file is neither in memory nor in a model folder."""
        name = Path(file).name if spec.strippath else file
        if Path(name).name in in_memory:
            return False
        return bool(file) and not any(existing_file(top / folder / name) for top in folders)

    # MuJoCo changes the name of a missing file that an included file states.
    nodes = {name: node for (tag, name), node in index.items() if tag == "mesh"}
    meshes = {
        mesh.name: nodes[mesh.name].attributes.get("file", mesh.file)
        if mesh.name in nodes
        else mesh.file
        for mesh in spec.meshes
        if is_missing(mesh.file, mesh.compiler.meshdir)
    }
    textures = {
        texture.name: file
        for texture in spec.textures
        for file in reversed((texture.file, *texture.cubefiles))  # the first overwrites the others
        if is_missing(file, texture.compiler.texturedir)
    }
    return meshes, textures


def _describe_missing_files(
    meshes: Mapping[str, str], textures: Mapping[str, str], geoms: Collection[mujoco.MjsGeom]
) -> list[Diagnostic]:
    """Return a note about missing mesh files and a note about missing texture files, if any.

    ``meshes`` and ``textures`` are {name: missing file}; ``geoms`` have these meshes.
    """
    collision_meshes = dict.fromkeys(
        meshes[geom.meshname]
        for geom in geoms
        if (geom.contype or geom.conaffinity) and geom.parent.name != "world"
    )
    return [
        diagnose(
            "files-missing",
            kind=Term(kind),
            files=dict.fromkeys(names_and_files.values()),
            touching=collision_meshes if kind == "mesh" else (),
            bodies=dict.fromkeys(geom.parent.name for geom in geoms) if kind == "mesh" else (),
        )
        for kind, names_and_files in (("mesh", meshes), ("texture", textures))
        if names_and_files
    ]


def gives_mass(spec: mujoco.MjSpec, geom: mujoco.MjsGeom) -> bool:
    """Return True if MuJoCo computes mass and inertia of the geom's body from the geom."""
    body = geom.parent
    if body.name == spec.worldbody.name:
        return False
    inertia_from_geom = geom.compiler.inertiafromgeom
    if inertia_from_geom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE or (
        inertia_from_geom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
        and body.explicitinertial
    ):
        return False
    low, high = geom.compiler.inertiagrouprange
    mass_or_density = geom.density if math.isnan(geom.mass) else geom.mass
    return bool(low <= geom.group <= high and mass_or_density != 0)


_FLAT_MESH_ERROR: Final = re.compile(
    r"mesh volume is too small: (.*?) \. Try setting inertia to shell"
)
"""Pattern of MuJoCo's error about a mesh without volume."""


def find_flat_mesh(error: BaseException) -> str | None:
    """Return the name of the mesh that MuJoCo rejects for lack of volume; None for other errors."""
    match = _FLAT_MESH_ERROR.search(str(error))
    return match[1] if match else None


def compile_with_shells(make: Callable[[], mujoco.MjSpec]) -> tuple[mujoco.MjModel, list[str], str]:
    """Compile a spec; meshes without volume, which MuJoCo rejects, become thin shells.

    A flat mesh that determines a mass is an error, because a shell would have another mass.

    Args:
        make: Function that creates the spec; called for each attempt, because compiling modifies a
            spec.

    Returns:
        Model; names of the shells; MuJoCo's message about the first flat mesh ("" if none).

    Raises:
        ValueError: If a flat mesh determines a mass, for example. Other exceptions of ``make`` are
            not converted.
    """
    shells: list[str] = []
    first_message = ""
    while True:
        spec = make()
        put_shells(spec, shells)
        try:
            with silence_mujoco():
                return spec.compile(), shells, first_message
        except ValueError as error:
            name = find_flat_mesh(error)
            if name is None or name in shells or _determines_mass(spec, name):
                raise
            shells.append(name)
            first_message = first_message or str(error)


def put_shells(spec: mujoco.MjSpec, names: Collection[str]) -> None:
    """Set in a spec, in place, that MuJoCo computes the inertia of given meshes as thin shells."""
    for mesh in spec.meshes:
        if mesh.name in names:
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL


def report_shells(names: list[str]) -> Diagnostic:
    """Create the note that MuJoCo treats flat meshes as thin shells to compute the inertia."""
    return diagnose("flat-meshes-as-shells", names=names, version=mujoco.__version__)


def _determines_mass(spec: mujoco.MjSpec, name: str) -> bool:
    """Return True if MuJoCo computes the inertia of a body from the mesh with this name."""
    return any(geom.meshname == name and gives_mass(spec, geom) for geom in spec.geoms)


MAX_INCLUDES: Final = 1000
"""Largest number of includes and attached models of an MJCF; a file with more is refused. Bounds
the reading time. Chosen, not tuned."""

MAX_INCLUDE_DEPTH: Final = 30
"""Largest number of nested includes in an MJCF, and of nested models, of which each attaches the
next; deeper nesting is refused. Bounds the reading time. Chosen, not tuned.
"""

MAX_COPIES: Final = 10_000
"""Largest estimated number of elements that the replicates and attached models of an MJCF create;
more are refused. Bounds the compile time. Chosen, not tuned.
"""


@dataclass(frozen=True)
class XmlNode:
    """XML element of an MJCF whose includes are replaced by the included elements.

    Attributes:
        tag: Tag.
        attributes: Attributes as in the file.
        place: Location: file and line.
        children: Child elements.
        childclass: Default class for the element, from the nearest element above with the attribute
            ``childclass``, for example a body; None without.
    """

    tag: str
    attributes: Mapping[str, str]
    place: Place
    children: list[XmlNode]
    childclass: str | None = None


_MAX_PRODUCTS: Final = (
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
"""(tag, attributes, upper bound of the product of their numbers). A file with a larger product is
refused, because MuJoCo could hang, or exhaust the memory. The tag "*" stands for every tag. Chosen,
not tuned."""

_SECTION_TAGS: Final = ("actuator", "sensor", "equality", "tendon", "contact", "deformable")
"""Sections of an MJCF whose elements can also be found by (section, name) instead of (tag, name),
because their tags vary (``motor``, ``position`` ...).
"""


class IncludeTree:
    """Tree of the XML elements of an MJCF with all its includes, and list of its files.

    Attached models are read if their file name ends with ``.xml``.

    Args:
        path: The file.
        root: Root element of the file.
        within: Resolved paths of the files that attach this file, the outermost first; empty for
            the main file.
        includes: Counter of the includes, shared by attached files; a new counter by default.

    Attributes:
        files: The file, the included files, and the attached files that are read.
        attached: Root elements of the attached models that are read, directly and indirectly.
        folders: Folders of the file and of the attached models.
        root: Root element.
        copies: Estimated number of elements after expansion of replicates and attached models. Each
            ``<attach>`` counts as all elements of the attached model.

    Raises:
        ModelError: For example if an included or attached file is missing or not valid, if files
            include each other in a loop, or if a limit of number, size or depth is exceeded.
        OutputError: If this run of the command line also writes one of these files.
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
        self._open_files = (*within, path.resolve())
        self.attached: list[XmlNode] = []
        self._copies_by_model: dict[str, int] = {}
        self._parsed_roots: dict[Path, etree._Element] = {}
        self._num_elements = 0
        self._include_counter = includes or itertools.count(1)
        if len(self._open_files) > MAX_INCLUDE_DEPTH:
            raise make_file_error(
                Place(path), diagnose("attached-too-deep", most=MAX_INCLUDE_DEPTH)
            )
        self.root = self._make_node(root, path, self._open_files, 0)
        self.copies = self._count_copies(self.root)
        if self.copies > self._num_elements + MAX_COPIES:
            raise make_file_error(Place(path), diagnose("too-many-copies", most=MAX_COPIES))

    def _make_node(
        self,
        element: etree._Element,
        path: Path,
        within: tuple[Path, ...],
        depth: int,
        childclass: str | None = None,
    ) -> XmlNode:
        """Convert a parsed MJCF element and its descendants to nodes, with the includes expanded.

        ``within`` are the resolved paths of the including files. ``childclass`` is the default
        class from the elements above.
        """
        attributes = {str(name): str(value) for name, value in element.attrib.items()}
        place = Place(path, line_of(element))
        node = XmlNode(str(element.tag), attributes, place, [], childclass)
        childclass = attributes.get("childclass", childclass)
        self._num_elements += 1
        if self._num_elements > MAX_ELEMENTS:
            raise make_file_error(
                Place(self.path), diagnose("too-many-elements", count=None, most=MAX_ELEMENTS)
            )
        if depth > MAX_DEPTH:
            raise make_element_error(path, element, diagnose("nested-too-deep", most=MAX_DEPTH))
        _check_sizes(path, element)
        _check_formats(path, element)
        if element.tag == "model" and element.get("file", "").endswith(".xml"):
            self._read_attached(element, path)
        pending = [(child, path, within) for child in reversed(element)]
        while pending:
            child, file, inside = pending.pop()
            if child.tag == "include":
                included, top = self._read_include(child, file, inside)
                opened = (*inside, included.resolve())
                pending.extend((below, included, opened) for below in reversed(top))
            else:
                node.children.append(self._make_node(child, file, inside, depth + 1, childclass))
        return node

    def _read_include(
        self, element: etree._Element, path: Path, within: tuple[Path, ...]
    ) -> tuple[Path, etree._Element]:
        """Return path and root element of the file of an ``<include>`` in the file ``path``.

        ``within`` are the resolved paths of the including files, for detecting loops and depth.
        """
        included = self._find_included(element, path)
        resolved = included.resolve()
        if resolved in within:
            raise make_element_error(path, element, diagnose("includes-itself", file=included.name))
        if len(within) > MAX_INCLUDE_DEPTH:
            raise make_element_error(
                path, element, diagnose("includes-too-deep", most=MAX_INCLUDE_DEPTH)
            )
        if resolved not in self._parsed_roots:
            self.files[included] = None
            _, self._parsed_roots[resolved] = parse_xml(included)
        return included, self._parsed_roots[resolved]

    def _read_attached(self, element: etree._Element, path: Path) -> None:
        """Read the file of a ``<model>``, and add its files, folders and elements to this tree."""
        attached = self._find_included(element, path)
        if attached.resolve() in self._open_files:
            raise make_element_error(path, element, diagnose("attaches-itself", file=attached.name))
        _, root = parse_xml(attached)
        tree = IncludeTree(attached, root, self._open_files, self._include_counter)
        self.files |= tree.files
        self.attached += [tree.root, *tree.attached]
        self.folders |= tree.folders
        name = element.get("name") or root.get("model") or attached.stem
        self._copies_by_model[name] = tree.copies

    def _find_included(self, element: etree._Element, path: Path) -> Path:
        """Return the existing file of an include or attached model, and count the include."""
        if next(self._include_counter) > MAX_INCLUDES:
            raise make_element_error(
                path, element, diagnose("too-many-includes", most=MAX_INCLUDES)
            )
        name = element.get("file")
        if not name:
            raise make_element_error(
                path, element, diagnose("element-without-file", tag=element.tag)
            )
        for folder in (self.path.parent, path.parent):
            found = existing_file(folder / name)
            if found is not None:
                return found
        missing = diagnose("included-file-missing", tag=element.tag, file=quote_short(name))
        raise make_element_error(path, element, missing)

    def _count_copies(self, node: XmlNode) -> int:
        """Estimate the number of elements in a subtree, with replicas and attached models."""
        total = 1 + sum(self._count_copies(child) for child in node.children)
        if node.tag == "replicate":
            total *= max(_multiply_numbers(node.attributes.get("count", "1")), 1)
        if node.tag == "attach":
            total += self._copies_by_model.get(node.attributes.get("model", ""), 0)
        return total


_HEXADECIMAL_NUMBER: Final = re.compile("0[xX][0-9a-fA-F]+")
"""Pattern of a hexadecimal number, which MuJoCo accepts in place of a decimal one."""


def _check_sizes(path: Path, element: etree._Element) -> None:
    """Raise a ModelError if a product of size attributes of an element exceeds `_MAX_PRODUCTS`."""
    for tag, attributes, limit in _MAX_PRODUCTS:
        if tag in ("*", element.tag):
            text = " ".join(element.get(attribute, "") for attribute in attributes)
            if _multiply_numbers(text) > limit:
                names = " x ".join(attributes)
                problem = diagnose("size-too-large", tag=element.tag, names=names, most=limit)
                raise make_element_error(path, element, problem)


_FORMAT_DIRECTIVE: Final = re.compile(r"%[-+ #0-9.*'$hlLqjzt]*[nsS]")
"""Pattern of printf directives that access memory (``%n``, ``%s``, ``%S``). Attributes outside of
`_TEXT_ATTRIBUTES` with such directives are refused, because MuJoCo's reader uses some texts as
format strings and would crash.
"""

_TEXT_ATTRIBUTES: Final = ("data", "file", "meshdir", "texturedir", "assetdir")
"""Attributes that may contain directives of printf, because MuJoCo does not use them as format
strings."""


def _check_formats(path: Path, element: etree._Element) -> None:
    """Raise a ModelError for texts that crash MuJoCo's reader when used as format strings."""
    for attribute, value in element.attrib.items():
        if attribute not in _TEXT_ATTRIBUTES and _FORMAT_DIRECTIVE.search(str(value)):
            values = {"tag": element.tag, "attribute": attribute, "value": quote_short(str(value))}
            raise make_element_error(path, element, diagnose("format-in-attribute", **values))


_MAX_PRODUCT = 10**18
"""Upper bound of the result of `_multiply_numbers`, far above all accepted numbers of elements."""


def _multiply_numbers(text: str) -> int:
    """Return the product of the magnitudes of the numbers in a text, rounded down.

    The result is at most `_MAX_PRODUCT`. Magnitudes below 1 count as 1, and words that are no
    numbers are ignored.
    """
    # MuJoCo also accepts hexadecimal numbers.
    words = text.split()
    numbers = [abs(float(word)) for word in words if NUMBER_PATTERN.fullmatch(word)]
    numbers += [
        float(min(int(word, 16), _MAX_PRODUCT))
        for word in words
        if _HEXADECIMAL_NUMBER.fullmatch(word)
    ]
    product = math.prod(max(number, 1.0) for number in numbers)
    return int(min(product, _MAX_PRODUCT))


def walk_elements(root: XmlNode) -> Iterator[XmlNode]:
    """Yield an element and all descendants, in document order."""
    pending = [root]
    while pending:
        node = pending.pop()
        yield node
        pending.extend(reversed(node.children))


_INDIRECT_SECTION_TAGS: Final = ("equality", "sensor")
"""Sections of an MJCF whose tags are not kinds of elements: ``<equality><joint name="a"/>`` is an
equality, and no joint with the name ``a``."""


def name_unnamed_joint(body: str, number: int) -> str:
    """Return the substitute for the name of a joint without name: "(BODY)", "(BODY #2)" ...

    Args:
        body: Name of the body.
        number: Number of the joint among the joints of the body without a name, from 1.
    """
    return f"({body})" if number == 1 else f"({body} #{number})"


def index_of(root: XmlNode) -> dict[tuple[str, str], XmlNode]:
    """Return an index of the elements of an MJCF: {(tag or section, name): element}.

    - Elements of the sections `_SECTION_TAGS` have a key (section, name), such as ("actuator",
    name); elements of the sections `_INDIRECT_SECTION_TAGS` have no key (tag, name).
    - Elements without a name may have a substitute, for example a mesh the name of its file, an
    actuator the name of its joint, and a joint the substitute of `name_unnamed_joint`.
    - Of several elements with the same name, the first in the file is listed.
    """
    index: dict[tuple[str, str], XmlNode] = {}
    fallback: dict[tuple[str, str], XmlNode] = {}
    numbers: Counter[str] = Counter()
    # (element, parent, name of the body around the element)
    pending = [(child, root, "") for child in reversed(root.children)]
    while pending:
        node, parent, body = pending.pop()
        name = node.attributes.get("class" if node.tag == "default" else "name")
        inner = node.attributes.get("name", "") if node.tag == "body" else body
        inner = inner if node.tag in ("body", "frame", "replicate") else ""
        pending.extend((child, node, inner) for child in reversed(node.children))
        kinds = [] if parent.tag in _INDIRECT_SECTION_TAGS else [node.tag]
        if parent.tag in _SECTION_TAGS:
            kinds.append(parent.tag)
        if node.tag == "freejoint":
            kinds.append("joint")
        if not name and node.tag in ("mesh", "texture", "hfield"):
            name = Path(node.attributes.get("file", "")).stem
        if not name and body and "joint" in kinds:
            numbers[body] += 1
            for substitute in (name_unnamed_joint(body, numbers[body]), body):
                for kind in kinds:
                    fallback.setdefault((kind, substitute), node)
        for kind in kinds:
            if name:
                index.setdefault((kind, name), node)
            if parent.tag == "actuator" and "joint" in node.attributes:
                fallback.setdefault((kind, node.attributes["joint"]), node)
    return fallback | index


def find_stating_element(
    root: XmlNode, node: XmlNode, attributes: Collection[str]
) -> XmlNode | None:
    """Find the element that sets an attribute: the node, or an element of its default class.

    Args:
        root: Root element.
        node: Element.
        attributes: Attributes, of which one is sufficient.

    Returns:
        The element, or an element of a default class; None if neither sets an attribute.
    """
    if set(attributes) & set(node.attributes):
        return node
    name = node.attributes.get("class") or node.childclass
    nested = _find_default_classes(root, name)
    common = set(attributes) & _COMMON_ACTUATOR_ATTRIBUTES if node.tag in _ACTUATOR_TAGS else set()
    for default in reversed(nested):
        for child in default.children:
            wanted = set(attributes) if child.tag == node.tag else common
            if wanted & set(child.attributes) and child.tag in (node.tag, *_ACTUATOR_TAGS):
                return child
    return None


_ACTUATOR_TAGS = frozenset(
    (
        *("general", "motor", "position", "velocity", "intvelocity", "orientation", "pid"),
        *("damper", "cylinder", "muscle", "adhesion", "dcmotor"),
    )
)
"""Tags of actuators in an MJCF. In a default class, these tags change the same defaults."""

_COMMON_ACTUATOR_ATTRIBUTES = frozenset(
    ("forcerange", "forcelimited", "ctrlrange", "ctrllimited", "gear", "lengthrange", "cranklength")
)
"""Attributes that an actuator inherits from a default of another actuator tag. Attributes such as
``kp`` are not listed: they set gain and bias, and another tag, such as ``motor``, replaces both.
"""


def _find_default_classes(root: XmlNode, name: str | None) -> list[XmlNode]:
    """Return a default class and its enclosing classes, outermost first.

    For None or an unknown name, the result contains at most the first top-level class.
    """
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
    """MJCF file that MuJoCo has parsed, with the location of each element.

    Attributes:
        path: The file.
        spec: Parsed spec, not compiled, without elements whose files are missing.
        files: The file, the included files, and the attached files that were read; empty for a
            generated text.
        notes: Diagnostics of removed or replaced elements.
        refusal: Message and location if MuJoCo does not compile the file, or if a number of the
            compiled model is not valid; None otherwise. A copy of ``spec`` may compile although the
            file does not, because ``MjSpec.copy()`` drops elements that refer to missing elements.
        as_it_is: Message and location of MuJoCo's error about a flat mesh that the reader turned
            into a shell; None without such a mesh.
        unknown: {kind of a joint parameter, such as ``effort``: joints with an unknown value}. Set
            if the MJCF was converted from a format in which a missing parameter is unknown, and not
            zero.
        stands_for: Word that messages use for the original file of a converted robot; "" for an
            MJCF.
        gains: {joint: (stiffness, damping) of the servo} (N m/rad, N m s/rad; N/m, N s/m), from the
            original file of a converted robot. None for an MJCF, and for a format without servos.
        of_urdf: Whether the MJCF was converted from a URDF, which does not specify ground and
            contacts.
        deferred_visuals: Function that converts the visual meshes of a URDF later. It puts the
            meshes into a spec in place, and returns notes on meshes that were removed. Until then,
            ``spec`` and ``model`` contain small tetrahedra instead of the meshes. None if no mesh
            is deferred.
    """

    path: Path
    spec: mujoco.MjSpec = field(repr=False)
    files: tuple[Path, ...] = ()
    notes: tuple[Diagnostic, ...] = ()
    refusal: tuple[Diagnostic, Place] | None = None
    as_it_is: tuple[Diagnostic, Place] | None = None
    unknown: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    _model: mujoco.MjModel | None = field(default=None, repr=False)
    _index: Mapping[tuple[str, str], XmlNode] = field(default_factory=dict, repr=False)
    _roots: tuple[XmlNode, ...] = field(default=(), repr=False)
    of_urdf: bool = False
    stands_for: str = ""
    gains: Mapping[str, tuple[float, float]] | None = None
    deferred_visuals: Callable[[mujoco.MjSpec], list[Diagnostic]] | None = None

    def place(self, kind: str, name: str, child: str | None = None) -> Place:
        """Return the location (file and line) of an element of this MJCF, by tag and name.

        The line is missing if no such element is found. Elements of attached models are not found.

        Args:
            kind: Tag: ``"body"``, ``"joint"``, ``"geom"`` ..., or section: ``"actuator"``,
                ``"sensor"``, ``"equality"``, ``"tendon"``, ``"contact"``, ``"deformable"``.
            name: Name of the element, or a substitute of `index_of`.
            child: Path below the element (``"inertial"``); the innermost existing element counts.
        """
        node = self._index.get((kind, name))
        return (
            Place(self.path) if node is None else innermost_element(node, child, _find_child).place
        )

    def find_attribute(self, kind: str, name: str, attributes: Collection[str]) -> Place | None:
        """Return the location of an attribute: in the element, or in a default class.

        Args:
            kind: Tag of the element, such as ``joint``, or section, such as ``actuator``.
            name: Name of the element.
            attributes: Attributes, of which one is sufficient.

        Returns:
            The location; None if it is not found.
        """
        node = self._index.get((kind, name))
        if node is None or not self._roots:
            return None
        setting_node = find_stating_element(self._roots[0], node, attributes)
        return None if setting_node is None else setting_node.place

    def place_of_nth_geom(
        self, body: str, number: int, count: int, attributes: Collection[str] = ()
    ) -> Place:
        """Return the location of a geom without a name, by its number in a body.

        Args:
            body: Name of the body; ``"world"`` for the worldbody.
            number: Number of the geom among the geoms of the body in the compiled model, from 0.
            count: Number of geoms of the body in the compiled model.
            attributes: If given, the result is the location at which one of these attributes is
                set, in the geom or in a default class.

        Returns:
            The location. If no attribute is set, the location of the geom. If the elements of the
            file cannot be assigned to the geoms of the model, the result is the location of the
            body (of the file, for the world). An example is an attached model that adds geoms to
            the body.
        """
        nodes = self._list_geom_nodes(body)
        if len(nodes) != count:
            return self.place("body", body)
        node = nodes[number]
        setting_node = (
            find_stating_element(self._roots[0], node, attributes) if attributes else None
        )
        return (setting_node or node).place

    def _list_geom_nodes(self, body: str) -> list[XmlNode]:
        """Return the elements of a body's geoms, in the order of the compiled model.

        Geoms in frames and replicates are included. Geoms with missing meshes, and geoms that
        MuJoCo discards (``discardvisual``), are omitted. Empty if the spec has other geoms.
        """
        if not self._roots:
            return []
        is_world = body == self.spec.worldbody.name
        tops = [top for top in self._roots[0].children if top.tag == "worldbody"]
        node = self._index.get(("body", body))
        parents = tops if is_world else [] if node is None else [node]
        meshes = {mesh.name for mesh in self.spec.meshes}
        nodes = [
            geom
            for parent in parents
            for geom in _expand_geoms(parent)
            if (mesh := self._find_mesh(geom)) is None or mesh in meshes
        ]
        spec_body = self.spec.worldbody if is_world else self.spec.body(body)
        geoms = [] if spec_body is None else list(spec_body.geoms)
        if len(geoms) != len(nodes):
            return []
        discards = bool(self.spec.compiler.discardvisual)
        return [
            node
            for node, geom in zip(nodes, geoms, strict=True)
            if not discards or geom.contype or geom.conaffinity
        ]

    def _find_mesh(self, geom: XmlNode) -> str | None:
        """Return the name of a geom's mesh, from the geom or a default class; None without mesh."""
        node = find_stating_element(self._roots[0], geom, ("mesh",))
        return None if node is None else node.attributes["mesh"]

    @property
    def attaches_models(self) -> bool:
        """Whether models of other files are attached, whose elements have lines in these files."""
        return len(self._roots) > 1

    @property
    def missing_collision_meshes(self) -> tuple[str, ...]:
        """Names of missing mesh files of geoms that can collide, except geoms of the world body."""
        return self._list_missing_values("touching")

    @property
    def missing_files(self) -> tuple[str, ...]:
        """Names of the missing mesh files, and of the first missing file of each texture."""
        return self._list_missing_values("files")

    @property
    def bodies_with_missing_meshes(self) -> tuple[str, ...]:
        """Names of the bodies from which geoms were removed, because mesh files are missing."""
        return self._list_missing_values("bodies")

    def _list_missing_values(self, key: str) -> tuple[str, ...]:
        """Return names from notes about missing files: ``files``, ``touching`` or ``bodies``."""
        values = [note.values.get(key) for note in self.notes if note.code == "files-missing"]
        names = (str(name) for value in values if isinstance(value, tuple) for name in value)
        return tuple(dict.fromkeys(names))

    def elements(self, tag: str) -> Iterator[tuple[Mapping[str, str], Place]]:
        """Yield the attributes, as in the file, and the location of each element with a tag."""
        for root in self._roots:
            for node in walk_elements(root):
                if node.tag == tag:
                    yield node.attributes, node.place

    def place_by_number(self, section: str, number: int) -> Place:
        """Return the location of an element without a name, by its number in a section of the file.

        Args:
            section: ``"actuator"``, ``"equality"`` or ``"tendon"``.
            number: Number in the section, from 0.

        Returns:
            The location. The line is missing if it is unknown, for example if attached models or
            replicates add elements.
        """
        if len(self._roots) != 1 or any(True for _ in self.elements("replicate")):
            return Place(self.path)
        tops = (node for node in self._roots[0].children if node.tag == section)
        places = [node.place for top in tops for node in top.children]
        return places[number] if number < len(places) else Place(self.path)

    @property
    def model(self) -> mujoco.MjModel:
        """Compiled model of the file, without elements whose mesh or texture files are missing.

        The model is shared and must not be modified; copying takes time if meshes are large.

        Raises:
            ModelError: If MuJoCo does not compile the file, or a number of the model is not valid.
        """
        self.check_compiled()
        assert self._model is not None
        return self._model

    def check_compiled(self) -> None:
        """Check that MuJoCo compiles this file, and that the numbers of the model are valid.

        Raises:
            ModelError: If a check fails.
        """
        if self.refusal is not None:
            problem, place = self.refusal
            raise make_file_error(place, problem)


def read_mjcf(path: str | Path) -> MjcfFile:
    """Read an MJCF with all included files, and compile the MJCF.

    Raises:
        ConfigurationError: If ``path`` is no path.
        ModelError: If the file cannot be loaded, or MuJoCo does not compile it. The message is a
            single line with location and reason.
        OutputError: If this run of the command line also writes this file, or for example a mesh.
    """
    check_type("mjcf", path, str | Path)
    path = Path(path)
    _, root = parse_xml(path)
    file = mjcf_from(path, root)
    _ = file.model  # raises a ModelError if the model is not valid
    return file


def mjcf_of_text(path: Path, text: str, assets: Mapping[str, bytes]) -> MjcfFile:
    """Compile an MJCF text that was generated in memory, and return the `MjcfFile`.

    Args:
        path: Source file, for error messages and locations.
        text: XML. Paths are absolute, or names of ``assets``.
        assets: {name: content} of the files.

    Raises:
        ModelError: If MuJoCo rejects the text (the message is MuJoCo's), or a number of the
            compiled model is not valid.
    """
    try:
        with silence_mujoco():
            spec, compiled_spec = (
                mujoco.MjSpec.from_string(text, assets=dict(assets)) for _ in range(2)
            )
    except _MUJOCO_ERRORS as error:
        message = one_line(error)
        raise make_file_error(Place(path), diagnose("mjcf-not-valid", message=message)) from error
    return MjcfFile(path, spec, _model=compile_spec(compiled_spec, path))


_MUJOCO_ERRORS: Final = (ValueError, RuntimeError, TypeError, OSError, MemoryError)
"""Exceptions of MuJoCo's parser and compiler for invalid models."""


def mjcf_from(path: Path, root: etree._Element) -> MjcfFile:
    """Compile an MJCF from its parsed root element, and return the `MjcfFile`.

    If MuJoCo does not compile the file, ``refusal`` of the result contains the error.

    Raises:
        ModelError: For example if an include or an attribute is not valid, or a mass depends on a
            missing mesh.
        OutputError: If this run of the command line also writes an included or attached file, a
            mesh or a texture.
    """
    if root.tag != "mujoco":
        is_urdf, is_include = root.tag == "robot", root.tag == "mujocoinclude"
        tag = str(root.tag)
        raise make_element_error(
            path, root, diagnose("no-mjcf", tag=tag, urdf=is_urdf, part=is_include)
        )
    tree = IncludeTree(path, root)
    index = index_of(tree.root)
    return _compile_file(tree, index, lambda: _parse_spec(tree, index))


def mjcf_of_spec(path: Path, spec: mujoco.MjSpec, notes: tuple[Diagnostic, ...] = ()) -> MjcfFile:
    """Compile a copy of a spec in memory, with its assets, and return the `MjcfFile`.

    Elements have no line numbers. Attributes are read from the XML that MuJoCo writes.

    Args:
        path: Name of the spec in messages, in the folder of its meshes.
        spec: Spec.
        notes: Diagnostics to keep in the file.

    Raises:
        ModelError: For example if MuJoCo cannot write the spec, or a mass depends on a missing
            mesh.
        OutputError: If this run of the command line also writes a mesh or a texture.
    """
    try:
        with silence_mujoco():
            text = to_xml(spec)
    except (*_MUJOCO_ERRORS, mujoco.FatalError) as error:
        problem = diagnose("mjcf-not-valid", message=one_line(error))
        raise make_file_error(Place(path), problem) from error
    root = parse_text(text)
    forget_lines(root)
    tree = IncludeTree(path, root)
    index = index_of(tree.root)

    def copy_spec() -> tuple[mujoco.MjSpec, list[Diagnostic]]:
        """Return a copy of the spec without elements whose files are missing, and the notes."""
        copy = spec.copy()
        _disable_unset_ranges(copy, index)
        return copy, [*notes, *leave_out_missing(copy, tree, index)]

    return _compile_file(tree, index, copy_spec)


def _disable_unset_ranges(spec: mujoco.MjSpec, index: Mapping[tuple[str, str], XmlNode]) -> None:
    """Disable, in place, the unset force and control ranges that MuJoCo writes as "0 0".

    In a spec, a range with two zero ends and the flag "auto" is unset. In a file, "0 0" means a
    motor without torque.
    """

    def is_unset(tag: str, name: str, attribute: str, ends: ArrayLike, switch: int) -> bool:
        """Return True if the spec does not set a range that MuJoCo has written to the XML.

        ``ends`` is the range, ``switch`` its flag (mjtLimited).
        """
        node = index.get((tag, name))
        return (
            node is not None
            and attribute in node.attributes
            and switch == mujoco.mjtLimited.mjLIMITED_AUTO
            and not np.any(ends)
        )

    off = mujoco.mjtLimited.mjLIMITED_FALSE
    for motor in spec.actuators:
        name, commands = motor.name or motor.target, np.ravel(motor.ctrlrange)[:2]
        if is_unset("actuator", name, "forcerange", motor.forcerange, motor.forcelimited):
            motor.forcelimited = off
        if is_unset("actuator", name, "ctrlrange", commands, motor.ctrllimited):
            motor.ctrllimited = off
    for joint in spec.joints:
        ends = joint.actfrcrange
        if is_unset("joint", joint.name, "actuatorfrcrange", ends, joint.actfrclimited):
            joint.actfrclimited = off


def _compile_file(
    tree: IncludeTree,
    index: Mapping[tuple[str, str], XmlNode],
    make_spec: Callable[[], tuple[mujoco.MjSpec, list[Diagnostic]]],
) -> MjcfFile:
    """Compile a new spec of an MJCF, and return the `MjcfFile` with the model or the error.

    ``make_spec`` creates the spec and its diagnostics; it is called several times.
    """
    path = tree.path
    spec, notes = make_spec()
    model, refusal, as_it_is = None, _find_nan(tree), None
    try:
        # A new spec, because compiling modifies a spec, and a copy would lack dangling elements.
        if refusal is None:
            model, shells, first_message = compile_with_shells(lambda: make_spec()[0])
            if shells:
                put_shells(spec, shells)
                notes.append(report_shells(shells))
                as_it_is = _make_refusal(tree, index, ValueError(first_message))
    except _MUJOCO_ERRORS as error:
        refusal = _make_refusal(tree, index, error)
    problem = None if model is None else find_invalid_number(model)
    if problem is not None:
        model, refusal = None, (problem, Place(path))
    return MjcfFile(
        path,
        spec,
        tuple(tree.files),
        tuple(notes),
        refusal,
        as_it_is,
        {},
        model,
        index,
        (tree.root, *tree.attached),
    )


_NAN_PATTERN: Final = re.compile(r"[+-]?nan(\(\w*\))?", re.IGNORECASE)
"""Pattern of a NaN in an MJCF."""

_NON_NUMERIC_ATTRIBUTES: Final = ("name", "model", "file")
"""Attributes in which `_find_nan` ignores the word "nan", since their values are texts."""


def _find_nan(tree: IncludeTree) -> tuple[Diagnostic, Place] | None:
    """Return the message on the first attribute that contains NaN, and its place.

    MuJoCo accepts NaN in most attributes. In the position of an ``<inertial>``, for example, NaN
    means unspecified to MuJoCo.

    Returns:
        Message and place; None without NaN. Also None if an element has the name "nan", since
        attributes may contain this name. Elements ``<text>`` are ignored.
    """
    roots = reversed((tree.root, *tree.attached))
    pending: list[tuple[XmlNode, tuple[str, str] | None]] = [(root, None) for root in roots]
    found: tuple[Diagnostic, Place] | None = None
    names: set[str] = set()
    while pending:
        node, subject = pending.pop()
        name = node.attributes.get("class" if node.tag == "default" else "name")
        if name:
            names.add(name)
            subject = node.tag, name
        for attribute, value in node.attributes.items():
            if found is not None or attribute in _NON_NUMERIC_ATTRIBUTES or node.tag == "text":
                continue
            words = value.split() if "nan" in value.lower() else []  # vertices may be many
            if any(map(_NAN_PATTERN.fullmatch, words)):
                problem = diagnose(
                    "number-not-finite",
                    subject=subject,
                    tag=node.tag,
                    attribute=attribute,
                    value=quote_short(value),
                    number=quote_short(next(filter(_NAN_PATTERN.fullmatch, words))),
                )
                found = problem, node.place
        pending.extend((child, subject) for child in reversed(node.children))
    # An element may have the name "nan".
    return None if any(map(_NAN_PATTERN.fullmatch, names)) else found


def _parse_spec(
    tree: IncludeTree, index: Mapping[tuple[str, str], XmlNode]
) -> tuple[mujoco.MjSpec, list[Diagnostic]]:
    """Return the spec of an MJCF without elements with missing files, and notes on the files."""
    try:
        with silence_mujoco():
            spec = parse_spec(tree.path)
    except _MUJOCO_ERRORS as error:
        message, place = _locate_message(tree, index, error)
        raise make_file_error(place, diagnose("mjcf-not-valid", message=message)) from error
    return spec, leave_out_missing(spec, tree, index)


def _make_refusal(
    tree: IncludeTree, index: Mapping[tuple[str, str], XmlNode], error: BaseException
) -> tuple[Diagnostic, Place]:
    """Convert an error of MuJoCo's compiler to a diagnostic, and locate the element at fault."""
    message, place = _locate_message(tree, index, error)
    return diagnose("mjcf-not-compiled", message=message, cause=shorten_message(message)), place


def _locate_message(
    tree: IncludeTree, index: Mapping[tuple[str, str], XmlNode], error: BaseException
) -> tuple[str, Place]:
    """Return MuJoCo's error message, and the probable location of the element at fault.

    MuJoCo's line number alone is not sufficient: it may belong to an unspecified file, and is 0 for
    included elements.
    """
    message = one_line(error)
    line_match = re.search(r"(?:, line |Line number=)([1-9][0-9]*)", message)
    if line_match and len(tree.files) == 1:
        return message, Place(tree.path, int(line_match[1]))
    quoted_words = set(re.findall(r"'([^']+)'", message))
    name_match = re.search(r"Element name '([^']+)'", message)
    named_places = [
        node.place
        for (_, element_name), node in index.items()
        if name_match and element_name == name_match[1]
    ]
    nodes = [node for root in (tree.root, *tree.attached) for node in walk_elements(root)]
    places_with_words = [
        node.place
        for node in nodes
        if quoted_words & {v for k, v in node.attributes.items() if k != "name" or line_match}
        and (not line_match or node.place.line == int(line_match[1]))
    ]
    return message, (*named_places, *places_with_words, Place(tree.path))[0]


def _expand_geoms(parent: XmlNode) -> Iterator[XmlNode]:
    """Yield the geoms of a body in MuJoCo's order, with frames and the copies of replicates."""
    for child in parent.children:
        if child.tag == "geom":
            yield child
        elif child.tag == "frame":
            yield from _expand_geoms(child)
        elif child.tag == "replicate":
            copies = _multiply_numbers(child.attributes.get("count", "1"))
            yield from list(_expand_geoms(child)) * copies


def _find_child(node: XmlNode, tag: str) -> XmlNode | None:
    """Return the first child with a tag; None without. A ``freejoint`` counts as ``joint``."""
    tags = ("joint", "freejoint") if tag == "joint" else (tag,)
    return next((child for child in node.children if child.tag in tags), None)
