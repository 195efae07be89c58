"""MJCF elements that a URDF cannot express: found, with effects as in closed forms of a pendulum,
and never reported as AGREE.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import event, example, given, settings
from hypothesis import strategies as st

from pupper_analysis.base.errors import ModelError
from pupper_analysis.robot.compare import mjcf_only as mjcf_only_module
from pupper_analysis.robot.compare.attribution import explain_differences
from pupper_analysis.robot.compare.behaviour import random_states
from pupper_analysis.robot.compare.differences import Effect
from pupper_analysis.robot.compare.mjcf_only import (
    make_passive_model,
    mjcf_only_effects,
    split_mimics,
    without_effects,
)
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.robot.matching.trees import Reference
from pupper_analysis.tools.crosscheck.crosscheck import EXTRAS_EDGE, Comparison
from tests.support.robots import (
    Files,
    all_changed,
    arm,
    change_part,
    compare_files,
    line_at,
    list_differences,
    match_files,
    mjcf_text,
    pendulum,
    quadruped,
    urdf_text,
    write,
)

GRAVITY, LENGTH, MASS = 9.81, 0.5, 2.0  # of the pendulum
ROD = MASS * LENGTH**2 + 1e-3 + 0.01  # its moment of inertia about the hinge, with the rotor

EFFORT = Tolerances().with_values({"effort": 2.0})  # of whatever motors there are

URDF = urdf_text(quadruped())
MJCF = mjcf_text(quadruped())


def replace_once(text: str, **edits: str) -> str:
    """Return the text with ``old`` replaced by ``new``, once; ``old`` has to be there."""
    for old, new in edits.items():
        assert old in text, old
        text = text.replace(old, new, 1)
    return text


def pair(folder: Path, mjcf: str, urdf: str = URDF, **options: Any) -> Comparison:
    return compare_files(write(folder, urdf, mjcf), **options)


def swing(folder: Path, **edits: str) -> tuple[dict[str, Effect], np.ndarray, np.ndarray]:
    """Return effects of the one difference of a pendulum, and the angles and speeds judged at."""
    text = replace_once(mjcf_text(pendulum(), free=False), **edits)
    files = write(folder, urdf_text(pendulum()), text)
    match = match_files(files)
    explanation = explain_differences(
        match.robot, reference=match.reference, mimics=match.robot.description.mimics
    )
    assert explanation.complete
    (difference,) = (item for item in explanation.differences if item.kind != "effort")
    states = random_states(match.robot, 20, seed=0)
    return difference.effects, states.qpos[:, 0], states.qvel[:, 0]


# ------------------------------------------------------------------------------------- closed forms

SWING = '<joint name="swing"'
LIFTED = {'<body name="bob"': '<body name="bob" gravcomp="0.4"'}
DC = '<dcmotor name="dc" joint="swing" gear="3" motorconst="0.5" resistance="2" {}/></actuator>'
EDGE = np.sqrt(6 * 1e-3 / MASS)  # of the cube with the bob's moments: m a^2 / 6 each


def tendon(attributes: str) -> dict[str, str]:
    fixed = f'<tendon><fixed {attributes}><joint joint="swing" coef="-3"/></fixed></tendon>'
    return {"<actuator>": f"{fixed}<actuator>"}


def lift(angle: np.ndarray, _: np.ndarray) -> np.ndarray:
    return 0.4 * MASS * GRAVITY * LENGTH * np.sin(angle)


def back_emf(_: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """It drives K w / R through the winding: a torque of K^2 w / R."""
    return 3**2 * 0.5**2 / 2 * speed


TORQUES: dict[str, tuple[dict[str, str], Callable[[np.ndarray, np.ndarray], np.ndarray]]] = {
    # MuJoCo documentation, "Polynomial": the force is (k0 + k1 x + k2 x^2) x.
    "spring": (
        {SWING: f'{SWING} stiffness="7 2 3"'},
        lambda angle, _: (7 + 2 * angle + 3 * angle**2) * angle,
    ),
    "spring with a rest angle": (
        {SWING: f'{SWING} stiffness="7" springref="0.3"'},
        lambda angle, _: 7 * (angle - 0.3),
    ),
    "damping": (
        {'damping="0.1"': 'damping="0.1 0.2 0.3"'},
        lambda _, speed: (0.2 * np.abs(speed) + 0.3 * speed**2) * speed,
    ),
    "gravity compensation": (LIFTED, lift),
    # Then it is a force of the actuators', which are switched off otherwise.
    "by motors": ({**LIFTED, SWING: f'{SWING} actuatorgravcomp="true"'}, lift),
    "tendon's spring": (
        tendon('stiffness="2" springlength="0.5"'),
        lambda angle, _: 3 * 2 * (-3 * angle - 0.5),
    ),
    "tendon's damping": (tendon('damping="2"'), lambda _, speed: 3 * 2 * 3 * speed),
    # Stokes' drag on the sphere of the same inertia box: 3 pi d mu v, and pi d^3 mu omega (MuJoCo
    # documentation, "Fluid forces: Inertia model"); d is the mean edge of the box.
    "viscosity": (
        {"<worldbody>": '<option viscosity="0.3"/><worldbody>'},
        lambda _, speed: (3 * np.pi * EDGE * 0.3 * LENGTH**2 + np.pi * EDGE**3 * 0.3) * speed,
    ),
    "dc motor": ({"</actuator>": DC.format("")}, back_emf),
    "dc motor without a command": ({"</actuator>": DC.format('input="none"')}, back_emf),
}


@pytest.mark.parametrize("kind", TORQUES)
def test_passive_forces_change_pendulum_acceleration_as_in_closed_form(
    kind: str, tmp_path: Path
) -> None:
    """Closed form: torque(q, qdot) / moment of inertia [rad/s^2], with the polynomials of MuJoCo's
    documentation.
    """
    edits, torque = TORQUES[kind]
    effects, angle, speed = swing(tmp_path, **edits)
    assert set(effects) == {"forward dynamics"}
    effect, expected = effects["forward dynamics"], np.abs(torque(angle, speed) / ROD).max()
    assert (effect.deviation, effect.share) == pytest.approx((expected, 1), rel=1e-9)


def test_armature_of_a_motor_on_a_tendon_counts_with_coef_and_gear_squared(tmp_path: Path) -> None:
    """Closed form: coef^2 gear^2 armature [kg m^2]."""
    edits = tendon('name="t"')
    edits["</actuator>"] = '<motor tendon="t" gear="5" armature="0.02"/></actuator>'
    effects, _, _ = swing(tmp_path, **edits)
    assert effects["mass matrix"].deviation == pytest.approx(3**2 * 5**2 * 0.02, rel=1e-9)


# ------------------------------------------------------------------------------------- one joint's


def test_armature_and_damping_of_a_motor_count_with_the_gear_squared(tmp_path: Path) -> None:
    """Reference: closed form, 0.04 + 2^2 0.015 = 0.1 and 0.002 + 2^2 0.002 = 0.01, and the mass
    matrices of both engines."""
    plain = 'damping="0.1" frictionloss="0.2" armature="0.01"'
    bare = 'damping="0.04" frictionloss="0.2" armature="0.002"'
    motors = MJCF.replace(plain, bare)
    for leg in range(4):
        motor = f'name="m_hip{leg}" joint="hip{leg}"'
        motors = replace_once(
            motors, **{motor: f'{motor} gear="2" damping="0.015" armature="0.002"'}
        )
    # 0.04 + 4 0.015 = 0.1 and 0.002 + 4 0.002 = 0.01; the torques' limits grow with the gear.
    comparison = pair(tmp_path, motors, tolerances=EFFORT)
    assert list_differences(comparison) == []
    assert comparison.agree
    armature = {q.name: q for q in comparison.check.quantities}["armature"]
    assert armature.scale == pytest.approx(0.02)
    assert armature.relative < 1e-12
    assert match_files(
        Files(tmp_path / "robot.urdf", tmp_path / "robot.xml")
    ).robot.pin_model.armature[6:] == pytest.approx([0.01, 0.02] * 4)


# ------------------------------------------------------------------------------------- the verdict

BEFORE, AFTER = "<actuator>", "</worldbody>"


def rope(words: str, *sites: str) -> str:
    """Return a spatial tendon from one site to another."""
    way = "".join(f'<site site="{site}"/>' for site in sites)
    return f"<tendon><spatial {words}>{way}</spatial></tendon>"


def belt(words: str, **joints: float) -> str:
    """Return a fixed tendon."""
    parts = "".join(f'<joint joint="{name}" coef="{by}"/>' for name, by in joints.items())
    return f"<tendon><fixed {words}>{parts}</fixed></tendon>"


def add_equality(kind: str, words: str) -> str:
    return f'{AFTER}<equality><{kind} {words} solref="-{{}} -1"/></equality>'


TWO = {"hip1": 1, "hip2": -2}

PASSIVE = {
    "spring": ("spring", "knee1", 'stiffness="{}" springref="-1.2"'),
    "free spring": ("spring", "<freejoint/>", '<joint type="free" stiffness="{}"/>'),
    "damping polynomial": ("damping polynomial", 'damping="0.1"', 'damping="0.1 0 {}"'),
    "gravity compensation": ("gravity compensation", "shank3", 'gravcomp="{}"'),
    "tendon spring": ("tendon", BEFORE, belt('stiffness="{}"', hip0=1, knee2=2)),
    "spatial spring": ("tendon", BEFORE, rope('stiffness="{}"', "foot0", "foot3")),
    "spatial armature": ("tendon", BEFORE, rope('armature="{}"', "foot1", "foot2")),
    "density": ("fluid", "<worldbody>", '<option density="{}"/><worldbody>'),
    "viscosity": ("fluid", "<worldbody>", '<option viscosity="{}"/><worldbody>'),
    "motor damping": ("damping", "m_hip3", 'damping="{}"'),
    "motor damping polynomial": ("actuator", "m_knee3", 'damping="0 {}"'),
    "spatial damping": ("tendon", BEFORE, rope('damping="{}"', "foot1", "foot3")),
    "tendon damping polynomial": ("tendon", BEFORE, belt('damping="0 {}"', hip1=3)),
    "damping of a tendon's motor": (
        "actuator",
        BEFORE,
        belt('name="pair"', **TWO) + '<actuator><motor tendon="pair" gear="3" damping="{}"/>',
    ),
    "armature of a tendon's motor": (
        "actuator",
        BEFORE,
        rope('name="cord"', "foot1", "foot3")
        + '<actuator><motor tendon="cord" gear="2" armature="{}"/>',
    ),
    "weld": ("equality", AFTER, add_equality("weld", 'body1="base"')),
    "connect": (
        "equality",
        AFTER,
        add_equality("connect", 'body1="shank0" body2="shank1" anchor="0 0 0"'),
    ),
    "joint equality": (
        "equality",
        AFTER,
        add_equality("joint", 'joint1="hip0" joint2="hip1" polycoef="0.1 1 0.2 0 0"'),
    ),
    "tendon equality": (
        "equality",
        AFTER,
        add_equality("tendon", 'tendon1="both"') + belt('name="both"', knee1=1, knee3=-1),
    ),
    "slack": (
        "tendon",
        BEFORE,
        belt('stiffness="{}" springlength="-0.1 0.1"', hip0=1, knee2=-0.5),
    ),
}
"""{passive element: (kind of difference, element or text in the MJCF, inserted text)}."""


def add_acting_element(kind: str, size: str, text: str) -> str:
    """Return the text with an element that acts on the robot."""
    _, where, words = PASSIVE[kind]
    if "<" not in where and "=" not in where:
        where, words = f'name="{where}"', f'name="{where}" {words}'
    elif where == BEFORE and BEFORE not in words:
        words += BEFORE
    return replace_once(text, **{where: words.format(size)})


_PAIR = '<tendon><fixed {}><joint joint="hip0" coef="1"/></fixed></tendon><actuator>'
_OFF = '<option><flag {}="disable"/></option><worldbody>'
UNFELT = {
    "tendon": [
        ("<actuator>", _PAIR.format(attribute))
        for attribute in ('frictionloss="1"', 'range="-1 1"')
    ],
    "flag": [("<worldbody>", _OFF.format(flag)) for flag in ("limit", "frictionloss", "actuation")],
}
"""{kind of difference: edits} that no acceleration of the unconstrained robot feels."""

_DEFAULT = "<default>{}</default><worldbody>"
SILENT = {
    "exclude": (AFTER, f'{AFTER}<contact><exclude body1="base" body2="shank0"/></contact>'),
    "margins": (
        "<worldbody>",
        _DEFAULT.format('<joint margin="0.2"/><geom margin="0.1" gap="0.1"/>'),
    ),
    "gravity compensation of nothing by motors": (
        "<worldbody>",
        _DEFAULT.format('<joint actuatorgravcomp="true"/>'),
    ),
    "softness": (
        "<worldbody>",
        _DEFAULT.format('<geom solref="0.1 2" solimp="0.1 0.2 0.3"/>'),
    ),
    "a free site": (AFTER, f'<site name="there"/>{AFTER}'),
}
"""Edits without effect on the unconstrained robot, or that only change the effect of another
element.
"""


def accelerations(text: str, seed: int) -> np.ndarray:
    """MuJoCo's own qacc (9, nv) of a text, without contacts, limits, dry friction and control."""
    model = mujoco.MjModel.from_xml_string(text)
    off = mujoco.mjtDisableBit
    for bit in (off.mjDSBL_CONTACT, off.mjDSBL_LIMIT, off.mjDSBL_FRICTIONLOSS):
        model.opt.disableflags |= bit.value
    data, random, rows = mujoco.MjData(model), np.random.default_rng(seed), []
    for _ in range(9):
        data.qpos[:] = random.uniform(-1, 1, model.nq)
        data.qpos[3:7] /= np.linalg.norm(data.qpos[3:7])
        data.qvel[:] = random.normal(size=model.nv)
        mujoco.mj_forward(model, data)
        rows.append(data.qacc.copy())
    return np.array(rows)


@pytest.mark.slow
@settings(max_examples=60)
@given(
    chosen=st.dictionaries(
        st.sampled_from(sorted(PASSIVE)), st.floats(-9, 3).map(lambda x: 10.0**x), max_size=3
    ),
    silent=st.sets(st.sampled_from(sorted(SILENT)), max_size=2),
    seed=st.integers(0, 1000),
)
@example(chosen={"spring": 1500.0}, silent=set(), seed=0)
@example(chosen={"tendon spring": 3.0, "spatial armature": 0.2}, silent=set(), seed=0)
@example(chosen={"gravity compensation": 0.5}, silent=set(SILENT), seed=0)
@example(chosen={"connect": 1e-9, "weld": 1e-9}, silent=set(), seed=0)
@example(chosen={}, silent=set(SILENT), seed=0)
@example(chosen={}, silent=set(), seed=0)
def test_files_do_not_agree_if_mujoco_accelerates_differently(
    tmp_path_factory: pytest.TempPathFactory, chosen: dict[str, float], silent: set[str], seed: int
) -> None:
    """Reference: MuJoCo's qacc of both texts at random states, with the tolerance of the
    dynamics.
    """
    text = MJCF
    for kind, size in chosen.items():
        text = add_acting_element(kind, repr(size), text)
    for kind in sorted(silent):
        old, new = SILENT[kind]
        text = replace_once(text, **{old: new})
    plain = accelerations(MJCF, seed)
    deviation = np.abs(accelerations(text, seed) - plain).max() / np.abs(plain).max()
    comparison = pair(tmp_path_factory.getbasetemp(), text)
    differs = bool(deviation > Tolerances().dynamics)
    event(f"agree={comparison.agree}, differs={differs}")
    assert not (comparison.agree and differs)
    assert comparison.complete, comparison.objections
    if not chosen:
        assert comparison.agree
        assert not differs


@pytest.mark.slow
@pytest.mark.parametrize("kind", PASSIVE)
def test_passive_force_is_the_first_difference_and_engines_agree(kind: str, tmp_path: Path) -> None:
    """Both engines agree on each file within 1e-12, so the file is the cause."""
    comparison = pair(tmp_path, add_acting_element(kind, "0.5", MJCF))
    assert comparison.engines == ()
    assert not comparison.agree
    assert comparison.complete
    assert list_differences(comparison)[0][0] == PASSIVE[kind][0]
    edges = {q.name: q.edge_deviations for q in comparison.check.quantities}["forward dynamics"]
    assert edges["engines (MJCF)"] < 1e-12
    assert edges["engines (URDF)"] < 1e-12
    # Joint parameters are a difference of the models; parameters that a URDF cannot state are not.
    assert edges["models (MuJoCo)" if kind == "motor damping" else EXTRAS_EDGE] > 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("kind", UNFELT)
def test_attribute_without_effect_on_acceleration_is_still_a_difference(
    kind: str, tmp_path: Path
) -> None:
    """Dry friction and ranges of tendons, and disable flags: reported with no effects."""
    for old, new in UNFELT[kind]:
        comparison = pair(tmp_path, replace_once(MJCF, **{old: new}))
        assert [one for one, _ in list_differences(comparison)] == [kind], new
        assert comparison.complete
        assert comparison.differences[0].effects == {}


FINDERS = {
    "of_joints": "spring",
    "of_bodies": "gravity compensation",
    "of_tendons": "spatial spring",
    "of_actuators": "motor damping polynomial",
    "find_fluid": "density",
}
"""{function that finds elements: kind in ``PASSIVE``}."""


@pytest.mark.parametrize("finder", FINDERS)
def test_force_of_an_element_that_is_not_found_leaves_a_deviation_unexplained(
    finder: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reference: MuJoCo's own dynamics, which do not depend on the functions that find elements."""
    monkeypatch.setattr(mjcf_only_module, finder, lambda _: iter(()))
    comparison = pair(tmp_path, add_acting_element(FINDERS[finder], "5", MJCF))
    assert comparison.differences == ()
    assert not comparison.agree
    assert not comparison.complete
    assert comparison.explained < 0.5
    (objection,) = comparison.objections
    assert objection.code == "deviation-unexplained"
    assert comparison.engines == ()


def test_flex_between_bodies_of_the_robot_is_refused_by_name(tmp_path: Path) -> None:
    """A URDF has no flex, and the vertices of a flex would count as bodies of the robot."""
    rope = (
        '<deformable><flex name="rope" dim="1" body="shank0 shank1 shank2" '
        'vertex="0 0 0 0 0 0 0 0 0" element="0 1 1 2"><edge stiffness="50" damping="2"/></flex>'
        "</deformable>"
    )
    with pytest.raises(ModelError, match=r"robot\.xml: .*flex rope"):
        pair(tmp_path, mjcf_text(quadruped(), extra=rope))


def test_spring_of_a_slide_of_a_fixed_robot_is_the_only_difference(tmp_path: Path) -> None:
    text = replace_once(
        mjcf_text(arm(), free=False),
        **{'<joint name="push"': '<joint name="push" stiffness="30"'},
    )
    comparison = pair(tmp_path, text, urdf_text(arm()))
    assert list_differences(comparison) == [("spring", "push")]
    assert "stiffness 30" in comparison.differences[0].message
    assert comparison.complete


def test_small_differences_that_add_up_are_no_agreement(tmp_path: Path) -> None:
    """A com is off by 9 um, within the tolerance; but the pendulum is 1 mm long."""
    tiny = {"com": (0.0, 0.0, -1e-3), "inertia": (1e-9, 1e-9, 1e-9, 0, 0, 0), "armature": 0.0}
    urdf, other = pendulum(**tiny), pendulum(**{**tiny, "com": (0.0, 0.0, -1.009e-3)})
    files = write(tmp_path, urdf_text(urdf), mjcf_text(other, free=False))
    comparison = compare_files(files)
    assert comparison.differences == ()
    assert comparison.complete
    assert not comparison.agree
    assert ("tolerances-add-up", "gravity") in [
        (message.code, message.subject.name) for message in comparison.objections
    ]
    assert compare_files(files, tolerances=Tolerances().with_values({"dynamics": 0.05})).agree


@pytest.mark.parametrize("gravity", [9.8, 9.80665, 9.81])
def test_usual_gravities_agree_unless_strict(tmp_path: Path, gravity: float) -> None:
    text = replace_once(MJCF, **{"<worldbody>": f'<option gravity="0 0 -{gravity}"/><worldbody>'})
    assert pair(tmp_path, text).agree
    assert pair(tmp_path, text, tolerances=Tolerances.strict()).agree == (gravity == 9.81)


def test_forces_of_a_controlled_motor_are_no_difference(tmp_path: Path) -> None:
    """They depend on the command; the motor has no torque limit any more."""
    text = mjcf_text(pendulum(), free=False)
    for motor in (
        DC.format('input="pos" controller="10 0 0"'),
        '<position joint="swing" kp="30" kv="2"/></actuator>',
        '<velocity joint="swing" kv="2"/></actuator>',
    ):
        mjcf = replace_once(text, **{"</actuator>": motor})
        comparison = pair(tmp_path, mjcf, urdf_text(pendulum()))
        assert list_differences(comparison) == [("effort", "swing")], motor
        assert max(comparison.deviations.values()) < 1e-12, motor


def test_inactive_equality_is_no_difference(tmp_path: Path) -> None:
    extra = '<equality><joint joint1="hip0" joint2="hip1" active="false"/></equality>'
    assert pair(tmp_path, mjcf_text(quadruped(), extra=extra)).agree


@pytest.mark.parametrize("integrator", ["Euler", "RK4", "implicit", "implicitfast", "discrete"])
def test_integrator_makes_no_difference(tmp_path: Path, integrator: str) -> None:
    """MuJoCo's ``discrete`` includes the time step in qacc."""
    option = f'<option integrator="{integrator}"/><worldbody>'
    assert pair(tmp_path, replace_once(MJCF, **{"<worldbody>": option})).agree


def test_model_without_effects_has_linear_damping_only() -> None:
    """Reference: MuJoCo's passive forces equal -damping qvel; the original is unchanged."""
    text = MJCF
    for kind in ("spring", "gravity compensation", "spatial spring", "viscosity"):
        text = add_acting_element(kind, "2", text)
    model = mujoco.MjModel.from_xml_string(text)
    names = tuple(f"{part}{leg}" for leg in range(4) for part in ("hip", "knee"))
    reference = Reference(model, model, names, "base")
    effects = mjcf_only_effects(reference)
    assert len(effects) == 4
    for bare, is_bare in (
        (without_effects(model, effects), True),
        (make_passive_model(model), False),
    ):
        data = mujoco.MjData(bare)
        data.qpos[7:], data.qvel[:] = 0.3, 1.0
        mujoco.mj_forward(bare, data)
        damping = -bare.dof_damping * data.qvel
        assert np.allclose(data.qfrc_passive, damping, rtol=0, atol=1e-15) == is_bare
    assert model.opt.viscosity == 2.0


def test_impossible_inertials_of_a_urdf_are_differences(tmp_path: Path) -> None:
    wrong = change_part(quadruped(), "shank1", inertia=(-0.1, 0.1, 0.1, 0, 0, 0))
    comparison = pair(tmp_path, MJCF, urdf_text(wrong))
    assert list_differences(comparison)[0] == ("inertia", "knee1")
    assert comparison.complete
    lighter = change_part(quadruped(), "shank1", mass=-0.3)
    assert ("mass", "knee1") in list_differences(pair(tmp_path, MJCF, urdf_text(lighter)))


# ------------------------------------------------------------------------------------- couplings


SAME = '<joint joint1="knee0" joint2="hip0" polycoef="0.1 2 0 0 0"/>'
OTHER = {
    "another factor": '<joint joint1="knee0" joint2="hip0" polycoef="0.1 2.01 0 0 0"/>',
    "another offset": '<joint joint1="knee0" joint2="hip0" polycoef="-0.1 2 0 0 0"/>',
    "backwards, wrongly": '<joint joint1="hip0" joint2="knee0" polycoef="0.1 2 0 0 0"/>',
    "another joint": '<joint joint1="knee0" joint2="hip1" polycoef="0.1 2 0 0 0"/>',
    "a parabola": '<joint joint1="knee0" joint2="hip0" polycoef="0.1 2 0.1 0 0"/>',
    "a curve of the fourth order": '<joint joint1="knee0" joint2="hip0" polycoef="0.1 2 0 0 0.1"/>',
}


KNEE = '<joint name="knee0" type="revolute">'
MIMIC = {KNEE: f'{KNEE}<mimic joint="hip0" multiplier="2" offset="0.1"/>'}


@pytest.mark.slow
def test_mimic_without_equal_equality_is_a_difference(
    tmp_path: Path,
) -> None:
    """An equality with the same polynomial agrees; six different ones do not, with both lines."""
    urdf = replace_once(URDF, **MIMIC)
    places = {"robot.urdf": tmp_path / "robot.urdf", "robot.xml": tmp_path / "robot.xml"}
    assert list_differences(pair(tmp_path, MJCF, urdf)) == [("mimic", "knee0")]
    for name, equality in {"": SAME, **OTHER}.items():
        text = replace_once(
            MJCF, **{"</worldbody>": f"</worldbody><equality>{equality}</equality>"}
        )
        comparison = pair(tmp_path, text, urdf)
        by_kind = {difference.kind: difference for difference in comparison.differences}
        assert set(by_kind) == ({"mimic", "equality"} if name else set()), name
        if name:
            assert line_at(by_kind["mimic"].urdf_place, places) == MIMIC[KNEE]
            assert equality in line_at(by_kind["equality"].mjcf_place, places)
            assert by_kind["equality"].effects["forward dynamics"].relative > 1e-3


def test_mimic_with_another_factor_states_both_couplings(tmp_path: Path) -> None:
    """The MJCF couples the same two joints, with knee0 = 2.01 hip0 + 0.1, and the inverse."""
    urdf = replace_once(URDF, **MIMIC)
    inverse = '<joint joint1="hip0" joint2="knee0" polycoef="-0.05 0.4 0 0 0"/>'
    for equality, in_mjcf, factor, constant in (
        (OTHER["another factor"], "knee0 = 2.01 hip0 + 0.1", "2.01", "0.1"),
        (inverse, "knee0 = 2.5 hip0 + 0.125", "2.5", "0.125"),
    ):
        text = replace_once(
            MJCF, **{"</worldbody>": f"</worldbody><equality>{equality}</equality>"}
        )
        messages = {
            difference.kind: difference.message
            for difference in pair(tmp_path, text, urdf).differences
        }
        assert messages["mimic"].endswith(f"in the MJCF as well (times {factor}, plus {constant})")
        assert f"{in_mjcf} in the MJCF, 2 hip0 + 0.1 in the URDF" in messages["equality"]


def test_the_offset_of_an_equality_is_about_the_rest_position(tmp_path: Path) -> None:
    """q - q0 = a0 + a1 (q' - q0'): MuJoCo's own residual is zero on the mimic's line."""
    text = """<mujoco><compiler angle="radian"/><worldbody><body name="base">
      <joint name="a" ref="0.3"/><geom size="1"/>
      <body><joint name="b" ref="-0.2"/><geom size="1"/></body></body></worldbody>
      <equality><joint joint1="b" joint2="a" polycoef="0.4 2 0 0 0"/></equality></mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    reference = Reference(model, model, ("a", "b"), "base")
    multiplier, offset = 2.0, 0.4 - 0.2 - 2 * 0.3
    data = mujoco.MjData(model)
    data.qpos[:] = 0.7, multiplier * 0.7 + offset
    mujoco.mj_forward(model, data)
    assert data.efc_pos[0] == pytest.approx(0, abs=1e-12)
    same, left = split_mimics(
        mjcf_only_effects(reference), reference, {"b": ("a", multiplier, offset)}, 1e-9
    )
    assert (len(same), left) == (1, [])


# ------------------------------------------------------------------------------------- scenes

BALL = '<body name="ball"><freejoint/><geom size="0.1"/><site name="end"/></body>'
MOCAP = '<body name="hand" mocap="true"/>'
DOOR = (
    '<body name="door" gravcomp="1"><joint name="hinge" axis="0 0 1" stiffness="3"/>'
    '<geom size="1"/></body>'
)


CLOTH = (
    '<flexcomp name="cloth" type="grid" count="3 3 1" spacing=".05 .05 .05" dim="2" pos="4 4 4" '
    'mass="1" radius=".01"><edge equality="true"/></flexcomp>'
)
HINGED = (
    '<tendon><fixed stiffness="4"><joint joint="hinge" coef="1"/></fixed></tendon>'
    '<equality><weld body1="ball" body2="hand"/></equality>'
)


@pytest.mark.parametrize(("scene", "extra"), [(BALL + MOCAP + DOOR, HINGED), (CLOTH, "")])
def test_elements_of_other_objects_are_no_difference_of_the_robot(
    scene: str, extra: str, tmp_path: Path
) -> None:
    """A ball, a mocap body and a door; and a cloth, whose edges are an equality constraint."""
    assert pair(tmp_path, mjcf_text(quadruped(), scene=scene, extra=extra)).agree


@pytest.mark.parametrize("inertial", ["", '<inertial pos="0 0 0" mass="3" diaginertia="1 1 1"/>'])
def test_mocap_body_adds_no_mass_to_a_fixed_base(inertial: str, tmp_path: Path) -> None:
    target = f'<body name="hand" mocap="true">{inertial}<geom size="0.1"/></body>'
    text = mjcf_text(arm(), free=False, scene=target)
    assert pair(tmp_path, text, urdf_text(arm())).agree


@pytest.mark.parametrize(
    ("extra", "kind"),
    [
        ('<equality><weld body1="base" body2="hand"/></equality>', "equality"),
        ('<equality><connect body1="ball" body2="base" anchor="0 0 0"/></equality>', "equality"),
        (
            '<tendon><spatial stiffness="4"><site site="end"/><site site="foot1"/></spatial>'
            "</tendon>",
            "tendon",
        ),
    ],
)
def test_equality_between_robot_and_object_is_a_difference(
    extra: str, kind: str, tmp_path: Path
) -> None:
    """The comparison removes the object from the scene, and must not lose the constraint force on
    the robot.
    """
    text = mjcf_text(quadruped(), scene=BALL + MOCAP, extra=extra)
    comparison = pair(tmp_path, text)
    assert [difference.kind for difference in comparison.differences] == [kind]
    assert comparison.complete
    assert comparison.differences[0].effects["forward dynamics"].relative > 1e-3


# ------------------------------------------------------------------------------------- switches


@pytest.mark.slow
def test_disable_flags_remove_the_forces_that_the_file_states(tmp_path: Path) -> None:
    """A disabled spring, damper or gravity counts as absent: the files agree if the URDF has none
    either, and a tendon keeps its other force.
    """

    def flagged(word: str, text: str = MJCF) -> Comparison:
        option = f'<option><flag {word}="disable"/></option><worldbody>'
        return pair(tmp_path, replace_once(text, **{"<worldbody>": option}))

    spring = replace_once(MJCF, **{'<joint name="hip0"': '<joint name="hip0" stiffness="9"'})
    assert flagged("spring", spring).agree
    assert {kind for kind, _ in list_differences(flagged("damper"))} == {"damping"}
    assert list_differences(flagged("gravity")) == [("gravity", "option")]
    undamped = urdf_text(all_changed(quadruped(), damping=0.0))
    option = '<option><flag damper="disable"/></option><worldbody>'
    assert pair(tmp_path, replace_once(MJCF, **{"<worldbody>": option}), undamped).agree
    cord = replace_once(MJCF, **{BEFORE: belt('stiffness="2" damping="3"', hip0=1) + BEFORE})
    for word, left, gone in (
        ("spring", "damping", "stiffness"),
        ("damper", "stiffness", "damping"),
    ):
        (tendon,) = (
            difference
            for difference in flagged(word, cord).differences
            if difference.kind == "tendon"
        )
        assert (left in tendon.message, gone in tendon.message) == (True, False)


def test_armature_of_a_tendon_counts_with_coef_squared(tmp_path: Path) -> None:
    """Closed form: 3^2 0.02 kg m^2."""
    effects, _, _ = swing(tmp_path, **tendon('armature="0.02"'))
    assert effects["mass matrix"].deviation == pytest.approx(3**2 * 0.02, rel=1e-9)
    assert effects["mass matrix"].relative == pytest.approx(3**2 * 0.02 / ROD, rel=1e-9)


def test_gravity_of_the_mjcf_is_compared_with_that_of_the_earth(tmp_path: Path) -> None:
    """Closed form of a pendulum: (9.81 - 1.62) m l sin(q)."""
    edits = {"<worldbody>": '<option gravity="0 0 -1.62"/><worldbody>'}
    effects, angle, _ = swing(tmp_path, **edits)
    expected = np.abs((GRAVITY - 1.62) * MASS * LENGTH * np.sin(angle)).max()
    assert effects["gravity"].deviation == pytest.approx(expected, rel=1e-9)
