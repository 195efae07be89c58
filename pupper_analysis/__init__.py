"""Compare the URDF and MJCF of a legged robot, and predict and verify how the robot stands.

    import pupper_analysis as pa

    robot = pa.load_variant("long-leg")
    stand = pa.solve_stand(robot)
    torques = pa.stand_statics(robot, stand).joint_torques
    report = pa.verify_stand(robot, stand)

Configurations and velocities are MuJoCo's qpos and qvel, with the joints in actuator order; see
``pupper_analysis.robot.coordinates``. Names are imported at first use.
"""

from pupper_analysis.base.drivers import guard_mujoco_import
from pupper_analysis.base.exports import make_lazy_exports

__version__ = "0.2.0"

guard_mujoco_import()

__getattr__, __dir__, __all__ = make_lazy_exports(__name__, __file__)
