"""Document of a workspace: text of an interval without length."""

from __future__ import annotations

from types import SimpleNamespace

from pupper_analysis.present.document import get_english
from pupper_analysis.tools.workspace.document import workspace_document
from tests.support.stubs import workspace


def test_height_without_range_is_not_printed_as_symmetric_about_zero() -> None:
    """Reference: an interval of heights from 0.0951 m to 0.0951 m, which does not contain 0."""
    result = workspace()
    result.intervals["height"] = SimpleNamespace(low=0.0951, high=0.0951)
    ranges = get_english(workspace_document(result).findings[0])
    assert "height 95.1 to 95.1 mm" in ranges
    assert "±95.1" not in ranges
