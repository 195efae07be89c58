"""A robot in the making: what was asked for, and what has been made of the two files so far."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import mujoco

from pupper_analysis.base.diagnostics import Diagnostic, Term
from pupper_analysis.base.errors import ModelError
from pupper_analysis.base.results import Result
from pupper_analysis.models.description import Description
from pupper_analysis.models.mjcf import has_free_joint
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.prepare.ready import Request, ready_robot
from pupper_analysis.robot.matching.match import Match
from pupper_analysis.robot.robot import Robot

_FREE_IN_PARTS = 4
"""Joints of a base that is free by three slides and a ball joint, or more."""


@dataclass(frozen=True)
class PassRun(Result):
    """A pass that was run.

    Attributes:
        name: What it is called.
        does: What it does, in words.
        done: What it had to do, or found; empty where the files needed nothing.
    """

    name: str
    does: Term
    done: tuple[Diagnostic, ...]


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
        refused: Why no robot with a free base can be made: then only ``hold-base`` applies.
        runs: The passes that were run.
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
    refused: ModelError | None = None
    runs: tuple[PassRun, ...] = ()

    @classmethod
    def of(cls, urdf: UrdfFile, mjcf: MjcfFile, request: Request) -> Draft:
        """Begins with two files.

        Raises:
            ModelError: If they are ready, and make no robot.
        """
        return cls(urdf, mjcf, request, mjcf.spec, ready=ready_robot(urdf, mjcf, request))

    @property
    def may_be_held(self) -> bool:
        """Whether its base may be fixed, as the file has it, though it was to be free."""
        if self.request.fixed_base or has_free_joint(self.mjcf.spec):
            return False
        tops = (len(list(body.joints)) for body in self.mjcf.spec.worldbody.bodies)
        return max(tops, default=0) < _FREE_IN_PARTS

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
