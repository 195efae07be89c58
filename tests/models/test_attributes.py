"""Joint attributes (limits, damping, armature): both engines and the other format have the values
that a file specifies.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

import pupper_analysis as pa
from pupper_analysis.models.attributes import (
    JOINT_ATTRIBUTES,
    PASSIVE_ATTRIBUTES,
    TREE_ATTRIBUTES,
    JointAttribute,
)
from pupper_analysis.models.conversion import MujocoTree
from pupper_analysis.models.mjcf_file import read_mjcf
from pupper_analysis.models.multibody import from_pinocchio
from pupper_analysis.models.spec_tree import SpecTree
from pupper_analysis.models.stated.mjcf import read_mjcf_model
from pupper_analysis.models.stated.urdf import read_urdf_model
from pupper_analysis.models.urdf_file import read_urdf
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml import to_text
from tests.support.corpus import INERTIAL, format_joint, format_link, format_urdf
from tests.support.engines import to_pinocchio

# No two values are equal, so that a swapped column is found.
VALUES = {
    "lower limit": -0.5,
    "upper limit": 0.75,
    "effort": 3.5,
    "velocity": 11.0,
    "damping": 0.125,
    "friction": 0.0625,
    "armature": 0.03,
    "spring": 0.7,
}

PLAIN = format_joint("j", "a", "b", '<axis xyz="0 1 0"/>')
URDF = format_urdf(
    format_link("a", INERTIAL.replace('mass value="1"', 'mass value="2"')), format_link("b"), PLAIN
)

MJCF = (
    '<mujoco><compiler angle="radian"/><worldbody><body name="a"><freejoint/>'
    '<inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/><body name="b">'
    '<joint name="j" axis="0 1 0" range="-0.5 0.75" damping="0.125" frictionloss="0.0625" '
    'armature="0.03" stiffness="0.7" actuatorfrcrange="-3.5 3.5"/>'
    '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></body></worldbody></mujoco>'
)


def stated_urdf() -> UrdfTree:
    tree = UrdfTree.of(URDF)
    for joint_attribute in JOINT_ATTRIBUTES:
        if joint_attribute.urdf is not None:
            tree.joints["j"].set_parameter(joint_attribute, VALUES[joint_attribute.kind])
    return tree


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    there = tmp_path / "r.urdf", tmp_path / "r.xml"
    there[0].write_text(to_text(stated_urdf().root))
    there[1].write_text(MJCF)
    return there


def test_engines_have_the_joint_attributes_of_the_files(files: tuple[Path, Path]) -> None:
    """Reference: `VALUES`, in which no two values are equal, so that a swapped column is found."""
    model = pin.buildModelFromUrdf(str(files[0]), pin.JointModelFreeFlyer())
    tree = from_pinocchio(model, "a", ["j"], {})
    for attribute in TREE_ATTRIBUTES:
        wanted = VALUES[attribute.kind] if attribute.urdf else 0.0
        assert getattr(tree.joints["j"], attribute.field) == wanted, attribute.kind
    compiled = mujoco.MjModel.from_xml_path(str(files[1]))
    for attribute in PASSIVE_ATTRIBUTES:
        if attribute.mujoco:
            assert getattr(compiled, attribute.mujoco)[6] == VALUES[attribute.kind], attribute.kind


def test_joint_attributes_are_kept_in_models_of_both_engines(files: tuple[Path, Path]) -> None:
    """Reference: `VALUES`, after a round trip through Pinocchio's model and in MuJoCo's compiled
    model.
    """
    model = pin.buildModelFromUrdf(str(files[0]), pin.JointModelFreeFlyer())
    tree = from_pinocchio(model, "a", ["j"], {})
    numbers = {
        tree_attribute.field: VALUES[tree_attribute.kind] for tree_attribute in TREE_ATTRIBUTES
    }
    numbered = replace(tree.joints["j"], **numbers)  # type: ignore[arg-type]
    tree = replace(tree, joints={"j": numbered})
    back = from_pinocchio(to_pinocchio(tree), "a", ["j"], {}).joints["j"]
    assert {field: getattr(back, field) for field in numbers} == numbers
    compiled = MujocoTree(tree).model
    for tree_attribute in TREE_ATTRIBUTES:
        if tree_attribute.mujoco:
            np.testing.assert_array_equal(
                getattr(compiled, tree_attribute.mujoco)[-1], VALUES[tree_attribute.kind]
            )


@pytest.mark.parametrize("position", [(0.1, 0.0, -0.2), (0.0, 0.0, 0.0), (-1.0, -1.0, -1.0)])
def test_frame_is_at_its_position_in_the_compiled_model(
    files: tuple[Path, Path], position: tuple[float, float, float]
) -> None:
    """Reference: MuJoCo's position of the site [m], with the joint at zero and the base at the
    origin.
    """
    model = pin.buildModelFromUrdf(str(files[0]), pin.JointModelFreeFlyer())
    tree = from_pinocchio(model, "a", ["j"], {})
    framed = replace(tree, frames={"tip": ("j", np.array(position))})
    here, origin = MujocoTree(framed), MujocoTree(tree)
    here.copy_parameters(framed)
    origin.copy_parameters(tree)
    data, reference = mujoco.MjData(here.model), mujoco.MjData(origin.model)
    mujoco.mj_kinematics(here.model, data)
    mujoco.mj_kinematics(origin.model, reference)
    expected = reference.xpos[-1] + reference.xmat[-1].reshape(3, 3) @ position
    np.testing.assert_allclose(data.site("tip").xpos, expected, atol=1e-12)


SPRUNG = MJCF.replace('damping="0.125"', "").replace(
    'stiffness="0.7"', 'stiffness="9" springdamper="0.2 0.5"'
)


def test_springdamper_equals_its_stiffness_and_damping(tmp_path: Path) -> None:
    """MuJoCo's documentation: d = 2 M / T and k = M / (T z)^2 for time constant T and damping ratio
    z. Scaling the damping keeps the stiffness, and `diff_models` reports both.
    """
    first, second = tmp_path / "one.xml", tmp_path / "two.xml"
    first.write_text(SPRUNG)
    second.write_text(SPRUNG.replace("0.2 0.5", "0.4 0.5"))
    file = read_mjcf(first)
    damping, spring = (
        next(a for a in PASSIVE_ATTRIBUTES if a.kind == kind) for kind in ("damping", "spring")
    )
    made = damping.read_compiled_value(file.model, 1), spring.read_compiled_value(file.model, 1)
    # d / k = 2 T z^2
    assert made[0] / made[1] == pytest.approx(2 * 0.2 * 0.5**2)
    stated = read_mjcf_model(file).joints["j"].stated
    assert (stated["damping"], stated["spring"]) == made
    tree = SpecTree(file.spec.copy())
    tree.scale("j", damping, 2.0)
    model = tree.spec.compile()
    assert damping.read_compiled_value(model, 1) == pytest.approx(2 * made[0])
    assert spring.read_compiled_value(model, 1) == pytest.approx(made[1])
    found = {change.kind: change for change in pa.diff_models(first, second).changes}
    assert {"damping", "spring"} <= set(found)
    assert found["damping"].old == pytest.approx(made[0])
    assert found["damping"].new == pytest.approx(made[0] / 2)
    assert found["damping"].old_place.endswith("one.xml:1")


def test_both_models_state_the_values_of_their_files(files: tuple[Path, Path]) -> None:
    one = read_urdf_model(read_urdf(files[0])).joints["j"].stated
    two = read_mjcf_model(read_mjcf(files[1])).joints["j"].stated
    assert one == {a.kind: VALUES[a.kind] for a in JOINT_ATTRIBUTES if a.urdf}
    assert two == {a.kind: VALUES[a.kind] for a in JOINT_ATTRIBUTES if a.mjcf}


def test_missing_value_is_unknown_and_a_stated_zero_is_not(tmp_path: Path) -> None:
    path = tmp_path / "r.xml"
    bare = MJCF.replace('damping="0.125" frictionloss="0.0625"', 'damping="0"')
    path.write_text(bare.replace('armature="0.03"', "").replace('stiffness="0.7"', ""))
    stated = read_mjcf_model(read_mjcf(path)).joints["j"].stated
    assert stated["damping"] == 0.0
    assert not {"friction", "armature", "spring"} & set(stated)
    default = '<default><joint armature="0"/></default><worldbody>'
    path.write_text(path.read_text().replace("<worldbody>", default))
    assert read_mjcf_model(read_mjcf(path)).joints["j"].stated["armature"] == 0.0


@pytest.mark.parametrize("attribute", PASSIVE_ATTRIBUTES, ids=lambda one: one.kind)
def test_factor_changes_its_attribute_only(
    attribute: JointAttribute, files: tuple[Path, Path]
) -> None:
    """References: texts of the URDF, and MuJoCo's compiled model."""
    urdf, mjcf = stated_urdf(), SpecTree(read_mjcf(files[1]).spec.copy())
    before = {a.kind: urdf.joints["j"].parameter_text(a) for a in JOINT_ATTRIBUTES if a.urdf}
    urdf.scale("j", attribute, 2.0)
    after = {a.kind: urdf.joints["j"].parameter_text(a) for a in JOINT_ATTRIBUTES if a.urdf}
    changed = {kind for kind in before if before[kind] != after[kind]}
    assert changed == ({attribute.kind} if attribute.urdf else set())
    old = mjcf.spec.copy().compile()
    mjcf.scale("j", attribute, 2.0)
    new = mjcf.spec.compile()
    for passive_attribute in PASSIVE_ATTRIBUTES:
        name, ratio = (
            passive_attribute.mujoco or passive_attribute.of_joints,
            2.0 if passive_attribute == attribute else 1.0,
        )
        assert getattr(new, name)[-1] == ratio * getattr(old, name)[-1], passive_attribute.kind


def test_comparison_names_each_value_that_differs(files: tuple[Path, Path]) -> None:
    """One value of the URDF is 10 % smaller than in the MJCF."""
    compared = [
        tree_attribute
        for tree_attribute in TREE_ATTRIBUTES
        if tree_attribute.urdf and tree_attribute.mjcf
    ]
    assert len(compared) >= 4
    for one in compared:
        tree = stated_urdf()
        tree.joints["j"].set_parameter(one, 0.9 * VALUES[one.kind])
        files[0].write_text(to_text(tree.root))
        found = pa.compare_models(*files, configurations=1).differences
        (difference,) = (found for found in found if found.kind != "spring")
        assert difference.kind == one.kind
        assert difference.urdf == pytest.approx(0.9 * VALUES[one.kind])
        assert difference.mjcf == VALUES[one.kind]
