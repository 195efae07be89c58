"""The model of a USD is that of the URDF, whatever its conventions; what it weighs, as USD says."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pxr", reason="usd-core is not installed")

from pxr import Gf, Usd, UsdGeom, UsdPhysics
from scipy.spatial.transform import Rotation

from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.stated.model import Array
from pupper_analysis.models.stated.urdf import read_urdf_model
from pupper_analysis.models.urdf_file import read_urdf
from pupper_analysis.tools.usd.file import read_usd
from pupper_analysis.tools.usd.model import Origin, UsdModel, read_usd_model
from tests.tools.usd import written as usd


def model(path: Path) -> UsdModel:
    return read_usd_model(read_usd(path))


def near(one: Array, two: Array) -> bool:
    return bool(np.allclose(one, two, rtol=1e-9, atol=1e-12))


def test_every_convention_gives_the_numbers_of_the_urdf(tmp_path: Path) -> None:
    mine = model(usd.write(tmp_path))
    theirs = read_urdf_model(read_urdf(usd.write_urdf(tmp_path)))
    assert mine.base == theirs.base == "base"
    assert mine.links.keys() == theirs.links.keys()
    for name, link in theirs.links.items():
        found = mine.links[name]
        assert found.parent == link.parent
        assert near(found.pose.position, link.pose.position)
        assert near(found.pose.rotation, link.pose.rotation)
        assert found.inertial is not None
        assert link.inertial is not None
        assert found.mass == pytest.approx(link.mass, rel=1e-9)
        assert near(found.inertial.com, link.inertial.com)
        assert near(found.inertial.inertia, link.inertial.inertia)
    for name, joint in theirs.joints.items():
        found = mine.joints[name]
        assert (found.kind, found.parent, found.child) == (joint.kind, joint.parent, joint.child)
        assert near(found.position, joint.position)
        assert not joint.moves or near(found.axis, joint.axis)
        assert (found.lower, found.upper, found.effort) == pytest.approx(
            (joint.lower, joint.upper, joint.effort), rel=1e-9
        )
    hip, spring = mine.edges["hip"].numbers, mine.edges["spring"].numbers
    assert hip["damping"] == pytest.approx(0.1, rel=1e-9)
    assert hip["friction"] == pytest.approx(0.05, rel=1e-9)
    assert hip["velocity"] == pytest.approx(10.0, rel=1e-6)  # 572.9578 degrees
    assert spring["damping"] == pytest.approx(2.0, rel=1e-9)
    drive = mine.drive("hip")
    assert drive is not None
    assert drive.stiffness == pytest.approx(0.5 * 180 / math.pi, rel=1e-9)
    shapes = {shape.name: shape.size for link in mine.links.values() for shape in link.shapes}
    assert shapes["trunk"] == pytest.approx((0.15, 0.25, 0.1))
    assert shapes["ball"] == pytest.approx((0.02,))


def test_up_is_up_and_what_is_unknown_is_not_zero(tmp_path: Path) -> None:
    mine = model(usd.write(tmp_path))
    assert mine.floating
    assert near(mine.mount.rotation, np.eye(3)) or np.allclose(
        mine.mount.rotation, np.eye(3), atol=1e-7
    )
    assert np.allclose(mine.mount.position, (0, 0, 0.4))
    assert "armature" not in mine.edges["hip"].numbers
    assert "friction" in mine.edges["spring"].numbers  # a stated zero is one
    assert mine.gravity is None


@pytest.mark.filterwarnings(
    "ignore:LoadUsdPhysicsFromRange:DeprecationWarning"
)  # its new name is new
def test_joints_are_where_usd_itself_finds_them(tmp_path: Path) -> None:
    """Frames that are written in a child of a body, against USD's own parser of its physics."""
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
        for path_, found in zip(*parsed[kind], strict=True):
            edge = mine.edges[path_.name]
            assert [mine.file.bodies[name] for name in edge.bodies] == [found.body0, found.body1]
            for end, frame in enumerate(edge.frames):
                position = np.array(getattr(found, f"localPose{end}Position")) * 0.01
                assert np.allclose(frame.position, position, atol=1e-7)
                turn = Gf.Matrix3d(getattr(found, f"localPose{end}Orientation"))
                assert np.allclose(frame.rotation, np.array(turn).T, atol=1e-6)


SOLIDS = {
    "box": ('def Cube "s"', "double size = 0.4"),
    "sphere": ('def Sphere "s"', "double radius = 0.3"),
    "cylinder": ('def Cylinder "s"', 'double radius = 0.2\ndouble height = 0.7\ntoken axis = "X"'),
    "capsule": ('def Capsule "s"', 'double radius = 0.2\ndouble height = 0.7\ntoken axis = "Y"'),
    "cone": ('def Cone "s"', 'double radius = 0.2\ndouble height = 0.7\ntoken axis = "Z"'),
    "mesh": ('def Mesh "s"',
             "point3f[] points = [(0, 0, 0), (0.5, 0, 0), (0, 0.4, 0), (0, 0, 0.6)]\n"
             "int[] faceVertexCounts = [3, 3, 3, 3]\n"
             "int[] faceVertexIndices = [0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3]"),
}  # fmt: skip


def body(solid: str, own: str = "", of_shape: str = "", more: str = "") -> str:
    head, size = SOLIDS[solid]
    api = '( prepend apiSchemas = ["PhysicsCollisionAPI", "PhysicsMassAPI"] )'
    return f"""#usda 1.0
( metersPerUnit = 1
  kilogramsPerUnit = 1 )
def Xform "r"
{{
    def Xform "b" ( prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"] )
    {{
        {own}
        {head} {api}
        {{
            {size}
            {of_shape}
            double3 xformOp:translate = (0.1, -0.2, 0.3)
            float3 xformOp:rotateXYZ = (20, 30, 40)
            uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]
        }}
        {more}
    }}
}}
"""


@pytest.mark.parametrize("solid", ["box", "sphere", "cylinder", "capsule", "cone", "mesh"])
def test_closed_forms_are_those_of_random_points(solid: str, tmp_path: Path) -> None:
    """Volume and moments of each solid, against the mean of points in it."""
    file = tmp_path / "b.usda"
    file.write_text(body(solid))
    shape = model(file).links["b"].shapes[0]
    found = shape.solid  # type: ignore[attr-defined]
    points = np.random.default_rng(0).uniform(-0.6, 0.6, (400_000, 3))
    x, y, z = points.T
    across, size = np.hypot(x, y), shape.size
    inside = {
        "box": lambda: np.abs(points).max(1) < 0.2,
        "sphere": lambda: np.linalg.norm(points, axis=1) < 0.3,
        "cylinder": lambda: (across < size[0]) & (np.abs(z) < size[1]),
        "capsule": lambda: np.hypot(across, np.maximum(np.abs(z) - size[1], 0)) < size[0],
        "cone": lambda: (np.abs(z) < size[1]) & (across < size[0] * (size[1] - z) / 2 / size[1]),
        "mesh": lambda: (points @ (2, 2.5, 1 / 0.6) < 1) & (points > 0).all(1),
    }[solid]()
    if solid == "mesh":  # its moments are in the axes of the body, where its vertices are
        turn = Rotation.from_euler("xyz", (20, 30, 40), degrees=True)
        points = turn.apply(points)
    chosen = points[inside]
    assert found.volume == pytest.approx(1.2**3 * inside.mean(), rel=0.02)
    assert np.allclose(found.com, chosen.mean(0), atol=4e-3)
    off = chosen - chosen.mean(0)
    tensor = (off**2).sum(1).mean() * np.eye(3) - off.T @ off / len(off)
    assert np.allclose(found.inertia / found.volume, tensor, atol=0.02 * np.trace(tensor))


CASES = {
    "nothing is stated": ("", ""),
    "a density of the body": ("float physics:density = 300", ""),
    "densities of both": ("float physics:density = 300", "float physics:density = 500"),
    "a mass of the shape": ("", "float physics:mass = 3"),
    "masses of both": ("float physics:mass = 4", "float physics:mass = 3"),
    "a mass of zero": ("float physics:mass = 0", "float physics:density = 500"),
    "a com of the body": ("point3f physics:centerOfMass = (0.3, 0.1, 0.2)", ""),
    "a mass and a com": ("float physics:mass = 4\npoint3f physics:centerOfMass = (0, 0.1, 0)", ""),
    "an inertia": ("float physics:mass = 4\nfloat3 physics:diagonalInertia = (1, 2, 2.5)"
                   "\nquatf physics:principalAxes = (0.8, 0.6, 0, 0)", ""),
    "a com of the shape": ("", "point3f physics:centerOfMass = (0.1, 0.05, 0)"),
    "an inertia of the shape": ("", "float physics:mass = 3\n"
                                "float3 physics:diagonalInertia = (0.3, 0.2, 0.25)"),
    "a second shape": ("", "float physics:mass = 3",
                       'def Sphere "t" ( prepend apiSchemas = ["PhysicsCollisionAPI"] )\n'
                       "{\ndouble radius = 0.1\n}"),
    "a shape that does not touch": ("", "", 'def Sphere "t" ( prepend apiSchemas = '
                                    '["PhysicsCollisionAPI"] )\n'
                                    "{\nbool physics:collisionEnabled = 0\n}"),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_a_body_weighs_what_usd_itself_reckons(case: str, tmp_path: Path) -> None:
    """Against ``ComputeMassProperties`` of USD, which is told each shape's volume alone."""
    if case == "a shape that does not touch" and Usd.GetVersion() < (0, 26, 0):
        pytest.skip("USD once counted what is switched off")
    file = tmp_path / "b.usda"
    file.write_text(body("box", *CASES[case]))
    mine = model(file)
    stage = mine.file.stage
    solids = {str(s.prim.GetPath()): s for s in mine.links["b"].shapes}  # type: ignore[attr-defined]

    def volume_of(prim: Usd.Prim) -> UsdPhysics.RigidBodyAPI.MassInformation:
        shape = solids[str(prim.GetPath())]
        info = UsdPhysics.RigidBodyAPI.MassInformation()
        info.volume = shape.solid.volume  # type: ignore[attr-defined]
        info.inertia = Gf.Matrix3f(*shape.solid.inertia.ravel())  # type: ignore[attr-defined]
        info.centerOfMass = Gf.Vec3f(0)
        info.localPos = Gf.Vec3f(*shape.pose.position)
        local = UsdGeom.Xformable(prim).GetLocalTransformation()
        info.localRot = Gf.Quatf(local.ExtractRotationQuat())
        return info

    prim = UsdPhysics.RigidBodyAPI(stage.GetPrimAtPath("/r/b"))
    mass, moments, com, axes = prim.ComputeMassProperties(volume_of)
    found = mine.links["b"].inertial
    assert found is not None
    assert found.mass == pytest.approx(mass, rel=1e-6)
    assert np.allclose(found.com, com, atol=1e-6)
    turn = np.array(Gf.Matrix3d(Gf.Quatd(axes).GetNormalized())).T
    expected = turn @ np.diag(moments) @ turn.T
    assert np.allclose(found.inertia, expected, atol=1e-5 * np.abs(expected).max())
    water = case in ("nothing is stated", "a com of the body", "a com of the shape")
    assert (mine.weights["b"].origin is Origin.WATER) is (
        water or case in ("a second shape", "a shape that does not touch")
    )


def test_a_body_without_mass_or_shape_weighs_nobody_knows_what(tmp_path: Path) -> None:
    lost = 'def Scope "x" ( prepend apiSchemas = ["PhysicsMassAPI"] )\n{\n}\ndef Xform "y"\n{\n}'
    file = tmp_path / "b.usda"
    file.write_text(body("box", more=lost).replace('["PhysicsCollisionAPI", ', "["))
    mine = model(file)
    assert mine.links["b"].inertial is None
    assert mine.weights["b"].origin is Origin.UNKNOWN


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (("double3 xformOp:translate = (10, 20, 0)\n            uniform token[] xformOpOrder = [",
          "double3 xformOp:translate = (10, 20, 0)\n            float3 xformOp:scale = (1, 2, 1)\n"
          '            uniform token[] xformOpOrder = ["xformOp:scale", '), "usd-frame-sheared"),
        (("rel physics:body1 = </leg/base/thigh>", "rel physics:body1 = </leg/base/calf>"),
         "usd-joint-of-no-prim"),
    ],
)  # fmt: skip
def test_what_no_engine_can_take_is_refused(
    change: tuple[str, str], code: str, tmp_path: Path
) -> None:
    with pytest.raises(ModelError, match=r"leg\.usda:</leg/") as refused:
        model(usd.write(tmp_path, change))
    assert refused.value.diagnostic.values["problem"].code in (code, "usd-body-scaled-unevenly")


MOTOR = """
        def MjcActuator "motor"
        {
            rel mjc:target = </leg/joints/hip>
            uniform double mjc:ctrlRange:min = -20000000
            uniform double mjc:ctrlRange:max = 20000000
            uniform double[] mjc:gear = [3]
        }

        def PhysicsFixedJoint "ankle"
"""


def test_of_several_limits_of_an_effort_the_least_counts(tmp_path: Path) -> None:
    """Of a drive 12 N m; of MuJoCo's motor 2 N m before a gear of 3."""
    change = ('def PhysicsFixedJoint "ankle"', MOTOR.strip())
    assert model(usd.write(tmp_path, change)).joints["hip"].effort == pytest.approx(6.0)
