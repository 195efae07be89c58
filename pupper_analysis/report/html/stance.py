"""The sections of a stance, of pushes, and of a path: how a robot stands, and for how long."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from pupper_analysis.analysis.path import PathThere
from pupper_analysis.analysis.push import PushedStance
from pupper_analysis.analysis.stance import Stance
from pupper_analysis.report.html import document as doc
from pupper_analysis.report.html import plots
from pupper_analysis.report.html.loads import load_blocks, proof, view_block
from pupper_analysis.report.html.scene import Motion
from pupper_analysis.report.html.sentences import said
from pupper_analysis.report.html.simulated import height_plot, motions_of, run_rows
from pupper_analysis.report.html.sources import page, source_of
from pupper_analysis.report.html.tasks import task_text
from pupper_analysis.report.html.verdict import verdict_lines, verdict_word
from pupper_analysis.report.html.words import text
from pupper_analysis.report.verdict import on_servos
from pupper_analysis.robot.as_published import ServosUsed
from pupper_analysis.robot.robot import Robot


def stance_section(stance: Stance, robot: Robot | None) -> doc.Section:
    """Returns a stance, what it costs, and whether it holds."""
    run = stance.verification
    blocks: list[doc.Block] = []
    if not stance.passed:
        lines = verdict_lines(stance.verdict)
        blocks.append(doc.Lines(lines, "bad", text("What failed")))
    blocks.append(view_block(robot, stance.sunk or stance.stand, stance.statics, motions_of([run])))
    blocks.append(doc.Lines((task_text(stance.stand.task), *source_of(robot), *_told(stance))))
    blocks += load_blocks(
        stance.statics,
        stance.minimum_peak,
        run,
        stance.limits.tolist(),
        {doc.Column(text("position"), "rad"): stance.joint_positions.tolist()},
    )
    blocks.append(
        doc.Table(
            text("MuJoCo, {seconds} s on the floating base", seconds=f"{run.duration:g}"),
            (
                doc.Column(text("quantity"), left=True),
                doc.Column(text("with feed-forward")),
                doc.Column(text("unit"), left=True),
            ),
            run_rows([run]),
            (),
            (page("stances.md", "What the simulation says"), proof(run)),
        )
    )
    blocks.append(height_plot([run], float((stance.sunk or stance.stand).qpos[2])))
    return doc.Section(
        doc.Name(stance.name),
        tuple(blocks),
        stance.passed,
        verdict_word(stance.verdict),
        (task_text(stance.stand.task), *verdict_lines(stance.verdict), *_told(stance)),
    )


def _told(stance: Stance) -> Iterable[doc.Words]:
    settled = stance.settled
    if settled is None:
        yield text("Without feed-forward, no sag is predicted:")
        yield said(stance.unsettled)
    else:
        yield text(
            "Without feed-forward it settles at {height} m: servos give {servo} mm, the ground "
            "{contact} mm.",
            height=f"{settled.base_height:.5f}",
            servo=f"{1e3 * settled.servo_sag:.2f}",
            contact=f"{1e3 * settled.contact_sag:.2f}",
        )
        yield from map(said, settled.failures)
    if stance.minimum_stiffness is not None:
        yield text(
            "Minimum stiffness of servos that carry it without feed-forward: {kp} N m/rad",
            kp=f"{stance.minimum_stiffness:.2f}",
        )
    near, links = stance.stand.ground_clearance, stance.stand.self_clearance
    if near is not None:
        yield text(
            "Lowest part but the feet: {link}, {distance} mm",
            link=doc.Name(near.links[0]),
            distance=f"{1e3 * near.distance:.1f}",
        )
    if links is not None:
        yield text(
            "Nearest links: {links}, {distance} mm apart",
            links=doc.Name(" / ".join(links.links)),
            distance=f"{1e3 * links.distance:.1f}",
        )
    if stance.loops_open is not None:
        yield text(
            "The MJCF's loops and couplings are open in it by up to {most} m or rad, as their "
            "softness has it.",
            most=f"{stance.loops_open:.2g}",
        )
    if stance.sunk is None:
        yield text(
            "Feet sunk into MuJoCo's soft ground would be out of reach: simulated with "
            "joints for rigid ground."
        )


def push_section(pushed: PushedStance, robot: Robot | None) -> doc.Section:
    """Returns how hard a stance can be pushed, each way."""
    recovery = pushed.recovery
    rows: list[tuple[doc.Cell, ...]] = [
        (
            doc.number(math.degrees(angle), ".0f"),
            doc.number(recovery.impulses[index], ".2f"),
            doc.number(recovery.velocity_steps[index], ".3f"),
            doc.number(recovery.tipping_estimate[index], ".2f"),
            said(recovery.failures[index]),
        )
        for index, angle in enumerate(recovery.directions)
    ]
    weakest = text(
        "Weakest at {direction}°: {impulse} N s, {speed} m/s of its {mass} kg; then:",
        direction=f"{math.degrees(recovery.weakest_direction):.0f}",
        impulse=f"{recovery.weakest_impulse:.2f}",
        speed=f"{recovery.weakest_impulse / recovery.mass:.2f}",
        mass=f"{recovery.mass:.2f}",
    )
    if recovery.unpushed:
        weakest = text("It does not stand, so it withstands no push.")
    table = doc.Table(
        text("Largest push that the stand survives"),
        (
            doc.Column(text("direction"), "°"),
            doc.Column(text("impulse"), "N s"),
            doc.Column(text("step of velocity"), "m/s"),
            doc.Column(text("a rigid robot tips at"), "N s"),
            doc.Column(text("how it fails then"), left=True),
        ),
        tuple(rows),
        (text("Directions about the vertical, of the base: forward 0°, left 90°."),),
        (
            text(
                "Each is found by simulations in MuJoCo ({count} in all), of {seconds} s each; a "
                "push of {resolution} N s more fails.",
                count=recovery.rollouts,
                seconds=f"{recovery.duration:g}",
                resolution=f"{recovery.resolution:g}",
            ),
        ),
    )
    return doc.Section(
        doc.Name(pushed.name),
        (
            view_block(robot, pushed.stand, None),
            doc.Lines((task_text(pushed.stand.task), *source_of(robot))),
            table,
            push_plot([pushed]),
        ),
        pushed.passed,
        text("LASTS") if pushed.passed else text("FAILS"),
        (
            *(() if pushed.passed else verdict_lines(pushed.verdict)),
            weakest,
            *(() if recovery.unpushed else (said(recovery.weakest_failure),)),
            *(_made_up(pushed.verdict.servos) if pushed.passed else ()),
        ),
    )


def _made_up(servos: ServosUsed) -> Iterable[doc.Words]:
    """Says that a limit rests on servos that were made up."""
    if servos.made:
        clause = on_servos(servos, good=True)
        yield text(clause.sentence, **clause.values)


def push_plot(pushes: Sequence[PushedStance]) -> doc.Plot:
    """Draws the largest pushes by direction, of one robot or several."""
    return plots.direction_plot(
        text("Largest push that the stand survives, from above: forward is up"),
        plots.Axis(text("impulse"), "N s", ".2f"),
        [
            plots.Series(doc.Name(one.name), one.recovery.directions, one.recovery.impulses)
            for one in pushes
        ],
    )


def push_table(pushes: Sequence[PushedStance]) -> doc.Table:
    """Returns the largest pushes of several robots, with the same directions, side by side."""
    directions = pushes[0].recovery.directions
    rows: list[tuple[doc.Cell, ...]] = [
        (
            doc.number(math.degrees(angle), ".0f"),
            *(doc.number(one.recovery.impulses[index], ".2f") for one in pushes),
        )
        for index, angle in enumerate(directions)
    ]
    return doc.Table(
        text("Largest push that the stand survives"),
        (
            doc.Column(text("direction"), "°"),
            *(doc.Column(doc.Name(one.name), "N s") for one in pushes),
        ),
        tuple(rows),
        (text("Directions about the vertical, of the base: forward 0°, left 90°."),),
    )


def _least_time(there: PathThere) -> tuple[tuple[str, str, float, str], ...]:
    """Returns the rows of a path's least time, if it was asked for."""
    if there.lower_bound is None:
        return ()
    return (
        ("least time", "s", float(there.path.time[-1]), ".3f"),
        ("least time if the acceleration could jump", "s", there.lower_bound, ".3f"),
    )


def path_section(there: PathThere, robot: Robot | None) -> doc.Section:
    """Returns the path to a stance, which its view steps through, and how it is followed."""
    path, tracking = there.path, there.tracking
    time = plots.Axis(text("time"), "s", ".2f")
    feet = [
        plots.Series(doc.Name(foot), path.time, path.loads[:, index])
        for index, foot in enumerate(path.feet)
    ]
    quantities = (
        *_least_time(there),
        ("greatest torque of motors in motion", "%", 100 * path.peak_utilisation, ".1f"),
        ("greatest speed of joints", "%", 100 * path.peak_speed_utilisation, ".1f"),
        ("least com margin", "mm", 1e3 * float(path.com_margin.min()), ".1f"),
        ("least margin of the zero-moment point", "mm", 1e3 * float(path.zmp_margin.min()), ".1f"),
        ("in MuJoCo: torque error, of the largest", "%", 100 * tracking.torque_error, ".1f"),
        ("in MuJoCo: joint error", "rad", tracking.joint_error, ".3f"),
        ("in MuJoCo: error of height", "mm", 1e3 * tracking.height_error, ".1f"),
    )
    table = doc.Table(
        text("The path, and how it is followed"),
        (
            doc.Column(text("quantity"), left=True),
            doc.Column(text("value")),
            doc.Column(text("unit"), left=True),
        ),
        tuple(
            (text(name), doc.number(value, form), doc.Name(unit))
            for name, unit, value, form in quantities
        ),
    )
    blocks: list[doc.Block] = [
        doc.Lines((task_text(there.stand.task), *source_of(robot))),
        table,
        plots.line_plot(
            text("Height of the base along the path"),
            time,
            plots.Axis(text("base height"), "mm", ".2f"),
            [plots.Series(text("base height"), path.time, 1e3 * path.qpos[:, 2])],
        ),
        plots.line_plot(
            text("Load of the feet along the path"),
            time,
            plots.Axis(text("load"), "N", ".2f"),
            feet,
        ),
    ]
    motion = Motion(text("the path"), path.time, path.qpos)
    blocks.insert(0, view_block(robot, there.stand, None, [motion]))
    if tracking.failures:
        blocks.insert(0, doc.Lines(tuple(map(said, tracking.failures)), "bad", text("What failed")))
    return doc.Section(
        doc.Name(there.name),
        tuple(blocks),
        there.passed,
        text("TRACKED") if there.passed else text("FAILED"),
        (
            task_text(there.stand.task),
            *map(said, tracking.failures),
            *_made_up(there.servos),
        ),
    )
