"""Each field of a stance on the page: state, sliders, and the exported file."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from pupper_analysis import cli
from pupper_analysis.cli.stance_fields import OPTION_FIELDS, make_task
from pupper_analysis.stance.fields import Field
from pupper_analysis.tools.live.controls import (
    CONTROL_BY_NAME,
    choose_slider_step,
    make_slider_ranges,
    round_up_slider_end,
)
from pupper_analysis.tools.live.state import State, write_stance_file
from tests.stance.test_fields import ON_PAGE, SLIDING, choose_value, is_near
from tests.support.variants import load


def state_with(field: Field) -> State:
    one = ON_PAGE[field.kind]
    place = "offset" if field.name == "offset" else "centre"
    return State(place, **{field.name: {"FL": one} if field.per else one})


@pytest.mark.parametrize("field", SLIDING.values(), ids=SLIDING)
def test_each_field_is_in_a_pages_state(field: Field) -> None:
    state = state_with(field)
    assert is_near(state.task().values()[field.name], choose_value(field))
    assert state != State()
    assert state.with_task(state.task()) == state


@pytest.mark.parametrize("field", SLIDING.values(), ids=SLIDING)
def test_each_field_has_sliders_with_words_and_a_range(field: Field) -> None:
    own = {name: control for name, control in CONTROL_BY_NAME.items() if control.field is field}
    if field.per == "joint":
        assert not own  # they are the robot's: live.joints
        return
    assert len(own) == max(1, len(field.axes))
    ranges = make_slider_ranges(load("v3"))
    for name, control in own.items():
        span = ranges[name]
        assert span.low <= span.value <= span.high
        assert span.low < span.high
        assert 0 < span.step < span.high - span.low
        for language in ("en", "zh"):
            assert control.label(language).endswith(("(mm)", "(°)", "(mm, °)"))
            assert control.hint(language)
        assert re.search("[\u4e00-\u9fff]", control.label("zh") + control.hint("zh"))


@pytest.mark.parametrize("field", SLIDING.values(), ids=SLIDING)
def test_each_field_is_in_the_file_that_is_saved(field: Field, tmp_path: Path) -> None:
    file = tmp_path / "stance.toml"
    file.write_text(write_stance_file(state_with(field)))
    words = ["--stance", str(file)]
    context = cli.find_command("stand").make_context("stand", words)
    typed = make_task({name: context.params[name] for name in OPTION_FIELDS})
    assert is_near(typed.values()[field.name], choose_value(field))


def test_slider_steps_and_ends_are_round_numbers() -> None:
    """By hand: a range of 100 has steps of 0.5; 131 is rounded up to 150."""
    assert choose_slider_step(100.0) == 0.5
    assert round_up_slider_end(131.0) == 150.0
    assert round_up_slider_end(0.031) == 0.04
