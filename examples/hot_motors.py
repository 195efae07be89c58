"""Predict which motor of a standing robot is closest to its temperature limit.

The output shows, without payload and with 2 kg, the joint whose motor is closest to its limit, the
copper loss of all motors and the final temperature of the winding.
"""

import pupper_analysis as pa
from pupper_analysis.models.motors.reading import find_motor
from pupper_analysis.tools.heat.heat import study_heat


def main() -> None:
    """Print the loss of all motors, and the motor closest to its limit, for two payloads."""
    motor = find_motor("dephy-actpack")
    for mass in (0.0, 2.0):
        robot = pa.load_variant("v3")
        if mass:
            robot = pa.robot.with_payload(robot, mass, (0.0, 0.0, 0.05))
        study = study_heat(robot, pa.StandTask(), dict.fromkeys(robot.joint_names, motor))
        first = study.first
        print(
            f"payload {mass:.0f} kg: all motors {study.loss:.1f} W,"
            f" {first.joint} settles at {first.steady_temperature:.1f} degC"
        )


if __name__ == "__main__":
    main()
