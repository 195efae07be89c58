"""What a payload says."""

from __future__ import annotations

from pupper_analysis.models.transmission import Drive, MadeServo
from pupper_analysis.robot.as_published import ServoSource, ServosUsed
from pupper_analysis.simulation.verdict import Asked, judge_stance
from pupper_analysis.tools.payload.document import payload_document
from tests.present.test_printed import printed
from tests.support.stubs import loaded, run


def test_limits_say_that_their_servos_were_made_up() -> None:
    """Of a robot without servos nobody stated what it can carry, or be pushed by."""
    made = MadeServo("knee", 320.0, 16.0, Drive.MOTOR)
    own = ServosUsed(ServoSource.ADDED, (320.0, 320.0), (16.0, 16.0), (made,))
    one = loaded()
    one.verdict = judge_stance(run(0.0, passed=True), None, own, asked=Asked.CARRIES)
    said = "on servos that were added to 1 joints: knee (in the file: torque motor) (kp 320 N m/rad"
    assert said in " ".join(printed(payload_document(one)))


def test_motors_without_a_limit_are_named() -> None:
    text = " ".join(printed(payload_document(loaded("hip", "knee"))))
    assert "Motors without effort limit, which set no payload: 2 (hip, knee)." in text
    assert "Motors without" not in " ".join(printed(payload_document(loaded())))
