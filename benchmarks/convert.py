"""Converters side by side: `python benchmarks/convert.py --robots FOLDER` prints a table.

FOLDER is a site-packages folder with robots of others (see benchmarks/corpus.py). With `--others`
BIN, other converters are tried, too; BIN is the `bin` of an environment that has them:

    python -m venv VENV && VENV/bin/pip install scikit-robot urdf2mjcf urdf-to-mjcf

Each URDF is converted with the converters' own defaults, and a free base where they have an option
for it. What comes out is judged by `compare_models`, and by `load_robot` and `verify_stand`, which
make up for what is missing.
"""

from __future__ import annotations

import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import click
import mujoco
from corpus import CONVERTED, DATA, GYM
from corpus import converted as by_mujoco
from rich.console import Console

import pupper_analysis as pa
from pupper_analysis.models.urdf_file import read_urdf
from pupper_analysis.models.xml import to_text

ROOT = Path(__file__).resolve().parents[1]

FURTHER = {
    "Go1": f"{DATA}/go1_description/urdf/go1.urdf",
    "B1": f"{DATA}/b1_description/urdf/b1.urdf",
    "HyQ": f"{DATA}/hyq_description/robots/hyq_no_sensors.urdf",
    "ANYmal B": f"{DATA}/anymal_b_simple_description/robots/anymal.urdf",
    "Mini Cheetah": f"{GYM}/mini_cheetah/mini_cheetah.urdf",
    "HyQReal1": f"{GYM}/hyqreal1/hyqreal1.urdf",
    "HyQReal2": f"{GYM}/hyqreal2/hyqreal2.urdf",
    "Panda (an arm)": f"{DATA}/panda_description/urdf/panda.urdf",
    "UR5 (an arm)": f"{DATA}/ur_description/urdf/ur5_robot.urdf",
}

LIMIT = 300
"""Seconds that a converter may take."""

Converter = Callable[[Path, Path], Path]


def ours(urdf: Path, output: Path) -> Path:
    """Converts by this package, proof included; returns the new file."""
    pa.convert_model(urdf, output)
    return output


def command(*words: str) -> Converter:
    """Converts by a command; {urdf} and {output} stand for the files."""

    def convert(urdf: Path, output: Path) -> Path:
        local = output.with_name(urdf.name)
        file = read_urdf(urdf)
        for mesh in file.root.iter("mesh"):  # they find meshes by their paths alone
            found = file.resolve_mesh(str(mesh.get("filename")))
            mesh.set("filename", str(mesh.get("filename") if found is None else found.resolve()))
        local.write_text(to_text(file.root))
        filled = [word.format(urdf=local, output=output) for word in words]
        done = subprocess.run(filled, capture_output=True, text=True, timeout=LIMIT, check=False)
        made = [output] if output.exists() else sorted(output.parent.rglob("*.xml"))
        if done.returncode or not made:
            lines = [line for line in done.stderr.splitlines() if "Error" in line]
            raise RuntimeError(lines[-1] if lines else f"exit status {done.returncode}")
        return made[0]

    return convert


def judged(urdf: Path, mjcf: Path) -> str:
    """What a comparison and a stand say of a new file."""
    try:
        compared = pa.compare_models(urdf, mjcf, configurations=5)
    except pa.PupperAnalysisError as error:
        return f"refused: {_short(error)}"
    found = "agrees" if compared.agree else f"{len(compared.differences)} differences"
    if not compared.agree:
        found += f" ({max(compared.deviations.values()):.0%})"
    try:
        robot = pa.load_robot(urdf=urdf, mjcf=mjcf)
        if not robot.floating:
            return found
        run = pa.verify_stand(robot, pa.stance.solve_stand_on_soft_ground(robot), duration=12.0)
        return f"{found}, {'stands' if run.passed else 'does not stand'}"
    except pa.PupperAnalysisError:
        return f"{found}, does not stand"


def _short(error: Exception) -> str:
    text = str(error).split(": ", 1)[-1]
    return text[:70].replace("|", "/")


@click.command()
@click.option("--robots", type=click.Path(path_type=Path, exists=True), required=True)
@click.option("--others", type=click.Path(path_type=Path, exists=True), help="Their bin folder.")
@click.option("--only", multiple=True, help="Robots; repeatable.")
def main(robots: Path, others: Path | None, only: tuple[str, ...]) -> None:
    """Print a table of converters by robots."""
    converters: dict[str, Converter] = {
        "pupper-analysis": ours,
        f"MuJoCo {mujoco.__version__}": lambda urdf, output: _mujoco(urdf, robots, output.parent),
    }
    for name, words in (
        ("convert-urdf-to-mjcf", ("{urdf}", "-o", "{output}", "--floating-base")),
        ("urdf2mjcf", ("{urdf}", "--output", "{output}")),
        ("urdf-to-mjcf", ("{urdf}", "-o", "{output}")),
    ):
        if others is not None and (others / name).exists():
            converters[name] = command(str(others / name), *words)
    corpus = {"Pupper v3": ROOT / "urdf" / "pupper_v3.urdf"}
    corpus |= {name: robots / DATA / path for name, path in CONVERTED.items()}
    corpus |= {name: robots / path for name, path in FURTHER.items()}
    out = Console(width=400, highlight=False)
    out.print(f"| robot | {' | '.join(converters)} |")
    out.print("|---" * (len(converters) + 1) + "|")
    for name, urdf in corpus.items():
        if only and name not in only:
            continue
        cells = []
        for convert in converters.values():
            with tempfile.TemporaryDirectory() as folder:
                output = Path(folder) / "new.xml"
                begin = time.perf_counter()
                try:
                    made = convert(urdf, output)
                    seconds = time.perf_counter() - begin
                    cells.append(f"{judged(urdf, made)} ({seconds:.1f} s)")
                except Exception as error:
                    cells.append(f"fails: {_short(error)}")
        out.print(f"| {name} | {' | '.join(cells)} |", soft_wrap=True, markup=False)


def _mujoco(urdf: Path, robots: Path, folder: Path) -> Path:
    return by_mujoco(urdf, (robots / DATA).parents[1], folder)


if __name__ == "__main__":
    main()
