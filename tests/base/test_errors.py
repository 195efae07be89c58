"""Errors of the package: one base class, messages with the defect and the valid alternatives."""

import pytest

import pupper_analysis as pa
from pupper_analysis.base import errors
from pupper_analysis.base.errors import StanceUnreachableError

ALL = [
    value
    for value in vars(errors).values()
    if isinstance(value, type) and issubclass(value, Exception)
]


@pytest.mark.parametrize("error", ALL)
def test_errors_have_one_base_class(error: type[Exception]) -> None:
    assert issubclass(error, pa.PupperAnalysisError)
    assert error.__doc__


def test_a_refusal_names_feet_with_an_error_above_a_thousandth_of_the_largest() -> None:
    """Of a foot with several contact points the largest error counts; a residual is not named."""
    shortfall = {"FL/0": 0.02, "FL/1": 0.03, "FR": 0.0301, "RL": 2e-5, "RR": 0.0}
    error = StanceUnreachableError("as if", shortfall, {})
    (missed,) = error.diagnostic.values["obstacles"]  # type: ignore[misc]
    feet = {one.subject.name: one.values["gap"].value for one in missed.values["feet"]}
    assert feet == {"FL": 0.03, "FR": 0.0301}


def test_unknown_name_of_many_lists_the_five_most_similar_names() -> None:
    """Reference: 43 names; five are listed, 38 are counted."""
    known = [f"link_{index:02d}" for index in range(40)] + ["panda_hand", "tool0", "left_finger"]
    error = pa.UnknownNameError("as if", "frame", "Panda_hnad", known)
    assert error.known == tuple(known)
    assert len(error.diagnostic.values["problem"].values["known"]) == 5  # type: ignore[union-attr]
    assert "the most similar names are: panda_hand, " in str(error)
    assert str(error).endswith(" and 38 more")
    assert "there are: a, b" in str(pa.UnknownNameError("as if", "frame", "c", ["a", "b"]))
