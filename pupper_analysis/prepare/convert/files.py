"""A robot that is given by files: how it is loaded, and how scripts and command lines say it.

It loads no engine before it loads a robot, so that ``--help`` need not wait for one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError

if TYPE_CHECKING:
    from pupper_analysis.robot.robot import Robot

_NAMED = ("urdf", "mjcf")
"""Files that options may name instead, by their format."""


@dataclass(frozen=True)
class RobotFiles:
    """A robot that is given by files.

    Attributes:
        models: Their names: one, or a URDF's and an MJCF's.
        options: What else ``load_robot`` is given.
    """

    models: tuple[str, ...]
    options: Mapping[str, Any]

    @staticmethod
    def of(*models: str, **options: Any) -> RobotFiles:
        """Returns what ``load_robot`` is given, with absolute paths.

        Raises:
            ModelError: If a description is not installed, or not there.
        """
        from pupper_analysis.models.published import find_file

        def absolute(model: str) -> str:
            return str(find_file(model).absolute())

        named = {name: absolute(options[name]) for name in _NAMED if name in options}
        return RobotFiles(tuple(map(absolute, models)), {**options, **named})

    def __str__(self) -> str:
        names = (*self.models, *(self.options[name] for name in _NAMED if name in self.options))
        return "+".join(Path(model).name for model in names)

    def load(self, **more: Any) -> Robot:
        """Loads the robot.

        Args:
            **more: What else ``load_robot`` is given.

        Raises:
            ConfigurationError: As ``load_robot``.
            ModelError: As ``load_robot``.
        """
        from pupper_analysis.prepare.convert.load import load_robot

        return load_robot(*self.models, **self.options, **more)

    def plain(self) -> dict[str, Any]:
        """Returns it as plain data, as a study's file has it."""
        return {**({"models": list(self.models)} if self.models else {}), **self.options}


@dataclass(frozen=True, eq=False)
class FileSource:
    """The robot of files, for pages and studies: it can be pickled, and has no scales.

    Attributes:
        files: How it is given.
        loaded: The robot.
    """

    files: RobotFiles
    loaded: Robot

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

    def asked(self) -> dict[str, Any]:
        """Returns how a study's file says it, as plain data."""
        return self.files.plain()
