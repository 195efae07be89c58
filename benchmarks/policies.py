"""Six public policies: how fast each walks by `walk`, and by a bare MuJoCo loop of its own code.

Nothing is fetched. Give clones of the two repositories that they are from, both of which may be
used freely (Apache-2.0, MIT):

    git clone https://github.com/google-deepmind/mujoco_playground
    git clone https://github.com/G-Levine/neural_controller
    python benchmarks/policies.py mujoco_playground neural_controller

Measured at d5e6b475 of the first, 0.5 m/s forward asked, over 2 to 8 s, by both: Go1 0.50, T1 0.48,
G1 0.60, Apollo 0.45, Berkeley Humanoid 0.45, apart by 0.005 at most; Pupper v3 0.47. What a policy
observes is in none of these files, but in the scripts beside them (`play_*.py`): it is written
here, and goes into a TOML beside a copy of each.
"""

from __future__ import annotations

import argparse
import math
import re
import shutil
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import pupper_analysis as pa
from pupper_analysis.tools.contract.readers import read_onnx
from pupper_analysis.tools.walk.gait import simulate_walk
from pupper_analysis.tools.walk.policy import Policy, build_onnx_network

COMMAND, SECONDS, WARM_UP = np.array([0.5, 0.0, 0.0]), 8.0, 2.0
SAME = 0.03  # m/s: apart by when the first action comes, and where the first foot is put down

ORDER = ["linear-velocity", "angular-velocity", "gravity", "command", "joint-positions",
         "joint-velocities", "last-action", "phase"]  # fmt: skip
GO1 = [*ORDER[:3], *ORDER[4:7], "command"]


@dataclass(frozen=True)
class Public:
    """A policy of MuJoCo Playground: its files, and what its player's script has in Python."""

    name: str
    folder: str
    keyframe: str
    scale: float
    phase_rate: float = 1.5
    imu: str = "imu"
    sensors: str = ""
    blind: int = 0  # the first joints, which are observed as zero

    def terms(self) -> list[str]:
        return GO1 if self.name == "go1" else ORDER


# Apollo's phase goes faster with its command: 1.25 Hz and 0.5 Hz more at 1.5 m/s.
PLAYGROUND = (
    Public("go1", "go1", "home", 0.5),
    Public("t1", "t1", "home", 1.0, blind=2),
    Public("g1", "g1", "knees_bent", 0.5, imu="imu_in_pelvis", sensors="_pelvis"),
    Public("apollo", "apollo", "knees_bent", 0.5, phase_rate=1.25 + 0.5 * 0.5 / 1.5),
    Public("bh", "berkeley_humanoid", "home", 0.5),
)


def scene_of(root: Path, one: Public) -> Path:
    folder = root / "mujoco_playground/_src/locomotion" / one.folder / "xmls"
    return folder / "scene_mjx_feetonly_flat_terrain.xml"


def read_bare(scene: Path) -> mujoco.MjModel:
    """The model without its meshes, which are only drawn, and are of another repository."""
    assets = {}
    for path in scene.parent.glob("*.xml"):
        text = re.sub(r"<mesh\b[^>]*/>", "", path.read_text("utf-8"))
        text = re.sub(r'<geom\b[^>]*\b(?:mesh="|class="visual)[^>]*/>', "", text)
        assets[path.name] = text.encode()
    return mujoco.MjModel.from_xml_string(assets[scene.name].decode(), assets)


def write_toml(path: Path, one: Public, model: mujoco.MjModel) -> None:
    """Writes what a policy observes, and what its actions mean, beside it."""
    default = model.key(one.keyframe).qpos[7:].tolist()
    seen = [0.0] * one.blind + [1.0] * (model.nu - one.blind)
    terms = [
        f'{{term = "{name}", scale = {seen}}}' if name.startswith("joint") else f'"{name}"'
        for name in one.terms()
    ]
    path.write_text(
        f"observation = [{', '.join(terms)}]\ndefault = {default}\naction-scale = {one.scale}\n"
        f"rate = 50\nphase-rate = {one.phase_rate}\nphase-offsets = [0.0, {math.pi}]\n"
        f'imu = "{one.imu}"\n',
        encoding="utf-8",
    )


def walk_bare(model: mujoco.MjModel, one: Public, act: Callable[[Any], Any]) -> float:
    """The speed forward in the base's heading, by a loop of its own, from the file's keyframe."""
    data, key = mujoco.MjData(model), model.key(one.keyframe)
    mujoco.mj_resetDataKeyframe(model, data, key.id)
    default, last, speeds = key.qpos[7:].copy(), np.zeros(model.nu), []
    every, site = round(0.02 / model.opt.timestep), model.site(one.imu).id
    for step in range(round(SECONDS / model.opt.timestep)):
        if step % every == 0:
            mujoco.mj_forward(model, data)
            phase = 2 * math.pi * one.phase_rate * 0.02 * (step // every) + np.array([0, math.pi])
            joints, rates = data.qpos[7:] - default, data.qvel[6:].copy()
            joints[: one.blind] = rates[: one.blind] = 0.0
            parts = {
                "linear-velocity": data.sensor(f"local_linvel{one.sensors}").data,
                "angular-velocity": data.sensor(f"gyro{one.sensors}").data,
                "gravity": data.site_xmat[site].reshape(3, 3).T @ [0.0, 0.0, -1.0],
                "command": COMMAND,
                "joint-positions": joints,
                "joint-velocities": rates,
                "last-action": last,
                "phase": np.concatenate([np.cos(phase), np.sin(phase)]),
            }
            last = act(np.concatenate([parts[name] for name in one.terms()]))
            data.ctrl[:] = default + one.scale * last
        mujoco.mj_step(model, data)
        if data.time > WARM_UP:
            turned = np.zeros(9)
            mujoco.mju_quat2Mat(turned, data.qpos[3:7])
            ahead = turned[[0, 3]] / np.hypot(turned[0], turned[3])
            speeds.append(float(ahead @ data.qvel[:2]))
    return float(np.mean(speeds))


def runner_of(path: Path) -> tuple[Callable[[Any], Any], str]:
    """What evaluates an ONNX file: onnxruntime, if it is there."""
    try:
        import onnxruntime
    except ImportError:
        network = build_onnx_network(path, read_onnx(path))
        return lambda seen: network.forward(seen[None])[0][0], "our network"
    session = onnxruntime.InferenceSession(str(path))
    name = session.get_inputs()[0].name
    return lambda seen: session.run(None, {name: seen[None].astype("f4")})[0][0], "onnxruntime"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("playground", type=Path, help="A clone of mujoco_playground.")
    parser.add_argument("controller", type=Path, nargs="?", help="A clone of neural_controller.")
    given, apart = parser.parse_args(), 0.0
    with tempfile.TemporaryDirectory() as place:
        for one in PLAYGROUND:
            policy, scene = Path(place) / f"{one.name}.onnx", scene_of(given.playground, one)
            found = f"mujoco_playground/experimental/sim2sim/onnx/{one.name}_policy.onnx"
            shutil.copy(given.playground / found, policy)
            model = read_bare(scene)
            write_toml(policy.with_suffix(".toml"), one, model)
            act, how = runner_of(policy)
            bare = walk_bare(model, one, act)
            walk = simulate_walk(pa.load_robot(mjcf=scene), Policy.load(policy), COMMAND)
            ours = float(walk.gaits[0].velocity[0])
            apart = max(apart, abs(ours - bare))
            print(f"{one.name}: {ours:.3f} m/s by walk, {bare:.3f} by bare MuJoCo and {how}")
    if given.controller is not None:
        policy = given.controller / "launch/policy_latest.json"
        walk = simulate_walk(pa.load_variant("v3"), Policy.load(policy), COMMAND)
        print(f"pupper v3: {walk.gaits[0].velocity[0]:.3f} m/s by walk")
    print(f"apart by {apart:.3f} m/s at most")
    return int(apart > SAME)


if __name__ == "__main__":
    sys.exit(main())
