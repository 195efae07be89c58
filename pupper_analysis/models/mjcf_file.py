"""Reads an MJCF: what MuJoCo makes of it, and where its elements stand."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import mujoco
from lxml import etree

from pupper_analysis.base.arguments import check_type
from pupper_analysis.base.arrays import plain_state
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.models.lenient import put_ground
from pupper_analysis.models.missing import (
    compile_with_shells,
    leave_out_missing,
    put_shells,
    taken_as_shells,
)
from pupper_analysis.models.mjcf import (
    compile_spec,
    no_number,
    silence_mujoco,
    spec_of,
)
from pupper_analysis.models.mjcf_tree import (
    Node,
    Tree,
    index_of,
    stating_element,
    walk_elements,
)
from pupper_analysis.models.places import (
    Place,
    innermost_element,
    one_line,
    refusal_at,
    refuse_file,
)
from pupper_analysis.models.spec_state import spec_from, state_of
from pupper_analysis.models.xml import parse_xml


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

    def __getstate__(self) -> dict[str, Any]:
        return {**plain_state(self), "spec": state_of(self.spec)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update({**state, "spec": spec_from(state["spec"])})

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

    def weighing(self, body: str) -> Place:
        """Finds where a body's mass is stated: its <inertial>, or the first geom that has one."""
        node = self._index.get(("body", body))
        if node is None:
            return Place(self.path)
        inertial = [child for child in node.children if child.tag == "inertial"]
        geoms = [child for child in node.children if child.tag == "geom"]
        stated = [geom for geom in geoms if {"mass", "density"} & set(geom.attributes)]
        return (*inertial, *stated, *geoms, node)[0].place

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
            spec, passed_over = spec_of(tree.path, lenient=True)
    except _MUJOCO_ERRORS as error:
        message, place = _mujoco_message(tree, index, error)
        raise refuse_file(place, diagnose("mjcf-not-valid", message=message)) from error
    return spec, [*passed_over, *leave_out_missing(spec, tree, index), *put_ground(spec)]


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
    line = int(found[1]) if found else None
    said = set(re.findall(r"'([^']+)'", message))
    name = re.search(r"Element name '([^']+)'", message)
    named = [node.place for (_, known), node in index.items() if name and known == name[1]]
    nodes = [node for root in (tree.root, *tree.attached) for node in walk_elements(root)]
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
    return message, place


def _child(node: Node, tag: str) -> Node | None:
    """Returns a node's first child of a tag; a free joint is a joint."""
    tags = ("joint", "freejoint") if tag == "joint" else (tag,)
    return next((child for child in node.children if child.tag in tags), None)
