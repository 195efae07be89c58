"""Contact parameters combined from two geoms, compared with MuJoCo's own contacts."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import pupper_analysis as pa
from pupper_analysis.robot import contact
from pupper_analysis.robot.build import rebuild_robot
from pupper_analysis.simulation.monitor import find_light_bodies
from tests.support.engines import evaluate_mujoco
from tests.support.variants import load

positive = st.floats(0.001, 2.0)
geoms = st.fixed_dictionaries(
    {
        "priority": st.integers(0, 1),
        "condim": st.sampled_from([1, 3, 4, 6]),
        "friction": st.tuples(positive, positive, positive),
        "solmix": st.one_of(st.just(0.0), st.floats(0.1, 10.0)),
        "solref": st.one_of(
            st.tuples(st.floats(0.005, 0.1), st.floats(0.1, 2.0)),
            st.tuples(st.floats(-5000.0, -10.0), st.floats(-100.0, -1.0)),
        ),
        "solimp": st.tuples(
            st.floats(0.1, 0.8),
            st.floats(0.85, 0.99),
            st.floats(0.001, 0.02),
            st.floats(0.2, 0.8),
            st.floats(1.0, 3.0),
        ),
    }
)


def ball_on_plane(ball: dict[str, object], plane: dict[str, object]) -> mujoco.MjModel:
    def attributes(values: dict[str, object]) -> str:
        texts = (
            (name, " ".join(map(repr, value)) if isinstance(value, tuple) else repr(value))
            for name, value in values.items()
        )
        return " ".join(f'{name}="{text}"' for name, text in texts)

    return mujoco.MjModel.from_xml_string(
        f"""<mujoco><worldbody>
        <geom name="plane" type="plane" size="1 1 1" {attributes(plane)}/>
        <body pos="0 0 0.099"><freejoint/>
          <geom name="ball" type="sphere" size="0.1" {attributes(ball)}/></body>
        </worldbody></mujoco>"""
    )


@pytest.mark.slow
@settings(max_examples=100)
@given(ball=geoms, plane=geoms)
def test_combined_contact_parameters_equal_mujoco(
    ball: dict[str, object], plane: dict[str, object]
) -> None:
    """References: dim, friction, solref and solimp of `data.contact`; the order of the geoms has no
    effect.
    """
    model = ball_on_plane(ball, plane)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    ours = contact.combine_geoms(model, model.geom("ball").id, model.geom("plane").id)
    swapped = contact.combine_geoms(model, model.geom("plane").id, model.geom("ball").id)
    assert ours.condim == data.contact.dim[0]
    np.testing.assert_allclose(ours.friction, data.contact.friction[0], rtol=1e-12)
    np.testing.assert_allclose(ours.solref, data.contact.solref[0], rtol=1e-12)
    np.testing.assert_allclose(ours.solimp, data.contact.solimp[0], rtol=1e-12)
    np.testing.assert_allclose(swapped.solimp, ours.solimp, rtol=1e-12)


def test_contact_of_condim_1_has_no_sliding_friction() -> None:
    values = {"condim": 1, "friction": (0.7, 0.1, 0.1)}
    model = ball_on_plane(values, values)
    assert contact.combine_geoms(model, 0, 1).sliding_friction == 0.0
    values["condim"] = 3
    assert contact.combine_geoms(ball_on_plane(values, values), 0, 1).sliding_friction == 0.7


@pytest.mark.parametrize("friction", [0.0, 1e-9, 1e-5])
def test_friction_up_to_the_minimum_of_mujoco_is_no_friction(friction: float) -> None:
    """Reference: a sliding ball, which MuJoCo decelerates by 1e-5 g for each of these values."""
    values = {"condim": 3, "friction": (friction, 0.0, 0.0)}
    model = ball_on_plane(values, values)
    assert contact.combine_geoms(model, 0, 1).sliding_friction == 0.0
    data = mujoco.MjData(model)
    data.qvel[0] = 1.0
    mujoco.mj_forward(model, data)
    force = np.zeros(6)
    mujoco.mj_contactForce(model, data, 0, force)
    assert force[0] > 0
    assert np.hypot(*force[1:3]) == pytest.approx(mujoco.mjMINMU * force[0], rel=1e-6)
    values["friction"] = (2e-5, 0.0, 0.0)
    rough = contact.combine_geoms(ball_on_plane(values, values), 0, 1)
    assert rough.sliding_friction == 2e-5
    negative = replace(rough, friction=(-1.0, -1.0, 0.0, 0.0, 0.0))
    assert negative.sliding_friction == -1.0


def test_foot_contacts_of_a_robot_equal_mujoco(robot: pa.Robot, stand: pa.Stand) -> None:
    """Reference: the four contacts in MuJoCo's data with the feet 1 mm deeper.

    Each foot has its own friction, so that exchanged feet are found.
    """
    spec = robot.description.mjcf.copy()
    for number, geom in enumerate(robot.foot_geoms):
        spec.geoms[geom].friction = (1.1 + 0.1 * number, 0.03, 0.01)
    robot = rebuild_robot(robot, mjcf=spec)
    mj = evaluate_mujoco(robot, stand.qpos - np.eye(robot.nq)[2] * 1e-3)
    assert mj.ncon == 4
    theirs = mj.contact
    for index, pair in enumerate(theirs.geom.tolist()):
        (foot,) = (robot.foot_geoms[geom] for geom in pair if geom in robot.foot_geoms)
        ours = robot.contacts[foot]
        assert ours.condim == theirs.dim[index]
        for field in ("friction", "solref", "solimp"):
            np.testing.assert_allclose(getattr(ours, field), getattr(theirs, field)[index])
    assert len({ours.friction[0] for ours in robot.contacts.values()}) == 4


def test_contact_in_the_gap_beyond_the_margin_is_no_contact() -> None:
    """MuJoCo detects both boxes, but exerts a force on the lower one only (``efc_address``)."""
    box = '<freejoint/><geom name="{}" type="box" size=".1 .1 .1" margin=".001" gap=".5"/>'
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><worldbody><geom type="plane" size="1 1 1"/>
        <body name="near" pos="0 0 .099">{box.format("near")}</body>
        <body name="far" pos="1 0 .3">{box.format("far")}</body></worldbody></mujoco>"""
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    acting = contact.find_acting_contacts(data)
    assert acting.tolist() == (data.contact.efc_address >= 0).tolist()
    assert sorted({*acting.tolist()}) == [False, True]
    assert contact.bodies_on_ground(model, data, {}) == {"near"}
    assert contact.ground_forces(model, data, {})[1] == {"near"}
    assert find_light_bodies(model, data) == ()
    forces, others = contact.ground_forces(model, data, {model.geom("far").id: "far foot"})
    assert not forces
    assert others == {"near"}


@pytest.mark.parametrize(("name", "friction", "condim"), [("v3", 1.0, 6), ("original", 1.2, 3)])
def test_friction_of_feet_and_floor_is_the_larger_one(
    name: str, friction: float, condim: int
) -> None:
    """v3: 0.8 of the feet and 1.0 of the floor; the skeleton: 1.2 of the feet."""
    robot = load(name)
    for foot in robot.contact_points:
        assert robot.contacts[foot].sliding_friction == friction
        assert robot.contacts[foot].condim == condim
    if name == "v3":  # the mean of 0.015 of the foot and 0.9 of the floor
        assert robot.contacts["FR"].solimp[0] == pytest.approx(0.4575)


def test_ground_is_the_plane_fixed_to_the_world() -> None:
    model = load("v3").mj_model
    ground = contact.ground_geom(model)
    assert ground is not None
    assert model.geom(ground).name == "floor"
    bare = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><geom type='box' size='1 1 1'/></worldbody></mujoco>"
    )
    assert contact.ground_geom(bare) is None


def test_foot_geom_is_the_colliding_sphere_at_the_site() -> None:
    """Not the visual sphere at the same position."""
    robot = load("v3")
    model = robot.mj_model
    site = model.site(robot.contact_frames["FR"])
    body = int(site.bodyid[0])
    found = contact.foot_geom(model, body, site.pos)
    assert found is not None
    assert model.geom_conaffinity[found] == 1
    assert contact.foot_geom(model, body, site.pos + np.array([0, 0, 1e-5])) is None
    assert contact.foot_geom(model, 0, site.pos) is None
