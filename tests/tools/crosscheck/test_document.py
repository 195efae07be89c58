"""What is printed: the first cause first, groups, all of it when asked, and nothing cut off."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from pupper_analysis.robot.compare import mjcf_only as extras
from pupper_analysis.tools.crosscheck.document import (
    make_comparison_annotations,
)
from tests.support.printing import printed
from tests.support.robots import (
    changed,
    compared,
    mjcf_text,
    quadruped,
    urdf_text,
    write,
    write_parts,
)


def test_annotations_name_unmatched_and_guessed_joints(tmp_path: Path) -> None:
    urdf = changed(changed(quadruped(), "shank3", kind="fixed"), "thigh0", joint="lf_haa")
    comparison = compared(write_parts(tmp_path, urdf, quadruped()))
    found = {remark.title: remark for remark in make_comparison_annotations(comparison)}
    assert found["joint knee3"].level == "error"
    assert found["joint knee3"].message == f"joint knee3 is not in {comparison.urdf}"
    assert found["joint knee3"].place == comparison.mjcf
    assert found["guessed joints"].level == "warning"
    assert "lf_haa=hip0" in found["guessed joints"].message


def test_unexplained_deviation_is_the_verdict(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a difference to name, the verdict still is not AGREE, in every format."""
    monkeypatch.setattr(extras, "of_joints", lambda _: iter(()))
    text = mjcf_text(quadruped())
    text = text.replace('<joint name="hip0"', '<joint name="hip0" stiffness="20"')
    comparison = compared(write(tmp_path, urdf_text(quadruped()), text))
    first = printed(comparison).replace(" robot.urdf and robot.xml: ", ": ", 1)
    assert re.match(r"DISAGREE: \S+ of forward dynamics is left that no difference explains", first)
    (remark,) = (r for r in make_comparison_annotations(comparison) if r.title == "agreement")
    assert remark.level == "error"
    assert "no difference explains" in remark.message
