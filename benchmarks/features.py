"""Test features of an MJCF, and mistakes in it: `python benchmarks/features.py`.

A quadruped that stands gets a feature of MuJoCo, or a mistake, in its MJCF. MuJoCo alone then
simulates the file with the commands of the computed stand. The table contains the height loss of
this simulation, the predicted height loss, the verdict of the stand, and the results of `audit` and
`crosscheck`. A row is silent, and the program ends with status 1, if the robot falls or differs
from the prediction without a report, or if no engine reads the file and `audit` reports no error.
"""

from __future__ import annotations

import contextlib
import math
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import click
import mujoco
import numpy as np
from tables import write_csv

import pupper_analysis as pa
from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.present.verdict import format_verdict
from pupper_analysis.simulation.verdict import VerdictCode
from pupper_analysis.tools.stand.stance import study_stance

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from tests.support.features import FEATURES, Edit, write_files

SECONDS = 6.0
"""Simulated time [s]."""

HEIGHT_TOLERANCE = 0.01  # share of the height: a stand that is further off is another one
"""Difference of the height loss from the prediction, relative to the height, above which a row is
reported."""

MAX_HEIGHT_LOSS = 0.3  # share of the height
"""Height loss, relative to the height, above which a robot has fallen."""


@dataclass(frozen=True)
class Row:
    """Result for a file."""

    name: str
    predicted: float | None  # m, lost on position commands
    bare: float | None  # m
    verdict: str
    audit: str
    crosscheck: str
    silent: bool


def simulate_height_loss(robot: pa.Robot, stand: pa.Stand, path: Path) -> float | None:
    """Return the height loss [m] of the base from a stand, on the servos of the file; None if
    refused.

    MuJoCo alone is used: state and commands are set by the names in the file. NaN for an unusable
    time step.
    """
    with silence_mujoco():
        try:
            model = mujoco.MjModel.from_xml_path(str(path))
        except ValueError:
            return None
        data = mujoco.MjData(model)
        angles = dict(zip(robot.joint_names, stand.joint_positions(robot).tolist(), strict=True))
        base = model.joint(next(j for j in range(model.njnt) if _is_free_joint_of_trunk(model, j)))
        data.qpos[base.qposadr[0] : base.qposadr[0] + 7] = stand.qpos[:7]
        ground = [g for g in range(model.ngeom) if model.geom(g).name == "floor"]
        if ground:  # it stands on the floor, wherever that is
            data.qpos[base.qposadr[0] + 2] += float(model.geom_pos[ground[0], 2])
        for name, angle in angles.items():
            data.qpos[model.joint(name).qposadr[0]] = angle
        for motor in range(model.nu):
            joint = int(model.actuator_trnid[motor, 0])
            if model.actuator_trntype[motor] == mujoco.mjtTrn.mjTRN_JOINT:
                gear = float(model.actuator_gear[motor, 0])
                if model.actuator_biastype[motor] == mujoco.mjtBias.mjBIAS_AFFINE:
                    data.ctrl[motor] = gear * angles.get(model.joint(joint).name, 0.0)
                    if model.actuator_actnum[motor]:  # its filter has come to rest
                        data.act[model.actuator_actadr[motor]] = data.ctrl[motor]
        mujoco.mj_forward(model, data)
        body = model.body("trunk").id
        start = float(data.xpos[body][2])
        timestep = float(model.opt.timestep)
        if not 1e-5 <= timestep <= 0.1:
            return math.nan
        for _ in range(round(SECONDS / timestep)):
            mujoco.mj_step(model, data)
        return start - float(data.xpos[body][2])


def _is_free_joint_of_trunk(model: mujoco.MjModel, joint: int) -> bool:
    """Return True if a joint is the free joint of the body ``trunk``."""
    free = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE
    return bool(free and model.body(model.jnt_bodyid[joint]).name == "trunk")


def describe_result(call: Callable[[], str]) -> str:
    """Return the result of a function, or "refused: " with the error of this package."""
    try:
        return call()
    except pa.PupperAnalysisError as error:
        return f"refused: {str(error).partition(': ')[2][:120] or type(error).__name__}"


def make_row(name: str, edit: Edit, robot: pa.Robot, stand: pa.Stand, folder: Path) -> Row:
    """Return the result for the file with a feature.

    Args:
        name: Name of the feature.
        edit: Change of the files.
        robot: Robot without the feature.
        stand: Stand of this robot.
        folder: Folder for the files.
    """
    urdf, mjcf = write_files(folder, edit)
    bare = simulate_height_loss(robot, stand, mjcf)
    predicted, unreserved, verdict = None, False, ""
    try:
        own = pa.load_robot(urdf=urdf, mjcf=mjcf)
        found = study_stance(own, stand.task)
        verdict = format_verdict(found.verdict)
        unreserved = found.verdict.code is VerdictCode.HOLDS  # others state a condition
        with contextlib.suppress(pa.PupperAnalysisError):
            rest = pa.steady_state(own, pa.solve_stand(own, stand.task))
            predicted = float(stand.qpos[2] - rest.qpos[2])
    except pa.PupperAnalysisError as error:
        verdict = f"refused: {error}".replace(f"{folder}/", "")
    audited = pa.audit_model(mjcf)
    errors = audited.counts["error"]
    audit = f"{errors} errors, {audited.counts['warning']} warnings"
    checked = describe_result(
        lambda: "agree" if pa.compare_models(urdf, mjcf).agree else "disagree"
    )
    height = float(stand.qpos[2])
    fell = bare is None or not abs(bare) < MAX_HEIGHT_LOSS * height
    elsewhere = (
        not fell and predicted is not None and abs(bare - predicted) > HEIGHT_TOLERANCE * height
    )
    silent = ((fell or elsewhere) and unreserved) or (bare is None and not errors)
    return Row(name, predicted, bare, verdict, audit, checked, silent)


def make_rows(names: tuple[str, ...]) -> Iterator[Row]:
    """Yield the results for the named features, or for all."""
    with tempfile.TemporaryDirectory() as top:
        plain = Path(top) / "plain"
        plain.mkdir()
        urdf, mjcf = write_files(plain, FEATURES["as it is"])
        robot = pa.load_robot(urdf=urdf, mjcf=mjcf)
        stand = pa.solve_stand(robot)
        for number, (name, edit) in enumerate(FEATURES.items()):
            if not names or name in names:
                folder = Path(top) / str(number)
                folder.mkdir()
                yield make_row(name, edit, robot, stand, folder)


COLUMNS = (
    "feature of the MJCF",
    "predicted (mm)",
    "bare MuJoCo (mm)",
    "stand",
    "audit",
    "crosscheck",
)
"""Columns of the table."""


def format_millimetres(value: float | None) -> str:
    """Return a length [m] in millimetres as text; "-" if unknown."""
    return "-" if value is None or not math.isfinite(value) else f"{1e3 * value:.2f}"


@click.command()
@click.argument("names", nargs=-1)
@click.option("--csv", "path", type=click.Path(path_type=Path), help="Write the table here.")
def main(names: tuple[str, ...], path: Path | None) -> None:
    """Write a file per feature, and print the results for it."""
    lines, silent = [], []
    for one in make_rows(names):
        numbers = (format_millimetres(one.predicted), format_millimetres(one.bare))
        lines.append((one.name, *numbers, one.verdict, one.audit, one.crosscheck))
        click.echo(("SILENT " if one.silent else "") + " | ".join(lines[-1]))
        silent += [one.name] if one.silent else []
    if path is not None:
        write_csv(path, COLUMNS, lines)
    if silent:
        raise SystemExit(f"silent: {', '.join(silent)}")


if __name__ == "__main__":
    np.seterr(all="ignore")
    main()
