"""``pupper-analysis contract``: compare trainer, deployment, firmware and model."""

from __future__ import annotations

from pathlib import Path

import click

from pupper_analysis.cli import shared


@shared.command(
    "contract", meanings={"sources": "a model, and the files of trainer, deployment or policy"}
)
@click.argument("sources", nargs=-1, required=True, type=click.Path())
@click.option(
    "--map",
    "pairs",
    multiple=True,
    metavar="NAME=JOINT",
    help="Name of a joint in a source and in the model, if the names are not matched. Repeatable.",
)
@click.option(
    "--no-stand",
    "unstood",
    is_flag=True,
    help=("Do not solve and simulate the stand in the default poses."),
)
@click.option(
    "--fail-on",
    type=click.Choice(["error", "warning", "note"]),
    default="warning",
    show_default=True,
    help="Lowest severity that makes the exit status 1.",
)
@shared.all_option
@shared.json_option
@shared.report_option
@shared.format_option
def command(
    sources: tuple[str, ...],
    pairs: tuple[str, ...],
    unstood: bool,
    fail_on: str,
    everything: bool,
    json_path: Path | None,
    report_path: Path | None,
    style: str,
) -> None:
    """Find disagreements between training configuration, deployment and model of a robot.

    SOURCES are the model (URDF, MJCF or USD) and files with numbers of its joints: configurations
    of mjlab, Isaac Lab and legged_gym in Python, YAML of deployments and of ROS 2 controllers,
    policies with metadata (ONNX, RTNeural's JSON). Joint order, signs, default angles, action
    scales and offsets, gains, limits, armature, friction, rates and observations are compared; each
    difference is shown with its line in both files and, if known, its effect.

    No source is imported or run. FILE:NAME selects one of several configurations in a file.
    A folder is searched for imported modules, and its deployments of this robot are read.

    \b
    Examples:
      pupper-analysis contract go2.xml env_cfgs.py deploy.yaml
      pupper-analysis contract go2.urdf unitree.py:UNITREE_GO2_CFG
      pupper-analysis contract pupper_v3.urdf pupper_v3.xml config.yaml \\
        policy.json -v
      pupper-analysis contract g1.xml env_cfgs.py deploy.yaml --format sarif

    Exit status: 0 all differences are less severe than --fail-on, 1 otherwise, 2 bad input.
    Also 1 if a source, a quantity or a joint name was not compared, or if there was nothing to
    compare, except with --fail-on error.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.present import formats
    from pupper_analysis.present.document import NextStep
    from pupper_analysis.tools.contract.contract import read_contract
    from pupper_analysis.tools.contract.document import (
        list_proposed_matches,
        make_contract_annotations,
        select_next_step,
    )

    names = dict(shared.parse_assignment("map", pair) for pair in pairs)
    with shared.show_progress("reading the sources, and standing the robot in them"):
        result = read_contract(*sources, names=names, stand=not unstood, fail_on=fail_on)
    if style in ("text", "markdown"):
        matches = list_proposed_matches(result)
        words = [word for name, joint in matches.items() for word in ("--map", f"{name}={joint}")]
        again = NextStep("contract", (*sources, *words))
        step = again if matches else select_next_step(result, sources)
        shared.show_results([("", result)], style, everything=everything, next_step=step)
    else:
        click.echo(
            formats.write_annotations(
                style,
                make_contract_annotations(result),
                f"pupper-analysis contract {Path(result.model).name}",
            )
        )
    shared.write_page(report_path, result)
    shared.finish_command(json_path, result, passed=result.passed)
