"""Write the recommended gains of a study into copies of the robot's files."""

from __future__ import annotations

from pathlib import Path

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.files import write_all
from pupper_analysis.robot.compare.differences import PropertyKey
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.gains.gains import GainStudy
from pupper_analysis.tools.sync.numbers import WrittenNumbers, write_numbers

_NUM_DIGITS = 3
"""Number of significant digits of the written gains. More digits have no meaning, since the bounds
of the gains are known to 0.5 %.
"""


def write_gains(
    study: GainStudy,
    robot: Robot,
    folder: Path,
    *,
    files: tuple[Path | None, Path | None] | None = None,
) -> WrittenNumbers:
    """Write the recommended kp and kd of each joint into copies of the robot's files.

    ``files`` are the URDF and MJCF to copy, if different from the files of the robot.

    Raises:
        ConfigurationError: If the study has no recommendation.
        ModelError: If a gain cannot be written, for example because the MJCF has no position servo
            at a joint.
        OutputError: If a file cannot be written.
    """
    numbers: dict[PropertyKey, float] = {}
    for joint_class in study.classes:
        if joint_class.recommended_kp is None or joint_class.recommended_kd is None:
            raise ConfigurationError("write", diagnose("no-recommended-gains"))
        for joint in joint_class.joints:
            numbers["kp", joint] = float(f"{joint_class.recommended_kp:.{_NUM_DIGITS}g}")
            numbers["kd", joint] = float(f"{joint_class.recommended_kd:.{_NUM_DIGITS}g}")
    written = write_numbers(robot, numbers, files=files)
    write_all(written.make_writings(folder))
    return written
