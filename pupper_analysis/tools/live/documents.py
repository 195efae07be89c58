"""Documents of the panels of a page, independent of the language.

`render` converts documents to HTML.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.base.errors import PupperAnalysisError, StanceUnreachableError
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import text
from pupper_analysis.present.documents.loads import contact_table, torque_table
from pupper_analysis.present.documents.standing import (
    SAG_QUANTITIES,
    quantity_columns,
    run_rows,
    simulated_table,
    stand_table,
    task_text,
)
from pupper_analysis.present.verdict import clause_text, verdict_clauses
from pupper_analysis.simulation.verdict import Verdict, VerdictCode
from pupper_analysis.stance.sag.steady_state import SteadyState
from pupper_analysis.tools.live.access import strip_folders
from pupper_analysis.tools.live.model import Answer
from pupper_analysis.tools.push.bench import PushTrial
from pupper_analysis.tools.push.document import trial_document
from pupper_analysis.tools.stand.stance import Stance

NO_TITLE = doc.Name("")
"""Empty title, for example of a document without robot."""


def live_stance_document(
    answer: Answer, sag: SteadyState | Diagnostic | None, judged: Verdict | None
) -> doc.Document:
    """Create the report of a stance for the live page: stand, sag, torques and contact forces.

    ``sag`` is the predicted equilibrium, or the reason why there is none; None until computed.
    ``judged`` is the predicted or simulated verdict.
    """
    robot, stand, statics = answer.robot, answer.stand, answer.statics
    blocks: list[doc.Block] = []
    if robot is not None and stand is not None:
        blocks.append(stand_table(stand, statics))
        if statics is not None:
            blocks += _make_sag_blocks(sag)
            blocks += [torque_table(statics, robot.effort_limits.tolist()), contact_table(statics)]
    messages: tuple[doc.Words, ...] = ()
    if judged is not None:
        messages = tuple(map(clause_text, verdict_clauses(judged)))
    elif answer.unreachable:
        messages = (text("out-of-reach"),)
    elif answer.refusal is not None:
        messages = (doc.diagnostic_text(answer.refusal.diagnostic),)
    passed = judged is not None and (judged.passed or judged.code is VerdictCode.IN_BALANCE)
    return doc.Document(
        text("stance"), _make_robot_title(answer), tuple(blocks), passed=passed, findings=messages
    )


def _make_robot_title(answer: Answer) -> doc.Name:
    """Return the title of a document: name and mass [kg] of the robot; empty without a robot."""
    robot = answer.robot
    return (
        NO_TITLE
        if robot is None
        else doc.Name(f"{robot.name}, {doc.format_widened(robot.total_mass, '.3f')} kg")
    )


def _make_sag_blocks(sag: SteadyState | Diagnostic | None) -> Iterable[doc.Block]:
    """Yield the table of the predicted sag of the servos, or the reason for no equilibrium.

    While the prediction runs, ``sag`` is None, and a waiting message is yielded.
    """
    title = text("predicted-sag-without-feed-forward")
    if sag is None:
        yield doc.Lines((text("being-worked-out"),), "warn", title)
    elif isinstance(sag, Diagnostic):
        yield doc.Lines((doc.diagnostic_text(sag),), "bad", title)
    else:
        yield doc.Table(title, quantity_columns(), run_rows([sag], SAG_QUANTITIES))
        if sag.failures:
            yield doc.Lines(tuple(map(doc.diagnostic_text, sag.failures)), "bad")


def refusal_document(
    answer: Answer, error: StanceUnreachableError | None, *, pending: bool
) -> doc.Document:
    """Create the report of a stance that is out of reach, with the reason, for the live page.

    ``pending`` is True while ``error`` is computed. Afterwards, ``error`` is None if the slower
    computation has found the stance to be reachable.
    """
    blocks: list[doc.Block] = []
    message: doc.Words = text("out-of-reach")
    if pending:
        blocks.append(doc.Lines((text("explaining"),), "warn"))
    elif error is None:
        message = text("it-is-in-reach-after")
    else:
        message = doc.diagnostic_text(error.diagnostic)
        if error.nearest is not None:
            title = text("the-ghost-the-nearest-stance")
            blocks.append(doc.Lines((task_text(error.nearest.task),), title=title))
    passed = not pending and error is None
    return doc.Document(
        text("stance"), _make_robot_title(answer), tuple(blocks), passed=passed, findings=(message,)
    )


def simulation_document(stance: Stance) -> doc.Document:
    """Create the report of a stance simulated without feed-forward, for the live page."""
    run = stance.sagging
    expected = None if stance.settled is None else stance.settled.base_height
    title = text("simulation-without-feed-forward", time=f"{run.duration:.0f}")
    table = replace(simulated_table(run), title=NO_TITLE)
    predicted = (text("base-at-predicted"), doc.number_cell(expected, ".5f"), doc.Name("m"))
    blocks = (replace(table, rows=(predicted, *table.rows)), _SIMULATION_NOTE)
    good = stance.verdict.passed
    messages = tuple(map(clause_text, verdict_clauses(stance.verdict)))
    return doc.Document(text("stance"), title, blocks, passed=good, findings=messages)


def live_push_document(trial: PushTrial) -> doc.Document:
    """Create the report of a simulated push against the standing robot, for the live page."""
    document = trial_document(trial)
    return replace(document, blocks=(*document.blocks, _SIMULATION_NOTE))


_SIMULATION_NOTE = doc.Lines((text("orange-as-simulated"),))
"""Legend below a report of the live page: the orange robot in the scene is the simulated one."""


def failure_document(error: PupperAnalysisError) -> doc.Document:
    """Create the report that shows an error message of this package on the live page."""
    messages = (doc.diagnostic_text(error.diagnostic),)
    return doc.Document(text("stance"), NO_TITLE, (), passed=False, failures=messages)


def unexpected_document(error: Exception) -> doc.Document:
    """Create the report of an unexpected error for the live page."""
    description = strip_folders(f"{type(error).__name__}: {error}".rstrip(": "))
    messages = (text("unexpected", what=description),)
    return doc.Document(text("stance"), NO_TITLE, (), passed=False, failures=messages)
