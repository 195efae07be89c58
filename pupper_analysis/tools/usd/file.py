"""USD file (UsdPhysics): checks before opening, and the prims of bodies and joints.

References are resolved by USD's asset resolver; the default resolver reads local files only.
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
from pupper_analysis.tools.usd.prim_limits import check_prim_count

MAX_BYTES: Final = 500_000_000
"""Upper bound of the size of the opened USD file [bytes]; referenced files are not counted. Chosen,
not tuned.
"""

MAX_DEPTH: Final = 500
"""Upper bound of the nesting depth of brackets in a text file (``#usda``). A deeper file can
overflow the stack of USD's parser, and is refused. Chosen, not tuned.
"""


@dataclass(frozen=True, eq=False)
class UsdFile:
    """Opened USD file: stage, and prims of bodies and joints by name.

    Attributes:
        path: File.
        stage: `pxr.Usd.Stage`, with all payloads loaded.
        bodies: {name: prim path} of the enabled rigid bodies. The name is the prim's display name
            or, without a display name, the prim name. If several bodies share a name, the key is
            the path without the leading slash.
        joints: {name: prim path} of the joints. Names are formed as for ``bodies``.
        notes: Notes on parts that were not read.
    """

    path: Path
    stage: Any = field(repr=False)
    bodies: Mapping[str, str]
    joints: Mapping[str, str]
    notes: tuple[Diagnostic, ...] = ()

    def place(self, kind: str, name: str, child: str | None = None) -> Place:
        """Return the place (file and prim) of a joint or body of this USD file.

        Args:
            kind: ``"joint"``, ``"actuator"`` or ``"equality"`` for a joint; otherwise a body.
            name: Name of the joint or body.
            child: Name of a child element, as for URDF and MJCF files. Ignored, since the prim of a
                body itself states the mass.

        Returns:
            File and prim; the file without a prim if neither a body nor a joint has the name.
        """
        del child
        joints = kind in ("joint", "actuator", "equality")
        own_paths, other_paths = (
            (self.joints, self.bodies) if joints else (self.bodies, self.joints)
        )
        return Place(self.path, None, own_paths.get(name, other_paths.get(name)))


class PrimPlaces:
    """Base class of models generated from a USD file, which are located by the prims of that file.

    Attributes:
        usd: USD file.
    """

    usd: UsdFile | None

    def place(self, kind: str, name: str, child: str | None = None) -> Place:
        """Return the place of the USD prim from which an element was generated.

        Args:
            kind: Kind of the element, such as link or joint.
            name: Name of the element.
            child: Name of a child element, as for URDF and MJCF files. Ignored, since the prim of a
                body itself states the mass.
        """
        assert self.usd is not None
        return self.usd.place(kind, name, child)


def read_usd(path: str | Path) -> UsdFile:
    """Open a USD file, and find the prims of bodies and joints.

    Raises:
        ModelError: If the file is not valid, too large, or has no rigid body, for example.
        MissingPackageError: If usd-core is not installed.
    """
    check_type("usd", path, str | Path)
    path = Path(path)
    pxr = _import_pxr()
    _check_file(path)
    with _capture_warnings(pxr) as get_warnings:
        try:
            reason = check_prim_count(path)
            if reason is not None:
                raise make_file_error(Place(path), reason)
            stage = pxr.Usd.Stage.Open(str(path.absolute()), pxr.Usd.Stage.LoadAll)
            stage.Reload()  # USD caches layers of earlier reads
            for layer in stage.GetUsedLayers():
                if Path(layer.realPath).is_file():  # the session layer has no file
                    register_input(Path(layer.realPath))
        except pxr.Tf.ErrorException as error:
            raise make_file_error(
                Place(path), diagnose("usd-not-valid", message=_format_error(error))
            ) from error
        missing = sorted({name for text in get_warnings() for name in _MISSING_ASSET.findall(text)})
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
    return UsdFile(path, stage, _name_prims(bodies), _name_prims(joints), notes)


def _import_pxr() -> Any:
    """Import the USD library, which is slow, when a file is read.

    Raises:
        MissingPackageError: If usd-core is not installed.
    """
    try:
        import pxr
        from pxr import Ar, Gf, Sdf, Tf, Usd, UsdGeom, UsdPhysics, UsdUtils  # noqa: F401
    except ImportError as error:
        raise MissingPackageError("usd-core", "usd") from error
    return pxr


def _check_file(path: Path) -> None:
    """Check a file before USD opens the file: size, content, and depth of brackets.

    Raises:
        ModelError: If the file cannot be read, is empty or too large, for example.
    """
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
    """Check that the brackets of a USD text file are nested at most `MAX_DEPTH` deep.

    Brackets in strings with double quotes in a single line are ignored.

    Raises:
        ModelError: If the brackets are nested deeper.
    """
    depth = 0
    for bracket in _BRACKET_PATTERN.findall(text):
        depth += {b"{": 1, b"(": 1, b"[": 1, b"}": -1, b")": -1, b"]": -1}.get(bracket, 0)
        if depth > MAX_DEPTH:
            raise make_file_error(Place(path), diagnose("nested-too-deep", most=MAX_DEPTH))


def _name_prims(prims: list[Any]) -> dict[str, str]:
    """Return {name: path} of prims; the key is the path if the name is not unique."""
    names_and_paths = [
        (prim.GetDisplayName() or prim.GetName(), str(prim.GetPath())) for prim in prims
    ]
    counts = Counter(name for name, _ in names_and_paths)
    return {name if counts[name] == 1 else path.strip("/"): path for name, path in names_and_paths}


@contextmanager
def _capture_warnings(pxr: Any) -> Iterator[Any]:
    """Capture USD's warnings; yield a function that returns the texts of new warnings as a list."""
    delegate = pxr.UsdUtils.CoalescingDiagnosticDelegate()
    try:
        yield lambda: [warning.commentary for warning in delegate.TakeUncoalescedDiagnostics()]
    finally:
        delegate.TakeUncoalescedDiagnostics()


def _format_error(error: Any) -> str:
    """Return the first message of a USD error, without source locations."""
    messages = [one_line(getattr(argument, "commentary", argument)) for argument in error.args]
    return messages[0] if messages else one_line(error)


_MISSING_ASSET: Final = re.compile(r"Could not open asset @([^@]*)@")
"""Pattern of USD's warning about a missing file."""
_BRACKET_PATTERN: Final = re.compile(rb'"(?:[^"\\\n]|\\.)*"|[][{}()]')
"""Pattern of brackets, and of strings with double quotes in a single line, in a text layer."""
