"""Predict where the robot comes to rest on its servos: servos and ground yield.

The output shows the height of Pupper v3 without feed-forward, predicted without a simulation and
then simulated, and the least kp with which the servos carry it.
"""

import pupper_analysis as pa


def main() -> None:
    """Predict and simulate the rest on servos; print the least stiffness that suffices."""
    robot = pa.load_variant("v3")
    stand = pa.stance.solve_stand_as_simulated(robot)
    print(f"commanded {1e3 * robot.stand_height:.2f} mm")
    sag = pa.steady_state(robot, stand, seconds=5.0)
    print(f"predicted {1e3 * sag.base_height:.2f} mm")
    print(f"  lost in the servos {1e3 * sag.servo_sag:.2f} mm")
    print(f"  lost in the ground {1e3 * sag.contact_sag:.2f} mm")
    simulated = pa.verify_stand(robot, stand, feedforward=False)
    print(f"simulated {1e3 * simulated.base_height:.2f} mm")
    print(f"minimum stiffness {pa.stance.minimum_stiffness(robot, stand):.2f} N m/rad")


if __name__ == "__main__":
    main()
