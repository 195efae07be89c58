"""Every number that is shown: in its column, with its unit, from the field that it names.

Each builder is given a stub whose numbers are all different, and the document that it makes is
printed whole and compared word by word: columns that are swapped, or metres shown as millimetres,
are seen. Lines are broken here to be read; what counts are the words and their order.
"""

from __future__ import annotations

import math
from types import SimpleNamespace as Stub
from typing import Any

import numpy as np
import printing
import pytest
from conftest import problem

from pupper_analysis.models.efforts import EffortStatement
from pupper_analysis.models.joint_drives import Drive, MadeServo
from pupper_analysis.pupper import comparison
from pupper_analysis.report.document import Document, Name, Report, Table
from pupper_analysis.report.documents.analysis import analysis_document
from pupper_analysis.report.documents.base_workspace import workspace_document
from pupper_analysis.report.documents.best_study import best_document
from pupper_analysis.report.documents.comparison import comparison_document
from pupper_analysis.report.documents.loaded_stance import payload_document
from pupper_analysis.report.documents.path_there import path_document
from pupper_analysis.report.documents.pushed_stance import compare_pushes, push_document
from pupper_analysis.report.documents.stance import stance_document
from pupper_analysis.robot.as_published import ServoSource, ServosUsed
from pupper_analysis.simulation.verdict import judge
from pupper_analysis.stance.optimize.best import Objective
from pupper_analysis.stance.path.leg_time import Binding
from pupper_analysis.stance.path.path_limits import Limit
from pupper_analysis.stance.payload.servo_limit import Failure
from pupper_analysis.stance.payload.sharing import Sharing


def printed(shown: Document | Report | Table) -> list[str]:
    """The words that are printed, without rules and bars."""
    if isinstance(shown, Table):
        shown = Document(Name(""), Name(""), (shown,))
    text = printing.printed(shown, width=240)
    return [word for word in text.split() if word.strip("─█▏▎▍▌▋▊▉")]


def words(text: str) -> list[str]:
    return text.split()


# One robot


def loads(shift: float) -> Stub:
    """A static equilibrium of two motors and two feet; another for each shift."""
    return Stub(
        joint_names=("hip", "knee"),
        joint_torques=np.array([0.1111, -0.2222]) + shift,
        motor_utilisation=np.array([0.051, 0.952]) + shift,
        contact_forces={
            "FR": np.array([1.011, -2.022, 3.033]) + shift,
            "RL": np.array([4.044, -5.055, 6.066]) + shift,
        },
        foot_loads={
            foot: Stub(
                force=np.array(force) + shift,
                friction_utilisation=used,
                centre_of_pressure=np.array(force) / 7,
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
    """A simulated stand."""
    return Stub(
        passed=passed,
        failures=() if passed else (problem("it sank"),),
        integrator="Euler",
        timestep=0.002,
        duration=12.0,
        kp=np.array([5.0, 6.0]),
        kd=np.array([0.1, 0.1]),
        collapses=False,
        base_height=0.12111 + shift,
        height_deviation=0.00002222 + shift,
        height_drift=-0.0000333 - shift,
        height_loss=0.004444 + shift,
        servo_sag=0.001555 + shift,
        contact_sag=0.002889 + shift,
        tilt=math.radians(0.6666) + shift,
        foot_slip={"FR": 0.0000777, "RL": 0.0001888 + shift},
        joint_error=9.1e-5 + shift,
        joint_torques=np.array([0.3333, -0.4444]),
        torque_error=0.01234 + shift,
        foot_forces={"FR": np.array([0.101, 0.202, 7.303]), "RL": np.array([0.404, 0.505, 8.606])},
        force_error=0.02356 + shift,
        mujoco_foot_error=3.1e-10,
        mujoco_residual=4.2e-5,
        stability=Stub(doubling_time=None),
        feedforward=passed,
        time=np.array([0.0, 12.0]),
        height=np.array([0.12, 0.11]),
        motion_time=np.array([0.0]),
        motion=np.zeros((1, 7)),
    )


SERVOS = ServosUsed(ServoSource.FILE, (5.0, 6.0), (0.1, 0.1))


ORIGINS = (
    EffortStatement.of("URDF", "joint", "one", "effort", (-3.3, 3.3)),
    EffortStatement.of("MJCF", "actuator", "two", "forcerange", (-4.4, 4.4)),
)


def joint(name: str, shift: float) -> Stub:
    return Stub(
        name=name,
        motion="oblique",
        oblique=True,
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
        task="height 0.1 m",
        iterations=7,
        qpos=np.array([0.0, 0.0, 0.1009]),
        foot_error=1.1e-16,
        orientation_error=2.2e-15,
        height_error=3.3e-14,
        com_error=4.4e-13,
    ),
    foot_jacobians={
        "FR": Stub(
            matrix=np.array([[0.01, 0.02], [0.03, 0.04], [0.05, 0.06]]),
            singular_values=np.array([0.0951, 0.0052]),
            condition=18.29,
        )
    },
    statics=loads(0.0),
    minimum_peak=loads(-0.05),
    hanging_torques=np.array([0.0077, 0.0088]),
    verification=run(0.0, passed=True),
    sagging=run(0.01, passed=False),
    verdict=judge(run(0.0, passed=True), run(0.01, passed=False), SERVOS),
    sweep=Stub(
        kp=np.array([10.0, 30.0]),
        kd=np.array([0.5, 1.0, 2.0]),
        height_deviation=np.array([[1.1e-3, 2.2e-3, np.inf], [4.4e-3, 0.5e-3, 6.6e-3]]),
        fell=np.array([[False, False, True], [False, False, False]]),
        lasts=np.array([[True, False, True], [True, True, True]]),
        doubling_time=np.array([[np.inf, 0.51, np.inf], [np.inf, np.inf, 61.0]]),
        damping_ratio=np.array([[0.11, 0.12, np.nan], [0.13, np.nan, 0.14]]),
        amplitude=2.1,
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
                where="knee, #3",
                whose="models (Pinocchio)",
                scale=0.312,
                unit="kg m^2",
                deviation=4.1e-5,
                relative=1.3e-4,
                passed=False,
            ),
            Stub(
                name="gravity",
                where="hip, #4",
                whose="engines (URDF)",
                scale=31.2,
                unit="N",
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


def test_an_analysis() -> None:
    assert printed(analysis_document(ANALYSIS)) == words(r"""
        FAILED stub: it leans
        3.171 kg; peak torque -0.222 N m at knee, 95.2% of its limit
        stands 100.9 mm high, in MuJoCo 121.1 mm; commanded the same joints without feed-forward
            131.1 mm
        URDF and MJCF: worst deviation 1.3e-04 (mass matrix)
        HOLDS with gravity feed-forward in MuJoCo for 12 s: torques within 1.2e-02, forces
            within 2.4e-02 of the prediction (relative to the largest)
        FAILS on position commands alone: it sank
        Standing, knee holds -0.222 N m; hanging by its base it would hold +0.009 N m.
        Commanded the pose alone, without feed-forward, it does not stand:
        it sank
        nq = 19, nv = 18, nu = 12; mass 3.171 kg; com at zero angles, from the base (+0.0101
            -0.0202 +0.0303) m
        thigh 81.1 mm, calf 112.2 mm
        From the robot's URDF and MJCF.
        Joints, in actuator order
        lower limit upper limit effort velocity armature damping friction
        joint motion axis (rad) (rad) (N m) (rad/s) (kg m²) (N m s/rad) (N m)
        hip oblique +0.11 +0.22 -0.33 -1.51 +2.52 3.3 14.4 0.0051 0.062 0.073
        knee oblique +0.61 +0.72 +0.17 -1.01 +3.02 3.8 14.9 0.5051 0.562 0.573
        Axes at zero angles, in the base's frame.
        effort: effort in the URDF (1), forcerange in the MJCF (1)
        Masses of the bodies
        base, or
        joint that mass
        moves it (kg)
        base 1.501
        hip 0.202
        knee 0.202
        Fixed links are counted with what they are fixed to.
        Errors of the solved stand (PlaCo, 7 iterations)
        deviation value unit
        feet off their targets, by Pinocchio 1.1e-16 m
        feet off their targets, by MuJoCo 3.1e-10 m
        orientation of the base 2.2e-15 rad
        height of the base 3.3e-14 m
        com 4.4e-13 m
        height 0.1 m
        Motor torques
        torque limit utilisation simulated minimum peak hanging
        joint (N m) (N m) (%) (N m) (N m) (N m)
        hip +0.1111 3.3 5.1 +0.3333 +0.0611 +0.0077
        knee -0.2222 3.8 95.2 -0.4444 -0.2722 +0.0088
        torque: with the least tangential forces at the feet, which last; minimum peak: with the
            contact forces of least peak utilisation, 90.2%.
        limit: effort in the URDF (1), forcerange in the MJCF (1)
        Contact forces on the feet, in world axes
        friction
        force x force y force z used simulated x simulated y simulated z minimum peak, x y z
        foot (N) (N) (N) (%) (N) (N) (N) (N)
        FR +1.011 -2.022 +3.033 7.1 +0.101 +0.202 +7.303 +0.961 -2.072 +2.983
        RL +4.044 -5.055 +6.066 8.2 +0.404 +0.505 +8.606 +3.994 -5.105 +6.016
        balance residual 1.1e-11 N, 2.2e-12 N m (in MuJoCo's terms 4.2e-05); com 12.3 mm inside
            the support polygon
        MuJoCo, 12 s on the floating base (Euler, 2 ms; kp 5 … 6 N m/rad, kd 0.1 N m s/rad)
        with
        quantity feed-forward without unit
        base height 0.12111 0.13111 m
        loss of height 4.444 14.444 mm
        of it servo sag 1.555 11.555 mm
        of it contact softness 2.889 12.889 mm
        deviation of height, last second (< 5 mm = stable) 0.02222 10.02222 mm
        drift of height, last second -0.0333 -10.0333 mm/s
        tilt against the task 0.6666 1.2396 °
        foot slip 0.1888 10.1888 mm
        joint error 9.1e-05 1.0e-02 rad
        torque off prediction, of the largest 1.234 2.234 %
        vertical foot force off prediction 2.356 3.356 %
        verdict stands FAILED
        without feed-forward it fails
        it sank
        Height deviation by servo gains
        kp \ kd kd 0.5 kd 1 kd 2
        (N m/rad \ N m s/rad) (mm) (mm) (mm)
        10 1.1000 2.2000 fell
        30 4.4000 0.5000 6.6000
        Marked are gains at which it comes to no stable rest.
        Standard deviation of the base's height in the last of 4.3 s, under 2.1 N at 3.2 Hz
            (implicitfast).
        Stiffer servos move less, without end: delay, noise and torque, which end it, are not in
            it.
        Each cell is a simulation of its own in MuJoCo.
        Damping ratio of the least damped mode by servo gains
        kp \ kd
        (N m/rad \ N m s/rad) kd 0.5 kd 1 kd 2
        10 0.11 doubles in 0.51 s -
        30 0.13 - 0.14
        Of the undisturbed stand, by the eigenvalues of a step of MuJoCo.
        Foot Jacobians, in world axes, by the joints of the leg
        singular
        values
        foot vx (m/rad) vy (m/rad) vz (m/rad) (m/rad) condition
        FR +0.0100 +0.0200 +0.0300 +0.0400 +0.0500 +0.0600 0.0951 0.0052 18.29
        Cross-check: URDF and MJCF, each in Pinocchio and in MuJoCo, at 21 random
            configurations; tolerance 1e-09
        quantity worst at deviation of scale deviation unit relative verdict
        mass matrix knee, #3 models (Pinocchio) 0.312 4.1e-05 kg m^2 1.3e-04 DIFFERS
        gravity 31.2 0.0e+00 N 0.0e+00 ok
        another note
        note: a note
    """)


def test_legs_of_one_joint_have_no_thigh() -> None:
    stub: Any = Stub(**{**vars(ANALYSIS), "thigh_length": None})
    text = " ".join(printed(analysis_document(stub)))
    assert "thigh -, calf 112.2 mm" in text


# Variants


def row(name: str, shift: float, **changes: Any) -> Any:
    fields: dict[str, Any] = {
        "name": name,
        "base": "skeleton",
        "total_mass": 2.711 + shift,
        "mass_ratio": 1.122 + shift,
        "thigh_ratio": 1.533 + shift,
        "thigh_shape_ratio": 1.644 + shift,
        "height": 0.1555 + shift,
        "peak_torque": 0.366 + shift,
        "peak_utilisation": 0.177 + shift,
        "servo_sag": 0.000888 + shift,
        "stands_without": True,
        "contact_sag": 0.000999 + shift,
        "torque_error": 0.0101 + shift,
        "force_error": 0.0202 + shift,
        "cross_check": 1.5e-13,
        "verified": True,
    }
    return comparison.ComparisonRow(**{**fields, **changes})


def test_the_comparison_of_variants() -> None:
    other = row(
        "two",
        0.01,
        thigh_ratio=None,
        thigh_shape_ratio=None,
        stands_without=False,
        cross_check=2.6e-12,
        verified=False,
    )
    assert printed(comparison.comparison_table([row("one", 0.0), other])) == words("""
        Comparison (ratios to the unscaled base model)
        foot force
        peak contact torque off off
        without mass thigh ratio, thigh ratio, stand height peak torque utilisation servo sag
            softness prediction prediction cross-check,
        variant verdict feed-forward (kg) mass ratio hip to knee drawn shape (m) (N m) (%) (mm)
            (mm) (%) (%) worst
        one VERIFIED stands 2.711 1.122 1.533 1.644 0.1555 0.366 17.7 0.888 0.999 1.010 2.020
            1.5e-13
        two FAILED FAILS 2.721 1.132 - - 0.1655 0.376 18.7 10.888 10.999 2.010 3.020 2.6e-12
    """)


def test_what_is_compared_is_what_is_meant() -> None:
    """Each field of a row from its own of the analysis; ratios the right way up."""
    stub = Stub(
        **{
            **vars(ANALYSIS),
            "thigh_shape_length": 0.09,
            "stand": Stub(task=Stub(height=0.1234)),
        }
    )
    found = vars(comparison.compare(stub, "v3", comparison.Reference(1.5, 0.05, 0.045)))
    assert {key: value for key, value in found.items() if not isinstance(value, float)} == {
        "name": "stub",
        "base": "v3",
        "stands_without": False,
        "verified": False,
    }
    assert {
        key: value for key, value in found.items() if isinstance(value, float)
    } == pytest.approx(
        {
            "total_mass": 3.171,
            "mass_ratio": 2.114,
            "thigh_ratio": 1.622,
            "thigh_shape_ratio": 2.0,
            "height": 0.1234,
            "peak_torque": 0.2222,
            "peak_utilisation": 0.952,
            "servo_sag": 0.011555,
            "contact_sag": 0.002889,
            "torque_error": 0.01234,
            "force_error": 0.02356,
            "cross_check": 1.3e-4,
        }
    )


def test_the_list_of_variants() -> None:
    spec = Stub(name="mine", base="v3", leg_scale=1.21, torso_mass_scale=2.31)
    robot = Stub(total_mass=3.4567, stand_height=0.14159)
    assert printed(comparison.variants_table([(spec, robot)])) == words("""
        Variants
        mass stand height
        variant base leg_scale torso_mass_scale (kg) (m)
        mine v3 1.21 2.31 3.457 0.1416
    """)


# Pushes


def pushes(shift: float) -> Stub:
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
        duration=6.5,
        resolution=0.03,
        unpushed=(),
        mass=2.15,
    )


def pushed(name: str, shift: float, depth: float) -> Any:
    stand = Stub(task=f"yaw {shift:.1f} deg", depths={"FR": depth / 2, "RL": depth})
    verdict = judge(run(0.0, passed=True), None, SERVOS)
    return Stub(name=name, passed=True, stand=stand, recovery=pushes(shift), verdict=verdict)


def test_pushes() -> None:
    both = [pushed("one", 0.0, 0.00311), pushed("two", 0.1, 0.0)]
    documents = tuple(map(push_document, both))
    assert printed(Report(Name(""), documents, compare_pushes(both[0], both))) == words("""
        LASTS one: weakest at 240°: 0.43 N s, 0.20 m/s of its 2.15 kg; then it falls (a rigid
            robot tips at 0.75 N s)
        yaw 0.0 deg
        all this is on MuJoCo's soft ground, with legs longer by what the feet sink in (at most
            3.11 mm)
        Largest push that the stand survives
        a rigid
        step of robot tips
        direction impulse velocity at how it fails
        (°) (N s) (m/s) (N s) then
        0 0.51 0.237 0.84 it rolls
        120 0.62 0.288 0.75 it slides
        240 0.43 0.201 0.96 it falls
        Directions about the vertical, of the base: forward 0°, left 90°.
        LASTS two: weakest at 240°: 0.53 N s, 0.25 m/s of its 2.15 kg; then it falls (a rigid
            robot tips at 0.85 N s)
        yaw 0.1 deg
        feet sunk into MuJoCo's soft ground would be out of reach: simulated with joints for
            rigid ground
        Largest push that the stand survives
        a rigid
        step of robot tips
        direction impulse velocity at how it fails
        (°) (N s) (m/s) (N s) then
        0 0.61 0.337 0.94 it rolls
        120 0.72 0.388 0.85 it slides
        240 0.53 0.301 1.06 it falls
        Directions about the vertical, of the base: forward 0°, left 90°.
        Largest push that the stand survives
        direction one two
        (°) (N s) (N s)
        0 0.51 0.61
        120 0.62 0.72
        240 0.43 0.53
        Directions about the vertical, of the base: forward 0°, left 90°.
    """)


# A stance


class Task(str):
    """What was asked, in words; and the height that came of it."""

    __slots__ = ()
    height = 0.1044


STAND: Any = Stub(
    task=Task("roll 1.0 deg"),
    com_margin=0.0333,
    qpos=np.array([0.0, 0.0, 0.1009]),
    depths={"FR": 0.0, "RL": 0.0},
    ground_clearance=Stub(distance=0.0111, links=("calf",)),
    self_clearance=Stub(distance=0.0222, links=("thigh", "base")),
)


def stance(**changes: Any) -> Any:
    fields: dict[str, Any] = {
        "name": "stub",
        "stand": STAND,
        "verification": run(0.0, passed=True),
        "joint_positions": np.array([0.6543, -0.7654]),
        "statics": loads(0.0),
        "minimum_peak": loads(-0.05),
        "limits": np.array([3.1, 4.2]),
        "limit_origins": ORIGINS,
        "verdict": judge(run(0.0, passed=True), None, SERVOS, overloaded=("knee",)),
        "settled": Stub(
            base_height=0.11223,
            servo_sag=0.00789,
            contact_sag=0.00421,
            release_margin=0.5,
            failures=(problem("foot FR slides"),),
        ),
        "unsettled": None,
        "minimum_stiffness": 4.567,
        "sunk": Stub(depths={"FR": 0.00311, "RL": 0.00422}, qpos=np.array([0.0, 0.0, 0.1031])),
        "passed": True,
        "loops_open": 2.34e-5,
    }
    return Stub(**{**fields, **changes})


def test_a_stance() -> None:
    assert printed(stance_document(stance())) == words("""
        FAILS stub: roll 1.0 deg
        OVERLOADED: with the contact forces that last the motors cannot hold it: knee
        HOLDS in MuJoCo for 12 s: torques within 1.2e-02, forces within 2.4e-02 of the
            prediction (relative to the largest)
        commanded these joints alone it settles at 0.11223 m: servos give 7.89 mm, the ground
            4.21 mm; but foot FR slides
        minimum stiffness of servos that carry it without feed-forward: 4.57 N m/rad
        lowest part but the feet: calf, 11.1 mm
        nearest links: thigh / base, 22.2 mm apart
        the MJCF's loops and couplings are open in it by up to 2.3e-05 m or rad, as their
            softness has it
        all this is on MuJoCo's soft ground, with legs longer by what the feet sink in (at most
            4.22 mm)
        Motor torques
        torque limit utilisation simulated minimum peak position
        joint (N m) (N m) (%) (N m) (N m) (rad)
        hip +0.1111 3.1 5.1 +0.3333 +0.0611 +0.6543
        knee -0.2222 4.2 95.2 -0.4444 -0.2722 -0.7654
        torque: with the least tangential forces at the feet, which last; minimum peak: with the
            contact forces of least peak utilisation, 90.2%.
        limit: effort in the URDF (1), forcerange in the MJCF (1)
        Contact forces on the feet, in world axes
        friction
        force x force y force z used simulated x simulated y simulated z minimum peak, x y z
        foot (N) (N) (N) (%) (N) (N) (N) (N)
        FR +1.011 -2.022 +3.033 7.1 +0.101 +0.202 +7.303 +0.961 -2.072 +2.983
        RL +4.044 -5.055 +6.066 8.2 +0.404 +0.505 +8.606 +3.994 -5.105 +6.016
        balance residual 1.1e-11 N, 2.2e-12 N m (in MuJoCo's terms 4.2e-05); com 12.3 mm inside
            the support polygon
        Stance
        quantity value unit
        height of the base 104.4 mm
        com margin 33.3 mm
        ground clearance 11.1 mm
        distance between links 22.2 mm
        friction used 8.2 %
        MuJoCo, 12 s on the floating base
        with
        quantity feed-forward unit
        base height 0.12111 m
        loss of height 4.444 mm
        of it servo sag 1.555 mm
        of it contact softness 2.889 mm
        deviation of height, last second (< 5 mm = stable) 0.02222 mm
        drift of height, last second -0.0333 mm/s
        tilt against the task 0.6666 °
        foot slip 0.1888 mm
        joint error 9.1e-05 rad
        torque off prediction, of the largest 1.234 %
        vertical foot force off prediction 2.356 %
    """)


def test_a_stance_that_fails() -> None:
    failing = stance(
        passed=False, verification=run(0.0, passed=False), sunk=None, settled=None,
        unsettled=problem("why"),
        verdict=judge(run(0.0, passed=False), None, SERVOS), minimum_stiffness=None,
        loops_open=None,
    )  # fmt: skip
    text = " ".join(printed(stance_document(failing)))
    assert text.startswith("FAILS stub: FAILS in MuJoCo: it sank roll 1.0 deg without")
    assert "without feed-forward, no sag is predicted: why lowest part" in text
    assert (
        "feet sunk into MuJoCo's soft ground would be out of reach: simulated with joints" in text
    )
    assert "HOLDS" not in text


def loaded(*unlimited: str) -> Any:
    payload = Stub(
        point=np.array([0.011, -0.022, 0.083]),
        mass=1.239,
        where=("knee",),
        failure=Failure.BUCKLING,
        motors=Stub(mass=4.569),
        servos=Stub(mass=1.239),
        contacts=Stub(mass=math.inf),
        unlimited=unlimited,
        shared=Sharing(3.5, np.zeros(12), {}),
    )
    trial = Stub(mass=1.177, duration=12.0, failure=Failure.TIPPING, time=3.456, where=("FL",))
    buckling = (Stub(mass=0.991, doubling_time=161.6, free_doubling_time=math.inf),)
    return Stub(
        name="stub",
        passed=True,
        stand=STAND,
        payload=payload,
        trial=trial,
        buckling=buckling,
        servos=SERVOS,
    )


def test_a_payload() -> None:
    assert printed(payload_document(loaded("hip"))) == words("""
        CARRIES stub: payload at (11, -22, 83) mm of the base: 1.23 kg, then the servos are too
            soft: it buckles (knee)
        simulated with 1.17 kg on it, 12 s, nudged: at 3.46 s the robot tips (FL)
        roll 1.0 deg
        What bounds the payload
        bound payload
        motors 4.56 kg
        servos' stiffness 1.23 kg
        contacts no limit
        Static, at the motors' peak torque as the files state it; rounded down.
        Motors without effort limit, which set no payload: 1 (hip).
        How fast it buckles on its servos: in what time a deviation doubles
        of the without dry
        payload servos' doubles in friction
        (kg) limit (s) (s)
        0.99 0.80 162 -
    """)
    text = " ".join(printed(payload_document(loaded("hip", "knee"))))
    assert "Motors without effort limit, which set no payload: 2 (hip, knee)." in text
    assert "contacts no limit Static," in " ".join(printed(payload_document(loaded())))
    assert "Motors without" not in " ".join(printed(payload_document(loaded())))


def test_the_best() -> None:
    best = Stub(
        objective=Objective.MARGIN,
        value=0.0456,
        nominal_value=0.0345,
        evaluations=321,
        coordinates={"height": 0.1567, "pitch": math.radians(2.5), "FR x": -0.0123},
        active=("height high",),
    )
    study: Any = Stub(best=best, stance=stance(), loaded=None, passed=True)
    told = words("""
        FAILS stub: best of 321 stances: distance of the com from the support polygon's edge
            0.0456 m, against 0.0345 m as asked
    """)
    where = words("""
        Where the best stance is
        coordinate value unit
        height +156.7 mm
        pitch +2.5 °
        FR x -12.3 mm
        at its limit: height high
    """)
    shown, alone = printed(best_document(study)), printed(stance_document(stance()))
    assert shown[: len(told)] == told
    place = shown.index("Where")
    assert shown[place : place + len(where)] == where
    # The rest is the stance's own, but for the verdict before it.
    assert shown[len(told) : place] + shown[place + len(where) :] == alone[2:]


def test_the_best_payload_is_rounded_down_in_kilograms() -> None:
    best = Stub(
        objective=Objective.PAYLOAD, value=2.349, nominal_value=1.118, evaluations=5,
        coordinates={"yaw": math.radians(-3.3)}, active=(),
    )  # fmt: skip
    study: Any = Stub(best=best, stance=stance(), loaded=loaded(), passed=True)
    text = " ".join(printed(best_document(study)))
    assert "best of 5 stances: payload 2.34 kg, against 1.11 kg as asked roll 1.0 deg" in text
    assert "yaw -3.3 °" in text
    assert "nudged: at 3.46 s the robot tips (FL)" in text


def test_a_workspace() -> None:
    intervals = {
        "height": Stub(low=0.0911, high=0.1922),
        "roll": Stub(low=math.radians(-13.3), high=math.radians(14.4)),
        "x": Stub(low=-0.0255, high=0.0366),
    }
    found: Any = Stub(start=STAND, intervals=intervals)
    assert printed(workspace_document(found)) == words("""
        : roll 1.0 deg
        How far the base can go, each alone
        direction from to unit
        height +91.1 +192.2 mm
        roll -13.3 +14.4 °
        x -25.5 +36.6 mm
        Of reach and balance alone, whatever motors and servos hold: stand, with a pose of
            these, tells whether it holds.
    """)


def there(**changes: Any) -> Any:
    path = Stub(
        feet=("FR", "RL"),
        loads=np.array([[3.33, 9.99], [7.77, 4.44]]),
        time=np.array([0.0, 1.5, 3.0]),
        peak_utilisation=0.321,
        peak_joint="knee",
        peak_time=1.23,
        peak_speed_utilisation=0.054,
        com_margin=np.array([0.0311, 0.0222]),
        zmp_margin=np.array([0.0177, 0.0288]),
        qpos=np.full((3, 7), 0.123),
    )
    tracking = Stub(
        torque_error=0.012,
        joint_error=0.034,
        joint_error_rms=0.005,
        height_error=0.0067,
        orientation_error=0.089,
        foot_slip={"FR": 0.0011, "RL": 0.0023},
        passed=True,
        failures=(),
    )
    fields = {"name": "stub", "passed": True, "stand": STAND, "path": path, "tracking": tracking}
    least = {"binding": None, "reserve": None, "lower_bound": None, "servos": SERVOS}
    return Stub(**fields, **{**least, **changes})


def test_a_path() -> None:
    assert printed(path_document(there())) == words("""
        TRACKED stub: roll 1.0 deg
        The path
        quantity value unit
        time 3 s
        samples 3
        greatest torque of motors in motion: knee at 1.23 s 32.1 %
        greatest speed of joints 5.4 %
        least com margin 22.2 mm
        least margin of the zero-moment point 17.7 mm
        least load of FR 3.33 N
        least load of RL 4.44 N
        Torques and speeds are in parts of their limits.
        How it is followed in MuJoCo
        quantity value unit
        torque error, of the largest 1.2 %
        joint error 0.034 rad
        joint error, rms 0.005 rad
        error of height 6.7 mm
        error of orientation 0.089 rad
        foot slip 2.3 mm
    """)


def test_the_fastest_path() -> None:
    least = there(
        binding=Binding(Limit.FRICTION, ("FR",), 2, 0.37, 0.5), reserve=0.21, lower_bound=2.5
    )
    text = " ".join(printed(path_document(least)))
    assert (
        "least time 3 s, with 21% of every limit in reserve: bound by friction (FR) after 37% of "
        "leg 2; 2.5 s if the acceleration could jump The path" in text
    )


# Two files


def test_two_models() -> None:
    difference = Stub(
        kind="mass",
        element="base",
        unit="kg",
        weight=(0.34, 0.341),
        urdf=3.3,
        mjcf=6.9,
        message="body of base: mass 3.3 kg in the URDF, 6.9 kg in the MJCF",
        diagnostic=problem("body of base: mass 3.3 kg in the URDF, 6.9 kg in the MJCF"),
        urdf_place="a.urdf:5",
        mjcf_place="b.xml:44",
        effects={
            "gravity": Stub(share=0.45, relative=1.2e-2, deviation=9.0),
            "mass matrix": Stub(share=0.97, relative=3.4e-1, deviation=8.0),
        },
        made_of=(problem("in the URDF it is made of trunk 3 kg"),),
    )
    limit = Stub(
        kind="effort",
        element="knee",
        unit="N m",
        weight=(0.0, 0.0),
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
    quantity = Stub(name="mass matrix", edges=sides, passed=False, where="knee, #3")
    found: Any = Stub(
        urdf="a.urdf",
        mjcf="b.xml",
        agree=False,
        same_robot=False,
        differences=(difference, limit),
        causes=(
            Stub(
                message="another unit",
                diagnostic=problem("another unit"),
                differences=(1,),
                leads=False,
            ),
        ),
        parts=(problem("a tail too many"),),
        objections=(problem("too much is left"),),
        mount=None,
        left={"mass matrix": 7.7e-7, "gravity": 8.8e-8},
        explained=0.9876,
        complete=False,
        check=Stub(configurations=23, quantities=(quantity,), notes=(problem("noted"),)),
        engines=(problem("gravity"),),
        notes=(problem("assumed"),),
        guessed={"one": "two"},
        only_urdf=("tail",),
        only_mjcf=("head",),
    )
    assert printed(comparison_document(found)) == words("""
        DISAGREE a.urdf and b.xml: a tail too many
        2 differences
        explained: 98.76 % of the deviation; with the MJCF's values in the URDF's model 7.7e-07
            is left, so something is missing in this list
        URDF: a.urdf
        MJCF: b.xml
        Only in one file
        a tail too many; it was taken off to compare the rest
        1. another unit
        a.urdf:7 b.xml:55
        | 1.5 N m
        | 2.5 N m
        This alone makes 1 differences.
        the effort of knee:
        no effect on the dynamics
        2. body of base: mass 3.3 kg in the URDF, 6.9 kg in the MJCF
        a.urdf:5 b.xml:44
        | 3.3 kg
        | 6.9 kg
        in the URDF it is made of trunk 3 kg
        alone it makes, of the deviation in: mass matrix 97% (3.4e-01), gravity 45% (1.2e-02)
        All differences, what is to be mended first, first
        greatest
        relative line of the line of the
        no. kind of in the URDF in the MJCF unit effect URDF MJCF
        1 mass base 3.3 6.9 kg 3.4e-01 a.urdf:5 b.xml:44
        2 effort knee 1.5 2.5 N m 0.0e+00 a.urdf:7 b.xml:55
        Objections
        too much is left
        Deviation relative to each quantity's scale, at 23 random configurations
        models models engines engines yourdfpy extras
        quantity (Pinocchio) (MuJoCo) (URDF) (MJCF) (URDF) (MJCF) worst at
        mass matrix 1.1e-01 2.2e-02 3.3e-13 4.4e-14 5.5e-15 6.6e-06 knee, #3
        note: assumed
        note: matched by structure, by link or by part of the name (confirm with --map): one=two
        note: only in a.urdf, fixed at zero or taken off to compare the rest: tail
        note: only in b.xml, fixed at zero or taken off to compare the rest: head
        note: noted
        note: the engines differ on one model: gravity
    """)


def test_limits_say_that_their_servos_were_made_up() -> None:
    """Of a robot without servos nobody stated what it can carry, or be pushed by."""
    made = MadeServo("knee", 320.0, 16.0, Drive.MOTOR)
    own = ServosUsed(ServoSource.MADE_UP, (320.0, 320.0), (16.0, 16.0), (made,))
    one = loaded()
    one.servos = own
    said = "on servos that were made up at 1 joints (kp 320 N m/rad, kd 16 N m s/rad)"
    assert said in " ".join(printed(payload_document(one)))
    push = pushed("one", 0.0, 0.00311)
    push.verdict = judge(run(0.0, passed=True), None, own)
    assert said in " ".join(printed(push_document(push)))
    assert said in " ".join(printed(path_document(there(servos=own))))


def test_pushes_of_what_fails_are_told_with_its_verdict() -> None:
    """It stands, and not as predicted: limits are told, and so is that `stand` fails."""
    one = pushed("one", 0.0, 0.00311)
    one.verdict, one.passed = judge(run(0.0, passed=False), None, SERVOS), False
    text = " ".join(printed(push_document(one)))
    assert text.startswith("FAILS one: FAILS in MuJoCo: ")
    assert "weakest at 240°: 0.43 N s" in text
    one.recovery.unpushed = ("it fell over",)
    text = " ".join(printed(push_document(one)))
    assert "it does not stand, so it withstands no push of 2.15 kg" in text
    assert "weakest" not in text


def test_what_motors_bear_if_legs_share_it_is_told_where_it_is_more() -> None:
    assert "share" not in " ".join(printed(payload_document(loaded())))
    more = loaded()
    more.payload.shared = Sharing(5.678, np.zeros(12), {})
    text = " ".join(printed(payload_document(more)))
    assert "motors, if the legs share it as these can 5.67 kg servos' stiffness" in text
