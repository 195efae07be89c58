"""Stand on a slope and on three legs: the load of the contacts, and what is out of reach.

The output shows the load of each foot in contact and its friction utilisation, uphill with one foot
in the air; then the error for a roll that no leg can follow, with the possible values.
"""

import math

import pupper_analysis as pa


def main() -> None:
    """Solve a stand on three legs on a slope of 5 degrees, and one that is out of reach."""
    robot = pa.load_variant("v3")
    task = pa.StandTask(
        ground=pa.Ground(slope=math.radians(5)), swing={"FL": 0.02}, com="inside", com_margin=0.01
    )
    stand = pa.solve_stand(robot, task)
    held = pa.stance.stand_statics(robot, stand)
    for foot in stand.stance_feet:
        force, used = held.contact_forces[foot], held.friction_utilisation[foot]
        print(f"{foot} carries {force[2]:6.2f} N and uses {used:.0%} of its friction")
    print(f"the com is {1e3 * held.com_margin:.0f} mm inside the support polygon")
    try:
        pa.solve_stand(robot, pa.StandTask(height=0.16, roll=0.4))
    except pa.StanceUnreachableError as error:
        print("out of reach; possible:", " or ".join(map(str, error.possible.values())))


if __name__ == "__main__":
    main()
