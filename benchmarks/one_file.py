"""Robots loaded from a single file: their stands, and their agreement with the robot of both files.

    python benchmarks/one_file.py --folder ROBOTS --each
    python benchmarks/one_file.py --folder ROBOTS --pairs

Each URDF and MJCF with legs below the folder is loaded alone, and its stand is simulated for 12 s.
If a URDF and an MJCF agree (crosscheck), CoM and gravity torques of the robots of one file are
compared with those of both files at random configurations, and the verdicts of their stands. The
pairs are Pupper's variants, those of `corpus.py`, and URDFs of `corpus.py` with the MJCF that
MuJoCo makes of them. Times are processor times.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import click
import numpy as np
from corpus import CONVERTED, DATA, PAIRS, convert_with_mujoco

import pupper_analysis as pa
from pupper_analysis.models.loading import kind_of
from pupper_analysis.present.verdict import verdict_word
from pupper_analysis.pupper.variant_files import write_variant
from pupper_analysis.stance.problem import nominal_foot_positions
from pupper_analysis.tools.stand.stance import study_stance

CONFIGURATIONS = 100
"""Number of random configurations."""


def make_stand_row(model: Path) -> str:
    """Load a robot of one file and simulate its stand; return a row of the table."""
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


def describe_verdict(robot: pa.Robot, like: pa.Robot) -> str:
    """Return the verdict and the largest torque of a stand.

    Args:
        robot: Robot to judge.
        like: Robot whose nominal stand supplies height and foot positions.
    """
    places, own = nominal_foot_positions(like), nominal_foot_positions(robot)
    nearest = {
        foot: min(places.values(), key=lambda p: math.dist(p, at)) for foot, at in own.items()
    }
    feet = {foot: (float(place[0]), float(place[1])) for foot, place in nearest.items()}
    try:
        result = study_stance(robot, pa.StandTask(height=like.stand_height, feet=feet))
    except pa.PupperAnalysisError as error:
        return f"{type(error).__name__}: {str(error)[:60]}"
    peak = float(np.abs(result.statics.joint_torques).max())
    return f"{verdict_word(result.verdict).en}: {peak:.5g} N m"


def make_pair_row(urdf: Path, mjcf: Path, seed: int) -> str:
    """Compare the robots of one file with that of both files; return a row of the table."""
    try:
        found = pa.compare_models(urdf, mjcf)
    except pa.PupperAnalysisError as error:
        return f"| {urdf.name} | {mjcf.name} | refused: {str(error)[:60]} | | | | | | |"
    if not found.agree:
        return f"| {urdf.name} | {mjcf.name} | disagree | | | | | | |"
    both = pa.load_robot(urdf, mjcf)
    if not (both.floating and both.feet):
        return f"| {urdf.name} | {mjcf.name} | agree, fixed base or no feet | | | | | | |"
    rng = np.random.default_rng(seed)
    worst, verdicts = [], [describe_verdict(both, both)]
    for one in (pa.load_robot(urdf), pa.load_robot(mjcf)):
        verdicts.append(describe_verdict(one, both))
        named = dict(zip(found.joints, found.joints, strict=True))
        names = [named.get(name, name) for name in both.joint_names]
        if not (set(names) <= set(one.joint_names) and one.floating):
            return f"| {urdf.name} | {mjcf.name} | agree, by other names | | | | | | |"
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
    numbers = " | ".join((f"{both.total_mass:.3f}", *worst, *verdicts))
    return f"| {urdf.name} | {mjcf.name} | agree | {numbers} |"


def list_pairs(folder: Path, written: Path) -> Iterator[tuple[Path, Path]]:
    """Yield pairs of URDF and MJCF: Pupper's variants, those of the corpus, and URDFs with MuJoCo's
    MJCF.
    """
    for name in pa.VARIANTS:
        yield write_variant(name, written / name)
    yield from ((folder / urdf, folder / mjcf) for urdf, mjcf in PAIRS.values())
    for place in CONVERTED.values():
        urdf = folder / DATA / place
        try:
            yield urdf, convert_with_mujoco(urdf, (folder / DATA).parents[1], written)
        except (ValueError, OSError):
            print(f"| {urdf.name} | MuJoCo's own | not compiled | | | | | | |")


@click.command()
@click.option("--folder", type=click.Path(path_type=Path, exists=True), required=True)
@click.option("--each", is_flag=True, help="Stand each robot of one file.")
@click.option("--pairs", is_flag=True, help="Compare the robots of one file with those of both.")
@click.option("--match", default="", help="Only files whose path has this in it.")
@click.option("--seed", default=0, show_default=True)
def main(folder: Path, each: bool, pairs: bool, match: str, seed: int) -> None:
    """Print the tables as Markdown."""
    if each:
        print_each(folder, match)
    if pairs:
        print_pairs(folder, match, seed)


def print_each(folder: Path, match: str) -> None:
    """Print a row per file: verdict, times and torques of the robot of this file alone."""
    print("| file | mass (kg) | verdict | load (s) | with 12 s (s) | torques | forces |")
    print("|---|---|---|---|---|---|---|")
    for model in sorted(path for path in folder.rglob("*") if path.suffix in (".urdf", ".xml")):
        if match in str(model) and kind_of(model):
            print(make_stand_row(model), flush=True)


def print_pairs(folder: Path, match: str, seed: int) -> None:
    """Print a row per pair: differences of the robots of one file from the robot of both files."""
    print(
        "\n| URDF | MJCF | crosscheck | mass (kg) | URDF alone | MJCF alone | both | URDF | MJCF |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as written:
        for urdf, mjcf in list_pairs(folder, Path(written)):
            if match in f"{urdf} {mjcf}":
                print(make_pair_row(urdf, mjcf, seed), flush=True)


if __name__ == "__main__":
    main()
