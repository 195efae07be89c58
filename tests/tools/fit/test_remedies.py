"""What else could be measured tells what physics says that it does, and no more."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pupper_analysis.pupper.variant_files import load_variant
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import own_servos
from pupper_analysis.stance.stand import solve_stand, stand_statics
from pupper_analysis.stance.task import StandTask
from pupper_analysis.tools.fit.estimate import Linearised, Posterior, estimate_parameters
from pupper_analysis.tools.fit.measurements.stands import MeasuredStands
from pupper_analysis.tools.fit.parameters import ParameterTable, give_widths
from pupper_analysis.tools.fit.stands.equations import StandEquations, StandNoise
from pupper_analysis.tools.fit.stands.fit import further_measurements, on_three_feet, parameters_of

Array = NDArray[np.float64]

FRICTION = 0.01


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_variant("v3")


@pytest.fixture(scope="module")
def equations(robot: Robot) -> StandEquations:
    """Of four stands on four feet, with servos that hold them as the file has it."""
    kp = np.array([own_servos(robot)[name][0] for name in robot.joint_names])
    size, command, position = robot.stand_height, [], []
    for height, roll, pitch in ((0.8, 0.1, 0.0), (0.9, -0.1, 0.1), (1.0, 0.0, -0.1), (0.85, 0, 0)):
        stand = solve_stand(robot, StandTask(height=height * size, roll=roll, pitch=pitch))
        position.append(stand.qpos[7:])
        command.append(stand.qpos[7:] + stand_statics(robot, stand).joint_torques / kp)
    stands = MeasuredStands(
        source="held",
        names=("a", "b", "c", "d"),
        joints=robot.joint_names,
        command=np.array(command),
        position=np.array(position),
        tilt=np.full((4, 2), np.nan),
        swing=((),) * 4,
    )
    friction = np.full(robot.nu, FRICTION)
    table = ParameterTable(give_widths(parameters_of(robot, stands, kp)))
    noise = StandNoise(encoder=1e-4, moment=1e-4)
    return StandEquations(robot, stands, table, kp, friction, noise)


@pytest.fixture(scope="module")
def posterior(equations: StandEquations) -> Posterior:
    def linearise(x: Array, about: Array) -> Linearised:
        return equations.linearise(x, about)

    return estimate_parameters(equations.table, linearise)


@pytest.fixture(scope="module")
def further(equations: StandEquations, posterior: Posterior) -> dict[str, Array]:
    return dict(further_measurements(equations, posterior, weighed=False))


def common_factor(equations: StandEquations) -> Array:
    """All masses and stiffnesses larger by the same share, in the priors' widths."""
    shares = [one.stated if one.kind in ("mass", "kp") else 0.0 for one in equations.table]
    line = np.array(shares) / equations.table.width
    return np.asarray(line / np.linalg.norm(line), dtype=float)


def test_no_stand_tells_a_common_factor_of_masses_and_stiffnesses(
    equations: StandEquations, posterior: Posterior, further: dict[str, Array]
) -> None:
    """Balance is homogeneous in torques. Dry friction is none better known than masses are.

    Soft ground tells it a little: how far feet sink, by 0.3 mm of an uneven ground.
    """
    line = common_factor(equations)

    def widest(information: Array) -> float:
        return float(line @ information @ line)

    ground = widest(posterior.information)
    assert ground < 20
    for what in ("stand-on-three-feet", "read-an-imu"):
        assert widest(further[what]) < 2 * ground + 1, what
    assert widest(further["weigh-the-robot"]) > 100


def test_on_three_feet_each_foot_is_in_the_air_once_and_nothing_is_off(
    robot: Robot, equations: StandEquations, posterior: Posterior
) -> None:
    x = posterior.mean
    three = on_three_feet(equations, x)
    assert three is not None
    carrying = [set(three.normal_forces(stand)) for stand in range(4)]
    lifted = [set(robot.feet) - feet for feet in carrying]
    assert sorted(foot for one in lifted for foot in one) == sorted(robot.feet)
    weight = robot.total_mass * 9.81
    found = three.linearise(x, x)
    assert found.chi2 < 0.1 * found.rows  # servos hold it
    for stand in range(4):
        forces = three.normal_forces(stand)
        assert sum(forces.values()) == pytest.approx(weight, rel=0.01)
        assert min(forces.values()) > 0.02 * weight
    assert on_three_feet(three, x) is None  # they are that already
