"""Sentences of results, said in Chinese."""

from __future__ import annotations

import re
from string import Formatter

import pytest
from conftest import load

import pupper_analysis as pa
from pupper_analysis.report.document import Said, Text
from pupper_analysis.report.html.sentences import patterns, said, sentences

HAN = re.compile("[\u4e00-\u9fff]")


def holes(pattern: str) -> list[str]:
    return sorted(name for _, name, _, _ in Formatter().parse(pattern) if name)


def filled(pattern: str) -> str:
    """Returns the sentence with another number in each hole."""
    names = list(dict.fromkeys(holes(pattern)))
    return pattern.format(**{name: f"-{8 + place}.25" for place, name in enumerate(names)})


def test_both_languages_have_the_same_holes() -> None:
    for english, chinese in sentences().items():
        assert holes(english) == holes(chinese), english
        assert len(set(holes(english))) == len(holes(english)), english


def test_each_pattern_is_met_and_not_hidden_by_another() -> None:
    assert len(patterns()) == len(sentences()) > 100
    for english, chinese in sentences().items():
        spoken = said(filled(english))
        assert isinstance(spoken, Text), english
        assert (spoken.en, spoken.zh) == (filled(english), filled(chinese))


def test_a_joint_with_the_name_of_a_word_keeps_it() -> None:
    spoken = said("joint roll is at its limit")
    assert isinstance(spoken, Text)
    assert spoken.zh == "关节 roll 到达限位"


def test_sentences_that_are_joined_are_taken_apart() -> None:
    sentence = "base_link touches the ground at 0.90 s; it fell over: tilt 180 deg, height 0.045 m"
    assert said(sentence) == Text(
        sentence, "base_link 在 0.90 s 时接触地面；它翻倒了：倾角 180°，高度 0.045 m"
    )


@pytest.mark.parametrize(
    "sentence",
    [
        "",
        "no such sentence",
        "it fell over; and nobody knows why",
        "<script>",
        "x" * 100_000,
        "{a}",
        "Newton steps, on all of the way from the stand.",
    ],
)
def test_what_is_not_known_stays_english(sentence: str) -> None:
    assert said(sentence) == Said(sentence)


def test_braces_in_names_are_no_holes() -> None:
    spoken = said("{0.__class__} touches the ground")
    assert isinstance(spoken, Text)
    assert spoken.zh == "{0.__class__} 接触地面"


@pytest.mark.parametrize("name", ["v3", "original"])
def test_what_is_noted_of_a_robot_is_in_both_languages(name: str) -> None:
    notes = (*load(name).notes, *pa.cross_check(load(name), configurations=1).notes)
    assert len(notes) > 2
    assert all(isinstance(said(note), Text) for note in notes), notes


@pytest.mark.parametrize("kp", [0.1, 1.0])
@pytest.mark.parametrize("feet", ["pinned", "sliding"])
def test_why_servos_do_not_carry_it_is_in_both_languages(kp: float, feet: str) -> None:
    robot = load("original")
    try:
        failures = pa.steady_state(robot, pa.solve_stand(robot), kp=kp, feet=feet).failures
    except pa.NoEquilibriumError as error:
        failures = (str(error),)
    assert failures
    assert all(isinstance(said(failure), Text) for failure in failures), failures


def test_falls_are_in_both_languages() -> None:
    robot = load("v3")
    weak = pa.verify_stand(
        robot, pa.solve_stand(robot), kp=0.5, kd=0.01, duration=2.0, feedforward=False
    )
    assert weak.failures
    assert all(isinstance(said(failure), Text) for failure in weak.failures), weak.failures
