"""From a squat to a file: a smooth path through stances, and the torques that it takes.

One sees how much of the motors the path uses, and how far inside the support polygon the
zero-moment point stays; and finds squat.csv: time, joint positions and torques of every sample,
with the units in the header, for a real robot to play.
"""

import pupper_analysis as pa

SECONDS = 2.0


def main() -> None:
    """Squats by a fifth of the height and rises again."""
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
