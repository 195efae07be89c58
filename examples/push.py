"""How hard can it be pushed: the largest impulse, forward, left, back and right.

One sees that Pupper v3 is pushed over most easily in one direction, and how it then fails; and
beside it the impulse that would tip it over if it were rigid.
"""

import math

import pupper_analysis as pa


def main() -> None:
    """Print the largest push from which the stand recovers, in four directions."""
    robot = pa.load_variant("v3")
    pushed = pa.push_recovery(
        robot, pa.stance.solve_stand_as_simulated(robot), directions=4, duration=3.0, resolution=0.1
    )
    rows = zip(
        pushed.directions, pushed.impulses, pushed.tipping_estimate, pushed.failures, strict=True
    )
    for direction, impulse, rigid, failure in rows:
        degrees = math.degrees(direction)
        print(f"{degrees:4.0f} deg: {impulse:.2f} N s ({rigid:.2f} if rigid), then: {failure}")
    print(f"weakest: {pushed.weakest_impulse:.2f} N s")


if __name__ == "__main__":
    main()
