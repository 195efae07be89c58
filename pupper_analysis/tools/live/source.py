"""Which robot a page is about, and how a script or a command line names it."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from typing import Protocol

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.prepare.convert.files import FileSource, RobotFiles
from pupper_analysis.robot.robot import Robot


class LiveSource(Protocol):
    """Makes robots, and says how others make them.

    Attributes:
        scales: {name of a scale that it takes: the base robot's}; none for a robot of two files.
    """

    @property
    def scales(self) -> Mapping[str, float]:
        """{name of a scale that it takes: the base robot's}."""

    def robot(self, scales: Mapping[str, float]) -> Robot:
        """Makes the robot of some scales; where not given, they are the base robot's.

        Raises:
            PupperAnalysisError: If there is none.
        """

    def python(self, scales: Mapping[str, float]) -> str:
        """Returns the Python expression that makes it, with ``pa`` for the package."""

    def arguments(self, scales: Mapping[str, float]) -> list[str]:
        """Returns the arguments of a command that name it."""


def load_source(files: RobotFiles) -> FileSource:
    """Loads the robot of a page.

    Raises:
        ConfigurationError: If its base is free, and it has no feet.
        ModelError: As ``load_robot``.
    """
    robot = files.load()
    if robot.floating and not robot.contact_points:
        raise ConfigurationError("robot", diagnose("robot-without-feet", robot=robot.name))
    return FileSource(files, robot)


def quote_words(words: list[str]) -> str:
    """Returns words as one types them."""
    return shlex.join(words)
