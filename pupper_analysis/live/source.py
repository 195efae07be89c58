"""Which robot a page is about, and how a script or a command line names it."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from pupper_analysis.convert.load import load_robot
from pupper_analysis.diagnostics import diagnose
from pupper_analysis.errors import ConfigurationError
from pupper_analysis.models.published import find_file
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


@dataclass(frozen=True, eq=False)
class LoadedFiles:
    """The robot of a URDF, an MJCF or both.

    Attributes:
        models: Paths of its files, absolute.
        options: What else ``load_robot`` was given.
        loaded: The robot.
    """

    models: tuple[str, ...]
    options: Mapping[str, Any]
    loaded: Robot

    @staticmethod
    def of(*models: str, **options: Any) -> LoadedFiles:
        """Loads it.

        Args:
            *models: Its files.
            **options: What else ``load_robot`` is given.

        Raises:
            ConfigurationError: If its base is free, and it has no feet.
            ModelError: As ``load_robot``.
        """
        robot = load_robot(*models, **options)
        if robot.floating and not robot.contact_points:
            raise ConfigurationError("robot", diagnose("robot-without-feet", robot=robot.name))
        paths = tuple(str(find_file(model).absolute()) for model in models)
        return LoadedFiles(paths, options, robot)

    @property
    def scales(self) -> Mapping[str, float]:
        """It has none."""
        return {}

    def robot(self, scales: Mapping[str, float]) -> Robot:
        """Returns the robot.

        Raises:
            ConfigurationError: If it is to be scaled.
        """
        if scales:
            name = next(iter(scales))
            raise ConfigurationError(name, diagnose("robot-not-scaled", robot=self.loaded.name))
        return self.loaded

    def python(self, scales: Mapping[str, float]) -> str:  # noqa: ARG002 - it has none
        """Returns the call of ``load_robot``."""
        given = [*map(repr, self.models)]
        given += [f"{name}={value!r}" for name, value in self.options.items()]
        return f"pa.load_robot({', '.join(given)})"

    def arguments(self, scales: Mapping[str, float]) -> list[str]:  # noqa: ARG002 - it has none
        """Returns the words and options that the command line takes."""
        words = [*self.models]
        for foot, frame in self.options.get("feet", {}).items():
            words += ["--foot", f"{foot}={frame if isinstance(frame, str) else ':'.join(frame)}"]
        for one, other in self.options.get("joints", {}).items():
            words += ["--map", f"{one}={other}"]
        for package, folder in self.options.get("packages", {}).items():
            words += ["--package", f"{package}={folder}"]
        for name in ("keyframe", "take", "body"):
            if name in self.options:
                words += [f"--{name}", self.options[name]]
        return words


def quote_words(words: list[str]) -> str:
    """Returns words as one types them."""
    return shlex.join(words)
