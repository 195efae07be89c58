"""The model of a USD equals that of the URDF in all conventions of USD; masses that no attribute
specifies are unknown.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pxr", reason="usd-core is not installed")

from pxr import Gf, Usd, UsdPhysics

from pupper_analysis.base.errors import ModelError
from pupper_analysis.tools.usd.file import read_usd
from pupper_analysis.tools.usd.model import MassOrigin, UsdModel, read_usd_model
from tests.tools.usd import written as usd


def model(path: Path) -> UsdModel:
    return read_usd_model(read_usd(path))


def test_every_convention_gives_the_drives_of_the_urdf(tmp_path: Path) -> None:
    """References: gains, damping and friction of the URDF. ``test_reader`` compares all other
    numbers in both engines.
    """
    mine = model(usd.write(tmp_path))
    hip, spring = mine.edges["hip"].numbers, mine.edges["spring"].numbers
    assert hip["damping"] == pytest.approx(0.1, rel=1e-9)
    assert hip["friction"] == pytest.approx(0.05, rel=1e-9)
    assert hip["velocity"] == pytest.approx(10.0, rel=1e-6)  # 572.9578 degrees
    assert spring["damping"] == pytest.approx(2.0, rel=1e-9)
    assert mine.gains == {"hip": pytest.approx((90 / math.pi, 0.9 / math.pi), rel=1e-9)}


def test_up_axis_is_converted_and_unknown_values_are_absent(tmp_path: Path) -> None:
    mine = model(usd.write(tmp_path))
    assert mine.floating
    assert np.allclose(mine.mount.rotation, np.eye(3), atol=1e-7)
    assert np.allclose(mine.mount.position, (0, 0, 0.4))
    assert "armature" not in mine.edges["hip"].numbers
    assert "friction" in mine.edges["spring"].numbers  # a stated zero is one
    assert mine.gravity is None


@pytest.mark.filterwarnings(
    "ignore:LoadUsdPhysicsFromRange:DeprecationWarning"
)  # its new name is new
def test_joint_frames_equal_those_of_usd_physics(tmp_path: Path) -> None:
    """Reference: USD's parser of its physics schema, for frames in a child prim of a body."""
    path = usd.write(
        tmp_path,
        ("rel physics:body1 = </leg/base/thigh/shank/rod/foot>",
         "rel physics:body1 = </leg/base/thigh/shank/rod/foot/ball>"),
        ("double radius = 2", "double radius = 2\n"
         "double3 xformOp:translate = (1, 2, 3)\nfloat xformOp:rotateZ = 90\n"
         'uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateZ"]'),
    )  # fmt: skip
    mine, stage = model(path), Usd.Stage.Open(str(path))
    parsed = UsdPhysics.LoadUsdPhysicsFromRange(stage, ["/leg"])
    kinds = UsdPhysics.ObjectType
    for kind in (kinds.RevoluteJoint, kinds.PrismaticJoint, kinds.FixedJoint):
        assert parsed[kind]
        for path_, found in zip(*parsed[kind], strict=True):
            edge = mine.edges[path_.name]
            assert [mine.file.bodies[name] for name in edge.bodies] == [found.body0, found.body1]
            for end, frame in enumerate(edge.frames):
                position = np.array(getattr(found, f"localPose{end}Position")) * 0.01
                assert np.allclose(frame.position, position, atol=1e-7)
                turn = Gf.Matrix3d(getattr(found, f"localPose{end}Orientation"))
                assert np.allclose(frame.rotation, np.array(turn).T, atol=1e-6)


MASS, COM, INERTIA = (
    "float physics:mass = 500\n",
    "point3f physics:centerOfMass = (0, 0, -10)\n",
    "float3 physics:diagonalInertia = (30000, 26000, 5000)\n",
)
SHAPE = (
    'def Sphere "s" ( prepend apiSchemas = ["PhysicsCollisionAPI", "PhysicsMassAPI"] )\n{{\n{}}}\n'
)
NEXT = 'def Xform "shank"'


@pytest.mark.parametrize(
    ("gone", "shape", "origin"),
    [
        ((), None, MassOrigin.STATED),
        ((MASS,), None, MassOrigin.UNKNOWN),
        ((MASS,), "", MassOrigin.WATER),
        ((MASS,), "float physics:density = 0\n", MassOrigin.WATER),
        ((MASS,), "float physics:density = 2\n", MassOrigin.SHAPES),
        ((MASS,), "float physics:mass = 2\n", MassOrigin.SHAPES),
        ((MASS,), "bool physics:collisionEnabled = 0\n", MassOrigin.UNKNOWN),
        ((COM,), "", MassOrigin.SHAPES),
        ((INERTIA,), "", MassOrigin.SHAPES),
        ((INERTIA,), None, MassOrigin.DEFAULT),
        ((COM,), None, MassOrigin.DEFAULT),
    ],
)
def test_usd_mass_is_stated_or_unknown(
    gone: tuple[str, ...], shape: str | None, origin: MassOrigin, tmp_path: Path
) -> None:
    changes = [(text, "\n") for text in gone]
    if shape is not None:
        changes.append((NEXT, SHAPE.format(shape) + NEXT))
    found = model(usd.write(tmp_path, *changes, after='def Xform "thigh"')).body_masses["thigh"]
    assert found.origin is origin
    assert (found.inertial is None) is (origin is not MassOrigin.STATED)
    names = {MASS: "mass", COM: "com", INERTIA: "inertia"}
    assert found.lacks == tuple(names[text] for text in gone)


_PLACE, _ORDER = "double3 xformOp:translate = (10, 20, 0)", "uniform token[] xformOpOrder = ["
_SCALED = "float3 xformOp:scale = "


def add_operation(operation: str) -> tuple[str, str]:
    """Return the change of the USD by which the thigh's transform has one more operation."""
    name = operation.split()[1]
    return (
        f"{_PLACE}\n            {_ORDER}",
        f'{_PLACE}\n            {operation}\n            {_ORDER}"{name}", ',
    )


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (add_operation(f"{_SCALED}(1, 2, 1)"), "usd-body-scaled-unevenly"),
        (add_operation(f"{_SCALED}(-1, 1, 1)"), "usd-frame-sheared"),  # mirrored
        (
            add_operation(
                "matrix4d xformOp:transform = "
                "((1, 0, 0, 0), (0.5, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))"
            ),
            "usd-frame-sheared",
        ),
        (
            ("rel physics:body1 = </leg/base/thigh>", "rel physics:body1 = </leg/base/calf>"),
            "usd-joint-of-no-prim",
        ),
    ],
)
def test_usd_that_no_engine_accepts_is_refused(
    change: tuple[str, str], code: str, tmp_path: Path
) -> None:
    with pytest.raises(ModelError, match=r"leg\.usda:</leg/") as refused:
        model(usd.write(tmp_path, change))
    assert refused.value.diagnostic.values["problem"].code == code


def test_fixed_joint_to_the_world_fixes_the_base(tmp_path: Path) -> None:
    """At a height of 70 cm; y is up in the file, z in the model."""
    held = """def PhysicsFixedJoint "root"
        {
            rel physics:body1 = </leg/base>
            point3f physics:localPos0 = (0, 70, 0)
            quatf physics:localRot0 = (0.70710677, -0.70710677, 0, 0)
        }

        def PhysicsFixedJoint "ankle\""""
    mine = model(usd.write(tmp_path, ('def PhysicsFixedJoint "ankle"', held)))
    assert not mine.floating
    np.testing.assert_allclose(mine.mount.position, (0, 0, 0.7), atol=1e-9)
    np.testing.assert_allclose(mine.mount.rotation, np.eye(3), atol=1e-9)
    assert not mine.loops


def test_second_joint_to_the_world_closes_a_loop(tmp_path: Path) -> None:
    """The base is fixed to the world; the shank is a descendant of the base."""
    joints = """def PhysicsFixedJoint "root"
        {
            rel physics:body1 = </leg/base>
        }

        def PhysicsSphericalJoint "tether"
        {
            rel physics:body1 = </leg/base/thigh/shank>
        }

        def PhysicsFixedJoint "ankle\""""
    mine = model(usd.write(tmp_path, ('def PhysicsFixedJoint "ankle"', joints)))
    assert mine.base == "base"
    assert not mine.floating
    assert [edge.name for edge in mine.loops] == ["tether"]


def test_hinge_at_the_world_is_the_first_joint_of_its_tree(tmp_path: Path) -> None:
    mine = model(
        usd.write(
            tmp_path,
            ("rel physics:body0 = </leg/base>", "rel physics:body0 = </leg>"),
            ("localPos0 = (10, 20, 0)", "localPos0 = (1, 2, 3)"),
        )
    )
    assert mine.base == "thigh"
    assert not mine.floating
    (hip,) = mine.links["thigh"].joints
    assert (hip.kind, hip.parent, hip.upper) == ("hinge", "world", pytest.approx(math.pi / 3))
    assert np.allclose(mine.mount.position, (0.01, -0.03, 0.02))  # y up: z is -y
    assert [joint.kind for joint in mine.links["base"].joints] == ["free"]


@pytest.mark.parametrize(
    "change",
    [
        ("float physics:mass = 500", 'string physics:mass = "heavy"'),
        ("double mjc:damping = 1000000", "double[] mjc:damping = [1, 2]"),
        ('uniform token physics:axis = "X"', 'uniform token physics:axis = "W"'),
        ("localPos0 = (10, 20, 0)", "localPos0 = (inf, 20, 0)"),
    ],
    ids=str,
)
def test_value_of_another_type_is_refused_at_its_prim(
    change: tuple[str, str], tmp_path: Path
) -> None:
    with pytest.raises(ModelError, match=r"leg\.usda:</leg/.*physics|leg\.usda:</leg/.*mjc"):
        model(usd.write(tmp_path, change))


@pytest.mark.parametrize(
    "change",
    [
        ("physics:lowerLimit = -30", "physics:lowerLimit = nan"),
        ("physics:stiffness = 5000000", "physics:stiffness = nan"),
        ("physics:stiffness = 5000000", "physics:stiffness = inf"),
        ("physics:damping = 50000", "physics:damping = inf"),
        ("mjc:damping = 1000000", "mjc:damping = nan"),
    ],
    ids=str,
)
def test_number_that_is_not_finite_is_refused_at_its_prim(
    change: tuple[str, str], tmp_path: Path
) -> None:
    with pytest.raises(ModelError, match=r"leg\.usda:</leg/.*is (nan|inf); give a finite number"):
        model(usd.write(tmp_path, change))


def test_infinite_limit_is_no_limit(tmp_path: Path) -> None:
    """USD's default of a missing limit is infinite."""
    change = ("physics:lowerLimit = -30", "physics:lowerLimit = -inf")
    assert model(usd.write(tmp_path, change)).joints["hip"].lower == -math.inf
