"""``pupper-analysis diff``: show the changes between two versions of a model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pupper_analysis.cli import shared
from pupper_analysis.cli.shared import change_tolerances, fine_tolerance_option

if TYPE_CHECKING:
    from pupper_analysis.tools.diff.compare import ModelDiff


@shared.command(
    "diff",
    meanings={
        "old": "the old version, a URDF or MJCF, REVISION:PATH, or a variant",
        "new": "the new version, of the same format as the old one",
    },
)
@click.argument("old", type=click.Path())
@click.argument("new", type=click.Path())
@shared.package_option
@fine_tolerance_option
@shared.json_option
@shared.text_format_option
@shared.verbose_option
def command(
    old: str,
    new: str,
    packages: tuple[str, ...],
    changes: tuple[str, ...],
    json_path: Path | None,
    style: str,
    everything: bool,
) -> None:
    """Show the changes of the robot between OLD and NEW: two URDFs, or two MJCFs.

    Each changed number is shown with its lines in both files and its effect on the dynamics, then
    the change in total mass; with -v, the change in the torques that hold the links in the air.
    Moved text, moved link frames and other ways to write the same robot are not changes. OLD or NEW
    may be REVISION:PATH, a file in git's history, or the name of a variant.

    \b
    Examples:
      pupper-analysis diff HEAD:robots/go1.urdf robots/go1.urdf
      pupper-analysis diff v1.0:./robot.xml main:./robot.xml
      pupper-analysis diff robot.urdf longer.urdf --tolerance mass=1e-3
      pupper-analysis diff v3 v3-heavy

    Exit status: 0 the robot is the same, 1 the robot has changed, 2 bad input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.robot.matching.tolerances import Tolerances
    from pupper_analysis.tools.diff.compare import diff_models

    tolerances = change_tolerances(Tolerances.strict(), changes)
    folders = shared.parse_packages(packages)
    with shared.show_progress("comparing both versions"), open_variants(old, new) as files:
        result = diff_models(*files, packages=folders, tolerances=tolerances)
    result = name_variants(result, dict(zip(files, (old, new), strict=True)))
    shared.show_results([("", result)], style, everything=everything)
    shared.finish_command(json_path, result, passed=result.same)


@contextmanager
def open_variants(old: str, new: str) -> Iterator[tuple[str, str]]:
    """Yield both arguments, with a file in place of each name of a variant.

    The file is the URDF of the variant if the other argument ends with ``.urdf``, else its MJCF.

    Raises:
        VariantError: If an argument is probably a misspelled variant name.
    """
    from pupper_analysis.pupper.named_robots import (
        is_variant,
        refuse_unknown_variant,
        variant_model_files,
    )

    found = []
    with ExitStack() as stack:
        for word, other in ((old, new), (new, old)):
            if is_variant(word):
                urdf, mjcf = stack.enter_context(variant_model_files(word))
                found.append(str(urdf if other.lower().endswith(".urdf") else mjcf))
            else:
                refuse_unknown_variant(word)
                found.append(word)
        yield found[0], found[1]


def name_variants(result: ModelDiff, words: Mapping[str, str]) -> ModelDiff:
    """Return a result that names the arguments of the command in place of the compared files.

    The file of a scaled variant is temporary; the name of the variant can be typed again.

    Args:
        result: Result with the paths of the compared files.
        words: {compared file: argument}.
    """

    def name(place: str) -> str:
        """Replace the file in ``file:line`` by the command-line argument that specified it."""
        file, separator, line = place.rpartition(":")
        return f"{words[file]}{separator}{line}" if file in words else words.get(place, place)

    changes = tuple(
        replace(change, old_place=name(change.old_place), new_place=name(change.new_place))
        for change in result.changes
    )
    return replace(result, old=name(result.old), new=name(result.new), changes=changes)
