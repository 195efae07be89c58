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
from pupper_analysis.models.attributes import JOINT_ATTRIBUTES, PASSIVE_ATTRIBUTES, TREE_ATTRIBUTES
from pupper_analysis.models.conversion import MujocoTree
from pupper_analysis.models.mjcf_file import read_mjcf
from pupper_analysis.models.multibody import from_pinocchio
from pupper_analysis.models.spec_tree import SpecTree
from pupper_analysis.models.stated.mjcf import read_mjcf_model
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml import to_text
from tests.support.corpus import INERTIAL, format_joint, format_link, format_urdf
from tests.support.engines import to_pinocchio

# No two alike: a swapped column is seen.
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
    for one in JOINT_ATTRIBUTES:
        if one.urdf is not None:
            tree.joints["j"].set_parameter(one, VALUES[one.kind])
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
    for one in TREE_ATTRIBUTES:
        wanted = VALUES[one.kind] if one.urdf else 0.0
        assert getattr(tree.joints["j"], one.field) == wanted, one.kind
    compiled = mujoco.MjModel.from_xml_path(str(files[1]))
    for one in PASSIVE_ATTRIBUTES:
        if one.mujoco:
            assert getattr(compiled, one.mujoco)[6] == VALUES[one.kind], one.kind


def test_joint_attributes_are_kept_in_models_of_both_engines(files: tuple[Path, Path]) -> None:
    """Reference: `VALUES`, after a round trip through Pinocchio's model and in MuJoCo's compiled
    model.
    """
    model = pin.buildModelFromUrdf(str(files[0]), pin.JointModelFreeFlyer())
    tree = from_pinocchio(model, "a", ["j"], {})
    numbers = {one.field: VALUES[one.kind] for one in TREE_ATTRIBUTES}
    numbered = replace(tree.joints["j"], **numbers)  # type: ignore[arg-type]
    tree = replace(tree, joints={"j": numbered})
    back = from_pinocchio(to_pinocchio(tree), "a", ["j"], {}).joints["j"]
    assert {field: getattr(back, field) for field in numbers} == numbers
    compiled = MujocoTree(tree).model
    for one in TREE_ATTRIBUTES:
        if one.mujoco:
            np.testing.assert_array_equal(getattr(compiled, one.mujoco)[-1], VALUES[one.kind])


SPRUNG = MJCF.replace('damping="0.125"', "").replace(
    'stiffness="0.7"', 'stiffness="9" springdamper="0.2 0.5"'
)


def test_springdamper_equals_its_stiffness_and_damping(tmp_path: Path) -> None:
    """MuJoCo's documentation: d = 2 M / T and k = M / (T z)^2 for time constant T and damping ratio
    z. Scaling the damping keeps the stiffness, and `diff_models` reports both.
    """
    one, two = tmp_path / "one.xml", tmp_path / "two.xml"
    one.write_text(SPRUNG)
    two.write_text(SPRUNG.replace("0.2 0.5", "0.4 0.5"))
    file = read_mjcf(one)
    damping, spring = (
        next(a for a in PASSIVE_ATTRIBUTES if a.kind == kind) for kind in ("damping", "spring")
    )
    made = damping.read_compiled_value(file.model, 1), spring.read_compiled_value(file.model, 1)
    # Of a time constant T and a damping ratio z, MuJoCo makes d = 2 M / T and k = M / (T z)^2.
    assert made[0] / made[1] == pytest.approx(2 * 0.2 * 0.5**2)
    stated = read_mjcf_model(file).joints["j"].stated
    assert (stated["damping"], stated["spring"]) == made
    tree = SpecTree(file.spec.copy())
    tree.scale("j", damping, 2.0)
    model = tree.spec.compile()
    assert damping.read_compiled_value(model, 1) == pytest.approx(2 * made[0])
    assert spring.read_compiled_value(model, 1) == pytest.approx(made[1])
    found = {change.kind: change for change in pa.diff_models(one, two).changes}
    assert {"damping", "spring"} <= set(found)
    assert found["damping"].old == pytest.approx(made[0])
    assert found["damping"].new == pytest.approx(made[0] / 2)
    assert found["damping"].old_place.endswith("one.xml:1")
