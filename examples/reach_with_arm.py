"""Mount an arm on a quadruped, and reach a point with the hand while the robot stands.

The output shows the largest motor load, and the verification in MuJoCo. With your own robots:
python examples/reach_with_arm.py go2.urdf z1.urdf
"""

import sys

import pupper_analysis as pa
from pupper_analysis.stance import CoMTask, PositionTask, SelfClearanceTask

ARM = """<mujoco><worldbody><body><joint name="turn" axis="0 0 1" range="-90 90"/><geom size=".02"/>
<body><joint name="lift" axis="0 1 0" range="-120 30"/><geom size=".02" pos=".05 0 .03"/>
<body name="hand" pos=".1 0 .03"><joint name="bend" axis="0 1 0" range="0 150"/>
<geom pos=".1 0 0" size=".02"/></body></body></body></worldbody></mujoco>"""


def main() -> None:
    """Attach MuJoCo's spec of the arm, solve for a posture on the feet, and simulate it."""
    files = sys.argv[1:] or ["v3", ARM]
    robot = pa.load_robot(files[0], visuals=False)
    arm = pa.load_robot(files[1], fixed_base=True, visuals=False).mj_spec()
    spec, size, hand = robot.mj_spec(), robot.base_height, f"arm_{arm.bodies[-1].name}"
    arm.option.integrator = spec.option.integrator
    spec.attach(arm, prefix="arm_", frame=spec.body(robot.mj_base).add_frame(pos=(0, 0, size / 2)))
    robot = pa.load_robot(spec)
    stand = pa.solve_stand(robot)
    start = pa.Configuration(robot, stand.qpos)
    x, y, z = start.frame_position(hand)
    goal = (x - 0.2 * size, y + 0.3 * size, z + 0.4 * size)
    tasks = [PositionTask(hand, goal), CoMTask(start.center_of_mass(), axes="xy")]
    posture = pa.solve_posture(robot, [*tasks, SelfClearanceTask(0.005)], start=stand)
    torques = pa.stance.stand_statics(robot, posture.stand).joint_torques
    report = pa.verify_stand(robot, pa.solve_stand_as_simulated(robot, posture.stand))
    print(f"largest motor load {abs(torques).max():.2f} N m, holds in MuJoCo: {report.passed}")


if __name__ == "__main__":
    main()
