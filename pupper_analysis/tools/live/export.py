"""A page's stance for elsewhere: as a command, as a file of options, as a link."""

from __future__ import annotations

import json
import shlex
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
)


def write_command(source: LiveSource, state: State) -> str:
    """Returns the command that solves and simulates the same stand."""
    words = source.arguments(state.scales())
    return shlex.join(["pupper-analysis", "stand", *words, *_options(state)])


def hold_command(
    source: LiveSource, scales: Mapping[str, float], positions: Mapping[str, float]
) -> str:
    """Returns the command that holds a posture with the base fixed.

    Args:
        source: The robot.
        scales: Its own scales.
        positions: {joint: where it is (rad, m)}.
    """
    words = ["pupper-analysis", "hold", *source.arguments(scales)]
    return shlex.join([*words, *(f"--joints={n}={at:.6g}" for n, at in positions.items())])


def write_stance_file(state: State) -> str:
    """Returns the options of the same stance as TOML, for ``--stance``; without the robot's."""
    lines, tables = [], []
    for option, of, value in _typed_options(state):
        if of:
            tables.append(f"{option}.{json.dumps(of)} = {json.dumps(value)}")
        else:
            lines.append(f"{option} = {json.dumps(value)}")
    return "".join(f"{line}\n" for line in (*lines, *tables))


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


def write_link(address: str, state: State) -> str:
    """Returns the address of a page with the same state, of a server as a browser reaches it.

    What viser's page takes to be its server's address is, with a state behind it, what the server
    is asked for: so it learns what it is to show.

    Args:
        address: Host and port.
        state: The state.
    """
    asked = f"?websocket=ws://{address}/?state={quote(str(state), safe=':;,.%')}"
    return f"http://{address}/{asked if str(state) else ''}"
