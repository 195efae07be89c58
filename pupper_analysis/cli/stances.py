"""``pupper-analysis stand`` and ``push``: how robots stand, and what makes them fall."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from pupper_analysis.cli.shared import (
    ANGLE,
    CONTEXT,
    FAILED,
    LENGTH,
    assignment,
    check_outputs,
    figure_option,
    json_option,
    length,
    point,
    write_json,
)
from pupper_analysis.errors import ConfigurationError

if TYPE_CHECKING:
    from pupper_analysis.robot.robot import Robot


@click.command(context_settings=CONTEXT, short_help="Solve a stance: its cost, and if it holds.")
@click.argument("name", required=False)
@click.option("--urdf", type=click.Path(path_type=Path), help="A robot of your own: its URDF ...")
@click.option("--mjcf", type=click.Path(path_type=Path), help="... its MJCF ...")
@click.option(
    "--foot",
    "feet",
    multiple=True,
    metavar="NAME=FRAME",
    help="... and a foot's frame. Repeatable.",
)
@click.option("--height", type=LENGTH, help="Base above the contact points (m).")
@click.option("--roll", type=ANGLE, default=0.0, help="Roll of the base (rad).")
@click.option("--pitch", type=ANGLE, default=0.0, help="Pitch of the base (rad).")
@click.option("--yaw", type=ANGLE, default=0.0, help="Yaw against the feet (rad).")
@click.option("--offset", metavar="X,Y", help="Base from the centre of the feet (m).")
@click.option("--com", default="centre", metavar="X,Y", help="Com at (m), or: centre, inside.")
@click.option("--com-margin", type=LENGTH, default=0.0, help="Inside the polygon (m).")
@click.option("--joint-margin", type=ANGLE, default=0.0, help="Off the limits (rad).")
@click.option("--ground-clearance", type=LENGTH, default=0.0, help="All but the feet (m).")
@click.option("--self-clearance", type=LENGTH, help="Between links (m).")
@click.option("--move", "moves", multiple=True, metavar="FOOT=X,Y", help="Foot off its place (m).")
@click.option("--swing", "lifts", multiple=True, metavar="FOOT=LENGTH", help="Foot lifted by (m).")
@click.option("--step", "steps", multiple=True, metavar="FOOT=LENGTH", help="Step under it (m).")
@click.option("--slope", type=ANGLE, default=0.0, help="Slope of the ground (rad).")
@click.option("--uphill", type=ANGLE, default=0.0, help="Where it rises (rad).")
@click.option("--kp", type=float, metavar="NM", help="Servo stiffness (N m/rad), not the model's.")
@click.option("--kd", type=float, metavar="NMS", help="Servo damping (N m s/rad), likewise.")
@click.option(
    "--best",
    type=click.Choice(["utilisation", "margin", "payload"]),
    help="Search for the best: the base's pose and the place of each foot are free.",
)
@click.option("--payload-at", default="0,0,0", metavar="X,Y,Z", help="In the base's frame (m).")
@click.option("--minimum-stiffness", is_flag=True, help="Also the softest servos that carry it.")
@click.option("--workspace", is_flag=True, help="Also how far the base can go from there.")
@click.option(
    "--workspace-figure", type=click.Path(path_type=Path), help="Draw that: a PNG.", metavar="PATH"
)
@click.option("--push", "pushed", is_flag=True, help="Also the largest pushes it survives.")
@click.option("--path", "seconds", type=float, metavar="S", help="Also move there in S seconds.")
@click.option("--csv", type=click.Path(path_type=Path), help="Write the path's commands here.")
@click.option("--npz", type=click.Path(path_type=Path), help="Write the path's arrays here.")
@figure_option
@json_option
def stand(
    name: str | None,
    urdf: Path | None,
    mjcf: Path | None,
    feet: tuple[str, ...],
    height: float | None,
    roll: float,
    pitch: float,
    yaw: float,
    offset: str | None,
    com: str,
    com_margin: float,
    joint_margin: float,
    ground_clearance: float,
    self_clearance: float | None,
    moves: tuple[str, ...],
    lifts: tuple[str, ...],
    steps: tuple[str, ...],
    slope: float,
    uphill: float,
    kp: float | None,
    kd: float | None,
    best: str | None,
    payload_at: str,
    minimum_stiffness: bool,
    workspace: bool,
    workspace_figure: Path | None,
    pushed: bool,
    seconds: float | None,
    csv: Path | None,
    npz: Path | None,
    figure: Path | None,
    json_path: Path | None,
) -> None:
    """Solve a stance; print joint angles, what the motors hold, and whether it lasts.

    NAME is a variant (v3 by default). A robot of your own is a URDF, an MJCF, and the frames at the
    centres of its feet, which both files name; if it has no position servos, give --kp and --kd.

    Lengths are in m and angles in rad, or have a unit: 20mm, 2cm, 5deg.

    A stance that is out of reach is refused with what would be possible. One that is reached but
    cannot be held (it slides or tips) is told apart. What is simulated is the stance with its legs
    longer by what the feet sink into MuJoCo's soft ground.

    \b
    Examples:
      pupper-analysis stand v3 --swing FL=2cm --com inside --com-margin 1cm --path 4 --csv lift.csv
      pupper-analysis stand long-leg --slope 5deg --uphill 90deg --pitch 0.05
      pupper-analysis stand v3 --step FR=0.02 --move RL=-0.01,0.02 --workspace --figure s.png
      pupper-analysis stand v3-heavy --best payload --payload-at 0,0,0.08
      pupper-analysis stand --urdf go1.urdf --mjcf go1.xml --foot FR=FR_foot --foot FL=FL_foot \\
        --foot RR=RR_foot --foot RL=RL_foot --kp 100 --kd 3

    \b
    Exit status: 0 it holds (and is reached along the path), 1 it fails in simulation,
    2 out of reach, not holdable or bad input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.analysis.stance import study
    from pupper_analysis.report import stance as stance_report
    from pupper_analysis.report.console import console
    from pupper_analysis.robot.ground import Ground
    from pupper_analysis.stance.optimize.search import Objective
    from pupper_analysis.stance.task import StandTask

    task = StandTask(
        height=height,
        roll=roll,
        pitch=pitch,
        yaw=yaw,
        offset=None if offset is None else _place("offset", offset),
        com=com if com in ("centre", "inside") else _place("com", com),
        com_margin=com_margin,
        joint_margin=joint_margin,
        ground_clearance=ground_clearance,
        self_clearance=self_clearance,
        foot_offsets={f: _place("move", p) for f, p in (assignment("move", m) for m in moves)},
        swing=dict(length("swing", text) for text in lifts),
        ground=Ground(slope, uphill, dict(length("step", text) for text in steps)),
    )
    if seconds is None and not (csv is None and npz is None):
        raise ConfigurationError("--csv, --npz", "there is no path to write; give --path too")
    x, y, z = point("payload-at", payload_at, 3)
    check_outputs(figure, workspace_figure, csv, npz, json_path)
    robot = _robot(name, urdf, mjcf, feet)
    result = study(
        robot,
        task,
        kp=kp,
        kd=kd,
        point=(x, y, z),
        objective=None if best is None else Objective(best),
        softest=minimum_stiffness,
        workspace=workspace or workspace_figure is not None,
        seconds=seconds,
        push=pushed,
    )
    stance_report.print_stance(console(), result)
    if figure is not None:
        from pupper_analysis.report.figures.pose import pose_figure

        pose_figure(robot, result.stand, result.statics, figure)
    if workspace_figure is not None and result.workspace is not None:
        from pupper_analysis.report.figures import workspace as drawing

        drawing.workspace_figure(robot, result.workspace, workspace_figure)
    if csv is not None and result.path is not None:
        result.path.to_csv(csv)
    if npz is not None and result.path is not None:
        result.path.to_npz(npz)
    write_json(json_path, result)
    if not result.passed:
        click.get_current_context().exit(FAILED)


def _place(option: str, text: str) -> tuple[float, float]:
    x, y = point(option, text)
    return x, y


def _robot(name: str | None, urdf: Path | None, mjcf: Path | None, feet: tuple[str, ...]) -> Robot:
    """Returns the variant of that name, or the robot of the two files."""
    from pupper_analysis.prepare.load import load_robot
    from pupper_analysis.pupper.load import load_variant

    if urdf is None and mjcf is None and not feet:
        return load_variant(name or "v3")
    if name is not None:
        raise ConfigurationError("NAME", "give a variant's name, or --urdf, --mjcf and --foot")
    if urdf is None or mjcf is None or not feet:
        raise ConfigurationError(
            "--urdf, --mjcf, --foot", "a robot of your own needs all three, --foot for each foot"
        )
    return load_robot(urdf=urdf, mjcf=mjcf, feet=dict(assignment("foot", foot) for foot in feet))


@click.command(context_settings=CONTEXT, short_help="Push robots over: how hard, which way?")
@click.argument("names", nargs=-1)
@click.option("--directions", default=12, show_default=True, help="How many, evenly spaced.")
@click.option(
    "--resolution", default=0.02, show_default=True, metavar="NS", help="Of the impulses (N s)."
)
@click.option("--height", type=LENGTH, help="Base above the ground (m).")
@figure_option
@json_option
def push(
    names: tuple[str, ...],
    directions: int,
    resolution: float,
    height: float | None,
    figure: Path | None,
    json_path: Path | None,
) -> None:
    """Find the largest horizontal push, in each direction, that variants survive as they stand.

    Each NAME is a variant; without any, all six are pushed (about ten seconds each). A push lasts
    20 ms, at the com of the base; a robot that survives it is upright and at rest after 6 s, and
    nothing but its feet ever touched the ground. It stands as in `stand --push`, with its legs
    longer by what the feet sink into MuJoCo's soft ground.

    \b
    Examples:
      pupper-analysis push v3 v3-heavy --figure push.png
      pupper-analysis push original --height 0.12 --directions 4 --resolution 0.1

    \b
    Exit status: 0 done, 1 a stand does not last even unpushed, 2 bad input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.pupper.load import load_variant
    from pupper_analysis.pupper.variants import VARIANTS
    from pupper_analysis.report import push as push_report
    from pupper_analysis.report.console import console
    from pupper_analysis.simulation.push import push_recovery
    from pupper_analysis.stance.sunk import sunk_stand
    from pupper_analysis.stance.task import StandTask

    check_outputs(figure, json_path)
    robots = [load_variant(name) for name in dict.fromkeys(names or VARIANTS)]
    stands = [sunk_stand(robot, StandTask(height=height)) for robot in robots]
    results = {
        robot.name: push_recovery(robot, stand, directions=directions, resolution=resolution)
        for robot, stand in zip(robots, stands, strict=True)
    }
    out = console()
    push_report.print_pushes(out, results)
    depths = [depth for stand in stands for depth in stand.depths.values()]
    out.print(push_report.sunk_note(depths), soft_wrap=True)
    if figure is not None:
        from pupper_analysis.report.figures.push import push_figure

        push_figure(results, figure)
    write_json(json_path, results)
    if not all(result.weakest_impulse > 0 for result in results.values()):
        click.get_current_context().exit(FAILED)
