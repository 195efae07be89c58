"""Logs of joint positions and commands: units, gaps, resolution, and refusals of wrong columns."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pupper_analysis.base.errors import MeasurementError, UnknownNameError
from pupper_analysis.tools.fit.measurements.log import Log, read_log
from pupper_analysis.tools.fit.measurements.log_quality import find_column_step, inspect_log
from tests.support.arm import arm

JOINTS = ("shoulder", "elbow")


def log(seconds: float = 4.0) -> Log:
    """Joints that lag their command by 50 ms, as those of a servo with friction do."""
    time = np.arange(0, seconds, 0.005)
    command = np.column_stack([0.4 * np.sin(5 * time), 0.3 * np.sin(7 * time + 1)])
    position = np.column_stack([0.4 * np.sin(5 * time - 0.25), 0.3 * np.sin(7 * time + 0.65)])
    return Log("a.csv", time, JOINTS, command, position)


def write_csv(folder: Path, header: str, *rows: str) -> Path:
    file = folder / "log.csv"
    file.write_text("\n".join([header, *rows]))
    return file


def table(rows: int = 120) -> list[list[str]]:
    return [[f"{5 * row}", f"{0.1 * row}", f"{0.002 * row}"] for row in range(rows)]


HEADER = "time [ms],position.elbow [deg],command.elbow"


def test_units_and_missing_cells_are_read(tmp_path: Path) -> None:
    rows = table()
    rows[3][1], rows[4][2] = "", "nan"
    found = read_log(write_csv(tmp_path, HEADER, *map(",".join, rows)))
    assert found.interval == pytest.approx(5e-3)
    assert found.position[10, 0] == pytest.approx(np.deg2rad(1.0))
    assert found.command[10, 0] == pytest.approx(0.02)
    assert np.flatnonzero(np.isnan(found.position[:, 0])).tolist() == [3]
    assert np.flatnonzero(np.isnan(found.command[:, 0])).tolist() == [4]


@pytest.mark.parametrize(
    ("header", "change", "code"),
    [
        (HEADER.replace("elbow [deg]", "elbow [turns]"), None, "column-unit"),
        (HEADER.replace("position.elbow [deg]", "angle"), None, "measurement-unknown"),
        (HEADER.replace("time [ms]", "torque.elbow"), None, "column-missing"),
        (HEADER.replace("command.elbow", "command.wrist"), None, "column-without-position"),
        (HEADER.replace("command", "velocity"), None, "joint-without-command"),
        (HEADER.replace("command.elbow", "position.elbow"), None, "column-twice"),
        (HEADER, (5, 0, ""), "time-missing"),
        (HEADER, (5, 1, "fast"), "cell-no-number"),
        (HEADER, (5, 1, "inf"), "cell-no-number"),
        (HEADER, (5, 1, "1,2"), "row-length"),
        (HEADER, 80, "log-too-short"),
        (HEADER, 0, "no-rows"),
    ],
)
def test_invalid_log_is_refused(tmp_path: Path, header: str, change: object, code: str) -> None:
    rows = table() if not isinstance(change, int) else table(change)
    if isinstance(change, tuple):
        rows[change[0]][change[1]] = change[2]
    with pytest.raises(MeasurementError) as refused:
        read_log(write_csv(tmp_path, header, *map(",".join, rows)))
    assert refused.value.cause.code == code


def test_repeated_time_is_refused_as_repeated(tmp_path: Path) -> None:
    rows = table()
    rows[5][0] = rows[4][0]
    with pytest.raises(MeasurementError) as refused:
        read_log(write_csv(tmp_path, HEADER, *map(",".join, rows)))
    assert "line 7, but equals that of the previous line (1 such line)" in str(refused.value)
    rows[5][0] = rows[3][0]
    with pytest.raises(MeasurementError, match=r"line 7, but decreases by 0\.005 s"):
        read_log(write_csv(tmp_path, HEADER, *map(",".join, rows)))


def test_log_is_reordered_to_the_robot_and_unknown_joints_are_refused() -> None:
    ordered = log().order_joints(arm())
    assert ordered.joints == arm().joint_names
    elbow = arm().joint_names.index("elbow")
    assert (ordered.position[:, elbow] == log().position[:, 1]).all()
    assert np.isnan(ordered.position[:, arm().joint_names.index("a_turn")]).all()
    with pytest.raises(UnknownNameError):
        replace(log(), joints=("shoulder", "wrist")).order_joints(arm())


def test_log_inspection_states_rate_resolution_and_gaps() -> None:
    """Reference: an encoder step of 2 pi / 4096 rad, one jump of the clock, three missing samples,
    and one joint at rest.
    """
    good = log()
    quantum = 2 * np.pi / 4096
    position = quantum * np.round(good.position / quantum)
    position[:, 1] = 0.3
    kept = np.delete(np.arange(len(good.time)), [50, 51, 300])
    time = good.time + 2.0 * (np.arange(len(good.time)) > 400)
    odd = replace(good, time=time, position=position)
    odd = replace(odd, time=time[kept], position=position[kept], command=good.command[kept])
    remarks = {remark.code: remark.values for remark in inspect_log(arm(), odd)}
    codes, missing = set(remarks), remarks["log-samples-missing"]
    step = float(np.median(np.diff(good.time)))
    assert missing["count"] == 2
    assert missing["longest"].value == pytest.approx(3 * step)  # not the jump of the clock
    assert find_column_step(position[:, 0]) == pytest.approx(quantum, rel=1e-6)
    assert len(odd.jumps) == 1
    assert codes >= {
        "joints-do-not-move",
        "clock-jumps",
        "log-samples-missing",
        "joints-not-in-log",
    }


def test_swapped_scaled_and_still_columns_are_refused() -> None:
    good, robot = log(), arm()
    degrees, swapped = np.rad2deg(good.position), "command-and-position-swapped"
    inspect_log(robot, good)
    both = [0, 0]  # commanded alike: neither's is the other's
    inspect_log(
        robot, replace(good, position=good.position[:, both], command=good.command[:, both])
    )
    for wrong, code in (
        (replace(good, position=good.command, command=good.position), swapped),
        (replace(good, position=good.position[:, ::-1]), "positions-of-other-joints"),
        (replace(good, position=degrees, command=np.rad2deg(good.command)), "column-in-degrees"),
        (replace(good, position=degrees / 8, command=good.command / 8), "columns-of-two-units"),
        (replace(good, position=np.full_like(good.position, 0.2)), "log-without-motion"),
        (replace(good, command=-good.command), "command-sign-differs"),
        (replace(good, time=1e3 * good.time), "log-too-slow"),
        (replace(good, time=1e-3 * good.time), "log-too-fast"),
    ):  # fmt: skip
        with pytest.raises(MeasurementError) as refused:
            inspect_log(robot, wrong)
        assert refused.value.cause.code == code


@pytest.mark.parametrize("offset", [-0.05, 0.0, 0.05])
def test_soft_servo_that_holds_is_not_reported_as_swapped(offset: float) -> None:
    """Dry friction keeps it up while the command comes down to half: the mean error is not zero."""
    time = 0.005 * np.arange(1000)
    way = np.minimum(time / 1.5, 1.0) - 0.5 * np.clip((time - 2) / 3, 0, 1)
    command, done = 1.5 * np.sin(way * np.pi / 2), [0.0]
    for target in command[1:]:  # as much of it as gravity leaves; friction holds within 0.1 rad
        free = 0.4 * target
        done.append(min(max(done[-1], free - 0.1), free + 0.1))
    position = np.array(done) + offset
    good = Log("lift", time, ("elbow",), command[:, None], position[:, None])
    inspect_log(arm(), good)
    with pytest.raises(MeasurementError, match="the two columns are probably exchanged"):
        inspect_log(arm(), replace(good, position=good.command, command=good.position))


@pytest.mark.parametrize("bits", [8, 12, 14, 16])
def test_encoder_resolution_is_found_from_rounded_values(bits: int) -> None:
    """Reference: 2 pi / 2^bits rad, by which the positions were rounded."""
    random, quantum = np.random.default_rng(bits), 2 * np.pi / 2**bits
    moved = 0.5 * np.sin(np.arange(2000) / 60) + quantum * random.normal(size=2000)
    values = np.round(quantum * np.round(moved / quantum), 7)
    assert find_column_step(values) == pytest.approx(quantum, rel=2e-3)
    assert find_column_step(moved + 1e-3 * random.normal(size=2000)) == 0.0


def test_uneven_sampling_intervals_are_reported() -> None:
    """Every other sample is 4 ms late, as from a second clock; 2 % of a scheduler are normal."""
    good, random = log(), np.random.default_rng(2)
    late = good.time + 0.004 * (np.arange(len(good.time)) % 2)
    found = inspect_log(arm(), replace(good, time=late))
    assert "log-intervals-uneven" in {message.code for message in found}
    shaken = good.time + 0.005 * 0.02 * random.normal(size=len(good.time))
    found = inspect_log(arm(), replace(good, time=shaken))
    assert "log-intervals-uneven" not in {message.code for message in found}


def test_a_joint_whose_position_precedes_its_command_is_reported() -> None:
    """The columns of one joint of two are exchanged; with both the log would be refused."""
    good = log()
    command, position = good.command.copy(), good.position.copy()
    command[:, 0], position[:, 0] = good.position[:, 0], good.command[:, 0]
    found = inspect_log(arm(), replace(good, command=command, position=position))
    (finding,) = [message for message in found if message.code == "position-leads-command"]
    assert finding.values["joints"] == ("shoulder",)


def test_exchanged_positions_of_similar_motions_are_refused() -> None:
    """The motions have a correlation of 0.7; with the own columns the log is accepted."""
    good = log()
    mixed = replace(
        good,
        command=good.command + 0.4 * good.command[:, ::-1],
        position=good.position + 0.4 * good.position[:, ::-1],
    )
    inspect_log(arm(), mixed)
    with pytest.raises(MeasurementError) as refused:
        inspect_log(arm(), replace(mixed, position=mixed.position[:, ::-1]))
    assert refused.value.cause.code == "positions-of-other-joints"


def test_wrong_sign_is_named_although_another_command_is_similar() -> None:
    """The other joint moves in the opposite direction, so that its command resembles the position
    with the wrong sign.
    """
    good = log()
    command, position = good.command.copy(), good.position.copy()
    command[:, 1] = 0.1 * command[:, 1] - command[:, 0]
    position[:, 1] = 0.1 * position[:, 1] - position[:, 0]
    opposed = replace(good, command=command, position=position)
    inspect_log(arm(), opposed)
    with pytest.raises(MeasurementError) as refused:
        inspect_log(arm(), replace(opposed, position=position * [-1.0, 1.0]))
    assert refused.value.cause.code == "command-sign-differs"
    assert refused.value.cause.values["joints"] == ("shoulder",)
