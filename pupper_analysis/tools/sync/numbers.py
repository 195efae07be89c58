"""Writes given numbers into a robot's URDF and MJCF alike, each in its own frames and words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.files import Writing, write_together
from pupper_analysis.base.inputs import MOST_FILE, read_input
from pupper_analysis.base.kinds import hash_of, made_model
from pupper_analysis.base.runs import note_input, running
from pupper_analysis.models.mjcf import silence_mujoco, to_xml
from pupper_analysis.models.mjcf_file import MjcfFile, mjcf_of_text, read_mjcf
from pupper_analysis.models.mjcf_in_place import MjcfInPlace
from pupper_analysis.models.urdf_file import UrdfFile, read_urdf, urdf_from
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml import parse_text
from pupper_analysis.models.xml_bytes import XmlDocument, read_document
from pupper_analysis.models.xml_text import Digits
from pupper_analysis.robot.compare.attribution import align_robot
from pupper_analysis.robot.matching.match import match_models
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.sync.copies import (
    Copies,
    copies_of_mjcf,
    copies_of_urdf,
    laid_out,
)
from pupper_analysis.tools.sync.frames import Key, Side, pair_robots
from pupper_analysis.tools.sync.mjcf_side import MjcfSide
from pupper_analysis.tools.sync.plan import Edit, edits_of
from pupper_analysis.tools.sync.trial import try_files
from pupper_analysis.tools.sync.urdf_side import UrdfSide
from pupper_analysis.tools.sync.wanted import (
    OF_BODIES,
    OF_SERVOS,
    NumberChanges,
    check_own,
    refuse_numbers,
    resolve_numbers,
)

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class WrittenNumbers:
    """Files with given numbers, tried and ready to be written.

    Attributes:
        urdf: Where the URDF goes in the folder; None if the robot has none.
        mjcf: Likewise of the MJCF.
        edits: Which attributes change; their files are those that the robot was loaded from.
        notes: How numbers were written, where that is not plain.
        contents: {place in the folder: content}: the models, and what they need to be loaded.
        sources: The files that were read.
    """

    urdf: Path | None
    mjcf: Path | None
    edits: tuple[Edit, ...]
    notes: tuple[Diagnostic, ...]
    contents: Mapping[Path, bytes]
    sources: tuple[Path, ...]

    def writings(
        self, folder: Path, made: Mapping[str, str] | None = None, *, force: bool = False
    ) -> list[Writing]:
        """Returns what is to be written to a folder; what is there already is left.

        Args:
            folder: The folder.
            made: {place: hash} of what was written there before: it is replaced while it is that.
            force: Replace whatever is there, but for the robot's own files.

        Raises:
            OutputError: If that is where the robot's own files are.
        """
        with running() as run:
            for source in self.sources:
                note_input(source)
            for place in self.contents:
                run.expect(folder / place)
        return [
            Writing(folder / place, content, made_model((made or {}).get(str(place))), force=force)
            for place, content in self.contents.items()
            if not _holds(folder / place, content)
        ]

    def hashes(self) -> dict[str, str]:
        """Returns {place: hash} of what is written, by which it is known again."""
        return {str(place): hash_of(content) for place, content in self.contents.items()}

    def write(self, folder: str | Path, *, force: bool = False) -> None:
        """Writes all files, or none.

        Args:
            folder: The folder.
            force: Replace whatever is there, but for the robot's own files.

        Raises:
            OutputError: If one cannot be written, is there, or is one that the robot was loaded
                from.
        """
        write_together(self.writings(Path(folder), force=force))


def _holds(path: Path, content: bytes) -> bool:
    try:
        return path.read_bytes() == content
    except OSError:
        return False


@silence_mujoco()
def write_numbers(
    robot: Robot,
    numbers: Mapping[Key, ArrayLike],
    *,
    files: tuple[Path | None, Path | None] | None = None,
    packages: Mapping[str, Path] | None = None,
) -> WrittenNumbers:
    """Puts given numbers into a robot's URDF and MJCF, in memory, and tries the result.

    Only attributes whose numbers change are written; no other byte of a file is. Both files get
    the numbers, each in its own frames and words, whatever they were; so they agree with each other
    wherever they did. A body's mass is that of all links that move as one: it goes to one of them,
    or to all alike if none can have it alone. Where a mass is given and no inertia, the inertia
    about the com changes in proportion: the density pattern stays.

    Args:
        robot: The robot. Where one of its models was made of the other, that has no file.
        numbers: {(kind, element): value}. Of a link that moves, in the frame of the URDF's link:
            ``mass`` (kg), ``com`` (3,) (m), ``inertia`` (3, 3) about the com (kg m^2). Of a joint:
            ``damping``, ``friction``, ``armature`` of its own, without that of motors, and ``kp``
            and ``kd`` of its position servo, at the joint (N m/rad, N m s/rad), which the MJCF
            alone states.
        files: The URDF and the MJCF, if they are not those that the robot was loaded from.
        packages: {ROS package: its folder}, for ``package://`` paths.

    Returns:
        The files; ``write`` writes them.

    Raises:
        ModelError: If a number cannot be written: it names all that cannot, and why. Or if the
            files do not state the robot's own numbers where others are wanted.
        UnknownNameError: If an element is not there.
    """
    description = robot.description
    urdf_path, mjcf_path = files or (
        None if description.converted == "urdf" else description.urdf_source,
        None if description.converted == "mjcf" else description.mjcf_source,
    )
    urdf = _urdf_in_memory(robot) if urdf_path is None else read_urdf(urdf_path, packages)
    mjcf = _mjcf_in_memory(robot) if mjcf_path is None else read_mjcf(mjcf_path)
    tolerances = Tolerances()
    matched = match_models(urdf, mjcf, names=_names(robot, urdf), tolerances=tolerances)
    both = pair_robots(matched, align_robot(matched.robot, tolerances))
    changes = NumberChanges(both, resolve_numbers(matched, numbers))
    check_own(robot, changes)
    edited, layout = _Edited(), list[Copies]()
    if urdf_path is not None:
        _edit_urdf(edited, changes, urdf)
        layout.append(copies_of_urdf(urdf))
    if mjcf_path is not None:
        _edit_mjcf(edited, changes, mjcf, urdf_path)
        layout.append(copies_of_mjcf(mjcf))
    else:
        lost = [key for key in changes.wanted if key[0] in (*OF_SERVOS, "armature")]
        edited.left.update(dict.fromkeys(lost, diagnose("mjcf-alone-states-it")))
    if edited.left:
        raise refuse_numbers(robot, edited.left)
    if len(layout) == 2:
        layout = list(laid_out(*layout))
    places = {copies.main: copies.places[copies.main] for copies in layout}
    written = WrittenNumbers(
        urdf=None if urdf_path is None else places[urdf_path],
        mjcf=None if mjcf_path is None else places[mjcf_path],
        edits=edits_of(edited.documents.values()),
        notes=tuple(
            diagnose("written-so", what=" ".join(key), how=note)
            for key, note in edited.notes.items()
        ),
        contents={
            place: edited.content(file)
            for copies in layout
            for file, place in copies.places.items()
        },
        sources=tuple(file for copies in layout for file in copies.files),
    )
    try_files(written.contents, changes, (urdf, written.urdf), (mjcf, written.mjcf))
    return written


@dataclass(eq=False)
class _Edited:
    """Documents with what is to be changed.

    Attributes:
        documents: {file: its document}.
        left: {number: why it cannot be written}.
        notes: {number: what is to be said}.
    """

    documents: dict[Path, XmlDocument] = field(default_factory=dict)
    left: dict[Key, Diagnostic] = field(default_factory=dict)
    notes: dict[Key, Diagnostic] = field(default_factory=dict)

    def content(self, file: Path) -> bytes:
        """Returns what a file shall hold."""
        document = self.documents.get(file)
        return read_input(file, MOST_FILE) if document is None else document.rendered()

    def take(self, side: Side) -> None:
        """Takes what a side tells."""
        self.left.update(side.left)
        self.notes.update(side.notes)


def _edit_urdf(edited: _Edited, changes: NumberChanges, urdf: UrdfFile) -> None:
    document = read_document(urdf.path)
    edited.documents[urdf.path] = document
    side = UrdfSide(
        tree=UrdfTree(document.root),
        sides=changes.both,
        wanted=changes.tree("urdf"),
        digits=Digits.of([urdf.path]),
    )
    side.plan([key for key in changes.wanted if key[0] in (*OF_BODIES, "damping", "friction")])
    edited.take(side)


def _edit_mjcf(edited: _Edited, changes: NumberChanges, mjcf: MjcfFile, urdf: Path | None) -> None:
    texts = [*mjcf.files] if urdf is None else [urdf, *mjcf.files]
    elements = MjcfInPlace(mjcf, Digits.of(texts))
    edited.documents.update(elements.documents)
    gains = {key: float(value) for key, value in changes.wanted.items() if key[0] in OF_SERVOS}
    side = MjcfSide(
        file=mjcf,
        elements=elements,
        sides=changes.both,
        wanted=changes.tree("mjcf"),
        digits=elements.digits,
        gains=gains,
    )
    side.plan([key for key in changes.wanted if key not in gains])
    edited.take(side)


def _urdf_in_memory(robot: Robot) -> UrdfFile:
    text = robot.description.urdf
    return urdf_from(robot.description.mjcf_source, text, parse_text(text), None)


def _mjcf_in_memory(robot: Robot) -> MjcfFile:
    """Returns the MJCF that was made of a URDF, without shapes, which weigh nothing in it."""
    spec = robot.description.mjcf.copy()
    for pair in list(spec.pairs):
        spec.delete(pair)
    for geom in list(spec.geoms):
        spec.delete(geom)
    for element in (*spec.meshes, *spec.textures, *spec.materials, *spec.keys):
        spec.delete(element)
    return mjcf_of_text(robot.description.urdf_source, to_xml(spec), {})


def _names(robot: Robot, urdf: UrdfFile) -> dict[str, str]:
    """Returns {joint in the file: in the robot}, of those that loading has named otherwise."""
    named = {
        joint.child: name for name, joint in UrdfTree.of(robot.description.urdf).joints.items()
    }
    known = set(robot.joint_names)
    return {
        name: named[joint.child]
        for name, joint in urdf.tree.joints.items()
        if named.get(joint.child, name) != name and named[joint.child] in known
    }
