"""Where the robots of a study come from."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from pupper_analysis.convert.load import load_robot
from pupper_analysis.diagnostics import diagnose
from pupper_analysis.errors import ConfigurationError
from pupper_analysis.models.description import Description
from pupper_analysis.models.loading import read_model
from pupper_analysis.models.published import find_file
from pupper_analysis.models.spec_state import state_of
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.robot.build import rebuild_robot
from pupper_analysis.robot.robot import Robot
from pupper_analysis.study.parameters import without_visuals


class RobotSource(Protocol):
    """Makes robots, here and in other processes: it can be pickled.

    Attributes:
        scales: {name of a scale that it takes: the base robot's}.
    """

    @property
    def scales(self) -> Mapping[str, float]:
        """{name of a scale that it takes: the base robot's}."""

    def robot(self, scales: Mapping[str, float]) -> Robot:
        """Makes the robot of some scales; where not given, they are the base robot's.

        Raises:
            PupperAnalysisError: If there is none.
        """

    def asked(self) -> Any:
        """Returns how a study's file says it, as plain data."""


@dataclass(frozen=True, eq=False)
class ModelFiles:
    """The robot of a URDF, an MJCF or both.

    Attributes:
        options: What ``load_robot`` was given.
        loaded: The robot, without what is only looked at.
    """

    options: Mapping[str, Any]
    loaded: Robot

    @staticmethod
    def of(options: Mapping[str, Any]) -> ModelFiles:
        """Loads it.

        Args:
            options: What ``load_robot`` is given: ``urdf``, ``mjcf`` or both, ``feet`` ...

        Raises:
            ConfigurationError: If an option is not ``load_robot``'s, or the robot cannot stand.
            ModelError: As ``load_robot``.
        """
        known = ("urdf", "mjcf", "take", "body", "feet", "name", "joints", "keyframe", "packages")
        unknown = [name for name in options if name not in known]
        paths = {
            name: str(find_file(options[name]).absolute())
            for name in ("urdf", "mjcf")
            if name in options
        }
        if unknown or not paths:
            problem = diagnose("no-files-of-a-robot", given=repr(dict(options)), known=known[2:])
            raise ConfigurationError("robot", problem)
        robot = load_robot(**options)
        if not robot.floating or not robot.contact_points:
            raise ConfigurationError("robot", diagnose("no-feet-to-stand-on", robot=robot.name))
        bare = rebuild_robot(robot, mjcf=without_visuals(robot.description).mjcf)
        return ModelFiles({**options, **paths}, bare)

    @staticmethod
    def of_files(models: Sequence[str]) -> ModelFiles:
        """Loads the robot of a file, or of a URDF and an MJCF.

        Raises:
            ConfigurationError: If the robot cannot stand, or the files are no one robot's.
            ModelError: As ``load_robot``.
        """
        kinds = ["urdf" if isinstance(read_model(one), UrdfFile) else "mjcf" for one in models]
        if len(set(kinds)) < len(kinds):
            raise ConfigurationError("robot", diagnose("not-one-robots-files", files=list(models)))
        return ModelFiles.of(dict(zip(kinds, models, strict=True)))

    @property
    def scales(self) -> Mapping[str, float]:
        """It has none."""
        return {}

    def robot(self, scales: Mapping[str, float]) -> Robot:
        """Returns the robot."""
        assert not scales
        return self.loaded

    def asked(self) -> dict[str, Any]:
        """Returns what ``load_robot`` was given."""
        return dict(self.options)


def digest_of(description: Description) -> str:
    """Returns a hash of all that a description says: the same files have the same hash."""
    parts = {
        "urdf": description.urdf,
        "mjcf": state_of(description.mjcf),
        "feet": dict(description.contact_points),
        "soles": dict(description.feet),
        "geoms": dict(description.foot_geoms),
        "nominal": dict(description.nominal),
    }
    digest = hashlib.sha256()
    _feed(digest, parts)
    return digest.hexdigest()


def _feed(digest: Any, value: Any) -> None:
    """Feeds a value to a hash, with where it begins and ends; folders are left out."""
    if isinstance(value, Mapping):
        for key in sorted(value, key=str):
            if key != "folder":
                digest.update(f"{{{key}:".encode())
                _feed(digest, value[key])
    elif isinstance(value, list | tuple):
        digest.update(f"[{len(value)}:".encode())
        for element in value:
            _feed(digest, element)
    elif isinstance(value, np.ndarray):
        digest.update(f"a{value.shape}".encode() + np.ascontiguousarray(value).tobytes())
    elif isinstance(value, bytes):
        digest.update(f"b{len(value)}:".encode() + value)
    else:
        text = repr(value).encode()
        digest.update(f"t{len(text)}:".encode() + text)
