"""Where the robots of a study come from."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.models.description import Description
from pupper_analysis.models.spec_state import state_of
from pupper_analysis.prepare.convert.files import FileSource, RobotFiles
from pupper_analysis.robot.build import rebuild_robot
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.study.parameters import without_visuals


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


_KNOWN = ("take", "body", "feet", "name", "joints", "keyframe", "packages")
"""What a study may say of files, besides the files."""


def load_source(given: Mapping[str, Any]) -> FileSource:
    """Loads the robot of a study, without what is only looked at.

    Args:
        given: {``urdf``, ``mjcf`` or both, or ``models``: its files; and other arguments of
            ``load_robot``}.

    Raises:
        ConfigurationError: If an option is not ``load_robot``'s, or the robot cannot stand.
        ModelError: As ``load_robot``.
    """
    options = dict(given)
    models = options.pop("models", ())
    unknown = [name for name in options if name not in (*_KNOWN, "urdf", "mjcf")]
    if unknown or not (models or "urdf" in options or "mjcf" in options):
        problem = diagnose("no-files-of-a-robot", given=repr(dict(given)), known=_KNOWN)
        raise ConfigurationError("robot", problem)
    files = RobotFiles.of(*models, **options)
    robot = files.load()
    if not robot.floating or not robot.contact_points:
        raise ConfigurationError("robot", diagnose("no-feet-to-stand-on", robot=robot.name))
    bare = rebuild_robot(robot, mjcf=without_visuals(robot.description).mjcf)
    return FileSource(files, bare)


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
