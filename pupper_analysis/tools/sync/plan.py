"""Plan of a sync: changes of both files, reasons for differences that remain, layout of copies.

Input is, for each selected difference, the file whose value is taken. `make_plan` changes both
documents in memory. If the value of a difference cannot be written, the reason is recorded.
`FileLayout` determines the paths of copies of the model's files. The copies are verified before the
files are written.
"""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property
from pathlib import Path

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import OutputError
from pupper_analysis.base.files import describe_os_error
from pupper_analysis.base.results import Result
from pupper_analysis.models.attributes import BY_KIND, JOINT_ATTRIBUTES
from pupper_analysis.models.mjcf_file import MjcfFile, read_mjcf
from pupper_analysis.models.published import existing_file
from pupper_analysis.models.urdf_file import UrdfFile, read_urdf
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml_bytes import XmlDocument, XmlElement, read_xml_bytes
from pupper_analysis.robot.build import find_placeholder_efforts
from pupper_analysis.robot.compare.attribution import align_robot
from pupper_analysis.robot.compare.differences import INERTIAL_KINDS, LIMIT_KINDS, PropertyKey
from pupper_analysis.robot.matching.match import match_models
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.tools.sync.frames import MatchedRobots, pair_robots
from pupper_analysis.tools.sync.mjcf_in_place import EditableMjcf
from pupper_analysis.tools.sync.mjcf_side import MjcfSide
from pupper_analysis.tools.sync.urdf_side import UrdfSide

_SHARED_JOINT_KINDS = tuple(
    attribute.kind for attribute in JOINT_ATTRIBUTES if attribute.is_in_both_formats
)
"""Kinds of joint numbers that both formats contain, so that `sync` can write the numbers."""

_WRITTEN_KINDS = (*INERTIAL_KINDS, "position", *_SHARED_JOINT_KINDS)
"""Kinds of differences that `sync` writes to the other file: numbers that both formats contain."""

_UNWRITTEN_REASONS = {
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
"""{kind of difference: reason why `sync` never writes a difference of this kind}."""


class UnwrittenCause(StrEnum):
    """Kind of reason why a difference between a URDF and an MJCF remains."""

    NOT_CHOSEN = "not chosen"
    NOT_STATED = "not stated"
    """The chosen file states no value."""
    NO_WORDS = "no words"
    """The difference is not a number that both formats state alike, such as structure, a
    convention, or a number of a single format.
    """
    NOT_MENDED = "not mended"
    """The number cannot be written, or the change does not remove the difference."""
    NEW = "new"
    """The difference appeared when other differences were removed."""


@dataclass(frozen=True)
class Edit(Result):
    """Change of an attribute of an XML element, written or planned.

    Attributes:
        file: File.
        line: Line of the element, or of the parent for a new element.
        element: Path: ``link base > inertial > mass``.
        attribute: Name of the attribute; ``old -> new`` for a renamed attribute.
        old: Old text; None for a new attribute.
        new: New text.
    """

    file: str
    line: int
    element: str
    attribute: str
    old: str | None
    new: str


@dataclass(frozen=True, eq=False)
class Files:
    """Paths of a URDF and an MJCF, with options for the matching of links and joints.

    Attributes:
        urdf: Path of the URDF.
        mjcf: Path of the MJCF.
        names: {name in the URDF: name in the MJCF}, for names that differ.
        packages: {package of ``package://``: folder}.
    """

    urdf: Path
    mjcf: Path
    names: Mapping[str, str]
    packages: Mapping[str, Path]


@dataclass(eq=False)
class Plan:
    """Planned changes of a URDF and an MJCF in memory, and differences that remain.

    Attributes:
        files: Files and options.
        urdf: {file: document} of the URDF.
        mjcf: {file: document} of the MJCF and the included files, the main file first.
        copies: Layouts of both models, for verification.
        left: {difference: reason why no value is written}.
        causes: {difference that is not written: kind of reason}; by default ``NOT_MENDED``.
        notes: {difference: note}.
    """

    files: Files
    urdf: dict[Path, XmlDocument]
    mjcf: dict[Path, XmlDocument]
    copies: tuple[FileLayout, FileLayout]
    left: dict[PropertyKey, Diagnostic] = field(default_factory=dict)
    causes: dict[PropertyKey, UnwrittenCause] = field(default_factory=dict)
    notes: dict[PropertyKey, Diagnostic] = field(default_factory=dict)

    def find_cause(self, key: PropertyKey) -> UnwrittenCause:
        """Return the kind of reason why the plan leaves a difference (kind, element) unchanged."""
        return self.causes.get(key, UnwrittenCause.NOT_MENDED)

    def documents(self) -> Iterator[XmlDocument]:
        """Yield the XML documents of both models, the documents of the URDF first."""
        yield from self.urdf.values()
        yield from self.mjcf.values()

    def edits(self) -> tuple[Edit, ...]:
        """Return the planned changes of attributes in both models, file by file."""
        return list_edits(self.documents())


def list_edits(documents: Iterable[XmlDocument]) -> tuple[Edit, ...]:
    """List the planned changes of attributes in XML documents, in the order of the documents."""
    return tuple(
        edit
        for document in documents
        for element in document.elements
        for edit in _iterate_edits(element)
    )


def make_plan(files: Files, tolerances: Tolerances, taken: Mapping[PropertyKey, str]) -> Plan:
    """Plan the changes of a URDF and an MJCF that take selected values from the other file.

    Args:
        files: Files and options.
        tolerances: Tolerances with which the differences were found.
        taken: {kind and element of a difference: ``"urdf"`` or ``"mjcf"``}: file whose value is
            taken.

    Raises:
        ModelError: If a file cannot be read, or the files cannot be matched, for example.
    """
    urdf, mjcf = read_urdf(files.urdf, files.packages), read_mjcf(files.mjcf)
    matched = match_models(urdf, mjcf, names=files.names, tolerances=tolerances)
    robots = pair_robots(matched, align_robot(matched.robot, tolerances))
    elements = EditableMjcf(mjcf)
    document = read_xml_bytes(urdf.path)
    copies = combine_layouts(list_urdf_files(urdf), list_mjcf_files(mjcf))
    plan = Plan(files, {files.urdf: document}, elements.documents, copies)
    into_urdf = UrdfSide(
        tree=UrdfTree(document.root),
        sides=robots,
        target=robots.urdf,
    )
    into_mjcf = MjcfSide(
        file=mjcf,
        elements=elements,
        sides=robots,
        target=robots.mjcf,
    )
    for side, source in ((into_urdf, "mjcf"), (into_mjcf, "urdf")):
        keys = [key for key, side_taken in taken.items() if side_taken == source]
        for key in keys:
            if reason := _find_unwritten_reason(key, source, robots):
                plan.left[key], plan.causes[key] = reason, UnwrittenCause.NO_WORDS
            elif is_absent(key, source, robots, urdf, mjcf):
                plan.left[key], plan.causes[key] = (
                    _make_unstated_reason(source),
                    UnwrittenCause.NOT_STATED,
                )
        keys = [key for key in keys if key not in plan.left]
        receiver = "urdf" if source == "mjcf" else "mjcf"
        side.target = robots.merge_values(receiver, keys)
        side.same_bodies = robots.merge_values(
            receiver, [*keys, *robots.list_equal_inertias(keys, tolerances)]
        )
        side.plan(keys)
        plan.left |= side.unwritten
        plan.notes |= side.notes
        joints = (robots.urdf if source == "urdf" else robots.mjcf).joints
        efforts = {name: joints[name].effort for name in matched.robot.joint_names}
        warnings = dict[PropertyKey, Diagnostic]()
        for name, reason in find_placeholder_efforts(matched.robot, efforts).items():
            note = diagnose("effort-taken-is-placeholder", why=reason)
            if (
                ("effort", name) in keys and note not in warnings.values()
            ):  # one note for all joints with the same reason
                warnings["effort", name] = note
        plan.notes = warnings | plan.notes | warnings  # before notes on how the value is written
    return plan


def _find_unwritten_reason(key: PropertyKey, whose: str, both: MatchedRobots) -> Diagnostic | None:
    """Return the reason why a file cannot state the new value of a difference, if any.

    ``key`` is (kind, element); ``whose`` is the file whose value is taken, ``"urdf"`` or
    ``"mjcf"``.
    """
    kind, name = key
    if kind not in _WRITTEN_KINDS:
        if kind in _UNWRITTEN_REASONS:
            return _UNWRITTEN_REASONS[kind]
        if whose == "mjcf":
            return diagnose("urdf-without-words")
        return diagnose("mjcf-alone-states-it")
    if kind == "position":
        urdf_joint, mjcf_joint = both.urdf.joints[name], both.mjcf.joints[name]
        if urdf_joint.parent != mjcf_joint.parent:
            return diagnose("parent-is-another")
    return None


def _make_unstated_reason(whose: str) -> Diagnostic:
    """Create the message why a difference remains: the file to copy from states no value.

    ``whose`` is this file, ``"urdf"`` or ``"mjcf"``.
    """
    lacking, stating = ("URDF", "MJCF") if whose == "urdf" else ("MJCF", "URDF")
    return diagnose("stated-in-one-file", lacking=lacking, stating=stating)


def _iterate_edits(element: XmlElement) -> Iterator[Edit]:
    """Yield the changes of the attributes of an element, then of new child elements."""
    old_name = {new: old for old, new in element.renamed.items()}
    for attribute, text in element.changes.items():
        old = element.attributes.get(old_name.get(attribute, attribute))
        name = attribute if attribute not in old_name else f"{old_name[attribute]} -> {attribute}"
        yield Edit(str(element.file), element.line, _describe_element(element), name, old, text)
    for child in element.children:
        if child.start < 0:
            yield from _iterate_edits(child)


def _describe_element(element: XmlElement) -> str:
    """Return the path of an element from the nearest named element, as ``link leg > mass``."""
    parts = []
    current: XmlElement | None = element
    while current is not None:
        name = current.attributes.get("name") or current.attributes.get("joint")
        parts.append(f"{current.tag} {name}" if name else current.tag)
        current = None if name else current.parent
    return " > ".join(reversed(parts))


def is_absent(
    key: PropertyKey, whose: str, both: MatchedRobots, urdf: UrdfFile, mjcf: MjcfFile
) -> bool:
    """Return True if a file states no value for a number in which URDF and MJCF differ.

    Placeholders count as no value: a mass of 0 or below, and in a URDF an effort that is 0,
    negative or infinite, since exporters write 0 for an unknown effort.

    Args:
        key: Kind and element of the differing number.
        whose: File that is examined: ``"urdf"`` or ``"mjcf"``.
        both: Matched robots of both files.
        urdf: URDF.
        mjcf: MJCF.
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
        return mjcf.find_attribute("joint", name, attribute.mjcf) is None
    return urdf.tree.joints[both.matched.urdf_joint[name]].parameter_text(attribute) is None


# Layout of a model's files in another folder.


_MJCF_FOLDER = "mjcf"
"""Subfolder of the output folder for the MJCF and the files that the MJCF needs, if the relative
positions of both models cannot be kept.
"""


@dataclass(frozen=True)
class FileLayout:
    """Files of a model, with the paths of a copy of each file in an output folder.

    No path in the files is changed. Therefore the output folder contains the same subfolders as the
    original folder, as far as relative paths require.

    Attributes:
        main: Main file of the model.
        top: Common folder of all files, which the output folder replaces.
        files: All files, the main file first.
        aside: Subfolder of the output folder that contains the copies; by default none.
    """

    main: Path
    top: Path
    files: tuple[Path, ...]
    aside: Path = Path()

    @staticmethod
    def arrange(main: Path, needed: Iterable[Path], within: Iterable[Path] = ()) -> FileLayout:
        """Create the layout of a copy of a model, from the main file and the files that it needs.

        Args:
            main: Main file of the model.
            needed: Other files that a copy needs (`list_urdf_files`, `list_mjcf_files`).
            within: ROS package folders, whose names the copy must keep.
        """
        files = tuple(dict.fromkeys((main, *needed)))
        folders = {_normalise_path(path).parent for path in (*files, *within)}
        return FileLayout(main, Path(os.path.commonpath(folders)), files)

    @cached_property
    def copy_paths(self) -> Mapping[Path, Path]:
        """``{file of the model: path of its copy in the output folder}``, also of the main file."""
        return {
            file: self.aside / _normalise_path(file).relative_to(self.top) for file in self.files
        }

    def get_main_copy_path(self) -> Path:
        """Return the path of the model's main file in the output folder."""
        return self.copy_paths[self.main]


def combine_layouts(urdf: FileLayout, mjcf: FileLayout) -> tuple[FileLayout, FileLayout]:
    """Return the layouts of a URDF's and an MJCF's files for a common output folder.

    If no model's folder contains the other model, the files of the MJCF get a separate folder.

    Returns:
        Layout of the URDF's files; layout of the MJCF's files.
    """
    for top in (urdf.top, mjcf.top):
        if all(layout.top.is_relative_to(top) for layout in (urdf, mjcf)):
            return replace(urdf, top=top), replace(mjcf, top=top)
    return urdf, replace(mjcf, aside=Path(_MJCF_FOLDER))


def _normalise_path(path: Path) -> Path:
    """Return an absolute path without ``..``; symbolic links are not resolved."""
    return Path(os.path.normpath(path.absolute()))


def list_urdf_files(urdf: UrdfFile) -> FileLayout:
    """Return the layout of the files of a URDF that a copy needs, with meshes and textures.

    Files at absolute paths and in other packages are left out, since such paths do not depend on
    the location of the URDF.
    """
    files: list[Path] = []
    packages: list[Path] = []
    parent_folders = urdf.path.absolute().parents
    for element in urdf.root.iter("mesh", "texture"):
        name = element.get("filename") or ""
        scheme, separator, rest = name.partition("://")
        file = urdf.resolve_mesh(name) if name else None
        if file is None:
            continue
        if not separator or scheme == "file":
            if not Path(rest if separator else name).is_absolute():
                files.append(file)
            continue
        relative_path = rest.lstrip("/").partition("/")[2]
        package = (
            Path(str(_normalise_path(file)).removesuffix(relative_path)) if relative_path else file
        )
        if package in parent_folders:
            manifest = existing_file(package / "package.xml")
            files += [file] if manifest is None else [file, manifest]
            packages.append(package)
    return FileLayout.arrange(urdf.path, files, packages)


def list_mjcf_files(mjcf: MjcfFile) -> FileLayout:
    """Return the layout of the files of an MJCF that a copy needs: main, included, assets."""
    return FileLayout.arrange(mjcf.path, [*mjcf.files, *_iterate_assets(mjcf)])


def _iterate_assets(mjcf: MjcfFile) -> Iterator[Path]:
    """Yield the existing mesh, height field, skin and texture files to which an MJCF refers.

    References with an absolute path are left out.
    """
    spec = mjcf.spec
    folders = tuple(dict.fromkeys(file.parent for file in (mjcf.path, *mjcf.files)))
    references = [
        (element.file, element.compiler.meshdir)
        for element in (*spec.meshes, *spec.hfields, *spec.skins)
    ]
    for texture in spec.textures:
        references += [(f, texture.compiler.texturedir) for f in (texture.file, *texture.cubefiles)]
    for file, folder in dict.fromkeys(references):
        name = Path(file).name if spec.strippath else file
        if not file or Path(name).is_absolute() or Path(folder).is_absolute():
            continue
        paths = (existing_file(top / folder / name) for top in folders)
        yield from (path for path in paths if path is not None)


@contextmanager
def write_temporary_files(contents: Mapping[Path, bytes]) -> Iterator[Path]:
    """Write {path: content} to a temporary folder, and yield the folder.

    Raises:
        OutputError: If the folder or a file cannot be written, for example on a full disk.
    """
    with ExitStack() as stack:
        place = "temporary folder"  # until its name is known
        try:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            for name, content in contents.items():
                place = str(folder / name)
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                (folder / name).write_bytes(content)
        except OSError as error:
            raise OutputError(place, describe_os_error(error)) from error
        yield folder
