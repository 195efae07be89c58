"""Load a robot of your own: a URDF, an MJCF, and the frames at the centres of its feet.

The output shows the mass, which is the same in both files, the torque of each motor in the nominal
stand, and whether the stand holds in MuJoCo. The two files are a variant of Pupper that is written
to a folder first; replace them by yours.
"""

import tempfile
from pathlib import Path

import pupper_analysis as pa

FEET = {
    "FR": "leg_front_r_3_foot_site",
    "FL": "leg_front_l_3_foot_site",
    "RR": "leg_back_r_3_foot_site",
    "RL": "leg_back_l_3_foot_site",
}
"""{name of the foot in the package: its frame, a link of the URDF and a site of the MJCF}."""


def main() -> None:
    """Load the robot, solve its nominal stand, and print the torques of its motors."""
    with tempfile.TemporaryDirectory() as folder:
        urdf, mjcf = pa.pupper.write_variant(
            pa.pupper.VariantSpec(base="v3", leg_scale=1.1), Path(folder)
        )
        robot = pa.load_robot(urdf=urdf, mjcf=mjcf, feet=FEET)
    stand = pa.solve_stand(robot)
    held = pa.stance.stand_statics(robot, stand)
    print(f"{robot.name}: {robot.total_mass:.3f} kg")
    for joint, torque in zip(held.joint_names, held.joint_torques, strict=True):
        print(f"{joint:15} {torque:+.3f} N m")
    print("holds in MuJoCo:", pa.verify_stand(robot, stand).passed)


if __name__ == "__main__":
    main()
