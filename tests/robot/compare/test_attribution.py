"""Effects of differences between two files, compared with closed forms of a pendulum and a
quadruped; completeness of explanations, and the text of messages.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pupper_analysis.base.arrays import rotation_from_quaternion
from pupper_analysis.base.diagnostics import Quantity
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.robot.compare import differences as explain_module
from pupper_analysis.robot.compare.attribution import explain_differences
from pupper_analysis.robot.compare.behaviour import random_states
from pupper_analysis.robot.compare.differences import Difference, Explanation
from pupper_analysis.robot.matching.tolerances import Tolerances
from tests.support.robots import (
    FEET,
    Part,
    Parts,
    all_changed,
    arm,
    change_part,
    compare_files,
    explain_parts,
    list_differences,
    match_files,
    mjcf_text,
    pendulum,
    quadruped,
    robot_of,
    turned_about,
    urdf_text,
    write,
)

GRAVITY = 9.81
WEIGHT = sum(part.mass for part in quadruped().values()) * GRAVITY
LENGTH, MASS = 0.5, 2.0  # of the pendulum
ROD = MASS * LENGTH**2 + 1e-3 + 0.01  # its moment of inertia about the hinge, with the rotor


def get_difference(explanation: Explanation) -> Difference:
    (difference,) = explanation.differences
    return difference


def swing(folder: Path, **values: Any) -> tuple[Explanation, np.ndarray, np.ndarray]:
    """Return the explanation of a pendulum whose MJCF has other values, and the angles [rad] and
    velocities [rad/s] of the evaluation.
    """
    robot = robot_of(folder, pendulum(), pendulum(**values), free=False)
    states = random_states(robot, 20, seed=0)
    return explain_differences(robot), states.qpos[:, 0], states.qvel[:, 0]


# ------------------------------------------------------------------------------------- effects


def test_gravity_effect_of_an_extra_mass_equals_its_weight(tmp_path: Path) -> None:
    """Closed form: m g [N] of the extra 0.25 kg, absolute and relative to the weight of the
    robot.
    """
    effects = get_difference(
        explain_parts(tmp_path, quadruped(), change_part(quadruped(), "base", mass=6.25))
    ).effects
    assert effects["gravity"].deviation == pytest.approx(0.25 * GRAVITY, rel=1e-12)
    assert effects["gravity"].relative == pytest.approx(0.25 * GRAVITY / WEIGHT, rel=1e-12)
    assert effects["mass matrix"].deviation == pytest.approx(0.25, rel=1e-12)
    assert effects["gravity"].share == pytest.approx(1, rel=1e-12)
    assert "joint positions" not in effects
    assert "foot positions" not in effects


def test_shares_of_two_masses_exceed_one_if_their_effects_cancel(tmp_path: Path) -> None:
    """Closed form: 0.3 kg and 0.1 kg have shares of 3/4 and 1/4 of the gravity deviation; with
    opposite signs 3/2 and 1/2.
    """
    for thigh, expected in ((1.1, (0.75, 0.25)), (0.9, (1.5, -0.5))):
        mjcf = change_part(change_part(quadruped(), "base", mass=6.3), "thigh0", mass=thigh)
        shares = {
            difference.element: difference.effects["gravity"].share
            for difference in explain_parts(tmp_path, quadruped(), mjcf).differences
        }
        assert shares["base"] == pytest.approx(expected[0], rel=1e-9)
        assert shares["hip0"] == pytest.approx(abs(expected[1]), rel=1e-9)


def test_damping_effect_equals_the_closed_form_of_a_pendulum(tmp_path: Path) -> None:
    """Closed form of the acceleration [rad/s^2]: 0.25 N m s/rad times the velocity, divided by the
    moment of inertia.
    """
    explanation, _, qvel = swing(tmp_path, damping=0.35)
    effect = get_difference(explanation).effects
    assert set(effect) == {"forward dynamics"}
    expected = np.abs(0.25 * qvel / ROD).max()
    assert effect["forward dynamics"].deviation == pytest.approx(expected, rel=1e-9)


def test_com_effect_equals_the_closed_form_of_a_pendulum(tmp_path: Path) -> None:
    """Closed forms: m g dz sin(q) [N m] for gravity, m (0.52^2 - 0.5^2) [kg m^2] for the mass
    matrix.
    """
    explanation, angles, _ = swing(tmp_path, com=(0.0, 0.0, -0.52))
    expected = np.abs(MASS * GRAVITY * 0.02 * np.sin(angles)).max()
    assert get_difference(explanation).effects["gravity"].deviation == pytest.approx(
        expected, rel=1e-9
    )
    heavier = MASS * (0.52**2 - 0.5**2)
    effect = get_difference(explanation).effects["mass matrix"]
    assert effect.deviation == pytest.approx(heavier, rel=1e-9)
    assert effect.relative == pytest.approx(heavier / ROD, rel=1e-9)


def test_inertia_effect_of_a_pendulum_is_in_the_mass_matrix_only(tmp_path: Path) -> None:
    """The mass matrix changes by the difference of the moments about the hinge, 0.8e-3 kg m^2;
    gravity does not.
    """
    explanation, _, _ = swing(tmp_path, inertia=(1e-3, 1.8e-3, 1e-3, 0, 0, 0))
    effects = get_difference(explanation).effects
    assert effects["mass matrix"].deviation == pytest.approx(0.8e-3, rel=1e-9)
    assert "gravity" not in effects


def test_zero_angle_effect_equals_the_closed_form_of_a_pendulum(tmp_path: Path) -> None:
    """Closed form: m g l (sin(q + 0.1) - sin(q)) [N m]; the message gives 5.73 deg about the joint
    axis.
    """
    turned = turned_about(pendulum()["bob"], (0, 1, 0), 0.1)
    explanation, angles, _ = swing(tmp_path, quaternion=turned)
    difference = get_difference(explanation)
    assert difference.kind == "rotation"
    assert (
        "rotated by 5.73 deg about (0, 1, 0) (the joint's own axis: the files' zero angles differ)"
        in (difference.message)
    )
    expected = MASS * GRAVITY * LENGTH * (np.sin(angles + 0.1) - np.sin(angles))
    assert difference.effects["gravity"].deviation == pytest.approx(
        np.abs(expected).max(), rel=1e-9
    )


def test_armature_of_the_mjcf_is_given_to_both_models_with_a_note(tmp_path: Path) -> None:
    """A URDF cannot state armature, so the armature of the MJCF alone is no difference."""
    explanation, _, _ = swing(tmp_path, armature=0.03)
    assert explanation.differences == ()
    (note,) = explanation.notes
    assert "0.03 kg m^2 on 1 joint" in str(note)


def test_damping_and_friction_that_the_mjcf_alone_states_have_their_units(tmp_path: Path) -> None:
    """Reference: the values of `quadruped()` and the SI units of armature, damping and dry
    friction.
    """
    urdf = re.sub("<dynamics[^>]*/>", "", urdf_text(quadruped()))
    comparison = compare_files(write(tmp_path, urdf, mjcf_text(quadruped())))
    assert comparison.differences == ()
    units = {
        note.code: (note.values["least"], note.values["count"])
        for note in comparison.notes
        if note.code.endswith("-of-the-mjcf-alone")
    }
    assert units == {
        "armature-of-the-mjcf-alone": (Quantity(0.01, "kg m^2"), 8),
        "damping-of-the-mjcf-alone": (Quantity(0.1, "N m s/rad"), 8),
        "friction-of-the-mjcf-alone": (Quantity(0.2, "N m"), 8),
    }


def test_effect_of_a_shifted_joint_equals_the_shift_of_its_subtree(tmp_path: Path) -> None:
    """Closed form: largest component of R shift [m] over the states, with the base rotation R."""
    shift = np.array([0.003, -0.001, 0.002])
    mjcf = change_part(
        quadruped(), "thigh2", position=tuple(quadruped()["thigh2"].position + shift)
    )
    robot = robot_of(tmp_path, quadruped(), mjcf)
    difference = get_difference(explain_differences(robot))
    assert (difference.kind, difference.element) == ("position", "hip2")
    states = random_states(robot, 20, seed=0)
    expected = max(
        np.abs(rotation_from_quaternion(qpos[3:7]) @ shift).max() for qpos in states.qpos
    )
    for quantity in ("joint positions", "foot positions"):
        assert difference.effects[quantity].deviation == pytest.approx(expected, rel=1e-9)


def test_limits_are_ordered_by_the_part_of_the_range_that_differs(tmp_path: Path) -> None:
    """Reference: changes of 1.5, 0.41 and 0.1 rad; efforts of a tenth (20 to 2 N m) and 34/35."""
    mjcf = change_part(quadruped(), "thigh0", upper=0.8)
    mjcf = change_part(mjcf, "shank2", lower=-1.0)
    mjcf = change_part(mjcf, "thigh1", lower=-0.6, effort=2.1)
    mjcf = change_part(mjcf, "shank0", effort=34.0)
    assert list_differences(explain_parts(tmp_path, quadruped(), mjcf)) == [
        ("lower limit", "knee2"),
        ("lower limit", "hip1"),
        ("upper limit", "hip0"),
        ("effort", "hip1"),
        ("effort", "knee0"),
    ]


def test_effect_of_a_mass_equals_that_of_mujoco(tmp_path: Path) -> None:
    """Reference: bias forces and mass matrices of two compiled MJCFs at the same states."""
    robot = robot_of(tmp_path, quadruped(), change_part(quadruped(), "shank1", mass=0.5))
    effects = get_difference(explain_differences(robot)).effects
    lighter = robot.description.mjcf.copy().compile()
    lighter.body("shank1").mass[0] = quadruped()["shank1"].mass
    largest = {"bias forces": 0.0, "mass matrix": 0.0}
    states = random_states(robot, 20, seed=0)
    for qpos, qvel in zip(states.qpos, states.qvel, strict=True):
        bias, matrices = [], []
        for model in (robot.mj_model, lighter):
            data = mujoco.MjData(model)
            robot.mj_convention.set_state(data, qpos, qvel)
            mujoco.mj_forward(model, data)
            matrix = np.zeros((model.nv, model.nv))
            mujoco.mj_fullM(model, data, matrix)
            bias.append(data.qfrc_bias[robot.mj_convention.qvel_index].copy())
            matrices.append(matrix)
        for name, (one, two) in (("bias forces", bias), ("mass matrix", matrices)):
            largest[name] = max(largest[name], float(np.abs(one - two).max()))
    for name, deviation in largest.items():
        assert effects[name].deviation == pytest.approx(deviation, rel=1e-9)


def test_moved_frame_has_an_effect_on_its_own_position_only(tmp_path: Path) -> None:
    """The foot frame is 3 mm lower: between 3 mm / sqrt(3) and 3 mm along a world axis."""
    moved = [f._replace(position=(0.002, 0.0, -0.203)) if f.name == "foot1" else f for f in FEET]
    files = write(tmp_path, urdf_text(quadruped(), moved), mjcf_text(quadruped()))
    difference = get_difference(explain_differences(match_files(files).robot))
    assert (difference.kind, difference.element, difference.unit) == ("frame", "foot1", "m")
    assert difference.message.startswith("frame foot1 is 3 mm apart: (0.002, 0, -0.203) m in the")
    assert set(difference.effects) == {"foot positions"}
    assert 0.003 / math.sqrt(3) <= difference.effects["foot positions"].deviation <= 0.003


def test_frame_on_another_body_names_both_bodies(tmp_path: Path) -> None:
    moved = [f._replace(link="thigh1") if f.name == "foot1" else f for f in FEET]
    files = write(tmp_path, urdf_text(quadruped(), moved), mjcf_text(quadruped()))
    explanation = explain_differences(match_files(files).robot)
    assert list_differences(explanation) == [("frame", "foot1")]
    message = get_difference(explanation).message
    assert "is on link thigh1 in the URDF, on shank1 in the MJCF" in message
    assert explanation.complete


def test_differences_are_ordered_by_effect_before_limits_and_the_rest(tmp_path: Path) -> None:
    """Masses of 0.27 and 0.1 kg, damping (accelerations alone), limits, and a CoM of 0.1 mm."""
    mjcf = change_part(quadruped(), "base", mass=6.1, com=(0.01, 0.002, -0.0051))
    mjcf = change_part(mjcf, "thigh0", damping=0.15, effort=25.0, lower=-0.7)
    mjcf = change_part(mjcf, "shank3", mass=0.5, friction=0.9)
    explanation = explain_parts(tmp_path, quadruped(), mjcf)
    assert list_differences(explanation) == [
        ("mass", "knee3"),
        ("mass", "base"),
        ("damping", "hip0"),
        ("lower limit", "hip0"),
        ("effort", "hip0"),
        ("com", "base"),
        ("friction", "knee3"),
    ]
    tiers = [difference.tier for difference in explanation.differences]
    assert tiers == [1, 1, 1, 2, 2, 3, 3]


def test_differences_of_a_slide_have_units_of_lengths_and_forces(tmp_path: Path) -> None:
    mjcf = change_part(arm(), "rod", lower=-0.1, effort=7.0, damping=0.3, friction=0.4)
    explanation = explain_parts(tmp_path, arm(), mjcf, free=False)
    units = {difference.kind: difference.unit for difference in explanation.differences}
    assert units == {"lower limit": "m", "effort": "N", "damping": "N s/m", "friction": "N"}
    messages = {difference.kind: difference.message for difference in explanation.differences}
    assert "0 m in the URDF, -0.1 m in the MJCF" in messages["lower limit"]
    assert "0.1 N s/m in the URDF, 0.3 N s/m in the MJCF" in messages["damping"]


def test_any_damping_differs_from_none(tmp_path: Path) -> None:
    bare = all_changed(quadruped(), damping=0.0, friction=0.0)
    assert explain_parts(tmp_path, bare, bare).differences == ()
    damped = explain_parts(tmp_path, bare, change_part(bare, "thigh0", damping=1e-6))
    assert list_differences(damped) == [("damping", "hip0")]


# ------------------------------------------------------------------------------------- completeness


def perturb_parts(parts: Parts, seed: int) -> Parts:
    """Return the parts with random changes of a relative size from 1e-7 to 0.1."""
    random = np.random.default_rng(seed)
    size = 10.0 ** random.uniform(-7, -1)

    def near(values: Any) -> Any:
        return tuple(np.array(values) + size * random.normal(size=len(values)) * 0.1)

    result = {}
    for name, part in parts.items():
        turn = Rotation.from_rotvec(size * random.normal(size=3))
        rotation = Rotation.from_quat(part.quaternion, scalar_first=True) * turn
        factors = dict(
            zip(("mass", "damping", "friction", "effort"), random.normal(size=4), strict=True)
        )
        result[name] = replace(
            part,
            position=near(part.position) if part.parent else part.position,
            quaternion=tuple(rotation.as_quat(scalar_first=True)) if part.parent else (1, 0, 0, 0),
            com=near(part.com),
            axis=near(part.axis),
            lower=part.lower + size * random.normal(),
            inertia=tuple(np.array(part.inertia) * (1 + size * random.normal() * 0.1)),
            **{key: getattr(part, key) * math.exp(size * x) for key, x in factors.items()},
        )
    return result


@pytest.mark.slow
@given(seed=st.integers(0, 10**6), fixed=st.booleans())
def test_models_agree_after_all_differences_are_removed(
    tmp_path_factory: pytest.TempPathFactory, seed: int, fixed: bool
) -> None:
    """After replacing all differing values, both files have equal kinematics and dynamics within
    1e-12; without replacement they deviate.
    """
    folder = tmp_path_factory.getbasetemp()
    parts = arm() if fixed else quadruped()
    explanation = explain_parts(folder, parts, perturb_parts(parts, seed), free=not fixed)
    assert explanation.complete
    assert max(explanation.residual.values()) < 1e-12
    assert max(explanation.deviations.values()) > 1e-9  # there was something to explain


def test_negative_mass_in_one_file_is_named_as_the_only_explanation(tmp_path: Path) -> None:
    """MuJoCo cannot evaluate a body of negative mass; the explanation is evaluated with the values
    of the other file."""
    explanation = explain_parts(
        tmp_path, change_part(quadruped(), "shank0", mass=-1.0), quadruped()
    )
    assert ("mass", "knee0") in list_differences(explanation)
    assert explanation.complete


def test_explanation_is_incomplete_if_mass_differences_are_ignored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Control: without the comparison of masses and inertias, the explanation is incomplete."""
    monkeypatch.setattr(explain_module, "body_changes", lambda *_: iter(()))
    explanation = explain_parts(tmp_path, quadruped(), change_part(quadruped(), "base", mass=6.3))
    assert explanation.differences == ()
    assert not explanation.complete
    assert explanation.residual["gravity"] == pytest.approx(0.3 * GRAVITY / WEIGHT, rel=1e-9)
    assert explanation.residual["gravity"] == explanation.deviations["gravity"]


def test_ignored_damping_leaves_the_explanation_of_a_light_link_incomplete(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A hand of 1e-6 kg has large accelerations, but a damping of 1e-7 N m s/rad is no rounding."""
    hand = Part(
        "hand", "column", "roll", "continuous", (0.3, 0.0, 0.4), axis=(0.0, 0.6, 0.8),
        mass=1e-6, inertia=(1e-9, 1e-9, 1e-9, 0.0, 0.0, 0.0), armature=0.0, damping=0.0,
    )  # fmt: skip
    light = {**arm(), "hand": hand}
    monkeypatch.setattr(explain_module, "_compare_joint_parameters", lambda *_: iter(()))
    damped = change_part(light, "hand", damping=1e-7)
    explanation = explain_parts(tmp_path, light, damped, free=False)
    assert explanation.differences == ()
    assert not explanation.complete
    heavy = change_part(light, "hand", mass=0.5, inertia=(2e-3, 2e-3, 2e-3, 0.0, 0.0, 0.0))
    assert explain_parts(tmp_path, heavy, light, free=False).complete


# ------------------------------------------------------------------------------------- tolerances

SHANK = quadruped()["shank0"]
BASE = quadruped()["base"]


def _add_to_first(values: Any, more: float) -> tuple[float, ...]:
    return (values[0] + more, *values[1:])


BY_TOLERANCE: dict[str, tuple[str, float, Any]] = {
    # kind: the link, the tolerance, how the MJCF's part is changed by x
    "mass": ("base", 1e-4, lambda x: {"mass": BASE.mass / (1 - x)}),
    "com": ("base", 1e-5, lambda x: {"com": _add_to_first(BASE.com, x)}),
    "inertia": ("base", 1e-3, lambda x: {"inertia": _add_to_first(BASE.inertia, 0.1 * x)}),
    "position": ("shank0", 1e-5, lambda x: {"position": _add_to_first(SHANK.position, x)}),
    "rotation": ("shank0", 1e-4, lambda x: {"quaternion": turned_about(SHANK, (1, 0, 0), x)}),
    "axis": ("shank0", 1e-4, lambda x: {"axis": (0.0, math.cos(x), math.sin(x))}),
    "lower limit": ("shank0", 1e-3, lambda x: {"lower": SHANK.lower + x}),
    "upper limit": ("shank0", 1e-3, lambda x: {"upper": SHANK.upper + x}),
    "effort": ("shank0", 1e-3, lambda x: {"effort": SHANK.effort / (1 - x)}),
    "damping": ("shank0", 1e-3, lambda x: {"damping": SHANK.damping / (1 - x)}),
    "friction": ("shank0", 1e-3, lambda x: {"friction": SHANK.friction / (1 - x)}),
}


@pytest.mark.slow
@pytest.mark.parametrize("strict", [False, True])
@pytest.mark.parametrize("kind", BY_TOLERANCE)
def test_each_tolerance_passes_just_below_and_fails_just_above(
    tmp_path: Path, kind: str, strict: bool
) -> None:
    """A difference of 98 % of the tolerance is none; 102 % is reported, for both signs."""
    link, size, change = BY_TOLERANCE[kind]
    tolerances = Tolerances.strict() if strict else Tolerances()
    size = 1e-9 if strict else size
    element = quadruped()[link].joint or "base"
    for factor, expected in ((0.98, []), (1.02, [(kind, element)])):
        for sign in (1, -1):
            mjcf = change_part(quadruped(), link, **change(sign * factor * size))
            assert (
                list_differences(explain_parts(tmp_path, quadruped(), mjcf, tolerances)) == expected
            )


def test_tolerance_of_a_frame_is_that_of_positions(tmp_path: Path) -> None:
    for distance, expected in ((0.98e-5, []), (1.02e-5, [("frame", "foot2")])):
        position = (0.002, 0.0, -0.2 + distance)
        moved = [f._replace(position=position) if f.name == "foot2" else f for f in FEET]
        files = write(tmp_path, urdf_text(quadruped(), moved), mjcf_text(quadruped()))
        assert list_differences(explain_differences(match_files(files).robot)) == expected


def test_tolerances_are_changed_by_name() -> None:
    tolerances = Tolerances().with_values({"mass": 0.01, "com": 0.002})
    assert (tolerances.mass, tolerances.com) == (0.01, 0.002)
    assert tolerances.inertia == Tolerances().inertia


def test_armature_of_a_neck_is_not_compared_with_legs(tmp_path: Path) -> None:
    """As in Apollo, whose neck has as many joints above it as a joint of an arm."""
    neck = Part("head", "base", "neck", position=(0.3, 0.0, 0.4), mass=0.2, armature=0.5)
    nod = Part("face", "head", "nod", position=(0.0, 0.0, 0.05), mass=0.1, armature=0.6)
    parts = quadruped() | {"head": neck, "face": nod}
    explanation = explain_differences(robot_of(tmp_path, parts, parts))
    assert not [d for d in explanation.differences if d.kind == "armature"]


def test_unknown_tolerance_is_refused_with_the_valid_names() -> None:
    with pytest.raises(
        ConfigurationError, match=r"unknown kind 'masses'; valid: mass, com, inertia,"
    ):
        Tolerances().with_values({"masses": 1.0})


@pytest.mark.parametrize("value", [0.0, -1e-3, math.nan, math.inf])
def test_tolerance_that_is_not_positive_and_finite_is_refused(value: float) -> None:
    with pytest.raises(ConfigurationError, match=r"mass=.* is not positive and finite"):
        Tolerances().with_values({"mass": value})


# ------------------------------------------------------------------------------------- words


TURNED = (0.8, 0.1, 0.5, math.sqrt(1 - 0.9))
HINTS: dict[str, tuple[dict[str, Any], dict[str, Any], str, str]] = {
    # the URDF's shank, the MJCF's, the kind, what the message says
    "grams": ({}, {"mass": 200.0}, "mass", "mass 0.2 kg in the URDF, 200 kg in the MJCF (g for"),
    "grams in the other": ({"mass": 200.0}, {}, "mass", "(g for kg?)"),
    "grams of inertia": (
        {"inertia": tuple(1e3 * np.array(SHANK.inertia))},
        {},
        "inertia",
        "(g for kg?)",
    ),
    "percent": ({}, {"mass": 0.25}, "mass", "(+25 %)"),
    "degrees": ({}, {"lower": math.degrees(-2.5)}, "lower limit", "(degrees for radians?)"),
    "degrees rounded": ({"upper": -28.6}, {}, "upper limit", "(degrees for radians?)"),
    "reversed axis": ({}, {"axis": (0, -1, 0)}, "axis", "axis reversed: (0, 1, 0) in the URDF, (0"),
    "turned axis": ({}, {"axis": (1, 1, 0)}, "axis", "axis rotated by 45 deg"),
    "quaternion order": (
        {"quaternion": TURNED},
        {"quaternion": (*TURNED[1:], TURNED[0])},
        "rotation",
        "(another order of the quaternion: MJCF has (w, x, y, z)?)",
    ),
    "type": ({}, {"kind": "prismatic"}, "type", "revolute in the URDF, prismatic in the MJCF"),
    "unlimited": (
        {"kind": "continuous"},
        {},
        "lower limit",
        "unlimited in the URDF, -2.5 rad in the MJCF",
    ),
    "limited": ({}, {"kind": "continuous"}, "upper limit", "-0.5 rad in the URDF, unlimited in"),
}


@pytest.mark.slow
@pytest.mark.parametrize("hint", HINTS)
def test_the_message_gives_both_values_and_the_likely_slip(tmp_path: Path, hint: str) -> None:
    """Slips such as grams for kilograms or degrees for radians; no other difference is reported,
    and the explanation is complete.
    """
    urdf, mjcf, kind, words = HINTS[hint]
    explanation = explain_parts(
        tmp_path,
        change_part(quadruped(), "shank0", **urdf),
        change_part(quadruped(), "shank0", **mjcf),
    )
    messages = {d.kind: d.message for d in explanation.differences if d.element == "knee0"}
    assert words in messages[kind]
    assert explanation.complete
    assert {d.element for d in explanation.differences} == {"knee0"}


def test_no_slip_is_suggested_without_reason(tmp_path: Path) -> None:
    """Values that differ by no typical factor: no message contains a suggestion."""
    mjcf = change_part(quadruped(), "shank0", mass=0.31, com=(0.01, 0.002, -0.1), lower=-2.0)
    mjcf = change_part(mjcf, "shank0", quaternion=turned_about(SHANK, (0, 1, 1), 0.1))
    differences = explain_parts(tmp_path, quadruped(), mjcf).differences
    assert {difference.element for difference in differences} == {"knee0"}
    for difference in differences:
        assert "?" not in difference.message
        assert "opposite sign" not in difference.message
        assert "zero angles" not in difference.message


# ------------------------------------------------------------------------------------- free joint


@pytest.mark.parametrize("base", ["base", "trunk"])
@pytest.mark.parametrize(
    ("word", "kind"), [("frictionloss", "dry friction"), ("stiffness", "spring")]
)
def test_springs_and_friction_of_a_free_joint_are_differences(
    word: str, kind: str, base: str, tmp_path: Path
) -> None:
    """For any name of the base in the MJCF: MuJoCo holds the base by this spring or friction, which
    a URDF cannot state."""
    text = mjcf_text(quadruped()).replace("<freejoint/>", f'<joint type="free" {word}="1.5"/>')
    text = text.replace('<body name="base"', f'<body name="{base}"')
    comparison = compare_files(write(tmp_path, urdf_text(quadruped()), text))
    assert not comparison.agree
    (difference,) = comparison.differences
    assert (difference.kind, difference.element) == (kind, base)
    assert "1.5" in difference.message


def test_armature_of_a_free_joint_is_a_difference_of_the_mass_matrix(tmp_path: Path) -> None:
    """Reference: the diagonal of the mass matrix grows by 0.5; gravity is unchanged."""
    text = mjcf_text(quadruped()).replace("<freejoint/>", '<joint type="free" armature="0.5"/>')
    explanation = explain_differences(
        match_files(write(tmp_path, urdf_text(quadruped()), text)).robot
    )
    difference = get_difference(explanation)
    assert (difference.kind, difference.element) == ("armature", "base")
    assert (difference.urdf, difference.mjcf) == (None, 0.5)
    # On the diagonal alone, and nothing of it weighs.
    assert difference.effects["mass matrix"].deviation == pytest.approx(0.5)
    assert "gravity" not in difference.effects
    assert explanation.complete


@pytest.mark.parametrize(("odd", "wrong"), [("shank0", "left_knee"), ("shank1", "right_knee")])
def test_armature_that_differs_between_left_and_right_is_reported(
    odd: str, wrong: str, tmp_path: Path
) -> None:
    """K1's left knee with ten times the armature; all other pairs are alike."""
    sides = {"hip0": "left_hip", "hip1": "right_hip", "knee0": "left_knee", "knee1": "right_knee"}
    legs = {
        name: replace(part, joint=sides.get(part.joint, part.joint))
        for name, part in quadruped().items()
        if name[-1] not in "23"
    }
    arms = {
        f"{kind}{n}": Part(f"{kind}{n}", "base", f"{side}_{kind}", position=place, armature=0.02)
        for kind, height in (("arm", 0.4), ("wing", 0.2))
        for n, (side, y) in enumerate({"left": 0.3, "right": -0.3}.items())
        for place in [(0.0, y, height)]
    }
    parts = legs | arms
    assert not explain_parts(tmp_path, parts, parts).differences
    difference = get_difference(
        explain_parts(tmp_path, parts, change_part(parts, odd, armature=0.2))
    )
    assert (difference.kind, difference.element) == ("armature", wrong)
    assert (difference.mjcf, "but 0.02 kg m^2 on" in difference.message) == (0.2, True)
    assert (difference.urdf, difference.unit) == (None, "kg m^2")
    assert difference.effects["mass matrix"].deviation == pytest.approx(0.18, rel=1e-9)
    slides = {
        name: replace(part, kind="prismatic", lower=-0.1, upper=0.1) if "shank" in name else part
        for name, part in parts.items()
    }
    slide = get_difference(explain_parts(tmp_path, slides, change_part(slides, odd, armature=0.2)))
    assert (slide.unit, "armature 0.2 kg in" in slide.message) == ("kg", True)


def test_damping_of_a_free_joint_is_a_difference_of_the_accelerations(tmp_path: Path) -> None:
    text = mjcf_text(quadruped()).replace("<freejoint/>", '<joint type="free" damping="0.5"/>')
    files = write(tmp_path, urdf_text(quadruped()), text)
    difference = get_difference(explain_differences(match_files(files).robot))
    assert (difference.kind, difference.element, difference.mjcf) == ("damping", "base", 0.5)
    assert "use <freejoint/>" in difference.message
    assert set(difference.effects) == {"forward dynamics"}
