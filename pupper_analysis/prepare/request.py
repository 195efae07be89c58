"""What is asked for when a robot is loaded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, eq=False)
class Request:
    """What is asked for when a robot is loaded.

    Attributes:
        feet: {foot: its frames in URDF and MJCF}; None: they are looked for.
        fixed_base: Whether the base is fixed in the world.
        name: The robot's name; None: the MJCF's.
        joints: {joint in the URDF: joint in the MJCF}.
        keyframe: The MJCF's keyframe to start from; None: the first in which the robot stands.
        as_is: Whether no servos are added, and no shapes altered.
    """

    feet: Mapping[str, tuple[str, str]] | None = None
    fixed_base: bool = False
    name: str | None = None
    joints: Mapping[str, str] | None = None
    keyframe: str | None = None
    as_is: bool = False
