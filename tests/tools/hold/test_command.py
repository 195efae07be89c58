"""The command ``hold``: printed text, written files, exit status, and refusals."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import pytest
from matplotlib.image import imread

import pupper_analysis as pa
from pupper_analysis.base.units import round_down
from tests.support.arm import MJCF, RANGES, URDF, arm
from tests.support.commands import check_refusal, run_command


@pytest.fixture
def files(tmp_path: Path) -> tuple[str, str]:
    urdf, mjcf = tmp_path / "arm.urdf", tmp_path / "arm.xml"
    urdf.write_text(URDF, encoding="utf-8")
    mjcf.write_text(MJCF, encoding="utf-8")
    return str(urdf), str(mjcf)


@pytest.mark.slow
def test_written_results_equal_the_python_results(
    files: tuple[str, str], capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Reference: `hold_posture` with the same joint positions and payload."""
    given = ("--joints", "elbow=90deg", "--joints", "b_slide=5cm", "--payload", "0.2")
    out = tmp_path / "held.json", tmp_path / "held.png"
    written = ("--json", str(out[0]), "--figure", str(out[1]), "-v")
    status, output, errors = run_command(capfd, "hold", *files, *given, *written)
    assert status == 0, errors
    held = pa.hold_posture(arm(), {"elbow": math.pi / 2, "b_slide": 0.05}, payload=0.2)
    found = json.loads(out[0].read_text())
    del found["generator"], found["provenance"]
    assert found == json.loads(held.to_json()) | {"name": "arm.urdf+arm.xml + 0.2 kg"}  # as typed
    limit = f"{round_down(held.payload.mass, 3):.3g} kg more at tip"
    assert f"Payload limit in this posture: {limit}" in " ".join(output.split())
    assert imread(out[1]).std() > 0.01


@pytest.mark.slow
def test_weak_motors_give_exit_status_1_and_invalid_input_is_refused(
    files: tuple[str, str], capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    status, output, _ = run_command(capfd, "hold", *files, "--payload", "3")
    assert f"  next: pupper-analysis hold {' '.join(files)}\n" in output
    assert status == 1
    assert "FAILS arm.urdf+arm.xml + 3 kg: worst motor" in output
    assert "OVERLOADED: motors exceed their limits: elbow" in output
    high = f"{math.degrees(RANGES['elbow'][1]):.4g} deg"
    for wrong, said in (
        (("--joints", "elbow=3"), f"elbow at 171.9 deg, outside 11.46 deg to {high}"),
        (("--joints", "elbow=90"), "(for degrees write 90deg)"),
        (("--joints", "elbow=3kg"), "3kg"),
        (("--joints", "elbow=3cm"), "the position of elbow is an angle"),
        (("--joints", "knee=3deg"), "there are: elbow"),
        (("--tool", "thumb"), "thumb"),
        (("--payload", "-1"), "--payload: -1.0 kg"),
        (("--kp", "0"), "kp"),
    ):
        check_refusal(capfd, tmp_path, ("hold", *files, *wrong), said)


def test_urdf_without_inertials_is_refused(
    files: tuple[str, str], capfd: pytest.CaptureFixture[str]
) -> None:
    """With or without inertials in the MJCF; the payload would be divided by a weight of zero."""
    urdf = Path(files[0])
    urdf.write_text(re.sub(r"<inertial>.*?</inertial>", "", URDF))
    status, _, errors = run_command(capfd, "hold", *files)
    assert status == 2
    assert "'elbow' moves no mass" in errors


LIFT = """<mujoco><worldbody><body name="base">
<geom size="0.05" mass="1" contype="0" conaffinity="0"/>
<body name="pillar"><joint name="pan" axis="0 0 1" range="-90 90"/>
<geom size="0.05" mass="1" contype="0" conaffinity="0"/>
<body name="carriage" pos="0.1 0 0"><joint name="lift" type="slide" axis="0 0 1" range="-0.1 0.4"/>
<geom size="0.05" mass="2" contype="0" conaffinity="0"/></body></body></body></worldbody>
<actuator><position joint="pan" kp="90" kv="9" forcerange="-20 20"/>
<position joint="lift" kp="900" kv="90" forcerange="-15 15"/></actuator></mujoco>"""


@pytest.mark.slow
def test_overloaded_motor_precedes_the_motors_that_a_range_limits(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Closed form: 2 kg weigh 19.6 N, of which the lift exerts 15 N, so that it sinks to the lower
    end of its range. The vertical axis of the pan needs no torque, although a range limits it.
    """
    file = tmp_path / "lift.xml"
    file.write_text(LIFT)
    status, output, _ = run_command(capfd, "hold", str(file))
    assert status == 1
    first, cause, *_ = output.splitlines()
    assert first == "FAILS lift.xml: worst motor 19.62 N = 131 % of the limit (lift)"
    assert cause.strip().startswith("OVERLOADED: motors exceed their limits: lift")
