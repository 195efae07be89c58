"""Robots with the contacts of a task, without a solved stand."""

from __future__ import annotations

import pytest

import pupper_analysis as pa
from pupper_analysis.robot.touching import with_contacts
from tests.support.arm import arm
from tests.support.variants import load


@pytest.mark.parametrize("grip", [None, 60.0])
@pytest.mark.parametrize("kind", ["free", "fixed"])
def test_contact_of_the_base_other_than_a_weld_is_refused(kind: str, grip: float | None) -> None:
    """A grip permits rotation about a contact point, which the base does not have."""
    robot = load("v3") if kind == "free" else arm()
    contact = pa.Contact(pa.Plane((0, 0, 0), (0, 0, 1)), grip=grip)
    with pytest.raises(pa.ConfigurationError, match="base is fixed to the base"):
        with_contacts(robot, {"base": contact})
