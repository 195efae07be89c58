"""Ball joints, which a URDF cannot state: held at rest with a warning, and named as a cause."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.base.diagnostics import Severity
from pupper_analysis.tools.live.window import list_contradictions
from tests.support.commands import answer

_ARM = """<mujoco model="arm"><compiler angle="radian"/><option timestep="0.001"/><worldbody>
<body name="base" pos="0 0 0.1"><geom type="box" size=".05 .05 .05" mass="1"/>
<body name="upper" pos="0 0 0.05"><joint name="turn" axis="0 0 1" range="-3 3" armature="0.01"/>
<geom type="capsule" fromto="0 0 0 0 0 0.1" size=".02" mass=".5" contype="0" conaffinity="0"/>
<body name="fore" pos="0 0 0.1"><joint name="lift" axis="0 1 0" range="-2 2" armature="0.01"/>
<geom type="capsule" fromto="0 0 0 0.2 0 0" size=".02" mass=".5" contype="0" conaffinity="0"/>
<body name="hand" pos="0.2 0 0">{ball}
<geom type="capsule" fromto="0 0 0 0.15 0 0" size=".02" mass=".3" contype="0" conaffinity="0"/>
</body></body></body></body>{beside}</worldbody>
<actuator><position joint="turn" kp="50" kv="2"/><position joint="lift" kp="50" kv="2"/></actuator>
</mujoco>"""
_BALL = '<joint name="wrist" type="ball" damping="0.01"/>'
_CRATE = """<body name="crate" pos="1 0 1"><freejoint/>
<geom type="box" size=".1 .1 .1" mass="2"/></body>"""


def write_arm(folder: Path, ball: str = "", beside: str = "") -> Path:
    """Write an arm, with a ball joint or a free-floating object beside the arm."""
    path = folder / "arm.xml"
    path.write_text(_ARM.format(ball=ball, beside=beside))
    return path


@pytest.mark.parametrize(("ball", "beside"), [(_BALL, ""), ("", _CRATE), (_BALL, _CRATE)])
def test_ball_joints_and_objects_beside_the_robot_are_no_coordinates(
    ball: str, beside: str, tmp_path: Path
) -> None:
    """Reference: bare MuJoCo on the same file, with ball joint and object at rest; Pinocchio.

    Jacobian, mass matrix and gravity torques of the two hinges, to 1e-12.
    """
    path = write_arm(tmp_path, ball, beside)
    robot = pa.load_robot(path)
    assert (robot.nq, robot.nv, robot.pin_model.nq, robot.mj_model.nq) == (2, 2, 2, 2)
    warnings = [note for note in robot.notes if note.severity is Severity.WARNING]
    expected = {"others-left-out": beside, "ball-joints-fixed": ball}
    assert [note.code for note in warnings] == [code for code, part in expected.items() if part]
    assert ("others-left-out" in {note.code for note in robot.notes}) == bool(beside)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    qpos = np.array([0.3, -0.4])
    data.qpos[:2] = qpos
    mujoco.mj_forward(model, data)
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jacBody(model, data, jacobian, None, model.body("hand").id)
    mass_matrix = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass_matrix)
    config = pa.Configuration(robot, qpos)
    np.testing.assert_allclose(config.frame_jacobian("hand")[:3], jacobian[:, :2], atol=1e-12)
    np.testing.assert_allclose(config.mass_matrix(), mass_matrix[:2, :2], atol=1e-12)
    np.testing.assert_allclose(config.gravity(), data.qfrc_bias[:2], atol=1e-12)
    np.testing.assert_allclose(config.frame_position("hand"), data.body("hand").xpos, atol=1e-12)


@pytest.mark.slow
def test_moving_ball_joint_is_named_as_the_cause(tmp_path: Path) -> None:
    """Reference: bare MuJoCo, in which the hand falls below the wrist. Control: a fixed wrist."""
    path = write_arm(tmp_path, _BALL)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    while data.time < 5:
        mujoco.mj_step(model, data)
    assert data.body("hand").xmat[6] < -0.9  # z of the hand's x axis
    done = answer("hold", str(path), folder=tmp_path)
    assert done.returncode == 1
    lines = done.stdout.splitlines()
    assert lines[0].startswith("DISAGREES arm.xml: torques of the unmodified file are ")
    assert "ball joints move, but the prediction holds them at rest" in lines[1]
    assert "wrist (line" in lines[1]
    assert "ball joints are held at rest" in done.stdout + done.stderr
    done = answer("hold", str(write_arm(tmp_path)), folder=tmp_path)
    assert done.returncode == 0, done.stdout


_LEG = """<body name="{leg}_thigh" pos="{x} {y} 0"><joint name="{leg}_hip" type="ball"/>
<geom type="capsule" fromto="0 0 0 0.05 0 -.18" size=".02" mass=".5"/>
<body name="{leg}_calf" pos="0.05 0 -.18"><joint name="{leg}_knee" {knee}/>
<geom type="capsule" fromto="0 0 0 -0.05 0 -.18" size=".015" mass=".2"/>
<geom name="{leg}_foot" type="sphere" size=".02" pos="-.05 0 -.2" mass=".05"/></body></body>"""


def write_quadruped(folder: Path, knee: str) -> Path:
    """Write a quadruped with ball joints at the hips, and motors at knees that are hinges."""
    places = {"FL": (0.2, 0.1), "FR": (0.2, -0.1), "RL": (-0.2, 0.1), "RR": (-0.2, -0.1)}
    legs = "".join(_LEG.format(leg=leg, x=x, y=y, knee=knee) for leg, (x, y) in places.items())
    motors = "".join(f'<motor joint="{leg}_knee" ctrlrange="-30 30"/>' for leg in places)
    path = folder / "quadruped.xml"
    path.write_text(
        '<mujoco model="quadruped"><compiler angle="radian"/><worldbody>'
        '<geom name="floor" type="plane" size="5 5 .1"/>'
        '<body name="trunk" pos="0 0 0.4"><freejoint/>'
        f'<geom type="box" size=".2 .1 .05" mass="6"/>{legs}</body></worldbody>'
        + ("" if "ball" in knee else f"<actuator>{motors}</actuator>")
        + "</mujoco>"
    )
    return path


@pytest.mark.slow
def test_ball_joints_in_legs_fail_stand_and_drop(tmp_path: Path) -> None:
    """Reference: bare MuJoCo with the knees held: the trunk falls, since nothing holds the hips.

    Compensated for the soft ground the stance is out of reach: the published file is compared
    nevertheless.
    """
    path = write_quadruped(tmp_path, 'axis="0 1 0" range="-0.03 0.02"')
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    knees = [model.joint(f"{leg}_knee") for leg in ("FL", "FR", "RL", "RR")]
    while data.time < 3:
        for motor, joint in enumerate(knees):
            angle, rate = data.qpos[joint.qposadr[0]], data.qvel[joint.dofadr[0]]
            data.ctrl[motor] = -53 * angle - 2.6 * rate
        mujoco.mj_step(model, data)
    assert data.body("trunk").xpos[2] < 0.2
    robot = pa.load_robot(path)
    stand = pa.solve_stand(robot)
    with pytest.raises(pa.StanceUnreachableError):
        pa.stance.solve_stand_on_soft_ground(robot, stand)
    verdict = pa.judge_stand(robot, stand)
    assert not verdict.passed
    assert verdict.published is not None
    assert [cause.code for cause in verdict.published.causes] == ["ball-joints"]
    messages = list_contradictions(robot)
    assert any("ball joints move" in message and "FL_hip" in message for message in messages)


def test_robot_with_ball_joints_alone_is_refused_by_their_names(tmp_path: Path) -> None:
    """A robot without hinges is refused in one line, with the cause: the ball joints."""
    path = write_quadruped(tmp_path, 'type="ball"')
    with pytest.raises(pa.ModelError, match=r"all joints are ball joints \(.*FL_hip, .*FL_knee"):
        pa.load_robot(path)
