"""Lower and turn a standing robot with Pink, with Mink, and with `solve_posture`.

The output shows the differences in joint position. Install with: pip install pin-pink mink daqp
"""

import mink
import numpy as np
import pink
from pinocchio import SE3, rpy

import pupper_analysis as pa
from pupper_analysis.stance import OrientationTask, PositionTask


def main() -> None:
    """Move the base to one pose, with the feet in place, by three packages."""
    robot = pa.load_variant("v3")
    stand, base = pa.solve_stand(robot), robot.base
    goal = SE3(rpy.rpyToMatrix(0.0, 0.0, 0.14), stand.qpos[:3] - [0.0, 0.0, 0.01])
    tasks = [PositionTask(base, goal.translation), OrientationTask(base, goal.rotation)]
    expected = pa.solve_posture(robot, tasks, start=stand.qpos).qpos
    config = pink.Configuration(robot.pin_model, robot.pin_data(), stand.q_pin)
    twin = mink.Configuration(robot.mj_model, stand.qpos)
    ours, theirs = [pink.FrameTask(base, 1.0, 1.0)], [mink.FrameTask(base, "body", 1.0, 1.0)]
    ours += [pink.FrameTask(foot, 1.0, 0.0) for foot in robot.contact_frames.values()]
    theirs += [mink.FrameTask(foot, "site", 1.0, 0.0) for foot in robot.contact_frames.values()]
    for task in ours + theirs:
        task.set_target_from_configuration(config if task in ours else twin)
    ours[0].set_target(goal)
    theirs[0].set_target(mink.SE3.from_matrix(goal.homogeneous))
    for _ in range(20):
        config.integrate_inplace(pink.solve_ik(config, ours, 1.0, "daqp"), 1.0)
        twin.integrate_inplace(mink.solve_ik(twin, theirs, 1.0, "daqp"), 1.0)
    for name, qpos in (("Pink", robot.to_mujoco(config.q)), ("Mink", twin.q)):
        print(f"{name}: {np.abs(qpos - expected)[7:].max():.0e} rad from solve_posture")


if __name__ == "__main__":
    main()
