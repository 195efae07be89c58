"""Shared by the tests: robots loaded once, random states, and each engine's own view of a robot."""

import contextlib
import copy
import importlib.util
import io
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import hypothesis
import mujoco
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import pupper_analysis as pa
from pupper_analysis import cli
from pupper_analysis.diagnostics import Diagnostic, diagnose

hypothesis.settings.register_profile(
    "suite",
    deadline=None,
    max_examples=20,
    derandomize=True,
    database=None,
    suppress_health_check=[hypothesis.HealthCheck.too_slow],
)
hypothesis.settings.load_profile("suite")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Marks the longest as slow, before any are chosen by their marks."""
    for item in items:
        if item.get_closest_marker("longest"):
            item.add_marker(pytest.mark.slow)


ROOT = Path(__file__).resolve().parents[1]
NAMES = tuple(pa.VARIANTS)
V3_NAMES = tuple(name for name in NAMES if name.startswith("v3"))
SKELETON_NAMES = tuple(name for name in NAMES if not name.startswith("v3"))
BASES = {"original": "pupper_skeleton", "v3": "pupper_v3"}  # variant: name of its files


BASES_FIRST = (*BASES, *(name for name in NAMES if name not in BASES))


def some(values: Sequence[Any], every: int, first: int = 1) -> list[Any]:
    """Cases of which the first, and one of ``every``, are run; the others in the longest stage."""
    return [
        value if place < first or place % every == 0 else longest(value)
        for place, value in enumerate(values)
    ]


def longest(value: Any) -> Any:
    case = value if isinstance(value, tuple) else (value,)
    return pytest.param(*case, marks=pytest.mark.longest)


@cache
def load(name: str, fixed_base: bool = False) -> pa.Robot:
    return pa.load_variant(name, fixed_base=fixed_base)


def with_efforts(robot: pa.Robot, efforts: float | Sequence[float] | np.ndarray) -> pa.Robot:
    """The robot with these effort limits (nu,), or one for all, in both of its models (N m)."""
    urdf, mjcf = robot.pin_model.copy(), copy.copy(robot.mj_model)
    limits = np.array(urdf.effortLimit)
    limits[robot.pin_convention.v_index] = efforts
    urdf.effortLimit = limits
    for name, limit in zip(robot.joint_names, limits[robot.pin_convention.v_index], strict=True):
        drives = mjcf.actuator_trnid[:, 0] == mjcf.joint(name).id
        mjcf.actuator_forcelimited[drives] = np.isfinite(limit)
        mjcf.actuator_forcerange[drives] = (-limit, limit) if np.isfinite(limit) else 0.0
    return replace(robot, pin_model=urdf, mj_model=mjcf)


@cache
def stand_of(name: str) -> pa.Stand:
    return pa.solve_stand(load(name))


@pytest.fixture(scope="session", params=NAMES)
def variant(request: pytest.FixtureRequest) -> str:
    """The name of each variant in turn."""
    return str(request.param)


@pytest.fixture(scope="session")
def robot(variant: str) -> pa.Robot:
    return load(variant)


@pytest.fixture(scope="session")
def stand(variant: str) -> pa.Stand:
    return stand_of(variant)


# ------------------------------------------------------------------------------------- states


def changed(robot: pa.Robot, change: Callable[[mujoco.MjModel], None]) -> pa.Robot:
    """The robot with another MuJoCo model."""
    model = copy.copy(robot.mj_model)
    change(model)
    return replace(robot, mj_model=model)


def numbers(size: int, limit: float) -> st.SearchStrategy[np.ndarray]:
    """Vectors of a size with elements between -limit and limit."""
    element = st.floats(-limit, limit, allow_subnormal=False)
    return st.lists(element, min_size=size, max_size=size).map(np.array)


def quaternion(rotation_vector: np.ndarray) -> np.ndarray:
    """The unit quaternion (w, x, y, z) of a rotation vector [rad]."""
    return np.asarray(Rotation.from_rotvec(rotation_vector).as_quat(scalar_first=True))


def qpos_of(robot: pa.Robot, place: np.ndarray, turn: np.ndarray, share: np.ndarray) -> np.ndarray:
    """A configuration; ``share`` places the joints between their limits (-1: lower, 1: upper)."""
    lower = np.maximum(robot.lower_limits, -3.0)
    upper = np.minimum(robot.upper_limits, 3.0)
    joints = (lower + upper) / 2 + share * (upper - lower) / 2
    return np.concatenate([place, quaternion(turn), joints]) if robot.floating else joints


def positions(robot: pa.Robot) -> st.SearchStrategy[np.ndarray]:
    """Configurations qpos anywhere, turned anyhow, inside the joint limits."""
    return st.builds(
        lambda place, turn, share: qpos_of(robot, place, turn, share),
        numbers(3, 2.0),
        numbers(3, 1.8),
        numbers(robot.nu, 1.0),
    )


def velocities(robot: pa.Robot) -> st.SearchStrategy[np.ndarray]:
    return numbers(robot.nv, 4.0)


def random_state(robot: pa.Robot, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """One state (qpos, qvel) with all its elements in play."""
    random = np.random.default_rng(seed)
    qpos = qpos_of(robot, *(random.uniform(-0.9, 0.9, size) for size in (3, 3, robot.nu)))
    return qpos, random.uniform(-2, 2, robot.nv)


# ------------------------------------------------------------------------------------- MuJoCo


def addresses(robot: pa.Robot) -> tuple[np.ndarray, np.ndarray]:
    """Where the public qpos and qvel are in MuJoCo's, found by the joints' names."""
    model = robot.mj_model
    base_q = list(range(7)) if robot.floating else []
    base_v = list(range(6)) if robot.floating else []
    joints = [model.joint(name) for name in robot.joint_names]
    q = base_q + [int(joint.qposadr[0]) for joint in joints]
    v = base_v + [int(joint.dofadr[0]) for joint in joints]
    return np.array(q), np.array(v)


def mujoco_at(
    robot: pa.Robot,
    qpos: np.ndarray,
    qvel: np.ndarray | None = None,
    model: mujoco.MjModel | None = None,
) -> mujoco.MjData:
    """MuJoCo's data of the MJCF at a public state, computed."""
    model = model or robot.mj_model
    data = mujoco.MjData(model)
    q, v = addresses(robot)
    data.qpos[q] = qpos
    data.qvel[v] = 0.0 if qvel is None else qvel
    mujoco.mj_forward(model, data)
    return data


def integrate(robot: pa.Robot, qpos: np.ndarray, qvel: np.ndarray, dt: float) -> np.ndarray:
    """The qpos after dt at constant qvel, by MuJoCo."""
    q, v = addresses(robot)
    moved, rate = np.empty(robot.mj_model.nq), np.empty(robot.mj_model.nv)
    moved[q], rate[v] = qpos, qvel
    mujoco.mj_integratePos(robot.mj_model, moved, rate, dt)
    return moved[q]


def rate_along(
    robot: pa.Robot,
    function: Callable[[np.ndarray], np.ndarray],
    qpos: np.ndarray,
    qvel: np.ndarray,
    dt: float = 1e-5,
) -> np.ndarray:
    """The time derivative of function(qpos) at velocity qvel, by a central difference."""
    ahead, behind = (integrate(robot, qpos, qvel, sign * dt) for sign in (1, -1))
    return (np.asarray(function(ahead)) - np.asarray(function(behind))) / (2 * dt)


def free_mechanism(robot: pa.Robot, timestep: float = 1e-3) -> mujoco.MjModel:
    """The robot's MuJoCo model without contacts, limits, motors, damping and friction; RK4."""
    model = robot.description.mjcf.copy().compile()
    off = mujoco.mjtDisableBit
    for bit in (off.mjDSBL_CONTACT, off.mjDSBL_LIMIT, off.mjDSBL_ACTUATION):
        model.opt.disableflags |= bit.value
    model.dof_damping[:] = 0.0
    model.dof_frictionloss[:] = 0.0
    model.opt.timestep = timestep
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4.value
    return model


# ------------------------------------------------------------------------------------- bodies


class Body(NamedTuple):
    """A moving body: mass [kg], com [m] and inertia about it [kg m^2], and the frame's pose.

    All are in the axes of the base at zero angles, positions from the base.
    """

    mass: float
    com: np.ndarray
    inertia: np.ndarray
    position: np.ndarray
    rotation: np.ndarray


def pinocchio_bodies(robot: pa.Robot) -> dict[str, Body]:
    """What moves with each joint (and with the base, "base"), by Pinocchio from the URDF."""
    model = robot.pin_model
    config = pa.Configuration(robot, robot.neutral())
    bodies = {}
    for index in range(1, model.njoints):
        name = "base" if index == 1 else str(model.names[index])
        frame = robot.base
        if index > 1:
            links = (f for f in model.frames if f.type == pin.FrameType.BODY)
            frame = next(link.name for link in links if link.parentJoint == index)
        inertia, rotation = model.inertias[index], config.frame_rotation(frame)
        origin = config.frame_position(frame)
        bodies[name] = Body(
            float(inertia.mass),
            origin + rotation @ inertia.lever,
            rotation @ inertia.inertia @ rotation.T,
            origin,
            rotation,
        )
    return bodies


def mujoco_bodies(robot: pa.Robot) -> dict[str, Body]:
    """The same by MuJoCo from the MJCF."""
    model = robot.mj_model
    data = mujoco_at(robot, robot.neutral())
    bodies = {}
    for index in range(1, model.nbody):
        joint = model.joint(int(model.body_jntadr[index]))
        name = "base" if index == 1 else str(joint.name)
        axes = data.ximat[index].reshape(3, 3)
        bodies[name] = Body(
            float(model.body_mass[index]),
            data.xipos[index].copy(),
            axes @ np.diag(model.body_inertia[index]) @ axes.T,
            data.xpos[index].copy(),
            data.xmat[index].reshape(3, 3).copy(),
        )
    return bodies


BODIES = {"urdf": pinocchio_bodies, "mjcf": mujoco_bodies}


def assert_same_bodies(one: dict[str, Body], two: dict[str, Body], tolerance: float) -> None:
    """Compares all there is, relative to the size of each quantity."""
    assert one.keys() == two.keys()
    for name, body in one.items():
        for field, value in body._asdict().items():
            other = getattr(two[name], field)
            size = max(float(np.abs(value).max()), 1e-2 if field in ("com", "position") else 0.0)
            np.testing.assert_allclose(
                other, value, rtol=0, atol=tolerance * size, err_msg=f"{name}: {field}"
            )


# ------------------------------------------------------------------------------------- robots


TINY_URDF = """
<robot name="tiny">
  <link name="base">
    <inertial><origin xyz="0.01 0.02 0.03"/><mass value="2"/>
      <inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0.001" ixz="0.002" iyz="0.003"/></inertial>
  </link>
  <joint name="turn" type="continuous"><origin xyz="0.1 0 0" rpy="0.3 0 0"/><axis xyz="0 0 1"/>
    <parent link="base"/><child link="arm"/><limit effort="5" velocity="9"/></joint>
  <link name="arm">
    <inertial><origin xyz="0 0 -0.1"/><mass value="0.5"/>
      <inertia ixx="0.002" iyy="0.003" izz="0.004" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <joint name="bend" type="revolute"><origin xyz="0.05 0 -0.2"/><axis xyz="0 1 0"/>
    <parent link="arm"/><child link="hand"/>
    <limit lower="-1" upper="2" effort="4" velocity="9"/></joint>
  <link name="hand">
    <inertial><origin xyz="0 0 -0.05"/><mass value="0.3"/>
      <inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <joint name="toe" type="fixed"><origin xyz="0 0 -0.1"/>
    <parent link="hand"/><child link="foot"/></joint>
  <link name="foot"/>
  <joint name="push" type="prismatic"><origin xyz="-0.1 0 0"/><axis xyz="0 0 1"/>
    <parent link="base"/><child link="rod"/>
    <limit lower="-0.3" upper="0.4" effort="3" velocity="9"/></joint>
  <link name="rod">
    <inertial><origin xyz="0 0 -0.1"/><mass value="0.4"/>
      <inertia ixx="0.002" iyy="0.002" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
</robot>
"""

# The rod before the arm, the actuators in a third order, one joint without.
TINY_MJCF = """
<mujoco model="tiny">
  <compiler angle="radian" eulerseq="XYZ" autolimits="true"/>
  <default><joint armature="0.01"/></default>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body name="base" pos="0 0 0.5">
      <freejoint/>
      <inertial pos="0.01 0.02 0.03" mass="2" fullinertia="0.02 0.03 0.04 0.001 0.002 0.003"/>
      <body name="rod" pos="-0.1 0 0">
        <joint name="push" type="slide" axis="0 0 1" range="-0.3 0.4"/>
        <inertial pos="0 0 -0.1" mass="0.4" diaginertia="0.002 0.002 0.001"/>
      </body>
      <body name="arm" pos="0.1 0 0" euler="0.3 0 0">
        <joint name="turn" axis="0 0 1"/>
        <inertial pos="0 0 -0.1" mass="0.5" diaginertia="0.002 0.003 0.004"/>
        <body name="hand" pos="0.05 0 -0.2">
          <joint name="bend" axis="0 1 0" range="-1 2" armature="0.02"/>
          <inertial pos="0 0 -0.05" mass="0.3" diaginertia="0.001 0.001 0.001"/>
          <geom type="sphere" size="0.02" pos="0 0 -0.1"/>
          <site name="foot" pos="0 0 -0.1"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="bend"/><motor joint="push"/></actuator>
</mujoco>
"""


class Files(NamedTuple):
    urdf: Path
    mjcf: Path


@pytest.fixture(scope="session")
def tiny_files(tmp_path_factory: pytest.TempPathFactory) -> Files:
    """A robot with a continuous and a sliding joint; each file has the joints in another order."""
    folder = tmp_path_factory.mktemp("tiny")
    files = Files(folder / "tiny.urdf", folder / "tiny.xml")
    files.urdf.write_text(TINY_URDF)
    files.mjcf.write_text(TINY_MJCF)
    return files


@pytest.fixture(scope="session")
def tiny(tiny_files: Files) -> pa.Robot:
    return pa.load_robot(urdf=tiny_files.urdf, mjcf=tiny_files.mjcf, feet=["foot"])


def script(path: str) -> ModuleType:
    """Loads a script of the repository, which is in no package, as a module."""
    name = f"{Path(path).stem}_script"
    spec = importlib.util.spec_from_file_location(name, ROOT / path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # its dataclasses look themselves up there
    spec.loader.exec_module(module)
    return module


def benchmark(name: str) -> ModuleType:
    return script(f"benchmarks/{name}.py")


def run_command(capfd: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    """Runs ``pupper-analysis`` in this process, to save the time of its start.

    Returns:
        Exit status, standard output and standard error, with what C++ prints.
    """
    with pytest.raises(SystemExit) as leaving:
        cli.run(cli.group, list(arguments))
    out, err = capfd.readouterr()
    return int(leaving.value.code or 0), out, err


def check_refusal(
    capfd: pytest.CaptureFixture[str], folder: Path, arguments: Sequence[str], message: str
) -> None:
    """Checks that bad input is one line, exit status 2, and no file in the current folder."""
    status, out, err = run_command(capfd, *arguments)
    assert status == 2
    assert message in err
    assert err.startswith("error: ")
    assert len(err.strip().splitlines()) == 1
    assert out == ""
    assert list(folder.iterdir()) == []


class Answer(NamedTuple):
    """What a command came to; `run_command` is for what C++ prints too."""

    returncode: int
    stdout: str
    stderr: str


def answer(*arguments: str, folder: Path | None = None) -> Answer:
    """Runs a command in this process, in a folder."""
    out, err = io.StringIO(), io.StringIO()
    with (
        contextlib.chdir(folder or "."),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        pytest.raises(SystemExit) as leaving,
    ):
        cli.run(cli.group, list(arguments))
    return Answer(int(leaving.value.code or 0), out.getvalue(), err.getvalue())


def problem(words: str) -> Diagnostic:
    """A diagnostic of these words."""
    return diagnose("problem", problem=words)
