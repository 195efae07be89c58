"""How much does it carry: the greatest mass on its back, and what gives way first.

One sees three limits: what the motors give, what the servos' stiffness holds up, and up to where
the legs reach and the contacts bear it. Pupper v3's motors would carry 16 kg; its soft servos let
it buckle under 6.0 kg.
"""

import pupper_analysis as pa

BACK = (0.0, 0.0, 0.08)
"""Where the mass is, in the base's frame (m)."""


def main() -> None:
    """Print the limits, and what the motors hold with half of the least one on the back."""
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
