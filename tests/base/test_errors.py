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
