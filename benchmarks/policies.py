"""Six public policies: walking speed by `walk`, and by a separate loop with MuJoCo alone.

Nothing is downloaded. The arguments are clones of the two repositories with the policies
(Apache-2.0, MIT):

    git clone https://github.com/google-deepmind/mujoco_playground
    git clone https://github.com/G-Levine/neural_controller
    python benchmarks/policies.py mujoco_playground neural_controller

Results at d5e6b475 of the first, for a command of 0.5 m/s forward, mean over 2 to 8 s, by both: Go1
0.50, T1 0.48, G1 0.60, Apollo 0.45, Berkeley Humanoid 0.45, with differences of at most 0.005;
Pupper v3 0.47. The observations of a policy are not in these files, but in the scripts beside them
(`play_*.py`); this script writes them to a TOML beside a copy of each policy.
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
"""Command (forward [m/s], left [m/s], turn [rad/s]), simulated time [s], and time before the mean
[s]."""

SPEED_TOLERANCE = (
    0.03  # m/s: apart by when the first action comes, and where the first foot is put down
)
"""Largest difference of both speeds [m/s]; they differ by the time of the first action and the
first foot contact."""

ORDER = ["linear-velocity", "angular-velocity", "gravity", "command", "joint-positions",
         "joint-velocities", "last-action", "phase"]  # fmt: skip
"""Observation of MuJoCo Playground's policies, in this order."""

GO1 = [*ORDER[:3], *ORDER[4:7], "command"]
"""Observation of the Go1's policy."""


@dataclass(frozen=True)
class PublicPolicy:
    """Policy of MuJoCo Playground: its files, and the parameters in its script."""

    name: str
    folder: str
    keyframe: str
    scale: float
    phase_rate: float = 1.5
    imu: str = "imu"
    sensors: str = ""
    blind: int = 0  # the first joints, which are observed as zero

    def list_terms(self) -> list[str]:
        """Return the terms of the observation."""
        return GO1 if self.name == "go1" else ORDER


# Apollo's phase goes faster with its command: 1.25 Hz and 0.5 Hz more at 1.5 m/s.
PLAYGROUND = (
    PublicPolicy("go1", "go1", "home", 0.5),
    PublicPolicy("t1", "t1", "home", 1.0, blind=2),
    PublicPolicy("g1", "g1", "knees_bent", 0.5, imu="imu_in_pelvis", sensors="_pelvis"),
    PublicPolicy("apollo", "apollo", "knees_bent", 0.5, phase_rate=1.25 + 0.5 * 0.5 / 1.5),
    PublicPolicy("bh", "berkeley_humanoid", "home", 0.5),
)
"""The policies."""


def scene_file(root: Path, one: PublicPolicy) -> Path:
    """Return the scene of a policy in a clone."""
    folder = root / "mujoco_playground/_src/locomotion" / one.folder / "xmls"
    return folder / "scene_mjx_feetonly_flat_terrain.xml"


def read_bare(scene: Path) -> mujoco.MjModel:
    """Compile a scene without its meshes, which are only drawn and belong to another repository."""
    assets = {}
    for path in scene.parent.glob("*.xml"):
        text = re.sub(r"<mesh\b[^>]*/>", "", path.read_text("utf-8"))
        text = re.sub(r'<geom\b[^>]*\b(?:mesh="|class="visual)[^>]*/>', "", text)
        assets[path.name] = text.encode()
    return mujoco.MjModel.from_xml_string(assets[scene.name].decode(), assets)


def write_toml(path: Path, one: PublicPolicy, model: mujoco.MjModel) -> None:
    """Write the observation and the action scale of a policy to a TOML file."""
    default = model.key(one.keyframe).qpos[7:].tolist()
    seen = [0.0] * one.blind + [1.0] * (model.nu - one.blind)
    terms = [
        f'{{term = "{name}", scale = {seen}}}' if name.startswith("joint") else f'"{name}"'
        for name in one.list_terms()
    ]
    path.write_text(
        f"observation = [{', '.join(terms)}]\ndefault = {default}\naction-scale = {one.scale}\n"
        f"rate = 50\nphase-rate = {one.phase_rate}\nphase-offsets = [0.0, {math.pi}]\n"
        f'imu = "{one.imu}"\n',
        encoding="utf-8",
    )


def walk_bare(model: mujoco.MjModel, one: PublicPolicy, act: Callable[[Any], Any]) -> float:
    """Simulate a policy with MuJoCo alone, and return the mean forward speed [m/s] of the base.

    Args:
        model: Compiled scene.
        one: The policy.
        act: Function that returns the action for an observation.
    """
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
            last = act(np.concatenate([parts[name] for name in one.list_terms()]))
            data.ctrl[:] = default + one.scale * last
        mujoco.mj_step(model, data)
        if data.time > WARM_UP:
            turned = np.zeros(9)
            mujoco.mju_quat2Mat(turned, data.qpos[3:7])
            ahead = turned[[0, 3]] / np.hypot(turned[0], turned[3])
            speeds.append(float(ahead @ data.qvel[:2]))
    return float(np.mean(speeds))


def load_runner(path: Path) -> tuple[Callable[[Any], Any], str]:
    """Return a function that evaluates an ONNX file, and its name; onnxruntime if installed."""
    try:
        import onnxruntime
    except ImportError:
        network = build_onnx_network(path, read_onnx(path))
        return lambda seen: network.forward(seen[None])[0][0], "our network"
    session = onnxruntime.InferenceSession(str(path))
    name = session.get_inputs()[0].name
    return lambda seen: session.run(None, {name: seen[None].astype("f4")})[0][0], "onnxruntime"


def main() -> int:
    """Compare the speeds of all policies; return 1 if a difference is too large."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("playground", type=Path, help="A clone of mujoco_playground.")
    parser.add_argument("controller", type=Path, nargs="?", help="A clone of neural_controller.")
    given, apart = parser.parse_args(), 0.0
    with tempfile.TemporaryDirectory() as place:
        for one in PLAYGROUND:
            policy, scene = Path(place) / f"{one.name}.onnx", scene_file(given.playground, one)
            found = f"mujoco_playground/experimental/sim2sim/onnx/{one.name}_policy.onnx"
            shutil.copy(given.playground / found, policy)
            model = read_bare(scene)
            write_toml(policy.with_suffix(".toml"), one, model)
            act, how = load_runner(policy)
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
    return int(apart > SPEED_TOLERANCE)


if __name__ == "__main__":
    sys.exit(main())
