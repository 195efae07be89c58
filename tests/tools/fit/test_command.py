"""The command ``fit``: plans, fits, corrected files, and refusals."""

from __future__ import annotations

import csv
import json
from contextlib import nullcontext
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import click
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.base.errors import ConfigurationError, OutputError
from pupper_analysis.cli import find_command
from pupper_analysis.cli.robots import RobotOptions
from pupper_analysis.cli.stance_options import parse_gain
from pupper_analysis.robot.servos import list_position_servos
from pupper_analysis.tools.fit.command import (
    _MODE_OPTIONS,
    _select_next_step,
    _write_gain_options,
)
from pupper_analysis.tools.fit.command import command as fit_command
from pupper_analysis.tools.fit.stands.plan import PlannedStand, StandPlan
from tests.support import arm
from tests.support.bar import MJCF, TRUE, URDF, log
from tests.support.commands import check_refusal, run_command
from tests.support.repository import ROOT


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
    (step,) = (line for line in out.splitlines() if line.startswith("  next: "))
    assert step.startswith("  next: pupper-analysis hold ")  # its base is fixed
    estimates = {
        estimate["name"]: estimate for estimate in json.loads(found.read_text())["estimates"]
    }
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
    check_refusal(capfd, tmp_path, (*given, "--hold-out", "leg.mcap"), "PlotJuggler")
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
    # A share beside a log would be predicted in place of the log.
    write_log(stands, *np.tile(np.arange(200) / 100, (3, 1)))
    held_out = ("--hold-out", str(stands), "--hold-out", "0.2")
    given = ("fit", "v3", "--log", str(stands), *held_out)
    check_refusal(capfd, tmp_path, given, "0.2 is a share")


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


MODES = {
    "--plan": ("--plan", "2"),
    "--stands": ("--stands", "stands.csv"),
    "--log": ("--log", "log.csv"),
}
VALUES = {
    **{"priors": "mass=0", "weight": "3kg", "hold_out": "0.3"},
    **{"kp": "5", "kd": "1", "added": "0.5kg", "added_at": "0,0,1cm"},
    **{"style": "markdown", "report_path": "a.html"},
}
"""{parameter with a special form: valid value}."""
EXPECTED = {"--plan": {"added", "added_at"}, "--stands": {"weight"},
            "--log": {"hold_out", "kd"}}  # fmt: skip
"""{mode: options that only this mode uses}."""


def record_calls(
    words: tuple[str, ...],
    monkeypatch: pytest.MonkeyPatch,
    calls: list[str] | None = None,
) -> list[str]:
    """Run `fit` with functions that record their arguments, and return the calls.

    Args:
        words: Options of the command.
        monkeypatch: Fixture that replaces the functions.
        calls: List to which the calls are appended, also if the command ends with an error.
    """
    calls = [] if calls is None else calls

    def replace(path: str, result: Any = None) -> None:
        def record(*arguments: Any, **named: Any) -> Any:
            calls.append(f"{path}{arguments}{sorted(named.items())}")
            return result

        monkeypatch.setattr(path, record)

    command, fit = "pupper_analysis.tools.fit.command", "pupper_analysis.tools.fit"
    shared = "pupper_analysis.cli.shared"
    replace(f"{command}.print_robot_notes")
    monkeypatch.setattr(f"{command}.parse_gain", lambda name, words, robot: words)
    robot = SimpleNamespace(name="robot", check_floating=lambda _, **__: None)
    replace(f"{command}.load_selected_robot", robot)
    replace(f"{command}._select_next_step")
    for name in ("show_results", "write_page", "confirm_written", "finish_command"):
        replace(f"{shared}.{name}")
    replace(f"{shared}.show_progress", nullcontext())
    replace(f"{fit}.fit.fit", "a fit")
    replace(f"{fit}.stands.plan.plan_stands", "a plan")
    replace(f"{fit}.stands.plan.write_plan")
    replace(f"{fit}.measurements.stands.read_stands", "stands")
    replace(f"{fit}.measurements.log.read_log", "a log")
    find_command("fit").main(args=["v3", *words], standalone_mode=False)
    return calls


def test_result_and_page_are_made_if_models_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The fit takes minutes; an output folder that cannot be written loses neither."""

    def refuse_output(*_: Any, **__: Any) -> None:
        raise OutputError("fitted", "no space left")

    monkeypatch.setattr("pupper_analysis.tools.fit.command._write_models", refuse_output)
    monkeypatch.setattr("pupper_analysis.tools.fit.result.Fit", str)  # the type of "a fit"
    shown: list[str] = []
    monkeypatch.chdir(tmp_path)
    Path("log.csv").touch()
    with monkeypatch.context() as context, pytest.raises(OutputError):
        record_calls(
            ("--log", "log.csv", "--report", "fit.html", "-o", str(tmp_path / "fitted")),
            context,
            shown,
        )
    names = [call.partition("(")[0].rpartition(".")[2] for call in shown]
    assert names[-2:] == ["show_results", "write_page"]


NOT_TYPED = {field.name for field in fields(RobotOptions)} | {
    *("stands", "logs", "count", "record", "listen"),  # the modes
    *("anyway", "output", "force"),  # which need a result of the fit, or an existing file
    "language",  # of the printed answer
}


@pytest.mark.parametrize("mode", MODES)
def test_each_option_of_a_mode_reaches_a_function_or_is_refused(
    mode: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The arguments of the called functions differ from those without the option."""
    monkeypatch.chdir(tmp_path)
    Path("stands.csv").touch()
    Path("log.csv").touch()
    used: set[str] = set()
    refused: dict[str, tuple[str, str, str]] = {}
    without_effect = []
    for parameter in find_command("fit").params:
        name = str(parameter.name)
        if not isinstance(parameter, click.Option) or name in NOT_TYPED:
            continue
        load = ("--added", "1kg") if name == "added_at" and mode == "--plan" else ()
        words = (*MODES[mode], *load)
        value = VALUES.get(name, "a.json")
        option = (max(parameter.opts, key=len), *(() if parameter.is_flag else (value,)))
        try:
            with monkeypatch.context() as patch:
                after = record_calls((*words, *option), patch)
        except ConfigurationError as error:
            refused[name] = error.field, option[0], str(error)
            continue
        used.add(name)
        with monkeypatch.context() as patch:
            if record_calls(words, patch) == after:
                without_effect.append(name)
    assert without_effect == []
    assert EXPECTED[mode] <= used
    assert set().union(*EXPECTED.values()) - EXPECTED[mode] <= refused.keys()
    for field, option_name, message in refused.values():
        assert field == option_name
        assert "\n" not in message
    assert {"priors", "kp", "json_path", "report_path", "everything", "style"} <= used


def test_refusal_of_an_option_names_the_modes_that_use_the_option(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    message = (
        "--weight: the option has no effect with --plan; it applies to --stands; "
        "omit one of the two"
    )
    check_refusal(capfd, tmp_path, ("fit", "v3", "--plan", "2", "--weight", "3kg"), message)


def test_plan_proposes_twice_the_stands_only_if_these_determine_more() -> None:
    """A plan of 5 stands proposed itself; all 30 candidates determine 28 parameters, not 0."""
    planned = PlannedStand("s01", (), {"knee": 0.5}, 0.25)
    plan = StandPlan("v3", stands=(planned,) * 5, expected=(), candidates=30)
    steps = [
        _select_next_step(replace(plan, determined_by_all=counts), None)
        for counts in ({"kp": 28}, {})
    ]
    words = [step.words for step in steps if step is not None]
    assert words == [("--plan", "10", "-o", "plan.csv"), ("-o", "plan.csv")]


def test_recording_after_a_plan_omits_the_options_that_it_refuses() -> None:
    """Reference: table of the options that each mode accepts."""
    plan = StandPlan("v3", stands=(), expected=(), candidates=0)
    step = _select_next_step(plan, Path("plan.csv"))
    assert step is not None
    refused = _MODE_OPTIONS["--plan"] - _MODE_OPTIONS["--record"]
    assert {"kp", "priors", "count"} <= refused
    for option in fit_command.params:
        if option.name in refused:
            assert {*option.opts} & {*step.omitted}, option.opts


@pytest.mark.parametrize(
    ("typed", "expected"),
    [
        ("--record my.csv --bridge typed -o s.csv", "--plan 6 -o {folder}/my.csv"),
        ("--stands my.csv --kp 6 --weight 3kg", "--kp 6 --plan 6 -o plan.csv"),
    ],
)
def test_missing_plan_or_stands_print_the_command_that_plans_stands(
    typed: str, expected: str, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    words = [str(tmp_path / word) if word == "my.csv" else word for word in typed.split()]
    status, _, err = run_command(capfd, "fit", "v3", *words)
    assert status == 2
    assert "my.csv: there is no such file" in err
    line = f"  next: pupper-analysis fit v3 {expected.format(folder=tmp_path)}"
    assert err.splitlines()[-1] == line


@pytest.mark.parametrize(
    ("typed", "fault", "expected"),
    [
        ("--plan 3 -o p.csv", "replace 6 (a default)", "--plan 3 -o {folder}/p.csv --kp 6"),
        ("--record my.csv", "kp 6, a default", "--plan 6 -o {folder}/my.csv --kp 6"),
        ("--stands my.csv", "kp 6, a default", "--plan 6 -o plan.csv --kp 6"),
    ],
)
def test_servos_without_kp_propose_the_command_with_kp_of_the_added_servos(
    typed: str, fault: str, expected: str, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Reference: MuJoCo's gain of the servos that loading adds, since a URDF states no kp.

    A plan of another robot's stands is not proposed.
    """
    (tmp_path / "my2.csv").write_text("stand,command.other_joint\n")
    urdf = str(ROOT / "urdf/pupper_v3.urdf")
    (kp,) = set(pa.load_robot(urdf).mj_model.actuator_gainprm[:, 0])
    fault, expected = (text.replace(" 6 (", f" {kp:g} (") for text in (fault, expected))
    fault = fault.replace("kp 6", f"kp {kp:g}")
    expected = expected.replace("--kp 6", f"--kp {kp:g}").format(folder=tmp_path)
    words = [str(tmp_path / word) if word[-4:] == ".csv" else word for word in typed.split()]
    status, _, err = run_command(capfd, "fit", urdf, *words)
    assert status == 2
    assert fault in err
    assert "did you mean" not in err
    assert err.splitlines()[-1] == f"  next: pupper-analysis fit {urdf} {expected}"
    (tmp_path / "my2.csv").write_text("stand,command.leg_front_r_1 [deg]\n")
    _, _, err = run_command(capfd, "fit", urdf, *words)
    assert ("did you mean" in err) == ("my.csv" in typed)


def test_joints_with_different_default_kp_get_an_option_for_each_value(tmp_path: Path) -> None:
    """Reference: the parser of ``--kp``, which returns the gains of the loaded servos."""
    (tmp_path / "arm.urdf").write_text(arm.URDF)
    robot = pa.load_robot(tmp_path / "arm.urdf")
    words = _write_gain_options(robot, "kp")
    assert set(words[::2]) == {"--kp"}
    servos = list_position_servos(robot)
    assert len({kp for kp, _ in servos.values()}) > 1
    parsed = parse_gain("kp", words[1::2], robot)
    assert parsed == pytest.approx([servos[joint][0] for joint in robot.joint_names], rel=5e-4)


@pytest.mark.parametrize("typed", ["--plan 3 --added 1kg", "--record my.csv", "--stands my.csv"])
def test_fixed_base_proposes_to_fit_a_log_in_place_of_stands(
    typed: str, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Stands need a free base; a log needs a fixed base."""
    path = tmp_path / "arm.urdf"
    path.write_text(arm.URDF)
    status, _, err = run_command(capfd, "fit", str(path), *typed.split())
    assert status == 2
    assert f"fixed base, no {typed.split()[0]}; record motion.csv: time, command.JOINT" in err
    assert err.splitlines()[-1] == f"  next: pupper-analysis fit {path} --log motion.csv"


def test_plan_in_place_of_stands_names_the_command_that_records_it(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """The refusal listed all joints of the first stand, with the advice to omit the stand."""
    plan = tmp_path / "plan.csv"
    joints = pa.load_variant("v3").joint_names
    columns = [f"{kind}.{joint}" for kind in ("command", "position") for joint in joints]
    cells = ["0.1"] * len(joints) + [""] * len(joints)
    plan.write_text("\n".join([",".join(["stand", *columns])] + [",".join(["s1", *cells])] * 2))
    status, _, err = run_command(capfd, "fit", "v3", "--stands", str(plan), "--kp", "6")
    fault, step = err.splitlines()
    assert status == 2
    assert fault.endswith("plan.csv: the file is a plan of 2 stands without positions; "
                          "record the plan first")  # fmt: skip
    assert step == f"  next: pupper-analysis fit v3 --record {plan} --bridge typed -o stands.csv"


def test_missing_stands_name_the_command_that_records_a_similar_plan(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """The refusal proposed the plan itself as stands, and to overwrite plan.csv."""
    plan, stands = tmp_path / "plan360.csv", tmp_path / "stands360.csv"
    joints = pa.load_variant("v3").joint_names
    columns = [f"{kind}.{joint}" for kind in ("command", "position") for joint in joints]
    cells = ["0.1"] * len(joints) + [""] * len(joints)
    plan.write_text("\n".join([",".join(["stand", *columns]), ",".join(["s1", *cells])]))
    status, _, err = run_command(capfd, "fit", "v3", "--stands", str(stands), "--kp", "6")
    fault, step = err.splitlines()
    assert status == 2
    assert fault == f"error: {stands}: there is no such file; first record the plan {plan}"
    assert step == f"  next: pupper-analysis fit v3 --record {plan} --bridge typed -o {stands}"
    status, _, err = run_command(capfd, "fit", "v3", "--log", str(plan), "--kp", "6")
    assert status == 2
    assert err.splitlines()[-1] == f"  next: pupper-analysis fit v3 --kp 6 --stands {plan}"


def test_missing_log_states_the_columns_of_a_log(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    words = ("fit", "v3", "--log", str(tmp_path / "motion.csv"))
    check_refusal(capfd, tmp_path, words, "a log is a CSV with time, command.JOINT and")
