"""Stands of public robots with hands on tables and feet on roofs and walls; MuJoCo's nudged
simulation is the reference. For the sources of the files see ``test_real_robots``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cache

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.touching import with_contacts
from pupper_analysis.stance.problem import default_contact_position
from tests.robots.test_real_robots import LAB, MJCF, URDF, file
from tests.stance.test_welds import compute_least_torque
from tests.support.variants import load

Contacts = Mapping[str, pa.Contact | pa.Weld]
UP, WALL = (0.0, 0.0, 1.0), (-1.0, 0.0, 0.0)
EXACT, CREEPING = 1e-6, 1e-2
"""Upper bounds of the relative torque and force errors. A steep foot beside level feet creeps."""


@cache
def robot(name: str) -> pa.Robot:
    if name == "v3":
        return load("v3")
    places = {
        "g1": (LAB, "unitree_g1/xmls/g1.xml"),
        "go2": (MJCF, "go2/go2.xml"),
        "ur5": (URDF, "ur_description/urdf/ur5_robot.urdf"),
        "panda": (URDF, "panda_description/urdf/panda.urdf"),
    }
    return pa.load_robot(file(*places[name]))


def touch_with_hand(
    name: str, normal: tuple[float, float, float], away: float = 0.0
) -> Callable[..., Contacts]:
    """Return a contact of a hand with a plane at its home pose, or ``away`` [m] along the
    normal.
    """

    def make(of: pa.Robot) -> Contacts:
        there = with_contacts(of, {name: pa.Contact(pa.Plane((0, 0, 0), normal))})
        out = np.array(normal)
        point = default_contact_position(there, name) + (away - there.contact_radius[name]) * out
        return {name: pa.Contact(pa.Plane(tuple(point.tolist()), normal, 0.6))}

    return make


def touch_with_palms(of: pa.Robot) -> Contacts:
    return {**touch_with_hand("left_palm", UP)(of), **touch_with_hand("right_palm", UP)(of)}


def slope_sides(
    degrees: float, friction: float | None = None, feet: int = 4
) -> Callable[..., Contacts]:
    """Return contacts of left and right feet on planes that rise towards the middle (a roof) or, if
    ``degrees`` is negative, away from it.
    """

    def make(of: pa.Robot) -> Contacts:
        tilt, found = math.radians(degrees), {}
        for foot, place in list(pa.solve_stand(of).contact_points.items())[:feet]:
            side = math.copysign(1.0, place[1])
            ridge = (0.0, 0.0, abs(float(place[1])) * math.tan(tilt))
            normal = (0.0, side * math.sin(tilt), math.cos(tilt))
            found[foot] = pa.Contact(pa.Plane(ridge, normal, friction))
        return found

    return make


def raise_front_foot(degrees: float) -> Callable[..., Contacts]:
    """Return a contact of the front right foot on a plane that rises forward and is 0.1 stand
    heights above the others.
    """

    def make(of: pa.Robot) -> Contacts:
        tilt, rise = math.radians(degrees), 0.1 * of.stand_height
        place = pa.solve_stand(of).contact_points["FR"] + (0.01, 0.0, rise)
        normal = (-math.sin(tilt), 0.0, math.cos(tilt))
        return {"FR": pa.Contact(pa.Plane(tuple(place.tolist()), normal), tuple(place.tolist()))}

    return make


def bolt_arm(hand: str, *place: float, force: float | None = None) -> Callable[..., Contacts]:
    """Return contacts of an arm: a welded base, and a hand on a table at a place [m]."""
    x, y, height = place
    table = pa.Plane((0, 0, height), UP, 0.6)
    arm = {"base": pa.Weld(), hand: pa.Contact(table, (x, y, height), force=force)}
    return lambda _: arm


def weld_parts(*parts: str) -> Callable[..., Contacts]:
    return lambda _: dict.fromkeys(parts, pa.Weld())


STANCES = {
    "g1, table": ("g1", touch_with_hand("left_palm", UP), EXACT),
    "g1, table higher": ("g1", touch_with_hand("left_palm", UP, 0.03), EXACT),
    "g1, table lower": ("g1", touch_with_hand("left_palm", UP, -0.02), EXACT),
    "g1, other hand": ("g1", touch_with_hand("right_palm", UP), EXACT),
    "g1, wall": ("g1", touch_with_hand("left_palm", WALL), EXACT),
    "g1, both hands": ("g1", touch_with_palms, EXACT),
    **{f"{name}, roof": (name, slope_sides(30), EXACT) for name in ("v3", "go2")},
    **{f"{name}, gutter": (name, slope_sides(-30), EXACT) for name in ("v3", "go2")},
    **{f"{name}, slippery roof": (name, slope_sides(20, 0.5), EXACT) for name in ("v3", "go2")},
    **{f"{name}, half a roof": (name, slope_sides(20, feet=2), EXACT) for name in ("v3", "go2")},
    **{f"{name}, ramp": (name, raise_front_foot(10), CREEPING) for name in ("v3", "go2")},
    **{f"{name}, wall": (name, raise_front_foot(90), EXACT) for name in ("v3", "go2")},
    "go2, steep ramp": ("go2", raise_front_foot(45), CREEPING),
    "ur5, table": ("ur5", bolt_arm("tool0", 0.4, 0.2, 0.3), EXACT),
    "ur5, pressing": ("ur5", bolt_arm("tool0", 0.4, -0.2, 0.2, force=30.0), EXACT),
    "panda, pressing": ("panda", bolt_arm("panda_leftfinger", 0.4, 0.1, 0.3, force=20.0), EXACT),
    "go2, bolted": ("go2", weld_parts("base"), EXACT),
    "go2, by a foot": ("go2", weld_parts("FL"), EXACT),
    "g1, by a foot": ("g1", weld_parts("right_ankle_roll_link"), EXACT),
}


@pytest.mark.slow
@pytest.mark.parametrize("stance", STANCES)
def test_stances_on_stated_contacts_hold_in_mujoco(stance: str) -> None:
    """Reference: MuJoCo's nudged simulation. Contact points are on their planes within 1 nm;
    relative torque and force errors are below the limit of the stance.
    """
    name, make, within = STANCES[stance]
    of = robot(name)
    contacts = make(of)
    stand = pa.solve_stand_as_simulated(of, pa.StandTask(contacts=contacts))
    for link, contact in contacts.items():
        if isinstance(contact, pa.Weld):
            continue
        for point in stand.check(of).feet[link]:
            assert contact.plane.signed_distance(stand.contact_points[point]) == pytest.approx(
                0, abs=1e-9
            )
    found = pa.verify_stand(of, stand)
    assert found.passed, [str(failure) for failure in found.failures]
    assert found.torque_error < within
    assert found.force_error < within


@pytest.mark.slow
def test_g1_hangs_back_on_a_ladder() -> None:
    """Soles are on two rungs, and both hands around a third rung. The hands pull, since the CoM is
    behind the heels. Reference: MuJoCo's simulation.
    """
    g1, contacts = robot("g1"), dict[str, pa.Contact | pa.Weld]()
    there = with_contacts(g1, touch_with_palms(g1))
    for palm in ("left_palm", "right_palm"):
        x, y, z = (default_contact_position(there, palm) + 0.12 * np.array(UP)).tolist()
        rung = pa.Bar((x + 0.05, 0, z), (0, 1, 0), 0.015)
        contacts[palm] = pa.Contact(rung, place=(x, y, z), grip=150.0)
    for foot, height in (("left_ankle_roll_link", 0.15), ("right_ankle_roll_link", 0.0)):
        contacts[foot] = pa.Contact(pa.Plane((0, 0, height), UP))
    task = pa.StandTask(contacts=contacts, com=(-0.1, 0.0), height=0.6)
    stand = pa.solve_stand_as_simulated(g1, task)
    heels = min(float(place[0]) for place in stand.contact_points.values())
    assert heels > -0.06
    statics = pa.stance.stand_statics(stand.check(g1), stand)
    for palm in ("left_palm", "right_palm"):
        assert statics.weld_wrenches[palm][2] < -30.0  # N
    found = pa.verify_stand(g1, stand)
    assert found.passed, [str(failure) for failure in found.failures]
    assert found.torque_error < EXACT
    assert found.force_error < EXACT
    bar = pa.Contact(pa.Bar((0, 0, 0.1), (0, 1, 0), 0.01))
    with pytest.raises(pa.ConfigurationError, match="several points"):
        pa.solve_stand(g1, pa.StandTask(contacts={"left_ankle_roll_link": bar}))


@pytest.mark.slow
@pytest.mark.parametrize("pressing", [True, False])
@pytest.mark.parametrize("stance", ["ur5, table", "go2, bolted", "go2, by a foot"])
def test_torques_of_welded_public_robots_equal_a_cone_program(
    stance: str, *, pressing: bool
) -> None:
    """Reference: smallest torque by Clarabel, with MuJoCo's Jacobians and contact forces that only
    press, or that are inside the friction cones.
    """
    name, make, _ = STANCES[stance]
    of = robot(name)
    stand = pa.solve_stand_as_simulated(of, pa.StandTask(contacts=make(of)))
    touched = stand.check(of)
    which = "minimum tangential" if pressing else "minimum torque"
    ours = pa.stance.stand_statics(touched, stand, distribution=which)
    _, torques = compute_least_torque(touched, stand, pressing=pressing)
    # If the weld can bear the whole load, the torques are those of the regularisation terms.
    rounding = 1e-6 * of.total_mass * 9.81  # N m: 1e-6 of the weight at a lever of 1 m
    np.testing.assert_allclose(ours.joint_torques, torques, atol=rounding)
