"""Record the numbers that the package computes for its variants in ``tests/data/recorded.json``.

``python -m tests.recorded`` writes the file. Write it after an intended change of numbers that the
changelog describes. All numbers of a result are recorded, except the fields ``WORK_FIELDS``. An
array with more than ``MAX_RECORDED_ELEMENTS`` elements is recorded as the products with three fixed
vectors, which depend on all elements.
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

RECORD_FILE = Path(__file__).parent / "data" / "recorded.json"
"""File of the recorded numbers."""

ENGINES = ("mujoco", "pin", "placo", "clarabel", "numpy", "scipy")
"""Packages whose versions are recorded with the numbers."""

ROUNDING_RTOL = 1e-12
"""Relative tolerance of results with one answer: closed forms of the engines, and linear
equations."""

CONE_RTOL = 1e-7
"""Relative tolerance of results of Clarabel if friction is a constraint, or a peak torque is
minimised. Clarabel's duality gaps are 1e-11. The minimum has this error; the position of the
minimum has the square root of this error.
"""

EIGENVALUE_RTOL = 1e-10
"""Relative tolerance of the minimum stiffness. OpenBLAS kernels for other processors
(``OPENBLAS_CORETYPE``: Haswell, Sandybridge) change the result by up to 1.6e-11."""

SIMULATION_RTOL = 1e-8
"""Relative tolerance of simulations: within two seconds a difference of 1e-16 m in the initial
state of a skeleton grows to 1e-9 N."""

FIELD_RTOL = {"ground_clearance/distance": 5e-12}
"""{field: larger tolerance} of fields that were less exact when recorded. Coal treated a cylinder
tilted by 1e-10 rad as upright; the edge of the tilted cylinder is 2.5e-12 m higher."""

MAX_RECORDED_ELEMENTS = 8
"""Number of elements above which an array is recorded as products, which keeps the file small."""

WORK_FIELDS = {"iterations", "evaluations", "rollouts", "simulated"}
"""Fields that count computations and are not recorded."""


@dataclass(frozen=True)
class Job:
    """Computation for a variant.

    Attributes:
        compute: Function of a robot and its nominal stand.
        tolerance: Allowed change of a number, relative to the largest number of the array, but at
            least to 1 (m, rad, N, kg).
        slow: Whether the computation takes too long for a quick test.
        same_engines: Whether the numbers may differ with other versions of the engines.
        why: Reason for ``same_engines``.
    """

    compute: Callable[[pa.Robot, pa.Stand], object]
    tolerance: float = ROUNDING_RTOL
    slow: bool = False
    same_engines: bool = False
    why: str = ""


def make_tilted_task(robot: pa.Robot) -> pa.StandTask:
    """Return a task with requirements of many kinds, within reach of all variants."""
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


def sweep_servo_gains(robot: pa.Robot, stand: pa.Stand) -> dict[str, object]:
    """Return the fields of a sweep of servo gains without the modes.

    The doubling time of a mode that hardly grows has few exact digits.
    """
    found = pa.simulation.sweep_gains(robot, stand, kp=(5, 20), kd=(0.2, 0.5), duration=2.0)
    modes = ("lasts", "doubling_time", "damping_ratio")
    return {name: value for name, value in vars(found).items() if name not in modes}


def make_three_legged_task(robot: pa.Robot) -> pa.StandTask:
    """Return a task with one foot in the air."""
    return pa.StandTask(swing={robot.contact_points[0]: 0.02}, com="inside", com_margin=0.005)


def evaluate_configuration(robot: pa.Robot, _: pa.Stand) -> dict[str, object]:
    """Return all quantities of a configuration at a random state."""
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


def make_statics_job(distribution: str) -> Callable[[pa.Robot, pa.Stand], object]:
    """Return a function that computes a force distribution for three stands.

    The stands are on level ground, on a slope, and on three feet.
    """

    def compute(robot: pa.Robot, stand: pa.Stand) -> object:
        """Return the static loads of three stands."""
        stands = (
            stand,
            *(
                pa.solve_stand(robot, task(robot))
                for task in (make_tilted_task, make_three_legged_task)
            ),
        )
        return [
            pa.stance.stand_statics(robot, stand, distribution=distribution) for stand in stands
        ]

    return compute


def compute_slow_motion(robot: pa.Robot, stand: pa.Stand) -> object:
    """Return the forces of a slow motion at the nominal stand."""
    pace = np.arange(robot.nv)
    config = pa.Configuration(robot, stand.qpos, 0.05 * np.sin(pace))
    return pa.statics.inverse_dynamics(config, 0.3 * np.cos(pace))


def cross_check_robot(robot: pa.Robot, _: pa.Stand) -> object:
    """Return the agreement of the engines, and the scale of each quantity.

    The differences between the engines are rounding errors, and are not recorded.
    """
    check = pa.cross_check(robot, configurations=3)
    return {
        "passed": check.passed,
        "scales": {quantity.name: quantity.scale for quantity in check.quantities},
    }


def make_squat_tasks(robot: pa.Robot) -> list[pa.StandTask]:
    """Return the tasks of a path from the nominal stand to a lower one."""
    return [pa.StandTask(), pa.StandTask(height=0.93 * robot.stand_height, roll=0.02)]


SEARCH_REASON = "it is found by a search that ends within a tolerance"
"""Reason for ``same_engines`` of a search."""

SIMULATION_REASON = "a simulation rounds otherwise with another engine"
"""Reason for ``same_engines`` of a simulation."""


def verify_nominal_stand(robot: pa.Robot, stand: pa.Stand) -> dict[str, Any]:
    """Return the verification of a stand without ``creep`` and ``stability``.

    The eigenvalues of a step come from differences, exact to 1e-9.
    """
    found = pa.verify_stand(robot, stand, duration=2.0, nudged=0).to_dict()
    del found["creep"]  # depends on the short settling of 2 s; other tests check the creep
    return {name: value for name, value in found.items() if name != "stability"}


def find_payload_bounds(robot: pa.Robot, stand: pa.Stand) -> dict[str, Any]:
    """Return {bound: mass [kg]} of the payload search without simulations."""
    from pupper_analysis.tools.payload.limit import _PayloadSearch

    search = _PayloadSearch(robot, stand.task, find_place(robot, (0.01, 0.0, 0.05)), None, None)
    return {name: bound.mass for name, bound in search.find_bounds().items()}


JOBS = {
    "configuration": Job(evaluate_configuration),
    "nominal stand": Job(lambda _, stand: stand),
    "tilted stand": Job(lambda robot, _: pa.solve_stand(robot, make_tilted_task(robot))),
    "stand on three feet": Job(
        lambda robot, _: pa.solve_stand(robot, make_three_legged_task(robot))
    ),
    "stand off centre": Job(
        lambda robot, _: pa.solve_stand(robot, pa.StandTask(offset=(0.004, -0.003)))
    ),
    "sunk stand": Job(lambda robot, _: pa.stance.solve_stand_on_soft_ground(robot)),
    "minimum tangential": Job(make_statics_job("minimum tangential"), CONE_RTOL),
    "minimum torque": Job(make_statics_job("minimum torque"), CONE_RTOL),
    "min-max torque": Job(make_statics_job("min-max torque"), CONE_RTOL),
    "nominal statics": Job(lambda robot, stand: pa.stance.stand_statics(robot, stand)),
    "inverse dynamics": Job(compute_slow_motion, CONE_RTOL),
    "steady state": Job(lambda robot, stand: pa.steady_state(robot, stand), EIGENVALUE_RTOL),
    "path": Job(
        lambda robot, _: pa.stance.stance_path(robot, make_squat_tasks(robot), 2.0, rate=8.0),
        CONE_RTOL,
    ),
    "cross-check": Job(cross_check_robot),
    "payload": Job(find_payload_bounds, 2e-3, slow=True, same_engines=True, why=SEARCH_REASON),
    "verification": Job(
        verify_nominal_stand, SIMULATION_RTOL, same_engines=True, why=SIMULATION_REASON
    ),
    "minimum stiffness": Job(
        lambda robot, stand: pa.stance.minimum_stiffness(robot, stand),
        slow=True,
        same_engines=True,
        why=SEARCH_REASON,
    ),
    "workspace": Job(
        lambda robot, _: pa.stance.base_workspace(robot),
        slow=True,
        same_engines=True,
        why=SEARCH_REASON,
    ),
    "push": Job(
        lambda robot, stand: pa.push_recovery(robot, stand, directions=3, resolution=0.2),
        SIMULATION_RTOL,
        slow=True,
        same_engines=True,
        why=SIMULATION_REASON,
    ),
    "gain sweep": Job(
        sweep_servo_gains, SIMULATION_RTOL, slow=True, same_engines=True, why=SIMULATION_REASON
    ),
}
"""{name of a computation: function and tolerances}."""


def compute_numbers(name: str, job: str) -> dict[str, Any]:
    """Return the numbers of a job for a variant, or the numbers of the error."""
    try:
        return list_numbers(JOBS[job].compute(load(name), stand_of(name)))
    except pa.PupperAnalysisError as error:
        return {f"refused: {type(error).__name__}": 1.0} | list_numbers(vars(error))


def list_numbers(result: object) -> dict[str, Any]:
    """Return {path of a field: number, or list of numbers} of a result."""
    found: dict[str, Any] = {}
    _collect_numbers("", orjson.loads(to_json(result)), found)
    return found


def _collect_numbers(where: str, value: Any, found: dict[str, Any]) -> None:
    """Add the numbers of a value and of its fields to ``found``."""
    if isinstance(value, dict):
        for name, inner in value.items():
            if name not in WORK_FIELDS:
                _collect_numbers(f"{where}/{name}" if where else name, inner, found)
    elif isinstance(value, list):
        flat = _flatten_list(value)
        if flat is None:
            for index, inner in enumerate(value):
                _collect_numbers(f"{where}/{index}", inner, found)
        elif len(flat) > MAX_RECORDED_ELEMENTS:
            found[f"{where} {np.shape(value)}"] = compute_products(np.array(flat))
        elif flat:
            found[where] = flat
    elif isinstance(value, (bool, int, float)):
        found[where] = float(value)


def _flatten_list(value: list[Any]) -> list[float] | None:
    """Return the numbers of a nested list as a flat list, or None if it is not an array."""
    try:
        array = np.array(value)
    except ValueError:  # rows of unequal length
        return None
    if array.dtype.kind not in "bif":
        return None
    flat: list[float] = array.astype(float).ravel().tolist()
    return flat


def compute_products(values: np.ndarray) -> list[float]:
    """Return the products of an array with three fixed vectors without equal or zero elements."""
    index = np.arange(len(values))
    return [float(values @ np.cos(index * pace + pace)) for pace in (0.1, 1.0, 2.6)]


def read_setting() -> dict[str, str]:
    """Return the versions of the engines, and the machine."""
    return {name: version(name) for name in ENGINES} | {"machine": platform.machine()}


def main() -> None:
    """Write the file of recorded numbers."""
    results = {name: {job: compute_numbers(name, job) for job in JOBS} for name in NAMES}
    RECORD_FILE.parent.mkdir(exist_ok=True)
    RECORD_FILE.write_bytes(orjson.dumps({"setting": read_setting(), "results": results}) + b"\n")
    print(f"{RECORD_FILE}: {RECORD_FILE.stat().st_size // 1000} kB")


if __name__ == "__main__":
    main()
