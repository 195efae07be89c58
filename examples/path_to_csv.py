"""Write a path for a real robot: a squat through three stances, with the torques that it requires.

The output shows the largest motor utilisation of the path, and the smallest distance of the
zero-moment point from the edge of the support polygon. squat.csv contains time, joint positions and
torques of every sample, with units in the header.
"""

import pupper_analysis as pa

SECONDS = 2.0
"""Duration of the path [s]."""


def main() -> None:
    """Lower the base by a fifth of its height, raise it again, and write the path."""
    robot = pa.load_variant("v3")
    high = pa.StandTask()
    low = pa.StandTask(height=0.8 * robot.stand_height)
    path = pa.stance.stance_path(robot, [high, low, high], SECONDS, rate=20.0)
    path.to_csv("squat.csv")
    print(f"{len(path.time)} samples in {path.time[-1]:.1f} s to squat.csv")
    print(f"motors: {path.peak_utilisation:.1%} of {path.peak_joint} at {path.peak_time:.2f} s")
    print(f"zero-moment point: {1e3 * path.zmp_margin.min():.1f} mm inside or more")


if __name__ == "__main__":
    main()
