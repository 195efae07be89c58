"""Writes given numbers into a robot's URDF and MJCF alike, each in its own frames and words.

In another folder a model's files stand to each other as they did, so that all are found: no path in
a file is rewritten, and what is written differs in nothing else.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ModelError, UnknownNameError
from pupper_analysis.base.files import Writing, remove_stale_files, resolve_target
from pupper_analysis.base.inputs import MAX_FILE_BYTES, read_input
from pupper_analysis.base.kinds import generated_model_kind, hash_content
from pupper_analysis.base.runs import ensure_run, register_input
from pupper_analysis.models.attributes import BY_KIND
from pupper_analysis.models.conversion import joint_armature, joint_damping
from pupper_analysis.models.mjcf import silence_mujoco, to_xml
from pupper_analysis.models.mjcf_file import MjcfFile, mjcf_of_text, read_mjcf
from pupper_analysis.models.multibody import MultibodyTree, TreeBody
from pupper_analysis.models.urdf_file import UrdfFile, read_urdf, urdf_from
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml import parse_text
from pupper_analysis.robot.compare.attribution import align_robot
from pupper_analysis.robot.matching.match import Match, match_models
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.robot.matching.trees import kinematic_trees
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import list_position_servos
from pupper_analysis.tools.sync.frames import Key, MatchedRobots, is_same_body, pair_robots
from pupper_analysis.tools.sync.mjcf_in_place import EditableMjcf
from pupper_analysis.tools.sync.mjcf_side import MjcfSide
from pupper_analysis.tools.sync.plan import (
    Edit,
    FileLayout,
    combine_layouts,
    list_edits,
    list_mjcf_files,
    list_urdf_files,
    write_temporary_files,
)
from pupper_analysis.tools.sync.urdf_side import UrdfSide
from pupper_analysis.tools.sync.xml_bytes import XmlDocument, read_document

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class WrittenNumbers:
    """Files with given numbers, tried and ready to be written.

    Attributes:
        urdf: Where the URDF goes in the folder; None if the robot has none.
        mjcf: Likewise of the MJCF.
        edits: Which attributes change; their files are those that the robot was loaded from.
        contents: {place in the folder: content}: the models, and what they need to be loaded.
        sources: The files that were read.
    """

    urdf: Path | None
    mjcf: Path | None
    edits: tuple[Edit, ...]
    contents: Mapping[Path, bytes]
    sources: tuple[Path, ...]

    def make_writings(
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
        with ensure_run() as run:
            for source in self.sources:
                register_input(source)
            for place in self.contents:
                run.expect(folder / place)
                remove_stale_files(resolve_target(folder / place)[0].parent)
        return [
            Writing(
                folder / place,
                content,
                generated_model_kind((made or {}).get(str(place))),
                force=force,
            )
            for place, content in self.contents.items()
            if not _holds(folder / place, content)
        ]

    def hash_contents(self) -> dict[str, str]:
        """Returns {place: hash} of what is written, by which it is known again."""
        return {str(place): hash_content(content) for place, content in self.contents.items()}


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
) -> WrittenNumbers:
    """Puts given numbers into a robot's URDF and MJCF, in memory, and tries the result.

    Only attributes whose numbers change are written; no other byte of a file is. Both files get
    the numbers, each in its own frames and words, whatever they were; so they agree with each other
    wherever they did. A body's mass is that of all links that move as one: it goes to one of them.
    Where a mass is given and no inertia, the inertia
    about the com changes in proportion: the density pattern stays.

    Args:
        robot: The robot. Where one of its models was made of the other, that has no file.
        numbers: {(kind, element): value}. Of a link that moves, in the frame of the URDF's link:
            ``mass`` (kg), ``com`` (3,) (m), ``inertia`` (3, 3) about the com (kg m^2). Of a joint:
            ``damping``, ``friction``, ``armature`` of its own, without that of motors, and ``kp``
            and ``kd`` of its position servo, at the joint (N m/rad, N m s/rad), which the MJCF
            alone states.
        files: The URDF and the MJCF, if they are not those that the robot was loaded from.

    Returns:
        The files; ``write_all`` of their ``writings`` writes them.

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
    urdf = _urdf_in_memory(robot) if urdf_path is None else read_urdf(urdf_path)
    mjcf = _mjcf_in_memory(robot) if mjcf_path is None else read_mjcf(mjcf_path)
    tolerances = Tolerances()
    names = _names(robot, urdf)
    matched = match_models(urdf, mjcf, names=names, tolerances=tolerances)
    both = pair_robots(matched, align_robot(matched.robot, tolerances))
    changes = NumberChanges(both, resolve_numbers(matched, numbers))
    check_robot_matches_files(robot, changes)
    documents, left, layout = dict[Path, XmlDocument](), dict[Key, Diagnostic](), list[FileLayout]()
    if urdf_path is not None:
        documents[urdf.path] = read_document(urdf.path)
        into_urdf = UrdfSide(
            tree=UrdfTree(documents[urdf.path].root), sides=both, target=changes.tree("urdf")
        )
        kinds = (*BODY_KINDS, "damping", "friction")
        into_urdf.plan([key for key in changes.wanted if key[0] in kinds])
        left |= into_urdf.unwritten
        layout.append(list_urdf_files(urdf))
    if mjcf_path is not None:
        elements = EditableMjcf(mjcf)
        documents |= elements.documents
        gains = {
            key: float(value) for key, value in changes.wanted.items() if key[0] in SERVO_KINDS
        }
        into_mjcf = MjcfSide(
            file=mjcf, elements=elements, sides=both, target=changes.tree("mjcf"), gains=gains
        )
        into_mjcf.plan([key for key in changes.wanted if key not in gains])
        left |= into_mjcf.unwritten
        layout.append(list_mjcf_files(mjcf))
    else:
        lost = [key for key in changes.wanted if key[0] in (*SERVO_KINDS, "armature")]
        left |= dict.fromkeys(lost, diagnose("mjcf-alone-states-it"))
    if left:
        raise make_refusal(robot, left)
    if len(layout) == 2:
        layout = list(combine_layouts(*layout))
    places = {copies.main: copies.places[copies.main] for copies in layout}
    written = WrittenNumbers(
        urdf=None if urdf_path is None else places[urdf_path],
        mjcf=None if mjcf_path is None else places[mjcf_path],
        edits=list_edits(documents.values()),
        contents={
            place: documents[file].render()
            if file in documents
            else read_input(file, MAX_FILE_BYTES)
            for copies in layout
            for file, place in copies.places.items()
        },
        sources=tuple(file for copies in layout for file in copies.files),
    )
    try_files(written.contents, changes, (urdf, written.urdf), (mjcf, written.mjcf), names)
    return written


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


# Files with given numbers are read by both engines, before they are written.


_WRITTEN = 1e-9
"""Relative: what is read of a written file is what was wanted, after rotations and rounding."""


def try_files(
    contents: Mapping[Path, bytes],
    changes: NumberChanges,
    urdf: tuple[UrdfFile, Path | None],
    mjcf: tuple[MjcfFile, Path | None],
    names: Mapping[str, str],
) -> None:
    """Writes the files elsewhere, reads them by both engines, and checks what has changed.

    Args:
        contents: {place in a folder: content}.
        changes: What shall have changed.
        urdf: The URDF as it was, and its place; None if it has no file.
        mjcf: Likewise of the MJCF.
        names: How the two were matched.

    Raises:
        ModelError: If an engine refuses a file, or reads another number than was wanted.
    """
    robot = changes.both.matched.robot
    with write_temporary_files(contents) as folder:
        try:
            one = urdf[0] if urdf[1] is None else read_urdf(folder / urdf[1], urdf[0].packages)
            two = mjcf[0] if mjcf[1] is None else read_mjcf(folder / mjcf[1])
            after = match_models(one, two, names=names, tolerances=Tolerances()).robot
        except ModelError as error:
            message = error.cause.with_names(lambda text: text.replace(f"{folder}/", ""))
            raise ModelError(robot.name, diagnose("written-not-read", problem=message)) from error
    written = [side for side, (_, there) in (("urdf", urdf), ("mjcf", mjcf)) if there is not None]
    wrong = dict.fromkeys(_odd(changes, after, written), diagnose("read-otherwise"))
    if wrong:
        raise make_refusal(robot, wrong)


def _odd(changes: NumberChanges, after: Robot, sides: Iterable[str]) -> Iterator[Key]:
    """Yields what the engines read of written files that is not what was wanted."""
    trees = dict(zip(("urdf", "mjcf"), kinematic_trees(after), strict=True))
    for side in sides:
        wanted, frames = changes.tree(side), changes.both.mjcf_frames if side == "mjcf" else {}
        for mover, body in trees[side].bodies.items():
            frame = frames.get(mover, pin.SE3.Identity())
            if not is_same_body(frame.actInv(wanted.bodies[mover].rigid), body.rigid, _WRITTEN):
                kind = next((k for k in BODY_KINDS if (k, mover) in changes.wanted), "mass")
                yield kind, mover
        for kind, (name, joint) in product(JOINT_KINDS, trees[side].joints.items()):
            values = [float(getattr(one, kind)) for one in (joint, wanted.joints[name])]
            if not math.isclose(*values, rel_tol=_WRITTEN):
                yield kind, name
    gains = list_position_servos(after)
    for (kind, name), value in changes.wanted.items() if "mjcf" in sides else ():
        if kind in SERVO_KINDS:
            read = gains[name][SERVO_KINDS.index(kind)] if name in gains else math.nan
            if not math.isclose(read, float(value), rel_tol=_WRITTEN):
                yield kind, name


# Given numbers of a robot, by what moves, and what both of its models become with them.


BODY_KINDS = ("mass", "com", "inertia")
JOINT_KINDS = ("damping", "friction", "armature")
SERVO_KINDS = ("kp", "kd")

_OWN = 1e-6
"""Relative: a robot's number is that of its file. What an engine makes of a file, converted or
aligned, is good to some 1e-9; what was changed since differs by more than anybody writes digits."""


def make_refusal(robot: Robot, left: Mapping[Key, Diagnostic]) -> ModelError:
    """Returns the error that names the numbers that cannot be written, each with its reason."""
    problems = [diagnose("number-unwritten", what=" ".join(k), why=why) for k, why in left.items()]
    return ModelError(robot.name, diagnose("numbers-unwritten", problems=problems))


def resolve_numbers(matched: Match, numbers: Mapping[Key, ArrayLike]) -> dict[Key, Array]:
    """Returns the numbers by the names of base and joints that move what they are of.

    Raises:
        UnknownNameError: If an element is not there.
    """
    movers: dict[str, str] = {}
    for names in (matched.mjcf_body, matched.urdf_link):
        movers |= {name: mover for mover, name in names.items()}
    movers |= {mover: mover for mover in matched.urdf_link}
    model, found = matched.robot.pin_model, {}
    for (kind, element), value in numbers.items():
        mover = movers.get(element)
        if kind not in BODY_KINDS:
            mover = element if element in matched.robot.joint_names else None
        elif mover is None and model.existFrame(element, pin.FrameType.BODY):
            at = model.frames[model.getFrameId(element, pin.FrameType.BODY)].parentJoint
            name = str(model.names[at])
            mover = name if name in matched.robot.joint_names else matched.robot.base
        if mover is None:
            known = movers if kind in BODY_KINDS else matched.robot.joint_names
            what = "link" if kind in BODY_KINDS else "joint"
            raise UnknownNameError(matched.robot.name, what, element, known)
        found[kind, mover] = np.array(value, dtype=float)
    return found


def check_robot_matches_files(robot: Robot, changes: NumberChanges) -> None:
    """Checks that a robot's bodies are those that its files state, in the same frames.

    All of them: where one is not, the files are another robot's, whatever is written.

    Raises:
        ModelError: If one is not: it was changed since, or derived.
    """
    both = changes.both
    own, base = kinematic_trees(robot)[0], both.matched.robot.base
    for mover in both.matched.urdf_link:
        stated = both.urdf.bodies[mover]
        body = own.bodies.get(own.base if mover == base else mover, stated)
        size = max(float(np.abs(stated.inertia).max()), 1e-300)
        if mover == base and not robot.floating:  # in the world's frame
            body = replace(body, com=stated.com, inertia=stated.inertia)
        if (
            abs(body.mass - stated.mass) > _OWN * stated.mass
            or float(np.abs(body.com - stated.com).max()) > _OWN
            or float(np.abs(body.inertia - stated.inertia).max()) > 1e3 * _OWN * size
        ):
            message = diagnose(
                "robot-is-not-its-files",
                subject=("link", both.matched.urdf_link.get(mover, mover)),
                file=both.matched.robot.description.urdf_source.name,
                mass=Quantity(body.mass, "kg"),
                stated=Quantity(stated.mass, "kg"),
            )
            raise ModelError(robot.name, message)


class NumberChanges:
    """What both robots shall be.

    Args:
        both: The robots, in the URDF's link frames.
        wanted: {(kind, base or joint): value}.
    """

    def __init__(self, both: MatchedRobots, wanted: Mapping[Key, Array]) -> None:
        self.both, self.wanted = both, wanted
        model = both.matched.robot.mj_model
        joints = both.matched.robot.joint_names
        dofs = [int(model.jnt_dofadr[model.joint(name).id]) for name in joints]
        self.movers = tuple(dict.fromkeys(name for kind, name in wanted if kind in BODY_KINDS))
        more = {
            "damping": joint_damping(model) - model.dof_damping,
            "armature": joint_armature(model) - model.dof_armature,
        }
        self._of_motors = {
            kind: dict(zip(joints, values[dofs].tolist(), strict=True))
            for kind, values in more.items()
        }

    def tree(self, side: str) -> MultibodyTree:
        """Returns what a robot shall be, of ``"urdf"`` or ``"mjcf"``."""
        tree = self.both.urdf if side == "urdf" else self.both.mjcf
        bodies, joints = dict(tree.bodies), dict(tree.joints)
        for mover in self.movers:
            bodies[mover] = self._body(bodies[mover], mover)
        for (kind, name), value in self.wanted.items():
            if kind in JOINT_KINDS:
                whole = float(value) + float(self._of_motors.get(kind, {}).get(name, 0.0))
                changed: dict[str, Any] = {BY_KIND[kind].field: whole}
                joints[name] = replace(joints[name], **changed)
        return replace(tree, bodies=bodies, joints=joints)

    def _body(self, body: TreeBody, mover: str) -> TreeBody:
        mass = float(self.wanted.get(("mass", mover), np.array(body.mass)))
        com = self.wanted.get(("com", mover), body.com)
        pattern = body.inertia * (mass / body.mass if body.mass > 0 else 1.0)
        return replace(
            body, mass=mass, com=com, inertia=self.wanted.get(("inertia", mover), pattern)
        )
