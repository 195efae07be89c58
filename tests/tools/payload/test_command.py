"""The command ``payload``: payloads for moments, and permanent payloads, and exit status."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import pupper_analysis as pa
from tests.support.commands import check_refusal, run_command
from tests.support.variants import load

pytestmark = pytest.mark.usefixtures("shared_rollouts")


@pytest.mark.slow
def test_continuous_payload_equals_the_payload_at_that_effort(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    found = {}
    for option in ("--continuous", "--effort"):
        path = tmp_path / f"{option}.json"
        status, out, err = run_command(capfd, "payload", "v3", option, "0.6", "--json", str(path))
        assert status == 0, err
        answer = out.partition("\n")[0]
        assert answer.startswith("CARRIES (")
        found[option] = answer.partition(") v3: ")[0], json.loads(path.read_text())["mass"]
    assert found["--continuous"][1] == found["--effort"][1] > 0.5
    assert found["--continuous"][0] == "CARRIES (permanently"
    assert found["--effort"][0] == "CARRIES (peak torque"


@pytest.mark.slow
def test_payload_prints_its_limits(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """Reference: `payload_limit` with the same task, point and gains."""
    path = tmp_path / "all.json"
    options = ("--payload-at", "1cm,0,0.08", "--kp", "30", "--kd", "1", "--yaw", "0.1")
    status, out, err = run_command(
        capfd, "payload", "-v", "original", *options, "--json", str(path)
    )
    assert status == 0, err
    content = json.loads(path.read_text())
    assert content["point"] == [0.01, 0.0, 0.08]
    robot = load("original")
    limit = pa.payload_limit(
        robot, pa.StandTask(yaw=0.1), (0.01, 0.0, 0.08), kp=30.0, kd=1.0, commands_alone=True
    )
    marks = {name: content[name] for name in ("generator", "provenance")}
    assert {**json.loads(limit.to_json()), **marks} == content
    assert content["trial"]["survived"]
    assert "at (10, 0, 80) mm of" in out
    assert f"base is ({1e3 * limit.offset[0]:.1f}, " in out
    assert "s after a nudge: stays upright" in out
    status, out, err = run_command(
        capfd, "payload", "-v", "v3-long-leg", *("--kp", "1", "--kd", "0.1")
    )
    assert status == 1, err
    assert "largest payload 0.00 kg at (0, 0, 0) mm of base_link, on the simulated ground" in out
    assert "limiting failure: loses static stability" in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--payload-at", "1,2"), "payload-at: '1,2' is not of the form X,Y,Z (10mm,0,0)"),
        (
            ("--slope", "0.8", "--pitch", "-0.8"),
            "the friction coefficient is 1.000, but balance needs 1.030",
        ),
        (("--json", "."), "the path is a folder"),
    ],
)
def test_invalid_input_is_refused_in_one_line(
    arguments: tuple[str, ...], message: str, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    output = () if "--json" in arguments else ("--json", "all.json")
    check_refusal(capfd, tmp_path, ["payload", "v3", *arguments, *output], message)
