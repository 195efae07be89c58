"""What documents of stands have in common: the robot as it was loaded, its servos, the ground."""

from __future__ import annotations

from collections.abc import Iterable

from pupper_analysis.diagnostics import grouped
from pupper_analysis.report.document import Said, Text, Words
from pupper_analysis.report.documents.sources import files
from pupper_analysis.report.verdict import clause_text, of_the_file, on_servos
from pupper_analysis.report.words import text
from pupper_analysis.robot.as_published import ServosUsed
from pupper_analysis.robot.robot import Robot


def robot_notes(robot: Robot | None) -> tuple[Words, ...]:
    """Returns a robot's files, what was assumed of it, and what its MJCF does by itself."""
    return () if robot is None else (files(robot), *assumptions(robot))


def assumptions(robot: Robot) -> tuple[Words, ...]:
    """Returns what was assumed when a robot was loaded, and what its MJCF does by itself."""
    return (*map(clause_text, of_the_file(robot)), *map(Said, grouped(robot.notes)))


def ground_text(depths: Iterable[float]) -> Text:
    """Says on which ground it was simulated, of feet that sink in by ``depths`` (m), or do not."""
    deepest = max(depths, default=0.0)
    if not deepest:
        return text("feet-sunk-into-mujocos-soft")
    return text(
        "all-this-is-on-mujocos",
        depth=f"{1e3 * deepest:.2f}",
    )


def made_up(servos: ServosUsed) -> tuple[Text, ...]:
    """Says that a limit rests on servos that were made up; nothing where the file has them."""
    return (clause_text(on_servos(servos, good=True)),) if servos.made else ()
