"""The document of a held posture: each number is in its own column."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.units import round_down
from pupper_analysis.present.document import BarPlot, Name, NextStep, Table, Text, get_english
from pupper_analysis.present.html.plots import draw_svg
from pupper_analysis.simulation.verdict import Ending, Question, VerdictCode
from pupper_analysis.tools.hold.document import (
    describe_hardest_motor,
    force_plots,
    hold_document,
)
from tests.support.arm import arm
from tests.support.stubs import judge_added_servos


def test_torques_positions_and_sags_are_each_in_their_column() -> None:
    """Reference: torques [N m], and positions and sags in mm for slides and degrees for hinges."""
    held = pa.hold_posture(arm(), {"shoulder": -0.4, "elbow": 0.9})
    table = next(block for block in hold_document(held).blocks if isinstance(block, Table))
    columns = {str(getattr(one.name, "en", one.name)): at for at, one in enumerate(table.columns)}
    assert held.settled is not None
    slides = [name.endswith("slide") for name in held.posture.joint_names]
    shown_by = np.where(slides, 1e3, 180 / np.pi)
    for name, values in (
        ("torque", held.statics.joint_torques),
        ("position", shown_by * held.posture.qpos),  # mm of what slides, degrees of what turns
        ("sag", shown_by * (held.settled.qpos - held.posture.qpos)),
    ):
        shown = [float(row[columns[name]].text) for row in table.rows]
        assert shown == pytest.approx(values.tolist(), abs=5e-5 if name == "torque" else 5e-3)
    (plot,) = (block for block in hold_document(held).blocks if isinstance(block, BarPlot))
    labels = {str(mark["words"].text) for mark in draw_svg(plot).marks if mark["tag"] == "text"
              if isinstance(mark["words"], Name)}  # fmt: skip
    for name, torque, limit in zip(
        held.posture.joint_names, held.statics.joint_torques, held.limits, strict=True
    ):
        unit = "N" if name.endswith("slide") else "N m"
        assert f"{100 * abs(torque) / limit:.1f} % of {limit:g} {unit}" in labels
    points = [bar.point for bar in plot.bars]
    assert points == pytest.approx((100 * held.worst.utilisation).tolist())
    assert get_english(plot.title).startswith("Motor utilisation in the posture: ")
    assert "shoulder at -22.92 deg, elbow at 51.57 deg" in get_english(plot.title)


def test_sections_of_the_forces_have_named_axes_and_equal_scales() -> None:
    """Reference: forces along the axes of the world. The axes were "first" and "second"."""
    held = pa.hold_posture(arm(), {"shoulder": -0.4, "elbow": 0.9})
    flat, upright = force_plots(held.force)
    assert flat.equal_scales
    assert upright.equal_scales
    names = [get_english(axis.name) for axis in (flat.x, flat.y, upright.x, upright.y)]
    along = [f"force along {axis} of the world" for axis in ("x", "y", "x or y", "z")]
    assert names == along
    forces = held.force.forces  # +x, -x, +y, -y, +z, -z
    sections = (flat.series[0], *upright.series)
    for section, (first, second) in zip(sections, ((0, 2), (0, 4), (2, 4)), strict=True):
        x, y = np.asarray(section.x), np.asarray(section.y)
        ahead = x[np.isclose(y, 0.0, atol=1e-9) & (x > 0)]
        above = y[np.isclose(x, 0.0, atol=1e-9) & (y > 0)]
        for found, index in ((ahead, first), (above, second)):
            if np.isfinite(forces[index]):
                assert found[0] == pytest.approx(forces[index])


def test_payload_that_fails_in_mujoco_is_a_finding() -> None:
    """The first lines contain the failed simulation, in addition to the limit of the motors."""
    held = pa.hold_posture(arm(), {"shoulder": -0.4, "elbow": 0.9})
    assert held.payload_trial is not None
    assert held.payload_trial.passed
    why = diagnose("nudge-does-not-decay", speed=1e-3, after=Quantity(7.0, "s"), left=5e-4)
    shaking = replace(held.payload_trial, passed=False, failures=(why,))
    for trial, lines in ((held.payload_trial, 0), (shaking, 1), (None, 0)):
        document = hold_document(replace(held, payload_trial=trial))
        failing = [line for line in document.findings if "and FAILS with more" in str(line)]
        assert len(failing) == lines


def test_no_motor_is_closest_to_its_limit_beside_one_without_torque() -> None:
    """A loaded motor with an effort of zero exceeds its limit by any torque."""
    held = pa.hold_posture(arm(), {"shoulder": -0.4, "elbow": 0.9})
    limits = held.limits.copy()
    assert list(describe_hardest_motor(held.statics, limits))
    limits[int(np.argmax(np.abs(held.statics.joint_torques)))] = 0.0
    shares = np.divide(
        np.abs(held.statics.joint_torques),
        limits,
        out=np.full(len(limits), np.inf),
        where=limits > 0,
    )
    statics = replace(held.statics, motor_utilisation=shares)
    assert list(describe_hardest_motor(statics, limits)) == []


def test_verdict_word_is_qualified_only_if_another_posture_exceeds_a_motor_limit() -> None:
    """The utilisations of the worst postures are set below and above 1."""
    held = pa.hold_posture(arm(), {"shoulder": -0.4, "elbow": 0.9})
    assert held.passed
    for share, qualified in ((0.99, False), (1.01, True)):
        shares = np.full(len(held.worst.utilisation), share)
        document = hold_document(replace(held, worst=replace(held.worst, utilisation=shares)))
        assert ("THIS POSTURE ONLY" in getattr(document.verdict, "en", "")) is qualified


def test_masses_are_not_rounded_up_to_a_payload_that_does_not_hold() -> None:
    """Reference: 0.06 kg at the tool, and at most 0.0123 kg more; a limit of 999.7 kg."""
    held = pa.hold_posture(arm(), {"shoulder": -0.4, "elbow": 0.9})
    loaded = replace(held, carried=0.06, payload=replace(held.payload, worst_posture_mass=0.0123))
    step = hold_document(loaded).next_step
    assert step is not None
    assert step.words == ("--payload", "0.072kg")
    strong = replace(
        held,
        payload=replace(held.payload, worst_posture_mass=999.7),
        payload_trial=None,
        simulated_mass=math.nan,
    )
    assert "payload limit at tip: 999 kg" in " ".join(map(str, hold_document(strong).findings))
    limits = replace(held.payload, mass=1.29999, servos=1299.7, worst_posture_mass=0.0123456)
    (table,) = [
        block
        for block in hold_document(replace(held, payload=limits)).blocks
        if isinstance(block, Table) and "Payload at the tool" in str(block.title)
    ]
    assert [getattr(row[1], "text", "") for row in table.rows] == ["1.299", "1299", "0.01234"]


def test_torques_from_1000_are_printed_as_integers() -> None:
    """Reference: 1234 N m; printed as 1.23e+03 before."""
    held = pa.hold_posture(arm(), {"shoulder": -0.4, "elbow": 0.9})
    torques = np.full(len(held.worst.joint_torques), 1234.0)
    strong = replace(held, worst=replace(held.worst, joint_torques=torques))
    texts = str(hold_document(strong))
    assert "1230" in texts
    assert "1.23e+03" not in texts


def test_soft_servos_are_the_reason_for_a_posture_that_needs_gravity_compensation() -> None:
    """Reference: the sag of the tool in MuJoCo [mm], with a third of the stiffness."""
    held = pa.hold_posture(arm(), {"shoulder": -0.4, "elbow": 0.9}, kp=100.0, kd=10.0)
    verdict = replace(
        held.verdict, code=VerdictCode.HOLDS_WITH_FEEDFORWARD, commands_alone=Ending.FAILS
    )
    lines = [line.short for line in hold_document(replace(held, verdict=verdict)).findings
             if isinstance(line, Text)]  # fmt: skip
    start, unit = "kp 100 N m/rad or N/m too low without gravity compensation: tip sags ", " mm"
    assert lines[1].startswith(start)
    sag = float(lines[1].removeprefix(start).removesuffix(unit))
    assert sag == pytest.approx(1e3 * np.linalg.norm(held.simulated_tool_sag), rel=0.01)
    assert "payload" in lines[2]


_GAINS_STEP = NextStep("gains", ("--contact", "base=weld"), omitted=("--payload",))
"""Next step of a posture without a further payload."""


def test_unknown_motor_limits_lead_to_a_command_with_example_limits() -> None:
    """hold proposed audit, and audit hold: neither stated a limit. Reference: the torque of the
    worst posture."""
    held = pa.hold_posture(arm(), {"shoulder": -0.4, "elbow": 0.9})
    payload = replace(held.payload, worst_posture_mass=math.nan, unknown=("elbow",))
    document = hold_document(replace(held, payload=payload))
    torque = abs(held.worst.joint_torques[held.worst.joint_names.index("elbow")])
    assert document.next_step is not None
    assert document.next_step.command == "hold"
    option, value = document.next_step.words
    assert option == "--effort"
    pattern, _, effort = value.partition("=")
    assert pattern == "elbow"
    assert torque <= float(effort) <= 1.01 * torque
    line = document.findings[1]
    assert isinstance(line, Text)
    assert line.short.endswith(f": replace {value} by the motor limits")


def test_next_step_after_a_loaded_posture_does_not_propose_the_same_payload_again() -> None:
    """The rest that rounding left is not proposed; an overload leads to the largest payload."""
    held = pa.hold_posture(arm(), {"shoulder": -0.4, "elbow": 0.9})
    loaded = replace(held, carried=10.0, payload=replace(held.payload, worst_posture_mass=0.5))
    assert hold_document(loaded).next_step == _GAINS_STEP
    shares = np.full(len(held.worst.utilisation), 1.01)
    overloaded = replace(loaded, worst=replace(held.worst, utilisation=shares))
    assert hold_document(overloaded).next_step == NextStep("hold", omitted=("--payload",))


@pytest.mark.parametrize(
    ("alone", "ending"),
    [
        (np.nan, " in the worst posture (limit: {joint})"),
        (0.5, " (limit: {joint}), 0.5 kg without gravity compensation"),
    ],
)
def test_second_line_names_the_joint_of_the_payload_and_the_mass_without_compensation(
    alone: float, ending: str
) -> None:
    """Reference: the joint in the row of the worst posture in the table of payloads."""
    held = replace(
        pa.hold_posture(arm(), {"shoulder": -0.4, "elbow": 0.9}), mass_by_commands_alone=alone
    )
    document = hold_document(held)
    line = document.findings[1]
    assert isinstance(line, Text)
    joint = held.payload.worst_posture_joint
    assert joint
    assert line.short.startswith(f"payload {held.payload.worst_posture_mass:.3g} kg at ")
    assert line.short.endswith(ending.format(joint=joint))
    assert f"最不利姿态，受限于 {joint}" in line.short_zh
    (table,) = [
        block
        for block in document.blocks
        if isinstance(block, Table) and "Payload at the tool" in str(block.title)
    ]
    mass, motor = table.rows[-1][1:]
    assert getattr(mass, "text", "") == f"{held.payload.worst_posture_mass:.4g}"
    assert motor == Name(joint)


def test_payload_that_the_simulation_refutes_is_not_proposed() -> None:
    """Solo12 states limits of 1000 N m: the motors held 313 kg, and the next command failed."""
    held = pa.hold_posture(arm(), {"shoulder": -0.4, "elbow": 0.9})
    assert held.payload_trial is not None
    why = diagnose("nudge-does-not-decay", speed=1e-3, after=Quantity(7.0, "s"), left=5e-4)
    shaking = replace(held.payload_trial, passed=False, failures=(why,))
    for simulated, step in (
        (0.254, NextStep("hold", ("--payload", "0.25kg"))),
        (0.0, _GAINS_STEP),
    ):
        document = hold_document(replace(held, payload_trial=shaking, simulated_mass=simulated))
        assert document.next_step == step
        line = document.findings[1]
        assert isinstance(line, Text)
        assert line.short.startswith(f"payload {simulated:g} kg at ")
        assert line.short.endswith(" (limit: simulation)")
        assert f"the motors hold {held.payload.worst_posture_mass:.3g} kg" in line.en


@pytest.mark.parametrize(
    ("alone", "hangs"), [(np.nan, True), (0.5, True), (0.5, False), (np.nan, False)]
)
def test_added_servos_are_stated_once_with_the_reason_of_their_gains(
    alone: float, *, hangs: bool
) -> None:
    """Go2: "(added kp); added kp 16.2 to 75 N m/rad", beside "kp 290 N m/rad" of its stand."""
    held = replace(
        pa.hold_posture(arm(), {"shoulder": -0.4, "elbow": 0.9}),
        mass_by_commands_alone=alone,
        hangs=hangs,
    )
    servos = replace(judge_added_servos(Question.STANDS).servos, hangs=hangs)
    document = hold_document(replace(held, verdict=replace(held.verdict, servos=servos)))
    lines = [line.short or line.en for line in document.findings if isinstance(line, Text)]
    second = "; ".join(lines[1:])
    assert second.count("added kp") == 1
    assert ("added kp 320 N m/rad for the fixed base" in second) == (hangs and math.isnan(alone))
    detail = any("a stand gets other gains" in get_english(line) for line in document.details)
    assert detail == (hangs and not math.isnan(alone))


def test_tool_position_and_sags_are_each_in_their_row() -> None:
    """References: the vectors of the result [m], which all differ; the table contains mm."""
    held = replace(
        pa.hold_posture(arm(), {"shoulder": -0.4, "elbow": 0.9}),
        tool_position=np.array([0.1, 0.2, 0.3]),
        tool_sag=np.array([0.003, -0.004, 0.0]),
        simulated_tool_sag=np.array([0.006, -0.008, 0.0]),
    )
    (table,) = [
        block
        for block in hold_document(held).blocks
        if isinstance(block, Table) and "Tool: " in str(block.title)
    ]
    rows = {
        get_english(row[0]): [getattr(cell, "text", "") for cell in row[1:]] for row in table.rows
    }
    assert rows == {
        "position in the world": ["+100.0 +200.0 +300.0", "374.2"],
        "sag without feed-forward": ["+3.00 -4.00 +0.00", "5.00"],
        "sag without feed-forward, simulated": ["+6.00 -8.00 +0.00", "10.00"],
    }


def test_finding_states_each_limit_of_the_tool() -> None:
    """References: payloads and force of the result, which all differ."""
    held = pa.hold_posture(arm(), {"shoulder": -0.4, "elbow": 0.9})
    document = hold_document(held)
    (line,) = [line for line in document.details if "The motors hold" in str(line)]
    payload = held.payload
    for value in (payload.mass, payload.worst_posture_mass, held.force.weakest):
        assert f"{round_down(value, 3):.3g} " in get_english(line)
    assert f"hold {round_down(payload.mass, 3):.3g} kg" in get_english(line)
    assert f"withstand {round_down(held.force.weakest, 3):.3g} N" in get_english(line)
    (table,) = [
        block
        for block in document.blocks
        if isinstance(block, Table) and "Payload at the tool" in str(block.title)
    ]
    masses = [getattr(row[1], "value", np.nan) for row in table.rows]
    assert masses == [payload.mass, payload.servos, payload.worst_posture_mass]


def test_predicted_and_simulated_sag_of_joints_are_each_in_their_column() -> None:
    """References: equilibrium, and simulated positions that deviate by 0.1 rad and 0.1 m."""
    held = pa.hold_posture(arm(), {"shoulder": -0.4, "elbow": 0.9})
    assert held.settled is not None
    simulated = held.settled.qpos + 0.1
    held = replace(held, sagging=replace(held.sagging, joint_positions=simulated))
    (table,) = [
        block
        for block in hold_document(held).blocks
        if isinstance(block, Table) and "Motor torques" in str(block.title)
    ]
    headings = [get_english(column.name) for column in table.columns]
    slides = [name.endswith("slide") for name in held.posture.joint_names]
    shown_by = np.where(slides, 1e3, 180 / np.pi)
    for name, positions in (("sag", held.settled.qpos), ("sag, simulated", simulated)):
        column = [getattr(row[headings.index(name)], "value", np.nan) for row in table.rows]
        assert column == pytest.approx((shown_by * (positions - held.posture.qpos)).tolist())


def test_worst_torque_limit_and_utilisation_are_each_in_their_column() -> None:
    """References: the result of the search, whose numbers all differ."""
    held = pa.hold_posture(arm(), {"shoulder": -0.4, "elbow": 0.9})
    (table,) = [
        block
        for block in hold_document(held).blocks
        if isinstance(block, Table) and "Worst posture of each motor" in str(block.title)
    ]
    worst = held.worst
    for index, row in enumerate(table.rows):
        joint, *cells = row[:4]
        assert joint == Name(worst.joint_names[index])
        expected = (
            worst.joint_torques[index],
            worst.limits[index],
            100 * worst.utilisation[index],
        )
        assert [getattr(cell, "value", np.nan) for cell in cells] == pytest.approx(expected)


def test_first_line_states_torque_and_utilisation_of_the_worst_posture() -> None:
    """References: torque [N m, N] and utilisation of the most loaded motor of the search."""
    held = pa.hold_posture(arm(), {"shoulder": -0.4, "elbow": 0.9})
    line = hold_document(held).findings[0]
    assert isinstance(line, Text)
    worst = held.worst
    index = int(np.nanargmax(worst.utilisation))
    torque, share = abs(worst.joint_torques[index]), 100 * worst.utilisation[index]
    assert line.short.startswith(f"worst posture {torque:.3g} ")
    assert line.short.endswith(f" = {share:.3g} % of the limit ({worst.joint_names[index]})")
