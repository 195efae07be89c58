"""The command ``fit``: plans, fits, corrected files, and refusals."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from tests.support.bar import MJCF, TRUE, URDF, log
from tests.support.commands import check_refusal, run_command


def write_log(path: Path, time: np.ndarray, position: np.ndarray, command: np.ndarray) -> None:
    """Write times [s], positions [rad] and commands [deg] of one joint as CSV."""
    rows = np.column_stack([time, position, np.rad2deg(command)])
    head = "time,position.turn,command.turn [deg]"
    np.savetxt(path, rows, "%.7f", ",", header=head, comments="")


@pytest.mark.slow
def test_a_motion_is_fitted_and_the_files_corrected(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Reference: kp of the simulated bar, within 5 %.

    A motion with an unexplained oscillation is not written without --anyway, and then with wider
    intervals.
    """
    files = tmp_path / "bar.urdf", tmp_path / "bar.xml"
    for file, text in zip(files, (URDF, MJCF), strict=True):
        file.write_text(text, encoding="utf-8")
    swing, found, path = (
        log().select_rows(slice(0, 600)),
        tmp_path / "fit.json",
        tmp_path / "log.csv",
    )
    write_log(path, swing.time, swing.position, swing.command)
    given = ("fit", *map(str, files), "--log", str(path), "--prior", "mass=0", "--prior", "com=0")
    messages = ("-v", "-o", str(tmp_path / "fitted"), "--json", str(found))
    status, out, err = run_command(capfd, *given, *messages)
    assert status == 0, err
    assert "friction turn" in out
    assert out.splitlines()[-2].startswith("  next: pupper-analysis hold ")  # its base is fixed
    estimates = {one["name"]: one for one in json.loads(found.read_text())["estimates"]}
    assert estimates["kp turn"]["mean"] == pytest.approx(TRUE["kp"], rel=0.05)
    assert 'kp="5"' not in (tmp_path / "fitted" / "bar.xml").read_text()
    # What is predicted may be a log of its own, but not one that was fitted.
    rest, other = log().select_rows(slice(600, None)), tmp_path / "other.csv"
    write_log(other, rest.time, rest.position, rest.command)
    apart = ("--hold-out", str(other), "--json", str(found), "--force")
    run_command(capfd, *given, *apart)
    assert json.loads(found.read_text())["held_out"] < 3e-3  # it begins in motion; the file: 0.033
    status, _, err = run_command(capfd, *given, "--hold-out", str(path))
    assert (status, err.count("\n")) == (2, 1)
    # Something else moves it: nothing is written, but on demand, with wider intervals.
    shaken = swing.position + 0.05 * np.sin(40 * swing.time)[:, None]
    write_log(path, swing.time, shaken, swing.command)
    messages = ("-o", str(tmp_path / "shaken"), "--json", str(found), "--force")
    assert run_command(capfd, *given, *messages)[0] == 1
    assert not (tmp_path / "shaken").exists()
    status, _, err = run_command(capfd, *given, *messages, "--anyway")
    assert status == 1
    assert "intervals and samples are" in err
    written = json.loads((tmp_path / "shaken" / "fit.json").read_text())
    times = max(1.0, written["fit"]["held_out"] / written["fit"]["fitted"])
    for one, own in zip(written["parameters"], written["fit"]["estimates"], strict=True):
        assert one["std"] == pytest.approx(times * own["std"])
    check_refusal(capfd, tmp_path, (*given, "--topic", "state=/joint_states"), "bag")
    check_refusal(capfd, tmp_path, (*given, "--hold-out", "1.5"), "--hold-out: 1.5 is not")
    path.write_text(path.read_text().replace("command.turn [deg]", "torque.turn"))
    check_refusal(capfd, tmp_path, given, "fitted with the commanded positions")


def test_invalid_input_is_refused_in_one_line(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    stands = tmp_path / "stands.csv"
    stands.write_text("command.elbow,position.elbow\n0.1,0.2\n")
    given = ("fit", "v3", "--stands", str(stands))
    check_refusal(capfd, tmp_path, ("fit", "v3"), "--plan 12")
    check_refusal(capfd, tmp_path, given, "elbow")
    check_refusal(capfd, tmp_path, (*given, "--prior", "mass=heavy"), "mass=heavy")
    check_refusal(capfd, tmp_path, (*given, "--weight", "heavy"), "heavy")
    stands.write_text("position.elbow\n0.2\n")
    check_refusal(capfd, tmp_path, given, "command.<joint>")
    check_refusal(capfd, tmp_path, ("fit", "v3", "--log", str(stands)), "time")
    check_refusal(capfd, tmp_path, ("fit", "v3", "--plan", "2", "-o", "plan.csv"), "2 is no")


@pytest.mark.slow
def test_fit_of_a_plan_without_servo_deflection_is_not_written(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """The measured positions equal the commands, so no servo has torque, and no model explains the
    stands: the fit is refused or unexplained."""
    plan, page = tmp_path / "plan.csv", tmp_path / "fit.html"
    assert run_command(capfd, "fit", "v3", "--plan", "4", "-o", str(plan))[0] == 0
    with plan.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 4
    for row in rows:
        for name, value in list(row.items()):
            if name.startswith("command."):
                row[name.replace("command", "position")] = value
    with plan.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    found = tmp_path / "fit.json"
    messages = ("--json", str(found), "--report", str(page), "-o", str(tmp_path / "fitted"))
    status, _, err = run_command(
        capfd, "fit", "v3", "--stands", str(plan), "--prior", "kp=0", *messages
    )
    assert status in (1, 2), err
    assert not (tmp_path / "fitted").exists()
    if status == 1:
        assert json.loads(found.read_text())["explained"] is False
