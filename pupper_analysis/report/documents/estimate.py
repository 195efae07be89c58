"""The document of an estimate: what a study would take."""

from __future__ import annotations

import math
import os

from pupper_analysis.report import document as doc
from pupper_analysis.report.documents.registry import build_document
from pupper_analysis.report.words import join_words, text, word
from pupper_analysis.robot.robot import Robot
from pupper_analysis.study.estimate import Estimate


@build_document.register(Estimate)
def estimate_document(
    expected: Estimate, _: Robot | None = None, workers: int | None = None
) -> doc.Document:
    """Returns what a study would take; see ``build``.

    Args:
        expected: The estimate.
        workers: On how many processes; by default as many as this machine has cores.
    """
    count = workers or os.cpu_count() or 1
    told = [
        text(
            "count-designs-of-which-there",
            count=expected.designs,
            there=expected.there,
        ),
        text(
            "mean-ms-each-on-average",
            mean=f"{1e3 * expected.seconds_each:.0f}",
            slowest=f"{1e3 * expected.slowest:.0f}",
        ),
        text(
            "about-time-on-count-workers",
            time=duration_text(expected.seconds(count)),
            count=count,
        ),
    ]
    if expected.left_out:
        told.append(
            text(
                "not-timed",
                names=join_words(map(doc.Name, expected.left_out)),
            )
        )
    if expected.failures:
        kinds = join_words(map(word, expected.failures))
        told.append(text("timed-that-failed", kinds=kinds))
    return doc.Document(text("study-of-designs"), text("estimate-title"), (), told=tuple(told))


def duration_text(seconds: float) -> str:
    """Returns a time as people say it."""
    if not math.isfinite(seconds):
        return "-"
    whole = round(seconds)
    if whole < 120:
        return f"{whole} s"
    if whole < 7200:
        return f"{whole // 60} min"
    return f"{whole / 3600:.1f} h"
