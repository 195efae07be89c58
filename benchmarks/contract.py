"""Compare trainer, deployment and model of public repositories: `python benchmarks/contract.py
FOLDER`.

FOLDER contains a checkout of each repository, as OWNER/NAME, at the commit in `COMMITS`. Each row
of `docs/data/contract-found.csv` is a finding of `contract` with the lines of both values and a
judgement that was made by hand. Judgements of earlier runs are copied. If a finding has no
judgement, the exit status is 1.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import click
from tables import write_csv

from pupper_analysis.base.errors import PupperAnalysisError
from pupper_analysis.tools.contract import read_contract

PROJECT_FOLDER = Path(__file__).resolve().parents[1]
"""Root folder of this project."""

TABLE = PROJECT_FOLDER / "docs/data/contract-found.csv"
"""Table of the findings, with judgements."""

HEADER = ("repository", "commit", "robot", "sources", "numbers", "quantity", "severity", "joints",
          "first", "other", "lines", "judged")  # fmt: skip
"""Columns of the table."""

COMMITS = {
    "AgibotTech/agibot_x1_infer": "9e0b818",
    "BoosterRobotics/booster_gym": "da396a0",
    "DeepRoboticsLab/rl_training": "127b4ff",
    "EGalahad/sim2real": "7c29b2d",
    "G-Levine/neural_controller": "3ffbbe6",
    "HybridRobotics/Berkeley-Humanoid-Lite": "edc4738",
    "Improbable-AI/walk-these-ways": "0e7236b",
    "JensenLav/unitree_rl_mjlab": "5053c93",
    "LeCAR-Lab/ASAP": "91df82c",
    "LeCAR-Lab/FALCON": "25ad085",
    "Open-X-Humanoid/TienKung-Lab": "7ce828b",
    "OpenRobotLab/HIMLoco": "ef289ac",
    "OpenRobotLab/HoST": "70bb580",
    "OpenRobotLab/OpenHomie": "0746fab",
    "Roboparty/atom01_train": "c93d119",
    "amazon-far/holosoma": "fc600e7",
    "ccrpRepo/RoboMimic_Deploy": "ffe3d40",
    "fan-ziqi/rl_sar": "e384912",
    "fan-ziqi/robot_lab": "09f7fb4",
    "haraduka/mevius": "35fdb6c",
    "leggedrobotics/legged_gym": "8fa29ac",
    "limxdynamics/tron1-rl-isaacgym": "d26da7f",
    "mujocolab/mjlab": "0eda4e7",
    "roboterax/humanoid-gym": "ae46e20",
    "unitreerobotics/unitree_rl_gym": "276801e",
    "unitreerobotics/unitree_rl_lab": "e72a072",
    "unitreerobotics/unitree_rl_mjlab": "5b7e396",
}
"""{repository: commit}. Models of other repositories: HybridRobotics/Berkeley-Humanoid-Lite-Assets
205534d, unitreerobotics/unitree_ros d6f13aa."""


class Case(NamedTuple):
    """Sources of a robot that are compared.

    Attributes:
        repository: Repository, as OWNER/NAME.
        robot: Name of the robot.
        sources: Files in the repository. ``//OWNER/NAME/`` at the start denotes another
            repository, ``ours/`` this project.
    """

    repository: str
    robot: str
    sources: tuple[str, ...]

    def paths(self, folder: Path) -> list[Path]:
        """Return the paths of the sources, in a folder of checkouts."""
        homes = {"//": folder, "ours/": PROJECT_FOLDER}
        return [
            next((home / one.removeprefix(mark) for mark, home in homes.items()
                  if one.startswith(mark)), folder / self.repository / one)
            for one in self.sources
        ]  # fmt: skip

    @property
    def repositories(self) -> list[str]:
        """Repositories of the sources."""
        others = ["/".join(one[2:].split("/")[:2]) for one in self.sources if one[:2] == "//"]
        return list(dict.fromkeys([self.repository, *others]))


def list_cases() -> Iterator[Case]:
    """Yield the cases of all repositories."""
    isaac = "tasks/manager_based/locomotion/velocity/config"
    for robot in ("g1_23dof", "g1", "h1_2", "go2"):
        home = f"unitree_{robot.removesuffix('_23dof')}"
        deploy = f"deploy/robots/{robot}/config/policy/velocity/v0/params/deploy.yaml"
        yield Case("unitreerobotics/unitree_rl_mjlab", robot, (
            f"mjlab/asset_zoo/robots/{home}/xmls/{robot}.xml",
            f"mjlab/tasks/velocity/config/{robot}/env_cfgs.py", deploy))  # fmt: skip
    for robot in ("g1_23dof", "g1", "h1_2", "go2", "a2", "r1"):
        home = f"unitree_{robot.removesuffix('_23dof')}"
        deploy = f"deploy/robots/{robot}/config/policy/velocity/v0/params/deploy.yaml"
        yield Case(
            "JensenLav/unitree_rl_mjlab",
            robot,
            (
                f"src/assets/robots/{home}/xmls/{robot}.xml",
                f"src/tasks/velocity/config/{robot}/env_cfgs.py",
                deploy,
                "//mujocolab/mjlab/src",
            ),
        )  # fmt: skip - without it no gain of its is a constant
    yield Case("unitreerobotics/unitree_rl_lab", "g1", (
        "//unitreerobotics/unitree_ros/robots/g1_description/g1_29dof_rev_1_0.urdf",
        "source/unitree_rl_lab/unitree_rl_lab/tasks/locomotion/robots/g1/29dof/velocity_env_cfg.py",
        "deploy/robots/g1/config/policy/velocity/v0/params/deploy.yaml",
        "deploy/robots/g1/config/policy/velocity/v0/exported/policy.onnx", "source"))  # fmt: skip
    models = {"g1": ("g1_description/g1_12dof.urdf", "g1_description/g1_12dof.xml"),
              "h1": ("h1/urdf/h1.urdf", "h1/h1.xml"),
              "h1_2": ("h1_2/h1_2_12dof.urdf", "h1_2/h1_2_12dof.xml")}  # fmt: skip
    for robot, pair in models.items():
        yield Case("unitreerobotics/unitree_rl_gym", robot, (
            *(f"resources/robots/{one}" for one in pair),
            f"legged_gym/envs/{robot}/{robot}_config.py",
            f"deploy/deploy_mujoco/configs/{robot}.yaml",
            f"deploy/deploy_real/configs/{robot}.yaml"))  # fmt: skip
    yield Case("unitreerobotics/unitree_rl_gym", "go2", (
        "resources/robots/go2/urdf/go2.urdf", "legged_gym/envs/go2/go2_config.py"))  # fmt: skip
    for robot, path in (("a1", "a1/a1"), ("anymal_b", "anymal_b/anymal_b"),
                        ("anymal_c", "anymal_c/flat/anymal_c_flat"),
                        ("cassie", "cassie/cassie")):  # fmt: skip
        yield Case("leggedrobotics/legged_gym", robot, (
            f"resources/robots/{robot}/urdf/{robot}.urdf",
            f"legged_gym/envs/{path}_config.py"))  # fmt: skip
    yield Case("Improbable-AI/walk-these-ways", "go1", (
        "resources/robots/go1/urdf/go1.urdf", "go1_gym/envs/go1/go1_config.py"))  # fmt: skip
    for robot in ("go1", "g1"):
        yield Case("mujocolab/mjlab", robot, (
            f"src/mjlab/asset_zoo/robots/unitree_{robot}/xmls/{robot}.xml",
            f"src/mjlab/tasks/velocity/config/{robot}/flat_env_cfg.py"))  # fmt: skip
    lite = "HybridRobotics/Berkeley-Humanoid-Lite"
    trainer = (
        "source/berkeley_humanoid_lite/berkeley_humanoid_lite/tasks/locomotion/velocity/config"
    )
    for robot, suffix, policy in (
        ("humanoid", "", "humanoid"),
        ("biped", "_biped", "biped_25hz_a"),
    ):
        model = f"berkeley_humanoid_lite{suffix}"
        yield Case(lite, robot, (
            f"//{lite}-Assets/data/urdf/{model}.urdf", f"//{lite}-Assets/data/mjcf/{model}.xml",
            f"{trainer}/{robot}/env_cfg.py", f"configs/policy_{policy}.yaml",
            f"checkpoints/policy_{policy}.onnx", f"//{lite}-Assets"))  # fmt: skip
    for policy in ("loco_mode/config/LocoMode", "dance/config/Dance", "kick/config/Kick",
                   "kungfu/config/KungFu", "kungfu2/config/KungFu2"):  # fmt: skip
        yield Case("ccrpRepo/RoboMimic_Deploy", f"g1, {Path(policy).name}", (
            "g1_description/g1_29dof_rev_1_0.xml", f"policy/{policy}.yaml"))  # fmt: skip
    yield Case("LeCAR-Lab/ASAP", "g1", (
        "humanoidverse/data/robots/g1/g1_29dof_anneal_23dof.urdf",
        "humanoidverse/data/robots/g1/g1_29dof_anneal_23dof.xml",
        "humanoidverse/config/robot/g1/g1_29dof_anneal_23dof.yaml",
        "sim2real/models/mimic/CR7_level1/model_191500.onnx"))  # fmt: skip
    policies = "src/holosoma_inference/holosoma_inference/models/loco"
    for robot in ("g1", "t1"):
        model = f"src/holosoma/holosoma/data/robots/{robot}/{robot}_29dof"
        yield Case("amazon-far/holosoma", robot, (
            f"{model}.urdf", f"{model}.xml", f"{policies}/{robot}_29dof/ppo_{robot}_29dof.onnx",
            f"{policies}/{robot}_29dof/fastsac_{robot}_29dof.onnx"))  # fmt: skip
    for robot, home in (("PF", "pointfoot"), ("SF", "solefoot"), ("WF", "wheelfoot")):
        yield Case("limxdynamics/tron1-rl-isaacgym", f"{robot}_TRON1A", (
            f"resources/robots/{robot}_TRON1A/urdf/robot.urdf",
            f"legged_gym/envs/{home}_flat/{home}_flat_config.py"))  # fmt: skip
    yield Case("roboterax/humanoid-gym", "XBot-L", (
        "resources/robots/XBot/urdf/XBot-L.urdf", "resources/robots/XBot/mjcf/XBot-L.xml",
        "humanoid/envs/custom/humanoid_config.py", "humanoid/scripts/sim2sim.py"))  # fmt: skip
    for robot, model in (("g1", "g1/g1_23dof"), ("h1", "h1/urdf/h1"),
                         ("pi", "pi_12dof/urdf/pi_12dof_release_v1")):  # fmt: skip
        yield Case("OpenRobotLab/HoST", robot, (
            f"legged_gym/resources/robots/{model}.urdf",
            f"legged_gym/legged_gym/envs/{robot}/{robot}_config_ground.py"))  # fmt: skip
    yield Case("OpenRobotLab/OpenHomie", "g1", (
        "HomieRL/legged_gym/resources/robots/g1_description/g1.urdf",
        "HomieRL/legged_gym/legged_gym/envs/g1/g1_29dof_config.py",
        "HomieDeploy/deploy.onnx"))  # fmt: skip
    lab = {"go2": ("unitree/go2_description/urdf/go2_description", "quadruped/unitree_go2"),
           "a1": ("unitree/a1_description/urdf/a1", "quadruped/unitree_a1"),
           "b2": ("unitree/b2_description/urdf/b2_description", "quadruped/unitree_b2"),
           "d1": ("agibot/d1/urdf/edu", "quadruped/agibot_d1"),
           "lite3": ("deeprobotics/lite3_description/urdf/lite3", "quadruped/deeprobotics_lite3"),
           "zsl1": ("zsibot/zsl1_description/urdf/zsl1", "quadruped/zsibot_zsl1"),
           "g1": ("unitree/g1_description/urdf/g1_29dof_rev_1_0", "humanoid/unitree_g1"),
           "gr1t1": ("fftai/gr1t1_description/urdf/GR1T1_lower_limb", "humanoid/fftai_gr1t1"),
           "t1": ("booster/t1_description/urdf/robot", "humanoid/booster_t1"),
           "tita": ("ddt/tita_description/urdf/tita", "wheeled/ddtrobot_tita")}  # fmt: skip
    robots = "source/robot_lab/data/Robots"
    for robot, (model, home) in lab.items():
        yield Case("fan-ziqi/robot_lab", robot, (
            f"{robots}/{model}.urdf",
            f"source/robot_lab/robot_lab/{isaac}/{home}/rough_env_cfg.py"))  # fmt: skip
    for policy in ("go2/robot_lab", "go2/himloco", "a1/robot_lab", "a1/legged_gym", "b2/robot_lab",
                   "gr1t1/legged_gym", "lite3/himloco", "g1/robomimic/locomotion",
                   "g1/robomimic/charleston", "g1/whole_body_tracking/dance_102"):  # fmt: skip
        robot = policy.partition("/")[0]
        yield Case("fan-ziqi/rl_sar", policy, (
            f"//fan-ziqi/robot_lab/{robots}/{lab[robot][0]}.urdf", f"policy/{robot}/base.yaml",
            f"policy/{policy}/config.yaml"))  # fmt: skip
    yield Case("DeepRoboticsLab/rl_training", "lite3", (
        f"//fan-ziqi/robot_lab/{robots}/{lab['lite3'][0]}.urdf",
        f"source/rl_training/rl_training/{isaac}/quadruped/deeprobotics_lite3/"
        "rough_env_cfg.py"))  # fmt: skip
    yield Case("G-Levine/neural_controller", "Pupper v3", (
        "ours/urdf/pupper_v3.urdf", "ours/mjcf/pupper_v3.xml", "launch/config.yaml",
        "launch/policy_latest.json"))  # fmt: skip
    yield Case("BoosterRobotics/booster_gym", "t1", (
        "resources/T1/T1_serial.urdf", "envs/T1.yaml", "deploy/configs/T1.yaml"))  # fmt: skip
    yield Case("EGalahad/sim2real", "g1", (
        "data/robots/g1/g1_29dof_nohand.xml", "config/robot/g1-real.yaml"))  # fmt: skip
    yield Case("AgibotTech/agibot_x1_infer", "x1", (
        "src/module/sim_module/model/mjcf/robot/xyber_x1/xyber_x1_serial.xml",
        "src/module/control_module/cfg/rl_x1.yaml"))  # fmt: skip
    yield Case("haraduka/mevius", "mevius", ("models/mevius.urdf", "scripts/parameters.py"))
    assets = "legged_lab/assets/tienkung2_lite"
    yield Case("Open-X-Humanoid/TienKung-Lab", "tienkung2_lite", (
        f"{assets}/urdf/tienkung2_lite.urdf", f"{assets}/mjcf/tienkung.xml",
        "legged_lab/envs/tienkung/walk_cfg.py", "legged_lab/scripts/sim2sim.py", "."))  # fmt: skip
    yield Case("Roboparty/atom01_train", "atom01", (
        "legged_lab/assets/roboparty/atom/mjcf/atom01.xml",
        "legged_lab/envs/atom01/atom01_config.py",
        "legged_lab/scripts/sim2sim_atom01.py"))  # fmt: skip
    yield Case("LeCAR-Lab/FALCON", "g1", (
        "humanoidverse/data/robots/g1/g1_29dof.urdf",
        "humanoidverse/config/robot/g1/g1_29dof_waist_fakehand.yaml",
        "sim2real/config/g1/g1_29dof_falcon.yaml",
        "sim2real/models/falcon/g1_29dof.onnx"))  # fmt: skip
    for robot in ("a1", "aliengo", "go1"):
        yield Case("OpenRobotLab/HIMLoco", robot, (
            f"legged_gym/resources/robots/{robot}/urdf/{robot}.urdf",
            f"legged_gym/legged_gym/envs/{robot}/{robot}_config.py"))  # fmt: skip


def _make_rows(folder: Path, case: Case) -> Iterator[list[str]]:
    """Yield a row per finding of a case, and per source or quantity that is not compared.

    A single row with "none" is yielded if there are no such rows.
    """
    paths = case.paths(folder)
    first = [case.repository, COMMITS[case.repository], case.robot,
             " + ".join(path.name for path in paths if path.suffix)]  # fmt: skip
    try:
        found = read_contract(*paths, stand=False)
    except PupperAnalysisError as error:
        yield [*first, "0", "not read", "error", "", "", "", str(error).rpartition("/")[2]]
        return
    first.append(str(len(found.facts)))
    for one in found.findings:
        joints = ", ".join(one.joints[:4]) + (f" and {len(one.joints) - 4} more"
                                              if len(one.joints) > 4 else "")  # fmt: skip
        tag = one.probable_mistake if one.probable_mistake != one.kind else ""
        slip = f" ({tag})" if tag else ""
        values = ["" if value is None else f"{value:.6g}" for value in one.values]
        lines = " ".join(Path(place).name for place in one.places)
        yield [*first, f"{one.kind}{slip}", str(one.severity), joints, *values, lines]
    for note in found.unread:
        yield [*first, "not read", "warning", "", "", "", str(note).rpartition("/")[2]]
    if not (found.findings or found.unread):
        yield [*first, "none", "", "", "", "", ""]


def _key(row: Sequence[str]) -> tuple[str, ...]:
    """Return the columns that identify a finding in another run.

    These are all columns but commit, sources, numbers, lines and judgement.
    """
    return (row[0], row[2], *row[5:10])


@click.command()
@click.argument("folder", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--table", type=click.Path(path_type=Path), default=TABLE, show_default=True)
def main(folder: Path, table: Path) -> None:
    """Read the sources of public repositories, and write the findings with the judgements of
    earlier runs.
    """
    with TABLE.open(encoding="utf-8", newline="") as file:
        before = {_key(row): row[-1] for row in csv.reader(file) if len(row) == len(HEADER)}
    rows = [
        [*row, before.get(_key(row), "")]
        for case in list_cases()
        for row in _make_rows(folder, case)
    ]
    write_csv(table, HEADER, rows)
    new = [row for row in rows if row[5] != "none" and not row[-1]]
    click.echo(f"{len(rows)} lines, {len(new)} that nobody has judged")
    sys.exit(bool(new))


if __name__ == "__main__":
    main()
