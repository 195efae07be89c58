"""One plausible slip in files that stand: `python benchmarks/one_slip.py --count 10000`.

Robots that stand by themselves get one slip each: a sign, a factor of ten, a unit, a swapped pair,
an attribute of another element ... Bare MuJoCo runs an MJCF as it is, from its own keyframe. None
that falls is to be said to HOLD, none that no engine takes to be OK, and none of whose numbers
that both formats have one differs is to AGREE; nothing is to end in an exception of no type of
ours. Of a file without ground it is to be said that one was added.
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
from bases import BASES, FALLS, by_itself, standing
from slip_generator import draw_slip
from tables import write_csv

from tests.support.legged import Pair

WHOLE = 60
"""Of so many that stand, one goes through the whole chain, for exceptions."""

LONG = 12.0
"""s: a stand's simulation."""


@cache
def base(name: str, folder: str) -> tuple[bytes, bytes]:
    """Returns a robot's URDF and MJCF."""
    top = Path(folder) / name
    made = Pair(top / "robot.urdf", top / "robot.xml")
    if not made.mjcf.exists():
        top.mkdir(parents=True, exist_ok=True)
        standing(name, top)
    return made.urdf.read_bytes(), made.mjcf.read_bytes()


def case(argument: tuple[str, int, int, str]) -> dict[str, Any]:
    """Makes one slip, and looks at what is said of it."""
    name, seed, number, folder = argument
    random = np.random.default_rng([seed, number])
    of_urdf = bool(random.integers(4) == 0)
    texts = base(name, folder)
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
        result = judge(pair, plain, whole=number % WHOLE == 0)
    kind = "urdf" if of_urdf else "mjcf"
    spent = round(time.process_time() - began, 3)
    return {"robot": name, "file": kind, "slip": said, **result, "seconds": spent}


def typed(result: dict[str, Any], what: str, call: Callable[[], Any]) -> Any:
    """Returns what a call does, or None; an exception that is not ours is written down."""
    try:
        return call()
    except pa.PupperAnalysisError as error:
        result[what] = f"refused: {error}"[:200]
    except Exception as error:
        result["untyped"] = f"{what}: {type(error).__name__}: {error}"[:300]
    return None


def audited(result: dict[str, Any], path: Path) -> None:
    audit = typed(result, "audit", lambda: pa.audit_model(path))
    if audit is not None:
        errors, warned = audit.counts["error"], audit.counts["warning"]
        result["audit"] = "ERRORS" if errors else "WARNINGS" if warned else "OK"
        result["rules"] = sorted(
            {found.rule for found in audit.findings if found.severity != "info"}
        )


def judge_mjcf(pair: Pair, plain: Pair, *, whole: bool) -> dict[str, Any]:
    """Compares what bare MuJoCo does with what is said."""
    result: dict[str, Any] = {"bad": []}
    try:
        lost = by_itself(pair.mjcf)
        if _keyless(pair.mjcf):  # nothing says where it is to stand
            return {**result, "bare": "no keyframe"}
        if _groundless(pair.mjcf):  # as most are published: a floor is added, and that is said
            return judge_groundless(pair, {**result, "bare": "no ground"})
    except (ValueError, RuntimeError) as error:
        lost, result["refusal"] = math.nan, str(error).splitlines()[0][:120]
    except (ZeroDivisionError, OverflowError, mujoco.FatalError):
        lost = math.inf
    falls = not abs(lost) <= FALLS and not math.isnan(lost)
    result["lost"] = round(lost, 6)
    result["bare"] = "refused" if math.isnan(lost) else "falls" if falls else "stands"
    if result["bare"] != "stands" or whole:
        audited(result, pair.mjcf)
    if math.isnan(lost) and result.get("audit") in ("OK", "WARNINGS"):
        result["bad"].append(f"{result['audit']}, and MuJoCo refuses it")
    lasting = falls and not abs(by_itself(pair.mjcf, LONG)) <= FALLS  # and does not merely bob
    if falls and result.get("audit") == "OK":
        result["bad"].append("OK, and it falls")
    if falls or whole:
        loaded = typed(result, "stand", lambda: pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf))
        own = None if loaded is None else own_run(loaded)
        collapses = own is not None and own.fails
        if loaded is not None:
            result["stand"] = "its own run collapses"
        if loaded is not None and (whole or not collapses):
            stance = typed(result, "stand", lambda: study_stance(loaded, pa.StandTask()))
            if stance is not None:
                result["stand"] = stance.verdict.code.value
                if lasting and stance.verdict.passed:
                    result["bad"].append(f"it falls, and {stance.verdict.code.value}")
    if not math.isnan(lost):
        differs = typed(result, "numbers", lambda: _mjcf_differs(pair.mjcf, plain.mjcf))
        if differs or whole:
            compared = typed(
                result, "crosscheck", lambda: pa.compare_models(pair.urdf, pair.mjcf).agree
            )
            if compared is not None:
                result["crosscheck"] = "AGREE" if compared else "DISAGREE"
                if compared and differs:
                    result["bad"].append(f"AGREE, but {differs}")
    if whole:
        out = pair.mjcf.with_name("converted.urdf")
        typed(result, "convert", lambda: pa.convert_model(pair.mjcf, out))
    return result


@silence_mujoco()
def _keyless(path: Path) -> bool:
    return not mujoco.MjModel.from_xml_path(str(path)).nkey


@silence_mujoco()
def _groundless(path: Path) -> bool:
    """Whether the world has nothing that a robot could stand on."""
    model = mujoco.MjModel.from_xml_path(str(path))
    still = model.body_weldid[model.geom_bodyid] == 0
    return not (still & ((model.geom_contype != 0) | (model.geom_conaffinity != 0))).any()


def judge_groundless(pair: Pair, result: dict[str, Any]) -> dict[str, Any]:
    """Looks whether it is said that the robot stands on a floor that is not the file's."""
    loaded = typed(result, "stand", lambda: pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf))
    if loaded is not None and not any(note.code == "ground-added" for note in loaded.notes):
        result["bad"].append("no ground, and nothing is said of it")
    return result


@cache
def _plain(path: Path) -> mujoco.MjModel:
    with silence_mujoco():
        return mujoco.MjModel.from_xml_path(str(path))


@silence_mujoco()
def _mjcf_differs(path: Path, plain: Path) -> str:
    """Says which of the numbers that a URDF has, too, is another than it was; "" if none."""
    new, old = mujoco.MjModel.from_xml_path(str(path)), _plain(plain)
    sizes = [(m.nbody, m.njnt, m.nv) for m in (new, old)]
    if sizes[0] != sizes[1]:
        return ""  # other bodies: what it is then is crosscheck's to say
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
        one, two = getattr(new, what)[moving], getattr(old, what)[moving]
        if np.abs(one.astype(float) - two).max() > 1e-3:
            return f"its {what} differs"
    return ""


def judge_urdf(pair: Pair, plain: Pair, *, whole: bool) -> dict[str, Any]:
    """Compares what Pinocchio and MuJoCo read with what is said."""
    result: dict[str, Any] = {"bad": []}
    new = _pinocchio(pair.urdf)
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
        audited(result, pair.urdf)
    if not taken and result.get("audit") in ("OK", "WARNINGS"):
        result["bad"].append(f"{result['audit']}, and no engine takes it")
    differs = _urdf_differs(new, plain.urdf)
    if differs or whole or not taken:
        compared = typed(
            result, "crosscheck", lambda: pa.compare_models(pair.urdf, pair.mjcf).agree
        )
        if compared is not None:
            result["crosscheck"] = "AGREE" if compared else "DISAGREE"
            if compared and (differs or not taken):
                result["bad"].append(f"AGREE, but {differs or 'no engine takes it'}")
    if whole:
        out = pair.mjcf.with_name("converted.xml")
        typed(result, "convert", lambda: pa.convert_model(pair.urdf, out))
        loaded = typed(result, "stand", lambda: pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf))
        if loaded is not None:
            stance = typed(result, "stand", lambda: study_stance(loaded, pa.StandTask()))
            result["stand"] = result.get("stand") or (stance and stance.verdict.code.value)
    return result


def _pinocchio(path: Path) -> pin.Model | None:
    try:
        model = pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer())
    except Exception:  # of any kind, by the binding
        return None
    return model


@cache
def _of_plain(path: Path) -> pin.Model:
    return _pinocchio(path)


def _urdf_differs(new: pin.Model | None, plain: Path) -> str:
    """Says which of Pinocchio's numbers is another than it was; "" if none."""
    old = _of_plain(plain)
    if new is None or sorted(new.names) != sorted(old.names) or new.nq != old.nq:
        return ""
    if list(new.names) != list(old.names):
        return ""
    for what in ("lowerPositionLimit", "upperPositionLimit", "effortLimit"):
        one, two = getattr(new, what)[6:], getattr(old, what)[6:]
        if not np.allclose(one, two, rtol=1e-3, atol=1e-3):
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


def counted(results: list[dict[str, Any]]) -> list[tuple[object, ...]]:
    """Returns a row of `COLUMNS` for each robot, and for all: what came of the slips."""
    lines = []
    names = [name for name in BASES if any(result.get("robot") == name for result in results)]
    for name in [*names, "all"]:
        own = [result for result in results if name in ("all", result.get("robot"))]
        kinds = Counter(result.get("bare") for result in own if result.get("file") == "mjcf")
        urdf = sum(result.get("file") == "urdf" for result in own)
        bad = sum(wrong(result) for result in own)
        bare = (kinds["refused"], kinds["falls"], kinds["stands"])
        lines.append((name, len(own), *bare, urdf, bad))
    return lines


def wrong(result: dict[str, Any]) -> bool:
    """Whether something is said that is not so, or nothing that can be read."""
    return bool(result.get("bad") or result.get("untyped") or result.get("crash"))


@click.command()
@click.option("--count", default=200, help="How many slips.")
@click.option("--seed", default=0)
@click.option("--first", default=0, help="The number of the first.")
@click.option("--robot", multiple=True, type=click.Choice(list(BASES)))
@click.option("--again", is_flag=True, help="Run those anew of which something is said wrongly.")
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
    """Makes slips, and counts what is said of them; resumes where it was stopped."""
    folder.mkdir(parents=True, exist_ok=True)
    names = robot or tuple(BASES)
    for name in names:
        base(name, str(folder))
    cases = []
    for number in range(first, first + count):
        name = names[number % len(names)]
        cases.append((f"{name}/{seed}/{number}", (name, seed, number, str(folder))))
    if again:
        guarded.forget(folder / "slips.jsonl", wrong)
    results = guarded.run(case, cases, folder / "slips.jsonl")
    lines = counted(results)
    for line in [COLUMNS, *lines]:
        click.echo(" | ".join(map(str, line)))
    if to is not None:
        write_csv(to, COLUMNS, lines)
    bad = [result for result in results if wrong(result)]
    for one in bad:
        click.echo(f"BAD {one}")
    if bad:
        raise SystemExit(f"{len(bad)} of {len(results)}")


if __name__ == "__main__":
    main()
