"""Robots of the configuration tests."""

from __future__ import annotations

import pytest

import pupper_analysis as pa
from tests.support.variants import NAMES, load


@pytest.fixture(scope="module", params=[*NAMES, "v3 fixed", "tiny"])
def any_robot(request: pytest.FixtureRequest, tiny: pa.Robot) -> pa.Robot:
    """Robots with a free and with a fixed base, and with a continuous joint."""
    if request.param == "tiny":
        return tiny
    return load(request.param.split()[0], fixed_base="fixed" in request.param)
