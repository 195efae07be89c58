"""Robot with a continuous joint, a hinge and a slide, whose files list the joints in different
orders.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

TINY_URDF = """
<robot name="tiny">
  <link name="base">
    <inertial><origin xyz="0.01 0.02 0.03"/><mass value="2"/>
      <inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0.001" ixz="0.002" iyz="0.003"/></inertial>
  </link>
  <joint name="turn" type="continuous"><origin xyz="0.1 0 0" rpy="0.3 0 0"/><axis xyz="0 0 1"/>
    <parent link="base"/><child link="arm"/><limit effort="5" velocity="9"/></joint>
  <link name="arm">
    <inertial><origin xyz="0 0 -0.1"/><mass value="0.5"/>
      <inertia ixx="0.002" iyy="0.003" izz="0.004" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <joint name="bend" type="revolute"><origin xyz="0.05 0 -0.2"/><axis xyz="0 1 0"/>
    <parent link="arm"/><child link="hand"/>
    <limit lower="-1" upper="2" effort="4" velocity="9"/></joint>
  <link name="hand">
    <inertial><origin xyz="0 0 -0.05"/><mass value="0.3"/>
      <inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <joint name="toe" type="fixed"><origin xyz="0 0 -0.1"/>
    <parent link="hand"/><child link="foot"/></joint>
  <link name="foot"/>
  <joint name="push" type="prismatic"><origin xyz="-0.1 0 0"/><axis xyz="0 0 1"/>
    <parent link="base"/><child link="rod"/>
    <limit lower="-0.3" upper="0.4" effort="3" velocity="9"/></joint>
  <link name="rod">
    <inertial><origin xyz="0 0 -0.1"/><mass value="0.4"/>
      <inertia ixx="0.002" iyy="0.002" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
</robot>
"""

# The rod before the arm, the actuators in a third order, one joint without.
TINY_MJCF = """
<mujoco model="tiny">
  <compiler angle="radian" eulerseq="XYZ" autolimits="true"/>
  <default><joint armature="0.01"/></default>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body name="base" pos="0 0 0.5">
      <freejoint/>
      <inertial pos="0.01 0.02 0.03" mass="2" fullinertia="0.02 0.03 0.04 0.001 0.002 0.003"/>
      <body name="rod" pos="-0.1 0 0">
        <joint name="push" type="slide" axis="0 0 1" range="-0.3 0.4"/>
        <inertial pos="0 0 -0.1" mass="0.4" diaginertia="0.002 0.002 0.001"/>
      </body>
      <body name="arm" pos="0.1 0 0" euler="0.3 0 0">
        <joint name="turn" axis="0 0 1"/>
        <inertial pos="0 0 -0.1" mass="0.5" diaginertia="0.002 0.003 0.004"/>
        <body name="hand" pos="0.05 0 -0.2">
          <joint name="bend" axis="0 1 0" range="-1 2" armature="0.02"/>
          <inertial pos="0 0 -0.05" mass="0.3" diaginertia="0.001 0.001 0.001"/>
          <geom type="sphere" size="0.02" pos="0 0 -0.1"/>
          <site name="foot" pos="0 0 -0.1"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="bend"/><motor joint="push"/></actuator>
</mujoco>
"""


class Files(NamedTuple):
    """Paths of the URDF and the MJCF."""

    urdf: Path
    mjcf: Path
