"""Options of commands that compare two files: whose joint is whose, and which differences count."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.cli import shared

if TYPE_CHECKING:
    from pupper_analysis.robot.matching.tolerances import Tolerances


map_option = click.option(
    "--map",
    "pairs",
    multiple=True,
    metavar="URDF=MJCF",
    help="A joint's or frame's name in the URDF and in the MJCF; e.g. lf_haa=FL_hip. Repeatable.",
)


map_file_option = shared.file_option(
    "--map-file",
    help='TOML file with one such pair per line: "name in the URDF" = "name in the MJCF".',
)


frame_option = click.option(
    "--frame",
    "feet",
    multiple=True,
    metavar="FRAME",
    help="Compare only this frame; e.g. FL_foot. Repeatable. By default all frames that both "
    "files have are compared.",
)


fine_tolerance_option = click.option(
    "--tolerance",
    "changes",
    multiple=True,
    metavar="KIND=VALUE",
    help="Largest difference to ignore, as for crosscheck; e.g. mass=1e-3. Repeatable.",
)


def with_changes(tolerances: Tolerances, changes: tuple[str, ...]) -> Tolerances:
    """Returns tolerances with the changes of --tolerance KIND=VALUE."""
    return tolerances.changed(
        dict(shared.parse_number_assignment("tolerance", text) for text in changes)
    )


def mapped_names(pairs: tuple[str, ...], map_file: Path | None) -> dict[str, str]:
    """Returns {name in the URDF: name in the MJCF} of --map and --map-file."""
    from pupper_analysis.robot.matching.match import read_mapping

    names = read_mapping(map_file) if map_file is not None else {}
    for text in pairs:
        old, new = shared.parse_assignment("map", text)
        if names.setdefault(old, new) != new:
            message = diagnose("mapped-twice", joint=old, one=names[old], two=new)
            raise ConfigurationError("map", message)
    return names
