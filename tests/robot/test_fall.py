"""What a fall is, in bare MuJoCo."""

from __future__ import annotations

SERVO = """<mujoco><option timestep="0.002"/><worldbody><geom type="plane" size="0 0 1"/>
<body pos="0 0 0.1"><freejoint/><geom type="box" size="0.1 0.1 0.1" mass="1"/>
<body><joint name="wheel" armature="0.1"/>
<geom size="0.01" mass="0.1" contype="0" conaffinity="0"/></body></body>
</worldbody><actuator><position joint="wheel" kp="10" kv="1"/></actuator></mujoco>"""
