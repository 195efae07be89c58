"""On a slope, on three legs: what the contacts carry, and what is out of reach.

One sees the stand uphill with a foot in the air, the load of each foot that carries and how much of
its friction it uses; then a roll that no leg can follow is refused, with how far it could go.
"""

import math

import pupper_analysis as pa


def main() -> None:
    """Stands on three legs on a slope of 5 degrees, and then asks for too much."""
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
