"""Agreement of commands: values that a command prints are typed into other commands."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

import pupper_analysis as pa
from pupper_analysis.present.documents.loads import get_display_scales
from pupper_analysis.simulation.trial import Failure
from pupper_analysis.tools.stand.stance import study_stance
from tests.support import random_legged
from tests.support.commands import Answer, answer
from tests.support.html_page import Page

INSIDE, OUTSIDE = 0.97, 1.03
"""Fractions of a printed limit at which an arm must hold, and must not hold. A robot that stands
must hold the printed payload itself. Limits from simulations have a tolerance of 1 to 2 %."""

RANGE_EXCESS = 0.01
"""Fraction of the base workspace by which a bound is passed."""

MAX_TURNS = {"roll": math.pi, "pitch": math.pi / 2, "yaw": math.pi}
"""Largest angles [rad] in which the command ``workspace`` searches."""

ROUNDING_TOLERANCE = 1e-9
"""Largest difference [rad, m, N m] between results of the same computation; processes sum in the
same order."""

SLOPE = "6deg"
"""Slope of the ground on which the payload is computed once more."""

PAYLOAD_PLACE, PAYLOAD_POINT = "0,0,5cm", (0.0, 0.0, 0.05)
"""Position of the payload as typed, and in metres."""


@dataclass
class Agreement:
    """Results of commands for a robot.

    Attributes:
        name: Name of the robot.
        codes: {command: code of its verdict, or exit status}.
        payload: Mass that ``payload`` prints [kg]; NaN if there is none.
        disagreements: Descriptions of results that contradict each other.
    """

    name: str
    codes: dict[str, str] = field(default_factory=dict)
    payload: float = math.nan
    disagreements: list[str] = field(default_factory=list)


class Commands:
    """Runner of commands on a robot, each with JSON output."""

    def __init__(self, folder: Path, robot: Sequence[str]) -> None:
        self.folder, self.robot = folder, tuple(robot)
        self._files = (f"{number}.json" for number in itertools.count())

    def __call__(
        self, command: str, *options: str, robot: Sequence[str] | None = None
    ) -> tuple[Answer, dict[str, Any]]:
        """Return how a command ended, and its JSON; empty if it wrote none."""
        file = self.folder / next(self._files)
        given = self.robot if robot is None else robot
        done = answer(command, *given, *options, "--json", str(file), folder=self.folder)
        assert done.returncode in (0, 1, 2), done.stderr  # 3 is a bug, whatever else
        return done, json.loads(file.read_text()) if file.is_file() else {}


def compare_commands(
    name: str,
    folder: Path,
    *files: str,
    everywhere: bool = False,
    objectives: Sequence[str] = ("utilisation",),
) -> Agreement:
    """Run commands on a robot, type their results into other commands, and return the
    contradictions.

    Args:
        name: Name of the robot.
        folder: Folder for written files.
        files: Files of the robot, or the name of a variant.
        everywhere: Whether to test a slope, pushes with payload, and bounds of the height that are
            typed into ``stand``, too.
        objectives: Objectives of ``best`` to compare.
    """
    found, run = Agreement(name), Commands(folder, files)
    page = folder / "page.html"
    stood, stance = run("stand", "--report", str(page))
    found.codes["stand"] = _result_code(stood, stance)
    if stance:
        _compare_page(found, Page(page.read_text()), stance)
        _compare_interface(found, stance, files)
        _compare_analysis(found, run, stance)
        _compare_push(found, run, stance)
    _compare_path(found, run, stood, stance)
    loaded = _compare_payload(found, run, stood)
    if stood.returncode == 0 and everywhere:
        there, _ = run("stand", "--slope", SLOPE)
        _compare_payload(found, run, there, "--slope", SLOPE)
        if loaded:
            load = "--payload", f"{found.payload:.9g}", "--payload-at", PAYLOAD_PLACE
            _compare_push(found, run, loaded, *load)
    if stance:
        _compare_study(found, stance, files, folder)
    if stood.returncode == 0:
        compare_best(found, run, objectives)
        _compare_workspace(found, run, typed=everywhere)
    if len(files) == 1 and files[0].endswith(".urdf"):
        _compare_conversion(found, run, stood, stance)
    if stood.returncode == 2:
        _compare_hold(found, run)
    return found


def _result_code(done: Answer, content: dict[str, Any]) -> str:
    """Return the code of a verdict, or the exit status."""
    return str(content["verdict"]["code"]) if "verdict" in content else f"exit {done.returncode}"


def _compare_page(found: Agreement, page: Page, stance: dict[str, Any]) -> None:
    """Compare the report page with the JSON, to the displayed digits."""
    word = "FAILS" if not stance["verdict"]["passed"] else "HOLDS"
    if word not in page.shown():
        found.disagreements.append(f"page: no word {word}")
    tables, statics, run = page.tables(), stance["statics"], stance["verification"]
    whole = {row["quantity"]: row["value"] for row in tables["Stance"]}
    near = stance["stand"]["ground_clearance"]
    asked = [
        ("torque", _column_cells(tables["Motor torques"], "torque"), statics["joint_torques"]),
        ("simulated", _column_cells(tables["Motor torques"], "simulated"), run["joint_torques"]),
        (
            "position",
            _column_cells(tables["Motor torques"], "position"),
            (get_display_scales(stance["units"]) * stance["joint_positions"]).tolist(),
        ),
        ("height", [whole["height of the base"]], [1e3 * stance["stand"]["task"]["height"]]),
        ("com", [whole["CoM margin"]], [1e3 * stance["stand"]["com_margin"]]),
    ]
    if near is not None:
        asked.append(("clearance", [whole["ground clearance"]], [1e3 * near["distance"]]))
    title = next(title for title in tables if title.startswith("Contact forces on the feet"))
    forces = {row["foot"]: row for row in tables[title]}
    for foot, load in statics["foot_loads"].items():
        asked.append(
            (f"force of {foot}", _column_cells([forces[foot]], "force z"), [load["force"][2]])
        )
    for what, shown, meant in asked:
        if len(shown) != len(meant) or not all(map(_agrees_in_digits, shown, meant)):
            found.disagreements.append(f"page: {what} {shown}, JSON {meant}")


def _column_cells(rows: list[dict[str, str]], name: str) -> list[str]:
    """Return the cells of a column with any unit."""
    return [cell for row in rows for head, cell in row.items() if head.startswith(f"{name} (")]


def _agrees_in_digits(shown: str, meant: float) -> bool:
    """Return True if a displayed number agrees with a value in the displayed digits."""
    digits = len(shown.partition(".")[2])
    return abs(float(shown) - meant) <= 0.501 * 10.0**-digits


def _sort_by_format(files: Sequence[str]) -> dict[str, str]:
    """Return {"urdf" or "mjcf": file} of a robot's files."""
    return {"mjcf" if file.endswith(".xml") else "urdf": file for file in files}


def _load_robot(files: Sequence[str]) -> pa.Robot:
    """Load a variant by name, or a robot from files."""
    if files[0] in pa.VARIANTS:
        return pa.load_variant(files[0])
    named = _sort_by_format(files)
    return pa.load_robot(urdf=named.get("urdf"), mjcf=named.get("mjcf"))


def _compare_interface(found: Agreement, stance: dict[str, Any], files: Sequence[str]) -> None:
    """Compare ``study_stance`` in Python with the JSON of ``stand``."""
    mine = study_stance(_load_robot(files), pa.StandTask())
    found.codes["python"] = mine.verdict.code
    if mine.verdict.code != stance["verdict"]["code"]:
        found.disagreements.append(f"study_stance: {mine.verdict.code}")
    for what, one, other in (
        ("joint positions", mine.joint_positions, stance["joint_positions"]),
        ("torques", mine.statics.joint_torques, stance["statics"]["joint_torques"]),
    ):
        off = float(np.abs(np.asarray(one) - np.asarray(other)).max(initial=0.0))
        if not off <= ROUNDING_TOLERANCE:
            found.disagreements.append(f"study_stance: {what} off by {off:.1e}")


def _compare_analysis(found: Agreement, run: Commands, stance: dict[str, Any]) -> None:
    """Compare numbers and verdict of ``analyze`` with those of ``stand``, for a variant."""
    if run.robot[0] not in pa.VARIANTS:
        return
    _, content = run("analyze", "--no-figures")
    analysed = content["variants"][run.robot[0]]
    if analysed["verdict"]["code"] != stance["verdict"]["code"]:
        found.disagreements.append(f"analyze: {analysed['verdict']['code']}")
    for what, one, other in (
        ("stand", analysed["stand"]["qpos"], stance["stand"]["qpos"]),
        ("torques", analysed["statics"]["joint_torques"], stance["statics"]["joint_torques"]),
        ("sag", analysed["sagging"]["base_height"], stance["sagging"]["base_height"]),
    ):
        if not np.allclose(one, other, rtol=0, atol=ROUNDING_TOLERANCE):
            found.disagreements.append(f"analyze: another {what} than stand")


def _compare_push(found: Agreement, run: Commands, stance: dict[str, Any], *asked: str) -> None:
    """Compare stand and verdict of ``push`` with those of ``stand``."""
    done, content = run("push", "--directions", "3", "--resolution", "1", *asked)
    name = " ".join(("push", *asked[::2]))
    if done.returncode == 2:
        found.codes[name] = "exit 2"
        if stance["verdict"]["passed"]:
            found.disagreements.append(f"{name}: {done.stderr.strip()[-120:]}")
        return
    pushed = content.get("robots", content)
    one = next(value for name, value in pushed.items() if name not in ("generator", "provenance"))
    found.codes[name] = one["verdict"]["code"]
    # `push` considers the stand with feed-forward only.
    if one["verdict"]["passed"] and not stance["verdict"]["passed"]:
        found.disagreements.append(f"{name}: {one['verdict']['code']}")
    off = float(np.abs(np.array(one["stand"]["qpos"]) - np.array(stance["stand"]["qpos"])).max())
    if not off <= ROUNDING_TOLERANCE:
        found.disagreements.append(f"{name}: stand off by {off:.1e}")


def _compare_path(found: Agreement, run: Commands, stood: Answer, stance: dict[str, Any]) -> None:
    """Check that a path from a stand to itself passes only if the stand passes."""
    height = float(stance["stand"]["qpos"][2]) if stance else math.nan
    asked = ("--height", f"{0.98 * height:.4f}") if 0 < height < math.inf else ()
    done, _ = run("path", "--seconds", "3", *asked)
    found.codes["path"] = f"exit {done.returncode}"
    if done.returncode == 0 and stood.returncode != 0:
        found.disagreements.append("path: exit 0 where stand fails")


def _compare_payload(
    found: Agreement, run: Commands, stood: Answer, *ground: str
) -> dict[str, Any]:
    """Check that ``stand`` holds with the payload that ``payload`` prints, and fails with 103 %.

    Return the JSON of the stand with the payload, empty if there is none.
    """
    told = " ".join(ground)
    done, content = run("payload", "--payload-at", PAYLOAD_PLACE, *ground)
    found.codes[f"payload {told}".strip()] = f"exit {done.returncode}"
    if done.returncode == 0 and stood.returncode != 0:
        found.disagreements.append(f"payload {told}: exit 0 where stand fails")
    unloaded = content.get("simulation", {}).get("failure") == Failure.UNLOADED
    if unloaded and stood.returncode == 0:
        found.disagreements.append(f"payload {told}: nothing where stand holds")
    mass = content.get("mass")
    if not isinstance(mass, float) or not 0 < mass < math.inf:
        return {}
    if not ground:
        found.payload = mass
    if done.returncode != 0:
        return {}
    stances = {}
    place = f"{content['link']},{PAYLOAD_PLACE}"
    for part in (1.0, OUTSIDE):
        asked = ("--payload", f"{part * mass:.9g}", "--payload-at", place, *ground)
        loaded, stances[part] = run("stand", *asked)
        code = _result_code(loaded, stances[part])
        found.codes[f"stand {told}, {part} of it"] = code
        if (loaded.returncode == 0) is not (part <= 1):
            found.disagreements.append(f"stand {told} with {part} of {mass:.4g} kg: {code}")
    return stances[1.0]


def _compare_study(
    found: Agreement, stance: dict[str, Any], files: Sequence[str], folder: Path
) -> None:
    """Compare a study of the nominal stand with the results of ``stand`` and ``payload``."""
    source = files[0] if files[0] in pa.VARIANTS else _sort_by_format(files)
    asked = ["verified"] if math.isnan(found.payload) else ["verified", "payload_limit"]
    study = pa.Study(
        source, {"yaw": [stance["stand"]["task"]["yaw"]]}, asked, payload_point=PAYLOAD_POINT
    )
    with ThreadPoolExecutor(1) as here:
        (row,) = study.run(folder / "study", executor=here).to_dict("records")
    if bool(row["verified"]) is not stance["verdict"]["passed"]:
        found.disagreements.append(f"study: verified {row['verified']}")
    mass = row.get("payload_limit", found.payload)
    if not math.isnan(found.payload) and not math.isclose(
        mass, found.payload, rel_tol=ROUNDING_TOLERANCE
    ):
        found.disagreements.append(f"study: payload {mass:.6g} kg for {found.payload:.6g}")


def compare_best(found: Agreement, run: Commands, objectives: Sequence[str]) -> None:
    """Compare the stance of ``best`` with the results of ``stand`` and ``payload`` for it."""
    for objective in objectives:
        at = ("--payload-at", PAYLOAD_PLACE) if objective == "payload" else ()
        done, content = run("best", *at, robot=(objective, *run.robot))
        found.codes[f"best {objective}"] = f"exit {done.returncode}"
        if not content:
            continue
        best, message = content["best"], content["stance"]
        typed = _format_task_options(best["stand"]["task"])
        if objective == "payload":
            loaded, answered = run("payload", *at, *typed)
            found.codes["payload of the best"] = f"exit {loaded.returncode}"
            if loaded.returncode != done.returncode:
                found.disagreements.append(f"best payload: payload exits {loaded.returncode}")
            mass = answered.get("mass", math.nan)
            if not math.isclose(mass, best["payload"]["mass"], rel_tol=ROUNDING_TOLERANCE):
                found.disagreements.append(
                    f"best payload: {best['payload']['mass']:.6g} kg, payload {mass:.6g} kg"
                )
            continue
        stood, stance = run("stand", *typed)
        code = _result_code(stood, stance)
        if code != message["verdict"]["code"]:
            found.disagreements.append(
                f"best {objective}: {message['verdict']['code']}, stand {code}"
            )
        if not stance:
            continue
        for what, one, other in (
            ("stand", message["stand"]["qpos"], stance["stand"]["qpos"]),
            ("torques", message["statics"]["joint_torques"], stance["statics"]["joint_torques"]),
        ):
            off = float(np.abs(np.asarray(one) - np.asarray(other)).max(initial=0.0))
            if not off <= ROUNDING_TOLERANCE:
                found.disagreements.append(f"best {objective}: {what} off by {off:.1e} in stand")


def _format_task_options(task: dict[str, Any]) -> list[str]:
    """Return the pose and the feet of a task as command-line options."""
    options = [f"--{name}={task[name]!r}" for name in ("height", "roll", "pitch", "yaw")]
    if task["offset"] is not None:
        options.append("--offset={!r},{!r}".format(*task["offset"]))
    moved = task["foot_offsets"].items()
    return options + ["--move={}={!r},{!r}".format(foot, *place) for foot, place in moved]


def _compare_workspace(found: Agreement, run: Commands, *, typed: bool) -> None:
    """Compare the bounds of ``workspace`` with stands just inside and just outside.

    The bounds are passed to ``solve_stand``, which ``stand`` calls, to save the simulations.

    Args:
        found: Results, to which contradictions are added.
        run: Runner of commands.
        typed: Whether the bounds of the height are typed into ``stand`` instead.
    """
    done, content = run("workspace")
    found.codes["workspace"] = f"exit {done.returncode}"
    if not content:
        found.disagreements.append(f"workspace: {done.stderr.strip()[-120:]}")
        return
    start, ends, robot = content["start"]["task"], content["intervals"], _load_robot(run.robot)
    for name in ("height", "roll", "pitch", "yaw"):
        for end, sign in (("low", -1), ("high", 1)):
            value, size = ends[name][end], abs(ends[name]["high"] - ends[name]["low"])
            for part in (-RANGE_EXCESS, RANGE_EXCESS):
                there = value + part * sign * size
                if abs(there) >= MAX_TURNS.get(name, math.inf) or (name == "height" and there <= 0):
                    continue  # it is searched no further
                if name == "height" and typed:
                    asked = [
                        option
                        for option in _format_task_options(start)
                        if not option.startswith("--height=")
                    ]
                    stood, _ = run("stand", f"--height={there!r}", *asked)
                    reached = "out of reach" not in stood.stderr
                else:
                    reached = _is_in_reach(robot, {**start, name: there})
                if reached is not (part < 0):
                    word = "in reach" if reached else "out of reach"
                    found.disagreements.append(
                        f"workspace: {name} {end} {value:.4g}, stand at {there:.4g}: {word}"
                    )


def _is_in_reach(robot: pa.Robot, task: dict[str, Any]) -> bool:
    """Return True if `solve_stand` solves a task given as JSON."""
    offsets = {foot: tuple(place) for foot, place in task["foot_offsets"].items()}
    pose = {name: task[name] for name in ("height", "roll", "pitch", "yaw")}
    offset = None if task["offset"] is None else tuple(task["offset"])
    try:
        pa.solve_stand(robot, pa.StandTask(**pose, offset=offset, foot_offsets=offsets))
    except pa.StanceUnreachableError:
        return False
    return True


def _compare_conversion(
    found: Agreement, run: Commands, stood: Answer, stance: dict[str, Any]
) -> None:
    """Compare the stand of a converted file with that of its source."""
    made = run.folder / "converted.xml"
    done, _ = run("convert", "-o", str(made), "--force")
    found.codes["convert"] = f"exit {done.returncode}"
    if not made.is_file():
        return
    if stood.returncode == 2:
        _compare_held(found, run, made)
        return
    for slope in ("0deg", "8deg"):
        before = (stood, stance) if slope == "0deg" else run("stand", "--slope", slope)
        after = run("stand", "--slope", slope, robot=(str(made),))
        found.codes[f"converted, {slope}"] = _result_code(*after)
        if before[0].returncode != after[0].returncode:
            found.disagreements.append(
                f"converted, slope {slope}: {_result_code(*before)}, then {_result_code(*after)}"
            )
        elif before[1] and after[1] and before[0].returncode == 0:
            one = sorted(np.abs(before[1]["statics"]["joint_torques"]))
            other = sorted(np.abs(after[1]["statics"]["joint_torques"]))
            # Numbers are written with the digits of the URDF, keyframes to a micrometre.
            if len(one) != len(other) or not np.allclose(one, other, rtol=1e-3, atol=1e-4):
                found.disagreements.append(f"converted, slope {slope}: other torques")


def _compare_hold(found: Agreement, run: Commands) -> None:
    """Check that ``hold`` holds its printed payload, which was simulated, and not 103 %."""
    done, content = run("hold")
    found.codes["hold"] = _result_code(done, content)
    payload = content.get("payload", {})
    # JSON has no infinity: what nothing limits is null there.
    bounds = [payload.get(name, math.nan) for name in ("mass", "servos")]
    most = min(math.inf if bound is None else bound for bound in bounds)
    if done.returncode != 0 or not 0 < most < math.inf:
        return
    if content.get("simulated_mass") is not None:
        most = content["simulated_mass"]
    if not most:
        return
    found.payload = most
    for part in (INSIDE, OUTSIDE):
        loaded, answered = run("hold", "--payload", f"{part * most:.9g}")
        code = _result_code(loaded, answered)
        found.codes[f"hold, {part} of it"] = code
        holds = part < 1
        if (loaded.returncode == 0) is not holds:
            found.disagreements.append(f"hold with {part} of {most:.4g} kg: {code}")


def _compare_held(found: Agreement, run: Commands, made: Path) -> None:
    """Compare the posture and torques of a converted arm with those of its source."""
    before, stated = run("hold")
    after, written = run("hold", robot=(str(made),))
    found.codes["converted, held"] = _result_code(after, written)
    if before.returncode != after.returncode:
        codes = _result_code(before, stated), _result_code(after, written)
        found.disagreements.append("converted: hold {}, then {}".format(*codes))
    if not stated or not written:
        return
    for what, one, other in (
        ("posture", stated["posture"]["qpos"], written["posture"]["qpos"]),
        ("torques", stated["statics"]["joint_torques"], written["statics"]["joint_torques"]),
    ):
        if len(one) != len(other) or not np.allclose(one, other, rtol=1e-3, atol=1e-4):
            found.disagreements.append(f"converted: hold has another {what}")


def write_random_robots(
    first: int, count: int, folder: Path
) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield names and files of random robots: two thirds are pairs, a third a URDF alone.

    Random URDFs have no shapes, and so no feet; a URDF alone is converted from the MJCF.
    """
    for seed in range(first, first + count):
        place = folder / f"random-{seed}"
        place.mkdir()
        pair = random_legged.write_robot(random_legged.draw_robot(seed), place)
        files: tuple[str, ...] = str(pair.urdf), str(pair.mjcf)
        if seed % 3 == 0:
            alone = place / "alone.urdf"
            answer("convert", str(pair.mjcf), "-o", str(alone), folder=place)
            if alone.is_file():  # no URDF has legs that hang from the world
                files = (str(alone),)
        yield f"random {seed}", files
