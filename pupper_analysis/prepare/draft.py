"""A robot in the making: what was asked for, and what has been made of the two files so far."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import mujoco

from pupper_analysis.matching.match import Match
from pupper_analysis.models.description import Description
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.prepare.ready import ready_robot
from pupper_analysis.prepare.request import Request
from pupper_analysis.robot.robot import Robot


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
        ready: The robot of both files as they are, if they are ready: then no pass applies.
        built: The robot; from the pass ``build`` on.
    """

    urdf: UrdfFile
    mjcf: MjcfFile
    request: Request
    spec: mujoco.MjSpec
    keyframes: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    found: Match | None = None
    description: Description | None = None
    ready: Robot | None = None
    built: Robot | None = None

    @classmethod
    def of(cls, urdf: UrdfFile, mjcf: MjcfFile, request: Request) -> Draft:
        """Begins with two files.

        Raises:
            ModelError: If they are ready, and make no robot.
        """
        return cls(urdf, mjcf, request, mjcf.spec, ready=ready_robot(urdf, mjcf, request))

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
        made = self.built or self.ready
        assert made is not None
        return made
