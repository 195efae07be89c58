"""Content of a model file for comparison with another version, and access to versions in git.

`read_version` converts a URDF or MJCF to a tree of joints and bodies, values outside the tree and
further elements. `open_version` and `open_revision` extract files of a git revision to a temporary
folder, without running filters or hooks of the repository.
"""

from __future__ import annotations

import os
import posixpath
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, TypeVar, cast

import mujoco
import numpy as np

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.base.inputs import path_exists
from pupper_analysis.models.efforts import find_null_efforts
from pupper_analysis.models.git import (
    SAFE_ENVIRONMENT,
    SAFE_OPTIONS,
    GitEntry,
    git_entries,
    pointed_file,
    run_git,
)
from pupper_analysis.models.mjcf import JointKind, compile_spec, name_elements
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.multibody import MultibodyTree
from pupper_analysis.models.objects import ModelObject, is_object
from pupper_analysis.models.places import Place, one_line
from pupper_analysis.models.published import is_published_name, is_uri
from pupper_analysis.models.spec_tree import join_free_base
from pupper_analysis.models.stated.model import Inertial
from pupper_analysis.models.stated.urdf import read_urdf_model
from pupper_analysis.models.transmission import actuator_gear, list_actuator_targets
from pupper_analysis.models.urdf_file import UrdfFile, describe_missing_meshes
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.robot.compare.mjcf_only import NamedModel, mjcf_only_effects
from pupper_analysis.robot.matching.match import delete_ball_joints, drop_other_objects, mjcf_tree
from pupper_analysis.robot.matching.sources import MjcfSources, Sources, UrdfSources
from pupper_analysis.robot.matching.trees import (
    Reference,
    fix_other_joints,
    urdf_mimics,
    urdf_tree,
    with_null_efforts,
    without_shapes,
)
from pupper_analysis.tools.diff.elements import (
    ElementKey,
    ModelElement,
    list_collisions,
    list_elements,
)


@dataclass(frozen=True, eq=False)
class Version:
    """Content of a URDF or MJCF, prepared for the comparison with another version.

    Attributes:
        file: File.
        tree: Joints and bodies. The base of a URDF is free if `RobotModel.has_free_base`.
        extra_values: {(kind, element): value} outside the tree: mimic joints, motors, springs,
            tendons, joints that are held (``HELD_KIND``) ...
        elements: Collision shapes of a URDF (`list_collisions`), or elements of an MJCF
            (`list_elements`).
        bodies: {base or joint: name of the base body or of the moved body}.
        sources: Lines of the numbers.
        notes: Assumptions, and ignored content.
        inertials: {link of a URDF: stated inertial}, before fixed links are added to moving links.
            Empty for an MJCF.
    """

    file: UrdfFile | MjcfFile
    tree: MultibodyTree
    extra_values: Mapping[tuple[str, str], Any]
    elements: Mapping[ElementKey, ModelElement]
    bodies: Mapping[str, str]
    sources: Sources
    notes: tuple[Diagnostic, ...]
    inertials: Mapping[str, Inertial] = field(default_factory=dict)


def read_version(file: UrdfFile | MjcfFile) -> Version:
    """Read the joints, bodies and elements of a file, for comparison with another version.

    Raises:
        ModelError: If an MJCF has no joints, for example.
    """
    return _read_urdf_version(file) if isinstance(file, UrdfFile) else _read_mjcf_version(file)


def _read_urdf_version(file: UrdfFile) -> Version:
    """Return the content of a URDF for comparison with another version.

    Mimic joints are independent in the tree.
    """
    root = without_shapes(file.root)
    mimics = urdf_mimics(root)
    tree = UrdfTree(root)
    for joint in tree.joints.values():
        joint.remove("mimic")
    kinds = {name: joint.kind for name, joint in tree.joints.items()}
    meshes = dict.fromkeys(mesh.get("filename", "") for mesh in file.root.iter("mesh"))
    lost = describe_missing_meshes([mesh for mesh in meshes if file.resolve_mesh(mesh) is None])
    _, fixed, held = fix_other_joints(root)
    base, stated = tree.base.name, read_urdf_model(file)
    frames = [joint.child for joint in tree.joints.values() if joint.is_fixed]
    carriers = {base: base, **{joint.name: joint.child for joint in tree.moving}}
    return Version(
        file=file,
        tree=replace(urdf_tree(root, file.path, base, frames), floating=stated.has_free_base),
        extra_values={
            **{("mimic", name): list(value) for name, value in mimics.items()},
            **{(HELD_KIND, name): {"type": kinds[name]} for name in fixed},
        },
        elements=list_collisions(stated),
        bodies=carriers,
        sources=UrdfSources(file, UrdfTree(root), carriers, {}, {}, (base,)),
        notes=(*file.notes, *([] if lost is None else [lost]), *held),
        inertials={
            name: link.inertial for name, link in stated.links.items() if link.inertial is not None
        },
    )


def _read_mjcf_version(file: MjcfFile) -> Version:
    """Return the content of an MJCF for comparison with another version.

    In the tree, objects that do not belong to the robot are left out, and ball joints are fixed.

    Raises:
        ModelError: If the MJCF has no joints, for example.
    """
    published = file
    if file.spec.compiler.fusestatic:
        file = _disable_fusestatic(file)
    spec = file.spec.copy()
    named, joined = name_elements(spec, set()), join_free_base(spec)
    whole = compile_spec(spec.copy(), file.path)
    dropped = drop_other_objects(spec, file.path, None)
    _, balls, held = delete_ball_joints(spec, file.path)
    notes = [*file.notes, *named, *([joined] if joined else []), *dropped, *held]
    for key in list(spec.keys):
        spec.delete(key)  # the size of a keyframe may not fit after removals
    model = compile_spec(spec.copy(), file.path)
    moving = {int(body) for body in model.jnt_bodyid}
    frames = [model.body(body).name for body in range(1, model.nbody) if body not in moving]
    frames += [model.site(site).name for site in range(model.nsite) if model.site(site).name]
    names = [
        model.joint(joint).name
        for joint in range(model.njnt)
        if model.jnt_type[joint] != JointKind.FREE
    ]
    base = _find_tree_root(model, names)
    carriers = {name: model.body(int(model.joint(name).bodyid[0])).name for name in names}
    carriers = {base: base, **carriers}
    reference = Reference(whole if joined else file.model, whole, names, base)
    others: dict[tuple[str, str], Any] = {
        (extra.kind, extra.element): extra.mjcf
        for extra in mjcf_only_effects(reference)
        if extra.kind != "flag"  # flags are listed as elements
    }
    return Version(
        file=published,
        tree=with_null_efforts(mjcf_tree(model, base, frames), find_null_efforts(file)),
        extra_values={
            **others,
            **_collect_motor_values(NamedModel(reference)),
            **{(HELD_KIND, name): _collect_ball_values(whole, name) for name in balls},
        },
        elements=list_elements(file),
        bodies=carriers,
        sources=MjcfSources(file, model, carriers, {}, (base,)),
        notes=tuple(notes),
    )


HELD_KIND: Final = "joint"
"""Kind of the values of joints that the tree holds at rest: ball joints of an MJCF, floating and
planar joints of a URDF."""


def _collect_ball_values(model: mujoco.MjModel, name: str) -> dict[str, Any]:
    """Collect the type and the numbers other than 0 of a ball joint: {attribute: value}."""
    joint = model.joint(name)
    dof = int(joint.dofadr[0])
    numbers: dict[str, float | list[float]] = {
        "damping": float(model.dof_damping[dof]),
        "stiffness": float(joint.stiffness[0]),
        "armature": float(model.dof_armature[dof]),
        "frictionloss": float(model.dof_frictionloss[dof]),
        "range": float(joint.range[1]) if model.jnt_limited[joint.id] else 0.0,
        "pos": _to_numbers(joint.pos, trim=False),
    }
    return {"type": "ball", **{word: value for word, value in numbers.items() if np.any(value)}}


def _disable_fusestatic(file: MjcfFile) -> MjcfFile:
    """Return the MJCF compiled with ``fusestatic`` off, so that static bodies remain bodies."""
    file.check_compiled()
    spec = file.spec.copy()
    spec.compiler.fusestatic = False
    return replace(file, spec=spec, _model=compile_spec(spec.copy(), file.path))


def _find_tree_root(model: mujoco.MjModel, names: list[str]) -> str:
    """Return the root body of the tree of the first joint (``names``), or else of the last body."""
    body = int(model.joint(names[0]).bodyid[0]) if names else model.nbody - 1
    while model.body_parentid[body] != 0:
        body = int(model.body_parentid[body])
    return str(model.body(body).name)


FORCE_RANGES: Final = ("forcerange", "actuatorfrcrange")
"""Ranges of the force of an actuator, and of the torque at its joint, in the values of motors."""


def _collect_motor_values(scene: NamedModel) -> dict[tuple[str, str], Any]:
    """Collect transmission, gains and ranges of actuators: {("motor", name): values}.

    The ranges are those of commands (``ctrlrange``) and forces (`FORCE_RANGES`).
    """
    model, found = scene.model, {}
    for motor in range(model.nactuator):
        value: dict[str, Any] = {
            "at": _describe_target(scene, motor),
            "gear": _to_numbers(actuator_gear(model, motor)),
            "gain": _to_numbers(model.actuator_gainprm[motor]),
            "bias": _to_numbers(model.actuator_biasprm[motor]),
        }
        first = int(model.actuator_ctrladr[motor])
        for control in range(first, first + int(model.actuator_ctrlnum[motor])):
            if model.actuator_ctrllimited[control]:
                word = "ctrlrange" if control == first else f"ctrlrange {control - first + 1}"
                value[word] = _to_numbers(model.actuator_ctrlrange[control], trim=False)
        if model.actuator_forcelimited[motor]:
            value["forcerange"] = _to_numbers(model.actuator_forcerange[motor], trim=False)
        target, (joint, _) = list_actuator_targets(model, motor)
        if target == mujoco.mjtObj.mjOBJ_JOINT and model.jnt_actfrclimited[joint]:
            value["actuatorfrcrange"] = _to_numbers(model.jnt_actfrcrange[joint], trim=False)
        found["motor", scene.name("actuator", motor)] = value
    return found


def _describe_target(scene: NamedModel, motor: int) -> str:
    """Return type and name of the element on which an actuator acts, such as ``joint knee``."""
    what, (target, _) = list_actuator_targets(scene.model, motor)
    kind = what.name.removeprefix("mjOBJ_").lower()
    return f"{kind} {scene.joint_name(target) if kind == 'joint' else scene.name(kind, target)}"


def _to_numbers(values: Any, *, trim: bool = True) -> list[float]:
    """Convert numbers to a list; trailing zeros after the first number are removed if ``trim``."""
    numbers = np.asarray(values, dtype=float)
    length = max(1, np.trim_zeros(numbers, "b").size) if trim else numbers.size
    return [float(number) for number in numbers[:length]]


# Files in git: `REVISION:PATH`.

_T = TypeVar("_T")
"""Type of the result of a function that reads a file."""

_MODEL_SUFFIXES = (
    ".urdf",
    ".xacro",
    ".yaml",
    ".yml",
    ".xml",
    ".mjcf",
    ".stl",
    ".obj",
    ".msh",
    ".dae",
    ".ply",
    ".png",
    ".hfield",
)
"""Suffixes of files that a model may need. Other files of a revision are not extracted, except a
file that the user names."""


@dataclass(frozen=True)
class VersionedFile:
    """Version of a model as passed by the user: file, copy of a file in git, or object.

    Attributes:
        path: Path for reading, or robot in memory.
        name: Name passed by the user; may be empty for a robot in memory.
        revision: Revision; empty for a file outside git.
        root: Folder with the extracted revision; None for a file outside git.
    """

    path: Path | ModelObject | str
    name: str
    revision: str = ""
    root: Path | None = None

    def label(self, place: Place) -> str:
        """Format a place as ``file:line``, with the file name as typed (``REVISION:PATH``).

        Elements of a robot in memory have no line: the label is the name of the robot.
        """
        return self.name if is_object(self.path) else self._replace_paths(place.path)

    def read(self, read: Callable[[Path | ModelObject | str], _T]) -> _T:
        """Call ``read`` with the path of the file (or the copy from git), or the robot in memory.

        Raises:
            ModelError: If ``read`` raises a ModelError; the message names the file as the user
                passed the name.
        """
        try:
            return read(self.path)
        except ModelError as error:
            if self.root is None:
                raise
            cause = error.cause.with_names(self._replace_paths)
            raise ModelError(self._replace_paths(error.source), cause) from error

    def _replace_paths(self, text: str) -> str:
        """Replace the temporary folder in a text by the name of the revision."""
        if self.root is None:
            return text
        top = f"{self.revision}:"
        return text.replace(f"{self.root}/", top).replace(str(self.root), top)


@contextmanager
def open_version(given: str | Path | ModelObject) -> Iterator[VersionedFile]:
    """Open a version of a model in a ``with`` block; extract a file of a git revision.

    Args:
        given: Robot in memory, path, name of a published robot, ``package://NAME/FILE``, or
            ``REVISION:PATH`` as for ``git show``. PATH is relative to the top of the repository, or
            to the current folder if PATH begins with ``./`` or ``../``. Files that the model may
            include are extracted as well. A single character other than ``@`` is no REVISION, but a
            drive.

    Raises:
        ModelError: If git is not installed or does not contain the file, for example.
    """
    if is_object(given):
        yield VersionedFile(cast(ModelObject, given), "")
        return
    text = str(given)
    revision, separator, inside = text.partition(":")
    # An existing path takes precedence; "C:\\robot.urdf" is a path as well.
    if (
        path_exists(text)
        or is_published_name(text)
        or is_uri(text)
        or not separator
        or not inside
        or (len(revision) < 2 and revision != "@")
    ):
        yield VersionedFile(given, text)
        return
    if revision.startswith("-"):
        raise ModelError(text, diagnose("no-revision", revision=revision))
    relative = find_path_in_revision(text, revision, inside)
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder).resolve()
        write_revision(text, revision, root, (*_MODEL_SUFFIXES, relative.lower()))
        yield VersionedFile(root / relative, text, revision, root)


@contextmanager
def open_revision(revision: str, folder: Path) -> Iterator[Callable[[Path], Path]]:
    """Extract a git revision in a ``with`` block; yield {file: extracted copy} as a function.

    Args:
        revision: Revision.
        folder: Folder in the repository.

    Yields:
        Function that returns the path of the extracted copy of a file in the repository.

    Raises:
        ModelError: If git is not installed, or the repository does not contain the revision, for
            example.
    """
    if revision.startswith("-"):
        raise ModelError(revision, diagnose("no-revision", revision=revision))
    top = find_repository_top(folder)
    with tempfile.TemporaryDirectory() as copy:
        root = Path(copy).resolve()
        write_revision(revision, revision, root, _MODEL_SUFFIXES, folder)
        yield lambda path: root / os.path.relpath(path.resolve(), top.resolve())


# Files of a revision as committed, without running filters or hooks of the repository.


_SYMLINK_MODE = "120000"
"""Mode of a symbolic link in a git tree."""


def find_repository_top(folder: Path) -> Path:
    """Return the top folder of the repository of a folder.

    Raises:
        ModelError: If git is not installed, or the folder is in no repository; with git's message.
    """
    return Path(_git_text(str(folder), "rev-parse", "--show-toplevel", folder=folder).rstrip("\n"))


def find_path_in_revision(given: str, revision: str, inside: str) -> str:
    """Return the path of a file in a revision, relative to the top of the repository.

    Args:
        given: Argument of the user, ``REVISION:PATH``, which errors name.
        revision: Revision of git, such as ``HEAD``.
        inside: PATH in the revision, relative to the top of the repository. A path that begins with
            ``./`` or ``../`` is relative to the current folder.

    Raises:
        ModelError: If the revision does not contain the file, for example; with git's message.
    """
    prefix = _git_text(given, "rev-parse", "--show-prefix").strip()
    given_path = prefix + inside if inside.startswith(("./", "../")) else inside
    relative = posixpath.normpath(given_path).lstrip("/")
    _git_text(given, "cat-file", "-e", f"{revision}:{relative}")
    return relative


def write_revision(
    given: str, revision: str, root: Path, endings: tuple[str, ...], folder: Path | None = None
) -> None:
    """Write the files of a git revision with given suffixes to a folder.

    A file keeps its path relative to the root of the repository, and its committed content.
    Pointers of Git LFS are replaced by the files, if the repository has them.

    Args:
        given: Argument of the user, such as ``REVISION:PATH``, for error messages.
        revision: Revision of git.
        root: Empty folder, to which the files are written.
        endings: Suffixes, in lower case.
        folder: Folder in the repository; by default the current folder.

    Raises:
        ModelError: If git is not installed or does not contain the revision; with git's message.
    """
    listed = _git_answer(given, "ls-tree", "-r", "-z", "--full-tree", revision, folder=folder)
    kept = _git_text(
        given, "rev-parse", "--path-format=absolute", "--git-common-dir", folder=folder
    ).rstrip("\n")
    wanted = [
        entry
        for entry in git_entries(listed) or []
        if entry.path.lower().endswith(endings)
        and entry.mode != _SYMLINK_MODE
        and not _is_outside(entry.path)
    ]
    for entry, content in _read_git_objects(given, wanted, folder):
        place = root / entry.path
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(_resolve_lfs_pointer(content, Path(kept)))


def _is_outside(path: str) -> bool:
    """Return True if a path in a git tree would leave the folder: absolute, or with ``..``."""
    return path.startswith("/") or ".." in path.split("/")


def _resolve_lfs_pointer(content: bytes, kept: Path) -> bytes:
    """Replace a pointer of Git LFS by the real file's content, if found; keep other content.

    ``kept`` is the folder that contains ``lfs/objects``.
    """
    found = pointed_file(content)
    if found is None or not found.isalnum():
        return content
    try:
        return (kept / "lfs" / "objects" / found[:2] / found[2:4] / found).read_bytes()
    except OSError:
        return content


def _git_text(given: str, *arguments: str, folder: Path | None = None) -> str:
    """Run git as `_git_answer` does, and decode the output; invalid bytes become surrogates."""
    return _git_answer(given, *arguments, folder=folder).decode(errors="surrogateescape")


def _git_answer(given: str, *arguments: str, folder: Path | None = None) -> bytes:
    """Run git in a folder, by default the current folder, and return the standard output.

    ``given`` is the argument of the user, which errors name.

    Raises:
        ModelError: If git is not installed, or fails; with git's message.
    """
    result = run_git(_git_command(given, *arguments), folder)
    if result.returncode:
        reason = one_line(result.stderr.decode(errors="replace")).removeprefix("fatal: ")
        raise ModelError(given, diagnose("not-in-git", reason=reason))
    return result.stdout


def _git_command(given: str, *arguments: str) -> list[str]:
    """Return a command line of git, with options that disable programs of the repository.

    Raises:
        ModelError: If git is not installed.
    """
    git = shutil.which("git")
    if git is None:
        raise ModelError(given, diagnose("no-file-and-no-git"))
    return [git, *SAFE_OPTIONS, *arguments]


def _read_git_objects(
    given: str, entries: Sequence[GitEntry], folder: Path | None
) -> Iterator[tuple[GitEntry, bytes]]:
    """Yield files of a git tree: the entry, and the content of the file.

    Submodules and missing objects are skipped. ``given`` is the argument of the user, which errors
    name; ``folder`` is in the repository (None: the current folder).

    Raises:
        ModelError: If git is not installed.
    """
    command = _git_command(given, "cat-file", "--batch")
    with subprocess.Popen(
        command,
        cwd=folder,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=os.environ | SAFE_ENVIRONMENT,
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        for entry in entries:
            process.stdin.write(f"{entry.object}\n".encode())
            process.stdin.flush()
            _, kind, *size = process.stdout.readline().split()
            if kind == b"missing":  # a partial clone
                continue
            content = process.stdout.read(int(size[0]))
            process.stdout.read(1)
            if kind == b"blob":  # skips commits of submodules
                yield entry, content
