"""What is to be written where, for chosen differences."""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property
from pathlib import Path

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.results import Result
from pupper_analysis.models.attributes import BY_KIND, JOINT_ATTRIBUTES
from pupper_analysis.models.mjcf_file import MjcfFile, read_mjcf
from pupper_analysis.models.published import existing_file
from pupper_analysis.models.urdf_file import UrdfFile, read_urdf
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.robot.build import find_placeholder_efforts
from pupper_analysis.robot.compare.attribution import align_robot
from pupper_analysis.robot.compare.differences import INERTIAL_KINDS, LIMIT_KINDS
from pupper_analysis.robot.matching.match import match_models
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.tools.sync.frames import Key, MatchedRobots, pair_robots
from pupper_analysis.tools.sync.mjcf_in_place import EditableMjcf
from pupper_analysis.tools.sync.mjcf_side import MjcfSide
from pupper_analysis.tools.sync.urdf_side import UrdfSide
from pupper_analysis.tools.sync.xml_bytes import Element, XmlDocument, read_document

_OF_BOTH = tuple(one.kind for one in JOINT_ATTRIBUTES if one.in_both)

_WRITTEN = (*INERTIAL_KINDS, "position", *_OF_BOTH)
"""Kinds of differences that are numbers of both formats, and are written."""

_REASONS = {
    "type": diagnose("joint-type-unwritten"),
    "parent": diagnose("parent-unwritten"),
    "name": diagnose("name-unwritten"),
    "base frame": diagnose("base-frame-unwritten"),
    **dict.fromkeys(("rotation", "axis", "frame", "zero"), diagnose("direction-unwritten")),
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


@dataclass(eq=False)
class Plan:
    """What is to be written.

    Attributes:
        files: The files.
        urdf: {file: its document} of the URDF.
        mjcf: {file: its document} of the MJCF and what it includes, the main file first.
        copies: The files of both models, and where they are tried.
        left: {difference: why it is not written}.
        causes: {difference that is left: the kind of reason}; the others are not mended.
        notes: {difference: what is to be said}.
    """

    files: Files
    urdf: dict[Path, XmlDocument]
    mjcf: dict[Path, XmlDocument]
    copies: tuple[FileLayout, FileLayout]
    left: dict[Key, Diagnostic] = field(default_factory=dict)
    causes: dict[Key, UnwrittenCause] = field(default_factory=dict)
    notes: dict[Key, Diagnostic] = field(default_factory=dict)

    def find_cause(self, key: Key) -> UnwrittenCause:
        """Returns why a difference is not written."""
        return self.causes.get(key, UnwrittenCause.NOT_MENDED)

    def documents(self) -> Iterator[XmlDocument]:
        """Yields all documents."""
        yield from self.urdf.values()
        yield from self.mjcf.values()

    def edits(self) -> tuple[Edit, ...]:
        """Returns what is written, file by file."""
        return list_edits(self.documents())


def list_edits(documents: Iterable[XmlDocument]) -> tuple[Edit, ...]:
    """Returns what is written into documents, one by one."""
    return tuple(
        edit for document in documents for element in document.elements for edit in _edits(element)
    )


def make_plan(files: Files, tolerances: Tolerances, taken: Mapping[Key, str]) -> Plan:
    """Plans what is to be written.

    Args:
        files: The files.
        tolerances: With which their differences were found.
        taken: {kind and element of a difference: ``"urdf"`` or ``"mjcf"``, whose value is taken}.
    """
    urdf, mjcf = read_urdf(files.urdf, files.packages), read_mjcf(files.mjcf)
    matched = match_models(urdf, mjcf, names=files.names, tolerances=tolerances)
    both = pair_robots(matched, align_robot(matched.robot, tolerances))
    elements = EditableMjcf(mjcf)
    document = read_document(urdf.path)
    copies = combine_layouts(list_urdf_files(urdf), list_mjcf_files(mjcf))
    plan = Plan(files, {files.urdf: document}, elements.documents, copies)
    into_urdf = UrdfSide(
        tree=UrdfTree(document.root),
        sides=both,
        target=both.urdf,
    )
    into_mjcf = MjcfSide(
        file=mjcf,
        elements=elements,
        sides=both,
        target=both.mjcf,
    )
    for side, other in ((into_urdf, "mjcf"), (into_mjcf, "urdf")):
        keys = [key for key, whose in taken.items() if whose == other]
        for key in keys:
            if reason := _reason(key, other, both):
                plan.left[key], plan.causes[key] = reason, UnwrittenCause.NO_WORDS
            elif is_absent(key, other, both, urdf, mjcf):
                plan.left[key], plan.causes[key] = _unstated(other), UnwrittenCause.NOT_STATED
        keys = [key for key in keys if key not in plan.left]
        side.target = both.merge_values("urdf" if other == "mjcf" else "mjcf", keys)
        side.plan(keys)
        plan.left |= side.unwritten
        plan.notes |= side.notes
        stated = (both.urdf if other == "urdf" else both.mjcf).joints
        efforts = {name: stated[name].effort for name in matched.robot.joint_names}
        warned = dict[Key, Diagnostic]()
        for name, why in find_placeholder_efforts(matched.robot, efforts).items():
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
    if kind == "position":
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
    if kind in LIMIT_KINDS and attribute is not None:
        return name in side.joints and math.isinf(getattr(side.joints[name], attribute.field))
    if kind in INERTIAL_KINDS:
        return name in side.bodies and not side.bodies[name].mass > 0
    if attribute is None or attribute.urdf is None or name not in side.joints:
        return False
    if getattr(side.joints[name], attribute.field):
        return False
    if whose == "mjcf":
        return mjcf.stated("joint", name, attribute.mjcf) is None
    return urdf.tree.joints[both.matched.urdf_joint[name]].stated(attribute) is None


# Files of a model, and where copies of them are tried or written.


_ASIDE = "mjcf"
"""Folder of the MJCF and its files, where they stand apart from the URDF's."""


@dataclass(frozen=True)
class FileLayout:
    """The files of a model, and where each goes in a folder.

    No path in them is rewritten: the folder repeats as much of the folders around them as is
    needed for each relative path to lead where it did.

    Attributes:
        main: The model's file.
        top: The folder around all of them, which the new folder takes the place of.
        files: All of them, the main file first.
        aside: Into which part of the new folder they go.
    """

    main: Path
    top: Path
    files: tuple[Path, ...]
    aside: Path = Path()

    @staticmethod
    def arrange(main: Path, others: Iterable[Path], within: Iterable[Path] = ()) -> FileLayout:
        """Lays out a model's files.

        Args:
            main: The model's file.
            others: All that it needs, beside absolute paths.
            within: Folders whose names are needed, too: those of packages.
        """
        files = tuple(dict.fromkeys((main, *others)))
        folders = {_plain(path).parent for path in (*files, *within)}
        return FileLayout(main, Path(os.path.commonpath(folders)), files)

    @cached_property
    def places(self) -> Mapping[Path, Path]:
        """{file: where it goes, relative to the folder}; the main file is one of them."""
        return {file: self.aside / _plain(file).relative_to(self.top) for file in self.files}

    def place(self) -> Path:
        """Returns where the model's file goes."""
        return self.places[self.main]


def combine_layouts(urdf: FileLayout, mjcf: FileLayout) -> tuple[FileLayout, FileLayout]:
    """Returns the files of both models in one folder.

    Where those of one stand in the folders of the other's, they stay there; else the MJCF's go to a
    folder of their own.
    """
    for outer in (urdf.top, mjcf.top):
        if all(one.top.is_relative_to(outer) for one in (urdf, mjcf)):
            return replace(urdf, top=outer), replace(mjcf, top=outer)
    return urdf, replace(mjcf, aside=Path(_ASIDE))


def _plain(path: Path) -> Path:
    """Returns a path without ``..``, its links as they are: relative paths go by names."""
    return Path(os.path.normpath(path.absolute()))


def list_urdf_files(urdf: UrdfFile) -> FileLayout:
    """Lays out a URDF and the meshes and textures that are found from where it stands.

    A ``package://`` path that leads to a folder around the URDF does, too; one that is found by a
    package's given folder, or on ``ROS_PACKAGE_PATH``, is found from everywhere.
    """
    found: list[Path] = []
    packages: list[Path] = []
    around = urdf.path.absolute().parents
    for element in urdf.root.iter("mesh", "texture"):
        name = element.get("filename") or ""
        scheme, separator, rest = name.partition("://")
        file = urdf.resolve_mesh(name) if name else None
        if file is None or (not separator and Path(name).is_absolute()) or scheme == "file":
            continue
        if not separator:
            found.append(file)
            continue
        inside = rest.lstrip("/").partition("/")[2]
        package = Path(str(_plain(file)).removesuffix(inside)) if inside else file
        if package in around:
            manifest = existing_file(package / "package.xml")
            found += [file] if manifest is None else [file, manifest]
            packages.append(package)
    return FileLayout.arrange(urdf.path, found, packages)


def list_mjcf_files(mjcf: MjcfFile) -> FileLayout:
    """Lays out an MJCF, what it includes or attaches, and the files of its assets."""
    return FileLayout.arrange(mjcf.path, [*mjcf.files, *_assets(mjcf)])


def _assets(mjcf: MjcfFile) -> Iterator[Path]:
    spec = mjcf.spec
    folders = tuple(dict.fromkeys(file.parent for file in (mjcf.path, *mjcf.files)))
    named = [
        (element.file, element.compiler.meshdir)
        for element in (*spec.meshes, *spec.hfields, *spec.skins)
    ]
    for texture in spec.textures:
        named += [(f, texture.compiler.texturedir) for f in (texture.file, *texture.cubefiles)]
    for file, folder in dict.fromkeys(named):
        name = Path(file).name if spec.strippath else file
        if not file or Path(name).is_absolute() or Path(folder).is_absolute():
            continue
        found = (existing_file(top / folder / name) for top in folders)
        yield from (path for path in found if path is not None)


@contextmanager
def write_temporary_files(contents: Mapping[Path, bytes]) -> Iterator[Path]:
    """Writes files to a folder of their own, to be tried: {place there: content}; yields it."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for name, content in contents.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)
        yield folder
