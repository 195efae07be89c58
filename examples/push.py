"""Compute the largest impulse from which the robot recovers: forward, left, back and right.

The output shows the impulse of each direction, the failure under a larger one, and for comparison
the impulse that would tip a rigid robot over.
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
