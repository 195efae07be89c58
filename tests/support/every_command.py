"""Whether a command says more of a file than bare MuJoCo does: features and slips, by commands.

Files are edits of a quadruped's that stands, and of an arm's that is held. The truth is MuJoCo's
alone: the file as it is, as ``mj_resetDataKeyframe`` leaves it, nudged, for five seconds.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path

import mujoco
import numpy as np

import pupper_analysis as pa
from pupper_analysis import cli
from pupper_analysis.base.errors import NotStandingError, PupperAnalysisError
from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.prepare.judge import judge_stand
from pupper_analysis.simulation.verdict import Verdict
from tests.support import arm, arm_features, features, legged, slips
from tests.support.commands import answer

SECONDS = 5.0
NUDGE = 1e-3
"""m/s, rad/s"""

LOST, LEANS = 0.3, 0.5
"""Of the height, of the com; rad: what has lost or leans more has fallen."""

SHAKES = 0.05
"""m/s, rad/s in the last half second: ten times what feet creep or roll by."""

DIVERGED = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
)

ABOVE, LOAD, SLOPE = (0.0, 0.0, 0.05), 0.3, math.radians(3)
"""Where the stance that a file states has a mass (m, kg), and on which slope it is (rad)."""

OWN = "unmodified MJCF"
"""With which the line of the own run begins."""

ADDED = "servos that were added"

NOTES = ("note:", "warning:")


class Truth(StrEnum):
    """What becomes of a file; of what is limp or told nothing, nobody says that it should stand."""

    STANDS = "stands"
    FALLS = "falls"
    SHAKES = "shakes"
    ELSEWHERE = "is commanded elsewhere"
    LIMP = "has no servos"
    UNTOLD = "has no ctrl"
    REFUSED = "is refused"


@silence_mujoco()
def truth_of(path: Path, plain: Path, *, slope: float = 0.0, load: float = 0.0) -> Truth:
    """Simulate a file; one that has no keyframe from the plain file's, by the joints' names.

    Args:
        path: The file.
        plain: The file of which it is an edit.
        slope: By which gravity is turned, so that the ground rises towards x (rad).
        load: Of a mass that is welded to the base ``ABOVE`` (kg).
    """
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        if load:
            spec.body("trunk").add_body(
                pos=ABOVE, mass=load, inertia=[1e-6] * 3, explicitinertial=True
            )
        model = spec.compile()
    except ValueError:
        return Truth.REFUSED
    if not 1e-5 <= model.opt.timestep <= 0.1:
        return Truth.REFUSED
    down, turned = model.opt.gravity.copy(), (math.cos(slope), math.sin(slope))
    model.opt.gravity[0] = turned[0] * down[0] + turned[1] * down[2]
    model.opt.gravity[2] = turned[0] * down[2] - turned[1] * down[0]
    stated = not model.nkey or re.search(r"<key\b[^>]*\bctrl=", path.read_text())
    servos = model.actuator_biastype != mujoco.mjtBias.mjBIAS_NONE
    driven = servos | (model.actuator_dyntype != mujoco.mjtDyn.mjDYN_NONE)
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    else:
        _as_in(mujoco.MjModel.from_xml_path(str(plain)), model, data)
    data.qvel[:] += NUDGE * np.random.default_rng(43).standard_normal(model.nv)
    mujoco.mj_forward(model, data)
    body, fastest = model.body("trunk").id, 0.0
    start = data.subtree_com[body].copy()
    steps = round(SECONDS / model.opt.timestep)
    for step in range(steps):
        mujoco.mj_step(model, data)
        if step > 0.9 * steps:
            fastest = max(fastest, float(np.abs(data.qvel).max()))
    end = data.subtree_com[body]
    fell = (
        any(data.warning[kind].number for kind in DIVERGED)  # it began anew
        or not -LOST * start[2] < end[2] - start[2] < start[2]
        or data.xmat[body][8] < math.cos(LEANS)
        or math.hypot(*(end - start)[:2]) > start[2]
    )
    if fell:
        message = Truth.FALLS if stated else Truth.UNTOLD
        return message if driven.any() else Truth.LIMP
    return Truth.SHAKES if fastest > SHAKES else Truth.STANDS


def _as_in(plain: mujoco.MjModel, model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Put a file where the keyframe of the plain one is, its servos told its angles."""
    data.qpos[:7] = plain.key_qpos[0, :7]
    for joint in range(model.njnt):
        if model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_FREE:
            there = plain.joint(model.joint(joint).name).qposadr[0]
            data.qpos[model.jnt_qposadr[joint]] = plain.key_qpos[0, there]
    for motor in range(model.nu):
        if model.actuator_trntype[motor] == mujoco.mjtTrn.mjTRN_JOINT:
            data.ctrl[motor] = data.qpos[model.jnt_qposadr[model.actuator_trnid[motor, 0]]]


@dataclass(frozen=True)
class Cell:
    """What a command came to: whether it lets pass, and whether it tells of the own run."""

    passed: bool
    refused: bool
    keyframe_run: bool
    added: bool
    word: str
    own_falls: bool | None = None
    truth: Truth | None = None  # of what else it is about than the row

    def wrong(self, truth: Truth) -> str:
        """Return what is better than the truth; empty if nothing is."""
        truth = self.truth or truth
        if self.refused:
            return ""
        if self.own_falls is False and truth is Truth.FALLS:
            return "its own run does not fall"
        if self.passed and truth in {Truth.FALLS, Truth.SHAKES, Truth.REFUSED}:
            return f"passes where the file {truth}"
        if self.passed and truth is Truth.LIMP and not self.added:
            return "passes on servos that the file has not, and does not say so"
        return "" if self.keyframe_run else "says nothing of what the file does by itself"


@dataclass
class Row:
    """A file, what becomes of it, and what commands say."""

    name: str
    truth: Truth
    cells: dict[str, Cell] = field(default_factory=dict)

    @property
    def wrong(self) -> dict[str, str]:
        """What is better than the truth: {command: how}."""
        found = {name: cell.wrong(self.truth) for name, cell in self.cells.items()}
        return {name: how for name, how in found.items() if how}


Ask = Callable[[Path, Path, Path], Cell]


def _command(name: str, *options: str, before: tuple[str, ...] = (), alone: bool = False) -> Ask:
    """Run a command of both files, or of the MJCF alone."""

    def ask(urdf: Path, mjcf: Path, folder: Path) -> Cell:
        files = (str(mjcf),) if alone else (str(urdf), str(mjcf))
        return _cell(*answer(name, *before, *files, *options, "-v", folder=folder))

    return ask


def _cell(status: int, out: str, err: str) -> Cell:
    assert status in (0, 1, 2), err  # 3 is a bug, whatever else
    message = " ".join((out + err).split())
    lines = [line for line in out.splitlines() if line.split() and not line.startswith(NOTES)]
    word = lines[0].split()[0] if lines else err.strip()[-80:]
    return Cell(status == 0, status == 2, OWN in message, ADDED in message, word)


def _study(urdf: Path, mjcf: Path, _: Path) -> Cell:
    """A design of a study, in this process: it passes where it is said to stand."""
    from pupper_analysis.tools.study.design import DesignBuilder
    from pupper_analysis.tools.study.outcome import list_stand_assumptions

    try:
        study = pa.Study({"urdf": str(urdf), "mjcf": str(mjcf)}, {"height": [0.35]}, ["stands"])
        (metric,) = study.metrics
        stood = metric.function(DesignBuilder(study.source, study.task, study.point).design({}))
    except NotStandingError as error:
        return Cell(False, False, True, False, type(error).__name__)
    except PupperAnalysisError as error:
        return Cell(False, True, False, False, type(error).__name__)
    return _cell(0, f"{stood} {' '.join(map(str, list_stand_assumptions(study.base)))}", "")


def _python(urdf: Path, mjcf: Path, _: Path) -> Cell:
    """What Python's callers have: ``judge_stand``."""
    try:
        robot = pa.load_robot(urdf=urdf, mjcf=mjcf)
        verdict = judge_stand(robot, pa.solve_stand(robot))
    except PupperAnalysisError as error:
        return Cell(False, True, False, False, type(error).__name__)
    return verdict_cell(verdict)


def verdict_cell(verdict: Verdict) -> Cell:
    """Return the cell of a verdict of ``judge_stand``."""
    own, added = verdict.keyframe_run, verdict.servos.made != ()
    falls = None if own is None else own.falls
    return Cell(verdict.passed, False, own is not None, added, verdict.code.name, falls)


def _live(urdf: Path, mjcf: Path, _: Path) -> Cell:
    """The simulation that the page of ``live`` shows."""
    from pupper_analysis.tools.live import model as live
    from pupper_analysis.tools.live.documents import simulation_document
    from pupper_analysis.tools.live.render import Translator, render_panel
    from pupper_analysis.tools.live.state import State

    try:
        asked = live.StanceSolver(pa.load_robot(urdf=urdf, mjcf=mjcf)).solve_state(State())
        if asked.refusal is not None:
            raise asked.refusal
        stance = live.simulate_stance(asked)
    except PupperAnalysisError as error:
        return Cell(False, True, False, False, type(error).__name__)
    page = render_panel(simulation_document(stance), Translator())
    return replace(_cell(not stance.verdict.passed, page, ""), word=stance.verdict.code.name)


def _convert(_: Path, mjcf: Path, folder: Path) -> Cell:
    """The URDF that is made of the MJCF, beside it: both are no better than the MJCF alone."""
    made = folder / "made.urdf"
    done = answer("convert", str(mjcf), "-o", str(made), folder=folder)
    if not made.is_file():
        return _cell(*done)
    cell = _cell(*answer("stand", str(made), str(mjcf), "-v", folder=folder))
    return replace(cell, word=f"{done.stdout.split()[0]}, {cell.word}")


def _written(_: Path, mjcf: Path, folder: Path) -> Cell:
    """The MJCF that is made of that URDF: what is said of it is no better than what it does."""
    between, made = folder / "made.urdf", folder / "made.xml"
    answer("convert", str(mjcf), "-o", str(between), folder=folder)
    if not between.is_file():
        return Cell(False, True, False, False, "no URDF")
    done = answer("convert", str(between), "-o", str(made), folder=folder)
    cell = _cell(*done)
    if not made.is_file():
        return cell
    stood = _cell(*answer("stand", str(made), "-v", folder=folder))
    return replace(
        stood,
        passed=cell.passed or stood.passed,
        word=f"{cell.word}, {stood.word}",
        truth=truth_of(made, folder.parent / "plain" / mjcf.name),
    )


def _stance(urdf: Path, mjcf: Path, folder: Path) -> Cell:
    """A stance that a file states: on a slope, with a payload, as ``live`` saves it."""
    (folder / "stance.toml").write_text(
        f'slope = "{math.degrees(SLOPE)}deg"\npayload = {LOAD}\n'
        f'payload_at = "{",".join(map(str, ABOVE))}"\n'
    )
    cell = _command("stand", "--stance", "stance.toml")(urdf, mjcf, folder)
    alone = truth_of(mjcf, folder.parent / "plain" / mjcf.name)
    there = truth_of(mjcf, folder.parent / "plain" / mjcf.name, slope=SLOPE, load=LOAD)
    return replace(cell, truth=alone if there is Truth.STANDS else there)


ASKED: dict[str, Ask] = {
    "stand": _command("stand"),
    "payload": _command("payload", "--payload-at", "0,0,5cm"),
    "push": _command("push", "--directions", "3", "--resolution", "2"),
    "path": _command("path", "--seconds", "3", "--height", "0.34"),
    "best": _command("best", before=("margin",)),
    "analyze": _command("analyze", "--no-figures", alone=True),
    "study": _study,
    "python": _python,
    "live": _live,
}

COMMANDS = {name: ask for name, ask in ASKED.items() if name in (*cli.COMMAND_NAMES, "python")}

FILES: dict[str, Ask] = {"convert": _convert, "written": _written, "stance": _stance}
"""Those of files that are made, or that state a stance."""

STANDING = COMMANDS | FILES

HELD: dict[str, Ask] = {"hold": _command("hold")}
"""Those that are asked of arms."""


def truth_of_arm(path: Path) -> Truth:
    """Simulate an arm's file from its keyframe; a joint that ends far from there has left it.

    It is commanded elsewhere if it stays when its servos are commanded the angles there instead.
    """
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError:
        return Truth.REFUSED
    if not (model.actuator_biasprm[:, 1] < 0).any():
        return Truth.LIMP
    off, speed, lost = _arm_run(model, angles=False)
    if lost:
        return Truth.FALLS
    if off <= LEANS:
        return Truth.SHAKES if speed > SHAKES else Truth.STANDS
    if _arm_run(model, angles=True)[0] > LEANS:
        return Truth.FALLS
    stated = re.search(r"<key\b[^>]*\bctrl=", path.read_text())
    return Truth.ELSEWHERE if stated else Truth.UNTOLD


def _arm_run(model: mujoco.MjModel, *, angles: bool) -> tuple[float, float, bool]:
    """Return how far the joints of the arm are off in the end, how fast, and whether it is lost.

    Args:
        model: What MuJoCo makes of its file.
        angles: Whether the servos are commanded where it begins.
    """
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    places = model.jnt_qposadr[[model.joint(name).id for name in arm.RANGES]]
    if angles:
        driven = model.jnt_qposadr[model.actuator_trnid[:, 0]]
        data.ctrl[:] = data.qpos[driven] * model.actuator_gear[:, 0]
    data.qvel[:] += NUDGE * np.random.default_rng(43).standard_normal(model.nv)
    start = data.qpos[places].copy()
    mujoco.mj_step(model, data, round(SECONDS / model.opt.timestep))
    off = float(np.abs(data.qpos[places] - start).max())
    lost = any(data.warning[kind].number for kind in DIVERGED)
    return off, float(np.abs(data.qvel).max()), lost


def edits() -> Iterator[tuple[str, Callable[[Path], legged.Pair]]]:
    """Yield what is tried: its name, and what writes its files into a folder."""
    for name, edit in features.FEATURES.items():
        yield name, lambda folder, edit=edit: legged.Pair(*features.files(folder, edit))
    for name, slip in slips.SLIPS.items():
        yield f"slip: {name}", lambda folder, slip=slip: _slipped(folder, slip)


def _slipped(folder: Path, slip: slips.Slip) -> legged.Pair:
    pair = slips.standing(folder)
    pair.mjcf.write_text(slip(pair.mjcf.read_text(), np.random.default_rng(0)))
    return pair


def row_of_arm(name: str, folder: Path) -> Row:
    """Asks what is asked of arms of a feature's file."""
    urdf, mjcf = arm_features.files(folder, arm_features.FEATURES[name])
    row = Row(name, truth_of_arm(mjcf))
    row.cells = {command: ask(urdf, mjcf, folder) for command, ask in HELD.items()}
    return row


def row_of(
    name: str,
    write: Callable[[Path], legged.Pair],
    folder: Path,
    commands: Iterable[str] = COMMANDS,
) -> Row:
    """Asks commands of an edit's file, each in a folder of its own."""
    (folder / "plain").mkdir()
    plain = slips.standing(folder / "plain")
    pair = write(folder)
    row = Row(name, truth_of(pair.mjcf, plain.mjcf))
    for command in commands:
        place = folder / command
        place.mkdir()
        row.cells[command] = STANDING[command](pair.urdf, pair.mjcf, place)
    return row
