"""Stub results for tests of documents and reports, with numbers that all differ.

Each stub has the fields that its document reads. A number that is shown twice or not at all, a
wrong unit and exchanged columns are visible.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from importlib import import_module
from types import SimpleNamespace as Stub
from typing import Any

import numpy as np

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.tools import own_tools
from pupper_analysis.models.efforts import EffortStatement
from pupper_analysis.models.transmission import Drive, MadeServo
from pupper_analysis.present.document import Document, Name, Report, text
from pupper_analysis.robot.as_published import ServoSource, ServosUsed
from pupper_analysis.robot.compare.compare import FilesCompared
from pupper_analysis.simulation.servo_bounds import ServoBounds, ServoClass
from pupper_analysis.simulation.trial import Failure
from pupper_analysis.simulation.verdict import Outcome, Question, Verdict, judge_stance
from pupper_analysis.stance.task import StandTask


def tool(module: str) -> Any:
    """Import a module of ``pupper_analysis.tools``, which may be missing in a package without the
    tool.
    """
    return import_module(f"pupper_analysis.tools.{module}")


def problem(words: str) -> Diagnostic:
    """Return a diagnostic with these words."""
    return diagnose("problem", problem=words)


def loads(shift: float) -> Stub:
    """Return static loads of two motors and two feet, all increased by ``shift``."""
    return Stub(
        joint_names=("hip", "knee"),
        joint_torques=np.array([0.1111, -0.2222]) + shift,
        torque_units=("N m", "N m"),
        motor_utilisation=np.array([0.051, 0.952]) + shift,
        contact_forces={
            "FR": np.array([1.011, -2.022, 3.033]) + shift,
            "RL": np.array([4.044, -5.055, 6.066]) + shift,
        },
        weld_wrenches={},
        foot_loads={
            foot: Stub(
                force=np.array(force) + shift,
                friction_utilisation=used,
            )
            for foot, force, used in (
                ("FR", (1.011, -2.022, 3.033), 0.071),
                ("RL", (4.044, -5.055, 6.066), 0.082),
            )
        },
        com_margin=0.0123,
        residual_force=1.1e-11,
        residual_torque=2.2e-12,
    )


def run(shift: float, *, passed: bool) -> Stub:
    """Return a simulated stand, with errors increased by ``shift``."""
    return Stub(
        passed=passed,
        failures=() if passed else (problem("it sank"),),
        integrator="Euler",
        timestep=0.002,
        duration=12.0,
        kp=np.array([5.0, 6.0]),
        kd=np.array([0.1, 0.1]),
        collapses=False,
        is_lifted=False,
        stays=passed,
        base_height=0.12111 + shift,
        height_deviation=0.00002222 + shift,
        height_drift=-0.0000333 - shift,
        height_loss=0.004444 + shift,
        servo_sag=0.001555 + shift,
        contact_sag=0.002889 + shift,
        tilt=math.radians(0.6666) + shift,
        foot_slip={"FR": 0.0000777, "RL": 0.0001888 + shift},
        energy=None,
        joint_error=9.1e-5 + shift,
        joint_error_unit="rad",
        joint_torques=np.array([0.3333, -0.4444]),
        torque_units=("N m", "N m"),
        torque_error=0.01234 + shift,
        force_error=0.02356 + shift,
        mujoco_residual=4.2e-5,
        stability=None,
        creep=None,
        notes=(),
        feedforward=passed,
        time=np.array([0.0, 12.0]),
        height=np.array([0.12, 0.11]),
        motion_time=np.array([0.0]),
        motion=np.zeros((1, 7)),
    )


SERVOS = ServosUsed(ServoSource.FILE, (5.0, 6.0), (0.1, 0.1))
"""Servos of two motors, from the model file."""


ORIGINS = (
    EffortStatement.of("URDF", "joint", "one", "effort", (-3.3, 3.3)),
    EffortStatement.of("MJCF", "actuator", "two", "forcerange", (-4.4, 4.4)),
)
"""Origins of two torque limits."""


def joint(name: str, shift: float) -> Stub:
    """Return a joint with an oblique axis, with numbers increased by ``shift``."""
    return Stub(
        name=name,
        motion="oblique",
        is_sliding=False,
        is_oblique=True,
        axis=np.array([0.11, 0.22, -0.33]) + shift,
        lower=-1.51 + shift,
        upper=2.52 + shift,
        effort=3.3 + shift,
        velocity=14.4 + shift,
        armature=0.0051 + shift,
        damping=0.062 + shift,
        friction=0.073 + shift,
        effort_origin=ORIGINS[shift > 0],
    )


ANALYSIS: Any = Stub(
    name="stub",
    nq=19,
    nv=18,
    nu=12,
    total_mass=3.171,
    link_masses={"base": 1.501, "hip": 0.202, "knee": 0.202},
    center_of_mass=np.array([0.0101, -0.0202, 0.0303]),
    thigh_length=0.0811,
    calf_length=0.1122,
    joints=(joint("hip", 0.0), joint("knee", 0.5)),
    notes=(problem("a note"),),
    stand=Stub(
        task=StandTask(height=0.1),
        qpos=np.array([0.0, 0.0, 0.1009]),
        depths={"FR": 0.0, "RL": 0.00311},
        com_margin=0.0334,
        ground_clearance=Stub(distance=0.0112),
        self_clearance=Stub(distance=0.0223),
    ),
    foot_jacobians={
        "FR": Stub(
            matrix=np.array([[0.01, 0.02], [0.03, 0.04], [0.05, 0.06]]),
            singular_values=np.array([0.0951, 0.0052]),
            condition=18.29,
        )
    },
    statics=loads(0.0),
    min_max_torque=loads(-0.05),
    hanging_torques=np.array([0.0077, 0.0088]),
    verification=run(0.0, passed=True),
    sagging=run(0.01, passed=False),
    verdict=judge_stance(run(0.0, passed=True), run(0.01, passed=False), SERVOS),
    servos=None,
    sweep=Stub(
        kp=np.array([10.0, 30.0]),
        kd=np.array([0.5, 1.0, 2.0]),
        height_deviation=np.array([[1.1e-3, 2.2e-3, np.inf], [4.4e-3, 0.5e-3, 6.6e-3]]),
        lasts=np.array([[True, False, True], [True, True, True]]),
        amplitude=0.0,
        frequency=3.2,
        duration=4.3,
        integrator="implicitfast",
    ),
    check=Stub(
        configurations=21,
        tolerance=1e-9,
        worst="mass matrix",
        quantities=(
            Stub(
                name="mass matrix",
                location="knee, #3",
                edge="models (Pinocchio)",
                deviation=4.1e-5,
                relative=1.3e-4,
                passed=False,
            ),
            Stub(
                name="gravity",
                deviation=0.0,
                relative=0.0,
                passed=True,
            ),
        ),
        notes=(problem("another note"),),
    ),
    verified=False,
    failures=(problem("it leans"),),
)
"""Result of ``analyze`` with all optional parts."""


def row(name: str, shift: float, **changes: Any) -> Any:
    """Return a row of the comparison of variants, with numbers increased by ``shift``."""
    fields: dict[str, Any] = {
        "name": name,
        "base": "skeleton",
        "total_mass": 2.711 + shift,
        "mass_ratio": 1.122 + shift,
        "thigh_ratio": 1.533 + shift,
        "height": 0.1555 + shift,
        "peak_torque": 0.366 + shift,
        "peak_utilisation": 0.177 + shift,
        "servo_sag": 0.000888 + shift,
        "stands_without": True,
        "verified": True,
    }
    return tool("analyze.document").ComparisonRow(**{**fields, **changes})


def pushes(shift: float) -> Stub:
    """Return the push recovery in three directions, with numbers increased by ``shift``."""
    return Stub(
        directions=np.radians([0.0, 120.0, 240.0]),
        impulses=np.array([0.51, 0.62, 0.43]) + shift,
        tipping_estimate=np.array([0.84, 0.75, 0.96]) + shift,
        weakest_direction=math.radians(240.0),
        weakest_impulse=0.43 + shift,
        weakest_failure=problem("it falls"),
        failures=(problem("it rolls"), problem("it slides"), problem("it falls")),
        velocity_steps=np.array([0.237, 0.288, 0.201]) + shift,
        rollouts=77,
        simulated=123.0,
        duration=6.5,
        resolution=0.03,
        failures_without_push=(),
        mass=2.15,
    )


KNOWN = {"joint_names": ("hip", "knee"), "unknown_limits": (), "peak_torques": None,
         "torque_units": ("N m", "N m"), "motors": {}, "region_peaks": None,
         "beyond_times": None, "energy": None, "within_region": True}  # fmt: skip
"""Fields of a push result with known torque limits."""


def make_push_result(name: str, shift: float, depth: float) -> Any:
    """Return a push result of a robot: its stand, its recovery and its verdict."""
    stand = Stub(
        task=StandTask(height=0.1, yaw=math.radians(shift)), depths={"FR": depth / 2, "RL": depth}
    )
    verdict = judge_stance(run(0.0, passed=True), None, SERVOS, question=Question.LASTS)
    return Stub(
        name=name, passed=True, stand=stand, recovery=pushes(shift), verdict=verdict, **KNOWN
    )


STAND: Any = Stub(
    task=StandTask(height=0.1044, roll=math.radians(1.0)),
    com_margin=0.0333,
    qpos=np.array([0.0, 0.0, 0.1009]),
    depths={"FR": 0.0, "RL": 0.0},
    foot_targets={"FR": np.zeros(3), "RL": np.zeros(3)},
    stance_feet=("FR", "RL"),
    ground_clearance=Stub(distance=0.0111),
    self_clearance=Stub(distance=0.0222),
)
"""Stand on rigid ground."""

SUNK = {"depths": {"FR": 0.00311, "RL": 0.00422}, "qpos": np.array([0.0, 0.0, 0.1031])}
"""Fields of a stand on soft ground."""


SERVO_BOUNDS = ServoBounds(
    classes=(
        ServoClass("hip", ("hip",), 4.31, 5.1291, 0.0711, 1.3509),
        ServoClass("knee", ("knee",), 4.31, 5.1291, 0.0711, 1.3509),
    ),
    least_kp_factor=1.19,
    holding_kp_factor=1.31,
    largest_kd_factor=19.0,
    timestep=0.0037,
    integrator="implicitfast",
)


def stance(**changes: Any) -> Any:
    """Return a stance result; ``changes`` replace fields."""
    fields: dict[str, Any] = {
        "name": "stub",
        "stand": Stub(**{**vars(STAND), **SUNK}),
        "verification": run(0.0, passed=True),
        "joint_positions": np.array([0.6543, -0.7654]),
        "units": ("rad", "rad"),
        "statics": loads(0.0),
        "min_max_torque": loads(-0.05),
        "limits": np.array([3.1, 4.2]),
        "limit_origins": ORIGINS,
        "verdict": judge_stance(run(0.0, passed=True), None, SERVOS, overloaded_motors=("knee",)),
        "settled": Stub(
            height_loss=-0.00783,
            servo_sag=0.00789,
            contact_sag=0.00421,
            rolling_feet=(),
            failures=(problem("foot FR slides"),),
        ),
        "unsettled": None,
        "minimum_stiffness": 4.567,
        "soft_servos": None,
        "no_stiffness": None,
        "servos": SERVO_BOUNDS,
        "added_mass": 0.0,
        "sagging": Stub(stays=False),
        "passed": False,
        "presses": (),
    }
    return Stub(**{**fields, **changes})


def make_payload_result(*unknown: str) -> Any:
    """Return a payload result, in which the torque limits of the joints ``unknown`` are missing."""
    none = Stub(mass=math.inf, failure=Failure.NOTHING, failing_parts=())
    bounds = {
        "servos": Stub(mass=1.239, failure=Failure.BUCKLING, failing_parts=("knee",)),
        "motors": Stub(mass=4.569, failure=Failure.MOTOR, failing_parts=("hip",)),
        "stance": none,
        "simulation": none,
    }
    trial = Stub(mass=1.177, duration=12.0, failure=None, nudges=12, simulated=38.0)
    return Stub(
        name="stub",
        passed=not unknown,
        stand=Stub(**{**vars(STAND), **SUNK}),
        offset=np.array([-0.0123, 0.0045]),
        point=np.array([0.011, -0.022, 0.083]),
        link="base_link",
        mass=math.nan if unknown else 1.239,
        failing_parts=("knee",),
        failure=Failure.BUCKLING,
        bounds=bounds,
        upper_bound=1.239,
        unknown_limits=unknown,
        torque_by_joint={"hip": 1.0, "knee": -2.0},
        joint_torques=(1.0, 2.0),
        get_torque_unit=lambda _: "N m",
        continuous=(),
        weak_motors=(),
        mass_by_commands_alone=math.nan,
        failures_alone=(),
        motor_utilisation=np.where(np.isin(["hip", "knee"], unknown), np.nan, [0.25, 0.5]),
        torque_units=("N m", "N m"),
        joint_names=("hip", "knee"),
        binding="stance",
        depends_on_feedforward=False,
        carried=0.0,
        trial=trial,
        verdict=judge_stance(run(0.0, passed=True), None, SERVOS, question=Question.CARRIES),
    )


def make_path_result(**changes: Any) -> Any:
    """Return a result of a path with its tracking; ``changes`` replace fields."""
    path = Stub(
        feet=("FR", "RL"),
        loads=np.array([[3.33, 9.99], [7.77, 4.44], [8.88, 5.55]]),
        time=np.array([0.0, 1.5, 3.0]),
        peak_utilisation=0.321,
        peak_joint="knee",
        peak_time=1.23,
        peak_speed_utilisation=0.054,
        has_motion=True,
        motors={},
        com_margin=np.array([0.0311, 0.0222, 0.0333]),
        zmp_margin=np.array([0.0177, 0.0288, 0.0399]),
        qpos=np.tile([0.011, 0.022, 0.123, 0.9, 0.1, 0.2, 0.3], (3, 1)),
    )
    tracking = Stub(
        torque_error=0.012,
        joint_error=0.034,
        height_error=0.0067,
        orientation_error=0.089,
        foot_slip={"FR": 0.0011, "RL": 0.0023},
        energy=None,
        passed=True,
        failures=(),
        joint_error_unit="rad",
    )
    fields = {"name": "stub", "passed": True, "stand": STAND, "path": path, "tracking": tracking}
    verdict = judge_stance(
        Outcome(passed=True, failures=(), duration=3.0), None, SERVOS, question=Question.TRACKED
    )
    return Stub(**fields, **{"verdict": verdict, "largest_kd_factor": None, **changes})


def judge_added_servos(question: Question) -> Verdict:
    """Return a passing verdict on servos that were added to the joint ``knee``; see
    `ADDED_SERVOS_TEXT`.
    """
    servo = MadeServo("knee", 320.0, 16.0, Drive.MOTOR)
    servos = ServosUsed(ServoSource.ADDED, (320.0, 320.0), (16.0, 16.0), (servo,))
    outcome = Outcome(passed=True, failures=(), duration=3.0)
    return judge_stance(outcome, None, servos, question=question)


ADDED_SERVOS_TEXT = (
    "on servos that were added to 1 joints: knee (in the file: torque motor) (kp 320 N m/rad"
)
"""Text about the servos of `judge_added_servos`."""


def best() -> Any:
    """Return a result of a search for the best stance."""
    found = Stub(
        objective=tool("best.search").Objective.MARGIN,
        payload=None,
        stand=STAND,
        value=0.0456,
        nominal_value=0.0345,
        evaluations=321,
        improved=True,
        active_bounds=(),
        coordinates={"height": 0.1567, "pitch": math.radians(2.5), "FR x": -0.0123},
    )
    return Stub(best=found, stance=stance(), passed=False)


def workspace() -> Any:
    """Return the intervals of three coordinates of the base's pose."""
    intervals = {
        "height": Stub(low=0.0911, high=0.1922),
        "roll": Stub(low=math.radians(-13.3), high=math.radians(14.4)),
        "x": Stub(low=-0.0255, high=0.0366),
    }
    joints = diagnose("workspace-ends-at-joint-limits", joints=["FL_knee", "FR_knee", "RL_knee"])
    reach = diagnose("workspace-ends-at-reach")
    limits = dict.fromkeys(intervals, (joints, reach))
    return Stub(
        name="stub",
        start=STAND,
        intervals=intervals,
        limits=limits,
        mismatch=None,
        missing_masses=None,
        passed=True,
    )


def files() -> Any:
    """Return the comparison of two files that disagree."""
    difference = Stub(
        kind="mass",
        element="base",
        unit="kg",
        relative_effects=(0.34, 0.341),
        urdf=3.3,
        mjcf=6.9,
        message="link base: mass 3.3 kg in the URDF, 6.9 kg in the MJCF",
        diagnostic=problem("link base: mass 3.3 kg in the URDF, 6.9 kg in the MJCF"),
        urdf_place="a.urdf:5",
        mjcf_place="b.xml:44",
        effects={
            "gravity": Stub(share=0.45, relative=1.2e-2, deviation=9.0),
            "mass matrix": Stub(share=0.97, relative=3.4e-1, deviation=8.0),
        },
        made_of=(problem("in the URDF 3 kg: trunk 3 kg"),),
    )
    limit = Stub(
        kind="effort",
        element="knee",
        unit="N m",
        relative_effects=(0.0, 0.0),
        urdf=1.5,
        mjcf=2.5,
        message="joint knee: effort 1.5",
        diagnostic=problem("joint knee: effort 1.5"),
        urdf_place="a.urdf:7",
        mjcf_place="b.xml:55",
        effects={},
        made_of=(),
    )
    sides = {
        "models (Pinocchio)": 1.1e-1,
        "models (MuJoCo)": 2.2e-2,
        "engines (URDF)": 3.3e-13,
        "engines (MJCF)": 4.4e-14,
        "yourdfpy (URDF)": 5.5e-15,
        "extras (MJCF)": 6.6e-6,
    }
    quantity = Stub(name="mass matrix", edge_deviations=sides, passed=False, location="knee, #3")
    found: Any = Stub(
        urdf="a.urdf",
        mjcf="b.xml",
        agree=False,
        same_robot=False,
        floating=True,
        refusal=None,
        deviations={"gravity": 0.41, "mass matrix": 0.34},
        differences=(difference, limit),
        causes=(
            Stub(
                message="another unit",
                diagnostic=problem("another unit"),
                differences=(1,),
                is_reported_first=False,
                effects={},
            ),
        ),
        parts=(problem("a tail too many"),),
        objections=(problem("too much is left"),),
        mount=None,
        residual={"mass matrix": 7.7e-7, "gravity": 8.8e-8},
        explained=0.9876,
        complete=False,
        check=Stub(
            configurations=23, tolerance=1e-9, quantities=(quantity,), notes=(problem("noted"),)
        ),
        engines=(problem("gravity"),),
        notes=(problem("assumed"),),
        guessed={"one": "two"},
        only_urdf=("tail",),
        only_mjcf=("head",),
    )
    for name in ("unexplained_differences", "main_problem"):
        setattr(found, name, vars(FilesCompared)[name].fget(found))
    return found


def _write_variants_report() -> Report:
    """Return the report of the comparison of three variants."""
    other = row(
        "two",
        0.01,
        thigh_ratio=None,
        stands_without=False,
        verified=False,
    )
    third = row("three", 0.02, stands_without=False)
    comparison = tool("analyze.document")
    compared = comparison.comparison_table([row("one", 0.0), other, third])
    return _make_report(Document(Name("Variants"), Name("variants"), (compared,)))


def _write_pushes_report() -> Report:
    """Return the report of two push recoveries with their comparison."""
    both = [make_push_result("one", 0.0, 0.00311), make_push_result("two", 0.1, 0.0)]
    push = tool("push.document")
    return Report(
        text("report"), tuple(map(push.push_document, both)), push.compare_pushes(both[0], both)
    )


def _make_report(document: Document) -> Report:
    """Return a report with one document."""
    return Report(text("report"), (document,))


_REPORTS: dict[str, tuple[str, Callable[[], Report]]] = {
    "analysis": (
        "analyze",
        lambda: _make_report(tool("analyze.document").analysis_document(ANALYSIS)),
    ),
    "variants": ("analyze", _write_variants_report),
    "pushes": ("push", _write_pushes_report),
    "stance": ("stand", lambda: _make_report(tool("stand.document").stance_document(stance()))),
    "payload": (
        "payload",
        lambda: _make_report(tool("payload.document").payload_document(make_payload_result())),
    ),
    "best": ("best", lambda: _make_report(tool("best.document").best_document(best()))),
    "workspace": (
        "workspace",
        lambda: _make_report(tool("workspace.document").workspace_document(workspace())),
    ),
    "path": ("path", lambda: _make_report(tool("path.document").path_document(make_path_result()))),
    "files": (
        "crosscheck",
        lambda: _make_report(tool("crosscheck.document").comparison_document(files())),
    ),
}
"""{name of an expected document: (tool that shows it, function that makes its report)}."""

REPORTS = {name: make for name, (tool, make) in _REPORTS.items() if tool in own_tools()}
"""{name of an expected document: function that makes its report}, of the tools in this package."""
