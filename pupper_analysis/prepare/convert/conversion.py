"""What became of a conversion."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.prepare.convert.repair import Repair


@dataclass(frozen=True)
class ConversionDraft:
    """A new model file that is not written yet.

    Attributes:
        text: Its XML, for the folder it is meant for.
        meshes: {file to be written beside it: its content}.
        notes: What was added, or assumed.
        not_converted: What the new format cannot say, or what was left out.
        repairs: Inertials that were repaired.
        urdf: The URDF with them, if the draft is of one: what the new file is proven against.
        stands: Whether it is a robot that shall stand.
        failure: Why it does not, if that is known already.
        lost: What it cannot do without, and lacks.
        on_balls: The joints whose feet touch with balls in the place of their meshes, as is
            reported.
    """

    text: str
    meshes: dict[Path, bytes]
    notes: tuple[Diagnostic, ...]
    not_converted: tuple[Diagnostic, ...]
    repairs: tuple[Repair, ...] = ()
    urdf: UrdfFile | None = None
    stands: bool = False
    failure: Diagnostic | None = None
    lost: tuple[Diagnostic, ...] = ()
    on_balls: frozenset[str] = frozenset()
