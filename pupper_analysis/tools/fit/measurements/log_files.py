"""Files of logs: CSV, npz, MCAP and ROS bags."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, InputError, MeasurementError
from pupper_analysis.base.files import reason_of
from pupper_analysis.base.inputs import check_input
from pupper_analysis.tools.fit.measurements.bags import MOST_FILE, is_bag, read_bag
from pupper_analysis.tools.fit.measurements.columns import Column, read_columns
from pupper_analysis.tools.fit.measurements.log import Log, make_log

COLUMNS = (
    Column("time", "time"),
    Column("command.*", "position"),
    Column("position.*", "position"),
    Column("velocity.*", "velocity"),
    Column("torque.*", "torque"),
)
"""What may stand in a log."""


@check_arguments
def read_log(
    path: str | Path,
    *,
    topics: Mapping[str, str] | None = None,
    joints: Sequence[str] = (),
) -> Log:
    """Reads a log from a CSV file, an ``.npz``, an ``.mcap`` or a ROS bag.

    Columns are ``time``, ``position.<joint>``, ``command.<joint>``; there may be
    ``velocity.<joint>``, and ``torque.<joint>``, by which it is seen whether motors give all they
    can. Units are SI unless they are said in brackets: ``time [ms]``, ``position.FL_knee [deg]``. A
    cell that is empty is missing.

    Of a bag, topics are found by their types: states are those of ``sensor_msgs/JointState`` or of
    a ``control_msgs/JointTrajectoryControllerState``; commands those of such a controller, a
    ``trajectory_msgs/JointTrajectory`` of single points, or a ``std_msgs/Float64MultiArray``.
    Moments are those of the messages' headers, or if one topic has none, those at which all were
    recorded. They are those of the joint whose position is there most often: numbers of others are
    put between theirs, but not where one of these is missing, and a command holds until the next.

    Args:
        path: The file; of a ROS 2 bag also its folder.
        topics: Of a bag: {``"state"`` or ``"command"``: the topic}, where there are several.
        joints: Of a bag: names of joints in messages that have none, in their order.

    Returns:
        The log. What is odd in it, ``inspect_log`` says, for a robot.

    Raises:
        ConfigurationError: If topics or joints are given of what is no bag.
        MeasurementError: If it cannot be read or is no log: columns are missing or not known, a
            joint has no commands, a cell is no number, time does not rise, samples are too few.
        MissingPackageError: If it is a bag, and rosbags is not installed.
    """
    if is_bag(Path(path)):
        _check_files(Path(path))
        time, kinds = read_bag(Path(path), topics or {}, joints)
        return make_log(str(path), time, kinds, range(len(time)))
    for name, given in (("topics", topics), ("joints", joints)):
        if given:
            raise ConfigurationError(name, diagnose("no-bag-has-no-topics", file=str(path)))
    table = read_columns(path, COLUMNS)
    kinds = {kind: table.of(kind) for kind in ("position", "command", "velocity", "torque")}
    return make_log(table.source, table.numbers.get("time", np.zeros(0)), kinds, table.lines)


def _check_files(bag: Path) -> None:
    """Refuses a bag with what is no regular file, as its reader would wait for that.

    Raises:
        MeasurementError: If there is one, or it is too large.
    """
    try:
        for file in bag.iterdir() if bag.is_dir() else (bag,):
            check_input(file, MOST_FILE)
    except InputError as error:
        raise MeasurementError(error.path, error.cause) from error
    except OSError as error:
        raise MeasurementError(str(bag), str(reason_of(error))) from error
