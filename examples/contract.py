"""Check that a policy, its controller and the model of the robot agree.

The output shows that the controller has another default angle at one knee, and the MJCF another kd.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import pupper_analysis as pa
from pupper_analysis.tools.contract import read_contract

JOINTS = [f"leg_{leg}_{number}" for leg in ("front_r", "front_l", "back_r", "back_l")
          for number in (1, 2, 3)]  # fmt: skip
ANGLES = [0.26, 0.0, -0.52, -0.26, 0.0, 0.52] * 2

POLICY = f'{{"kp": 5.0, "kd": 0.25, "default_joint_pos": {ANGLES}, "in_shape": [], "layers": []}}'
CONTROLLER = f"""
walker:
  ros__parameters:
    joint_names: {JOINTS}
    default_joint_pos: {[*ANGLES[:11], 0.82]}
"""

with TemporaryDirectory() as folder:
    policy, controller = Path(folder, "policy.json"), Path(folder, "config.yaml")
    policy.write_text(POLICY)
    controller.write_text(CONTROLLER)
    robot = pa.load_variant("v3")
    model = robot.description.mjcf_source
    contract = read_contract(model, policy, controller)

for finding in contract.findings:
    print(f"{finding.severity}: {finding.message}")
for pose in contract.poses:
    print(f"{pose.source}: base {1e3 * pose.height:.0f} mm over the feet")
