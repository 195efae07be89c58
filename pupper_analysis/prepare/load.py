"""Makes a robot of its two files, as they are, or made ready in memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.prepare.draft import PassRun
from pupper_analysis.prepare.passes import run_passes
from pupper_analysis.prepare.ready import Request
from pupper_analysis.prepare.simulable import check_simulable
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]

Feet = Sequence[str] | Mapping[str, str | tuple[str, str]]


def robot_of(
    urdf: UrdfFile,
    mjcf: MjcfFile,
    *,
    feet: Feet | None = None,
    fixed_base: bool = False,
    name: str | None = None,
    joints: Mapping[str, str] | None = None,
    keyframe: str | None = None,
    as_is: bool = False,
) -> Robot:
    """Makes a robot of two files that have been read, as they are, or made ready in memory.

    What its arguments mean says ``load_robot``, which reads the files.
    """
    frames = None if feet is None else feet_frames(feet)
    request = Request(frames, fixed_base, name, joints, keyframe, as_is)
    robot, _ = prepare_robot(urdf, mjcf, request)
    return robot


def prepare_robot(urdf: UrdfFile, mjcf: MjcfFile, request: Request) -> tuple[Robot, list[PassRun]]:
    """Makes two files a robot; returns the passes that were run, too: none if they are ready.

    Raises:
        ModelError: If no robot can be made of them.
        UnknownNameError: If a foot, joint or keyframe is not there.
    """
    check_simulable(mjcf)
    return run_passes(urdf, mjcf, request)


def feet_frames(feet: Feet) -> dict[str, tuple[str, str]]:
    """Returns {foot: its frames in URDF and MJCF}.

    Raises:
        ConfigurationError: If a frame is neither a name nor a pair of names, or named twice.
    """
    named = dict(feet) if isinstance(feet, Mapping) else {foot: foot for foot in feet}
    if len(named) < len(feet):
        raise ConfigurationError("feet", diagnose("feet-named-twice", feet=map(str, feet)))
    frames = {}
    for foot, frame in named.items():
        pair = (frame, frame) if isinstance(frame, str) else tuple(np.atleast_1d(frame).tolist())
        if len(pair) != 2 or not all(isinstance(name, str) for name in pair):
            problem = diagnose("foot-frame-not-valid", subject=("foot", foot), frame=repr(frame))
            raise ConfigurationError("feet", problem)
        frames[foot] = (str(pair[0]), str(pair[1]))
    return frames
