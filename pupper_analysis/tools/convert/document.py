"""Document of a conversion: additions, losses, and the verification of the new file.

Input is a ``Conversion``. The document contains the verdict, the deviation from the source, the
simulated stand, the response to a small velocity disturbance, and what was not converted.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import filterfalse
from pathlib import Path

from pupper_analysis.base.diagnostics import Diagnostic, Quantity
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import text
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.robot.compare.differences import has_inverted_urdf_range
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.convert.model import Conversion


@build_document.register(Conversion)
def conversion_document(conversion: Conversion, _: Robot | None = None) -> doc.Document:
    """Create the report of a conversion: verdict of the checks, and what was not converted."""
    blocks = []
    if conversion.not_converted:
        left = tuple(map(doc.diagnostic_text, conversion.not_converted))
        blocks.append(doc.Lines(left, "warn", text("not-converted"), detail=True))
    return doc.Document(
        text("conversion"),
        _make_title(conversion),
        tuple(blocks),
        passed=conversion.passed,
        verdict=text(_get_verdict_key(conversion)),
        failures=tuple(map(doc.diagnostic_text, conversion.failures)),
        findings=tuple(_describe_checks(conversion)),
        details=tuple(_describe_recovery(conversion)),
        brief=True,
        notes=tuple(map(doc.diagnostic_text, filterfalse(_is_servo_note, conversion.notes))),
        next_step=_select_next_step(conversion),
    )


def _is_servo_note(note: Diagnostic) -> bool:
    """Return True for the note that servos or armature differ from the converted variant's MJCF."""
    return note.code in ("servos-of-variant-not-used", "armature-of-variant-not-used")


def _make_title(conversion: Conversion) -> doc.Text:
    """Return the names of source and new file, and what differs from the variant's own MJCF."""
    note = next(filter(_is_servo_note, conversion.notes), None)
    names = {
        "old": _format_file_name(conversion.source),
        "new": _format_file_name(conversion.output),
    }
    if not conversion.agree or note is None:
        return text("old-and-new", **names)
    servos = note.code == "servos-of-variant-not-used"
    armature = not servos or note.values["other_armature"]
    both = servos and armature
    return text(
        "old-and-new-except-servos",
        **names,
        both=both,
        servos=servos and not both,
        armature=armature and not both,
    )


def _select_next_step(conversion: Conversion) -> doc.NextStep:
    """Return the command to suggest next."""
    if has_inverted_urdf_range(conversion.comparison.differences):
        return doc.NextStep("audit", (conversion.source, "--fix"), robot_typed=False)
    if not conversion.agree:
        return doc.NextStep("crosscheck", (conversion.source, conversion.output), robot_typed=False)
    if not conversion.passed:
        return doc.NextStep("audit")
    command = "stand" if conversion.floating else "hold"
    # The new file is no xacro file.
    omitted = ("--xacro", "--xacro-arg")
    words = (conversion.output, *_list_variant_gains(conversion))
    return doc.NextStep(command, words, robot_typed=False, omitted=omitted)


def _list_variant_gains(conversion: Conversion) -> tuple[str, ...]:
    """Return the options for kp and kd of the variant's own MJCF, if its joints have equal gains.

    Empty if the servos do not differ from those of this MJCF.
    """
    note = next(filter(_is_servo_note, conversion.notes), None)
    spans = [] if note is None else [note.values.get("own_kp"), note.values.get("own_kd")]
    words: list[str] = []
    for name, span in zip(("--kp", "--kd"), spans, strict=False):
        if not isinstance(span, Diagnostic) or span.values["wide"]:
            return ()
        words += (name, f"{span.values['least']:.6g}")
    return tuple(words)


def _get_verdict_key(conversion: Conversion) -> str:
    """Return the key of the verdict in the catalogue of texts."""
    if not conversion.agree:
        return "disagree"
    if not conversion.passed:
        return "FAILED"
    return "agree"


def _format_file_name(path: str) -> doc.Name:
    """Return the file name of a path, without folders."""
    return doc.Name(Path(path).name)


def _describe_checks(conversion: Conversion) -> Iterable[doc.Words]:
    """Describe the deviation from the source, the simulated stand, and what was not converted."""
    compared = conversion.comparison
    count, run = len(compared.differences), conversion.verification
    # Line 2 states the servos, if there is a note about these; otherwise the stand.
    stands = (
        run is not None and run.passed and any(map(_is_servo_note, conversion.notes)) and not count
    )
    deviation = text(
        "differences-from-source-count",
        source=doc.Name(conversion.source),
        count=count,
        same=not count and not stands,
        stands=f"{run.duration:g}" if run is not None and stands else "",
        explained=count and conversion.agree,
        differs=count and not conversion.agree,
        worst=f"{max(compared.deviations.values()):.1e}",
        armature=any(loss.code == "armature-not-in-urdf" for loss in conversion.not_converted),
    )
    if repairs := len(conversion.repairs):
        deviation = text("near-repaired-inertials-count", near=deviation, count=repairs)
    yield deviation
    yield from map(doc.diagnostic_text, filter(_is_servo_note, conversion.notes))
    if run is not None:
        yield text(
            "stands-for-seconds" if run.passed else "does-not-stand-for-seconds",
            seconds=f"{run.duration:g}",
            height=f"{1e3 * run.base_height:.1f}",
            torque=f"{run.torque_error:.1e}",
            **_format_added_gains(conversion),
        ).with_mark("good" if run.passed else "bad")
    elif (gains := _format_added_gains(conversion))["kp"]:
        yield text("servos-added-in-short", **gains)
    if conversion.not_converted:
        first, *others = conversion.not_converted
        yield text("not-converted-in-short", first=doc.diagnostic_text(first), more=len(others))


def _format_added_gains(conversion: Conversion) -> dict[str, doc.Words | str]:
    """Return kp and kd of the added servos: with unit, as a number, and the unit; empty without.

    For example {"kp": "320 N m/rad", "kp_number": "320", "kp_unit": "N m/rad"}. The numbers of
    hinges and slides together have their units.
    """
    codes = ("servos-added", "servos-made")
    added = next((note for note in conversion.notes if note.code in codes), None)
    gains: dict[str, doc.Words | str] = {
        f"{gain}{part}": "" for gain in ("kp", "kd") for part in ("", "_number", "_unit")
    }
    for gain in ("kp", "kd") if added is not None else ():
        span = added.values[gain]  # type: ignore[union-attr]
        if isinstance(span, Diagnostic) and span.code == "spans":  # hinges and slides
            gains |= dict.fromkeys((gain, f"{gain}_number"), doc.diagnostic_text(span))
        elif isinstance(span, Diagnostic):
            low, high = span.values["least"], span.values["most"]
            wide = (
                f"..{high.value:.4g}" if span.values["wide"] and isinstance(high, Quantity) else ""
            )
            unit = str(high.unit) if isinstance(high, Quantity) else ""
            number = f"{low:.4g}{wide}"
            gains |= {gain: doc.diagnostic_text(span), f"{gain}_number": number}
            gains[f"{gain}_unit"] = unit
    return gains


MAX_REST_FRACTION = 0.01
"""Largest remaining speed (`Nudge.left`) at which the robot counts as at rest, divided by the speed
of the nudge (disturbance at the start) [1]. Dry friction can stop the motion even if the linear
model has a slowly decaying mode. Chosen, not tuned.
"""


def _describe_recovery(conversion: Conversion) -> Iterable[doc.Words]:
    """Describe the recovery of a new MJCF from a velocity disturbance (nudge) at its keyframe.

    The least damped mode should decay to 1/e within the simulated time t: 2 pi f z t >= 1, with
    damping ratio z and frequency f.
    """
    kept, run = conversion.kept, conversion.verification
    if kept is None or kept.failures or run is None or not run.passed:
        return
    least = kept.stability.least_damped
    if not least:
        return
    rate = 2 * math.pi * least.frequency * least.damping_ratio
    is_left = kept.nudge.left > MAX_REST_FRACTION * kept.nudge.speed
    if is_left and rate * kept.nudge.duration < 1:
        yield text(
            "nudge-outlasts-simulation",
            time=f"{1 / rate:.2g}" if rate > 0 else "inf",
            duration=f"{kept.nudge.duration:g}",
            damping=f"{least.damping_ratio:.2g}",
            frequency=f"{least.frequency:.2g}",
        ).with_mark("warn")
        return
    yield text(
        "forgets-a-nudge-of-speed",
        speed=f"{kept.nudge.speed:g}",
        damping=f"{least.damping_ratio:.2g}",
        frequency=f"{least.frequency:.2g}",
    ).with_mark("good")
