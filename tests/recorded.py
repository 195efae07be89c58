"""What the package computed of its variants when `tests/data/recorded.json` was written.

`python -m tests.recorded` writes the file anew: after a change that is meant to change numbers, and
which says so in the changelog. Of each result every number is taken, whatever its fields are
called; of a long array its products with three fixed vectors, which any of its elements changes.
"""

from __future__ import annotations

import platform
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import orjson

import pupper_analysis as pa
from pupper_analysis.base.results import to_json
from pupper_analysis.robot.tool import find_place
from tests.support.states import random_state
from tests.support.variants import NAMES, load, stand_of

FILE = Path(__file__).parent / "data" / "recorded.json"

ENGINES = ("mujoco", "pin", "placo", "clarabel", "numpy", "scipy")

ROUNDING = 1e-12
"""Of what has one answer: the engines' closed forms, and equations solved to the last digits."""

CONES = 1e-7
"""Of what Clarabel finds where friction binds, or the peak is least: its gaps are 1e-11, and a
minimum is as flat as their root. The least peak itself is within 1e-11."""

EIGENVALUE = 1e-10
"""Of the least stiffness: with OpenBLAS's kernels of other processors (``OPENBLAS_CORETYPE``:
Haswell, Sandybridge) it is up to 1.6e-11 of itself off."""

STEPPED = 1e-8
"""Of simulations: in two seconds the skeletons' makes 1e-9 N of a start that is 1e-16 m off."""

COARSE = {"ground_clearance/distance": 5e-12}
"""Fields that were less exact when they were recorded: coal took a cylinder that is tilted by
1e-10 rad for an upright one, whose edge is 2.5e-12 m higher."""

LONG = 8
"""More elements than that are multiplied, so that the file stays small."""

WORK = {"iterations", "evaluations", "rollouts", "simulated"}
"""Fields that count what it took, and no number of the robot's."""


@dataclass(frozen=True)
class Job:
    """Something that is computed of a variant.

    Attributes:
        compute: Of a robot and its nominal stand.
        tolerance: How much the numbers may change, relative to the largest of their array, or to 1
            (m, rad, N, kg) if that is more.
        slow: Whether it takes too long for a quick test.
        same_engines: Whether other versions of the engines may find other numbers, for a reason
            that ``why`` tells.
        why: That reason.
    """

    compute: Callable[[pa.Robot, pa.Stand], object]
    tolerance: float = ROUNDING
    slow: bool = False
    same_engines: bool = False
    why: str = ""


def tilted(robot: pa.Robot) -> pa.StandTask:
    """A task with something in each of its numbers, in reach of every variant."""
    return pa.StandTask(
        height=0.94 * robot.stand_height,
        roll=0.03,
        pitch=-0.04,
        yaw=0.05,
        foot_offsets={robot.contact_points[1]: (0.004, -0.003)},
        ground=pa.Ground(slope=0.08, uphill=0.6, heights={robot.contact_points[0]: 0.004}),
        com=(0.003, -0.002),
        joint_margin=0.01,
    )


def gain_sweep(robot: pa.Robot, stand: pa.Stand) -> dict[str, object]:
    """What is simulated; of modes that hardly grow a doubling time has few digits."""
    found = pa.simulation.sweep_gains(robot, stand, kp=(5, 20), kd=(0.2, 0.5), duration=2.0)
    modes = ("lasts", "doubling_time", "damping_ratio")
    return {name: value for name, value in vars(found).items() if name not in modes}


def three_legged(robot: pa.Robot) -> pa.StandTask:
    """A task with a foot in the air."""
    return pa.StandTask(swing={robot.contact_points[0]: 0.02}, com="inside", com_margin=0.005)


def configuration(robot: pa.Robot, _: pa.Stand) -> dict[str, object]:
    """Everything that a configuration says, at a state with all its elements in play."""
    qpos, qvel = random_state(robot, 7)
    config = pa.Configuration(robot, qpos, qvel)
    qacc = np.sin(np.arange(robot.nv) + 1.0)
    wrenches = {foot: np.cos(np.arange(6) + n) for n, foot in enumerate(robot.contact_points)}
    return {
        "foot_positions": config.foot_positions(),
        "foot_jacobians": config.foot_jacobians(),
        "contact_points": config.contact_points(),
        "contact_jacobians": {
            foot: config.point_jacobian(robot.contact_frames[foot], point)
            for foot, point in config.contact_points().items()
        },
        "center_of_mass": config.center_of_mass(),
        "com_jacobian": config.com_jacobian(),
        "mass_matrix": config.mass_matrix(),
        "bias_forces": config.bias_forces(),
        "gravity": config.gravity(),
        "static_rates": config.static_load_derivative(wrenches),
        "forward_dynamics": config.forward_dynamics(qacc),
        "foot_accelerations": config.foot_accelerations(qacc),
        "com_acceleration": config.com_acceleration(qacc),
        "imu": config.imu(qacc, robot.base),
        "joint_axes": {name: config.joint_axis(name) for name in robot.joint_names},
    }


def statics(distribution: str) -> Callable[[pa.Robot, pa.Stand], object]:
    """The forces of a distribution, on level ground, on a slope, and on three feet."""

    def compute(robot: pa.Robot, stand: pa.Stand) -> object:
        stands = (stand, *(pa.solve_stand(robot, task(robot)) for task in (tilted, three_legged)))
        return [pa.stance.stand_statics(robot, one, distribution=distribution) for one in stands]

    return compute


def moving(robot: pa.Robot, stand: pa.Stand) -> object:
    """The forces of a slow motion out of the nominal stand."""
    pace = np.arange(robot.nv)
    config = pa.Configuration(robot, stand.qpos, 0.05 * np.sin(pace))
    return pa.statics.inverse_dynamics(config, 0.3 * np.cos(pace))


def checked(robot: pa.Robot, _: pa.Stand) -> object:
    """What the engines agree in; what they differ by is rounding."""
    check = pa.cross_check(robot, configurations=3)
    return {"passed": check.passed, "scales": {one.name: one.scale for one in check.quantities}}


def squat(robot: pa.Robot) -> list[pa.StandTask]:
    return [pa.StandTask(), pa.StandTask(height=0.93 * robot.stand_height, roll=0.02)]


SEARCHED = "it is found by a search that ends within a tolerance"
SIMULATED = "a simulation rounds otherwise with another engine"


def verification(robot: pa.Robot, stand: pa.Stand) -> dict[str, Any]:
    """But for its spectrum: a step's eigenvalues come from differences, to 1e-9 of 1."""
    found = pa.verify_stand(robot, stand, duration=2.0, nudged=0).to_dict()
    del found["creep"]  # of a settling of 2 s: it is tested where it is measured
    return {name: value for name, value in found.items() if name != "stability"}


def payload(robot: pa.Robot, stand: pa.Stand) -> dict[str, Any]:
    """What each bound lets a stance carry, and where: of a simulation there are other tests."""
    from pupper_analysis.tools.payload.limit import _PayloadSearch

    search = _PayloadSearch(robot, stand.task, find_place(robot, (0.01, 0.0, 0.05)), None, None)
    return {name: bound.mass for name, bound in search.find_bounds().items()}


JOBS = {
    "configuration": Job(configuration),
    "nominal stand": Job(lambda _, stand: stand),
    "tilted stand": Job(lambda robot, _: pa.solve_stand(robot, tilted(robot))),
    "stand on three feet": Job(lambda robot, _: pa.solve_stand(robot, three_legged(robot))),
    "stand off centre": Job(
        lambda robot, _: pa.solve_stand(robot, pa.StandTask(offset=(0.004, -0.003)))
    ),
    "sunk stand": Job(lambda robot, _: pa.stance.solve_stand_on_soft_ground(robot)),
    "minimum tangential": Job(statics("minimum tangential"), CONES),
    "minimum torque": Job(statics("minimum torque"), CONES),
    "min-max torque": Job(statics("min-max torque"), CONES),
    "nominal statics": Job(lambda robot, stand: pa.stance.stand_statics(robot, stand)),
    "inverse dynamics": Job(moving, CONES),
    "steady state": Job(lambda robot, stand: pa.steady_state(robot, stand), EIGENVALUE),
    "path": Job(lambda robot, _: pa.stance.stance_path(robot, squat(robot), 2.0, rate=8.0), CONES),
    "cross-check": Job(checked),
    "payload": Job(payload, 2e-3, slow=True, same_engines=True, why=SEARCHED),
    "verification": Job(verification, STEPPED, same_engines=True, why=SIMULATED),
    "minimum stiffness": Job(
        lambda robot, stand: pa.stance.minimum_stiffness(robot, stand),
        slow=True,
        same_engines=True,
        why=SEARCHED,
    ),
    "workspace": Job(
        lambda robot, _: pa.stance.base_workspace(robot), slow=True, same_engines=True, why=SEARCHED
    ),
    "push": Job(
        lambda robot, stand: pa.push_recovery(robot, stand, directions=3, resolution=0.2),
        STEPPED,
        slow=True,
        same_engines=True,
        why=SIMULATED,
    ),
    "gain sweep": Job(gain_sweep, STEPPED, slow=True, same_engines=True, why=SIMULATED),
}


def computed(name: str, job: str) -> dict[str, Any]:
    """The numbers of a job for a variant; of a refusal, its own."""
    try:
        return numbers(JOBS[job].compute(load(name), stand_of(name)))
    except pa.PupperAnalysisError as error:
        return {f"refused: {type(error).__name__}": 1.0} | numbers(vars(error))


def numbers(result: object) -> dict[str, Any]:
    """Every number of a result, {where: a number, or a list of numbers}."""
    found: dict[str, Any] = {}
    _walk("", orjson.loads(to_json(result)), found)
    return found


def _walk(where: str, value: Any, found: dict[str, Any]) -> None:
    if isinstance(value, dict):
        for name, inner in value.items():
            if name not in WORK:
                _walk(f"{where}/{name}" if where else name, inner, found)
    elif isinstance(value, list):
        flat = _flat(value)
        if flat is None:
            for index, inner in enumerate(value):
                _walk(f"{where}/{index}", inner, found)
        elif len(flat) > LONG:
            found[f"{where} {np.shape(value)}"] = products(np.array(flat))
        elif flat:
            found[where] = flat
    elif isinstance(value, (bool, int, float)):
        found[where] = float(value)


def _flat(value: list[Any]) -> list[float] | None:
    """The numbers of an array of any depth, or None if it is none."""
    try:
        array = np.array(value)
    except ValueError:  # rows of unequal length
        return None
    if array.dtype.kind not in "bif":
        return None
    flat: list[float] = array.astype(float).ravel().tolist()
    return flat


def products(values: np.ndarray) -> list[float]:
    """Products with three vectors, no two of whose elements are equal or zero."""
    index = np.arange(len(values))
    return [float(values @ np.cos(index * pace + pace)) for pace in (0.1, 1.0, 2.6)]


def setting() -> dict[str, str]:
    """What the numbers depend on."""
    return {name: version(name) for name in ENGINES} | {"machine": platform.machine()}


def main() -> None:
    results = {name: {job: computed(name, job) for job in JOBS} for name in NAMES}
    FILE.parent.mkdir(exist_ok=True)
    FILE.write_bytes(orjson.dumps({"setting": setting(), "results": results}) + b"\n")
    print(f"{FILE}: {FILE.stat().st_size // 1000} kB")


if __name__ == "__main__":
    main()
