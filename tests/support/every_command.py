"""Compare the reports of all commands about a file with MuJoCo's simulation of the file.

Files are edits of a quadruped that stands, and of an arm that servos hold. The reference is MuJoCo
alone: the file from its keyframe, after a nudge, for five seconds.
"""

from __future__ import annotations

import json
import math
import re
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Any
from unittest import mock

import mujoco
import numpy as np

import pupper_analysis as pa
from pupper_analysis import cli
from pupper_analysis.base.errors import NotStandingError, PupperAnalysisError
from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.prepare.convert import load
from pupper_analysis.prepare.judge import judge_stand
from pupper_analysis.prepare.passes import make_robot
from pupper_analysis.simulation.verdict import Verdict
from tests.support import arm, arm_features, features, legged, slips
from tests.support.commands import answer
from tests.support.variants import share_variants

SECONDS = 5.0
"""Simulated time [s]."""

NUDGE = 1e-3
"""Standard deviation of the initial velocity [m/s, rad/s]."""

LOST, LEANS = 0.3, 0.5
"""Loss of CoM height, relative to the height, and tilt [rad] above which a robot has fallen."""

MAX_REST_SPEED = 0.05
"""Speed [m/s, rad/s] in the last tenth of the simulation above which a robot shakes: ten times the
creep of feet."""

DIVERGED = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
)
"""MuJoCo's warnings of a diverged simulation."""

ABOVE, LOAD, SLOPE = (0.0, 0.0, 0.05), 0.3, math.radians(3)
"""Position [m] and mass [kg] of a payload, and slope of the ground [rad], of a stance file."""

OWN_RUN_TEXT = "unmodified MJCF"
"""Text at the start of the line about the simulation of the unmodified file."""

ADDED_SERVOS_TEXT = "servos that were added"
"""Text of the note about added servos."""

NOTE_PREFIXES = ("note:", "warning:")
"""Prefixes of lines that are notes."""


class Truth(StrEnum):
    """Result of MuJoCo's simulation of a file.

    No report must state that a robot without servos or commands stands.
    """

    STANDS = "stands"
    FALLS = "falls"
    SHAKES = "shakes"
    ELSEWHERE = "is commanded elsewhere"
    LIMP = "has no servos"
    UNTOLD = "has no ctrl"
    REFUSED = "is refused"


_truths: dict[tuple[object, ...], Truth] = {}
"""{content of the files, and load: result} of the simulations of this process."""


def simulate_truth(
    path: Path,
    plain: Path,
    *,
    slope: float = 0.0,
    load: float = 0.0,
    stance: tuple[list[float], dict[str, tuple[float, float]]] | None = None,
) -> Truth:
    """Simulate a file as `_simulate_truth` does; files with the same content once per process."""
    key = path.read_bytes(), plain.read_bytes(), slope, load, repr(stance)
    if key not in _truths:
        _truths[key] = _simulate_truth(path, plain, slope=slope, load=load, stance=stance)
    return _truths[key]


@silence_mujoco()
def _simulate_truth(
    path: Path,
    plain: Path,
    *,
    slope: float = 0.0,
    load: float = 0.0,
    stance: tuple[list[float], dict[str, tuple[float, float]]] | None = None,
) -> Truth:
    """Simulate a file, and return the result.

    A file without keyframe starts from the keyframe of the unmodified file, by joint names.

    Args:
        path: The file.
        plain: The unmodified file.
        slope: Slope of the ground [rad], rising towards x; gravity is rotated instead.
        load: Mass [kg] that is fixed to the base at ``ABOVE``.
        stance: Initial pose of the base (``qpos[:7]``), and {joint: (angle [rad], torque [N m])}.
            Each servo of a joint is commanded to the angle that gives the torque; None for the
            keyframe.
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
        _copy_keyframe(mujoco.MjModel.from_xml_path(str(plain)), model, data)
    if stance is not None:
        _set_stance(model, data, *stance)
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
    return Truth.SHAKES if fastest > MAX_REST_SPEED else Truth.STANDS


def _set_stance(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    base: list[float],
    joints: dict[str, tuple[float, float]],
) -> None:
    """Set base pose, joint angles [rad], and commands of servos that exert torques [N m]."""
    data.qpos[:7] = base
    for name, (angle, _) in joints.items():
        data.qpos[model.joint(name).qposadr[0]] = angle
    for motor in range(model.nu):
        joint = model.actuator_trnid[motor, 0]
        angle, torque = joints[model.joint(joint).name]
        gear, kp = model.actuator_gear[motor, 0], model.actuator_gainprm[motor, 0]
        data.ctrl[motor] = gear * angle + torque / (gear * kp)


def _copy_keyframe(plain: mujoco.MjModel, model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Set the state of a file, with commands, to the keyframe of the unmodified file."""
    data.qpos[:7] = plain.key_qpos[0, :7]
    for joint in range(model.njnt):
        if model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_FREE:
            there = plain.joint(model.joint(joint).name).qposadr[0]
            data.qpos[model.jnt_qposadr[joint]] = plain.key_qpos[0, there]
    for motor in range(model.nu):
        if model.actuator_trntype[motor] == mujoco.mjtTrn.mjTRN_JOINT:
            data.ctrl[motor] = data.qpos[model.jnt_qposadr[model.actuator_trnid[motor, 0]]]


MAX_SHARED_ROBOTS = 24
"""Largest number of robots that are stored at a time; the least recently used is dropped. Chosen
above the number of edits of which a test module runs several commands."""


@contextmanager
def share_robots() -> Iterator[None]:
    """Prepare a pair of files once: commands that load the same bytes with the same options get
    the same robot. Robots are immutable. Variants are shared, too.
    """
    shared: OrderedDict[tuple[object, ...], pa.Robot] = OrderedDict()

    def make_shared_robot(urdf: UrdfFile, mjcf: MjcfFile, **options: Any) -> pa.Robot:
        given = {name: value for name, value in options.items() if name != "finish"}
        paths = urdf.path, mjcf.path
        key = (*paths, *(path.read_bytes() for path in paths), repr(given))
        if key not in shared:
            shared[key] = make_robot(urdf, mjcf, **options)
        shared.move_to_end(key)
        if len(shared) > MAX_SHARED_ROBOTS:
            shared.popitem(last=False)
        return shared[key]

    with mock.patch.object(load, "make_robot", make_shared_robot), share_variants():
        yield


@dataclass(frozen=True)
class Cell:
    """Report of a command: whether it passes, and mentions the run of the unmodified file."""

    passed: bool
    refused: bool
    keyframe_run: bool
    added: bool
    word: str
    own_falls: bool | None = None
    truth: Truth | None = None  # of what else it is about than the row

    def find_objection(self, truth: Truth) -> str:
        """Return the reason why the report is better than the simulation; "" if it is not."""
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
    """File with the result of its simulation, and the reports of commands."""

    name: str
    truth: Truth
    cells: dict[str, Cell] = field(default_factory=dict)

    @property
    def wrong(self) -> dict[str, str]:
        """{command: reason} of the reports that are better than the simulation."""
        found = {name: cell.find_objection(self.truth) for name, cell in self.cells.items()}
        return {name: how for name, how in found.items() if how}


Ask = Callable[[Path, Path, Path], Cell]


def _make_command(
    name: str, *options: str, before: tuple[str, ...] = (), alone: bool = False
) -> Ask:
    """Return a function that runs a command on both files, or on the MJCF alone."""

    def ask(urdf: Path, mjcf: Path, folder: Path) -> Cell:
        files = (str(mjcf),) if alone else (str(urdf), str(mjcf))
        return _make_cell(*answer(name, *before, *files, *options, "-v", folder=folder))

    return ask


def _make_cell(status: int, out: str, err: str) -> Cell:
    """Return the report in the output of a command."""
    assert status in (0, 1, 2), err  # 3 is a bug, whatever else
    message = " ".join((out + err).split())
    lines = [
        line for line in out.splitlines() if line.split() and not line.startswith(NOTE_PREFIXES)
    ]
    word = lines[0].split()[0] if lines else err.strip()[-80:]
    return Cell(
        status == 0, status == 2, OWN_RUN_TEXT in message, ADDED_SERVOS_TEXT in message, word
    )


def _run_study(urdf: Path, mjcf: Path, _: Path) -> Cell:
    """Return the report of a study with one design; it passes if the design stands."""
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
    return _make_cell(0, f"{stood} {' '.join(map(str, list_stand_assumptions(study.base)))}", "")


def _run_python(urdf: Path, mjcf: Path, _: Path) -> Cell:
    """Return the report of ``judge_stand`` in Python."""
    try:
        robot = pa.load_robot(urdf=urdf, mjcf=mjcf)
        verdict = judge_stand(robot, pa.solve_stand(robot))
    except PupperAnalysisError as error:
        return Cell(False, True, False, False, type(error).__name__)
    return make_verdict_cell(verdict)


def make_verdict_cell(verdict: Verdict) -> Cell:
    """Return the report in a verdict of ``judge_stand``."""
    own, added = verdict.keyframe_run, verdict.servos.made != ()
    falls = None if own is None else own.falls
    return Cell(verdict.passed, False, own is not None, added, verdict.code.name, falls)


def _run_live(urdf: Path, mjcf: Path, _: Path) -> Cell:
    """Return the report of the simulation on the page of ``live``."""
    from pupper_analysis.tools.live import model as live
    from pupper_analysis.tools.live.documents import simulation_document
    from pupper_analysis.tools.live.render import Translator, render_panel
    from pupper_analysis.tools.live.state import State

    try:
        asked = live.PageSolver(pa.load_robot(urdf=urdf, mjcf=mjcf)).solve_state(State())
        if asked.refusal is not None:
            raise asked.refusal
        stance = live.simulate_stance(asked)
    except PupperAnalysisError as error:
        return Cell(False, True, False, False, type(error).__name__)
    page = render_panel(simulation_document(stance), Translator())
    return replace(_make_cell(not stance.verdict.passed, page, ""), word=stance.verdict.code.name)


def _run_convert(_: Path, mjcf: Path, folder: Path) -> Cell:
    """Return the report about the MJCF and the URDF converted from it."""
    made = folder / "made.urdf"
    done = answer("convert", str(mjcf), "-o", str(made), folder=folder)
    if not made.is_file():
        return _make_cell(*done)
    cell = _make_cell(*answer("stand", str(made), str(mjcf), "-v", folder=folder))
    return replace(cell, word=f"{done.stdout.split()[0]}, {cell.word}")


def _run_round_trip(_: Path, mjcf: Path, folder: Path) -> Cell:
    """Return the report about the MJCF converted back, compared with its own simulation."""
    between, made = folder / "made.urdf", folder / "made.xml"
    answer("convert", str(mjcf), "-o", str(between), folder=folder)
    if not between.is_file():
        return Cell(False, True, False, False, "no URDF")
    done = answer("convert", str(between), "-o", str(made), folder=folder)
    cell = _make_cell(*done)
    if not made.is_file():
        return cell
    stood = _make_cell(*answer("stand", str(made), "-v", folder=folder))
    return replace(
        stood,
        passed=cell.passed or stood.passed,
        word=f"{cell.word}, {stood.word}",
        truth=simulate_truth(made, folder.parent / "plain" / mjcf.name),
    )


def _run_stance_file(urdf: Path, mjcf: Path, folder: Path) -> Cell:
    """Return the report about a stance file with slope and payload, as ``live`` saves it."""
    (folder / "stance.toml").write_text(
        f'slope = "{math.degrees(SLOPE)}deg"\npayload = {LOAD}\n'
        f'payload_at = "{",".join(map(str, ABOVE))}"\n'
    )
    cell = _make_command("stand", "--stance", "stance.toml")(urdf, mjcf, folder)
    alone = simulate_truth(mjcf, folder.parent / "plain" / mjcf.name)
    there = simulate_truth(mjcf, folder.parent / "plain" / mjcf.name, slope=SLOPE, load=LOAD)
    return replace(cell, truth=alone if there is Truth.STANDS else there)


def _run_best(urdf: Path, mjcf: Path, folder: Path) -> Cell:
    """Return the report about the stance with the largest margin.

    Whether a robot shakes depends on the stance, and this stance is not that of the keyframe: if
    the file shakes in its keyframe, the reference is its simulation in the stance of the report.
    """
    ask = _make_command("best", "--json", "best.json", before=("margin",))
    cell = ask(urdf, mjcf, folder)
    plain = folder.parent / "plain" / mjcf.name
    if not cell.passed or simulate_truth(mjcf, plain) is not Truth.SHAKES:
        return cell
    stance = json.loads((folder / "best.json").read_text())["stance"]
    qpos, torques = stance["stand"]["qpos"], stance["statics"]["joint_torques"]
    names = pa.load_robot(urdf=urdf, mjcf=mjcf).joint_names
    joints = dict(zip(names, zip(qpos[7:], torques, strict=True), strict=True))
    return replace(cell, truth=simulate_truth(mjcf, plain, stance=(qpos[:7], joints)))


REPORTS: dict[str, Ask] = {
    "stand": _make_command("stand"),
    "payload": _make_command("payload", "--payload-at", "0,0,5cm"),
    "push": _make_command("push", "--directions", "3", "--resolution", "2"),
    "path": _make_command("path", "--seconds", "3", "--height", "0.34"),
    "best": _run_best,
    "analyze": _make_command("analyze", "--no-figures", alone=True),
    "study": _run_study,
    "python": _run_python,
    "live": _run_live,
}
"""{name: function that returns the report about a quadruped}."""

COMMANDS = {name: ask for name, ask in REPORTS.items() if name in (*cli.COMMAND_NAMES, "python")}
"""{command: function}, of commands and of Python."""

FILES: dict[str, Ask] = {
    "convert": _run_convert,
    "written": _run_round_trip,
    "stance": _run_stance_file,
}
"""{name: function}, of converted files and stance files."""

STANDING = COMMANDS | FILES
"""{name: function}, of all reports about a quadruped."""

HELD: dict[str, Ask] = {"hold": _make_command("hold")}
"""{command: function that returns the report about an arm}."""


def simulate_arm_truth(path: Path) -> Truth:
    """Simulate an arm's file from its keyframe, and return the result.

    The result is ELSEWHERE if the arm leaves the keyframe, but stays when its servos are commanded
    to the angles of the keyframe.
    """
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError:
        return Truth.REFUSED
    if not (model.actuator_biasprm[:, 1] < 0).any():
        return Truth.LIMP
    off, speed, lost = _simulate_arm(model, angles=False)
    if lost:
        return Truth.FALLS
    if off <= LEANS:
        return Truth.SHAKES if speed > MAX_REST_SPEED else Truth.STANDS
    if _simulate_arm(model, angles=True)[0] > LEANS:
        return Truth.FALLS
    stated = re.search(r"<key\b[^>]*\bctrl=", path.read_text())
    return Truth.ELSEWHERE if stated else Truth.UNTOLD


def _simulate_arm(model: mujoco.MjModel, *, angles: bool) -> tuple[float, float, bool]:
    """Simulate an arm.

    Args:
        model: Compiled model of the file.
        angles: Whether the servos are commanded to the initial angles.

    Returns:
        Largest final displacement of a joint [rad, m], largest final speed [rad/s, m/s], and
        whether the simulation diverged.
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


def list_edits() -> Iterator[tuple[str, Callable[[Path], legged.Pair]]]:
    """Yield (name, function that writes the edited files to a folder) of all edits."""
    for name, edit in features.FEATURES.items():
        yield name, lambda folder, edit=edit: legged.Pair(*features.write_files(folder, edit))
    for name, slip in slips.SLIPS.items():
        yield f"slip: {name}", lambda folder, slip=slip: _write_mistake(folder, slip)


def _write_mistake(folder: Path, slip: slips.Slip) -> legged.Pair:
    """Write a quadruped with a mistake."""
    pair = slips.standing(folder)
    pair.mjcf.write_text(slip(pair.mjcf.read_text(), np.random.default_rng(0)))
    return pair


def make_arm_row(name: str, folder: Path) -> Row:
    """Run the commands for arms on a file with a feature."""
    urdf, mjcf = arm_features.files(folder, arm_features.FEATURES[name])
    row = Row(name, simulate_arm_truth(mjcf))
    row.cells = {command: ask(urdf, mjcf, folder) for command, ask in HELD.items()}
    return row


def make_row(
    name: str,
    write: Callable[[Path], legged.Pair],
    folder: Path,
    commands: Iterable[str] = COMMANDS,
) -> Row:
    """Run commands on an edited file, each in its own folder.

    Several rows of one edit may use the same folder. ``python`` may be among the commands of two
    rows; other commands write files, and must differ.
    """
    (folder / "plain").mkdir(exist_ok=True)
    plain = slips.standing(folder / "plain")
    pair = write(folder)
    row = Row(name, simulate_truth(pair.mjcf, plain.mjcf))
    for command in commands:
        place = folder / command
        place.mkdir(exist_ok=command == "python")
        row.cells[command] = STANDING[command](pair.urdf, pair.mjcf, place)
    return row
