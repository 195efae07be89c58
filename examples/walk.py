"""Simulate a policy and its motor torques: a policy that balances with the hips, written here.

The output shows the torque of the motors of a leg, and that a policy for standing does not walk.
Pupper's own, ``launch/policy_latest.json`` of github.com/G-Levine/neural_controller, walks v3 at
0.47 m/s.
"""

import json
import tempfile
from pathlib import Path

import pupper_analysis as pa
from pupper_analysis.tools.walk.gait import simulate_walk
from pupper_analysis.tools.walk.policy import Policy

POSE = [0.26, 0.0, -0.52, -0.26, 0.0, 0.52] * 2
"""Default joint angles of the policy [rad]."""


def make_policy(path: Path) -> Policy:
    """Write a policy of one layer that corrects lateral tilt with the hips, in RTNeural's JSON."""
    weights = [[0.0] * 12 for _ in range(36)]
    weights[4] = [0.0, 0.2, 0.0] * 4  # the direction of gravity, to the left
    layer = {"type": "dense", "activation": "tanh", "weights": [weights, [0.0] * 12]}
    stated = {"observation_history": 1, "action_scale": 0.75, "kp": 5.0, "kd": 0.25}
    path.write_text(json.dumps({**stated, "default_joint_pos": POSE, "layers": [layer]}))
    return Policy.load(path)


if __name__ == "__main__":
    robot = pa.load_variant("v3")
    with tempfile.TemporaryDirectory() as folder:
        policy = make_policy(Path(folder) / "stand.json")
    for command in ((0.0, 0.0, 0.0), (0.5, 0.0, 0.0)):
        walk = simulate_walk(robot, policy, command, seconds=3.0, warm_up=1.0)
        gait = walk.gaits[0]
        print(f"commanded {command[0]} m/s: {gait.velocity[0]:.2f} m/s, tracks: {gait.tracks}")
    for joint, torque in zip(walk.joints[:3], gait.torque_rms[:3], strict=True):
        print(f"  {joint}: {torque:.2f} N m")
