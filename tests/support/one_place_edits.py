"""Edits of one value in the MJCF of v3: contacts, floor, options, keyframe, joints and motors."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import NamedTuple

from tests.support.repository import ROOT

SHARED, SCENE, BODY = "pupper_v3_shared.xml", "pupper_v3.xml", "pupper_v3_body.xml"
"""Files of the MJCF of v3 in ``mjcf/``: what all scenes include, the scene, and the robot."""

_CONTACT = 'solimp="0.015 1 0.015"'
"""Text of the contact softness in the shared file."""

_FOOT = '"collision" type="sphere" size="0.01995"'
"""Text of a foot's collision geom."""


class Edit(NamedTuple):
    """Replacement of one text in a file of ``mjcf/``.

    Attributes:
        file: Name of the file in ``mjcf/``.
        old: Text before the edit.
        new: Text after the edit.
        line: Line of its first occurrence.
        urdf: Kind of the difference to the URDF; empty if a URDF cannot state the value.
    """

    file: str
    old: str
    new: str
    line: int
    urdf: str = ""

    def written(self, mjcf: Path) -> None:
        """Apply the edit to a copy of the folder ``mjcf/``."""
        text = (mjcf / self.file).read_text()
        assert self.old in text
        (mjcf / self.file).write_text(text.replace(self.old, self.new))


FELT = {
    "conaffinity": Edit(SHARED, 'conaffinity="1"', 'conaffinity="0"', 40, "collision"),
    "floor": Edit(SCENE, 'contype="1" conaffinity="1"', 'contype="0" conaffinity="0"', 6),
    "shape": Edit(BODY, _FOOT, _FOOT.replace("0.01995", "0.0399"), 23, "collision"),
    "margin": Edit(SHARED, _CONTACT, _CONTACT + ' margin="0.02"', 40),
    "solref": Edit(SHARED, _CONTACT, _CONTACT + ' solref="0.3 1"', 40),
    "solimp": Edit(SHARED, _CONTACT, 'solimp="0.9 0.95 0.001"', 40),
    "condim": Edit(SHARED, 'condim="6"', 'condim="1"', 35),
    "floor's friction": Edit(SCENE, 'condim="3"', 'condim="3" priority="1" friction="0.01"', 6),
    "timestep": Edit(SHARED, 'timestep="0.002"', 'timestep="0.01"', 5),
    "integrator": Edit(SHARED, "timestep=", 'integrator="RK4" timestep=', 5),
    "cone": Edit(SHARED, 'cone="elliptic"', 'cone="pyramidal"', 5),
    "impratio": Edit(SHARED, 'impratio="100"', 'impratio="1"', 5),
    "contacts off": Edit(
        SHARED, '-9.81"/>', '-9.81"><flag contact="disable"/></option>', 5, "collision"
    ),
    "keyframe's qpos": Edit(SCENE, 'qpos="0 0 0.28', 'qpos="0 0 0.6', 14),
    "keyframe's ctrl": Edit(SCENE, 'ctrl="0 0 0', 'ctrl="0 0 0.3', 14),
    "gain": Edit(SHARED, 'biasprm="0 -5', 'biasprm="0 -4', 49),
    "effort": Edit(SHARED, 'forcerange="-3 3"', 'forcerange="-0.1 0.1"', 33, "effort"),
    "armature": Edit(SHARED, 'armature="0.0016"', 'armature="0.016"', 34),
    "dry friction": Edit(SHARED, 'frictionloss="0.01"', 'frictionloss="0.1"', 34, "friction"),
    "damping": Edit(SHARED, 'damping="0.01"', 'damping="0.1"', 34, "damping"),
    "limits' margin": Edit(SHARED, 'damping="0.01"', 'damping="0.01" margin="3"', 34),
    "dry friction's softness": Edit(
        SHARED, 'damping="0.01"', 'damping="0.01" solreffriction="0.5 1"', 34
    ),
    "gravity": Edit(SHARED, "0 0 -9.81", "0 0 -3.7", 5, "gravity"),
}
"""{name: edit} whose effect is visible within two simulated seconds."""

HARMLESS = {
    "friction": Edit(SHARED, 'friction="0.8', 'friction="0.3', 40),  # the floor's is 1, the larger
    "gap": Edit(SHARED, _CONTACT, _CONTACT + ' gap="0.001"', 40),
    "limits' softness": Edit(SHARED, 'damping="0.01"', 'damping="0.01" solreflimit="0.3 1"', 34),
}
"""{name: edit} that does not change a simulation of v3 on its floor."""

FALLS = ("conaffinity", "floor", "contacts off")
"""Names of the edits after which v3 falls through the floor."""


def copy_mjcf(folder: Path) -> Path:
    """Copy the folder ``mjcf/`` into ``folder`` and return the copy."""
    place = folder / "mjcf"
    shutil.copytree(ROOT / "mjcf", place, ignore=shutil.ignore_patterns("*.md"))
    return place
