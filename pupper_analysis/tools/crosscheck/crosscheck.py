"""Compares two files of a robot, and evaluates both in both engines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import Diagnostic, Term, diagnose
from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.robot.compare.compare import FilesCompared, compare_files
from pupper_analysis.robot.compare.differences import Explanation
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.tools.crosscheck.engines import (
    OF_ONE_MODEL,
    OF_THE_MJCF,
    CrossCheck,
    check_states,
    cross_check,
)

ENGINES_AGREE = 1e-8
"""How far the two engines may deviate on one model, relative to a quantity's scale."""


@dataclass(frozen=True, eq=False)
class Comparison(FilesCompared):
    """What became of the comparison of a URDF with an MJCF, and of the cross-check.

    Attributes:
        check: The cross-check: both models in both engines.
        engines: Quantities on which the engines deviate for one and the same model.
    """

    check: CrossCheck
    engines: tuple[Diagnostic, ...]


@check_arguments
@silence_mujoco()
def compare_models(
    urdf: str | Path,
    mjcf: str | Path,
    *,
    names: Mapping[str, str] | None = None,
    packages: Mapping[str, Path] | None = None,
    feet: Sequence[str] = (),
    tolerances: Tolerances | None = None,
    strict_names: bool = False,
    any_coordinates: bool = False,
    same_mount: bool = False,
    configurations: int = 20,
    seed: int = 0,
) -> Comparison:
    """Compares a URDF with an MJCF of the same robot, and explains how they differ.

    A file of another format (`base.tools.formats`) may stand in the place of either.

    Args:
        urdf: Path of the URDF, or what stands for it.
        mjcf: Path of the MJCF, or what stands for it.
        names: {name in the URDF: name in the MJCF} of joints and frames whose names differ.
        packages: {ROS package: its folder}, for ``package://`` paths.
        feet: Frames, by their names in the MJCF, that count as feet; by default all frames that
            both files have are compared.
        tolerances: What counts as a difference; by default for files of 5 to 6 digits.
        strict_names: Joints that are matched by structure, not by their name or by ``names``, are
            a difference; otherwise `guessed` alone tells of them. So are damping and dry friction
            that the URDF does not state; otherwise a note tells of them.
        any_coordinates: Joints' zeros, moved with their limits, and a free base's frame may be
            elsewhere: notes tell of them. By default they are differences, because qpos means
            another pose.
        same_mount: A fixed base that is tilted against the URDF's is an objection; otherwise
            `mount` alone tells of it.
        configurations: Number of random configurations of the cross-check.
        seed: Of the random numbers, 0 or more.

    Returns:
        The comparison.

    Raises:
        ModelError: If a file cannot be read, or the two cannot be matched.
        MissingPackageError: If what reads the format of one is not installed.
        UnknownNameError: If a name is not in its file.
        ConfigurationError: If an argument is out of its range.
    """
    check_states(configurations, seed)
    tolerances = tolerances or Tolerances()
    compared = compare_files(
        urdf,
        mjcf,
        names=names,
        packages=packages,
        feet=feet,
        tolerances=tolerances,
        strict_names=strict_names,
        any_coordinates=any_coordinates,
        same_mount=same_mount,
    )
    check = cross_check(
        compared.matched.robot,
        configurations=configurations,
        tolerance=tolerances.dynamics,
        seed=seed,
        mimics=compared.matched.mimics,
        moved=compared.alignment.moved,
    )
    own = {one.name: getattr(compared.result, one.name) for one in fields(compared.result)}
    return Comparison(**own, check=check, engines=_engines(check, compared.explanation))


def _engines(check: CrossCheck, explanation: Explanation) -> tuple[Diagnostic, ...]:
    """Says where the engines deviate for one and the same model."""
    return tuple(
        diagnose(
            "engines-deviate",
            subject=("quantity", quantity.name),
            relative=relative,
            edge=Term(whose),
        )
        for quantity in check.quantities
        for whose, relative in quantity.edges.items()
        if whose in OF_ONE_MODEL
        and relative > ENGINES_AGREE
        # With forces of MuJoCo's that a tree of joints has not, the two got different models.
        and not (explanation.remains and whose in OF_THE_MJCF)
    )
