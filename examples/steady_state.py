"""Why does it not stand where it is told to: servos sag, and the ground gives way.

One sees where Pupper v3 comes to rest on its own servos without feed-forward, predicted without a
simulation and then simulated; and the least kp with which servos would still carry it.
"""

import pupper_analysis as pa


def main() -> None:
    """Predicts the steady state under the servos, simulates it, and softens the servos."""
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
