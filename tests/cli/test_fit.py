"""``pupper-analysis fit``: plans and fits, and bad input."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from tests.support.commands import check_refusal, run_command
from tests.support.leg import JOINTS, MJCF, URDF, measured, motion


@pytest.mark.longest
def test_a_plan_is_measured_and_fitted(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """With the commands as positions no servo gives anything: no model explains that it stands."""
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
    told = ("--json", str(found), "--report", str(page), "-o", str(tmp_path / "fitted"))
    status, _, err = run_command(
        capfd, "fit", "v3", "--stands", str(plan), "--prior", "kp=0", *told
    )
    assert status in (1, 2), err
    assert not (tmp_path / "fitted").exists()
    if status == 1:
        assert json.loads(found.read_text())["explained"] is False


def test_torques_are_fitted_and_the_files_corrected(
    capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = tmp_path / "leg.urdf", tmp_path / "leg.xml"
    for file, text in zip(files, (URDF, MJCF), strict=True):
        file.write_text(text, encoding="utf-8")
    log, found = measured(10.0), tmp_path / "fit.json"
    assert log.torque is not None
    path = tmp_path / "log.npz"
    # The knee's torque is that of its belt, too, which turns with the hip.
    coupled = log.torque + 0.5 * np.sign(motion(log.time)[1].sum(axis=1))[:, None]
    torque = {"torque [mNm]": 1e3 * coupled}
    np.savez(path, joints=JOINTS, time=log.time, position=log.position, **torque)
    given = ("fit", *map(str, files), "--log", str(path), "--prior", "mass=0")
    told = ("-o", str(tmp_path / "fitted"), "--json", str(found), "--coupling", "belt=hip+knee")
    status, out, err = run_command(capfd, *given, *told)
    assert status == 0, err
    assert "friction belt" in out
    estimates = {one["name"]: one for one in json.loads(found.read_text())["estimates"]}
    assert estimates["friction belt"]["mean"] == pytest.approx(0.5, abs=0.1)
    assert "frictionloss" in (tmp_path / "fitted" / "leg.xml").read_text()
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    check_refusal(capfd, here, (*given, "--by", "command"), "servo")
    check_refusal(capfd, here, (*given, "--coupling", "belt=hip"), "belt=hip")
    check_refusal(capfd, here, (*given, "--topic", "state=/joint_states"), "bag")
    check_refusal(capfd, here, (*given, "--kp", "3"), "kp")


def test_bad_input_is_one_line(
    capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    elsewhere = tmp_path / "here"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    stands = tmp_path / "stands.csv"
    stands.write_text("command.elbow,position.elbow\n0.1,0.2\n")
    given = ("fit", "v3", "--stands", str(stands))
    check_refusal(capfd, elsewhere, ("fit", "v3"), "--plan 12")
    check_refusal(capfd, elsewhere, given, "elbow")
    check_refusal(capfd, elsewhere, (*given, "--prior", "mass=heavy"), "mass=heavy")
    check_refusal(capfd, elsewhere, (*given, "--weight", "heavy"), "heavy")
    stands.write_text("position.elbow\n0.2\n")
    check_refusal(capfd, elsewhere, given, "command.<joint>")
    check_refusal(capfd, elsewhere, ("fit", "v3", "--log", str(stands)), "time")
    check_refusal(capfd, elsewhere, ("fit", "v3", "--plan", "0", "-o", "plan.csv"), "0 is no")
