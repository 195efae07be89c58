"""Reads a USD file (UsdPhysics): what may be opened, and where its prims are.

Nothing is fetched, and no plugin is asked for.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from pupper_analysis.base.arguments import check_type
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import InputError, MissingPackageError
from pupper_analysis.base.inputs import read_input
from pupper_analysis.base.runs import register_input
from pupper_analysis.models.places import (
    Place,
    make_file_error,
    make_input_error,
    one_line,
)
from pupper_analysis.models.xml import LFS_POINTER

MAX_BYTES: Final = 500_000_000
"""Largest layer that is opened: meshes are in it, as they are not in a URDF."""

MAX_DEPTH: Final = 500
"""Deepest nesting of a text layer; USD's own parser of it runs out of stack."""


@dataclass(frozen=True, eq=False)
class UsdFile:
    """A USD file that can be opened.

    Attributes:
        path: The file.
        stage: Its `pxr.Usd.Stage`, all payloads loaded.
        bodies: {name: path of the prim} of its rigid bodies. A name is the prim's, or the one it is
            shown by where a converter had to change that; of several alike, the path.
        joints: Likewise of its joints.
        notes: What was left out on reading.
    """

    path: Path
    stage: Any = field(repr=False)
    bodies: Mapping[str, str]
    joints: Mapping[str, str]
    notes: tuple[Diagnostic, ...] = ()

    def place(self, kind: str, name: str, child: str | None = None) -> Place:
        """Finds a prim.

        Args:
            kind: ``"joint"``, ``"actuator"`` (its joint's), or else a body.
            name: Its name.
            child: Is not looked at: a body's mass is stated in the body.

        Returns:
            The file and the prim; the file alone where there is none of that name.
        """
        del child
        joints = kind in ("joint", "actuator", "equality")
        first, second = (self.joints, self.bodies) if joints else (self.bodies, self.joints)
        return Place(self.path, None, first.get(name, second.get(name)))


class PrimPlaces:
    """The places of what stands for a USD in another format: its prims.

    Attributes:
        usd: The file.
    """

    usd: UsdFile | None

    def place(self, kind: str, name: str, child: str | None = None) -> Place:
        """Finds a prim; see `UsdFile.place`."""
        assert self.usd is not None
        return self.usd.place(kind, name, child)


def read_usd(path: str | Path) -> UsdFile:
    """Opens a USD file.

    Raises:
        ModelError: If it cannot be opened, or holds no rigid body.
        MissingPackageError: If usd-core is not installed.
    """
    check_type("usd", path, str | Path)
    path = Path(path)
    pxr = _library()
    _check_file(path)
    with _quietly(pxr) as said:
        try:
            stage = pxr.Usd.Stage.Open(str(path.absolute()), pxr.Usd.Stage.LoadAll)
            stage.Reload()  # a layer that was open already may be older than its file
            for layer in stage.GetUsedLayers():
                if Path(layer.realPath).is_file():  # the session's is none
                    register_input(Path(layer.realPath))
        except pxr.Tf.ErrorException as error:
            raise make_file_error(
                Place(path), diagnose("usd-not-valid", message=_words(error))
            ) from error
        missing = sorted({name for text in said() for name in _MISSING.findall(text)})
    notes = (diagnose("usd-files-missing", files=missing),) if missing else ()
    bodies, joints, motors = [], [], 0
    for prim in pxr.Usd.PrimRange(stage.GetPseudoRoot(), pxr.Usd.TraverseInstanceProxies()):
        if prim.HasAPI(pxr.UsdPhysics.RigidBodyAPI):
            if pxr.UsdPhysics.RigidBodyAPI(prim).GetRigidBodyEnabledAttr().Get() is not False:
                bodies.append(prim)
        elif prim.IsA(pxr.UsdPhysics.Joint):
            joints.append(prim)
        motors += prim.GetTypeName() == "MjcActuator"
    if not bodies:
        raise make_file_error(Place(path), diagnose("usd-without-bodies"))
    if motors:
        notes = (*notes, diagnose("usd-actuators-not-read", count=motors))
    return UsdFile(path, stage, _named(bodies), _named(joints), notes)


def _library() -> Any:
    """Returns the library; nothing of it is imported before a USD file is read.

    Raises:
        MissingPackageError: If it is not installed.
    """
    try:
        import pxr
        from pxr import Ar, Gf, Sdf, Tf, Usd, UsdGeom, UsdPhysics, UsdUtils  # noqa: F401
    except ImportError as error:
        raise MissingPackageError("usd-core", "usd") from error
    return pxr


def _check_file(path: Path) -> None:
    """Refuses what is no file, too large, empty, or a pointer of Git LFS."""
    try:
        data = read_input(path, MAX_BYTES)
    except InputError as error:
        raise make_input_error(path, error) from error
    if data.startswith(LFS_POINTER):
        raise make_file_error(Place(path), diagnose("model-is-lfs-pointer"))
    if not data[: len(LFS_POINTER)].strip():
        raise make_file_error(Place(path), diagnose("file-is-empty"))
    if data.startswith(b"#usda"):
        _check_depth(path, data)


def _check_depth(path: Path, text: bytes) -> None:
    """Refuses a text layer whose brackets are nested too deep; those in strings do not count."""
    depth = 0
    for bracket in _BRACKETS.findall(text):
        depth += {b"{": 1, b"(": 1, b"[": 1, b"}": -1, b")": -1, b"]": -1}.get(bracket, 0)
        if depth > MAX_DEPTH:
            raise make_file_error(Place(path), diagnose("nested-too-deep", most=MAX_DEPTH))


def _named(prims: list[Any]) -> dict[str, str]:
    """Names prims: by what they are called; several alike by their paths."""
    called = [(prim.GetDisplayName() or prim.GetName(), str(prim.GetPath())) for prim in prims]
    counts = Counter(name for name, _ in called)
    return {name if counts[name] == 1 else path.strip("/"): path for name, path in called}


@contextmanager
def _quietly(pxr: Any) -> Iterator[Any]:
    """Keeps USD from writing its warnings to the terminal; yields what returns them."""
    delegate = pxr.UsdUtils.CoalescingDiagnosticDelegate()
    try:
        yield lambda: [one.commentary for one in delegate.TakeUncoalescedDiagnostics()]
    finally:
        delegate.TakeUncoalescedDiagnostics()


def _words(error: Any) -> str:
    """Returns what USD says of a file, without where in its own sources it says so."""
    said = [one_line(getattr(one, "commentary", one)) for one in error.args]
    return said[0] if said else one_line(error)


_MISSING: Final = re.compile(r"Could not open asset @([^@]*)@")
_BRACKETS: Final = re.compile(rb'"(?:[^"\\\n]|\\.)*"|[][{}()]')
