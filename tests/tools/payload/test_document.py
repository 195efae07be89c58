"""What a payload says."""

from __future__ import annotations

from pupper_analysis.tools.payload.document import payload_document
from tests.present.test_printed import printed
from tests.support.stubs import loaded


def test_motors_without_a_limit_are_named() -> None:
    text = " ".join(printed(payload_document(loaded("hip", "knee"))))
    assert "Motors without effort limit, which set no payload: 2 (hip, knee)." in text
    assert "Motors without" not in " ".join(printed(payload_document(loaded())))
