"""Robots of one file: do they stand as predicted, and are they the robots of both files?

    python benchmarks/one_file.py --folder ROBOTS

Each URDF and MJCF below the folder that has legs is loaded alone, and stood for 12 s. Where a URDF
and an MJCF agree (crosscheck), mass, com and gravity torques of the robots of one file are compared
with those of both, at random configurations. Times are the processor's.
"""

from __future__ import annotations

import time
from pathlib import Path

import click
import numpy as np

import pupper_analysis as pa
from pupper_analysis.analysis.stance import study_stance
from pupper_analysis.models.loading import kind_of
from pupper_analysis.report.verdict import verdict_word

CONFIGURATIONS = 100


def stood(model: Path) -> str:
    """Stands a robot of one file; returns a row of a table."""
    begin = time.process_time()
    try:
        robot = pa.load_robot(model)
        loaded = time.process_time() - begin
        if not (robot.floating and robot.feet):
            return f"| {model.name} | {robot.total_mass:.3f} | fixed base | {loaded:.1f} | | | |"
        result = study_stance(robot, pa.StandTask())
    except pa.PupperAnalysisError as error:
        return f"| {model.name} | | {type(error).__name__}: {str(error)[:90]} | | | | |"
    verdict, took = result.verdict, time.process_time() - begin
    errors = f"{verdict.torque_error:.1e} | {verdict.force_error or 0:.1e}"
    word = verdict_word(verdict).en
    return (
        f"| {model.name} | {robot.total_mass:.3f} | {word} | {loaded:.1f} | {took:.1f} | {errors} |"
    )


def apart(urdf: Path, mjcf: Path, seed: int) -> str:
    """Compares the robots of one file with that of both; returns a row of a table."""
    found = pa.compare_models(urdf, mjcf)
    if not found.agree:
        return f"| {urdf.name} | {mjcf.name} | disagree | | | |"
    both = pa.load_robot(urdf, mjcf, self_check=False)
    rng = np.random.default_rng(seed)
    worst = []
    for one in (pa.load_robot(urdf), pa.load_robot(mjcf, self_check=False)):
        named = dict(zip(found.joints, found.joints, strict=True))
        names = [named.get(name, name) for name in both.joint_names]
        if not set(names) <= set(one.joint_names):
            return f"| {urdf.name} | {mjcf.name} | agree, by other names | | | |"
        order = [one.joint_names.index(name) for name in names]
        off = 0.0
        for _ in range(CONFIGURATIONS):
            qpos, other = both.neutral(), one.neutral()
            turn = rng.normal(size=4)
            qpos[3:7] = other[3:7] = turn / np.linalg.norm(turn)
            angles = rng.uniform(-1, 1, both.nu)
            qpos[-both.nu :], other[[one.nq - one.nu + at for at in order]] = angles, angles
            mine, theirs = pa.Configuration(both, qpos), pa.Configuration(one, other)
            off = max(off, float(np.abs(mine.center_of_mass() - theirs.center_of_mass()).max()))
            torques = theirs.gravity()[6:][order]
            off = max(off, float(np.abs(mine.gravity()[6:] - torques).max()))
        worst.append(f"{off:.1e}")
    return f"| {urdf.name} | {mjcf.name} | agree | {both.total_mass:.3f} | {' | '.join(worst)} |"


@click.command()
@click.option("--folder", type=click.Path(path_type=Path, exists=True), required=True)
@click.option("--match", default="", help="Only files whose path has this in it.")
@click.option("--pair", type=(Path, Path), multiple=True, help="A URDF and an MJCF to compare.")
@click.option("--seed", default=0, show_default=True)
def main(folder: Path, match: str, pair: tuple[tuple[Path, Path], ...], seed: int) -> None:
    """Prints both tables as Markdown."""
    print("| file | mass (kg) | verdict | load (s) | with 12 s (s) | torques | forces |")
    print("|---|---|---|---|---|---|---|")
    for model in sorted(path for path in folder.rglob("*") if path.suffix in (".urdf", ".xml")):
        if match in str(model) and kind_of(model):
            print(stood(model), flush=True)
    if pair:
        print("\n| URDF | MJCF | crosscheck | mass (kg) | URDF alone | MJCF alone |")
        print("|---|---|---|---|---|---|")
    for urdf, mjcf in pair:
        print(apart(urdf, mjcf, seed), flush=True)


if __name__ == "__main__":
    main()
