"""Plant a single plausible mistake in files that stand: `python benchmarks/one_slip.py --count
10000`.

Robots that stand without additions get one mistake each: a sign, a factor of ten, a unit, a swapped
pair, an attribute of another element ... MuJoCo alone simulates the MJCF from its own keyframe. A
report is wrong if a falling robot gets HOLDS, if `audit` reports OK for a file that no engine
reads, if `crosscheck` reports AGREE although a number that both formats contain differs, or if an
exception is not of this package. For a file without ground, a note must state that a floor was
added.
"""

from __future__ import annotations

import math
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import click
import mujoco
import numpy as np
import pinocchio as pin
from lxml import etree

import pupper_analysis as pa
from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.prepare.own_run import own_run
from pupper_analysis.tools.stand.stance import study_stance

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import guarded
from bases import BASES, MAX_HEIGHT_LOSS, simulate_from_keyframe, write_standing_robot
from slip_generator import draw_slip
from tables import write_csv

from tests.support.legged import Pair

FULL_TEST_INTERVAL = 60
"""Of so many standing robots, one runs through all commands, to find exceptions. Chosen, not
tuned."""

LONG_DURATION = 12.0
"""Time [s] of a second simulation of a falling robot. Chosen, not tuned."""


@cache
def read_base(name: str, folder: str) -> tuple[bytes, bytes]:
    """Return the texts of the URDF and MJCF of a robot, which are written at the first call."""
    top = Path(folder) / name
    made = Pair(top / "robot.urdf", top / "robot.xml")
    if not made.mjcf.exists():
        top.mkdir(parents=True, exist_ok=True)
        write_standing_robot(name, top)
    return made.urdf.read_bytes(), made.mjcf.read_bytes()


def run_case(argument: tuple[str, int, int, str]) -> dict[str, Any]:
    """Plant a mistake, and return the reports about the files.

    Args:
        argument: (robot, seed, number, folder) of the case.
    """
    name, seed, number, folder = argument
    random = np.random.default_rng([seed, number])
    of_urdf = bool(random.integers(4) == 0)
    texts = read_base(name, folder)
    root = etree.fromstring(texts[0 if of_urdf else 1])
    said = ""
    for _ in range(20):
        said = draw_slip(root, random)
        if said and etree.tostring(root) != texts[0 if of_urdf else 1]:
            break
    began = time.process_time()
    with tempfile.TemporaryDirectory() as top, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        pair = Pair(Path(top) / "robot.urdf", Path(top) / "robot.xml")
        pair.urdf.write_bytes(etree.tostring(root) if of_urdf else texts[0])
        pair.mjcf.write_bytes(texts[1] if of_urdf else etree.tostring(root))
        plain = Pair(Path(folder) / name / "robot.urdf", Path(folder) / name / "robot.xml")
        judge = judge_urdf if of_urdf else judge_mjcf
        result = judge(pair, plain, whole=number % FULL_TEST_INTERVAL == 0)
    kind = "urdf" if of_urdf else "mjcf"
    spent = round(time.process_time() - began, 3)
    return {"robot": name, "file": kind, "slip": said, **result, "seconds": spent}


def call_recorded(result: dict[str, Any], what: str, call: Callable[[], Any]) -> Any:
    """Return the result of a function; None, with the message in ``result``, if it raises an error.

    Args:
        result: Result of the case; modified. An exception of another package is recorded under
            "untyped".
        what: Key of a refusal by this package.
        call: The function.
    """
    try:
        return call()
    except pa.PupperAnalysisError as error:
        result[what] = f"refused: {error}"[:200]
    except Exception as error:
        result["untyped"] = f"{what}: {type(error).__name__}: {error}"[:300]
    return None


def add_audit(result: dict[str, Any], path: Path) -> None:
    """Add the severity of an audit, and the rules that report errors or warnings, to a result."""
    audit = call_recorded(result, "audit", lambda: pa.audit_model(path))
    if audit is not None:
        errors, warned = audit.counts["error"], audit.counts["warning"]
        result["audit"] = "ERRORS" if errors else "WARNINGS" if warned else "OK"
        result["rules"] = sorted(
            {found.rule for found in audit.findings if found.severity != "note"}
        )


def judge_mjcf(pair: Pair, plain: Pair, *, whole: bool) -> dict[str, Any]:
    """Compare MuJoCo's simulation of an MJCF with the reports of this package.

    Args:
        pair: Files with the mistake, in the MJCF.
        plain: Files without the mistake.
        whole: Whether all commands run.
    """
    result: dict[str, Any] = {"bad": []}
    try:
        lost = simulate_from_keyframe(pair.mjcf)
        if _has_no_keyframe(pair.mjcf):  # the file states no stand
            return {**result, "bare": "no keyframe"}
        if _has_no_ground(pair.mjcf):  # a floor is added, with a note
            return judge_groundless(pair, {**result, "bare": "no ground"})
    except (ValueError, RuntimeError) as error:
        lost, result["refusal"] = math.nan, str(error).splitlines()[0][:120]
    except (ZeroDivisionError, OverflowError, mujoco.FatalError):
        lost = math.inf
    falls = not abs(lost) <= MAX_HEIGHT_LOSS and not math.isnan(lost)
    result["lost"] = round(lost, 6)
    result["bare"] = "refused" if math.isnan(lost) else "falls" if falls else "stands"
    if result["bare"] != "stands" or whole:
        add_audit(result, pair.mjcf)
    if math.isnan(lost) and result.get("audit") in ("OK", "WARNINGS"):
        result["bad"].append(f"{result['audit']}, and MuJoCo refuses it")
    if falls and result.get("audit") == "OK":
        result["bad"].append("OK, and it falls")
    if falls or whole:
        loaded = call_recorded(
            result, "stand", lambda: pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf)
        )
        own = None if loaded is None else own_run(loaded)
        collapses = own is not None and own.fails
        if loaded is not None:
            result["stand"] = "its own run collapses"
        if loaded is not None and (whole or not collapses):
            stance = call_recorded(result, "stand", lambda: study_stance(loaded, pa.StandTask()))
            if stance is not None:
                result["stand"] = stance.verdict.code.value
                lost_later = (
                    simulate_from_keyframe(pair.mjcf, LONG_DURATION)
                    if falls and stance.verdict.passed
                    else 0.0
                )
                if not abs(lost_later) <= MAX_HEIGHT_LOSS:  # and it does not merely bob
                    result["bad"].append(f"it falls, and {stance.verdict.code.value}")
    if not math.isnan(lost):
        differs = call_recorded(result, "numbers", lambda: _mjcf_differs(pair.mjcf, plain.mjcf))
        if differs or whole:
            compared = call_recorded(
                result, "crosscheck", lambda: pa.compare_models(pair.urdf, pair.mjcf).agree
            )
            if compared is not None:
                result["crosscheck"] = "AGREE" if compared else "DISAGREE"
                if compared and differs:
                    result["bad"].append(f"AGREE, but {differs}")
    if whole:
        out = pair.mjcf.with_name("converted.urdf")
        call_recorded(result, "convert", lambda: pa.convert_model(pair.mjcf, out))
    return result


@silence_mujoco()
def _has_no_keyframe(path: Path) -> bool:
    """Return True if an MJCF has no keyframe."""
    return not mujoco.MjModel.from_xml_path(str(path)).nkey


@silence_mujoco()
def _has_no_ground(path: Path) -> bool:
    """Return True if the world of an MJCF has no collidable geom."""
    model = mujoco.MjModel.from_xml_path(str(path))
    still = model.body_weldid[model.geom_bodyid] == 0
    return not (still & ((model.geom_contype != 0) | (model.geom_conaffinity != 0))).any()


def judge_groundless(pair: Pair, result: dict[str, Any]) -> dict[str, Any]:
    """Check that a note states that a floor was added."""
    loaded = call_recorded(result, "stand", lambda: pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf))
    if loaded is not None and not any(note.code == "ground-added" for note in loaded.notes):
        result["bad"].append("no ground, and nothing is said of it")
    return result


@cache
def _compile_unmodified(path: Path) -> mujoco.MjModel:
    """Return the compiled model of an MJCF without mistake."""
    with silence_mujoco():
        return mujoco.MjModel.from_xml_path(str(path))


@silence_mujoco()
def _mjcf_differs(path: Path, plain: Path) -> str:
    """Return the name of a changed quantity that a URDF contains, too.

    "" if none has changed, or the models have other bodies, joints or zero angles.
    """
    new, old = mujoco.MjModel.from_xml_path(str(path)), _compile_unmodified(plain)
    sizes = [(m.nbody, m.njnt, m.nv) for m in (new, old)]
    if sizes[0] != sizes[1]:
        return ""  # other bodies: only `crosscheck` can compare these models
    random, states = np.random.default_rng(0), []
    start = np.concatenate([[0, 0, 0.5, 1, 0, 0, 0], random.uniform(-0.5, 0.5, new.nv - 6)])
    for model in (new, old):
        if model.nq != len(start) or model.jnt_type[0] != mujoco.mjtJoint.mjJNT_FREE:
            return ""
        data = mujoco.MjData(model)
        data.qpos[:] = start
        if (model.qpos0[7:] != old.qpos0[7:]).any():
            return ""  # angles of another zero: the same robot
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_crb(model, data)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        full[np.diag_indices(model.nv)] -= model.dof_armature
        states.append({"mass matrix": full, "masses": model.body_mass[1:]})
    for what, values in states[0].items():
        scale = np.abs(states[1][what]).max()
        if not np.abs(values - states[1][what]).max() <= 1e-3 * scale:
            return f"its {what} differs"
    for what in ("jnt_range", "jnt_limited"):
        moving = new.jnt_type >= 2
        first, second = getattr(new, what)[moving], getattr(old, what)[moving]
        if np.abs(first.astype(float) - second).max() > 1e-3:
            return f"its {what} differs"
    return ""


def judge_urdf(pair: Pair, plain: Pair, *, whole: bool) -> dict[str, Any]:
    """Compare the models of Pinocchio and MuJoCo with the reports of this package.

    Args:
        pair: Files with the mistake, in the URDF.
        plain: Files without the mistake.
        whole: Whether all commands run.
    """
    result: dict[str, Any] = {"bad": []}
    new = _build_pinocchio(pair.urdf)
    taken = new is not None
    if not taken:
        try:
            with silence_mujoco():
                mujoco.MjModel.from_xml_path(str(pair.urdf))
            taken = True
        except (ValueError, RuntimeError) as error:
            result["refusal"] = str(error).splitlines()[0][:120]
    result["bare"] = "taken" if taken else "refused"
    if not taken or whole:
        add_audit(result, pair.urdf)
    if not taken and result.get("audit") in ("OK", "WARNINGS"):
        result["bad"].append(f"{result['audit']}, and no engine takes it")
    differs = _urdf_differs(new, plain.urdf)
    if differs or whole or not taken:
        compared = call_recorded(
            result, "crosscheck", lambda: pa.compare_models(pair.urdf, pair.mjcf).agree
        )
        if compared is not None:
            result["crosscheck"] = "AGREE" if compared else "DISAGREE"
            if compared and (differs or not taken):
                result["bad"].append(f"AGREE, but {differs or 'no engine takes it'}")
    if whole:
        out = pair.mjcf.with_name("converted.xml")
        call_recorded(result, "convert", lambda: pa.convert_model(pair.urdf, out))
        loaded = call_recorded(
            result, "stand", lambda: pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf)
        )
        if loaded is not None:
            stance = call_recorded(result, "stand", lambda: study_stance(loaded, pa.StandTask()))
            result["stand"] = result.get("stand") or (stance and stance.verdict.code.value)
    return result


def _build_pinocchio(path: Path) -> pin.Model | None:
    """Return Pinocchio's model of a URDF; None if Pinocchio raises an error."""
    try:
        model = pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer())
    except Exception:  # of any kind, by the binding
        return None
    return model


@cache
def _build_unmodified(path: Path) -> pin.Model:
    """Return Pinocchio's model of a URDF without mistake."""
    return _build_pinocchio(path)


def _urdf_differs(new: pin.Model | None, plain: Path) -> str:
    """Return the name of a quantity that differs in Pinocchio's models.

    "" if none differs, or the models have other joints.
    """
    old = _build_unmodified(plain)
    if new is None or sorted(new.names) != sorted(old.names) or new.nq != old.nq:
        return ""
    if list(new.names) != list(old.names):
        return ""
    for what in ("lowerPositionLimit", "upperPositionLimit", "effortLimit"):
        first, second = getattr(new, what)[6:], getattr(old, what)[6:]
        if not np.allclose(first, second, rtol=1e-3, atol=1e-3):
            return f"its {what} differs"
    q = pin.neutral(old)
    q[7:] = np.random.default_rng(0).uniform(-0.5, 0.5, old.nq - 7)
    masses = []
    for model in (new, old):
        data = model.createData()
        upper = np.triu(pin.crba(model, data, q))
        masses.append(upper)
    if not np.abs(masses[0] - masses[1]).max() <= 1e-3 * np.abs(masses[1]).max():
        return "its mass matrix differs"
    return ""


COLUMNS = ("robot", "slips", "refused", "falls", "stands", "of the URDF", "said wrongly")
"""Columns of the table."""


def count_outcomes(results: list[dict[str, Any]]) -> list[tuple[object, ...]]:
    """Return rows with the columns `COLUMNS`, for each robot and for all."""
    lines = []
    names = [name for name in BASES if any(result.get("robot") == name for result in results)]
    for name in [*names, "all"]:
        own = [result for result in results if name in ("all", result.get("robot"))]
        kinds = Counter(result.get("bare") for result in own if result.get("file") == "mjcf")
        urdf = sum(result.get("file") == "urdf" for result in own)
        bad = sum(is_wrong(result) for result in own)
        bare = (kinds["refused"], kinds["falls"], kinds["stands"])
        lines.append((name, len(own), *bare, urdf, bad))
    return lines


def is_wrong(result: dict[str, Any]) -> bool:
    """Return True if a report is wrong, or a case ended in a crash or a foreign exception."""
    return bool(result.get("bad") or result.get("untyped") or result.get("crash"))


@click.command()
@click.option("--count", default=200, help="How many slips.")
@click.option("--seed", default=0)
@click.option("--first", default=0, help="The number of the first.")
@click.option("--robot", multiple=True, type=click.Choice(list(BASES)))
@click.option("--again", is_flag=True, help="Run the cases with a wrong report again.")
@click.option("--folder", type=click.Path(path_type=Path), default=Path("build/slips"))
@click.option("--csv", "to", type=click.Path(path_type=Path), help="Write the counts here.")
def main(
    count: int,
    seed: int,
    first: int,
    robot: tuple[str, ...],
    again: bool,
    folder: Path,
    to: Path | None,
) -> None:
    """Plant mistakes, and count the wrong reports; resumes a stopped run."""
    folder.mkdir(parents=True, exist_ok=True)
    names = robot or tuple(BASES)
    for name in names:
        read_base(name, str(folder))
    cases = []
    for number in range(first, first + count):
        name = names[number % len(names)]
        cases.append((f"{name}/{seed}/{number}", (name, seed, number, str(folder))))
    if again:
        guarded.remove_results(folder / "slips.jsonl", is_wrong)
    results = guarded.run_cases(run_case, cases, folder / "slips.jsonl")
    lines = count_outcomes(results)
    for line in [COLUMNS, *lines]:
        click.echo(" | ".join(map(str, line)))
    if to is not None:
        write_csv(to, COLUMNS, lines)
    bad = [result for result in results if is_wrong(result)]
    for one in bad:
        click.echo(f"BAD {one}")
    if bad:
        raise SystemExit(f"{len(bad)} of {len(results)}")


if __name__ == "__main__":
    main()
