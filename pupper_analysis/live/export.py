"""A page's stance for elsewhere: as Python, as a command, as JSON, as CSV, as a link."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator, Mapping
from typing import Any
from urllib.parse import quote

from pupper_analysis.live.model import Answer, Sag
from pupper_analysis.live.source import Source, spoken
from pupper_analysis.live.state import State, metres, plain
from pupper_analysis.results import to_json

PROGRAM = "pupper-analysis"

_SCRIPT = """\
import math

import pupper_analysis as pa

robot = {robot}
task = pa.StandTask({task})
stand = pa.held_stand(robot, task)  # on MuJoCo's ground, which is soft
statics = pa.stand_statics(robot, stand)
for joint, torque in zip(robot.joint_names, statics.joint_torques):
    print(f"{{joint:24}} {{torque:+.4f}} N m")
print(f"com margin {{1e3 * stand.com_margin:.1f}} mm")

try:
    settled = pa.steady_state(robot, stand{kp})  # without feed-forward
    print(f"sags by {{1e3 * settled.height_loss:.2f}} mm")
except pa.NoEquilibriumError as error:
    print(error)
report = pa.verify_stand(robot, stand{gains})  # in MuJoCo
print("verified" if report.passed else report.failures)
"""


def python(source: Source, state: State) -> str:
    """Returns a script that makes the same stand."""
    robot = source.python(state.scales())
    if state.payload:
        robot = f"pa.with_payload({robot}, {state.payload!r}, {state.payload_point()!r})"
    kp = "" if state.kp is None else f", kp={state.kp!r}"
    kd = "" if state.kd is None else f", kd={state.kd!r}"
    text = _SCRIPT.format(robot=robot, task=_task(state), kp=kp, gains=kp + kd)
    return text if "math." in text else text.removeprefix("import math\n\n")


def _task(state: State) -> str:
    """Returns the arguments of a ``StandTask``: those that are not the usual ones."""
    parts = [f"{name}={_PYTHON[kind](value)}" for name, kind, value in _asked(state)]
    if state.moves:
        moves = {foot: (metres(x), metres(y)) for foot, (x, y) in state.moves.items()}
        parts.append(f"foot_offsets={moves!r}")
    if state.lifts:
        parts.append(f"swing={_heights(state.lifts)!r}")
    ground = [
        f"{name}={_angle(value)}" for name in ("slope", "uphill") if (value := getattr(state, name))
    ]
    if state.steps:
        ground.append(f"heights={_heights(state.steps)!r}")
    if ground:
        parts.append(f"ground=pa.Ground({', '.join(ground)})")
    return ", ".join(parts)


def _heights(feet: Mapping[str, float]) -> dict[str, float]:
    return {foot: metres(height) for foot, height in feet.items()}


def _asked(state: State) -> Iterator[tuple[str, str, Any]]:
    """Yields what is asked of base and com: its name, kind and value; nothing that is usual."""
    if state.height is not None:
        yield "height", "length", state.height
    for name in ("roll", "pitch", "yaw"):
        if value := getattr(state, name):
            yield name, "angle", value
    if state.place == "offset":
        yield "offset", "point", state.offset
    if state.place == "inside":
        yield "com", "word", "inside"
    if state.joint_margin:
        yield "joint_margin", "angle", state.joint_margin
    for name in ("com_margin", "ground_clearance", "self_clearance"):
        if value := getattr(state, name):
            yield name, "length", value


def _angle(degrees: float) -> str:
    return f"math.radians({plain(degrees)})"


def command(source: Source, state: State) -> str:
    """Returns the command that solves and simulates the same stand."""
    return spoken([PROGRAM, "stand", *source.arguments(state.scales()), *_options(state)])


def live_command(source: Source, state: State, language: str = "en") -> str:
    """Returns the command that opens a page with the same state."""
    words = [PROGRAM, "live", *source.arguments({})]
    words += [] if language == "en" else ["--language", language]
    return spoken([*words, "--state", str(state)] if str(state) else words)


def _options(state: State) -> list[str]:
    """Returns what the command line's options of stance, payload and servos say."""
    words = [
        f"--{name.replace('_', '-')}={_TYPED[kind](value)}" for name, kind, value in _asked(state)
    ]
    words += [f"--move={foot}={_point(move)}" for foot, move in state.moves.items()]
    words += [f"--swing={foot}={height!r}" for foot, height in _heights(state.lifts).items()]
    words += [f"--step={foot}={height!r}" for foot, height in _heights(state.steps).items()]
    for name in ("slope", "uphill"):
        if value := getattr(state, name):
            words.append(f"--{name}={_TYPED['angle'](value)}")
    if state.payload:
        words += [f"--payload={state.payload!r}", f"--payload-at={_point(state.payload_at)}"]
    for name in ("kp", "kd"):
        if (value := getattr(state, name)) is not None:
            words.append(f"--{name}={value!r}")
    return words


def _point(point: tuple[float, ...]) -> str:
    return ",".join(repr(metres(number)) for number in point)


_PYTHON: Mapping[str, Callable[[Any], str]] = {
    "length": lambda value: repr(metres(value)),
    "angle": _angle,
    "point": lambda point: repr(tuple(map(metres, point))),
    "word": repr,
}
"""How Python says a value of each kind."""

_TYPED: Mapping[str, Callable[[Any], str]] = {
    "length": lambda value: repr(metres(value)),
    "angle": lambda degrees: f"{plain(degrees)}deg",
    "point": _point,
    "word": str,
}
"""How one types it."""


def json(source: Source, answer: Answer, sag: Sag | None) -> str:
    """Returns all that is known of a stance."""
    content: dict[str, Any] = {
        "robot": source.python(answer.state.scales()),
        "state": str(answer.state),
        "task": answer.task,
        "stand": answer.stand,
        "statics": answer.statics,
        "settled": sag.settled if sag else None,
        "refusal": str(answer.refusal) if answer.refusal else None,
    }
    return to_json(content) + "\n"


def table(answer: Answer) -> str:
    """Returns the joints as CSV: angles (rad), torques and limits (N m), utilisation."""
    assert answer.robot is not None
    assert answer.stand is not None
    assert answer.statics is not None
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["joint", "position_rad", "torque_nm", "limit_nm", "utilisation"])
    rows = zip(
        answer.robot.joint_names,
        answer.stand.joint_positions(answer.robot).tolist(),
        answer.statics.joint_torques.tolist(),
        answer.robot.effort_limits.tolist(),
        answer.statics.motor_utilisation.tolist(),
        strict=True,
    )
    writer.writerows(rows)
    return text.getvalue()


def link(address: str, state: State, language: str = "en") -> str:
    """Returns the address of a page with the same state, of a server as a browser reaches it.

    What viser's page takes to be its server's address is, with a state behind it, what the server
    is asked for: so it learns what it is to show.

    Args:
        address: Host and port.
        state: The state.
        language: In which it opens.
    """
    asked = f"state={quote(str(state), safe=':;,.%')}"
    if language != "en":
        asked += f"%26language={language}"  # of the server's address, not of the page's
    elif not str(state):
        return f"http://{address}/"
    return f"http://{address}/?websocket=ws://{address}/?{asked}"
