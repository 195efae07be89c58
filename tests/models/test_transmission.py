"""Types of actuators at joints and tendons, from their force laws."""

from __future__ import annotations

import mujoco

from pupper_analysis.models.transmission import Drive, classify_joint_drive, list_tendon_servos


def test_dcmotor_at_a_tendon_is_no_servo() -> None:
    """The tendon's id, 1, is not the id of a joint: the model has a single joint."""
    model = mujoco.MjModel.from_xml_string("""
    <mujoco><worldbody><body><joint name="j"/><geom size="0.1"/></body></worldbody>
    <tendon>
    <fixed name="slack"><joint joint="j" coef="1"/></fixed>
    <fixed name="driven"><joint joint="j" coef="1"/></fixed>
    </tendon>
    <actuator><dcmotor tendon="driven" motorconst="0.1" resistance="1"/></actuator></mujoco>""")
    assert list_tendon_servos(model, 0) == []
    assert classify_joint_drive(model, 0) is Drive.TENDON
