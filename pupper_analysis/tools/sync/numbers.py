"""Writing of given numbers into the URDF and the MJCF of a robot.

The output folder preserves the relative paths of a model's files. Therefore paths in the files need
not be changed.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pupper_analysis.base.array_types import Array
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
from pupper_analysis.models.xml_bytes import XmlDocument, read_xml_bytes
from pupper_analysis.robot.compare.attribution import align_robot
from pupper_analysis.robot.compare.differences import PropertyKey
from pupper_analysis.robot.matching.match import Match, match_models
from pupper_analysis.robot.matching.sources import BODY_KINDS
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.robot.matching.trees import kinematic_trees
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import list_position_servos
from pupper_analysis.tools.sync.frames import MatchedRobots, is_same_body, pair_robots
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


@dataclass(frozen=True, eq=False)
class WrittenNumbers:
    """Model files with new numbers, in memory, verified and ready to be written.

    Attributes:
        urdf: Path of the URDF in the output folder; None if the robot has no URDF file.
        mjcf: Path of the MJCF in the output folder; None if the robot has no MJCF file.
        edits: Changes of attributes, in the files that were read.
        contents: {path in the folder: content} of the models and of the files that the models need.
        sources: Files that were read.
    """

    urdf: Path | None
    mjcf: Path | None
    edits: tuple[Edit, ...]
    contents: Mapping[Path, bytes]
    sources: tuple[Path, ...]

    def make_writings(
        self, folder: Path, old_hashes: Mapping[str, str] | None = None, *, force: bool = False
    ) -> list[Writing]:
        """Create the requests for `write_all` that write the new files into a folder.

        Stale temporary files of earlier runs are removed from the folders.

        Args:
            folder: Output folder.
            old_hashes: {path in the folder: hash} of an earlier result. An existing file is
                replaced if the content has this hash.
            force: Replace any file that is not a file of the robot.

        Raises:
            OutputError: If a file would replace a file of the robot.
        """
        with ensure_run() as run:
            for source in self.sources:
                register_input(source)
            for place in self.contents:
                run.register_output(folder / place)
                remove_stale_files(resolve_target(folder / place)[0].parent)
        return [
            Writing(
                folder / place,
                content,
                generated_model_kind((old_hashes or {}).get(str(place))),
                force=force,
            )
            for place, content in self.contents.items()
            if not _has_content(folder / place, content)
        ]

    def hash_contents(self) -> dict[str, str]:
        """Compute the hashes of the file contents: {path in the output folder: hash}.

        A later run recognises unmodified files by the hash.
        """
        return {str(place): hash_content(content) for place, content in self.contents.items()}


def _has_content(path: Path, content: bytes) -> bool:
    """Return True if a file has this content; False if the file cannot be read."""
    try:
        return path.read_bytes() == content
    except OSError:
        return False


@silence_mujoco()
def write_numbers(
    robot: Robot,
    numbers: Mapping[PropertyKey, ArrayLike],
    *,
    files: tuple[Path | None, Path | None] | None = None,
) -> WrittenNumbers:
    """Change numbers in the URDF and the MJCF of a robot, in memory, and verify the result.

    Attributes that state changed numbers are written, in the frames of each file; all other bytes
    stay. If a mass is given without an inertia, the inertia about the CoM is scaled by the ratio of
    the masses.

    Args:
        robot: Robot. A model that was generated from the other model has no file, and is not
            written.
        numbers: {(kind, element): value}. The kinds of a link or body are ``mass`` [kg], ``com``,
            shape (3,) [m], and ``inertia`` about the CoM, shape (3, 3) [kg m^2]. The values belong
            to all links that move together with the element. The frame is the frame of the URDF's
            link that the joint moves, or of the base. The kinds of a joint are ``damping`` [N m
            s/rad, N s/m], ``friction`` [N m, N] and ``armature`` [kg m^2, kg], without the
            contributions of motors. Further kinds of a joint are ``kp`` [N m/rad, N/m] and ``kd``
            [N m s/rad, N s/m] of the position servo, at the joint. A URDF cannot state
            ``armature``, ``kp`` and ``kd``.
        files: URDF and MJCF, if different from the files from which the robot was loaded.

    Returns:
        New files; `write_all` writes the result of `make_writings`.

    Raises:
        ModelError: If a number cannot be written (the message lists all, with reasons), or the
            files do not describe the robot, for example.
        UnknownNameError: If an element does not exist, or a kind of number is unknown.
    """
    for kind, _ in numbers:
        if kind not in NUMBER_KINDS:
            raise UnknownNameError(robot.name, "number", kind, NUMBER_KINDS)
    description = robot.description
    urdf_path, mjcf_path = files or (
        None if description.converted == "urdf" else description.urdf_source,
        None if description.converted == "mjcf" else description.mjcf_source,
    )
    urdf = _make_urdf(robot) if urdf_path is None else read_urdf(urdf_path)
    mjcf = _make_mjcf(robot) if mjcf_path is None else read_mjcf(mjcf_path)
    tolerances = Tolerances()
    names = _map_renamed_joints(robot, urdf)
    matched = match_models(urdf, mjcf, names=names, tolerances=tolerances)
    robots = pair_robots(matched, align_robot(matched.robot, tolerances))
    changes = NumberChanges(robots, resolve_numbers(matched, numbers))
    check_robot_matches_files(robot, changes)
    in_urdf = _EditedFile() if urdf_path is None else _edit_urdf(urdf, robots, changes)
    in_mjcf = (
        _EditedFile(unwritten=_refuse_mjcf_numbers(changes))
        if mjcf_path is None
        else _edit_mjcf(mjcf, robots, changes)
    )
    unwritten = {**in_urdf.unwritten, **in_mjcf.unwritten}
    if unwritten:
        raise make_refusal(robot, unwritten)
    documents = {**in_urdf.documents, **in_mjcf.documents}
    layout = [*in_urdf.layout, *in_mjcf.layout]
    if len(layout) == 2:
        layout = list(combine_layouts(*layout))
    places = {copies.main: copies.copy_paths[copies.main] for copies in layout}
    written = WrittenNumbers(
        urdf=None if urdf_path is None else places[urdf_path],
        mjcf=None if mjcf_path is None else places[mjcf_path],
        edits=list_edits(documents.values()),
        contents=_render_files(documents, layout),
        sources=tuple(file for copies in layout for file in copies.files),
    )
    try_files(written.contents, changes, (urdf, written.urdf), (mjcf, written.mjcf), names)
    return written


@dataclass(frozen=True, eq=False)
class _EditedFile:
    """Model file with new numbers, edited in memory; without a file, no documents and no layout.

    Attributes:
        documents: {path: edited XML document} of the file and the included files.
        unwritten: {property: reason} of the numbers that the file cannot state.
        layout: Files that the model needs, with paths in the output folder.
    """

    documents: Mapping[Path, XmlDocument] = field(default_factory=dict)
    unwritten: Mapping[PropertyKey, Diagnostic] = field(default_factory=dict)
    layout: tuple[FileLayout, ...] = ()


def _edit_urdf(urdf: UrdfFile, robots: MatchedRobots, changes: NumberChanges) -> _EditedFile:
    """Write the numbers that a URDF can state into the document in memory."""
    document = read_xml_bytes(urdf.path)
    side = UrdfSide(tree=UrdfTree(document.root), sides=robots, target=changes.make_tree("urdf"))
    kinds = (*BODY_KINDS, "damping", "friction")
    side.plan([key for key in changes.wanted if key[0] in kinds])
    return _EditedFile({urdf.path: document}, side.unwritten, (list_urdf_files(urdf),))


def _edit_mjcf(mjcf: MjcfFile, robots: MatchedRobots, changes: NumberChanges) -> _EditedFile:
    """Write the numbers into the documents of an MJCF in memory, if possible."""
    elements = EditableMjcf(mjcf)
    gains = {key: float(value) for key, value in changes.wanted.items() if key[0] in SERVO_KINDS}
    side = MjcfSide(
        file=mjcf,
        elements=elements,
        sides=robots,
        target=changes.make_tree("mjcf"),
        gains=gains,
    )
    side.plan([key for key in changes.wanted if key not in gains])
    return _EditedFile(elements.documents, side.unwritten, (list_mjcf_files(mjcf),))


def _refuse_mjcf_numbers(changes: NumberChanges) -> dict[PropertyKey, Diagnostic]:
    """Refuse requested numbers that only an MJCF states (gains, armatures): {property: reason}."""
    mjcf_only = [key for key in changes.wanted if key[0] in (*SERVO_KINDS, "armature")]
    return dict.fromkeys(mjcf_only, diagnose("mjcf-alone-states-it"))


def _render_files(
    documents: Mapping[Path, XmlDocument], layout: Sequence[FileLayout]
) -> dict[Path, bytes]:
    """Render changed documents, and read the other files: {path in the output folder: content}."""
    return {
        place: documents[file].render() if file in documents else read_input(file, MAX_FILE_BYTES)
        for copies in layout
        for file, place in copies.copy_paths.items()
    }


def _make_urdf(robot: Robot) -> UrdfFile:
    """Return the URDF that was generated from the MJCF of a robot."""
    text = robot.description.urdf
    return urdf_from(robot.description.mjcf_source, text, parse_text(text), None)


def _make_mjcf(robot: Robot) -> MjcfFile:
    """Return the MJCF generated from a URDF, without shapes (which have no mass) and keyframes."""
    spec = robot.description.mjcf.copy()
    for pair in list(spec.pairs):
        spec.delete(pair)
    for geom in list(spec.geoms):
        spec.delete(geom)
    for element in (*spec.meshes, *spec.textures, *spec.materials, *spec.keys):
        spec.delete(element)
    return mjcf_of_text(robot.description.urdf_source, to_xml(spec), {})


def _map_renamed_joints(robot: Robot, urdf: UrdfFile) -> dict[str, str]:
    """Find the joints that were renamed on loading: {joint in the URDF: joint of the robot}."""
    name_of_child = {
        joint.child: name for name, joint in UrdfTree.of(robot.description.urdf).joints.items()
    }
    joint_names = set(robot.joint_names)
    return {
        name: name_of_child[joint.child]
        for name, joint in urdf.tree.joints.items()
        if name_of_child.get(joint.child, name) != name
        and name_of_child[joint.child] in joint_names
    }


# Verification: the new files are read by both engines.


_READ_RTOL = 1e-9
"""Tolerance of the difference between a requested number and the number that an engine reads from
the new file: absolute [m] for a centre of mass, otherwise relative. Covers the rounding errors of
digits and of rotations. Chosen, not tuned.
"""


def try_files(
    contents: Mapping[Path, bytes],
    changes: NumberChanges,
    urdf: tuple[UrdfFile, Path | None],
    mjcf: tuple[MjcfFile, Path | None],
    names: Mapping[str, str],
) -> None:
    """Verify new model files: read temporary copies with both engines, and check the new numbers.

    Args:
        contents: {path in the folder: content}.
        changes: Requested numbers.
        urdf: Old URDF; and the path of the new URDF in the folder, None if there is no new URDF.
        mjcf: Old MJCF; and the path of the new MJCF in the folder, None if there is no new MJCF.
        names: Names with which the files were matched.

    Raises:
        ModelError: If an engine refuses a file, or reads another number.
    """
    robot = changes.both.matched.robot
    with write_temporary_files(contents) as folder:
        try:
            new_urdf = urdf[0] if urdf[1] is None else read_urdf(folder / urdf[1], urdf[0].packages)
            new_mjcf = mjcf[0] if mjcf[1] is None else read_mjcf(folder / mjcf[1])
            after = match_models(new_urdf, new_mjcf, names=names, tolerances=Tolerances()).robot
        except ModelError as error:
            message = error.cause.with_names(lambda text: text.replace(f"{folder}/", ""))
            raise ModelError(robot.name, diagnose("written-not-read", problem=message)) from error
    written = [
        side for side, (_, new_path) in (("urdf", urdf), ("mjcf", mjcf)) if new_path is not None
    ]
    wrong_numbers = dict.fromkeys(
        _find_wrong_numbers(changes, after, written), diagnose("read-otherwise")
    )
    if wrong_numbers:
        raise make_refusal(robot, wrong_numbers)


def _find_wrong_numbers(
    changes: NumberChanges, after: Robot, sides: Iterable[str]
) -> Iterator[PropertyKey]:
    """Yield the numbers (kind, element) whose value in the written files differs from the target.

    ``after`` is the robot, read from the written files; ``sides`` are ``"urdf"``, ``"mjcf"``.
    """
    trees = dict(zip(("urdf", "mjcf"), kinematic_trees(after), strict=True))
    for side in sides:
        target, frames = changes.make_tree(side), changes.both.mjcf_frames if side == "mjcf" else {}
        for mover, body in trees[side].bodies.items():
            frame = frames.get(mover, pin.SE3.Identity())
            if not is_same_body(
                frame.actInv(target.bodies[mover].spatial_inertia), body.spatial_inertia, _READ_RTOL
            ):
                kind = next((k for k in BODY_KINDS if (k, mover) in changes.wanted), "mass")
                yield kind, mover
        for kind, (name, joint) in product(JOINT_PARAMETER_KINDS, trees[side].joints.items()):
            values = [
                float(getattr(tree_joint, kind)) for tree_joint in (joint, target.joints[name])
            ]
            if not math.isclose(*values, rel_tol=_READ_RTOL):
                yield kind, name
    gains = list_position_servos(after)
    for (kind, name), value in changes.wanted.items() if "mjcf" in sides else ():
        if kind in SERVO_KINDS:
            gain = gains[name][SERVO_KINDS.index(kind)] if name in gains else math.nan
            if not math.isclose(gain, float(value), rel_tol=_READ_RTOL):
                yield kind, name


# Numbers by base and joints, and the target trees of both models.


JOINT_PARAMETER_KINDS = ("damping", "friction", "armature")
"""Kinds of numbers of a joint that `write_numbers` accepts, in addition to servo gains."""
SERVO_KINDS = ("kp", "kd")
"""Kinds of numbers of a position servo that `write_numbers` accepts."""
NUMBER_KINDS = (*BODY_KINDS, *JOINT_PARAMETER_KINDS, *SERVO_KINDS)
"""All kinds of numbers that `write_numbers` accepts."""

_SAME_ROBOT_RTOL = 1e-6
"""Tolerance of the difference between a body of the loaded robot and the same body in the files.
The tolerance is relative for the mass, absolute [m] for the CoM, and 1e3 times larger and relative
for the inertia. At a larger difference nothing is written, since the robot was probably changed
after loading. Chosen, not tuned.
"""


def make_refusal(robot: Robot, reasons: Mapping[PropertyKey, Diagnostic]) -> ModelError:
    """Create the error that lists the numbers that cannot be written, with reasons."""
    problems = [
        diagnose("number-unwritten", what=" ".join(k), why=why) for k, why in reasons.items()
    ]
    return ModelError(robot.name, diagnose("numbers-unwritten", problems=problems))


def resolve_numbers(
    matched: Match, numbers: Mapping[PropertyKey, ArrayLike]
) -> dict[PropertyKey, Array]:
    """Replace links and bodies in the keys of ``numbers`` by the joints that move the links.

    The base replaces a link or body that no joint moves.

    Args:
        matched: Matched URDF and MJCF.
        numbers: {(kind of number, name of a link, body or joint): value}.

    Returns:
        {(kind, base or joint that moves the element): value}.

    Raises:
        UnknownNameError: If an element does not exist.
    """
    movers: dict[str, str] = {}
    for names in (matched.mjcf_body, matched.urdf_link):
        movers |= {name: mover for mover, name in names.items()}
    movers |= {mover: mover for mover in matched.urdf_link}
    model, resolved = matched.robot.pin_model, {}
    for (kind, element), value in numbers.items():
        mover = movers.get(element)
        if kind not in BODY_KINDS:
            mover = element if element in matched.robot.joint_names else None
        elif mover is None and model.existFrame(element, pin.FrameType.BODY):
            joint_id = model.frames[model.getFrameId(element, pin.FrameType.BODY)].parentJoint
            name = str(model.names[joint_id])
            mover = name if name in matched.robot.joint_names else matched.robot.base
        if mover is None:
            valid_names = movers if kind in BODY_KINDS else matched.robot.joint_names
            noun = "link" if kind in BODY_KINDS else "joint"
            raise UnknownNameError(matched.robot.name, noun, element, valid_names)
        resolved[kind, mover] = np.array(value, dtype=float)
    return resolved


def check_robot_matches_files(robot: Robot, changes: NumberChanges) -> None:
    """Check that a robot in memory has the mass, CoM and inertia of each body in the files.

    Of a base that is fixed in the world, the mass is compared.

    Raises:
        ModelError: If a body differs: the robot was changed after loading, or has other files.
    """
    robots = changes.both
    tree, base = kinematic_trees(robot)[0], robots.matched.robot.base
    for mover in robots.matched.urdf_link:
        file_body = robots.urdf.bodies[mover]
        body = tree.bodies.get(tree.base if mover == base else mover, file_body)
        size = max(float(np.abs(file_body.inertia).max()), 1e-300)
        if mover == base and not robot.floating:  # expressed in the world frame
            body = replace(body, com=file_body.com, inertia=file_body.inertia)
        if (
            abs(body.mass - file_body.mass) > _SAME_ROBOT_RTOL * file_body.mass
            or float(np.abs(body.com - file_body.com).max()) > _SAME_ROBOT_RTOL
            or float(np.abs(body.inertia - file_body.inertia).max()) > 1e3 * _SAME_ROBOT_RTOL * size
        ):
            message = diagnose(
                "robot-is-not-its-files",
                subject=("link", robots.matched.urdf_link.get(mover, mover)),
                file=robots.matched.robot.description.urdf_source.name,
                mass=Quantity(body.mass, "kg"),
                stated=Quantity(file_body.mass, "kg"),
            )
            raise ModelError(robot.name, message)


class NumberChanges:
    """Requested numbers of links and joints, from which the target tree of a file is built.

    Args:
        both: Matched robots of URDF and MJCF, in the URDF's link frames.
        wanted: {(kind, base or joint): value}.
    """

    def __init__(self, both: MatchedRobots, wanted: Mapping[PropertyKey, Array]) -> None:
        self.both, self.wanted = both, wanted
        model = both.matched.robot.mj_model
        joints = both.matched.robot.joint_names
        dofs = [int(model.jnt_dofadr[model.joint(name).id]) for name in joints]
        self.movers = tuple(dict.fromkeys(name for kind, name in wanted if kind in BODY_KINDS))
        values_of_kind = {
            "damping": joint_damping(model) - model.dof_damping,
            "armature": joint_armature(model) - model.dof_armature,
        }
        self._motor_values = {
            kind: dict(zip(joints, values[dofs].tolist(), strict=True))
            for kind, values in values_of_kind.items()
        }

    def make_tree(self, side: str) -> MultibodyTree:
        """Return the multibody tree that a file must describe with the requested numbers.

        Args:
            side: ``"urdf"`` or ``"mjcf"``.
        """
        tree = self.both.urdf if side == "urdf" else self.both.mjcf
        bodies, joints = dict(tree.bodies), dict(tree.joints)
        for mover in self.movers:
            bodies[mover] = self._change_body(bodies[mover], mover)
        for (kind, name), value in self.wanted.items():
            if kind in JOINT_PARAMETER_KINDS:
                total = float(value) + float(self._motor_values.get(kind, {}).get(name, 0.0))
                changed: dict[str, Any] = {BY_KIND[kind].field: total}
                joints[name] = replace(joints[name], **changed)
        return replace(tree, bodies=bodies, joints=joints)

    def _change_body(self, body: TreeBody, mover: str) -> TreeBody:
        """Return a body with the requested mass, CoM and inertia.

        ``mover`` is the joint that moves the body, or the base. Without a requested inertia, the
        inertia is scaled with the mass.
        """
        mass = float(self.wanted.get(("mass", mover), np.array(body.mass)))
        com = self.wanted.get(("com", mover), body.com)
        pattern = body.inertia * (mass / body.mass if body.mass > 0 else 1.0)
        return replace(
            body, mass=mass, com=com, inertia=self.wanted.get(("inertia", mover), pattern)
        )
