"""Fixed links that are merged into a body: a missing or scaled link is found, and reported once and
first.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from pupper_analysis.models.multibody import TreeBody
from pupper_analysis.present.documents.registry import make_document
from pupper_analysis.tools.crosscheck.causes import (
    combine_bodies,
    compute_moments,
    group_by_pattern,
)
from pupper_analysis.tools.crosscheck.crosscheck import Comparison
from pupper_analysis.tools.crosscheck.document import describe_effects
from tests.support.robots import (
    Part,
    Parts,
    change_part,
    compare_files,
    format_headline,
    list_differences,
    mjcf_text,
    quadruped,
    turned_frames,
    urdf_text,
    write,
)


def rotor(leg: int, on: str, place: tuple[float, float, float], mass: float = 0.089) -> Part:
    """Return a small link on a fixed joint, whose axes are parallel to none of its parent."""
    quaternion = tuple(
        np.array([1.0, 0.3, -0.2, 0.1 * leg]) / np.linalg.norm([1, 0.3, 0.2, 0.1 * leg])
    )
    return Part(
        f"{on}_rotor", on, f"{on}_rotor_joint", "fixed", place, quaternion, mass=mass,
        com=(0.004, -0.001, 0.002), inertia=(5e-5, 6e-5, 8e-5, 4e-6, -7e-6, 2e-6),
    )  # fmt: skip


def add_rotors() -> Parts:
    """Return the quadruped with a rotor on each thigh, and four and a sensor on its base."""
    parts = quadruped()
    for leg in range(4):
        parts |= {f"thigh{leg}_rotor": rotor(leg, f"thigh{leg}", (0.01, 0.05, -0.02 * leg))}
        x, y = (0.2 if leg < 2 else -0.2), (0.1 if leg % 2 else -0.1)
        part = rotor(leg, "base", (x, y, 0.02))
        parts |= {f"hip{leg}_rotor": replace(part, link=f"hip{leg}_rotor", joint=f"r{leg}")}
    sensor = replace(rotor(0, "base", (0.1, 0.0, 0.05), 0.02), link="lidar", joint="to_lidar")
    return {**parts, "lidar": sensor}


def remove_parts(parts: Parts, *endings: str) -> Parts:
    return {name: part for name, part in parts.items() if not name.endswith(endings)}


def get_cause_message(comparison: Comparison, kind: str) -> str:
    """Return the message of the single cause of a kind."""
    assert comparison.complete
    assert not comparison.agree
    (cause,) = (cause for cause in comparison.causes if cause.kind == kind)
    return cause.message


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("links")


@pytest.mark.slow
@pytest.mark.parametrize("lacks", ["MJCF", "URDF"])
def test_missing_links_are_one_cause_and_the_first(lacks: str, folder: Path) -> None:
    """Reference: eight rotors of 0.089 kg, 0.712 kg together."""
    full, bare = urdf_text(add_rotors()), mjcf_text(remove_parts(add_rotors(), "_rotor"))
    if lacks == "URDF":
        full, bare = urdf_text(remove_parts(add_rotors(), "_rotor")), mjcf_text(add_rotors())
    comparison = compare_files(write(folder, full, bare))
    message = get_cause_message(comparison, "links")
    assert message.startswith(f"the {lacks} lacks 0.712 kg that the ")
    assert ", the mass of 8 *_rotor of 0.089 kg each" in message
    assert format_headline(comparison) == f"DISAGREE: {message}"
    (cause,) = comparison.causes
    assert len(cause.differences) == len(comparison.differences)


@pytest.mark.slow
def test_files_agree_after_the_named_links_are_added(folder: Path) -> None:
    bare = remove_parts(add_rotors(), "_rotor", "lidar")
    comparison = compare_files(write(folder, urdf_text(add_rotors()), mjcf_text(bare)))
    message = get_cause_message(comparison, "links")
    assert "8 *_rotor of 0.089 kg each, lidar of 0.02 kg" in message
    full = add_rotors()
    assert compare_files(write(folder, urdf_text(full), mjcf_text(full))).agree


def test_some_of_the_links_of_a_pattern_are_counted(folder: Path) -> None:
    bare = remove_parts(add_rotors(), "thigh0_rotor", "thigh1_rotor", "hip2_rotor")
    comparison = compare_files(write(folder, urdf_text(add_rotors()), mjcf_text(bare)))
    assert "the mass of 3 *_rotor of 0.089 kg each" in get_cause_message(comparison, "links")


@pytest.mark.slow
def test_missing_link_is_found_despite_rotated_frames(folder: Path) -> None:
    files = write(
        folder, urdf_text(add_rotors()), turned_frames(remove_parts(add_rotors(), "_rotor"), seed=3)
    )
    assert "8 *_rotor of 0.089 kg each" in get_cause_message(compare_files(files), "links")


@pytest.mark.slow
@pytest.mark.parametrize("inertia", [True, False])
def test_decimal_point_error_is_found_in_folded_links(inertia: bool, folder: Path) -> None:
    """Mass, or mass and inertia, of four rotors are ten times larger in the URDF."""

    def tenfold(part: Part) -> Part:
        moments = tuple((10.0 if inertia else 1.0) * value for value in part.inertia)
        return replace(part, mass=10 * part.mass, inertia=moments)

    parts = {n: tenfold(p) if n.endswith("_rotor") else p for n, p in add_rotors().items()}
    parts = {**parts, **{f"hip{leg}_rotor": add_rotors()[f"hip{leg}_rotor"] for leg in range(4)}}
    comparison = compare_files(write(folder, urdf_text(parts), mjcf_text(add_rotors())))
    message = get_cause_message(comparison, "scaled links")
    assert message.startswith("mass and inertia of" if inertia else "the mass of")
    for leg in range(4):
        assert f"thigh{leg}_rotor (0.89 kg in the URDF, 0.089 kg in the MJCF)" in message
    assert "0.1 times as large in the MJCF as in the URDF" in message
    assert format_headline(comparison) == f"DISAGREE: {message}"


@pytest.mark.parametrize(("mass", "other", "reported"), [(0.3, 3.0, True), (4.0, 2.5, False)])
def test_equal_factor_of_two_masses_is_a_decimal_point_error(
    mass: float, other: float, reported: bool, folder: Path
) -> None:
    """Only a factor of 10 is reported as a common cause; with another factor, each mass is a
    difference."""
    names = ("thigh0", "thigh1")
    urdf, mjcf = (
        {n: replace(p, mass=value) if n in names else p for n, p in quadruped().items()}
        for value in (mass, other)
    )
    comparison = compare_files(write(folder, urdf_text(urdf), mjcf_text(mjcf)))
    assert [kind for kind, _ in list_differences(comparison)] == ["mass", "mass"]
    assert ("scaled links" in {cause.kind for cause in comparison.causes}) == reported


@pytest.mark.slow
def test_dropped_products_are_found_if_the_base_has_fixed_links(folder: Path) -> None:
    """Offsets of fixed links give the merged base products of inertia, also without own ones."""
    mjcf = {
        name: replace(part, inertia=(*part.inertia[:3], 0.0, 0.0, 0.0))
        for name, part in add_rotors().items()
    }
    comparison = compare_files(write(folder, urdf_text(add_rotors()), mjcf_text(mjcf)))
    message = get_cause_message(comparison, "products")
    assert message.startswith("all products of inertia are 0 in the MJCF; 18 bodies have")
    comparison = compare_files(write(folder, urdf_text(mjcf), mjcf_text(add_rotors())))
    assert get_cause_message(comparison, "products").startswith(
        "all products of inertia are 0 in the URDF"
    )


@pytest.mark.slow
def test_random_change_of_an_inertial_is_not_explained_by_a_missing_link(folder: Path) -> None:
    """Six random inertials whose mass differs by exactly the mass of one or several links."""
    random = np.random.default_rng(5)
    for _ in range(6):
        base, less = add_rotors()["base"], 0.089 * int(random.integers(1, 5))
        com = tuple(np.array(base.com) + 1e-3 * random.normal(size=3))
        other = {
            "mass": base.mass - less,
            "com": com,
            "inertia": tuple(np.array(base.inertia) * random.uniform(0.98, 1.02, size=6)),
        }
        files = write(
            folder, urdf_text(add_rotors()), mjcf_text(change_part(add_rotors(), "base", **other))
        )
        comparison = compare_files(files)
        assert ("mass", "base") in list_differences(comparison)
        kinds = {cause.kind for cause in comparison.causes}
        assert not kinds & {"links", "scaled links"}, (other, comparison.causes)


def test_moved_rotor_is_not_reported_as_missing(folder: Path) -> None:
    """The mass of both bodies agrees, but not CoM and inertia."""
    parts = change_part(add_rotors(), "hip0_rotor", position=(-0.2, 0.1, 0.02))
    files = write(folder, urdf_text(parts), mjcf_text(remove_parts(add_rotors(), "hip0_rotor")))
    assert "links" in {cause.kind for cause in compare_files(files).causes}
    moved = write(folder, urdf_text(parts), mjcf_text(add_rotors()))
    assert "links" not in {cause.kind for cause in compare_files(moved).causes}


def test_folded_body_of_two_boxes_equals_mujocos_body() -> None:
    """Reference: mass, CoM and inertia that MuJoCo compiles for the same boxes."""
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><freejoint/><geom type="box" size="0.1 0.2 0.3" mass="2"/>'
        '<geom type="box" size="0.05 0.1 0.02" mass="3" pos="0.4 -0.1 0.2"/></body></worldbody>'
        "</mujoco>"
    )

    def box(mass: float, half: tuple[float, ...], place: tuple[float, ...]) -> TreeBody:
        x, y, z = np.square(half)
        return TreeBody(mass, np.array(place), np.diag([y + z, x + z, x + y]) * mass / 3)

    combined = combine_bodies(
        box(2.0, (0.1, 0.2, 0.3), (0.0, 0.0, 0.0)), box(3.0, (0.05, 0.1, 0.02), (0.4, -0.1, 0.2))
    )
    assert combined.mass == pytest.approx(model.body_mass[1])
    assert combined.com == pytest.approx(model.body_ipos[1])
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[1])
    turn = turn.reshape(3, 3)
    assert combined.inertia == pytest.approx(turn @ np.diag(model.body_inertia[1]) @ turn.T)
    assert compute_moments(combined)[0] == 5.0


def test_names_are_grouped_by_common_pattern() -> None:
    names = ["FL_hip_rotor", "RR_thigh_rotor", "Head_upper", "Head_lower", "imu"]
    assert group_by_pattern(names) == {
        "*_rotor": ["FL_hip_rotor", "RR_thigh_rotor"],
        "Head_*": ["Head_upper", "Head_lower"],
        "imu": ["imu"],
    }


def test_effect_of_a_cause_is_that_of_all_its_differences(tmp_path: Path) -> None:
    """Without the eight rotors, nothing else differs: the cause explains the whole deviation.

    The first difference alone, the mass of a single body, explains a part only.
    """
    parts = add_rotors()
    comparison = compare_files(
        write(tmp_path, urdf_text(parts), mjcf_text(remove_parts(parts, "_rotor")))
    )
    (cause,) = comparison.causes
    assert len(cause.differences) == len(comparison.differences)
    for name in ("mass matrix", "gravity", "forward dynamics", "com"):
        assert cause.effects[name].share == pytest.approx(1.0, abs=1e-6)
        assert cause.effects[name].relative == pytest.approx(comparison.deviations[name], abs=1e-9)
    first = comparison.differences[cause.differences[0]]
    assert first.effects["gravity"].share < 0.9


def test_second_line_names_another_cause(tmp_path: Path) -> None:
    """The rotors are missing in the MJCF, and two shanks have inertials of another robot."""
    parts = add_rotors()
    bare = remove_parts(parts, "_rotor")
    for leg in (1, 2):
        bare = change_part(
            bare, f"shank{leg}", mass=0.55, com=(0.02, 0.01, -0.15),
            inertia=(0.003, 0.004, 0.002, 0.0, 0.0, 0.0),
        )  # fmt: skip
    comparison = compare_files(write(tmp_path, urdf_text(parts), mjcf_text(bare)))
    assert {cause.kind for cause in comparison.causes} == {"links", "inertial"}
    shorts = {cause.kind: cause.diagnostic.short for cause in comparison.causes}
    assert shorts["links"] == "the MJCF lacks 0.712 kg: 8 *_rotor"
    first, second = comparison.causes
    effects = [
        max(effect.relative for effect in cause.effects.values()) for cause in (first, second)
    ]
    assert effects[0] > effects[1]
    findings = make_document(comparison).findings
    assert getattr(findings[0], "short", "") == shorts[first.kind]
    assert getattr(findings[1], "short", "").endswith(f"; {shorts[second.kind]}")


def test_effect_that_other_differences_cancel_has_a_remark_instead_of_a_share(
    tmp_path: Path,
) -> None:
    """The mass moves from one thigh to the other: each change alone affects the total mass."""
    parts = quadruped()
    mass = parts["thigh0"].mass
    moved = change_part(change_part(parts, "thigh0", mass=mass + 0.1), "thigh1", mass=mass - 0.1)
    comparison = compare_files(write(tmp_path, urdf_text(parts), mjcf_text(moved)))
    first = comparison.differences[0]
    assert first.effects["mass matrix"].share > 1.005
    message = str(describe_effects(first.effects))
    assert "(others cancel a part)" in message
