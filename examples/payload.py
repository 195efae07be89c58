"""Compute the largest payload on the back, and the limit that determines it.

The output shows three limits: by the torque of the motors, by the stiffness of the servos, and by
the reach of the legs and the contacts. The motors of Pupper v3 would carry 16 kg; with its soft
servos it buckles under 6.0 kg.
"""

import pupper_analysis as pa

BACK = (0.0, 0.0, 0.08)
"""Position of the payload's mass in the frame of the base [m]."""


def main() -> None:
    """Print the limits, and the motor utilisation with half of the payload on the back."""
    robot = pa.load_variant("v3")
    limit = pa.payload_limit(robot, point=BACK)
    for name in ("motors", "servos", "stance"):
        bound = getattr(limit, name)
        print(f"{name:9} {bound.mass:6.2f} kg: {bound.failure.value}")
    print(f"limit     {limit.mass:6.2f} kg, by the {limit.binding}")

    loaded = pa.robot.with_payload(robot, limit.mass / 2, BACK)
    held = pa.stance.stand_statics(loaded, pa.stance.solve_stand_as_simulated(loaded))
    print(f"half of it takes {held.motor_utilisation.max():.0%} of the motors")


if __name__ == "__main__":
    main()
