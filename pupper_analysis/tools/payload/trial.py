"""Does a payload really stay up: MuJoCo with the mass on the robot, nudged from all sides."""

from __future__ import annotations

from dataclasses import dataclass

from numpy.typing import ArrayLike

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.stability import LASTING
from pupper_analysis.robot.tool import Place
from pupper_analysis.simulation.trial import NudgeTrial, simulate_nudges
from pupper_analysis.stance.soft_ground import solve_loaded_stand
from pupper_analysis.stance.stand import Stand
from pupper_analysis.stance.task import StandTask


@dataclass(frozen=True, eq=False)
class PayloadTrial(NudgeTrial):
    """Simulations of a loaded stand that is nudged from all sides.

    Attributes:
        mass: Of the payload (kg).
    """

    mass: float


@check_arguments
def simulate_payload(
    robot: Robot,
    stance: StandTask | Stand,
    mass: float,
    point: Place = (0.0, 0.0, 0.0),
    *,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    duration: float = LASTING,
    dry_friction: bool = False,
) -> PayloadTrial:
    """Simulates a stance with a mass on the robot, as ``simulate_nudges`` does.

    It begins in the stand that ``stand --payload`` judges (``solve_loaded_stand``), with
    feed-forward for the load.

    Args:
        robot: The robot.
        stance: The stance; of a stand, its task.
        mass: Of the payload (kg).
        point: Where it is, as in ``with_payload``.
        kp: Servo stiffness (N m/rad); the model's own by default.
        kd: Servo damping (N m s/rad); the model's own by default.
        duration: Simulated time (s), at least 2.
        dry_friction: Keep the model's dry friction of joints and rolling feet.

    Returns:
        What happened.

    Raises:
        ConfigurationError: If an argument is out of its range, or the robot cannot stand.
        ModelError: If the model has no position servos, and kp and kd are not both given.
        StanceUnreachableError: If the stance is out of reach with that load.
        StaticsInfeasibleError: If no contact forces balance it.
    """
    loaded, stand = solve_loaded_stand(robot, stance, mass, point)
    seen = simulate_nudges(
        loaded, stand, kp=kp, kd=kd, duration=duration, dry_friction=dry_friction
    )
    return PayloadTrial(**vars(seen), mass=float(mass))
