"""Errors: one family, each with what is wrong and what would be valid."""

import pickle

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


def test_errors_survive_pickling_and_say_where() -> None:
    error = pa.StaticsInfeasibleError(
        pa.errors.Infeasibility.FRICTION, "0.1", margin=0.02, friction_needed=0.3, feet=["FR"]
    )
    moved = error.at("at 0.50 s")
    assert type(moved) is type(error)
    assert (moved.where, error.where) == ("at 0.50 s", "")
    assert str(moved) == f"at 0.50 s: {error}"
    unreachable = pa.StanceUnreachableError("task", {"FR": 0.1}, {"knee": 1.0})
    for one in (error, moved, unreachable, pa.ConfigurationError("kp", "-1").at("there")):
        back = pickle.loads(pickle.dumps(one))
        assert type(back) is type(one)
        assert str(back) == str(one)
        assert vars(back) == vars(one)


def test_errors_carry_their_data() -> None:
    unknown = pa.UnknownNameError("v3", "foot", "tail", iter(["FR", "FL"]))
    assert (unknown.source, unknown.kind, unknown.name, unknown.known) == (
        "v3",
        "foot",
        "tail",
        ("FR", "FL"),
    )
    stance = pa.StanceUnreachableError("task", {"FR": 0.1}, {"knee": 1.0})
    assert (stance.shortfall, stance.at_limit) == ({"FR": 0.1}, {"knee": 1.0})
    statics = pa.StaticsInfeasibleError(
        pa.errors.Infeasibility.PULL, "x", margin=-0.1, feet=iter(["FR"])
    )
    assert (statics.margin, statics.friction_needed, statics.feet) == (-0.1, None, ("FR",))
    assert statics.reason == "a foot would have to pull"
