"""Document of a diff: effects of changes that are not evaluated."""

from __future__ import annotations

from pathlib import Path

import pytest

import pupper_analysis as pa
from pupper_analysis.present.document import FileFinding, get_english
from pupper_analysis.tools.diff.document import diff_document

MODEL = """<mujoco><worldbody><body name="base"><freejoint/><geom size="0.1"/>
  <body name="leg" pos="0 0 1"><joint name="hip"/><geom size="0.1"/>
    <body name="foot" pos="0 0 1"><joint name="knee"/><geom size="0.1"/></body></body>
</body></worldbody></mujoco>"""
"""MJCF of a base with two joints."""


@pytest.mark.parametrize(
    ("removed", "kind"), [("<freejoint/>", "type"), ('<joint name="knee"/>', "joint")]
)
def test_structural_changes_do_not_claim_to_be_without_effect(
    tmp_path: Path, removed: str, kind: str
) -> None:
    """A removed degree of freedom changes the mass matrix; `diff` does not evaluate this effect."""
    old, new = tmp_path / "old.xml", tmp_path / "new.xml"
    old.write_text(MODEL)
    new.write_text(MODEL.replace(removed, ""))
    diff = pa.diff_models(old, new)
    place = next(place for place, change in enumerate(diff.changes) if change.kind == kind)
    findings = [block for block in diff_document(diff).blocks if isinstance(block, FileFinding)]
    notes = [get_english(note) for note in findings[place].notes]
    assert notes == ["effect on the dynamics not evaluated"]
