"""What a page says: the numbers of a stance as a table, in HTML that no name can become part of."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from html import escape
from typing import Any

import numpy as np

from pupper_analysis.analysis.robot import slides
from pupper_analysis.analysis.stance import Stance
from pupper_analysis.errors import PupperAnalysisError, StanceUnreachableError
from pupper_analysis.live.colour import BEYOND, SCALE, colour_of, css
from pupper_analysis.live.controls import slider_values
from pupper_analysis.live.door import without_folders
from pupper_analysis.live.language import Language
from pupper_analysis.live.model import Answer, Sag
from pupper_analysis.live.sliders import CONTROLS
from pupper_analysis.live.state import State
from pupper_analysis.report.formats import visible
from pupper_analysis.report.verdict import clauses
from pupper_analysis.simulation.push_trial import PushTrial
from pupper_analysis.simulation.verdict import Verdict, VerdictCode
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

PHONE = """<style>
.pa-page{display:none}
@media (max-width:36em){
.mantine-Paper-root:has(.pa-page){width:100% !important;max-height:55% !important}
.mantine-Paper-root:has(.pa-page) [style*="width: 20em"]{width:100% !important}
div:has(>.mantine-Paper-root .pa-page):not(:has([style*="display: none"] .pa-page))>div:has(canvas)
{height:45% !important}
.pa-page{display:block}
}
</style><div class="pa-page"></div>"""
"""Where viser has a sheet over the scene, as wide as a hand, the scene ends where it begins."""


def page(*parts: str) -> str:
    """Returns parts as one piece of a page."""
    return f'{STYLE}<div class="pa">{"".join(parts)}</div>'


def headed(text: str) -> str:
    """Returns a text as a heading."""
    return f"<h4>{said(text)}</h4>"


def line(text: str) -> str:
    """Returns a text as a line of its own."""
    return f"<div>{said(text)}</div>"


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
    return "" if robot is None else headed(f"{robot.name}, {robot.total_mass:.3f} kg")


def verdict(say: Language, answer: Answer, judged: Verdict | None) -> str:
    """Returns whether it stands, in one remark.

    Args:
        say: The language.
        answer: The stance.
        judged: Its verdict; None if it is out of reach, or not in balance.
    """
    if judged is not None:
        return ruling(say, judged)
    if answer.unreachable:
        return box("bad", say("out-of-reach"))
    refusal = answer.refusal
    return box("bad", "" if refusal is None else say.sentence(refusal.diagnostic))


def ruling(say: Language, judged: Verdict, more: str = "") -> str:
    """Returns a verdict as a remark."""
    good = judged.passed or judged.code is VerdictCode.IN_BALANCE
    told = [say.sentence(clause.told) for clause in clauses(judged)]
    return box("good" if good else "bad", "; ".join([*told, *([more] if more else [])]))


def numbers(say: Language, answer: Answer, sag: Sag | None, judged: Verdict | None) -> str:
    """Returns what a stance takes.

    Args:
        say: The language.
        answer: The stance.
        sag: Where it settles; None while that is worked out.
        judged: Its verdict.
    """
    robot, stand = answer.robot, answer.stand
    if robot is None:
        return page(verdict(say, answer, judged))
    parts = [title(answer), verdict(say, answer, judged)]
    if stand is not None:
        parts.append(_stance(say, stand, answer.statics))
    if stand is not None and answer.statics is not None:
        parts += [
            _sag(say, sag),
            _torques(say, answer, answer.statics),
            _forces(say, answer.statics),
        ]
    return page(*parts)


def brief(say: Language, answer: Answer, judged: Verdict | None) -> str:
    """Returns the verdict and which motor works hardest, in a line."""
    parts = [verdict(say, answer, judged)]
    if answer.statics is not None and judged is not None:
        statics = answer.statics
        shares = np.nan_to_num(statics.motor_utilisation, nan=0.0, posinf=0.0)
        if shares.any():
            hardest = int(np.argmax(shares))
            name, share = statics.joint_names[hardest], 100 * float(shares[hardest])
            parts = [ruling(say, judged, f"{name}: {share:.0f} %")]
    return f'<div class="pa-page">{page(*parts)}</div>'


def _stance(say: Language, stand: Stand, statics: GravityCompensation | None) -> str:
    known = [
        (say("height-of-the-base"), f"{1e3 * (stand.task.height or 0.0):.1f} mm"),
        (say("com-margin"), f"{1e3 * stand.com_margin:.1f} mm"),
    ]
    if stand.ground_clearance is not None:
        clearance = f"{1e3 * stand.ground_clearance.distance:.1f} mm"
        known.append((say("ground-clearance"), clearance))
    if stand.self_clearance is not None:
        clearance = f"{1e3 * stand.self_clearance.distance:.1f} mm"
        known.append((say("distance-between-links"), clearance))
    if statics is not None and statics.friction_utilisation:
        share = max(statics.friction_utilisation.values())
        known.append((say("friction-used"), f"{100 * share:.1f} %"))
    return rows(known)


def _sag(say: Language, sag: Sag | None) -> str:
    title = headed(say("predicted-sag-without-feed-forward"))
    if sag is None:
        return title + box("wait", say("being-worked-out"))
    if sag.settled is None:
        return title + box("bad", say.sentence(sag.unsettled))
    settled = sag.settled
    parts = [
        (say("loss-of-height"), f"{1e3 * settled.height_loss:.2f} mm"),
        (say("in-the-servos"), f"{1e3 * settled.servo_sag:.2f} mm"),
        (say("in-the-contacts"), f"{1e3 * settled.contact_sag:.2f} mm"),
    ]
    failures = "".join(box("bad", say.sentence(failure)) for failure in settled.failures)
    return title + rows(parts) + failures


def _torques(say: Language, answer: Answer, statics: GravityCompensation) -> str:
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
        colour = css(colour_of(share if limited else None))
        bar = f'<span class="bar" style="width:{width:.2f}em;background:{colour}"></span>'
        used = f"{100 * share:.1f} %" if limited else "-"
        body.append(
            f'<tr><td>{said(name)}</td><td class="n">{torque:+.4f}</td>'
            f'<td class="n">{used}</td><td style="width:4.6em">{bar}</td></tr>'
        )
    head = headed(say("motor-torques-n-m"))
    return f'{head}<table class="torques">{"".join(body)}</table>{_legend(say)}'


def _legend(say: Language) -> str:
    beyond = said(say("above"))
    stops = ",".join(f"{css(colour)} {100 * share:.0f}%" for share, colour in SCALE)
    return (
        f'<div class="scale" style="background:linear-gradient(90deg,{stops})"></div>'
        '<div style="display:flex;justify-content:space-between"><span>0</span>'
        f'<span>50 %</span><span>100 % <b style="color:{css(BEYOND)}">'
        f"■ {beyond}</b></span></div>"
    )


def _forces(say: Language, statics: GravityCompensation) -> str:
    body = [
        (foot, f"{np.linalg.norm(load.force):.2f} N") for foot, load in statics.foot_loads.items()
    ]
    return headed(say("contact-forces-title")) + rows(body)


def refusal(
    say: Language, answer: Answer, error: StanceUnreachableError | None, *, pending: bool
) -> str:
    """Returns why a stance is out of reach, and how far it could go.

    Args:
        say: The language.
        answer: What is out of reach.
        error: The explained refusal.
        pending: Whether it is not explained yet; ``error`` is None then.
    """
    head = title(answer)
    if pending:
        wait = say("explaining")
        return page(head, box("bad", say("out-of-reach")), box("wait", wait))
    if error is None:
        return page(head, box("good", say("it-is-in-reach-after")))
    missing = [(foot, f"{1e3 * gap:.1f} mm") for foot, gap in error.shortfall.items() if gap > 0]
    parts = [head, box("bad", say("out-of-reach"))]
    if error.possible:
        demands = say.either(say.demands(demand) for demand in error.possible)
        parts.append(headed(say("in-the-way-demands", demands=demands)))
        parts.append(line(say("possible-with-all-else")))
        parts += [line(f"• {_possible(say, answer.state, one)}") for one in error.limits.values()]
    if missing:
        parts += [headed(say("feet-miss-their-places")), rows(missing)]
    if error.at_limit:
        parts += [headed(say("joints-at-a-limit")), line(_at_limits(answer, error.at_limit))]
    parts += [line(say.sentence(str(text))) for text in error.blocked]
    if error.nearest is not None:
        parts += [headed(say("the-ghost-the-nearest-stance")),
                  line(say.task(error.nearest.task))]  # fmt: skip
    return page(*parts)


def _possible(say: Language, state: State, fields: Mapping[str, Any]) -> str:
    """Returns how far fields of a task can go, as their sliders say it."""
    task = replace(state.task(), **fields)
    feet = dict.fromkeys((*task.foot_offsets, *task.swing, *task.ground.heights)) or {"": None}
    told = {
        f"{CONTROLS[name].label(say.code)}"
        f"{f' {foot}' if CONTROLS[name].field.per_foot else ''}: {value:g}": None
        for foot in feet
        for name, value in slider_values(state, task, fields, foot).items()
    }
    return ", ".join(told)


def _at_limits(answer: Answer, joints: Mapping[str, float]) -> str:
    """Returns joints with the limits that they are at: in degrees, or mm of those that slide."""
    assert answer.robot is not None
    robot = answer.robot
    return ", ".join(
        f"{name} ({1e3 * limit:+.1f} mm)"
        if slides(robot, name)
        else f"{name} ({math.degrees(limit):+.1f}°)"
        for name, limit in joints.items()
    )


def simulation(say: Language, stance: Stance, *, feedforward: bool) -> str:
    """Returns what MuJoCo made of a stance, beside the prediction.

    Args:
        say: The language.
        stance: What was simulated.
        feedforward: Which of its simulations is told.
    """
    report = stance.verification if feedforward else stance.sagging
    if feedforward:
        title = "simulation-with-feed-forward"
        expected = (stance.sunk or stance.stand).qpos[2]
    else:
        title = "simulation-without-feed-forward"
        expected = None if stance.settled is None else stance.settled.base_height
    parts = [headed(say(title, time=f"{report.duration:.0f}")), ruling(say, stance.verdict)]
    table = [
        (
            say("base-at-predicted"),
            "-" if expected is None else f"{1e3 * float(expected):.2f} mm",
        ),
        (say("base-at-simulated"), f"{1e3 * report.base_height:.2f} mm"),
        (say("its-change-at-the-end"), f"{1e3 * report.height_drift:+.3f} mm/s"),
        (say("largest-joint-error"), f"{report.joint_error:.1e} rad"),
    ]
    if report.feedforward:
        of = say("share-of-the-largest", share=f"{100 * report.torque_error:.2f}")
        table.append((say("torque-error"), of))
        table.append((say("foot-force-error"), f"{100 * report.force_error:.2f} %"))
    return page(*parts, rows(table), line(say("orange-as-simulated")))


def push(say: Language, trial: PushTrial) -> str:
    """Returns what came of a push."""
    title = say(
        "pushed-with",
        impulse=f"{trial.impulse:.2f}",
        direction=f"{math.degrees(trial.direction):.0f}",
    )
    parts = [
        headed(title),
        box("good", say("it-recovers"))
        if trial.failure is None
        else box("bad", say.sentence(trial.failure)),
        rows([(say("change-of-velocity"), f"{trial.velocity_step:.2f} m/s")]),
        line(say("orange-as-simulated")),
    ]
    return page(*parts)


def failure(say: Language, error: PupperAnalysisError) -> str:
    """Returns why something could not be done."""
    return page(box("bad", say.sentence(error.diagnostic)))


def unforeseen(say: Language, error: Exception) -> str:
    """Returns that something went wrong that should not."""
    what = without_folders(f"{type(error).__name__}: {error}".rstrip(": "))
    return page(box("bad", say("unforeseen", what=what)))


def waiting(text: str) -> str:
    """Returns that something is under way."""
    return page(box("wait", text))


def nothing(text: str) -> str:
    """Returns a hint where there is no result."""
    return page(line(text))
