"""The two model files of a robot, as text and spec."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import mujoco


@dataclass(frozen=True, eq=False)
class Description:
    """A robot's URDF and MJCF.

    Attributes:
        name: The robot's name.
        urdf: The URDF's text.
        urdf_source: The file it came from.
        mjcf: The MJCF's spec, not to be changed (take ``mjcf.copy()``).
        mjcf_source: The file it came from.
        feet: For each foot, the URDF's link and the MJCF's site, body or geom.
        frames: Likewise for further frames that both files have.
    """

    name: str
    urdf: str
    urdf_source: Path
    mjcf: mujoco.MjSpec
    mjcf_source: Path
    feet: Mapping[str, tuple[str, str]]
    frames: Mapping[str, tuple[str, str]] = field(default_factory=dict)
