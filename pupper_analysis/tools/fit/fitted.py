"""Writes what a fit found: models, offsets, and ranges for those who train policies."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import orjson

from pupper_analysis.base.errors import InputError
from pupper_analysis.base.files import Writing, write_together
from pupper_analysis.base.inputs import MOST_TEXT, read_input
from pupper_analysis.base.kinds import FIT_FOLDER
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.fit.estimate import Posterior
from pupper_analysis.tools.fit.write import FitFiles, fit_files
from pupper_analysis.tools.study.randomisation import randomisation_text


def write_fit(
    robot: Robot,
    posterior: Posterior,
    folder: str | Path,
    *,
    fit: object = None,
    files: tuple[Path | None, Path | None] | None = None,
    packages: Mapping[str, Path] | None = None,
    force: bool = False,
) -> FitFiles:
    """Writes a fit to a folder: all of its files, or none.

    The corrected URDF and MJCF, with the meshes and included files that they need, as they stand to
    each other; no byte of the models is another but those of numbers that changed. ``fit.json``
    has all parameters with their covariance, ``offsets.csv`` what encoders show beyond the angle
    (take it from a position, add it to a command), and ``ranges.yaml`` how the corrected models'
    numbers are spread: factors and offsets by the names that studies have.

    Args:
        robot: The robot, as its files have it.
        posterior: What is known of its parameters.
        folder: Where to; made if need be.
        fit: The result that is told in ``fit.json``, too.
        files: The URDF and the MJCF, if they are not those that the robot was loaded from.
        packages: {ROS package: its folder}, for ``package://`` paths.
        force: Replace files that no fit has written, or that were edited since; but never those
            that the robot was loaded from.

    Returns:
        What was written.

    Raises:
        FitError: If no bodies can be near the estimate.
        ModelError: If not all numbers can be written.
        OutputError: If a file cannot be or must not be replaced, or is one that the robot was
            loaded from.
    """
    folder = Path(folder)
    made = fit_files(robot, posterior, fit=fit, files=files, packages=packages)
    contents = dict(made.contents)
    if made.spreads:
        contents[Path("ranges.yaml")] = randomisation_text(made.spreads, "yaml")[0].encode()
    writings = made.models.writings(folder, _made_before(folder), force=force)
    writings += [
        Writing(folder / name, content, FIT_FOLDER.files[name.name], force=force)
        for name, content in contents.items()
    ]
    write_together(writings)
    return made


def _made_before(folder: Path) -> dict[str, str]:
    """Returns {place: hash} of the models that a fit has written to that folder."""
    try:
        found = orjson.loads(read_input(folder / "fit.json", MOST_TEXT, own=True))
        return {str(place): str(known) for place, known in found["files"].items()}
    except (InputError, ValueError, TypeError, KeyError, AttributeError):
        return {}
