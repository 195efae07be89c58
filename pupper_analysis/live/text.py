"""What a page says: the numbers of a stance as a table, in HTML that no name can become part of."""

from __future__ import annotations

import math
from collections.abc import Iterable
from html import escape

import numpy as np

from pupper_analysis.errors import PupperAnalysisError, StanceUnreachableError
from pupper_analysis.live.colour import BEYOND, SCALE, colour_of, css
from pupper_analysis.live.model import Answer, Sag
from pupper_analysis.report.formats import visible
from pupper_analysis.simulation.push_trial import PushTrial
from pupper_analysis.simulation.verify import StandVerification
from pupper_analysis.stance.stand import Stand
from pupper_analysis.statics.equilibrium import GravityCompensation

STYLE = """<style>
.pa{font:13px/1.45 system-ui,sans-serif;padding:0 .9em .6em;overflow-wrap:anywhere}
.pa table{border-collapse:collapse;width:100%;margin:.35em 0 .7em}
.pa td,.pa th{padding:.1em .35em .1em 0;text-align:left;font-weight:400;vertical-align:top}
.pa th{opacity:.72}
.pa td.n{text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap}
.pa h4{margin:.7em 0 .1em;font-size:13px;font-weight:650}
.pa .good,.pa .bad,.pa .wait{border-left:4px solid;padding:.25em .6em;margin:.4em 0}
.pa .good{border-color:#1e8c46}.pa .bad{border-color:#c81e28}.pa .wait{border-color:#e0a020}
.pa .bar{display:inline-block;height:.62em;border-radius:2px;vertical-align:baseline}
.pa .scale{display:flex;height:.6em;border-radius:2px;margin:.2em 0 0}
</style>"""


def page(*parts: str) -> str:
    """Returns parts as one piece of a page."""
    return f'{STYLE}<div class="pa">{"".join(parts)}</div>'


def said(text: str) -> str:
    """Returns a text as it is shown: nothing in it acts."""
    return escape(visible(text))


def box(kind: str, text: str) -> str:
    """Returns a remark: ``good``, ``bad`` or ``wait``."""
    return f'<div class="{kind}">{said(text)}</div>'


def rows(values: Iterable[tuple[str, str]]) -> str:
    """Returns names and values as a table."""
    body = "".join(
        f'<tr><th>{said(name)}</th><td class="n">{said(value)}</td></tr>' for name, value in values
    )
    return f"<table>{body}</table>"


def title(answer: Answer) -> str:
    """Returns which robot it is, and its mass."""
    robot = answer.robot
    return "" if robot is None else f"<h4>{said(robot.name)}, {robot.total_mass:.3f} kg</h4>"


def verdict(answer: Answer) -> str:
    """Returns whether it stands, in one remark."""
    if answer.refusal is None:
        return box("good", "It stands, in balance.")
    if answer.unreachable:
        return box("bad", "Out of reach.")
    return box("bad", str(answer.refusal))


def numbers(answer: Answer, sag: Sag | None) -> str:
    """Returns what a stance takes.

    Args:
        answer: The stance.
        sag: Where it settles; None while that is worked out.
    """
    robot, stand = answer.robot, answer.stand
    if robot is None:
        return page(verdict(answer))
    parts = [title(answer), verdict(answer)]
    if stand is not None:
        parts.append(_stance(stand, answer.statics))
    if stand is not None and answer.statics is not None:
        parts += [
            _sag(sag),
            _torques(answer, answer.statics),
            _forces(answer.statics),
        ]
    return page(*parts)


def _stance(stand: Stand, statics: GravityCompensation | None) -> str:
    known = [
        ("height of the base", f"{1e3 * (stand.task.height or 0.0):.1f} mm"),
        ("com margin", f"{1e3 * stand.com_margin:.1f} mm"),
    ]
    if stand.ground_clearance is not None:
        known.append(("ground clearance", f"{1e3 * stand.ground_clearance.distance:.1f} mm"))
    if statics is not None and statics.friction_utilisation:
        share = max(statics.friction_utilisation.values())
        known.append(("friction used", f"{100 * share:.1f} %"))
    return rows(known)


def _sag(sag: Sag | None) -> str:
    title = "<h4>Predicted sag, without feed-forward</h4>"
    if sag is None:
        return title + box("wait", "being worked out …")
    if sag.settled is None:
        return title + box("bad", sag.unsettled)
    settled = sag.settled
    parts = [
        ("loss of height", f"{1e3 * settled.height_loss:.2f} mm"),
        ("in the servos", f"{1e3 * settled.servo_sag:.2f} mm"),
        ("in the contacts", f"{1e3 * settled.contact_sag:.2f} mm"),
    ]
    return title + rows(parts) + "".join(box("bad", failure) for failure in settled.failures)


def _torques(answer: Answer, statics: GravityCompensation) -> str:
    assert answer.robot is not None
    body = []
    for name, torque, share, limit in zip(
        statics.joint_names,
        statics.joint_torques.tolist(),
        statics.motor_utilisation.tolist(),
        answer.robot.effort_limits.tolist(),
        strict=True,
    ):
        limited = math.isfinite(limit) and limit > 0
        width = min(1.0, share) * 4.5 if limited else 0.0
        colour = css(colour_of(share, limit))
        bar = f'<span class="bar" style="width:{width:.2f}em;background:{colour}"></span>'
        used = f"{100 * share:.1f} %" if limited else "-"
        body.append(
            f'<tr><td>{said(name)}</td><td class="n">{torque:+.4f}</td>'
            f'<td class="n">{used}</td><td style="width:4.6em">{bar}</td></tr>'
        )
    head = "<h4>Motor torques (N m), and parts of their limits</h4>"
    return f'{head}<table class="torques">{"".join(body)}</table>{_legend()}'


def _legend() -> str:
    stops = ",".join(f"{css(colour)} {100 * share:.0f}%" for share, colour in SCALE)
    return (
        f'<div class="scale" style="background:linear-gradient(90deg,{stops})"></div>'
        '<div style="display:flex;justify-content:space-between"><span>0</span>'
        f'<span>50 %</span><span>100 % <b style="color:{css(BEYOND)}">■ above</b></span></div>'
    )


def _forces(statics: GravityCompensation) -> str:
    body = [
        (foot, f"{np.linalg.norm(load.force):.2f} N") for foot, load in statics.foot_loads.items()
    ]
    return "<h4>Contact forces</h4>" + rows(body)


def refusal(answer: Answer, error: StanceUnreachableError | None, *, pending: bool) -> str:
    """Returns why a stance is out of reach, and how far it could go.

    Args:
        answer: What is out of reach.
        error: The explained refusal.
        pending: Whether it is not explained yet; ``error`` is None then.
    """
    head = title(answer)
    if pending:
        wait = "finding out what is in the way, and how far it can go …"
        return page(head, box("bad", "Out of reach."), box("wait", wait))
    if error is None:
        return page(head, box("good", "It is in reach after all."))
    missing = [(foot, f"{1e3 * gap:.1f} mm") for foot, gap in error.shortfall.items() if gap > 0]
    parts = [head, box("bad", "Out of reach.")]
    if error.possible:
        demands = " or ".join(error.possible)
        parts.append(f"<h4>In the way: {said(demands)}</h4>")
        parts.append("<div>Possible with all else as asked:</div>")
        parts += [f"<div>• {said(text)}</div>" for text in error.possible.values()]
    if missing:
        parts += ["<h4>Feet miss their places by</h4>", rows(missing)]
    if error.at_limit:
        names = ", ".join(f"{name} ({limit:+.2f} rad)" for name, limit in error.at_limit.items())
        parts += ["<h4>Joints at a limit</h4>", f"<div>{said(names)}</div>"]
    parts += [f"<div>{said(text)}</div>" for text in error.blocked]
    if error.nearest is not None:
        parts += ["<h4>The ghost: the nearest stance in reach</h4>",
                  f"<div>{said(str(error.nearest.task))}</div>"]  # fmt: skip
    return page(*parts)


def simulation(report: StandVerification, held: Stand, sag: Sag | None) -> str:
    """Returns what MuJoCo made of a stance, beside the prediction.

    Args:
        report: The simulation.
        held: The stand that was simulated.
        sag: Where it settles without feed-forward, by prediction.
    """
    kind = "with" if report.feedforward else "without"
    good = "verified: as predicted" if report.feedforward else "it stands"
    parts = [
        f"<h4>MuJoCo, {report.duration:.0f} s {kind} feed-forward</h4>",
        box("good", good) if report.passed else box("bad", "; ".join(report.failures)),
    ]
    expected = held.qpos[2] if report.feedforward else None
    if not report.feedforward and sag is not None and sag.settled is not None:
        expected = sag.settled.base_height
    table = [
        ("base at, predicted", "-" if expected is None else f"{1e3 * float(expected):.2f} mm"),
        ("base at, simulated", f"{1e3 * report.base_height:.2f} mm"),
        ("its change at the end", f"{1e3 * report.height_drift:+.3f} mm/s"),
        ("largest joint error", f"{report.joint_error:.1e} rad"),
    ]
    if report.feedforward:
        table.append(("torque error", f"{100 * report.torque_error:.2f} % of the largest"))
        table.append(("foot force error", f"{100 * report.force_error:.2f} %"))
    return page(*parts, rows(table), "<div>Orange: as simulated.</div>")


def push(trial: PushTrial) -> str:
    """Returns what came of a push."""
    direction = math.degrees(trial.direction)
    parts = [
        f"<h4>Pushed with {trial.impulse:.2f} N s towards {direction:.0f}°</h4>",
        box("good", "it recovers") if trial.recovered else box("bad", trial.failure),
        rows([("change of velocity", f"{trial.velocity_step:.2f} m/s")]),
        "<div>Orange: as simulated.</div>",
    ]
    return page(*parts)


def failure(error: PupperAnalysisError) -> str:
    """Returns why something could not be done."""
    return page(box("bad", str(error)))


def unforeseen(error: Exception) -> str:
    """Returns that something went wrong that should not."""
    what = f"{type(error).__name__}: {error}".rstrip(": ")
    return page(box("bad", f"unforeseen: {what}. This is a bug: please report it."))


def waiting(text: str) -> str:
    """Returns that something is under way."""
    return page(box("wait", text))


def nothing(text: str) -> str:
    """Returns a hint where there is no result."""
    return page(f"<div>{said(text)}</div>")
