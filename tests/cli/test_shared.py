"""Lengths and angles on the command line, with and without their units."""

from __future__ import annotations

import math

import pytest

from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.cli.shared import (
    parse_packages,
    parse_point,
    parse_quantity,
    parse_xacro_args,
)
from tests.support.commands import run_command


@pytest.mark.parametrize(
    ("kind", "text", "value"),
    [
        ("length", "0.2", 0.2),
        ("length", "20mm", 0.02),
        ("length", "2 cm", 0.02),
        ("length", "-0.2m", -0.2),
        ("length", "1e-2m", 0.01),
        ("angle", "0.2", 0.2),
        ("angle", "0.2rad", 0.2),
        ("angle", "-90deg", -math.pi / 2),
    ],
)
def test_a_quantity_has_a_number_and_a_unit(kind: str, text: str, value: float) -> None:
    assert parse_quantity(kind, text) == pytest.approx(value, rel=1e-15)


def test_a_point_has_two_quantities() -> None:
    assert parse_point("offset", "1cm,-2mm") == pytest.approx((0.01, -0.002))


def test_only_the_first_separator_of_a_xacro_argument_is_replaced() -> None:
    texts = ("arm:=true", "mode=a", "remap=old:=new", "pair:=x:=y")
    expected = {"arm": "true", "mode": "a", "remap": "old:=new", "pair": "x:=y"}
    assert parse_xacro_args(texts) == expected


@pytest.mark.parametrize(
    ("kind", "text"), [("length", "3deg"), ("angle", "3m"), ("length", "m"), ("angle", "5 degrees")]
)
def test_a_quantity_with_another_unit_is_refused(kind: str, text: str) -> None:
    with pytest.raises(ValueError, match="could not convert"):
        parse_quantity(kind, text)


@pytest.mark.parametrize(
    "words",
    [
        ("heat", "v3", "--motor", "a" * 300),
        ("diff", "a" * 300, "b.urdf"),
        ("contract", "v3", "a" * 300),
        ("check", "a" * 300),
        ("stand", "v3", "--payload-at", "1", "1" * 300),
        ("stand", "v3", "\N{EN DASH}" + "1" * 300),
    ],
    ids=lambda words: words[0],
)
def test_a_word_that_is_too_long_for_a_file_is_refused_as_another_word(
    words: tuple[str, ...], capfd: pytest.CaptureFixture[str]
) -> None:
    """The operating system refuses to search for a file with such a name."""
    status, _, errors = run_command(capfd, *words)
    assert status == 2
    assert errors.startswith("error: ")
    assert "unexpected" not in errors


def test_a_package_with_a_folder_name_that_is_too_long_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="package"):
        parse_packages((f"a={'a' * 300}",))


def test_unknown_option_suggests_the_option_with_its_words(
    capfd: pytest.CaptureFixture[str],
) -> None:
    for typed, meant in (("--at", "'--payload-at'"), ("--clearance", "'--ground-clearance'")):
        assert meant in run_command(capfd, "stand", "v3", typed, "1")[2]
    assert "'--height'" in run_command(capfd, "stand", "v3", "--heigth", "1")[2]
    assert "Did you mean" not in run_command(capfd, "convert", "a.urdf", "--kp", "1")[2]
