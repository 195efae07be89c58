"""A page's stance for elsewhere: as Python, as a command, as a file of options, as a link."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any
from urllib.parse import quote

from pupper_analysis.stance.fields import Field
from pupper_analysis.tools.live.state import (
    SHOWN,
    LiveSource,
    State,
    format_number,
    in_si,
    quote_words,
)

PROGRAM = "pupper-analysis"

_SCRIPT = """\
import math

import pupper_analysis as pa

robot = {robot}
task = pa.StandTask({task})
stand = pa.stance.solve_stand_as_simulated(robot, task)  # on MuJoCo's ground, which is soft
statics = pa.stance.stand_statics(robot, stand)
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


def write_python(source: LiveSource, state: State) -> str:
    """Returns a script that makes the same stand."""
    robot = source.python(state.scales())
    if state.payload:
        robot = f"pa.robot.with_payload({robot}, {state.payload!r}, {state.payload_point()!r})"
    kp = "" if state.kp is None else f", kp={state.kp!r}"
    kd = "" if state.kd is None else f", kd={state.kd!r}"
    text = _SCRIPT.format(robot=robot, task=_task(state), kp=kp, gains=kp + kd)
    return text if "math." in text else text.removeprefix("import math\n\n")


def _task(state: State) -> str:
    """Returns the arguments of a ``StandTask``: those that are not the usual ones."""
    parts: dict[str, list[str]] = {"task": [], "ground": []}
    for field, value in state.asked():
        parts[field.part].append(f"{field.name}={_python(field, value)}")
    ground = [f"ground=pa.Ground({', '.join(parts['ground'])})"] if parts["ground"] else []
    return ", ".join([*parts["task"], *ground])


def _python(field: Field, value: Any) -> str:
    """Returns a value of a page as Python has it."""
    if field.kind == "angle" and not isinstance(value, dict):
        return f"math.radians({format_number(value)})"
    if field.kind == "angle":
        return (
            "{" + ", ".join(f"{foot!r}: {_python(field, one)}" for foot, one in value.items()) + "}"
        )
    return repr(in_si(field, value))


def write_command(source: LiveSource, state: State) -> str:
    """Returns the command that solves and simulates the same stand."""
    return quote_words([PROGRAM, "stand", *source.arguments(state.scales()), *_options(state)])


def hold_command(
    source: LiveSource, scales: Mapping[str, float], positions: Mapping[str, float]
) -> str:
    """Returns the command that holds a posture with the base fixed.

    Args:
        source: The robot.
        scales: Its own scales.
        positions: {joint: where it is (rad, m)}.
    """
    words = [PROGRAM, "hold", *source.arguments(scales)]
    return quote_words([*words, *(f"--joints={n}={at:.6g}" for n, at in positions.items())])


def write_stance_file(state: State) -> str:
    """Returns the options of the same stance as TOML, for ``--stance``; without the robot's."""
    lines, tables = [], []
    for option, of, value in _typed_options(state):
        if of:
            tables.append(f"{option}.{json.dumps(of)} = {json.dumps(value)}")
        else:
            lines.append(f"{option} = {json.dumps(value)}")
    return "".join(f"{line}\n" for line in (*lines, *tables))


def live_command(source: LiveSource, state: State, language: str = "en") -> str:
    """Returns the command that opens a page with the same state."""
    words = [PROGRAM, "live", *source.arguments({})]
    words += [] if language == "en" else ["--language", language]
    return quote_words([*words, "--stance", str(state)] if str(state) else words)


def _options(state: State) -> list[str]:
    """Returns what the command line's options of stance, payload and servos say."""
    return [
        f"--{option}={of}={value}" if of else f"--{option}={value}"
        for option, of, value in _typed_options(state)
    ]


def _typed_options(state: State) -> Iterator[tuple[str, str, str]]:
    """Yields options of stance, payload and servos, of which foot, and how one types the value."""
    for field, value in state.asked():
        for of, one in value.items() if field.per else [("", value)]:
            yield field.option, of, _typed(field, one)
    for name in ("payload", "payload_at", "kp", "kd"):
        value = getattr(state, name)
        if value is not None and (state.payload or not name.startswith("payload")):
            yield SHOWN[name].option, "", _typed(SHOWN[name], value)


def _typed(field: Field, value: Any) -> str:
    """Returns how one types a value of a page."""
    if field.kind == "angle":
        return f"{format_number(value)}deg"
    if isinstance(value, tuple):
        return ",".join(p if isinstance(p, str) else repr(p) for p in in_si(field, value))
    return value if isinstance(value, str) else repr(in_si(field, value))


def write_link(address: str, state: State, language: str = "en") -> str:
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
