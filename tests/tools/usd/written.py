"""A leg on a base, as a URDF and as a USD of every convention that a USD may have.

The USD is in centimetres and grams, y up, its hip about a turned X, its knee written from the shank
to the thigh, its angles in degrees; all by hand, with numbers that the URDF has, too.
"""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("pxr", reason="usd-core is not installed")

URDF = """<robot name="leg">
  <link name="base">
    <inertial>
      <origin xyz="0.01 0.02 0.03" rpy="0 0 0"/>
      <mass value="2"/>
      <inertia ixx="0.02" iyy="0.01" izz="0.025" ixy="0" ixz="0" iyz="0"/>
    </inertial>
    <collision><geometry><box size="0.3 0.5 0.2"/></geometry></collision>
  </link>
  <joint name="hip" type="revolute">
    <parent link="base"/><child link="thigh"/>
    <origin xyz="0.1 0.2 0"/>
    <axis xyz="0 1 0"/>
    <limit lower="-0.5235987755982988" upper="1.0471975511965976" effort="12" velocity="10"/>
    <dynamics damping="0.1" friction="0.05"/>
  </joint>
  <link name="thigh">
    <inertial>
      <origin xyz="0 0 -0.1"/>
      <mass value="0.5"/>
      <inertia ixx="0.003" iyy="0.0026" izz="0.0005" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <joint name="knee" type="revolute">
    <parent link="thigh"/><child link="shank"/>
    <origin xyz="0 0 -0.25"/>
    <axis xyz="0 1 0"/>
    <limit lower="-2.0943951023931953" upper="-0.5235987755982988" effort="9" velocity="10"/>
    <dynamics damping="0.1" friction="0.05"/>
  </joint>
  <link name="shank">
    <inertial>
      <origin xyz="0 0 -0.08"/>
      <mass value="0.25"/>
      <inertia ixx="0.002" iyy="0.0019" izz="0.0002" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <joint name="spring" type="prismatic">
    <parent link="shank"/><child link="rod"/>
    <origin xyz="0 0 -0.2"/>
    <axis xyz="0 0 1"/>
    <limit lower="-0.02" upper="0.03" effort="40" velocity="1"/>
    <dynamics damping="2" friction="0"/>
  </joint>
  <link name="rod">
    <inertial>
      <mass value="0.1"/>
      <inertia ixx="0.0004" iyy="0.0004" izz="0.0001" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <joint name="ankle" type="fixed">
    <parent link="rod"/><child link="foot"/>
    <origin xyz="0 0 -0.05"/>
  </joint>
  <link name="foot">
    <inertial>
      <mass value="0.05"/>
      <inertia ixx="0.00002" iyy="0.00002" izz="0.00002" ixy="0" ixz="0" iyz="0"/>
    </inertial>
    <collision><geometry><sphere radius="0.02"/></geometry></collision>
  </link>
</robot>
"""

USD = """#usda 1.0
(
    defaultPrim = "leg"
    metersPerUnit = 0.01
    kilogramsPerUnit = 0.001
    upAxis = "Y"
)

def Xform "leg"
{
    def Xform "base" (
        prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI", "PhysicsArticulationRootAPI"]
    )
    {
        float physics:mass = 2000
        point3f physics:centerOfMass = (1, 2, 3)
        float3 physics:diagonalInertia = (100000, 200000, 250000)
        quatf physics:principalAxes = (0.70710677, 0, 0, 0.70710677)
        quatf xformOp:orient = (0.70710677, -0.70710677, 0, 0)
        double3 xformOp:translate = (0, 40, 0)
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:orient"]

        def Cube "trunk" (
            prepend apiSchemas = ["PhysicsCollisionAPI"]
        )
        {
            double size = 2
            float3 xformOp:scale = (15, 25, 10)
            uniform token[] xformOpOrder = ["xformOp:scale"]
        }

        def Xform "thigh" (
            prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"]
        )
        {
            float physics:mass = 500
            point3f physics:centerOfMass = (0, 0, -10)
            float3 physics:diagonalInertia = (30000, 26000, 5000)
            quatf physics:principalAxes = (1, 0, 0, 0)
            double3 xformOp:translate = (10, 20, 0)
            uniform token[] xformOpOrder = ["xformOp:translate"]

            def Xform "shank" (
                prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"]
            )
            {
                float physics:mass = 250
                point3f physics:centerOfMass = (0, 0, -8)
                float3 physics:diagonalInertia = (20000, 19000, 2000)
                quatf physics:principalAxes = (1, 0, 0, 0)
                double3 xformOp:translate = (0, 0, -25)
                uniform token[] xformOpOrder = ["xformOp:translate"]

                def Xform "rod" (
                    prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"]
                )
                {
                    float physics:mass = 100
                    point3f physics:centerOfMass = (0, 0, 0)
                    float3 physics:diagonalInertia = (4000, 4000, 1000)
                    quatf physics:principalAxes = (1, 0, 0, 0)
                    double3 xformOp:translate = (0, 0, -20)
                    uniform token[] xformOpOrder = ["xformOp:translate"]

                    def Xform "foot" (
                        prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"]
                    )
                    {
                        float physics:mass = 50
                        point3f physics:centerOfMass = (0, 0, 0)
                        float3 physics:diagonalInertia = (200, 200, 200)
                        quatf physics:principalAxes = (1, 0, 0, 0)
                        double3 xformOp:translate = (0, 0, -5)
                        uniform token[] xformOpOrder = ["xformOp:translate"]

                        def Sphere "ball" (
                            prepend apiSchemas = ["PhysicsCollisionAPI"]
                        )
                        {
                            double radius = 2
                        }
                    }
                }
            }
        }
    }

    def Scope "joints"
    {
        def PhysicsRevoluteJoint "hip" (
            prepend apiSchemas = ["PhysicsDriveAPI:angular"]
        )
        {
            rel physics:body0 = </leg/base>
            rel physics:body1 = </leg/base/thigh>
            uniform token physics:axis = "X"
            point3f physics:localPos0 = (10, 20, 0)
            point3f physics:localPos1 = (0, 0, 0)
            quatf physics:localRot0 = (0.70710677, 0, 0, 0.70710677)
            quatf physics:localRot1 = (0.70710677, 0, 0, 0.70710677)
            float physics:lowerLimit = -30
            float physics:upperLimit = 60
            float drive:angular:physics:maxForce = 120000000
            float drive:angular:physics:stiffness = 5000000
            float drive:angular:physics:damping = 50000
            double mjc:damping = 1000000
            float newton:friction = 500000
            float newton:velocityLimit = 572.9578
        }

        def PhysicsRevoluteJoint "knee" (
            prepend apiSchemas = ["PhysicsDriveAPI:angular"]
        )
        {
            rel physics:body0 = </leg/base/thigh/shank>
            rel physics:body1 = </leg/base/thigh>
            uniform token physics:axis = "X"
            point3f physics:localPos0 = (0, 0, 0)
            point3f physics:localPos1 = (0, 0, -25)
            quatf physics:localRot0 = (0.70710677, 0, 0, -0.70710677)
            quatf physics:localRot1 = (0.70710677, 0, 0, -0.70710677)
            float physics:lowerLimit = -120
            float physics:upperLimit = -30
            float drive:angular:physics:maxForce = 90000000
            double mjc:damping = 1000000
            double mjc:frictionloss = 500000
        }

        def PhysicsPrismaticJoint "spring" (
            prepend apiSchemas = ["PhysicsDriveAPI:linear"]
        )
        {
            rel physics:body0 = </leg/base/thigh/shank>
            rel physics:body1 = </leg/base/thigh/shank/rod>
            uniform token physics:axis = "Z"
            point3f physics:localPos0 = (0, 0, -20)
            point3f physics:localPos1 = (0, 0, 0)
            quatf physics:localRot0 = (1, 0, 0, 0)
            quatf physics:localRot1 = (1, 0, 0, 0)
            float physics:lowerLimit = -2
            float physics:upperLimit = 3
            float drive:linear:physics:maxForce = 4000000
            float newton:damping = 2000
            float newton:friction = 0
        }

        def PhysicsFixedJoint "ankle"
        {
            rel physics:body0 = </leg/base/thigh/shank/rod>
            rel physics:body1 = </leg/base/thigh/shank/rod/foot>
            point3f physics:localPos0 = (0, 0, -5)
            point3f physics:localPos1 = (0, 0, 0)
            quatf physics:localRot0 = (1, 0, 0, 0)
            quatf physics:localRot1 = (1, 0, 0, 0)
        }
    }
}
"""


def write(folder: Path, *changes: tuple[str, str], name: str = "leg.usda", after: str = "") -> Path:
    """Writes the USD with some of its text replaced, once each, beyond another text."""
    head, mark, text = USD.partition(after) if after else ("", "", USD)
    assert mark == after
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    file = folder / name
    file.write_text(head + mark + text)
    return file


def write_urdf(folder: Path, *changes: tuple[str, str]) -> Path:
    """Writes the URDF, likewise."""
    text = URDF
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    file = folder / "leg.urdf"
    file.write_text(text)
    return file
