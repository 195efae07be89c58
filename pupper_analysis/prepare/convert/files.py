"""Specify a robot by its files and loading options, for scripts, command lines and studies.

`RobotFiles` stores the arguments of ``load_robot``: names of a URDF or an MJCF, and options.
`FileSource` provides the loaded robot to pages and studies. Pinocchio and MuJoCo are not imported
before a robot is loaded, so that ``--help`` is fast.
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

_MODEL_OPTIONS = ("urdf", "mjcf")
"""Options of ``load_robot`` whose value is a file name."""


@dataclass(frozen=True)
class RobotFiles:
    """Files and options of a robot: the arguments of ``load_robot``, to load it repeatedly.

    Attributes:
        models: Names of the files that are positional arguments of ``load_robot``.
        options: Keyword arguments of ``load_robot``.
    """

    models: tuple[str, ...]
    options: Mapping[str, Any]

    @staticmethod
    def from_arguments(*models: str, **options: Any) -> RobotFiles:
        """Create the specification of a robot from arguments of ``load_robot``.

        File names, also names of installed descriptions, become absolute paths.

        Args:
            *models: Names of a URDF, an MJCF, or both.
            **options: Keyword arguments of ``load_robot``. A ``urdf`` or ``mjcf`` of None counts as
                absent.

        Raises:
            ModelError: If an installed description is not found.
        """
        from pupper_analysis.models.published import find_file

        packages = options.get("packages") or {}
        folders = {name: Path(folder) for name, folder in packages.items()}

        def absolute(model: str) -> str:
            """Return the absolute path of a model file."""
            return str(find_file(model, folders).absolute())

        unset = [name for name in _MODEL_OPTIONS if options.get(name) is None]
        options = {name: value for name, value in options.items() if name not in unset}
        named = {name: absolute(options[name]) for name in _MODEL_OPTIONS if name in options}
        return RobotFiles(tuple(map(absolute, models)), {**options, **named})

    def __str__(self) -> str:
        names = (
            *self.models,
            *(self.options[name] for name in _MODEL_OPTIONS if name in self.options),
        )
        return "+".join(Path(model).name for model in names)

    def load(self, **more: Any) -> Robot:
        """Load the robot from the files, with the stored options.

        Args:
            **more: Further keyword arguments of ``load_robot``, which must not be in ``options``.

        Raises:
            ConfigurationError: If an option is invalid.
            ModelError: If no robot can be made of the files.
            UnknownNameError: If a foot, joint, keyframe or body does not exist.
        """
        from pupper_analysis.prepare.convert.load import load_robot

        return load_robot(*self.models, **self.options, **more)

    def to_dict(self) -> dict[str, Any]:
        """Return the specification as {option: value} for TOML or JSON.

        The keys ``models``, ``urdf`` and ``mjcf`` contain file names; the other keys are loading
        options.
        """
        return {**({"models": list(self.models)} if self.models else {}), **self.options}


@dataclass(frozen=True, eq=False)
class FileSource:
    """Loaded robot with its files and loading options, for pages and studies; can be pickled.

    Attributes:
        files: Files of the robot, with the options for loading.
        loaded: Robot that was loaded from the files.
    """

    files: RobotFiles
    loaded: Robot

    @property
    def scales(self) -> Mapping[str, float]:
        """Scale factors {dimension: factor [1]}; always empty: a robot of files is not scaled."""
        return {}

    def robot(self, scales: Mapping[str, float]) -> Robot:
        """Return the loaded robot; scale factors are refused, unlike for a generated robot.

        Args:
            scales: {dimension: factor}; must be empty, since a robot of files cannot be scaled.

        Raises:
            ConfigurationError: If ``scales`` is not empty.
        """
        if scales:
            name = next(iter(scales))
            raise ConfigurationError(name, diagnose("robot-not-scaled", robot=self.loaded.name))
        return self.loaded

    def to_dict(self) -> dict[str, Any]:
        """Return the specification of the robot for a study file (TOML): {option: value}.

        The keys ``models``, ``urdf`` and ``mjcf`` contain file names; the other keys are loading
        options.
        """
        return self.files.to_dict()
