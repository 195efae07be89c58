"""A robot in the making: what was asked for, and what has been made of the two files so far."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import mujoco

from pupper_analysis.matching.match import Match
from pupper_analysis.models.description import Description
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.robot.robot import Robot


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


@dataclass(frozen=True, eq=False)
class Draft:
    """A robot as far as it is made.

    Attributes:
        urdf: As it was read.
        mjcf: As it was read.
        request: What is asked for.
        spec: The MJCF's, changed.
        keyframes: {name: {joint: position}} of the MJCF's that may be started from.
        found: Whose joint is whose; from the pass ``match`` on.
        description: Both files made alike; from the pass ``match`` on.
        built: The robot; from the pass ``build`` on.
    """

    urdf: UrdfFile
    mjcf: MjcfFile
    request: Request
    spec: mujoco.MjSpec
    keyframes: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    found: Match | None = None
    description: Description | None = None
    built: Robot | None = None

    @property
    def match(self) -> Match:
        """Whose joint is whose."""
        assert self.found is not None
        return self.found

    @property
    def described(self) -> Description:
        """Both files, made alike."""
        assert self.description is not None
        return self.description

    @property
    def robot(self) -> Robot:
        """The robot."""
        assert self.built is not None
        return self.built
