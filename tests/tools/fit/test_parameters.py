"""Prior knowledge of parameters: parsing of typed values, and the parameters that a prior
concerns.
"""

from __future__ import annotations

import math

import pytest

from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.tools.fit.parameters import (
    PARAMETER_KINDS,
    Prior,
    apply_priors,
    parse_prior,
)


@pytest.mark.parametrize(
    ("text", "prior"),
    [
        ("mass=50%", Prior("mass", "*", share=0.5)),
        ("mass:leg_*=100g", Prior("mass", "leg_*", width=0.1)),
        ("com:base=5mm", Prior("com", "base", width=0.005)),
        ("offset=2 deg", Prior("offset", "*", width=math.radians(2))),
        ("offset=0.1", Prior("offset", "*", width=0.1)),
        ("kp=0", Prior("kp", "*", width=0.0)),
        ("kp:knee=0.5N m/rad", Prior("kp", "knee", width=0.5)),
        ("delay=3ms", Prior("delay", "*", width=0.003)),
        ("com=1e-3m", Prior("com", "*", width=0.001)),
    ],
)
def test_a_prior_is_read_in_its_unit(text: str, prior: Prior) -> None:
    found = parse_prior(text)
    assert (found.kind, found.subject) == (prior.kind, prior.subject)
    assert found.compute_std(3.0) == pytest.approx(prior.compute_std(3.0))


@pytest.mark.parametrize(
    "text",
    ["mass", "mass=", "weight=3", "mass=-1", "mass=nan", "mass=1e300kg", "mass=3deg", "com=3kg"],
)
def test_invalid_prior_is_refused(text: str) -> None:
    with pytest.raises(ConfigurationError):
        parse_prior(text)


def test_last_matching_prior_counts_and_unmatched_prior_is_refused() -> None:
    stated = [("mass", "base", "", 2.0), ("mass", "calf", "", 0.1), ("kp", "knee", "", 5.0)]
    priors = [parse_prior(text) for text in ("mass=10%", "mass:calf=50g", "kp=0")]
    found = apply_priors(stated, priors)
    assert [(parameter.name, parameter.width) for parameter in found] == [
        ("mass base", pytest.approx(0.2)),
        ("mass calf", pytest.approx(0.05)),
    ]
    with pytest.raises(ConfigurationError, match="tail"):
        apply_priors(stated, [parse_prior("mass:tail=1g")])


def test_share_of_a_stated_value_of_zero_is_refused_with_an_absolute_prior() -> None:
    """The prior in the message is accepted, and has the default standard deviation."""
    stated = [("load", "scale", "", 0.0), ("com", "base", "x", 0.1), ("com", "base", "y", 0.0)]
    for given in ("load=50%", "com=20%"):
        with pytest.raises(ConfigurationError, match="absolute standard deviation") as caught:
            apply_priors(stated, [parse_prior(given)])
        typed = str(caught.value).partition("for example ")[2].partition(",")[0]
        prior = parse_prior(typed)
        assert prior.width == PARAMETER_KINDS[prior.kind].width
        priors = [parse_prior(given), prior]
        assert len(apply_priors(stated, priors)) == 3
    assert [prior.name for prior in apply_priors(stated, [parse_prior("com=0%")])] == ["load scale"]


def test_prior_of_a_subject_with_brackets_concerns_this_subject() -> None:
    stated = [("kp", "arm[0]", "", 5.0), ("kp", "arm0", "", 5.0)]
    parameters = apply_priors(stated, [parse_prior("kp=1"), parse_prior("kp:arm[0]=2")])
    assert {parameter.subject: parameter.width for parameter in parameters} == {
        "arm[0]": 2.0,
        "arm0": 1.0,
    }
