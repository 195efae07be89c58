"""``pupper-analysis payload``: what it carries for moments, and what lasts."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.support.commands import run_command


def test_what_lasts_is_what_motors_of_that_effort_carry(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    found = {}
    for option in ("--continuous", "--effort"):
        path = tmp_path / f"{option}.json"
        status, out, err = run_command(capfd, "payload", "v3", option, "0.6", "--json", str(path))
        assert status == 0, err
        found[option] = out.partition(" v3:")[0], json.loads(path.read_text())["mass"]
    assert found["--continuous"][1] == found["--effort"][1] > 0.5
    assert found["--continuous"][0] == "CARRIES (at continuous torque)"
    assert found["--effort"][0] == "CARRIES (at the stated peak torque, for moments)"
