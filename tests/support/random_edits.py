"""Random one-place edits of what touches, options, keyframes and pairs of an MJCF, as a user makes.

`python -m tests.support.random_edits ROBOT.xml --count 100` compares what `diff` says of each with
bare MuJoCo: both files are simulated from the first keyframe, and every step is looked at.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from lxml import etree

import pupper_analysis as pa

FELT = 1e-4
"""m, rad: what moves a rollout by less is harmless."""

BAND = 1.5
"""Between `FELT` divided and multiplied by it either answer is right: blows move a sample more."""

SECONDS = 2.0

Element = etree._Element


class Edit(NamedTuple):
    """What was edited."""

    what: str
    element: Element | None = None


class Answer(NamedTuple):
    """What bare MuJoCo and `diff` make of an edit."""

    edit: str
    truth: float
    felt: bool
    same: bool
    placed: bool

    @property
    def right(self) -> bool:
        """Whether what moves a rollout is said to, at its line, and what does not is not."""
        if self.truth > FELT * BAND:
            return self.felt and self.placed
        return self.truth >= FELT / BAND or not self.felt


def _numbers(random: np.random.Generator, *spans: tuple[float, float]) -> str:
    return " ".join(f"{np.exp(random.uniform(*np.log(span))):.4g}" for span in spans)


Value = Callable[[np.random.Generator], str]


def _one(*choices: str) -> Value:
    return lambda random: str(random.choice(choices))


def _within(*spans: tuple[float, float]) -> Value:
    return lambda random: _numbers(random, *spans)


_GEOM: dict[str, Value] = {
    "friction": _within((0.01, 2.0), (1e-3, 0.1), (1e-4, 0.01)),
    "condim": _one("1", "3", "4", "6"),
    "solref": _within((0.004, 0.3), (0.3, 2.0)),
    "solimp": lambda random: (
        f"{random.uniform(0.01, 0.9):.3f} 0.95 {random.uniform(1e-3, 0.05):.4f}"
    ),
    "margin": _within((1e-3, 0.03)),
    "gap": _within((1e-4, 5e-3)),
    "contype": _one("0", "1", "2", "3"),
    "conaffinity": _one("0", "1", "2", "3"),
    "priority": _one("1", "2"),
    "solmix": _within((0.01, 10.0)),
    "rgba": _one("1 0 0 1"),
    "group": _one("1", "4"),
}
_OPTION: dict[str, Value] = {
    "timestep": _within((5e-4, 8e-3)),
    "integrator": _one("Euler", "RK4", "implicit", "implicitfast"),
    "cone": _one("pyramidal", "elliptic"),
    "solver": _one("PGS", "CG", "Newton"),
    "jacobian": _one("dense", "sparse"),
    "impratio": _within((0.5, 100.0)),
    "iterations": _one("1", "2", "5", "50", "100"),
    "tolerance": _within((1e-12, 1e-3)),
    "ls_iterations": _one("1", "5", "50"),
    "noslip_iterations": _one("0", "1", "5"),
    "gravity": lambda random: f"0 0 {-random.uniform(1.0, 12.0):.3f}",
    "wind": _one("1 0 0"),
    "density": _within((0.1, 100.0)),
}
_FLAG: dict[str, Value] = {
    name: _one("enable", "disable")
    for name in ("contact", "constraint", "gravity", "frictionloss", "limit", "warmstart",
                 "filterparent", "actuation", "refsafe", "eulerdamp", "multiccd", "energy")
}  # fmt: skip


def edit(tree: etree._ElementTree, random: np.random.Generator) -> Edit:
    """Makes one edit in an MJCF's tree."""
    root = tree.getroot()
    geoms = list(root.iter("geom"))
    keys = [key for key in root.iter("key") if key.get("qpos")]
    kind = str(random.choice(["geom", "geom", "geom", "size", "option", "flag", "key", "pair"]))
    if kind == "key" and keys:
        key = keys[0]
        words = [word for word in ("qpos", "ctrl") if key.get(word)]
        word = str(random.choice(words))
        values = [float(value) for value in str(key.get(word)).split()]
        number = int(random.integers(len(values)))
        values[number] += float(random.choice([-1, 1])) * 10 ** random.uniform(-6.0, -0.7)
        key.set(word, " ".join(map(repr, values)))
        return Edit(f"key {word}", key)
    if kind == "pair":
        named = [geom for geom in geoms if geom.get("name") and not _in_default(geom)]
        bodies = [body.get("name") for body in root.iter("body") if body.get("name")]
        if len(named) > 1 and random.integers(2):
            one, two = random.choice(len(named), 2, replace=False)
            ends = {"geom1": str(named[one].get("name")), "geom2": str(named[two].get("name"))}
            contact = etree.SubElement(root, "contact")
            etree.SubElement(contact, "pair", ends)
        elif len(bodies) > 1:
            one, two = random.choice(bodies, 2, replace=False)
            contact = etree.SubElement(root, "contact")
            etree.SubElement(contact, "exclude", body1=str(one), body2=str(two))
        return Edit("pair or exclude")
    if kind in ("option", "flag"):
        options = list(root.iter("option"))
        option = options[0] if options else etree.SubElement(root, "option")
        table = _OPTION if kind == "option" else _FLAG
        word = str(random.choice(list(table)))
        if kind == "flag":
            found = option.find("flag")
            option = etree.SubElement(option, "flag") if found is None else found
        option.set(word, table[word](random))
        return Edit(f"{kind} {word}")
    geom = geoms[int(random.integers(len(geoms)))]
    if kind == "size" and geom.get("size") and geom.get("type") != "plane":
        sizes = [float(value) * random.uniform(0.5, 2.0) for value in str(geom.get("size")).split()]
        geom.set("size", " ".join(map(repr, sizes)))
        return Edit("geom size", geom)
    word = str(random.choice(list(_GEOM)))
    geom.set(word, _GEOM[word](random))
    return Edit(f"geom {word}", geom)


def _in_default(geom: Element) -> bool:
    return any(parent.tag == "default" for parent in geom.iterancestors())


def rollout(path: Path, seconds: float = SECONDS) -> np.ndarray:
    """Returns the positions (steps, nq) of bare MuJoCo from the first keyframe."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    found = []
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
        found.append([data.time, *data.qpos])
    return np.array(found)


def apart(one: np.ndarray, two: np.ndarray) -> float:
    """Returns how far two rollouts are apart at the same times; infinite if one diverges alone."""
    if one.shape[1] != two.shape[1]:
        return float("inf")
    begun_anew = [bool((np.diff(run[:, 0]) < 0).any()) for run in (one, two)]
    if any(begun_anew):
        return 0.0 if all(begun_anew) else float("inf")
    times = one[:, 0] if len(one) <= len(two) else two[:, 0]
    times = times[times <= min(one[-1, 0], two[-1, 0])]
    steps = max(one[0, 0], two[0, 0])
    at = []
    for run in (one, two):  # of steps of other lengths, those at the same times
        near = np.abs(run[:, 0][:, None] - times[None, :]).argmin(axis=0)
        at.append(run[near])
    same = np.abs(at[0][:, 0] - at[1][:, 0]) < 1e-6 * steps
    gaps = np.abs(at[0][same, 1:] - at[1][same, 1:])
    return float(gaps.max(initial=0.0)) if same.any() else float("inf")


def answers(source: Path, count: int, first: int, scratch: Path) -> list[Answer]:
    """Edits a file anew for each seed, and asks `diff` and bare MuJoCo."""
    folder = scratch / "robot"
    shutil.copytree(source.parent, folder, copy_function=_linked)
    original, edited = folder / source.name, folder / f"edited_{source.name}"
    before, found = rollout(original), []
    for seed in range(first, first + 20 * count):
        if len(found) == count:
            break
        tree = etree.parse(original)
        made = edit(tree, np.random.default_rng([seed, 44]))
        tree.write(edited)
        try:
            truth = apart(before, rollout(edited))
        except ValueError:  # MuJoCo refuses it
            continue
        diff = pa.diff_models(original, edited)
        messages = [change for change in diff.changes if change.effects]
        felt = bool(messages) or any(each.code == "simulation-changes" for each in diff.combined)
        places = [change.new_place.rpartition(":")[2] for change in diff.changes]
        placed = made.element is None or str(_line(tree, made.element, edited)) in places
        found.append(Answer(f"{made.what}, seed {seed}", truth, felt, diff.same, placed))
    return found


def _line(tree: etree._ElementTree, element: Element, written: Path) -> int:
    """Returns an element's line in the file as it is written."""
    (there,) = etree.parse(written).xpath(tree.getpath(element))
    return int(there.sourceline)


def _linked(source: str, target: str) -> None:
    Path(target).symlink_to(Path(source).resolve())


def main() -> None:
    """Prints what `diff` misses, and how many it sees."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    wrong = 0
    for file in options.files:
        with tempfile.TemporaryDirectory() as scratch:
            found = answers(file.resolve(), options.count, options.first, Path(scratch))
        counts = Counter(
            "moves" if one.truth > FELT else "harmless, told" if not one.same else "not told"
            for one in found
        )
        print(f"{file.name}: {dict(counts)}; wrong: {sum(not one.right for one in found)}")
        for one in found:
            if not one.right:
                wrong += 1
                print(f"   {one}")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
