"""The document of a stance: what it costs, and whether it holds."""

from __future__ import annotations

from collections.abc import Iterable

from pupper_analysis.present import document as doc
from pupper_analysis.present.documents.loads import load_blocks, view_block
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.present.documents.simulated import height_plot, motions_of, simulated_table
from pupper_analysis.present.documents.standing import (
    ground_text,
    robot_notes,
    stand_table,
    task_text,
)
from pupper_analysis.present.verdict import verdict_lines, verdict_word
from pupper_analysis.present.words import join_words, text
from pupper_analysis.robot.robot import Robot
from pupper_analysis.simulation.verify import StandVerification
from pupper_analysis.stance.sag.steady_state import RELEASE_MARGIN
from pupper_analysis.tools.stand.stance import Stance

DISAGREEMENT = 1e-4
"""What a stand may leave of the balance in MuJoCo's terms before it is remarked upon (N, N m)."""


@build_document.register(Stance)
def stance_document(stance: Stance, robot: Robot | None = None) -> doc.Document:
    """Returns a stance, what it costs, and whether it holds; see ``build``."""
    run = stance.verification
    stand = stance.stand
    blocks = [
        view_block(robot, stand, stance.statics, motions_of([run])),
        *load_blocks(
            stance.statics,
            stance.min_max_torque,
            run,
            stance.limits.tolist(),
            stance.limit_origins,
            {doc.Column(text("position"), "rad"): stance.joint_positions.tolist()},
        ),
        stand_table(stand, stance.statics),
        simulated_table(run),
        height_plot([run], float(stand.qpos[2])),
    ]
    verdict = verdict_lines(stance.verdict)
    return doc.Document(
        text("stance"),
        doc.Name(stance.name),
        tuple(blocks),
        passed=stance.passed,
        verdict=verdict_word(stance.verdict),
        failures=() if stance.passed else tuple(line for line in verdict if line.mark != "good"),
        told=(
            task_text(stance.stand.task),
            *(line for line in verdict if stance.passed or line.mark == "good"),
            *_told(stance),
        ),
        notes=(*_disagreement(run), *robot_notes(robot)),
    )


def _disagreement(run: StandVerification) -> Iterable[doc.Words]:
    """Says that the two models are not of one robot, if by the MJCF the stand is out of balance."""
    if run.mujoco_residual > DISAGREEMENT:
        yield text(
            "the-two-models-disagree",
            residual=f"{run.mujoco_residual:.1e}",
        )


def _told(stance: Stance) -> Iterable[doc.Words]:
    settled = stance.settled
    if stance.unsettled is not None:
        yield text("no-sag-predicted", why=doc.tell(stance.unsettled))
    if settled is not None:
        settles = text(
            "settles-at",
            # Above the ground where the task has its height, which on a slope is not the world's z.
            height=f"{(stance.stand.task.height or 0.0) - settled.height_loss:.5f}",
            servo=f"{1e3 * settled.servo_sag:z.2f}",
            contact=f"{1e3 * settled.contact_sag:z.2f}",
        )
        if settled.failures:
            why = join_words(map(doc.tell, settled.failures), "semicolon")
            settles = text("settles-but", settles=settles, why=why)
        elif settled.release_margin < RELEASE_MARGIN:
            settles = text(
                "settles-if-let-down-slowly",
                settles=settles,
            )
        yield settles
    if stance.minimum_stiffness is not None:
        yield text(
            "minimum-stiffness-of-servos",
            kp=f"{stance.minimum_stiffness:.2f}",
        )
    near, links = stance.stand.ground_clearance, stance.stand.self_clearance
    if near is not None:
        yield text(
            "lowest-part-but-the-feet",
            link=doc.Name(near.links[0]),
            distance=f"{1e3 * near.distance:.1f}",
        )
    if links is not None:
        yield text(
            "nearest-links-links-distance",
            links=doc.Name(" / ".join(links.links)),
            distance=f"{1e3 * links.distance:.1f}",
        )
    if stance.loops_open is not None:
        yield text(
            "the-mjcfs-loops-and-couplings",
            most=f"{stance.loops_open:.2g}",
        )
    yield ground_text(stance.stand.depths.values())
