"""Task and ground values: the plane's heights in closed form, and refusals of invalid requests."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

import pupper_analysis as pa

angles = st.floats(0.0, 1.2)


@given(st.floats(0.01, 1.2), st.floats(-math.pi, math.pi))
def test_plane_rises_in_the_uphill_direction(slope: float, uphill: float) -> None:
    """Closed form: tan(slope) per metre uphill, and zero across."""
    ground = pa.Ground(slope, uphill)
    ahead = (math.cos(uphill), math.sin(uphill))
    aside = (-ahead[1], ahead[0])
    assert ground.height(ahead) == pytest.approx(math.tan(slope))
    assert ground.height(aside) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ({"offset": (0.0, 0.0), "com": (0.0, 0.0)}, "offset"),
        ({"feet": {"FL": (0, 0)}, "foot_offsets": {"FL": (0, 0)}}, "feet"),
        ({"com": "middle"}, "com"),
        ({"ik_seed": ["straight"]}, "ik_seed"),
    ],
)
def test_a_task_refuses_bad_requests(arguments: dict[str, object], named: str) -> None:
    with pytest.raises(pa.ConfigurationError, match=named):
        pa.StandTask(**arguments)  # type: ignore[arg-type]


def test_unknown_keyword_of_a_task_raises_type_error() -> None:
    with pytest.raises(TypeError, match="unexpected keyword argument 'wings'"):
        pa.StandTask(wings=2)  # type: ignore[call-arg]


@pytest.mark.parametrize("slope", [-0.1, math.pi / 2, math.nan, "steep"])
def test_a_ground_refuses_slopes_out_of_range(slope: object) -> None:
    with pytest.raises(pa.ConfigurationError, match="slope"):
        pa.Ground(slope=slope)  # type: ignore[arg-type]
