"""List defects of public robots, each with a proof that does not use this package.

    python benchmarks/public_defects.py --csv docs/data/public-defects.csv OWNER/NAME@COMMIT=FOLDER

FOLDER is a checkout of the repository at the commit; several are possible. The findings of `audit`
about masses, inertias, limits and efforts are listed (`PROOFS`), with line, value and remedy. Each
is proven from the text of the file alone: by numpy, by trimesh, or by MuJoCo, which compiles the
stated inertial as a single body. A finding whose proof fails is listed with `not proven`.

Equal findings in several files of a repository are one row. `--sample N` prints N random findings
of all rules, for a judgement by eye.
"""

from __future__ import annotations

import json
import math
import random
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import click
import mujoco
import numpy as np
from lxml import etree
from tables import write_csv

import pupper_analysis as pa

Element = Any
"""Element of lxml."""

TENSOR = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
"""Attributes of <inertia>, in the order of MuJoCo's ``fullinertia``."""


def read_tensor(link: Element) -> np.ndarray:
    """Return the inertia tensor of a link, shape (3, 3) [kg m^2], in the frame of its inertial."""
    tag = link.find("inertial/inertia")
    xx, yy, zz, xy, xz, yz = (float(tag.get(word, 0)) for word in TENSOR)
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def prove_by_mujoco(link: Element) -> str | None:
    """Return the reason for which MuJoCo refuses the inertial of a link; None if it accepts it."""
    tag, mass = link.find("inertial/inertia"), link.find("inertial/mass").get("value")
    numbers = " ".join(tag.get(word, "0") for word in TENSOR)
    text = (
        '<mujoco><worldbody><body><freejoint/><inertial pos="0 0 0" '
        f'mass="{mass}" fullinertia="{numbers}"/></body></worldbody></mujoco>'
    )
    try:
        mujoco.MjModel.from_xml_string(text)
    except ValueError as error:
        return f"MuJoCo: {str(error).splitlines()[0].removeprefix('Error: ')}"
    return None


def prove_tensor(link: Element) -> str | None:
    """Return the principal moments of an impossible tensor, and MuJoCo's refusal if it refuses."""
    moments = np.linalg.eigvalsh(read_tensor(link))
    impossible = moments[0] <= 0 or moments[0] + moments[1] < moments[2]
    refusal = prove_by_mujoco(link)
    texts = [f"numpy: principal moments {', '.join(f'{value:.4g}' for value in moments)} kg m^2"]
    return "; ".join(texts + [refusal] * (refusal is not None)) if impossible else None


def prove_gyration(link: Element) -> str | None:
    """Return the radius of gyration of a link above 1 m."""
    mass = float(link.find("inertial/mass").get("value"))
    radius = math.sqrt(float(np.linalg.eigvalsh(read_tensor(link)).max()) / mass)
    return f"numpy: radius of gyration {radius:.3g} m" if radius > 1 else None


def prove_limit(joint: Element) -> str | None:
    """Return the limits of a joint with lower >= upper, or with an effort or velocity <= 0."""
    limit = joint.find("limit")
    if limit is None:
        return None
    bad = [
        f'{word}="{limit.get(word)}"'
        for word in ("effort", "velocity")
        if float(limit.get(word, 1)) <= 0
    ]
    lower, upper = (float(limit.get(word, 0)) for word in ("lower", "upper"))
    if joint.get("type") in ("revolute", "prismatic") and lower >= upper:
        bad.append(f'lower="{lower:g}" upper="{upper:g}"')
    return f"text: {', '.join(bad)}" if bad else None


def prove_mass(link: Element) -> str | None:
    """Return the text of a mass that is not positive, or that is missing."""
    mass = link.find("inertial/mass")
    if mass is None:
        return "text: no <inertial>"
    value = float(mass.get("value"))
    return f'text: mass="{mass.get("value")}"' if value <= 0 else None


PROOFS: dict[str, Callable[[Element], str | None]] = {
    "triangle-inequality": prove_tensor,
    "inertia-not-positive-definite": prove_tensor,
    "inertia-implausible": prove_gyration,
    "range-empty": prove_limit,
    "effort-or-velocity-zero": prove_limit,
    "effort-negative": prove_limit,
    "mass-not-positive": prove_mass,
    "moving-body-without-mass": prove_mass,
}
"""{rule of the audit: function that proves it from the element; None if not proven}."""

COUNTED = ("one-density",)
"""Rules that are proven from the whole file."""


def prove_one_density(path: Path, root: Element, packages: dict[str, Path]) -> str | None:
    """Return the ratios of mass and volume that trimesh computes from the meshes of the links."""
    import trimesh

    densities = []
    for link in root.iterfind("link"):
        mesh, mass = link.find("visual/geometry/mesh"), link.find("inertial/mass")
        if mesh is None or mass is None:
            continue
        name = mesh.get("filename", "")
        package, _, inside = name.removeprefix("package://").partition("/")
        file = packages[package] / inside if package in packages else path.parent / name
        if not file.is_file():
            continue
        body = trimesh.load(file, force="mesh")
        if body.is_volume and body.volume > 0:
            scale = [float(part) for part in mesh.get("scale", "1 1 1").split()]
            densities.append(float(mass.get("value")) / (abs(body.volume) * math.prod(scale)))
    if len(densities) < 4:
        return None
    middle = float(np.median(densities))
    close = sum(abs(value / middle - 1) < 0.01 for value in densities)
    if close < 0.75 * len(densities):
        return None
    return f"trimesh: {close} of {len(densities)} masses are volume x {middle:.4g} kg/m^3"


def list_packages(path: Path, top: Path) -> dict[str, Path]:
    """Return {name: folder} of all folders above a file, within the checkout."""
    return {folder.name: folder for folder in path.parents if top in (folder, *folder.parents)}


def describe_remedy(repair: Any) -> str:
    """Return the changed attributes of a repair: ``inertia ixx -0.2 -> 0.2``."""
    return "; ".join(
        f"{change.child.rpartition('/')[2]} {word} {change.old[word]} -> {new}".replace("  ", " ")
        for change in repair.list_changes()
        for word, new in change.new.items()
    )


def list_rows(name: str, top: Path, found: list[tuple[Path, Any]]) -> Iterator[tuple[Any, ...]]:
    """Yield a row for each defect of the files of a repository, equal defects of files once."""
    seen: dict[tuple[str, str, str], list[Any]] = {}
    for path, finding in found:
        if finding.rule not in (*PROOFS, *COUNTED) or finding.severity == "note":
            continue
        root = etree.parse(str(path)).getroot()
        kind, _, quoted = finding.element.partition(" ")
        elements = [e for e in root.iterfind(kind) if e.get("name") == quoted.strip("'")]
        if finding.rule in COUNTED:
            proof = prove_one_density(path, root, list_packages(path, top))
        else:
            proof = PROOFS[finding.rule](elements[0]) if elements else None
        if finding.rule == "inertia-implausible" and proof is None:
            continue  # a matter of judgement, not of proof
        remedy = describe_remedy(finding.repairs[0]) if len(finding.repairs) == 1 else ""
        key = (finding.rule, finding.element, finding.message)
        row = seen.setdefault(
            key,
            [
                name,
                f"{path.relative_to(top)}:{finding.line}",
                0,
                finding.rule,
                finding.element,
                finding.message,
                remedy,
                proof or "not proven",
            ],
        )
        row[2] += 1
    yield from map(tuple, seen.values())


COLUMNS = (
    "repository", "file and line", "files", "rule", "element", "finding", "remedy", "proof",
)  # fmt: skip
"""Columns of the table. ``files`` is the number of files of the repository with this finding."""


@click.command()
@click.argument("sources", nargs=-1, required=True)
@click.option("--csv", "to", type=click.Path(path_type=Path), help="Write the table here.")
@click.option("--sample", type=int, default=0, help="Print N random findings of all rules.")
@click.option("--seed", type=int, default=0, show_default=True, help="Of the sample.")
def main(sources: tuple[str, ...], to: Path | None, sample: int, seed: int) -> None:
    """Audit all URDFs of checkouts, and list the defects that are proven."""
    rows, all_findings = [], []
    for source in sources:
        name, _, folder = source.rpartition("=")
        top = Path(folder).resolve()
        found = []
        for path in sorted(top.rglob("*.urdf")):
            try:
                audit = pa.audit_model(path, packages=list_packages(path, top))
            except pa.PupperAnalysisError as error:
                click.echo(f"{path}: {error!s:.100}", err=True)
                continue
            found += [(path, finding) for finding in audit.findings]
        rows += list_rows(name, top, found)
        all_findings += [(name, path, f) for path, f in found if f.severity != "note"]
        click.echo(f"{name}: {len(found)} findings", err=True)
    for name, path, finding in random.Random(seed).sample(
        all_findings, min(sample, len(all_findings))
    ):
        click.echo(json.dumps([name, path.name, finding.line, str(finding)]))
    if to is not None:
        write_csv(to, COLUMNS, rows)
    proven = sum(row[-1] != "not proven" for row in rows)
    click.echo(f"{len(rows)} defects, {proven} proven")


if __name__ == "__main__":
    main()
