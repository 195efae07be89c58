"""Documents of payload limits."""

from __future__ import annotations

from pupper_analysis.tools.payload.document import payload_document
from tests.present.test_printed import print_words
from tests.support.stubs import make_payload_result


def test_motors_without_a_limit_are_named() -> None:
    text = " ".join(print_words(payload_document(make_payload_result("hip", "knee"))))
    assert text.startswith("UNKNOWN stub")
    said = "Motors whose torque limit no file states, which these bounds leave out: 2 (hip, knee)."
    assert said in text
    assert "all else allows 1.23 kg, with which the motors must give up to 2 N m (knee)" in text
    assert "Motors whose" not in " ".join(print_words(payload_document(make_payload_result())))
