"""The command line."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pupper_analysis.errors import ConfigurationError, OutputError, PupperAnalysisError

if TYPE_CHECKING:
    from pupper_analysis.analysis import Analysis
    from pupper_analysis.robot import Robot
    from pupper_analysis.variants import VariantSpec

VERIFIED, FAILED, BAD_INPUT = 0, 1, 2
"""Exit statuses."""

_CONTEXT = {"help_option_names": ["-h", "--help"], "max_content_width": 100}

_json_option = click.option(
    "--json", "json_path", type=click.Path(path_type=Path), help="Write all results here."
)
_figure_option = click.option("--figure", type=click.Path(path_type=Path), help="Draw it: a PNG.")
_format_option = click.option(
    "--format",
    "style",
    type=click.Choice(["text", "github", "junit"]),
    default="text",
    show_default=True,
    help="For people, as GitHub annotations, or as JUnit XML.",
)


def run(command: click.Command, arguments: list[str] | None = None) -> None:
    """Runs a command and leaves the process with its exit status.

    An error of the package, or of the command line, becomes one line on standard error and exit
    status 2.
    """
    try:
        status = command.main(args=arguments, standalone_mode=False)
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message(), err=True)
        status = BAD_INPUT
    except click.UsageError as error:
        where = error.ctx.command_path if error.ctx else command.name
        click.echo(f"error: {error.format_message()} (see: {where} --help)", err=True)
        status = BAD_INPUT
    except (PupperAnalysisError, click.ClickException) as error:
        click.echo(f"error: {error}", err=True)
        status = BAD_INPUT
    except click.Abort:
        click.echo("interrupted", err=True)
        status = 130
    except BrokenPipeError:
        # The reader of a pipe, such as head, has seen enough.
        sys.stdout = None
        status = VERIFIED
    sys.exit(status)


def main() -> None:
    """Runs the console command."""
    run(group)


@click.group("pupper-analysis", context_settings=_CONTEXT)
@click.version_option(package_name="pupper-analysis")
def group() -> None:
    """Know that a legged robot's models are right, what its motors hold and how it can stand.

    \b
    Exit status: 0 verified, 1 something failed verification or the cross-check, 2 bad input.
    """  # noqa: D301 - click reads the \b


@group.command(
    context_settings=_CONTEXT, short_help="Take variants from two model files to a verified stand."
)
@click.argument("names", nargs=-1, metavar="[NAME]...")
@click.option("--list", "list_only", is_flag=True, help="List the variants, and stop.")
@click.option("--base", metavar="BASE", help="Analyse a variant of this base: skeleton or v3.")
@click.option("--leg-scale", type=float, metavar="S", help="Its legs' length and mass, times S.")
@click.option("--torso-mass-scale", type=float, metavar="T", help="Its torso's mass, times T.")
@click.option("--height", type=float, metavar="M", help="Height of the base above the ground (m).")
@click.option("--roll", type=float, default=0.0, metavar="RAD", help="Roll of the base (rad).")
@click.option("--pitch", type=float, default=0.0, metavar="RAD", help="Pitch of the base (rad).")
@click.option("--yaw", type=float, default=0.0, metavar="RAD", help="Yaw against the feet (rad).")
@click.option(
    "--output",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("output"),
    show_default=True,
    help="Folder for the figures; made if need be.",
)
@_json_option
@click.option("--no-figures", is_flag=True, help="Print only.")
@click.option(
    "--write",
    "write_folder",
    type=click.Path(path_type=Path, file_okay=False),
    help="Write the variants' URDF, MJCF and meshes into this folder.",
)
def analyze(
    names: tuple[str, ...],
    list_only: bool,
    base: str | None,
    leg_scale: float | None,
    torso_mass_scale: float | None,
    height: float | None,
    roll: float,
    pitch: float,
    yaw: float,
    output: Path,
    json_path: Path | None,
    no_figures: bool,
    write_folder: Path | None,
) -> None:
    """Take variants of Pupper from their two model files to a verified stand.

    Each NAME is a variant (see --list); without any, all six are analysed. A variant of your own
    is given by --base, --leg-scale and --torso-mass-scale.

    \b
    Printed per variant: joints and what their axes really do, masses and com, the stand (PlaCo),
    foot Jacobians, motor torques and contact forces (Pinocchio), the simulated stand and the gain
    sweep (MuJoCo), and the cross-check of URDF and MJCF; then a table that compares the variants.

    \b
    Examples:
      pupper-analysis analyze
      pupper-analysis analyze original long-leg --no-figures
      pupper-analysis analyze --base v3 --leg-scale 1.2 --json v3-1.2.json
      pupper-analysis analyze v3 --height 0.12 --pitch 0.1

    \b
    Exit status: 0 all verified, 1 something failed verification or the cross-check,
    2 bad input (an unknown name, a scale that is no scale, a stance out of reach).
    """  # noqa: D301 - click reads the \b
    from pupper_analysis.description import write_variant
    from pupper_analysis.variants import VARIANTS, VariantSpec, variant_spec

    specs = [variant_spec(name) for name in dict.fromkeys(names)]
    if base is not None or leg_scale is not None or torso_mass_scale is not None:
        specs.append(
            VariantSpec(
                base="skeleton" if base is None else base,
                leg_scale=1.0 if leg_scale is None else leg_scale,
                torso_mass_scale=1.0 if torso_mass_scale is None else torso_mass_scale,
            )
        )
    if list_only:
        _print_list(specs or list(VARIANTS.values()))
        return
    specs = specs or list(VARIANTS.values())
    _check_outputs(json_path, folders=(None if no_figures else output, write_folder))
    analyses, robots = _analyze_all(specs, height, roll, pitch, yaw)
    _finish(specs, robots, analyses, None if no_figures else output, json_path)
    if write_folder is not None:
        for spec in specs:
            for path in write_variant(spec, write_folder):
                click.echo(f"written: {path}")
    if not all(analysis.verified for analysis in analyses):
        click.get_current_context().exit(FAILED)


def _analyze_all(
    specs: list[VariantSpec], height: float | None, roll: float, pitch: float, yaw: float
) -> tuple[list[Analysis], list[Robot]]:
    """Analyses the variants and prints each as it is done."""
    from pupper_analysis import report
    from pupper_analysis.analysis import analyze_variant
    from pupper_analysis.robot import load_variant
    from pupper_analysis.stand import solve_stand
    from pupper_analysis.task import StandTask

    task = StandTask(height=height, roll=roll, pitch=pitch, yaw=yaw)
    robots = [load_variant(spec) for spec in specs]
    for robot in robots:  # a stance out of reach is found before anything is printed
        solve_stand(robot, task)
    out = report.console()
    analyses = []
    for robot in robots:
        analyses.append(analyze_variant(robot, task, progress=out.is_terminal))
        report.print_analysis(out, analyses[-1])
    return analyses, robots


def _finish(
    specs: list[VariantSpec],
    robots: list[Robot],
    analyses: list[Analysis],
    folder: Path | None,
    json_path: Path | None,
) -> None:
    """Compares the variants, and writes figures and JSON."""
    from pupper_analysis import report
    from pupper_analysis.analysis import leg_lengths, thigh_shape_length
    from pupper_analysis.robot import load_variant
    from pupper_analysis.variants import VariantSpec

    references = {}
    for name in {spec.base for spec in specs}:
        robot = load_variant(VariantSpec(base=name))
        references[name] = report.Reference(
            robot.total_mass, leg_lengths(robot)[0], thigh_shape_length(robot)
        )
    rows = [
        report.compare(analysis, spec.base, references[spec.base])
        for spec, analysis in zip(specs, analyses, strict=True)
    ]
    out = report.console()
    report.print_comparison(out, rows)
    if folder is not None:
        for line in _draw(robots, analyses, folder):
            out.print(line)
    if json_path is not None:
        content: dict[str, Any] = {
            "variants": {analysis.name: analysis for analysis in analyses},
            "comparison": rows,
        }
        _write_json(json_path, content)
        out.print(f"results: {json_path}")
    good = sum(analysis.verified for analysis in analyses)
    out.print(f"{good} of {len(analyses)} verified")


def _draw(robots: list[Robot], analyses: list[Analysis], folder: Path) -> list[str]:
    """Writes all figures; returns what to say of them."""
    from pupper_analysis import figures, render

    for robot, analysis in zip(robots, analyses, strict=True):
        path = folder / f"pose_{analysis.name}.png"
        figures.pose_figure(robot, analysis.stand, analysis.statics, path)
    figures.torque_figure(analyses, folder / "torques.png")
    figures.height_figure(analyses, folder / "heights.png")
    figures.gain_figure(analyses, folder / "gains.png")
    stands = [analysis.stand for analysis in analyses]
    picture = render.render_variants(
        list(zip(robots, stands, strict=True)), folder / "variants.png"
    )
    lines = [f"figures: {folder}/"]
    if picture.note:
        lines.append(f"note: {picture.note}")
    return lines


def _check_outputs(*files: Path | None, folders: tuple[Path | None, ...] = ()) -> None:
    """Finds out before the work begins that its results cannot be written."""
    for path in (*folders, *(file.parent for file in files if file is not None)):
        if path is None:
            continue
        existing = next(parent for parent in (path, *path.absolute().parents) if parent.exists())
        if not existing.is_dir():
            raise OutputError(path, f"{existing} is not a folder")
    for file in files:
        if file is not None and file.is_dir():
            raise OutputError(file, "it is a folder; give the name of a file")


def _print_list(specs: list[VariantSpec]) -> None:
    from pupper_analysis import report
    from pupper_analysis.robot import load_variant

    report.print_variants(report.console(), [(spec, load_variant(spec)) for spec in specs])


@group.command(context_settings=_CONTEXT, short_help="Find what makes a URDF and an MJCF disagree.")
@click.argument("urdf", type=click.Path(path_type=Path))
@click.argument("mjcf", type=click.Path(path_type=Path))
@click.option(
    "--map",
    "pairs",
    multiple=True,
    metavar="URDF=MJCF",
    help="A joint's or frame's name in the URDF, and in the MJCF. May be repeated.",
)
@click.option(
    "--map-file",
    type=click.Path(path_type=Path),
    help='TOML file of such names: a line "name in the URDF" = "name in the MJCF" each.',
)
@click.option(
    "--package",
    "packages",
    multiple=True,
    metavar="NAME=DIR",
    help="Where package://NAME/ is; else ROS_PACKAGE_PATH, then the folders above the URDF.",
)
@click.option(
    "--foot", "feet", multiple=True, metavar="FRAME", help="Compare this frame (all common ones)."
)
@click.option(
    "--tolerance",
    "changes",
    multiple=True,
    metavar="KIND=VALUE",
    help="Of mass, com, inertia, position, rotation, axis, limit, effort, velocity, damping, "
    "friction or dynamics. May be repeated.",
)
@click.option("--strict", is_flag=True, help="Tolerate rounding errors alone (1e-9), not digits.")
@click.option("--all", "everything", is_flag=True, help="Print every difference.")
@_json_option
@_format_option
def crosscheck(
    urdf: Path,
    mjcf: Path,
    pairs: tuple[str, ...],
    map_file: Path | None,
    packages: tuple[str, ...],
    feet: tuple[str, ...],
    changes: tuple[str, ...],
    strict: bool,
    everything: bool,
    json_path: Path | None,
    style: str,
) -> None:
    """Find which number in which file makes a robot's URDF and MJCF disagree.

    Both models are compared in both engines, and body by body; each difference is shown with its
    place in both files and its effect, the greatest first, and the list is proven complete.
    Joints are matched by name, by --map, and the rest by structure (which is then printed).

    \b
    Examples:
      pupper-analysis crosscheck go1.urdf go1.xml
      pupper-analysis crosscheck robot.urdf robot.xml --map lf_haa=FL_hip --tolerance mass=1e-3
      pupper-analysis crosscheck robot.urdf robot.xml --strict --format github

    \b
    Exit status: 0 they agree within the tolerances, 1 they differ, 2 bad input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis import comparison_report, formats, matching, report
    from pupper_analysis.comparison import compare_models
    from pupper_analysis.explain import Tolerances

    names = matching.read_mapping(map_file) if map_file is not None else {}
    for text in pairs:
        old, new = _assignment("map", text)
        if names.setdefault(old, new) != new:
            raise ConfigurationError("map", f"{old!r} is mapped to both {names[old]!r} and {new!r}")
    folders = {name: Path(value) for name, value in (_assignment("package", p) for p in packages)}
    for name, folder in folders.items():
        if not folder.is_dir():
            raise ConfigurationError("package", f"{name}: {folder} is not a folder")
    tolerances = Tolerances.strict() if strict else Tolerances()
    tolerances = tolerances.changed(dict(_number("tolerance", text) for text in changes))
    _check_outputs(json_path)
    comparison = compare_models(
        urdf, mjcf, names=names, packages=folders, feet=feet, tolerances=tolerances
    )
    if style == "text":
        comparison_report.print_models(report.console(), comparison, everything=everything)
    elif style == "github":
        click.echo(formats.github(comparison_report.remarks(comparison)))
    else:
        suite = f"{urdf.name} against {mjcf.name}"
        click.echo(formats.junit(suite, comparison_report.cases(comparison)))
    _write_json(json_path, comparison)
    if not comparison.agree:
        click.get_current_context().exit(FAILED)


@group.command(
    "audit", context_settings=_CONTEXT, short_help="Find what is wrong in one URDF or MJCF."
)
@click.argument("file", required=False, type=click.Path(path_type=Path))
@click.option(
    "--package",
    "packages",
    multiple=True,
    metavar="NAME=DIR",
    help="Where package://NAME/ is. May be repeated.",
)
@click.option(
    "--disable", "disabled", multiple=True, metavar="RULE", help="Do not run this rule. Repeatable."
)
@click.option("--list-rules", is_flag=True, help="List the rules, and stop.")
@click.option(
    "--fail-on",
    type=click.Choice(["error", "warning", "info"]),
    default="error",
    show_default=True,
    help="The least severity that makes the exit status 1.",
)
@_json_option
@_format_option
def audit_command(
    file: Path | None,
    packages: tuple[str, ...],
    disabled: tuple[str, ...],
    list_rules: bool,
    fail_on: str,
    json_path: Path | None,
    style: str,
) -> None:
    """Find what is physically or practically wrong in one model file, URDF or MJCF.

    Masses and inertias that no body can have, legs that are no mirror images, shapes that end
    beside their joints, limits in degrees, servos that jitter, feet that begin in the floor, and
    more: each finding has its place, why it matters, and what to do.

    \b
    Examples:
      pupper-analysis audit robot.urdf
      pupper-analysis audit scene.xml --disable armature-zero --fail-on warning
      pupper-analysis audit --list-rules

    \b
    Exit status: 0 nothing as bad as --fail-on was found, 1 something was, 2 bad input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis import audit_report, formats, report
    from pupper_analysis.audit import audit_model

    if list_rules:
        audit_report.print_rules(report.console())
        return
    if file is None:
        raise ConfigurationError("FILE", "give the URDF or MJCF to audit")
    folders = {name: Path(value) for name, value in (_assignment("package", p) for p in packages)}
    _check_outputs(json_path)
    result = audit_model(file, packages=folders, disabled=disabled)
    if style == "text":
        audit_report.print_audit(report.console(), result)
    elif style == "github":
        click.echo(formats.github(audit_report.remarks(result)))
    else:
        click.echo(formats.junit(f"audit of {file.name}", audit_report.cases(result)))
    _write_json(json_path, result)
    if audit_report.worst_rank(result) <= audit_report.rank(fail_on):
        click.get_current_context().exit(FAILED)


def _assignment(option: str, text: str) -> tuple[str, str]:
    name, separator, value = text.partition("=")
    if not (name and separator and value):
        raise ConfigurationError(option, f"{text!r} is not of the form NAME=VALUE")
    return name, value


def _number(option: str, text: str) -> tuple[str, float]:
    name, value = _assignment(option, text)
    try:
        return name, float(value)
    except ValueError as error:
        raise ConfigurationError(option, f"{value!r} in {text!r} is not a number") from error


def _write_json(path: Path | None, content: object) -> None:
    from pupper_analysis.files import whole_file
    from pupper_analysis.results import to_json

    if path is not None:
        with whole_file(path) as temporary:
            temporary.write_text(to_json(content) + "\n")


@group.command(context_settings=_CONTEXT, short_help="Solve a stance, and see what it costs.")
@click.argument("name", default="v3")
@click.option("--height", type=float, metavar="M", help="Base above the contact points (m).")
@click.option("--roll", type=float, default=0.0, metavar="RAD", help="Roll of the base (rad).")
@click.option("--pitch", type=float, default=0.0, metavar="RAD", help="Pitch of the base (rad).")
@click.option("--yaw", type=float, default=0.0, metavar="RAD", help="Yaw against the feet (rad).")
@click.option("--offset", metavar="X,Y", help="Base from the centre of the feet (m).")
@click.option("--com", default="centre", metavar="X,Y", help="Com at (m), or: centre, inside.")
@click.option("--com-margin", type=float, default=0.0, metavar="M", help="Inside the polygon (m).")
@click.option(
    "--joint-margin", type=float, default=0.0, metavar="RAD", help="Off the limits (rad)."
)
@click.option("--move", "moves", multiple=True, metavar="FOOT=X,Y", help="Foot off its place (m).")
@click.option("--lift", "lifts", multiple=True, metavar="FOOT=M", help="Foot lifted by (m).")
@click.option("--step", "steps", multiple=True, metavar="FOOT=M", help="Step under a foot (m).")
@click.option("--slope", type=float, default=0.0, metavar="RAD", help="Slope of the ground (rad).")
@click.option("--uphill", type=float, default=0.0, metavar="RAD", help="Where it rises (rad).")
@click.option("--envelope", is_flag=True, help="Also how far the base can go from there.")
@_figure_option
@_json_option
def stance(
    name: str,
    height: float | None,
    roll: float,
    pitch: float,
    yaw: float,
    offset: str | None,
    com: str,
    com_margin: float,
    joint_margin: float,
    moves: tuple[str, ...],
    lifts: tuple[str, ...],
    steps: tuple[str, ...],
    slope: float,
    uphill: float,
    envelope: bool,
    figure: Path | None,
    json_path: Path | None,
) -> None:
    """Solve a stance of a variant; print joint angles, what the motors hold, and whether it lasts.

    A stance that is out of reach is refused with what would be possible. One that is reached but
    cannot be held (it slides or tips) is told apart.

    \b
    Examples:
      pupper-analysis stance v3 --lift FL=0.02 --com inside --com-margin 0.01
      pupper-analysis stance long-leg --slope 0.1 --uphill 1.57 --pitch 0.05
      pupper-analysis stance v3 --step FR=0.02 --move RL=-0.01,0.02 --envelope --figure s.png

    \b
    Exit status: 0 it holds, 1 it fails in simulation, 2 out of reach, not holdable or bad input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis import report, stance_report
    from pupper_analysis.robot import load_variant
    from pupper_analysis.task import Ground, StandTask

    task = StandTask(
        height=height,
        roll=roll,
        pitch=pitch,
        yaw=yaw,
        offset=None if offset is None else _place("offset", offset),
        com=com if com in ("centre", "inside") else _place("com", com),
        com_margin=com_margin,
        joint_margin=joint_margin,
        foot_offsets={f: _place("move", p) for f, p in (_assignment("move", m) for m in moves)},
        lifted=dict(_number("lift", text) for text in lifts),
        ground=Ground(slope, uphill, dict(_number("step", text) for text in steps)),
    )
    _check_outputs(figure, json_path)
    robot = load_variant(name)
    result = stance_report.study(robot, task, envelope=envelope)
    stance_report.print_stance(report.console(), result)
    if figure is not None:
        from pupper_analysis import figures

        figures.pose_figure(robot, result.stand, result.statics, figure)
    _write_json(json_path, result)
    if not result.verification.passed:
        click.get_current_context().exit(FAILED)


def _place(option: str, text: str) -> tuple[float, float]:
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError as error:
        raise ConfigurationError(option, f"{text!r} is not of the form X,Y (m)") from error
    return x, y


@group.command(context_settings=_CONTEXT, short_help="Push robots over: how hard, which way?")
@click.argument("names", nargs=-1)
@click.option("--directions", default=12, show_default=True, help="How many, evenly spaced.")
@click.option(
    "--resolution", default=0.02, show_default=True, metavar="NS", help="Of the impulses (N s)."
)
@click.option("--height", type=float, metavar="M", help="Base above the ground (m).")
@_figure_option
@_json_option
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
    nothing but its feet ever touched the ground.

    \b
    Examples:
      pupper-analysis push v3 v3-heavy --figure push.png
      pupper-analysis push original --height 0.12 --directions 4 --resolution 0.1

    \b
    Exit status: 0 done, 1 a stand does not last even unpushed, 2 bad input.
    """  # noqa: D301 - click reads the \b
    from pupper_analysis import push_report, report
    from pupper_analysis.push import push_recovery
    from pupper_analysis.robot import load_variant
    from pupper_analysis.stand import solve_stand
    from pupper_analysis.task import StandTask
    from pupper_analysis.variants import VARIANTS

    _check_outputs(figure, json_path)
    robots = [load_variant(name) for name in dict.fromkeys(names or VARIANTS)]
    stands = [solve_stand(robot, StandTask(height=height)) for robot in robots]
    results = {
        robot.name: push_recovery(robot, stand, directions=directions, resolution=resolution)
        for robot, stand in zip(robots, stands, strict=True)
    }
    push_report.print_pushes(report.console(), results)
    if figure is not None:
        from pupper_analysis.push_figure import push_figure

        push_figure(results, figure)
    _write_json(json_path, results)
    if not all(result.weakest_impulse > 0 for result in results.values()):
        click.get_current_context().exit(FAILED)


@group.command(context_settings=_CONTEXT, short_help="Show Pupper v3 in MuJoCo's viewer.")
@click.option("--fixed", is_flag=True, help="Fix the base in the air; else it falls and lands.")
@click.option("--headless", is_flag=True, help="Open no window: print the model and its IMU.")
def view(fixed: bool, headless: bool) -> None:
    """Show Pupper v3 in MuJoCo's viewer (on macOS, run this with mjpython)."""
    from pupper_analysis import viewer

    viewer.view(fixed=fixed, headless=headless)


@group.command(context_settings=_CONTEXT, short_help="Drop Pupper v3, and see that it stands.")
@click.option("--headless", is_flag=True, help="Open no window: simulate, and print the result.")
@click.option("--seconds", type=float, help="Simulated time of the drop (s).  [default: 6]")
@click.option("--demo", type=click.Choice(["squat", "sway", "lift"]), help="Let it move instead.")
@click.option("--csv", type=click.Path(path_type=Path), help="Write the path of a demo here.")
def stand(headless: bool, seconds: float | None, demo: str | None, csv: Path | None) -> None:
    """Drop Pupper v3 from its home pose, and see that it stands (on macOS, run with mjpython).

    With --demo it moves instead: squat, sway from side to side, or shift its weight and lift a
    foot. Every sample of the path is a stand in balance, solved on the whole body.

    \b
    Exit status: 0 it stands, or follows the path; 1 it does not; 2 bad input.
    """  # noqa: D301 - click reads the \b
    if demo is None:
        if csv is not None:
            raise ConfigurationError("--csv", "only a demo has a path to write; give --demo too")
        from pupper_analysis import viewer

        seconds = viewer.DEFAULT_SECONDS if seconds is None else seconds
        good = viewer.stand(headless=headless, seconds=seconds)
    else:
        if seconds is not None:
            raise ConfigurationError("--seconds", "a demo has its own duration")
        from pupper_analysis import demo as demos

        _check_outputs(csv)
        good = demos.demo(demo, headless=headless, csv=csv)
    if not good:
        click.get_current_context().exit(FAILED)
