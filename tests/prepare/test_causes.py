"""Names of the elements that are candidate causes of a deviation."""

from __future__ import annotations

import mujoco

from pupper_analysis.prepare.causes import _name_actuators


def test_actuator_without_name_has_the_name_of_its_joint_or_its_number() -> None:
    """Reference: the file. A tendon has the same id as the joint ``hip``, but is no joint."""
    model = mujoco.MjModel.from_xml_string("""
        <mujoco>
          <worldbody>
            <body><joint name="hip"/><geom size="0.1"/></body>
            <body><joint name="knee"/><geom size="0.1"/></body>
          </worldbody>
          <tendon><fixed name="cable"><joint joint="knee" coef="1"/></fixed></tendon>
          <actuator>
            <motor tendon="cable"/><motor joint="knee"/><motor name="own" joint="hip"/>
          </actuator>
        </mujoco>""")
    assert _name_actuators(model, range(3)) == ("#0", "knee", "own")
