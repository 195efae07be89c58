"""Inertias that no body can have: combined across fixed links, or repaired on request."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest

import pupper_analysis as pa
from pupper_analysis.prepare.convert.repair import find_nearest_moments, is_valid_inertia
from pupper_analysis.tools.convert import model as conversion
from tests.support.conversions import (
    compare_dynamics,
    compile_file,
    convert_file,
    write_standing_urdf,
)
from tests.support.legged import rewrite_file
from tests.support.robots import Part, Parts, arm, change_part, urdf_text

CAMERA = (8.7e-6, 6.7e-4, 1.37e-3, 0.0, 0.0, 0.0)  # of ANYmal C's depth cameras
FLAT = (1e-3, 1e-3, 1e-2, 0.0, 0.0, 0.0)


def write_parts(folder: Path, parts: Parts) -> Path:
    path = folder / "arm.urdf"
    path.write_text(urdf_text(parts, ()))
    return path


def make_fixed_part(link: str, parent: str, inertia: tuple[float, ...], mass: float = 0.16) -> Part:
    return Part(
        link, parent, f"{link}_fixed", "fixed", (0.05, 0.02, 0.1), (0.8, 0.6, 0.0, 0.0),
        mass=mass, com=(0.01, 0.0, 0.02), inertia=inertia,
    )  # fmt: skip


def without_mass(urdf: Path, link: str) -> None:
    text = urdf.read_text()
    start = text.index("<inertial>", text.index(f'<link name="{link}">'))
    end = text.index("</inertial>", start) + len("</inertial>")
    urdf.write_text(text[:start] + text[end:])


def test_repair_finds_the_mass_across_fixed_links(tmp_path: Path) -> None:
    """As on ANYmal C: the camera is fixed to a massless mount, and the mount to a massless frame,
    to which a mass of 6 kg is fixed as well. Reference: dynamics of the URDF in Pinocchio.
    """
    parts = arm()
    parts["frame"] = make_fixed_part("frame", "rod", FLAT)
    parts["mount"] = make_fixed_part("mount", "frame", FLAT)
    parts["camera"] = make_fixed_part("camera", "mount", CAMERA)
    parts["heavy"] = make_fixed_part(
        "heavy", "frame", (0.05, 0.06, 0.07, 1e-3, 2e-3, -1e-3), mass=6.0
    )
    urdf = write_parts(
        tmp_path, change_part(parts, "rod", kind="continuous", lower=None, upper=None)
    )
    for link in ("frame", "mount", "rod"):
        without_mass(urdf, link)
    mjcf, found = convert_file(urdf, "arm.xml")
    assert found.passed, found.failures
    assert found.repairs == ()
    model = compile_file(mjcf)
    assert model.body("heavy").mass[0] == pytest.approx(6.16)
    assert compare_dynamics(urdf, mjcf) < 1e-9


def test_invalid_inertia_of_a_moving_link_is_repaired_on_request(tmp_path: Path) -> None:
    """Reference: the closest moments that satisfy the triangle inequality, (1, 1, -1) times a third
    of the deficit. Mass, CoM, axes and all other bodies are unchanged."""
    stated = (0.02, 0.04, 0.08, 1e-3, 0.0, 0.0)
    urdf = write_parts(tmp_path, change_part(arm(), "boom", inertia=stated))
    with pytest.raises(pa.ModelError, match=r"'boom'.*physically impossible.*--repair-inertia"):
        pa.convert_model(urdf, tmp_path / "arm.xml")
    mjcf, found = convert_file(urdf, "arm.xml", repair_inertia=True)
    assert found.passed, found.failures
    (repair,) = found.repairs
    assert (repair.link, repair.body) == ("boom", "lift")
    moments, new = np.array(repair.moments), np.array(repair.new_moments)
    assert moments[0] + moments[1] < moments[2]
    assert new[0] + new[1] == pytest.approx(new[2], rel=2e-6)
    missing = moments[2] - moments[0] - moments[1]
    np.testing.assert_allclose(new - moments, np.array([1, 1, -1]) * missing / 3, rtol=1e-4)
    model, body = compile_file(mjcf), compile_file(mjcf).body("boom")
    np.testing.assert_allclose(np.sort(body.inertia), new, rtol=1e-9)
    np.testing.assert_allclose(body.ipos, (0.2, 0.0, 0.0))
    assert {d.element for d in found.comparison.differences} == {"lift"}
    assert {d.kind for d in found.comparison.differences} == {"inertia"}
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    # MuJoCo's principal axes diagonalise the tensor of the URDF.
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.body("boom").iquat)
    turn = turn.reshape(3, 3)
    tensor = np.array([[0.02, 1e-3, 0.0], [1e-3, 0.04, 0.0], [0.0, 0.0, 0.08]])
    off = turn.T @ tensor @ turn
    assert np.abs(off - np.diag(np.diag(off))).max() < 1e-9


@pytest.mark.slow
def test_moving_link_without_mass_gets_one_gram_on_request(tmp_path: Path) -> None:
    parts = arm()
    parts["claw"] = Part("claw", "rod", "grip", position=(0.2, 0.0, 0.0), axis=(0.0, 0.0, 1.0))
    urdf = write_parts(tmp_path, parts)
    without_mass(urdf, "claw")
    with pytest.raises(pa.ModelError, match="'claw', which joint 'grip' moves, has no mass"):
        pa.convert_model(urdf, tmp_path / "arm.xml")
    mjcf, found = convert_file(urdf, "arm.xml", repair_inertia=True)
    assert found.passed, found.failures
    assert [(repair.link, repair.new_mass) for repair in found.repairs] == [("claw", 1e-3)]
    assert compile_file(mjcf).body("claw").mass[0] == 1e-3
    assert {difference.element for difference in found.comparison.differences} == {"grip"}


def test_mass_of_a_fixed_link_is_counted_once_if_its_link_is_repaired(tmp_path: Path) -> None:
    """Rod and tool have masses without moments: the tool's mass moves to the rod, whose moments are
    repaired. Reference: Pinocchio's masses and gravity torques of the unmodified URDF."""
    zero = (0.0,) * 6
    parts = change_part(arm(), "rod", inertia=zero)
    parts["tool"] = make_fixed_part("tool", "rod", zero, mass=0.3)
    urdf = write_parts(tmp_path, parts)
    stated = pin.buildModelFromUrdf(str(urdf))
    robot = pa.load_robot(urdf=urdf)
    mass = sum(inertia.mass for inertia in stated.inertias[1:])
    assert sum(inertia.mass for inertia in robot.pin_model.inertias[1:]) == pytest.approx(mass)
    assert robot.mj_model.body_mass[1:].sum() == pytest.approx(robot.total_mass)
    rod = stated.inertias[stated.getJointId("push")]
    repaired = robot.pin_model.inertias[robot.pin_model.getJointId("push")]
    assert repaired.mass == pytest.approx(rod.mass)
    assert repaired.lever == pytest.approx(rod.lever)


@pytest.mark.slow
def test_robot_with_a_repaired_link_stands(tmp_path: Path) -> None:
    """As for NimbRo-OP2X, whose mimic joints move links without mass."""
    frame = (
        '<link name="frame"/><joint name="helper" type="revolute"><parent link="trunk"/>'
        '<child link="frame"/><axis xyz="0 1 0"/>'
        '<limit lower="-1" upper="1" effort="9" velocity="5"/></joint></robot>'
    )
    path = rewrite_file(write_standing_urdf(tmp_path), ("</robot>", frame))
    mjcf, found = convert_file(path, "quad.xml", repair_inertia=True)
    assert [repair.link for repair in found.repairs] == ["frame"]
    assert found.passed, found.failures
    assert found.verification is not None
    with pytest.raises(pa.ModelError, match="'helper' moves no mass") as raised:
        pa.load_robot(urdf=path, mjcf=mjcf)
    assert str(path) in raised.value.source


@pytest.mark.slow
def test_repair_of_one_body_permits_no_difference_of_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The new MJCF has a rod of 0.6 kg, and the URDF 0.5 kg."""
    draft_mjcf = conversion.draft_mjcf

    def draft_with_heavier_rod(*arguments: Any) -> Any:
        draft = draft_mjcf(*arguments)
        assert 'mass="0.5"' in draft.text
        return replace(draft, text=draft.text.replace('mass="0.5"', 'mass="0.6"'))

    monkeypatch.setattr(conversion, "draft_mjcf", draft_with_heavier_rod)
    urdf = write_parts(tmp_path, change_part(arm(), "boom", inertia=(0.02, 0.04, 0.08, 0, 0, 0)))
    _, found = convert_file(urdf, "arm.xml", repair_inertia=True)
    assert not found.agree
    assert any("link rod: mass" in failure for failure in map(str, found.failures))


@pytest.mark.parametrize("seed", range(20))
def test_repaired_moments_are_possible_and_nearest(seed: int) -> None:
    """Reference: 20,000 random moments, none of which is valid and nearer."""
    random = np.random.default_rng(seed)
    moments = np.sort(10.0 ** random.uniform(-6, 0, 3))
    moments[2] += moments[0] + moments[1]
    new = find_nearest_moments(moments, 1.0)
    assert new.min() > 0
    assert new[0] + new[1] >= new[2] * (1 - 1e-9)
    distance = np.linalg.norm(new - moments)
    others = moments + random.normal(0, distance, (20_000, 3))
    low, middle, high = np.sort(others, axis=1).T
    possible = (low > 0) & (low + middle >= high)
    nearest = np.linalg.norm(others[possible] - moments, axis=1).min(initial=np.inf)
    assert distance <= nearest * (1 + 1e-5)


@pytest.mark.parametrize("least", [0.0, 3e-20, 1e-9])
@pytest.mark.parametrize("difference", [0.0, 1e-9, 1e-6])
def test_repaired_moments_of_a_rod_are_possible_in_any_order(
    least: float, difference: float
) -> None:
    """A rod of 0, B and C = B: raising both A and B alone would make B larger than A + C."""
    moments = np.array([least, 1.5e-3, 1.5e-3 * (1 + difference)])
    low, middle, high = np.sort(find_nearest_moments(moments, 1.0))
    assert low > 0
    assert low + middle > high
    np.testing.assert_allclose((low, middle, high), moments, rtol=0, atol=3e-6 * 1.5e-3)


def test_nearest_inertia_of_a_mass_without_inertia_is_valid() -> None:
    """Moments of 1e-4 m^2 times the mass [kg m^2], valid by the triangle inequality."""
    import pinocchio as pin

    new = find_nearest_moments(np.zeros(3), 0.5)
    np.testing.assert_allclose(new, 0.5 * 1e-4)
    inertia = pin.Inertia.Zero()
    inertia.mass, inertia.inertia = 0.5, np.diag(new)
    assert is_valid_inertia(inertia)


@pytest.mark.parametrize(("mass", "valid"), [(0.0, True), (-0.1, False)])
def test_only_a_mass_of_zero_needs_no_moments(mass: float, valid: bool) -> None:
    """MuJoCo 4.0.0 refuses a moving body of negative mass."""
    import pinocchio as pin

    inertia = pin.Inertia.Zero()
    inertia.mass = mass
    assert is_valid_inertia(inertia) is valid


@pytest.mark.parametrize("moments", [(0.3, 0.7, 1.0), (0.1, 0.7, 0.8), (1e-4, 0.2, 0.2001)])
@pytest.mark.parametrize("seed", [None, *range(8)])
def test_flat_body_is_accepted_by_mujoco_in_any_axes(
    moments: tuple[float, float, float], seed: int | None, tmp_path: Path
) -> None:
    """A plate has A + B = C. MuJoCo refuses such tensors if its rounding makes C larger.

    0.1 + 0.7 < 0.8 in double precision. Reference: the stated tensor, in MuJoCo's model.
    """
    turn = np.eye(3)
    if seed is not None:
        turn, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    tensor = turn @ np.diag(moments) @ turn.T
    entries = tuple(tensor[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])
    parts = change_part(arm(), "rod", inertia=entries)
    robot = pa.load_robot(write_parts(tmp_path, parts))
    assert not [note for note in robot.notes if note.code == "inertia-repaired"]
    body = robot.mj_model.body("rod")
    np.testing.assert_allclose(sorted(body.inertia), moments, rtol=1e-9, atol=1e-10)
