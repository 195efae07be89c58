"""Robots, results and errors are equal after transfer to other processes and threads."""

from __future__ import annotations

import copy
import importlib
import inspect
import multiprocessing
import os
import pickle
import pkgutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import pupper_analysis as pa
from pupper_analysis.models.mjcf import silence_mujoco, spec_from_data, spec_to_data, to_xml
from pupper_analysis.stance.clearance import ClearanceShapes
from tests.support.patience import PATIENCE
from tests.support.repository import ROOT
from tests.support.variants import load, stand_of

REBUILT = 1e-14  # of the largest number of its kind
HEIGHTS = np.linspace(0.10, 0.14, 20)


def pickle_and_load(value: Any) -> Any:
    return pickle.loads(pickle.dumps(value))


COPIES = pytest.mark.parametrize("copied", [pickle_and_load, copy.deepcopy, copy.copy])

# -------------------------------------------------------------------------------------- errors


def all_errors() -> list[type[pa.PupperAnalysisError]]:
    """Every class of the package's errors, wherever it is defined."""
    for module in pkgutil.walk_packages(pa.__path__, "pupper_analysis."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)

    def below(kind: type[pa.PupperAnalysisError]) -> list[type[pa.PupperAnalysisError]]:
        return [kind, *(subclass for sub in kind.__subclasses__() for subclass in below(sub))]

    return sorted(
        (
            kind
            for kind in set(below(pa.PupperAnalysisError))
            if "pupper_analysis" in kind.__module__
        ),
        key=str,
    )


VALUES = st.none() | st.text() | st.floats(allow_nan=False)
ATTRIBUTES = st.dictionaries(
    st.text(min_size=1),
    st.none()
    | st.text()
    | st.floats(allow_nan=False)
    | st.dictionaries(st.text(), st.floats(0, 1)),
    max_size=4,
)


@pytest.mark.slow
@pytest.mark.parametrize("kind", all_errors(), ids=lambda kind: kind.__name__)
@COPIES
@given(message=st.text(), attributes=ATTRIBUTES)
def test_each_error_is_equal_after_pickling(
    kind: type[pa.PupperAnalysisError],
    copied: Callable[[Any], Any],
    message: str,
    attributes: dict[str, Any],
) -> None:
    attributes.pop("at", None)
    error = kind.__new__(kind, message)
    vars(error).update(attributes)
    for raised in (error, error.with_location("there")):
        back = copied(raised)
        assert type(back) is kind
        assert (back.args, vars(back), str(back)) == (raised.args, vars(raised), str(raised))


# -------------------------------------------------------------------------------------- robots


def assert_same_model(one: mujoco.MjModel, two: mujoco.MjModel, tolerance: float = 0.0) -> None:
    """Compares all numbers; where the spec was compiled again, but for the last digit."""
    compared = 0
    for name in dir(one):
        value = getattr(one, name) if not name.startswith("_") else None
        if isinstance(value, np.ndarray):
            size = np.abs(value).max(initial=1.0) if value.dtype.kind == "f" else 0.0
            np.testing.assert_allclose(
                getattr(two, name), value, rtol=0, atol=tolerance * size, err_msg=name
            )
            compared += 1
    assert compared > 300
    for name in ("timestep", "gravity", "integrator", "cone", "impratio", "noslip_iterations"):
        np.testing.assert_array_equal(getattr(one.opt, name), getattr(two.opt, name))


@pytest.mark.slow
@COPIES
def test_robot_is_equal_after_pickling(variant: str, copied: Callable[[Any], Any]) -> None:
    """All numbers of both engines' models; after recompilation of the spec within 1e-14."""
    robot = load(variant)
    back = copied(robot)
    assert back.fingerprint == robot.fingerprint
    assert back.pin_model == robot.pin_model
    assert_same_model(robot.mj_model, back.mj_model)
    assert_same_model(
        robot.description.mjcf.copy().compile(), back.description.mjcf.copy().compile(), REBUILT
    )
    assert {type(back.feet), type(back.contacts)} == {type(robot.feet)}
    assert (back.feet, back.contacts, back.notes) == (robot.feet, robot.contacts, robot.notes)
    assert (back.description.urdf, back.contact_points) == (
        robot.description.urdf,
        robot.contact_points,
    )


@pytest.mark.slow
@pytest.mark.parametrize("variant", ["v3-heavy", "long-leg"])
def test_pickled_robot_has_the_same_stand(variant: str) -> None:
    """qpos and torques are equal to the last bit, simulated heights within 1e-9."""
    robot = load(variant)
    back = pickle_and_load(robot)
    task = pa.StandTask(pitch=0.03, ground=pa.Ground(heights={robot.contact_points[0]: 0.01}))
    one, two = pa.solve_stand(robot, task), pa.solve_stand(back, task)
    np.testing.assert_array_equal(one.qpos, two.qpos)
    np.testing.assert_array_equal(
        pa.stance.stand_statics(robot, one).joint_torques,
        pa.stance.stand_statics(back, two).joint_torques,
    )
    # A stand of one is one of the other; steps are built into the spec, which was written.
    for first, second in ((robot, back), (back, robot)):
        simulated = pa.verify_stand(first, one, duration=2.0).base_height
        again = pa.verify_stand(second, two, duration=2.0).base_height
        assert again == pytest.approx(simulated, rel=1e-9)


def test_refusal_with_its_nearest_stand_is_equal_after_pickling() -> None:
    with pytest.raises(pa.StanceUnreachableError) as caught:
        pa.solve_stand(load("v3"), pa.StandTask(height=0.5))
    error = caught.value
    for back in (pickle_and_load(error), copy.deepcopy(error), copy.copy(error)):
        assert isinstance(back.nearest, pa.Stand)
        assert (back.shortfall, back.limits, back.possible) == (
            error.shortfall,
            error.limits,
            error.possible,
        )
        np.testing.assert_array_equal(back.nearest.qpos, error.nearest.qpos)


@pytest.mark.slow
def test_robot_with_a_payload_is_equal_after_pickling(tiny: pa.Robot) -> None:
    heavy = pa.robot.with_payload(tiny, 0.123456789, (0.0123456789, 0.0, 0.1))
    back = pickle_and_load(heavy)
    assert back.total_mass == heavy.total_mass
    assert_same_model(heavy.mj_model, back.mj_model)
    assert_same_model(
        heavy.description.mjcf.copy().compile(), back.description.mjcf.copy().compile(), REBUILT
    )


WEIGHTLESS = """<mujoco><default><default class="shape"><geom group="3" mass="0" density="0"/>
</default></default><worldbody><body><freejoint/><geom size="0.1"/>
<body><geom class="shape" size="0.1" mass="0"/></body></body></worldbody></mujoco>"""


def test_massless_shape_stays_massless_after_pickling() -> None:
    """As B2's feet: MuJoCo's writer leaves a class's mass and density out."""
    spec = mujoco.MjSpec.from_string(WEIGHTLESS)
    masses = spec.copy().compile().body_mass
    written = mujoco.MjModel.from_xml_string(to_xml(spec))
    for back in (spec_from_data(pickle_and_load(spec_to_data(spec))).compile(), written):
        np.testing.assert_allclose(back.body_mass, masses, rtol=1e-12)


DIGITS = """
<mujoco model="digits">
  <compiler angle="radian"/>
  <option timestep="0.00123456789" gravity="0 0 -9.80665123"/>
  <default><joint armature="0.0123456789"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1" friction="0.87654321 0.01 0.001"/>
    <body name="base" pos="0 0 0.512345678">
      <freejoint/>
      <geom type="box" size="0.123456789 0.1 0.1" mass="2.3456789" rgba="0.123456789 0 0 1"/>
      <frame pos="0.0123456789 0 0" euler="0.123456789 0 0">
        <body name="tail" euler="0.3 0.2 0.1">
          <inertial pos="0 0 0" mass="0.1" diaginertia="1e-3 2e-3 2.5e-3" euler="0 0.3333333 0"/>
          <joint name="wag" axis="1 2 3"/>
        </body>
      </frame>
      <body name="arm" pos="0.123456789 0 0">
        <inertial pos="0 0 0" mass="0.1" fullinertia="1e-3 2e-3 2.5e-3 1e-4 1e-5 2e-4"/>
        <joint name="turn" axis="0 0.6 0.8" range="-1.23456789 1" damping="0.0123456789"/>
        <geom type="sphere" size="0.0212345678" mass="0.345678912" solref="0.0123456789 1"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position joint="turn" kp="12.3456789" kv="0.123456789" forcerange="-1.23456789 1.23456789"/>
  </actuator>
  <sensor><jointpos joint="turn" noise="0.00123456789"/></sensor>
  <keyframe><key name="home" qpos="0 0 0.5123456789 1 0 0 0 0.1 0.123456789"/></keyframe>
</mujoco>
"""


@pytest.mark.parametrize("angle", ["radian", "degree"])
def test_pickled_spec_has_all_digits(angle: str) -> None:
    spec = mujoco.MjSpec.from_string(DIGITS.replace("radian", angle))
    back = spec_from_data(pickle_and_load(spec_to_data(spec)))
    assert_same_model(spec.copy().compile(), back.copy().compile(), REBUILT)
    again = spec_from_data(pickle_and_load(spec_to_data(back)))
    assert_same_model(spec.copy().compile(), again.compile(), REBUILT)


@pytest.mark.slow
def test_infinite_limits_are_equal_after_pickling(tiny: pa.Robot) -> None:
    """Pinocchio cannot read the infinity that Pinocchio writes, which would stop studies of Mini
    Cheetah."""
    robot = pickle_and_load(tiny)
    robot.pin_model.effortLimit[-1] = np.inf
    robot.pin_model.lowerPositionLimit[-1] = -np.inf
    for _ in range(2):
        robot = pickle_and_load(robot)
        assert robot.pin_model.effortLimit[-1] == np.inf
        assert robot.pin_model.lowerPositionLimit[-1] == -np.inf
        assert np.isfinite(robot.pin_model.upperPositionLimit[-1])


def test_meshes_are_pickled_with_their_model(tmp_path: Path) -> None:
    pa.pupper.write_variant("v3", tmp_path)
    spec = mujoco.MjSpec.from_file(str(tmp_path / "mjcf" / "v3.xml"))
    model, state = spec.copy().compile(), spec_to_data(spec)
    for mesh in (tmp_path / "mjcf" / "meshes").iterdir():
        mesh.unlink()
    assert_same_model(model, spec_from_data(state).compile(), REBUILT)


@COPIES
def test_results_are_equal_after_pickling(copied: Callable[[Any], Any]) -> None:
    """All fields as JSON; a copied configuration computes the same mass matrix, to the last bit."""
    robot, stand = load("v3"), stand_of("v3")
    config = pa.Configuration(robot, stand.qpos)
    for result in (
        stand,
        stand.task,
        pa.gravity_compensation(config),
        pa.verify_stand(robot, stand, duration=2.0, nudged=0),
        pa.steady_state(robot, stand),
        pa.matching.Tolerances(),
        pa.VARIANTS["v3"],
    ):
        back = copied(result)
        assert type(back) is type(result)
        assert pa.results.to_json(back) == pa.results.to_json(result)
    np.testing.assert_array_equal(copied(config).mass_matrix(), config.mass_matrix())


# -------------------------------------------------------------------------------------- processes


def heights(robot: pa.Robot, height: float) -> list[float]:
    stand = pa.solve_stand(robot, pa.StandTask(height=height, self_clearance=0.001))
    return [float(value) for value in stand.qpos]


@pytest.mark.slow
@pytest.mark.parametrize(
    "method", sorted({"spawn", "fork"} & {*multiprocessing.get_all_start_methods()})
)
def test_workers_solve_and_refuse(method: str) -> None:
    """An error that cannot be unpickled would hang the pool."""
    robot = load("v3")
    with multiprocessing.get_context(method).Pool(1) as pool:
        solved = pool.apply_async(heights, (robot, 0.12))
        refused = pool.apply_async(heights, (robot, 0.5))
        assert solved.get(100) == heights(robot, 0.12)
        with pytest.raises(pa.StanceUnreachableError, match="out of reach") as caught:
            refused.get(100)
    assert caught.value.nearest.robot == robot.fingerprint


def test_stands_of_twenty_threads_equal_those_of_one_thread() -> None:
    robot = load("v3")
    expected = [heights(robot, height) for height in HEIGHTS]
    with ThreadPoolExecutor(20) as pool:
        found = list(pool.map(lambda height: heights(robot, height), HEIGHTS))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


def test_robots_loaded_by_twenty_threads_are_equal() -> None:
    with ThreadPoolExecutor(20) as pool:
        robots = list(pool.map(lambda _: pa.load_variant("v3-heavy"), range(20)))
    assert {robot.fingerprint for robot in robots} == {load("v3-heavy").fingerprint}


@pytest.mark.skipif(not hasattr(os, "memfd_create"), reason="only Linux has files in memory")
def test_clearance_makes_no_temporary_files(monkeypatch: pytest.MonkeyPatch) -> None:
    """So a killed worker leaves none."""

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("a temporary file on disk")

    for name in ("mkstemp", "mkdtemp", "TemporaryDirectory", "NamedTemporaryFile"):
        monkeypatch.setattr(tempfile, name, refuse)
    nearest = ClearanceShapes(load("v3")).find_closest_links(stand_of("v3").qpos)
    assert nearest is not None
    assert nearest.distance > 0


def test_clearance_is_equal_without_in_memory_files(monkeypatch: pytest.MonkeyPatch) -> None:
    one = ClearanceShapes(load("v3")).find_closest_links(stand_of("v3").qpos)
    monkeypatch.delattr(os, "memfd_create", raising=False)
    assert ClearanceShapes(load("v3")).find_closest_links(stand_of("v3").qpos) == one


SIMULATE_AND_SILENCE = """
import sys, threading, time
import mujoco
from pupper_analysis.models.mjcf import silence_mujoco

sys.setswitchinterval(1e-6)
model = mujoco.MjModel.from_xml_string(
    '<mujoco><worldbody><body><joint/><geom size=".1"/></body></worldbody></mujoco>'
)
end = time.monotonic() + 4

def simulate():
    while time.monotonic() < end:
        data = mujoco.MjData(model)
        data.qvel[0] = 1e12  # MuJoCo warns
        mujoco.mj_step(model, data)

threads = [threading.Thread(target=simulate) for _ in range(3)]
for thread in threads:
    thread.start()
while time.monotonic() < end:
    with silence_mujoco():
        time.sleep(1e-4)
for thread in threads:
    thread.join()
"""


@pytest.mark.slow
def test_process_survives_warnings_while_another_thread_is_silenced(tmp_path: Path) -> None:
    """Reference: with a handler written in Python, MuJoCo ended the process within 1 to 3 s."""
    done = subprocess.run(
        [sys.executable, "-c", SIMULATE_AND_SILENCE],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
        timeout=PATIENCE,
    )
    assert done.returncode == 0, done.stderr[-500:]


def test_mujoco_warnings_are_silent_until_the_last_context_ends() -> None:
    """Threads compile and simulate at once; MuJoCo's warnings are the process's."""

    def heard(_: str) -> None:
        raise AssertionError

    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(heard)
    try:
        first, second = silence_mujoco(), silence_mujoco()
        first.__enter__()
        second.__enter__()
        first.__exit__(None, None, None)
        assert not inspect.isfunction(mujoco.get_mju_user_warning())  # none written in Python
        second.__exit__(None, None, None)
        assert mujoco.get_mju_user_warning() is heard
    finally:
        mujoco.set_mju_user_warning(before)
