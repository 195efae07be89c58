"""Ranges of fixed tendons bound postures that are held, as ranges of joints do."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.tool import find_tool
from pupper_analysis.stance.posture import find_posture, joint_ranges
from pupper_analysis.tools.hold.hold import reach_load
from pupper_analysis.tools.hold.motions import JointMotions
from pupper_analysis.tools.hold.sag import sag_posture
from pupper_analysis.tools.hold.worst import worst_postures

FINGER = """<mujoco><compiler angle="radian"/><worldbody><body name="palm">
<geom size=".02" mass=".1"/>
<body name="near" pos="0 0 .05"><joint name="root" axis="0 1 0" range="-1.5 1.5"/>
<geom type="capsule" fromto="0 0 0 .1 0 0" size=".01" mass=".2"/>
<body name="middle" pos=".1 0 0"><joint name="mid" axis="0 1 0" range="-1.5 1.5"/>
<geom type="capsule" fromto="0 0 0 .07 0 0" size=".01" mass=".1"/>
<body name="far" pos=".07 0 0"><joint name="tip" axis="0 1 0" range="-1.5 1.5"/>
<geom type="capsule" fromto="0 0 0 .05 0 0" size=".01" mass=".08"/>
</body></body></body></body></worldbody>
<tendon><fixed name="cord" limited="true" range="0.8 2"><joint joint="root" coef="1"/>
<joint joint="mid" coef=".7"/><joint joint="tip" coef="-.4"/></fixed></tendon>
EQUALITY<actuator><position joint="root" kp="30" kv=".3" forcerange="-2 2"/>
<position joint="mid" kp="30" kv=".3" forcerange="-2 2"/>TIP</actuator></mujoco>"""

COUPLED = '<equality><joint joint1="tip" joint2="mid" polycoef="0 .8"/></equality>'
TIP = '<position joint="tip" kp="30" kv=".3" forcerange="-2 2"/>'
COEFFICIENTS = {"root": 1.0, "mid": 0.7, "tip": -0.4}


def finger(folder: Path, *, coupled: bool = False, text: str = FINGER) -> pa.Robot:
    parts = (COUPLED, "") if coupled else ("", TIP)
    file = folder / "finger.xml"
    file.write_text(text.replace("EQUALITY", parts[0]).replace("TIP", parts[1]))
    return pa.load_robot(file, fixed_base=True)


def cord(robot: pa.Robot, qpos: np.ndarray) -> float:
    """Returns how long MuJoCo has the tendon in a posture."""
    data = mujoco.MjData(robot.mj_model)
    data.qpos[robot.mj_convention.qpos_index] = qpos
    mujoco.mj_fwdPosition(robot.mj_model, data)
    return float(data.ten_length[0])


def samples(robot: pa.Robot, *, coupled: bool, most: float = 2.0) -> np.ndarray:
    """Returns random postures (n, 3) in the ranges of the joints, and in the tendon's."""
    names = robot.joint_names
    found = np.random.default_rng(3).uniform(*joint_ranges(robot).T, size=(15_000, 3))
    if coupled:
        found[:, names.index("tip")] = 0.8 * found[:, names.index("mid")]
    lengths = found @ [COEFFICIENTS[name] for name in names]
    return found[(lengths > 0.8) & (lengths < most)]


@pytest.mark.parametrize("coupled", [False, True])
def test_a_posture_is_in_a_tendons_range_or_refused(coupled: bool, tmp_path: Path) -> None:
    """The middle of the joints' ranges has it at 0, below its 0.8."""
    robot = finger(tmp_path, coupled=coupled)
    assert all(note.code != "tendon-ranges-not-kept" for note in robot.notes)
    posture = find_posture(robot)
    assert 0.8 + 0.1 < cord(robot, posture.qpos) < 2.0 - 0.1
    given = find_posture(robot, {"mid": -0.5})
    assert given.qpos[robot.joint_names.index("mid")] == -0.5
    assert 0.8 < cord(robot, given.qpos) < 2.0
    for beyond in ({"root": 0.0, "mid": 0.0, "tip": 0.0}, {"root": 1.5, "mid": 1.5, "tip": -1.0}):
        if coupled:
            beyond = {"root": -1.0, "mid": 0.0}
        with pytest.raises(pa.ConfigurationError, match="tendon cord is at the end of its range"):
            find_posture(robot, beyond)


@pytest.mark.parametrize("coupled", [False, True])
def test_worst_postures_are_in_it_and_no_sample_in_it_is_worse(
    coupled: bool, tmp_path: Path
) -> None:
    """Along its end two joints move at once: from there neither could by itself."""
    robot = finger(tmp_path, coupled=coupled)
    posture = find_posture(robot)
    worst = worst_postures(robot, posture, find_tool(robot))
    found = np.abs(worst.joint_torques)
    inside = samples(robot, coupled=coupled)
    at = [Configuration(robot, one) for one in inside]
    torques = np.array([there.by_motors(there.load()) for there in at])
    most = np.abs(torques).max(axis=0)
    assert (most <= found + 1e-9).all()
    assert (most >= 0.97 * found).all()  # of so many samples one is near
    for qpos in worst.postures:
        assert 0.8 - 1e-6 < cord(robot, qpos) < 2.0 + 1e-6


def test_the_reach_and_random_postures_are_in_it(tmp_path: Path) -> None:
    robot = finger(tmp_path)
    posture = find_posture(robot)
    lengths = [cord(robot, qpos) for qpos in JointMotions(robot, posture).random(200)]
    assert 0.8 - 1e-9 < min(lengths) < 0.9
    assert 1.9 < max(lengths) < 2.0 + 1e-9
    reached = reach_load(robot, posture, find_tool(robot))
    straight = 0.05 + 0.1 + 0.07 + 0.05  # the tendon keeps it from pointing up
    assert reached.heights.max() < 0.9 * straight


def test_servos_that_sag_to_its_end_are_told_so(tmp_path: Path) -> None:
    """Gravity bends the finger down: the tendon gets longer."""
    robot = finger(tmp_path, text=FINGER.replace('kp="30"', 'kp="2"'))
    posture = find_posture(robot, {"root": 0.8, "mid": 0.3, "tip": -1.3})
    assert sag_posture(robot, posture, find_tool(robot)).joint_sag.min() > 0
    near = find_posture(robot, {"root": 0.8, "mid": 0.95, "tip": -1.32})
    assert cord(robot, near.qpos) < 2.0
    with pytest.raises(pa.NoEquilibriumError, match="tendon cord is at the end"):
        sag_posture(robot, near, find_tool(robot))


@pytest.mark.parametrize(
    ("bent", "rest", "axes", "most"),
    [
        ((-0.176, 0.0, -0.907, -0.186), (-0.808, -0.037), ("0 0 1", "0 0 1", "0 1 0"), 0.036884),
        ((0.138, 0.0, -0.507, 0.159), (-1.039, 0.0), ("1 0 0", "0 0 1", "1 0 0"), 0.129869),
    ],
)
def test_a_coupling_that_bends_is_looked_at_between_its_places(
    bent: tuple[float, ...],
    rest: tuple[float, ...],
    axes: tuple[str, ...],
    most: float,
    tmp_path: Path,
) -> None:
    """At its end, which lies between two, MuJoCo asks for 1.17 times what these do; in a peak that
    is not by the greatest of these, for 1.07 times what is by that."""
    words = [" ".join(map(str, [*one[::-1], *[0.0] * (5 - len(one))])) for one in (bent, rest)]
    coupled = (
        f'<equality><joint joint1="mid" joint2="root" polycoef="{words[0]}"/>'
        f'<joint joint1="tip" joint2="mid" polycoef="{words[1]}"/></equality>'
    )
    root, names = FINGER.index("<position"), ("root", "mid", "tip")
    text = FINGER[: FINGER.index("<tendon>")] + coupled + "<actuator>"
    text += FINGER[root : FINGER.index("/>", root)] + "/></actuator></mujoco>"
    for axis, name in zip(axes, names, strict=True):
        old = f'name="{name}" axis="0 1 0" range="-1.5 1.5"'
        text = text.replace(old, f'name="{name}" axis="{axis}" range="-3 3"')
    robot = finger(tmp_path, text=text)
    worst = worst_postures(robot, find_posture(robot), find_tool(robot))
    model = robot.mj_model
    data, loads = mujoco.MjData(model), []
    for lead in np.linspace(-3, 3, 3001):
        mid = np.polyval(bent, lead)
        angles = lead, mid, np.polyval(rest, mid)
        if np.abs(angles).max() <= 3:
            data.qpos[[model.joint(name).qposadr[0] for name in names]] = angles
            mujoco.mj_forward(model, data)
            rate = np.polyval(np.polyder(bent), lead)
            load = data.qfrc_bias[[model.joint(name).dofadr[0] for name in names]]
            loads.append(abs(load @ (1.0, rate, rate * rest[0])))
    assert max(loads) == pytest.approx(most, rel=1e-4)
    found = abs(worst.joint_torques[worst.joint_names.index("root")])
    assert (1 - 1e-5) * max(loads) <= found <= 1.01 * max(loads)
