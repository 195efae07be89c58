"""The document of a conversion states a recovery only if the robot recovers within the simulated
time.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.prepare.notes import describe_span, describe_spans
from pupper_analysis.present.document import Text, get_english
from pupper_analysis.tools.convert.document import (
    _describe_checks,
    _describe_recovery,
    conversion_document,
)


def conversion(frequency: float, damping_ratio: float, left: float, *, stands: bool = True) -> Any:
    mode = SimpleNamespace(frequency=frequency, damping_ratio=damping_ratio)
    nudge = SimpleNamespace(speed=1e-3, duration=12.0, left=left)
    stability = SimpleNamespace(least_damped=mode)
    kept = SimpleNamespace(failures=(), stability=stability, nudge=nudge)
    return SimpleNamespace(kept=kept, verification=SimpleNamespace(passed=stands))


@pytest.mark.parametrize(
    ("frequency", "damping_ratio", "left", "start"),
    [
        # SpotMicro with links of 1000 kg m^2: 1 / (2 pi 0.018 0.0036) = 2456 s to 1/e
        (0.018, 0.0036, 7e-4, "DOES NOT RECOVER within the simulated 12 s"),
        (0.018, 0.0036, 1e-6, "RECOVERS"),  # dry friction has stopped it
        (3.0, 0.05, 7e-4, "RECOVERS"),
    ],
)
def test_recovery_is_stated_only_if_it_is_faster_than_the_simulation(
    frequency: float, damping_ratio: float, left: float, start: str
) -> None:
    """Closed form: the time to 1/e is 1 / (2 pi frequency damping ratio) [s]; the simulation has 12
    s.
    """
    (line,) = _describe_recovery(conversion(frequency, damping_ratio, left))
    assert str(line.en).startswith(start)


def test_recovery_has_speed_damping_and_frequency_in_this_order() -> None:
    (line,) = _describe_recovery(conversion(7.1, 0.11, 1e-6))
    assert get_english(line) == (
        "RECOVERS FROM A NUDGE of 0.001 m/s and rad/s from its keyframe: "
        "the lowest damping ratio is 0.11, at 7.1 Hz"
    )


def test_recovery_is_not_stated_of_a_robot_that_does_not_stand() -> None:
    assert not list(_describe_recovery(conversion(3.0, 0.05, 1e-6, stands=False)))


def get_short_findings(conversion: Any) -> list[str]:
    return [
        getattr(part, "short", "") or get_english(part) for part in _describe_checks(conversion)
    ]


def test_gains_of_hinges_and_slides_are_stated_apart() -> None:
    """Panda: kp was "53.3 to 2660 N m/rad or N/m" for seven hinges and a slide of the hand."""
    note = diagnose(
        "servos-made",
        kp=describe_spans([200.0, 2660.0, 53.3], ["N m/rad", "N m/rad", "N/m"]),
        kd=describe_spans([4.0, 65.8, 1.78], ["N m s/rad", "N m s/rad", "N s/m"]),
        timestep=Quantity(0.002, "s"),
    )
    converted = SimpleNamespace(
        source="arm.urdf",
        agree=True,
        repairs=(),
        notes=(note,),
        not_converted=(),
        comparison=SimpleNamespace(differences=(), deviations={"com": 1e-16}),
        verification=None,
    )
    _, line = _describe_checks(converted)
    assert isinstance(line, Text)
    assert line.short == (
        "servos added (kp 200 to 2660 N m/rad and 53.3 N/m, kd 4 to 65.8 N m s/rad and 1.78 N s/m)"
    )
    assert line.zh == (
        "添加了伺服（kp 200 至 2660 N m/rad 和 53.3 N/m，kd 4 至 65.8 N m s/rad 和 1.78 N s/m）"
    )


def test_second_line_has_the_gains_of_the_added_servos_and_the_lost_limits() -> None:
    """kp 320 and kd 16 of one kind of joint; velocity limits of 12 joints are lost."""
    note = diagnose(
        "servos-added",
        count=12,
        bad=False,
        some=False,
        kp=describe_span([320.0, 320.0], "N m/rad"),
        kd=describe_span([8.0, 16.0], "N m s/rad"),
        timestep=Quantity(0.002, "s"),
    )
    lost = diagnose("velocity-limits-left", count=12, limits="15.7 to 30.1 rad/s")
    converted = SimpleNamespace(
        source="go2.urdf",
        agree=True,
        repairs=(),
        notes=(note,),
        not_converted=(lost,),
        comparison=SimpleNamespace(
            differences=(), deviations={"com": 1e-16, "gravity": 2e-15, "bias forces": 3e-16}
        ),
        verification=SimpleNamespace(
            passed=True, duration=12.0, base_height=0.28, torque_error=4.2e-8
        ),
    )
    assert get_short_findings(converted)[1:] == [
        "STANDS 12 s at 280.0 mm, servos added (kp 320, kd 8..16)",
        "velocity limits of 12 joints not converted",
    ]
    complete = [get_english(part) for part in _describe_checks(converted)]
    assert complete[0] == (
        "kinematics, masses and torques deviate by at most 2.0e-15; no difference from go2.urdf"
    )
    armature = diagnose("armature-not-in-urdf", armature=describe_span([0.01], "kg m^2"))
    converted.not_converted = (armature,)
    compared = "kinematics, masses, torques deviate ≤2.0e-15"
    assert get_short_findings(converted)[0] == f"{compared} (with equal armature)"
    converted.not_converted = (lost,)
    assert complete[1] == (
        "STANDS for 12 s in MuJoCo at base height 280.0 mm, on added servos with kp 320 N m/rad "
        "and kd 8 to 16 N m s/rad; torques deviate from the prediction by at most 4.2e-08"
    )
    document = conversion_document(
        SimpleNamespace(
            **vars(converted),
            output="new/go2.xml",
            passed=True,
            failures=(),
            kept=None,
            floating=True,
        )
    )
    assert get_english(document.title) == "go2.urdf and go2.xml"
    assert document.next_step is not None
    assert document.next_step.words == ("new/go2.xml",)
    converted.notes = ()
    assert get_short_findings(converted)[1] == "STANDS 12 s in MuJoCo at base height 280.0 mm"
