"""What an MJCF is given: the same by the verbs of MuJoCo's editable model and of new XML."""

from __future__ import annotations

import mujoco
import numpy as np

from pupper_analysis.models.spec_tree import SpecTree
from pupper_analysis.models.xml import add_element
from pupper_analysis.prepare.convert.from_urdf import MjcfXml
from pupper_analysis.tools.convert.draft import NewMjcf

ARRAYS = (
    *("actuator_gainprm", "actuator_biasprm", "actuator_forcelimited", "actuator_forcerange"),
    *("actuator_ctrllimited", "actuator_trnid", "eq_data", "eq_obj1id", "eq_obj2id", "eq_solref"),
    *("exclude_signature", "geom_bodyid", "geom_contype", "geom_conaffinity", "geom_pos"),
    *("geom_size", "geom_type", "body_mass", "key_qpos", "key_ctrl", "sensor_type", "site_bodyid"),
)


def robot() -> NewMjcf:
    """Three hinges in a row on a free base, each body with a sphere."""
    mjcf = NewMjcf(MjcfXml.of_urdf("chain").root)
    body = add_element(mjcf.section("worldbody"), "body", name="base", pos="0 0 0.4")
    add_element(body, "freejoint", name="root")
    for name in ("base", "one", "two", "three"):
        if name != "base":
            body = add_element(body, "body", name=name, pos="0 0 -0.1")
            add_element(body, "joint", name=f"{name}_joint", axis="0 1 0")
        add_element(body, "inertial", pos="0 0 0.01", mass="0.2", diaginertia="1e-3 2e-3 2e-3")
        add_element(body, "geom", name=f"{name}_geom", class_="collision", size="0.02")
    return mjcf


def edit(mjcf: NewMjcf | SpecTree) -> None:
    mjcf.set_options({"integrator": "implicitfast", "cone": "elliptic", "impratio": 100.0})
    mjcf.add_imu("two", "imu")
    mjcf.add_coupling("three_joint", "two_joint", "-0.5", "0.25")
    mjcf.add_position_servo("one_joint", 40.0, 1.5, ("-3", "+7"))
    mjcf.add_position_servo("two_joint", 20.0, 0.5)
    mjcf.exclude_contact("base", "two")
    mjcf.add_ball("ball", "three", 0.03, [0.0, 0.01, -0.02])
    mjcf.set_home([0, 0, 0.4, 1, 0, 0, 0, 0.1, 0.2, 0.15], [0.1, 0.2])


def test_both_mjcf_editors_make_the_same_model() -> None:
    written = robot()
    edited = SpecTree(mujoco.MjSpec.from_string(written.text))
    edit(written)
    edit(edited)
    for each in (written, edited):
        each.turn_off_contact(["one_geom"])
    made = mujoco.MjModel.from_xml_string(written.text)
    kept = edited.spec.compile()
    for word in ("integrator", "cone", "impratio"):
        assert getattr(made.opt, word) == getattr(kept.opt, word)
    assert made.opt.impratio == 100
    for name in ARRAYS:
        ours, theirs = getattr(made, name), getattr(kept, name)
        if name == "sensor_type":  # a file is given the orientation, too
            ours = ours[: len(theirs)]
        np.testing.assert_allclose(ours, theirs, atol=1e-15, err_msg=name)
    np.testing.assert_allclose(made.actuator_forcerange, [[-3, 7], [0, 0]])
    assert made.nexclude == made.neq == made.nkey == 1
