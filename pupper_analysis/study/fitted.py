"""Writes what a fit found: models, offsets, and ranges for those who train policies."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from pupper_analysis.identification.estimate import Posterior
from pupper_analysis.identification.write import FitFiles, fit_files
from pupper_analysis.robot.robot import Robot
from pupper_analysis.study.randomisation import randomisation_text
from pupper_analysis.together import Writing, write_together


def write_fit(
    robot: Robot,
    posterior: Posterior,
    folder: str | Path,
    *,
    fit: object = None,
    files: tuple[Path | None, Path | None] | None = None,
    packages: Mapping[str, Path] | None = None,
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

    Returns:
        What was written.

    Raises:
        FitError: If no bodies can be near the estimate.
        ModelError: If not all numbers can be written.
        OutputError: If a file cannot be, or is one that the robot was loaded from.
    """
    folder = Path(folder)
    made = fit_files(robot, posterior, fit=fit, files=files, packages=packages)
    writings = made.models.writings(folder)
    writings += [Writing(folder / name, content) for name, content in made.contents.items()]
    if made.spreads:
        text, _ = randomisation_text(made.spreads, "yaml")
        writings.append(Writing(folder / "ranges.yaml", text.encode()))
    write_together(writings)
    return made
