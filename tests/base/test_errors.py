"""Errors of the package: one base class, messages with the defect and the valid alternatives."""

import pickle

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
    feet = {value.subject.name: value.values["gap"].value for value in missed.values["feet"]}
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


def test_short_message_about_an_unknown_name_fits_into_a_line() -> None:
    """Reference: names of Pupper's joints; the similarity differs by one missing letter."""
    known = [f"leg_{side}_{number}" for side in ("front_r", "front_l") for number in (1, 2, 3)]
    error = pa.UnknownNameError("v3", "joint", "leg_frnt_l_1", known)
    assert error.correction == "leg_front_l_1"
    assert error.diagnostic.short == (
        "v3: no joint 'leg_frnt_l_1'; most similar: leg_front_l_1, leg_front_r_1 and 4 more"
    )
    feet = pa.UnknownNameError("v3", "foot", "XX", ["FR", "FL"])
    assert (feet.diagnostic.short, feet.correction) == (str(feet), "")


@pytest.mark.parametrize(
    ("unknown", "first"),
    [
        ("FR_foot", ["FR_foot_collision", "FR"]),
        ("fr", ["FR_foot_collision", "FR_calf", "FR"]),
        ("base", ["trunk"]),
        ("pelvis", ["trunk"]),
        ("trnk", ["trunk"]),
    ],
)
def test_names_with_the_same_words_come_before_similar_names(
    unknown: str, first: list[str]
) -> None:
    """Reference: names of a Go1. By edit distance, ``FR_calf`` is nearest to ``FR_foot``."""
    legs = [
        f"{leg}{part}"
        for leg in ("FL", "FR", "RR", "RL")
        for part in ("_foot_collision", "_calf", "", "_thigh", "_hip")
    ]
    known = ["imu", "head", *legs, "trunk"]
    error = pa.UnknownNameError("as if", "link", unknown, known, base="trunk")
    listed = error.diagnostic.values["problem"].values["known"]  # type: ignore[union-attr]
    assert list(listed)[: len(first)] == first  # type: ignore[arg-type]
    assert len(listed) == 5  # type: ignore[arg-type]
    feet = [name for name in known if name.endswith("collision")]
    assert "there are: FR_foot_collision, FL_" in str(pa.UnknownNameError("", "foot", "FR", feet))


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (
            pa.VariantError("name", "v4", "known variants: v3"),
            ["name", "'v4'", "known variants: v3"],
        ),
        (pa.ModelError("a/b.xml", "no joint x"), ["a/b.xml", "no joint x"]),
        (pa.UnknownNameError("v3", "foot", "tail", ["FR", "FL"]), ["v3", "foot 'tail'", "FR, FL"]),
        (pa.UnknownNameError("v3", "foot", "tail", []), ["there are: none"]),
        (pa.ConfigurationError("kp", "-1 is negative"), ["kp", "-1 is negative"]),
        (
            StanceUnreachableError("height 1 m", {"FR": 0.0123}, {"knee": -2.6}),
            ["height 1 m", "FR by 12.3 mm", "knee (-149.0 deg)"],
        ),
        (
            StanceUnreachableError("height 1 m", {"FR/1": 0.001, "FR/2": 0.002, "x/y": 0.3}, {}),
            ["targets: FR by 2 mm, x/y by 300 mm"],
        ),
        (
            pa.StaticsInfeasibleError(
                errors.Infeasibility.FRICTION,
                "0.1, and 0.3 is needed",
                margin=0.02,
                friction_needed=0.3,
            ),
            ["no static balance", "friction too low", "0.3 is needed"],
        ),
        (pa.NoEquilibriumError(0.86, "it ends there"), ["no equilibrium", "it ends there"]),
        (
            pa.NoStiffnessError("v3", 8192.0, "a foot slides"),
            ["v3", "8190 N m/rad", "a foot slides"],
        ),
        (pa.NotSettlingError(1e-6, "the depths do not settle"), ["the depths do not settle"]),
    ],
)
def test_message_contains_each_argument_of_the_error(error: Exception, words: list[str]) -> None:
    """Reference: the arguments, lengths in mm and angles in degrees (-2.6 rad = -149.0 deg)."""
    assert [word for word in words if word not in str(error)] == []


def test_errors_have_their_arguments_as_attributes() -> None:
    unknown = pa.UnknownNameError("v3", "foot", "tail", iter(["FR", "FL"]))
    assert (unknown.source, unknown.kind, unknown.name) == ("v3", "foot", "tail")
    assert unknown.known == ("FR", "FL")
    stance = StanceUnreachableError("task", {"FR": 0.1}, {"knee": 1.0})
    assert (stance.shortfall, stance.at_limit) == ({"FR": 0.1}, {"knee": 1.0})
    reason = errors.Infeasibility.PULL
    statics = pa.StaticsInfeasibleError(reason, "x", margin=-0.1, feet=iter(["FR"]))
    assert (statics.margin, statics.friction_needed, statics.feet) == (-0.1, None, ("FR",))
    assert statics.reason == "a foot would have to pull"


def test_error_with_location_keeps_its_type_and_starts_with_the_place() -> None:
    error = pa.StaticsInfeasibleError(
        errors.Infeasibility.FRICTION, "0.1", margin=0.02, friction_needed=0.3, feet=["FR"]
    )
    located = error.with_location("at 0.50 s")
    assert type(located) is type(error)
    assert (located.where, error.where) == ("at 0.50 s", "")
    assert str(located) == f"at 0.50 s: {error}"
    assert (located.margin, located.feet) == (error.margin, error.feet)
    back = pickle.loads(pickle.dumps(located))
    assert str(back) == str(located)
    assert vars(back) == vars(located)
