"""The document of a payload: what a stance can carry, and what the simulation makes of it."""

from __future__ import annotations

import math
from collections.abc import Iterable

from pupper_analysis.analysis.payload import LoadedStance
from pupper_analysis.report import document as doc
from pupper_analysis.report.documents.loads import view_block
from pupper_analysis.report.documents.registry import build_document
from pupper_analysis.report.documents.standing import made_up, robot_notes
from pupper_analysis.report.documents.tasks import task_text
from pupper_analysis.report.verdict import verdict_of_files
from pupper_analysis.report.words import join_words, text, word
from pupper_analysis.robot.robot import Robot

_MORE = 1.001
"""Times what motors bear: legs that share a load bear more."""


@build_document.register(LoadedStance)
def payload_document(loaded: LoadedStance, robot: Robot | None = None) -> doc.Document:
    """Returns what a stance can carry; see ``build``."""
    limit = payload_text(loaded)
    return doc.Document(
        text("payload-title"),
        doc.Name(loaded.name),
        (view_block(robot, loaded.stand, None), payload_table(loaded), *_buckling(loaded)),
        passed=loaded.passed,
        verdict=verdict_of_files("carries" if loaded.passed else "FAILS", loaded.converted),
        failures=() if loaded.passed else tuple(_trial(loaded)),
        told=(
            limit,
            *(_trial(loaded) if loaded.passed else ()),
            task_text(loaded.stand.task),
            *made_up(loaded.servos),
        ),
        notes=robot_notes(robot),
    )


def payload_text(loaded: LoadedStance) -> doc.Text:
    """Returns the greatest mass, where it is, and what gives way beyond it."""
    payload, fell = loaded.payload, loaded.fell
    beyond, where = payload.failure, payload.where
    if fell is not None and fell.failure is not None:
        beyond, where = fell.failure, fell.where
    failure: doc.Words = word(beyond.value)
    if where:
        failure = text("failure-where", failure=failure, where=", ".join(where))
    return text(
        "payload-at-place",
        place=", ".join(f"{1e3 * value:.0f}" for value in payload.point),
        link=payload.link,
        mass=mass_text(loaded.mass),
        failure=failure,
    )


def payload_table(loaded: LoadedStance) -> doc.Table:
    """Returns what each bound lets it carry."""
    payload = loaded.payload
    bounds = [
        ("motors", payload.motors.mass),
        ("servos-stiffness", payload.servos.mass),
        ("contacts", payload.contacts.mass),
    ]
    shared = payload.shared
    if shared is not None and payload.motors.mass * _MORE < shared.mass < math.inf:
        bounds.insert(1, ("motors-if-the-legs-share", shared.mass))
    if loaded.fell is not None:
        bounds.append(("payload-nudged", loaded.mass))
    notes: list[doc.Words] = [text("payload-is-static")]
    if payload.unlimited:
        notes.append(
            text(
                "motors-without-effort-limit",
                count=len(payload.unlimited),
                joints=join_words(map(doc.Name, payload.unlimited)),
            )
        )
    return doc.Table(
        text("what-bounds-the-payload"),
        (doc.Column(text("bound"), left=True), doc.Column(text("payload"))),
        tuple((text(name), mass_text(mass)) for name, mass in bounds),
        tuple(notes),
    )


def _buckling(loaded: LoadedStance) -> Iterable[doc.Table]:
    """Yields how fast a stand buckles near what its servos hold."""
    if not loaded.buckling:
        return
    limit = loaded.payload.servos.mass
    rows: list[tuple[doc.Cell, ...]] = [
        (
            doc.number_cell(one.mass, ".2f"),
            doc.number_cell(one.mass / limit, ".2f"),
            *(
                doc.number_cell(None if math.isinf(time) else time, ".3g")
                for time in (one.doubling_time, one.free_doubling_time)
            ),
        )
        for one in loaded.buckling
    ]
    yield doc.Table(
        text("how-fast-it-buckles"),
        (
            doc.Column(text("payload"), "kg"),
            doc.Column(text("of-the-servos-limit"), "1"),
            doc.Column(text("doubles-in"), "s"),
            doc.Column(text("without-dry-friction"), "s"),
        ),
        tuple(rows),
    )


def mass_text(mass: float) -> doc.Words:
    """Returns a mass that can be borne (kg), rounded down: what is told is borne."""
    if math.isinf(mass):
        return text("no-limit")
    return doc.Name(f"{math.floor(100 * mass) / 100:.2f} kg")


def _trial(loaded: LoadedStance) -> Iterable[doc.Words]:
    """Says what became of it in simulation, with nearly its payload on it."""
    trial = loaded.trial
    if trial is None:
        return
    mass, seconds = mass_text(trial.mass), f"{trial.duration:g}"
    if trial.failure is None:
        yield text(
            "simulated-with-mass",
            mass=mass,
            seconds=seconds,
        )
    else:
        yield text(
            "simulated-with-mass-on-it-seconds",
            mass=mass,
            seconds=seconds,
            time=f"{trial.time:.2f}",
            failure=word(trial.failure.value),
            where=", ".join(trial.where),
        )
