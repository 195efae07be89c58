"""Slips planted into public repositories, and whether `contract` finds them with both lines.

    python benchmarks/contract_slips.py FOLDER

FOLDER is that of `benchmarks/contract.py`, of which five robots are taken whose trainer and
deployment agree, or of which it is known in what they differ. A slip is one edit of one line of one
file: the order of three numbers, a sign, a scale, a default angle, a gain, a limit, degrees for
radians. It is found if something differs that did not before, of that quantity, at the line of the
edit and a line of another file. The exit status is 1 if one is not.
"""

from __future__ import annotations

import math
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
from contract import OURS, Case, cases

from pupper_analysis.tools.contract import read_contract
from pupper_analysis.tools.contract.findings import Disagreement

NUMBER = re.compile(r"(?<![\w.'])-?\d+\.?\d*(?:e-?\d+)?(?![\w.])")

SLIPS = ("order", "order", "sign", "sign", "scale", "scale", "default", "default", "kp", "kp",
         "limit", "unit")  # fmt: skip


class Slot(NamedTuple):
    """Where numbers of a quantity stand.

    Attributes:
        source: How the file's path ends.
        first: What stands before them.
        last: What stands after them.
        quantities: What a finding may be of.
    """

    source: str
    first: str
    last: str
    quantities: tuple[str, ...]


_ANGLE = ("default angle", "action offset")
DEPLOY = {
    "default": Slot("deploy.yaml", "default_joint_pos:", "]", _ANGLE),
    "scale": Slot("deploy.yaml", "    scale: [", "]", ("action scale",)),
    "kp": Slot("deploy.yaml", "stiffness:", "]", ("kp",)),
}
GYM = "deploy/deploy_mujoco/configs/g1.yaml"
LITE = "policy_humanoid.yaml"
PAIRS: dict[tuple[str, str], dict[str, Slot]] = {
    ("JensenLav/unitree_rl_mjlab", "go2"): {
        **DEPLOY,
        "limit": Slot("go2_constants.py", "effort_limit=", ",", ("effort",)),
    },
    ("unitreerobotics/unitree_rl_gym", "g1"): {
        "default": Slot(GYM, "default_angles:", "]", _ANGLE),
        "scale": Slot(GYM, "action_scale:", "\n", ("action scale",)),
        "kp": Slot(GYM, "kps:", "]", ("kp",)),
        "limit": Slot("g1_12dof.urdf", 'effort="', '"', ("effort",)),
    },
    ("unitreerobotics/unitree_rl_lab", "g1"): {
        **DEPLOY,
        "limit": Slot("g1_29dof_rev_1_0.urdf", 'velocity="', '"', ("velocity",)),
    },
    ("HybridRobotics/Berkeley-Humanoid-Lite", "humanoid"): {
        "default": Slot(LITE, "default_joint_positions:", "num_observations", _ANGLE),
        "scale": Slot(LITE, "action_scale:", "\n", ("action scale",)),
        "kp": Slot(LITE, "joint_kp:", "joint_kd:", ("kp",)),
        "limit": Slot(LITE, "effort_limits:", "default_base_position:", ("effort",)),
    },
    ("G-Levine/neural_controller", "Pupper v3"): {
        "default": Slot("config.yaml", "default_joint_pos:", "]", _ANGLE),
        "scale": Slot("env.py", "scale=", ",", ("action scale",)),
        "kp": Slot("env.py", "stiffness=", ",", ("kp",)),
        "limit": Slot("policy_latest.json", '"joint_upper_limits":', "]", ("upper limit",)),
    },
}

GO2 = "fan-ziqi/robot_lab/source/robot_lab/data/Robots/unitree/go2_description/urdf"
"""The Go2's URDF, which states limits of its motors: the MJCF beside that trainer has none."""

ENV = """from isaaclab import ArticulationCfg, DCMotorCfg, EnvCfg, JointPositionActionCfg

ROBOT = ArticulationCfg(
    init_state=ArticulationCfg.InitialStateCfg(joint_pos={
        "leg_.*_r_1": 0.26, "leg_.*_l_1": -0.26, "leg_.*_r_3": -0.52, "leg_.*_l_3": 0.52}),
    actuators={"legs": DCMotorCfg(
        joint_names_expr=["leg_.*"],
        stiffness=5.0,
        damping=0.25,
        effort_limit=3.0,
    )},
)
WALK = EnvCfg(
    scene=ROBOT,
    actions=JointPositionActionCfg(
        joint_names=[".*"],
        scale=0.75,
    ),
)
"""
"""Pupper v3's numbers as a trainer of Isaac Lab would state them: its own is not public."""


class Edit(NamedTuple):
    """An edit: the file's new text, the lines that it changed, and what a finding may be of."""

    path: Path
    text: str
    lines: tuple[int, ...]
    quantities: tuple[str, ...]


def plant(home: Path, paths: list[Path], slot: Slot, slip: str, seed: int) -> Edit:
    """Returns a slip in one of the sources, or in a module that one imports."""
    every = [*paths, *home.rglob(Path(slot.source).name)]
    path = next(one for one in every if str(one).endswith(slot.source))
    text = path.read_text()
    start = text.index(slot.first) + len(slot.first)
    spans = [one.span() for one in NUMBER.finditer(text, start, text.index(slot.last, start))]
    values = [float(text[a:b]) for a, b in spans]
    at = np.random.default_rng(seed)
    bent = [number for number, value in enumerate(values) if value]
    changed = dict[int, float]()
    if slip == "order":  # three numbers in a row that are not all the same
        rows = [n for n in range(len(values) - 2) if len(set(values[n : n + 3])) == 3]
        rows = rows or [n for n in range(len(values) - 2) if len(set(values[n : n + 3])) > 1]
        row = int(at.choice(rows))
        changed = {row + n: values[row + (n + 1) % 3] for n in range(3)}
    elif slip == "unit":
        changed = {number: round(math.degrees(value), 2) for number, value in enumerate(values)}
    else:
        change: dict[str, Callable[[float], float]] = {
            "sign": lambda x: -x, "scale": lambda x: 0.6 * x, "kp": lambda x: 1.4 * x,
            "default": lambda x: x + 0.12, "limit": lambda x: 0.6 * x,
        }  # fmt: skip
        number = int(at.choice(bent))
        changed = {number: round(change[slip](values[number]), 4)}
    changed = {number: value for number, value in changed.items() if value != values[number]}
    for number in sorted(changed, reverse=True):
        a, b = spans[number]
        text = f"{text[:a]}{changed[number]}{text[b:]}"
    lines = tuple(1 + text.count("\n", 0, spans[number][0]) for number in changed)
    return Edit(path, text, lines, slot.quantities)


def found_by(found: Disagreement, edit: Edit) -> bool:
    """Whether a finding is of an edit, with its line and another file's."""
    mine = {f"{edit.path}:{line}" for line in edit.lines}
    theirs = [place for place in found.places if not place.startswith(f"{edit.path}:")]
    return found.kind in edit.quantities and bool(mine & set(found.places)) and len(theirs) == 1


def run(home: Path, case: Case, slots: dict[str, Slot]) -> Iterator[tuple[str, bool, str]]:
    """Yields (slip, whether it is found, what is found) of a robot."""
    paths = case.paths(home)
    if case.repository.startswith("G-Levine"):
        for number, one in enumerate(paths):  # ours are not edited
            if one.is_relative_to(OURS) and one.suffix == ".urdf":
                paths[number] = Path(shutil.copy(one, home / one.name))
        paths.append(home / "env.py")
        paths[-1].write_text(ENV)
    if case.robot == "go2":
        paths.append(home / "go2_description.urdf")

    def read() -> dict[tuple[object, ...], Disagreement]:
        found = read_contract(*paths, stand=False).findings
        return {(one.kind, one.joints, one.values, one.places): one for one in found}

    before = read()
    for number, slip in enumerate(SLIPS):
        slot = slots.get(slip, slots["default"])
        edit = plant(home, paths, slot, slip, number)
        kept = edit.path.read_text()
        edit.path.write_text(edit.text)
        new = [one for key, one in read().items() if key not in before]
        edit.path.write_text(kept)
        hits = [one for one in new if found_by(one, edit)]
        slips = {one.probable_mistake for one in hits if one.probable_mistake != "mirror"}
        right = slip in slips if slip in ("order", "sign", "unit") else bool(slips)
        words = (hits or new or [None])[0]
        yield slip, right, f"{Path(edit.path).name}:{edit.lines}: {words and words.message}"


@click.command()
@click.argument("folder", type=click.Path(exists=True, file_okay=False, path_type=Path))
def main(folder: Path) -> None:
    """Plants 60 slips into copies of five public robots' sources."""
    known = {(one.repository, one.robot): one for one in cases()}
    count, lost = 0, 0
    for key, slots in PAIRS.items():
        with tempfile.TemporaryDirectory() as made:
            home = Path(made)
            for repository in known[key].repositories:
                shutil.copytree(folder / repository, home / repository, symlinks=True)
            shutil.copy(folder / GO2 / "go2_description.urdf", home)
            for slip, right, words in run(home, known[key], slots):
                count, lost = count + 1, lost + (not right)
                click.echo(f"{'found' if right else 'LOST '} {key[0]} {slip}: {words[:180]}")
    click.echo(f"{count} slips, {count - lost} found with both lines")
    sys.exit(bool(lost))


if __name__ == "__main__":
    main()
