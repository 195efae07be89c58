"""Task and ground values: the plane's heights in closed form, and refusals of invalid requests."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import pupper_analysis as pa
from tests.support.variants import load

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


@given(st.floats(0.0, 1.2), st.floats(-math.pi, math.pi), st.floats(-1, 1), st.floats(-1, 1))
def test_centre_of_a_sphere_is_a_radius_above_the_plane_or_step(
    slope: float, uphill: float, x: float, y: float
) -> None:
    """The plane contains the origin; the step is 0.05 m above the plane, along z."""
    ground = pa.Ground(slope, uphill, {"FL": 0.05})
    normal = ground.normal()
    assert np.linalg.norm(normal) == pytest.approx(1.0)
    for foot, step in (("FR", 0.0), ("FL", 0.05 * math.cos(slope))):
        centre = ground.centre(foot, (x, y), 0.02)
        assert normal @ centre == pytest.approx(0.02 + step, abs=1e-12)
        np.testing.assert_array_equal(centre[:2], (x, y))


def test_ground_is_level_without_slope_and_steps() -> None:
    assert pa.Ground().is_level
    assert pa.Ground(uphill=1.0, heights={"FL": 0.0}).is_level
    assert not pa.Ground(slope=0.1).is_level
    assert not pa.Ground(heights={"FL": 0.01}).is_level


def test_offset_is_refused_beside_a_position_of_the_com() -> None:
    assert pa.StandTask(offset=(0.01, 0.0), com="centre").com == "centre"
    for com in ("inside", (0.0, 0.0)):
        with pytest.raises(pa.ConfigurationError, match="not both"):
            pa.StandTask(offset=(0.01, 0.0), com=com)


def test_contact_that_exerts_a_force_is_refused_at_a_lifted_foot() -> None:
    """A lifted foot with a plane is above the plane, and bears no load."""
    plane = pa.Slope(0.1)
    assert pa.StandTask(swing={"FR": 0.02}, contacts={"FR": pa.Contact(plane)}).swing == {
        "FR": 0.02
    }
    for contact, word in (
        (pa.Weld(), "weld"),
        (pa.Contact(plane, force=5.0), "force"),
        (pa.Contact(plane, grip=5.0), "grip"),
    ):
        with pytest.raises(pa.ConfigurationError, match=f"FR is lifted .* has a {word}"):
            pa.StandTask(swing={"FR": 0.02}, contacts={"FR": contact})
        pa.StandTask(swing={"FL": 0.02}, contacts={"FR": contact})


@pytest.mark.parametrize(
    ("values", "hint"),
    [
        ({"height": 120}, "for millimetres write height 0.12."),
        ({"height": 1200}, "(for millimetres write 1.2)"),
        ({"swing": {"FL": 20}}, "for millimetres write swing[FL] 0.02."),
        ({"foot_offsets": {"FL": (20, 0)}}, "for millimetres write foot_offsets[FL] (0.02, 0)."),
        ({"ground": pa.Ground(heights={"FL": 20})}, "for millimetres write heights[FL] 0.02."),
        ({"self_clearance": 5}, "for millimetres write self_clearance 0.005."),
        ({"com_margin": 10}, "(for millimetres write 0.01)"),
        ({"com": (10, 0)}, "(for millimetres write (0.01, 0))"),
        ({"pitch": 5}, "(for degrees write math.radians(5))"),
        ({"joint_margin": 5}, "(for degrees write math.radians(5))"),
    ],
)
def test_number_that_is_probably_in_mm_or_degrees_is_suggested_in_si_units(
    values: dict[str, Any], hint: str
) -> None:
    """The bounds are those above which the command line requires a unit."""
    with pytest.raises(pa.PupperAnalysisError) as caught:
        pa.solve_stand(load("v3"), pa.StandTask(**values))
    assert hint in str(caught.value)


@pytest.mark.parametrize("height", [0.5, 4.9])
def test_unreachable_height_that_may_be_in_m_has_no_suggestion(height: float) -> None:
    with pytest.raises(pa.StanceUnreachableError) as caught:
        pa.solve_stand(load("v3"), pa.StandTask(height=height))
    assert "millimetres" not in str(caught.value)
