"""Compare converters from URDF to MJCF: `python benchmarks/convert.py --robots FOLDER` prints a
table.

FOLDER is a site-packages folder with public robots (see benchmarks/corpus.py). With `--others` BIN,
other converters are run, too; BIN is the `bin` folder of an environment that contains them:

    python -m venv VENV && VENV/bin/pip install scikit-robot urdf2mjcf urdf-to-mjcf

Each URDF is converted with the default options of the converter, and with a free base if there is
an option for it. The result is evaluated by `compare_models`, and by `load_robot` and
`verify_stand`, which add missing elements.
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
from corpus import convert_with_mujoco as by_mujoco
from rich.console import Console

import pupper_analysis as pa
from pupper_analysis.models.urdf_file import read_urdf
from pupper_analysis.models.xml import to_text

PROJECT_FOLDER = Path(__file__).resolve().parents[1]
"""Root folder of this project."""

FURTHER_URDFS = {
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
"""{robot: URDF in FOLDER} in addition to `corpus.CONVERTED`."""

MAX_TIME = 300
"""Maximum time of a conversion [s]."""

Converter = Callable[[Path, Path], Path]


def convert_with_package(urdf: Path, output: Path) -> Path:
    """Convert a URDF with this package, which verifies the result; return the new file."""
    pa.convert_model(urdf, output)
    return output


def make_command_converter(*words: str) -> Converter:
    """Return a function that converts with a command of another package.

    Args:
        *words: Words of the command; ``{urdf}`` and ``{output}`` are replaced by the paths.
    """

    def convert(urdf: Path, output: Path) -> Path:
        local = output.with_name(urdf.name)
        file = read_urdf(urdf)
        for mesh in file.root.iter("mesh"):  # they find meshes by their paths alone
            found = file.resolve_mesh(str(mesh.get("filename")))
            mesh.set("filename", str(mesh.get("filename") if found is None else found.resolve()))
        local.write_text(to_text(file.root))
        filled = [word.format(urdf=local, output=output) for word in words]
        done = subprocess.run(filled, capture_output=True, text=True, timeout=MAX_TIME, check=False)
        made = [output] if output.exists() else sorted(output.parent.rglob("*.xml"))
        if done.returncode or not made:
            lines = [line for line in done.stderr.splitlines() if "Error" in line]
            raise RuntimeError(lines[-1] if lines else f"exit status {done.returncode}")
        return made[0]

    return convert


def describe_conversion(urdf: Path, mjcf: Path) -> str:
    """Return a text with the results of the comparison and of the simulated stand of a new file."""
    try:
        compared = pa.compare_models(urdf, mjcf, configurations=5)
    except pa.PupperAnalysisError as error:
        return f"refused: {_shorten_error(error)}"
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


def _shorten_error(error: Exception) -> str:
    """Return the message of an error without prefix, at most 70 characters."""
    text = str(error).split(": ", 1)[-1]
    return text[:70].replace("|", "/")


@click.command()
@click.option("--robots", type=click.Path(path_type=Path, exists=True), required=True)
@click.option("--others", type=click.Path(path_type=Path, exists=True), help="Their bin folder.")
@click.option("--only", multiple=True, help="Robots; repeatable.")
def main(robots: Path, others: Path | None, only: tuple[str, ...]) -> None:
    """Print a table of converters and robots."""
    converters: dict[str, Converter] = {
        "pupper-analysis": convert_with_package,
        f"MuJoCo {mujoco.__version__}": lambda urdf, output: _convert_with_mujoco(
            urdf, robots, output.parent
        ),
    }
    for name, words in (
        ("convert-urdf-to-mjcf", ("{urdf}", "-o", "{output}", "--floating-base")),
        ("urdf2mjcf", ("{urdf}", "--output", "{output}")),
        ("urdf-to-mjcf", ("{urdf}", "-o", "{output}")),
    ):
        if others is not None and (others / name).exists():
            converters[name] = make_command_converter(str(others / name), *words)
    corpus = {"Pupper v3": PROJECT_FOLDER / "urdf" / "pupper_v3.urdf"}
    corpus |= {name: robots / DATA / path for name, path in CONVERTED.items()}
    corpus |= {name: robots / path for name, path in FURTHER_URDFS.items()}
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
                    cells.append(f"{describe_conversion(urdf, made)} ({seconds:.1f} s)")
                except Exception as error:
                    cells.append(f"fails: {_shorten_error(error)}")
        out.print(f"| {name} | {' | '.join(cells)} |", soft_wrap=True, markup=False)


def _convert_with_mujoco(urdf: Path, robots: Path, folder: Path) -> Path:
    """Convert a URDF with MuJoCo's own importer; return the new file."""
    return by_mujoco(urdf, (robots / DATA).parents[1], folder)


if __name__ == "__main__":
    main()
