"""Move the body of a standing robot: look at a point, and keep the CoM above the feet.

The output shows the residual of each task by Pinocchio and by MuJoCo, the largest motor utilisation
of the posture, the largest straight push of a foot, and the task that is not fulfilled with the
base at 0.4 m.
"""

import pupper_analysis as pa
from pupper_analysis.stance import AxisAlignTask, CoMTask, PositionTask


def main() -> None:
    """Solve for two postures: one that exists, and one that is out of reach."""
    robot = pa.load_variant("v3")
    stand = pa.solve_stand(robot)
    com = pa.Configuration(robot, stand.qpos).center_of_mass()
    tasks = [
        AxisAlignTask(robot.base, axis=(1, 0, 0), point=(0.5, 0.05, 0.2)),
        CoMTask(com, axes="xy"),
    ]
    posture = pa.solve_posture(robot, tasks, start=stand.qpos)
    residuals = zip(posture.tasks, posture.residuals, posture.mujoco_residuals, strict=True)
    for task, by_pinocchio, by_mujoco in residuals:
        print(f"{task:24s} {by_pinocchio:.0e} {by_mujoco:.0e}")
    config = pa.Configuration(robot, posture.qpos)
    utilisation = pa.gravity_compensation(config).motor_utilisation.max()
    print(f"largest motor utilisation: {100 * utilisation:.0f} %")
    push = pa.statics.force_polytope(config, "FR").largest_push([0, 0, -1])
    print(f"largest straight push of FR: {push:.1f} N")
    try:
        pa.solve_posture(robot, [PositionTask(robot.base, (0, 0, 0.4))], start=stand.qpos)
    except pa.PostureUnreachableError as error:
        print(error)


if __name__ == "__main__":
    main()
