"""Files with the recommended gains: only the gains differ, and the robot stands with them."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import pytest

from pupper_analysis.pupper.variant_files import write_variant
from tests.support.commands import answer
from tests.support.variants import load


@pytest.mark.slow
def test_written_gains_hold_a_robot_that_its_own_servos_do_not(tmp_path: Path) -> None:
    """References: the MJCF before, byte by byte; MuJoCo's gains; `stand` of the written files."""
    urdf, mjcf = write_variant("v3-long-leg", tmp_path / "old")
    done = answer("gains", str(urdf), str(mjcf), "--write", str(tmp_path / "new"))
    assert done.returncode == 1  # the present gains are out of bounds
    new = tmp_path / "new" / "mjcf" / mjcf.name
    written = re.sub(r' (gain|bias)prm="[^"]*"', "", new.read_text())
    assert written == re.sub(r' (gain|bias)prm="[^"]*"', "", mjcf.read_text())
    assert (tmp_path / "new" / "urdf" / urdf.name).read_bytes() == urdf.read_bytes()
    model = mujoco.MjModel.from_xml_path(str(new))
    assert model.actuator_gainprm[:, 0] == pytest.approx(11.4)
    assert model.actuator_biasprm[:, 2] == pytest.approx(-0.283)
    stand = answer("stand", str(tmp_path / "new" / "urdf" / urdf.name), str(new))
    assert (stand.returncode, stand.stdout.split(" ")[0]) == (0, "HOLDS")


@pytest.mark.slow
def test_an_mjcf_without_servos_is_refused_by_name(tmp_path: Path) -> None:
    """Gains of added servos have no place in the file."""
    urdf, mjcf = write_variant("v3", tmp_path / "old")
    mjcf.write_text(re.sub(r' biastype="affine"| (gain|bias)prm="[^"]*"', "", mjcf.read_text()))
    done = answer("gains", str(urdf), str(mjcf), "--write", str(tmp_path / "new"))
    assert done.returncode == 2
    assert "leg_front_r_1" in done.stderr
    assert not (tmp_path / "new").exists()


@pytest.mark.slow
def test_written_gains_are_those_for_the_payload(tmp_path: Path) -> None:
    """References: mass and gains of MuJoCo's model; a kp of 5 N m/rad is too soft for 1 kg and the
    margin of a factor of 2, but not without payload."""
    done = answer("gains", "v3", "--payload", "1", "--write", str(tmp_path / "new"))
    assert done.returncode == 0, done.stderr
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "new" / "mjcf" / "v3.xml"))
    assert model.actuator_gainprm[0, 0] == pytest.approx(2 * 3.25, rel=0.01)
    assert model.body_mass.sum() == pytest.approx(load("v3").total_mass)
    assert "a payload of 1 kg; the files contain the robot without this payload" in done.stdout
