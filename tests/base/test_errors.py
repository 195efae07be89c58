"""Errors: one family, each with what is wrong and what would be valid."""

import pytest

import pupper_analysis as pa
from pupper_analysis.base import errors

ALL = [
    value
    for value in vars(errors).values()
    if isinstance(value, type) and issubclass(value, Exception)
]


@pytest.mark.parametrize("error", ALL)
def test_errors_are_of_one_family(error: type[Exception]) -> None:
    assert issubclass(error, pa.PupperAnalysisError)
    assert error.__doc__


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (pa.UnknownNameError("v3", "foot", "tail", ["FR", "FL"]), ["v3", "foot 'tail'", "FR, FL"]),
        (pa.UnknownNameError("v3", "foot", "tail", []), ["there are: -"]),
        (
            pa.StanceUnreachableError("height 1 m", {"FR": 0.0123}, {"knee": -2.6}),
            ["height 1 m", "FR by 12.3 mm", "knee (-149.0 deg)"],
        ),
        (
            pa.StanceUnreachableError("height 1 m", {"FR/1": 0.001, "FR/2": 0.002, "x/y": 0.3}, {}),
            ["targets: FR by 2 mm, x/y by 300 mm."],
        ),
        (pa.NoStiffnessError("v3", 8192.0, "a foot slides"), ["v3", "8190", "a foot slides"]),
    ],
)
def test_message_says_it_all(error: Exception, words: list[str]) -> None:
    assert all(word in str(error) for word in words)
    with pytest.raises(pa.PupperAnalysisError):
        raise error
