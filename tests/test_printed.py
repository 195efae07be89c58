"""Every number that is printed: in its column, with its unit, from the field that it names.

Each report is given a stub whose numbers are all different, and what it prints is compared word by
word: columns that are swapped, or metres printed as millimetres, are seen. Lines are broken here to
be read; what counts are the words and their order.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable
from types import SimpleNamespace as Stub
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from pupper_analysis.models.efforts import EffortStatement
from pupper_analysis.models.joint_drives import Drive, MadeServo
from pupper_analysis.pupper import comparison
from pupper_analysis.report import analysis as analysis_report
from pupper_analysis.report import comparison as models_report
from pupper_analysis.report import push as push_report
from pupper_analysis.report import stance as stance_report
from pupper_analysis.robot.as_published import ServoSource, ServosUsed
from pupper_analysis.simulation.verdict import judge
from pupper_analysis.stance.optimize.best import Objective
from pupper_analysis.stance.payload.servo_limit import Failure
from pupper_analysis.stance.payload.sharing import Sharing


def printed(show: Callable[..., None], *arguments: Any, **options: Any) -> list[str]:
    """The words that a report prints, without rules and bars."""
    out = Console(file=io.StringIO(), width=240, highlight=False)
    show(out, *arguments, **options)
    assert isinstance(out.file, io.StringIO)
    return [word for word in out.file.getvalue().split() if word.strip("─█▏▎▍▌▋▊▉")]


def words(text: str) -> list[str]:
    return text.split()


# ------------------------------------------------------------------------------------- one robot


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
        failures=() if passed else ("it sank",),
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


ANALYSIS = Stub(
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
    notes=("a note",),
    stand=Stub(
        task="height 0.1 m",
        iterations=7,
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
        notes=("another note",),
    ),
    verified=False,
    failures=("it leans",),
)


def test_an_analysis() -> None:
    assert printed(analysis_report.print_analysis, ANALYSIS) == words(r"""
        stub
        nq = 19, nv = 18, nu = 12; mass 3.171 kg; com at zero angles, from the base (+0.0101 -0.0202
            +0.0303) m
        thigh 81.1 mm, calf 112.2 mm; bodies: base 1.501 kg, 2 x 0.202 kg (hip …)
        Joints, in actuator order (axes at zero angles, base frame)
        limits effort velocity armature damping friction
        joint motion axis (rad) (N m) (rad/s) (kg m²) (N m s/rad) (N m)
        hip oblique +0.11 +0.22 -0.33 -1.51 … +2.52 3.3 14.4 0.0051 0.062 0.073
        knee oblique +0.61 +0.72 +0.17 -1.01 … +3.02 3.8 14.9 0.5051 0.562 0.573
        effort: effort in the URDF (1), forcerange in the MJCF (1)
        note: a note
        Stand (PlaCo, 7 iterations): height 0.1 m
        errors: feet 1.1e-16 m (by MuJoCo 3.1e-10 m), orientation 2.2e-15 rad, height 3.3e-14 m, com
            4.4e-13 m
        Foot Jacobians (m/rad, world axes, by the joints of the leg)
        foot vx vy vz singular values condition
        FR +0.0100 +0.0200 +0.0300 +0.0400 +0.0500 +0.0600 0.0951 0.0052 18.29
        Motor torques (N m)
        joint torque limit utilisation simulated minimum peak hanging
        hip +0.1111 3.3 5.1% +0.3333 +0.0611 +0.0077
        knee -0.2222 3.8 95.2% -0.4444 -0.2722 +0.0088
        torque: with the least tangential forces at the feet, which last; minimum peak: with the
            contact forces of
        least peak utilisation, 90.2%; hanging: the same pose, base held
        limit: effort in the URDF (1), forcerange in the MJCF (1)
        Contact forces on the feet (N, world axes)
        foot force friction used simulated minimum peak
        FR +1.011 -2.022 +3.033 7.1% +0.101 +0.202 +7.303 +0.961 -2.072 +2.983
        RL +4.044 -5.055 +6.066 8.2% +0.404 +0.505 +8.606 +3.994 -5.105 +6.016
        balance residual 1.1e-11 N, 2.2e-12 N m (in MuJoCo's terms 4.2e-05); com 12.3 mm inside the
            support polygon
        MuJoCo, 12 s on the floating base (Euler, 2 ms; kp 5 … 6 N m/rad, kd 0.1 N m s/rad)
        with feed-forward without
        base height 0.12111 m 0.13111 m
        loss of height 4.444 mm 14.444 mm
        servo sag 1.555 mm 11.555 mm
        contact softness 2.889 mm 12.889 mm
        deviation, last second (< 5 mm = stable) 0.02222 mm 10.02222 mm
        drift, last second -0.0333 mm/s -10.0333 mm/s
        tilt against the task 0.6666 deg 1.2396 deg
        foot slip 0.1888 mm 10.1888 mm
        joint error 9.1e-05 rad 1.0e-02 rad
        torque off prediction, of the largest 1.234% 2.234%
        vertical foot force off prediction 2.356% 3.356%
        verdict stands FAILED
        without feed-forward: it sank
        Height deviation (mm) under 2.1 N at 3.2 Hz (implicitfast, 4.3 s, last second); damping
            ratio of the least damped mode
        Kp (N m/rad) \ Kd (N m s/rad) 0.5 1 2
        10 1.1000 0.11 2.2000 doubles in 0.51 s fell
        30 4.4000 0.13 0.5000 - 6.6000 0.14
        stiffer servos move less, without end: delay, noise and torque, which end it, are not in it
        Cross-check: URDF and MJCF, each in Pinocchio and in MuJoCo, at 21 random configurations
            (#); tolerance 1e-09
        quantity worst at deviation of scale deviation relative
        mass matrix knee, #3 models (Pinocchio) 0.312 kg m^2 4.1e-05 1.3e-04 DIFFERS
        gravity 31.2 N 0.0e+00 0.0e+00 ok
        note: another note
        HOLDS with gravity feed-forward in MuJoCo for 12 s: torques within 1.2e-02, forces within
            2.4e-02 of the prediction (relative to the largest); FAILS on position commands alone:
            it sank
        FAILED stub: it leans
    """)


def test_legs_of_one_joint_have_no_thigh() -> None:
    stub = Stub(**{**vars(ANALYSIS), "thigh_length": None})
    text = " ".join(printed(analysis_report.print_analysis, stub))
    assert "thigh -, calf 112.2 mm;" in text


# ------------------------------------------------------------------------------------- variants


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
    assert printed(comparison.print_comparison, [row("one", 0.0), other]) == words("""
        Comparison (ratios to the unscaled base model)
        one two
        mass (kg) 2.711 2.721
        mass ratio 1.122 1.132
        thigh ratio, hip to knee 1.533 -
        thigh ratio, drawn shape 1.644 -
        stand height (m) 0.1555 0.1655
        peak torque (N m) 0.366 0.376
        peak utilisation 17.7% 18.7%
        without feed-forward stands FAILS
        servo sag (mm) 0.888 10.888
        contact softness (mm) 0.999 10.999
        torque off prediction 1.010% 2.010%
        foot force off prediction 2.020% 3.020%
        cross-check, worst 1.5e-13 2.6e-12
        verdict VERIFIED FAILED
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
    assert printed(comparison.print_variants, [(spec, robot)]) == words("""
        Variants
        mass stand height
        variant base leg_scale torso_mass_scale (kg) (m)
        mine v3 1.21 2.31 3.457 0.1416
    """)


# ------------------------------------------------------------------------------------- pushes


def pushes(shift: float) -> Stub:
    return Stub(
        directions=np.radians([0.0, 120.0, 240.0]),
        impulses=np.array([0.51, 0.62, 0.43]) + shift,
        tipping_estimate=np.array([0.84, 0.75, 0.96]) + shift,
        weakest_direction=math.radians(240.0),
        weakest_impulse=0.43 + shift,
        weakest_failure="it falls",
        unpushed=(),
        mass=2.15,
    )


def pushed(shift: float, depth: float) -> Stub:
    stand = Stub(task=f"yaw {shift:.1f} deg", depths={"FR": depth / 2, "RL": depth})
    verdict = judge(run(0.0, passed=True), None, SERVOS)
    return Stub(stand=stand, recovery=pushes(shift), verdict=verdict)


def test_pushes() -> None:
    both = {"one": pushed(0.0, 0.00311), "two": pushed(0.1, 0.0)}
    assert printed(push_report.print_pushes, both) == words("""
        one: yaw 0.0 deg
        two: yaw 0.1 deg
        Largest push that the stand survives
        one two
        direction (N s) (N s)
        0 deg 0.51 0.61
        120 deg 0.62 0.72
        240 deg 0.43 0.53
        directions about the vertical, of the base: forward 0, left 90
        one (2.15 kg): weakest at 240 deg, 0.43 N s = 0.20 m/s; then it falls (a rigid robot tips at
            0.75 N s)
        two (2.15 kg): weakest at 240 deg, 0.53 N s = 0.25 m/s; then it falls (a rigid robot tips at
            0.85 N s)
        all this is on MuJoCo's soft ground, with legs longer by what the feet sink in (at most 3.11
            mm)
        note: the feet of two, sunk into MuJoCo's soft ground, would be out of reach; simulated with
            joints for rigid ground
    """)


def test_how_deep_feet_sink_is_in_millimetres() -> None:
    assert "(at most 2.34 mm)" in push_report.sunk_note([0.00111, 0.00234, 0.00222])


# ------------------------------------------------------------------------------------- a stance


STAND = Stub(
    task="roll 1.0 deg",
    ground_clearance=Stub(distance=0.0111, links=("calf",)),
    self_clearance=Stub(distance=0.0222, links=("thigh", "base")),
)


def stance(**changes: Any) -> Stub:
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
            failures=("foot FR slides",),
        ),
        "unsettled": "",
        "minimum_stiffness": 4.567,
        "sunk": Stub(depths={"FR": 0.00311, "RL": 0.00422}),
        "loops_open": 2.34e-5,
    }
    return Stub(**{**fields, **changes})


def test_a_stance() -> None:
    assert printed(stance_report.print_stance, stance()) == words("""
        stub: roll 1.0 deg
        Motor torques (N m)
        joint torque limit utilisation simulated minimum peak position (rad)
        hip +0.1111 3.1 5.1% +0.3333 +0.0611 +0.6543
        knee -0.2222 4.2 95.2% -0.4444 -0.2722 -0.7654
        torque: with the least tangential forces at the feet, which last; minimum peak: with the
            contact forces of
        least peak utilisation, 90.2%
        limit: effort in the URDF (1), forcerange in the MJCF (1)
        Contact forces on the feet (N, world axes)
        foot force friction used simulated minimum peak
        FR +1.011 -2.022 +3.033 7.1% +0.101 +0.202 +7.303 +0.961 -2.072 +2.983
        RL +4.044 -5.055 +6.066 8.2% +0.404 +0.505 +8.606 +3.994 -5.105 +6.016
        balance residual 1.1e-11 N, 2.2e-12 N m (in MuJoCo's terms 4.2e-05); com 12.3 mm inside the
            support polygon
        lowest part but the feet: calf, 11.1 mm
        nearest links: thigh and base, 22.2 mm apart
        commanded these joints alone it settles at 0.11223 m: servos give 7.89 mm, the ground 4.21
            mm; but foot FR slides
        minimum stiffness of servos that carry it without feed-forward: 4.57 N m/rad
        all this is on MuJoCo's soft ground, with legs longer by what the feet sink in (at most 4.22
            mm)
        the MJCF's loops and couplings are open in it by up to 2.3e-05 m or rad, as their softness
            has it
        OVERLOADED: with the contact forces that last the motors cannot hold it: knee;
        HOLDS in MuJoCo for 12 s: torques within 1.2e-02, forces within 2.4e-02 of the prediction
            (relative to the largest)
    """)


def test_a_stance_that_fails() -> None:
    failing = stance(
        verification=run(0.0, passed=False), sunk=None, settled=None, unsettled="why",
        verdict=judge(run(0.0, passed=False), None, SERVOS), minimum_stiffness=None,
        loops_open=None,
    )  # fmt: skip
    text = " ".join(printed(stance_report.print_stance, failing))
    assert "without feed-forward, no sag is predicted: why note: the feet of stub, sunk" in text
    assert text.endswith("simulated with joints for rigid ground FAILS in MuJoCo: it sank")
    assert "HOLDS" not in text


def loaded(*unlimited: str) -> Stub:
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
        name="stub", stand=STAND, payload=payload, trial=trial, buckling=buckling, servos=SERVOS
    )


def test_a_payload() -> None:
    assert printed(stance_report.print_payload, loaded("hip")) == words("""
        stub: roll 1.0 deg
        payload at (11, -22, 83) mm of the base: 1.23 kg, then the servos are too soft: it buckles
            (knee); motors 4.56 kg, servos' stiffness 1.23 kg, contacts no limit; 1 motor has no
            effort limit, and sets no payload
        How fast it buckles on its servos: in what time a deviation doubles
        payload (kg) of the servos' limit doubles in (s) without dry friction (s)
        0.99 0.80 162 -
        that is static, at the motors' peak torque as the files state it
        simulated with 1.17 kg on it, 12 s, nudged: at 3.46 s the robot tips (FL)
    """)
    text = " ".join(printed(stance_report.print_payload, loaded("hip", "knee")))
    assert "no limit; 2 motors have no effort limit, and set no payload" in text
    assert "contacts no limit How fast" in " ".join(printed(stance_report.print_payload, loaded()))


def test_the_best() -> None:
    best = Stub(
        objective=Objective.MARGIN,
        value=0.0456,
        nominal_value=0.0345,
        evaluations=321,
        coordinates={"height": 0.1567, "pitch": math.radians(2.5), "FR x": -0.0123},
        active=("height high",),
    )
    study = Stub(best=best, stance=stance(), loaded=None)
    first = words("""
        best of 321 stances: distance of the com from the support polygon's edge 0.0456 m, against
            0.0345 m as asked; height 156.7 mm, pitch +2.5 deg, FR x -12.3 mm; at its limit: height
            high
    """)
    assert printed(stance_report.print_best, study) == (
        first + printed(stance_report.print_stance, stance())
    )


def test_the_best_payload_is_rounded_down_in_kilograms() -> None:
    best = Stub(
        objective=Objective.PAYLOAD, value=2.349, nominal_value=1.118, evaluations=5,
        coordinates={"yaw": math.radians(-3.3)}, active=(),
    )  # fmt: skip
    study = Stub(best=best, stance=stance(), loaded=loaded())
    text = " ".join(printed(stance_report.print_best, study))
    assert "best of 5 stances: payload 2.34 kg, against 1.11 kg as asked; yaw -3.3 deg" in text
    assert text.endswith("nudged: at 3.46 s the robot tips (FL)")


def test_a_workspace() -> None:
    intervals = {
        "height": Stub(low=0.0911, high=0.1922),
        "roll": Stub(low=math.radians(-13.3), high=math.radians(14.4)),
        "x": Stub(low=-0.0255, high=0.0366),
    }
    found = Stub(start=STAND, intervals=intervals)
    assert printed(stance_report.print_workspace, "stub", found) == words("""
        stub: roll 1.0 deg
        How far the base can go, each alone
        from to
        height +91.1 mm +192.2 mm
        roll -13.3 deg +14.4 deg
        x -25.5 mm +36.6 mm
        of reach and balance alone, whatever motors and servos hold: stand, with a pose of these,
            tells whether it holds
    """)


def there(**changes: Any) -> Stub:
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
    fields = {"name": "stub", "stand": STAND, "path": path, "tracking": tracking}
    least = {"binding": None, "reserve": None, "lower_bound": None, "servos": SERVOS}
    return Stub(**fields, **{**least, **changes})


def test_a_path() -> None:
    assert printed(stance_report.print_path, there()) == words("""
        stub: roll 1.0 deg
        path of 3 s, 3 samples: motors in motion at most 32.1% of their torque limit (knee at 1.23
            s), 5.4% of their velocity limit; com at least 22.2 mm inside the support polygon,
            zero-moment point 17.7 mm
        least load of the feet (N): FR 3.33, RL 4.44
        in MuJoCo: torques within 1.2% of the largest, joints within 0.034 rad (0.005 rms), base
            height within 6.7 mm, orientation within 0.089 rad, feet within 2.3 mm of their places
        TRACKED
    """)


def test_the_fastest_path() -> None:
    least = there(binding="friction (FR)", reserve=0.21, lower_bound=2.5)
    text = " ".join(printed(stance_report.print_path, least))
    assert (
        "least time 3 s, with 21% of every limit in reserve: bound by friction (FR); 2.5 s if the "
        "acceleration could jump path of" in text
    )


# ------------------------------------------------------------------------------------- two files


def test_two_models() -> None:
    difference = Stub(
        kind="mass",
        element="base",
        urdf=3.3,
        mjcf=6.9,
        message="body of base: mass 3.3 kg in the URDF, 6.9 kg in the MJCF",
        diagnostic="body of base: mass 3.3 kg in the URDF, 6.9 kg in the MJCF",
        urdf_place="a.urdf:5",
        mjcf_place="b.xml:44",
        effects={
            "gravity": Stub(share=0.45, relative=1.2e-2, deviation=9.0),
            "mass matrix": Stub(share=0.97, relative=3.4e-1, deviation=8.0),
        },
        made_of=("in the URDF it is made of trunk 3 kg",),
    )
    limit = Stub(
        kind="effort",
        element="knee",
        urdf=1.5,
        mjcf=2.5,
        message="joint knee: effort 1.5",
        diagnostic="joint knee: effort 1.5",
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
    found = Stub(
        urdf="a.urdf",
        mjcf="b.xml",
        agree=False,
        same_robot=False,
        differences=(difference, limit),
        causes=(
            Stub(message="another unit", diagnostic="another unit", differences=(1,), leads=False),
        ),
        parts=("a tail too many",),
        objections=("too much is left",),
        mount=None,
        left={"mass matrix": 7.7e-7, "gravity": 8.8e-8},
        explained=0.9876,
        complete=False,
        check=Stub(configurations=23, quantities=(quantity,), notes=("noted",)),
        engines=("gravity",),
        notes=("assumed",),
        guessed={"one": "two"},
        only_urdf=("tail",),
        only_mjcf=("head",),
    )
    assert printed(models_report.print_models, found) == words("""
        DISAGREE: a tail too many
        - a tail too many; it was taken off to compare the rest
        - another unit (this alone makes 1 differences; --all prints each)
        a.urdf:7 b.xml:55
        the effort of knee: no effect on the dynamics
        1. body of base: mass 3.3 kg in the URDF, 6.9 kg in the MJCF
        a.urdf:5 b.xml:44
        in the URDF it is made of trunk 3 kg
        alone it makes, of the deviation in: mass matrix 97% (3.4e-01), gravity 45% (1.2e-02)
        explained: 98.76 % of the deviation; with the MJCF's values in the URDF's model 7.7e-07 is
            left, so something is missing in this list
        too much is left
        Deviation relative to each quantity's scale, at 23 random configurations
        models models engines engines yourdfpy extras
        quantity (Pinocchio) (MuJoCo) (URDF) (MJCF) (URDF) (MJCF) worst at
        mass matrix 1.1e-01 2.2e-02 3.3e-13 4.4e-14 5.5e-15 6.6e-06 knee, #3
        note: noted
        note: the engines differ on one model: gravity
        note: assumed
        note: matched by structure, by link or by part of the name (confirm with --map): one=two
        note: only in a.urdf, fixed at zero or taken off to compare the rest: tail
        note: only in b.xml, fixed at zero or taken off to compare the rest: head
    """)


def test_limits_say_that_their_servos_were_made_up() -> None:
    """Of a robot without servos nobody stated what it can carry, or be pushed by."""
    made = MadeServo("knee", 320.0, 16.0, Drive.MOTOR)
    own = ServosUsed(ServoSource.MADE_UP, (320.0, 320.0), (16.0, 16.0), (made,))
    one = loaded()
    one.servos = own
    said = "on servos that were made up at 1 joints (kp 320 N m/rad, kd 16 N m s/rad)"
    assert f"as the files state it, {said}" in " ".join(printed(stance_report.print_payload, one))
    push = pushed(0.0, 0.00311)
    push.verdict = judge(run(0.0, passed=True), None, own)
    assert said in " ".join(printed(push_report.print_pushes, {"one": push}))
    way = there(servos=own)
    assert f"of their places, {said}" in " ".join(printed(stance_report.print_path, way))


def test_pushes_of_what_fails_are_told_with_its_verdict() -> None:
    """It stands, and not as predicted: limits are told, and so is that `stand` fails."""
    one = pushed(0.0, 0.00311)
    one.verdict = judge(run(0.0, passed=False), None, SERVOS)
    text = " ".join(printed(push_report.print_pushes, {"one": one}))
    assert "one: FAILS in MuJoCo: " in text
    assert "weakest at 240 deg, 0.43 N s" in text
    one.recovery.unpushed = ("it fell over",)
    text = " ".join(printed(push_report.print_pushes, {"one": one}))
    assert "it does not stand, so it withstands no push" in text
    assert "weakest" not in text


def test_what_motors_bear_if_legs_share_it_is_told_where_it_is_more() -> None:
    assert "share" not in " ".join(printed(stance_report.print_payload, loaded()))
    more = loaded()
    more.payload.shared = Sharing(5.678, np.zeros(12), {})
    text = " ".join(printed(stance_report.print_payload, more))
    assert "motors 5.67" in text.split("contacts")[1]
