"""The document of a path."""

from __future__ import annotations

import math
import re

from pupper_analysis.present.document import MAX_ANSWER_WIDTH, Text, get_english, text
from pupper_analysis.simulation.verdict import Question
from pupper_analysis.tools.path.command import command
from pupper_analysis.tools.path.document import path_document
from tests.support.printing import printed
from tests.support.stubs import ADDED_SERVOS_TEXT, judge_added_servos, make_path_result


def test_path_states_that_its_servos_were_added() -> None:
    result = make_path_result(verdict=judge_added_servos(Question.TRACKED))
    assert ADDED_SERVOS_TEXT in " ".join(printed(path_document(result), width=240).split())


def test_path_on_unstable_damping_states_ideal_servos_and_proposes_gains() -> None:
    """`stand` stated ideal servos of Go2's URDF, and `path` did not; the bound is a factor of 1."""
    for factor, ideal in ((None, False), (1.9, False), (0.56, True)):
        document = path_document(make_path_result(largest_kd_factor=factor))
        assert get_english(document.verdict).endswith("(ideal servos)") is ideal
        assert document.next_step is not None
        assert (document.next_step.command == "gains") is ideal


def test_error_of_a_slide_is_a_length() -> None:
    """The stub deviates by 0.034 m; as an angle in rad, it would be 1.95 degrees."""
    result = make_path_result()
    result.tracking.joint_error_unit = "m"
    (row,) = [line for line in printed(path_document(result)).splitlines() if "34.0" in line]
    assert "mm" in row


def test_path_without_motion_names_the_options_of_a_goal() -> None:
    """A long name fits 100 columns (``MAX_ANSWER_WIDTH``), and line 2 has room for a warning."""
    result = make_path_result()
    result.path.has_motion = False
    first, second, *_ = path_document(result).findings
    assert isinstance(first, Text)
    assert isinstance(second, Text)
    assert first.short == "no motion; load 32.1 % of the limit (knee)"
    options = {option for param in command.params for option in param.opts}
    assert options >= {word.strip(",") for word in second.short.split() if word.startswith("--")}
    assert options >= set(re.findall(r"--[a-z]+", second.en))
    assert len(second.short) < MAX_ANSWER_WIDTH / 2


def test_first_line_fits_with_a_long_name_of_a_robot() -> None:
    """Go2 from its URDF: the line had up to 117 characters."""
    common = {"seconds": "4", "share": "14", "joint": "FL_calf_joint", "time": "0.40"}
    common |= {"error": "0.35 deg", "height": "10.2"}
    for place in ("", " of the limit (knee, 0.40 s)"):
        line = text("path-in-short", **common, still=bool(place), place=place).short
        assert line
        assert len(f"TRACKED (URDF only) go2_description: {line}") <= MAX_ANSWER_WIDTH


def test_chinese_answer_states_the_same_numbers_as_the_english_answer() -> None:
    """The first Chinese line stated only the duration of the path."""
    numbers = {"error": "0.16 deg", "height": "0.1", "share": "27", "place": "", "joint": "knee"}
    line = text("path-in-short", **numbers, seconds="4", still=False, zero=False, unknown=False)
    assert line.short == "joint error 0.16 deg, height error 0.1 mm, load 27 %"
    assert line.short_zh == "关节误差 0.16 deg，高度误差 0.1 mm，负载 27 %"


def test_short_answer_states_tracking_errors_then_the_motor_with_the_largest_load() -> None:
    """References: errors and peak load of the result, in degrees, mm and percent."""
    result = make_path_result()
    error = math.degrees(result.tracking.joint_error)
    height = 1e3 * result.tracking.height_error
    first, second = printed(path_document(result), width=200, everything=False).splitlines()[:2]
    expected = f"joint error {error:.2g} deg, height error {height:.1f} mm, load 32.1 %"
    assert first.endswith(expected)
    assert second.startswith("  motor load 32.1 % of the limit: knee at 1.23 s")
