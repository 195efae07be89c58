"""Plant mistakes into public repositories, and count those that `contract` finds with both lines.

    python benchmarks/contract_slips.py FOLDER

FOLDER is that of `benchmarks/contract.py`. The robots of `PAIRS` are used, whose trainer and
deployment agree, or whose differences are known. A mistake is an edit of a file: the order of three
numbers, a sign, a scale, a default angle, a gain, a limit, or degrees instead of radians. It is
found if there is a new finding of this quantity, at the edited line and a line of another file; for
order, sign and unit, the finding must also name this mistake. The exit status is 1 if a mistake is
not found.
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
from contract import PROJECT_FOLDER, Case, list_cases

from pupper_analysis.tools.contract import read_contract
from pupper_analysis.tools.contract.findings import Disagreement

NUMBER = re.compile(r"(?<![\w.'])-?\d+\.?\d*(?:e-?\d+)?(?![\w.])")
"""Pattern of a number in a source file."""

SLIPS = ("order", "order", "sign", "sign", "scale", "scale", "default", "default", "kp", "kp",
         "limit", "unit")  # fmt: skip
"""Kinds of mistakes; each is planted as often as it is listed."""


class Slot(NamedTuple):
    """Location of the numbers of a quantity in a source file.

    Attributes:
        source: End of the path of the file.
        first: Text before the numbers.
        last: Text after the numbers.
        quantities: Quantities that a finding about the numbers may have.
    """

    source: str
    first: str
    last: str
    quantities: tuple[str, ...]


_ANGLE_QUANTITIES = ("default angle", "action offset")
"""Quantities that a finding about a default angle may have."""

DEPLOY = {
    "default": Slot("deploy.yaml", "default_joint_pos:", "]", _ANGLE_QUANTITIES),
    "scale": Slot("deploy.yaml", "    scale: [", "]", ("action scale",)),
    "kp": Slot("deploy.yaml", "stiffness:", "]", ("kp",)),
}
"""{kind of mistake: location} in the deployment files of Unitree's repositories."""

GYM = "deploy/deploy_mujoco/configs/g1.yaml"
"""End of the path of the deployment file of unitree_rl_gym."""

LITE = "policy_humanoid.yaml"
"""End of the path of the policy configuration of the Berkeley Humanoid Lite."""

BOOSTER = "deploy/configs/T1.yaml"
"""End of the path of the deployment file of booster_gym."""

FALCON = "g1_29dof_falcon.yaml"
"""End of the path of the deployment file of FALCON."""

PAIRS: dict[tuple[str, str], dict[str, Slot]] = {
    ("JensenLav/unitree_rl_mjlab", "go2"): {
        **DEPLOY,
        "limit": Slot("go2_constants.py", "effort_limit=", ",", ("effort",)),
    },
    ("unitreerobotics/unitree_rl_gym", "g1"): {
        "default": Slot(GYM, "default_angles:", "]", _ANGLE_QUANTITIES),
        "scale": Slot(GYM, "action_scale:", "\n", ("action scale",)),
        "kp": Slot(GYM, "kps:", "]", ("kp",)),
        "limit": Slot("g1_12dof.urdf", 'effort="', '"', ("effort",)),
    },
    ("unitreerobotics/unitree_rl_lab", "g1"): {
        **DEPLOY,
        "limit": Slot("g1_29dof_rev_1_0.urdf", 'velocity="', '"', ("velocity",)),
    },
    ("HybridRobotics/Berkeley-Humanoid-Lite", "humanoid"): {
        "default": Slot(LITE, "default_joint_positions:", "num_observations", _ANGLE_QUANTITIES),
        "scale": Slot(LITE, "action_scale:", "\n", ("action scale",)),
        "kp": Slot(LITE, "joint_kp:", "joint_kd:", ("kp",)),
        "limit": Slot(LITE, "effort_limits:", "default_base_position:", ("effort",)),
    },
    ("G-Levine/neural_controller", "Pupper v3"): {
        "default": Slot("config.yaml", "default_joint_pos:", "]", _ANGLE_QUANTITIES),
        "scale": Slot("env.py", "scale=", ",", ("action scale",)),
        "kp": Slot("env.py", "stiffness=", ",", ("kp",)),
        "limit": Slot("policy_latest.json", '"joint_upper_limits":', "]", ("upper limit",)),
    },
    ("BoosterRobotics/booster_gym", "t1"): {
        "default": Slot(BOOSTER, "0.2, 1.35, 0, 0.5,\n    0,\n", "]", _ANGLE_QUANTITIES),
        "scale": Slot(BOOSTER, "action_scale:", "\n", ("action scale",)),
        "kp": Slot(
            BOOSTER,
            "stiffness: [\n    20, 20,\n    20, 20, 20, 20,\n    20, 20, 20, 20,\n    200,\n",
            "]",
            ("kp",),
        ),
        "limit": Slot("T1_serial.urdf", 'effort="', '"', ("effort",)),
    },
    ("Open-X-Humanoid/TienKung-Lab", "tienkung2_lite"): {
        "default": Slot(
            "legged_lab/scripts/sim2sim.py", "default_dof_pos = np.array(", "]", _ANGLE_QUANTITIES
        ),
        "scale": Slot("legged_lab/scripts/sim2sim.py", "action_scale =", "\n", ("action scale",)),
        "limit": Slot("tienkung2_lite.urdf", 'effort="', '"', ("effort",)),
    },
    ("Roboparty/atom01_train", "atom01"): {
        "default": Slot("sim2sim_atom01.py", "default_pos = np.array([", "]", _ANGLE_QUANTITIES),
        "scale": Slot("sim2sim_atom01.py", "action_scale =", "\n", ("action scale",)),
        "kp": Slot("sim2sim_atom01.py", "kps = np.array([", "]", ("kp",)),
        "limit": Slot("sim2sim_atom01.py", "kds = np.array([", "]", ("kd",)),
    },
    ("LeCAR-Lab/FALCON", "g1"): {
        "default": Slot(FALCON, "DEFAULT_DOF_ANGLES: [", "]", _ANGLE_QUANTITIES),
        "kp": Slot(FALCON, "JOINT_KP: [", "]", ("kp",)),
        "limit": Slot("g1_29dof.urdf", 'effort="', '"', ("effort",)),
    },
}
"""{(repository, robot): {kind of mistake: location}}."""

GO2 = "fan-ziqi/robot_lab/source/robot_lab/data/Robots/unitree/go2_description/urdf"
"""Folder of the Go2's URDF, which contains limits of the motors; the MJCF of the trainer does not.
"""

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
"""Numbers of Pupper v3 in the form of an Isaac Lab trainer; the trainer itself is not public."""


class Edit(NamedTuple):
    """Edit of a source file.

    Attributes:
        path: The file.
        text: New text of the file.
        lines: Numbers of the changed lines.
        quantities: Quantities that a finding about the edit may have.
    """

    path: Path
    text: str
    lines: tuple[int, ...]
    quantities: tuple[str, ...]


def plant_mistake(home: Path, paths: list[Path], slot: Slot, slip: str, seed: int) -> Edit:
    """Return an edit that plants a mistake into one of the sources, or into a module that one
    imports.

    Args:
        home: Folder of the repositories.
        paths: Sources of the robot.
        slot: Location of the numbers.
        slip: Kind of the mistake, an element of `SLIPS`.
        seed: Seed for the choice of the number.
    """
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
    if path.suffix == ".urdf":  # a place in XML is the end of the start tag
        ends = (text.index(">", spans[number][0]) for number in changed)
        lines += tuple(1 + text.count("\n", 0, end) for end in ends)
    return Edit(path, text, lines, slot.quantities)


def names_both_lines(found: Disagreement, edit: Edit) -> bool:
    """Return True if a finding has a quantity of an edit, an edited line, and one line of another
    file.
    """
    mine = {f"{edit.path}:{line}" for line in edit.lines}
    theirs = [place for place in found.places if not place.startswith(f"{edit.path}:")]
    return found.kind in edit.quantities and bool(mine & set(found.places)) and len(theirs) == 1


def run_case(home: Path, case: Case, slots: dict[str, Slot]) -> Iterator[tuple[str, bool, str]]:
    """Yield (kind of mistake, whether it is found, description) for all mistakes of a robot."""
    paths = case.paths(home)
    if case.repository.startswith("G-Levine"):
        for number, one in enumerate(paths):  # ours are not edited
            if one.is_relative_to(PROJECT_FOLDER) and one.suffix == ".urdf":
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
        edit = plant_mistake(home, paths, slot, slip, number)
        kept = edit.path.read_text()
        edit.path.write_text(edit.text)
        new = [one for key, one in read().items() if key not in before]
        edit.path.write_text(kept)
        hits = [one for one in new if names_both_lines(one, edit)]
        slips = {one.probable_mistake for one in hits if one.probable_mistake != "mirror"}
        right = slip in slips if slip in ("order", "sign", "unit") else bool(slips)
        words = (hits or new or [None])[0]
        yield slip, right, f"{Path(edit.path).name}:{edit.lines}: {words and words.message}"


@click.command()
@click.argument("folder", type=click.Path(exists=True, file_okay=False, path_type=Path))
def main(folder: Path) -> None:
    """Plant the mistakes of `SLIPS` into copies of the sources of each robot of `PAIRS`."""
    known = {(one.repository, one.robot): one for one in list_cases()}
    count, lost = 0, 0
    for key, slots in PAIRS.items():
        with tempfile.TemporaryDirectory() as made:
            home = Path(made)
            for repository in known[key].repositories:
                shutil.copytree(folder / repository, home / repository, symlinks=True)
            shutil.copy(folder / GO2 / "go2_description.urdf", home)
            for slip, right, words in run_case(home, known[key], slots):
                count, lost = count + 1, lost + (not right)
                click.echo(f"{'found' if right else 'LOST '} {key[0]} {slip}: {words[:180]}")
    click.echo(f"{count} slips, {count - lost} found with both lines")
    sys.exit(bool(lost))


if __name__ == "__main__":
    main()
