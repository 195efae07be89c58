"""Arm with numbers in closed form: a turntable, two elbows and a slide.

The upper arm turns about y: at an angle a it points along (cos a, 0, -sin a). The order of the
MJCF's actuators differs from the order of the joints in the tree, and from that of their names.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.prepare.convert.load import load_robot
from pupper_analysis.robot.robot import Robot

G = 9.81
"""Gravitational acceleration [m/s^2]."""

UPPER, FORE, SLIDE = 0.4, 0.3, 0.1
"""Lengths of upper arm and forearm, and distance of the tip from the hand's frame [m]."""

MASSES = {"turn": 3.0, "upper": 2.0, "fore": 1.0, "hand": 0.5}
"""{link: mass [kg]}."""

CENTRES = {"upper": 0.15, "fore": 0.2}
"""{link: distance of its CoM from its joint [m]}; others are at the joint."""

EFFORTS = {"a_turn": 5.0, "shoulder": 30.0, "elbow": 9.0, "b_slide": 12.0}
"""{joint: torque or force limit [N m, N]}."""

RANGES = {
    "a_turn": (-3.0, 3.0),
    "shoulder": (-2.0, 0.5),
    "elbow": (0.2, 2.4),
    "b_slide": (0.0, 0.2),
}
"""{joint: lower and upper limit [rad, m]}."""

STIFFNESS = {"a_turn": 50.0, "shoulder": 800.0, "elbow": 300.0, "b_slide": 900.0}
"""{joint: stiffness of its servo [N m/rad, N/m]}."""

ORDER = ("elbow", "b_slide", "shoulder", "a_turn")
"""Joints in the order of the actuators."""


def _make_inertial(mass: float, x: float) -> str:
    """Return the ``<inertial>`` of a link, with the CoM at ``x`` [m]."""
    return (
        f'<inertial><origin xyz="{x} 0 0"/><mass value="{mass}"/>'
        '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'
    )


def _make_joint(name: str, kind: str, parent: str, child: str, xyz: str, axis: str) -> str:
    """Return the ``<joint>`` of a URDF."""
    low, high = RANGES[name]
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}"/><axis xyz="{axis}"/>'
        f'<limit lower="{low}" upper="{high}" effort="{EFFORTS[name]}" velocity="5"/></joint>'
    )


URDF = f"""<robot name="arm"><link name="base"/>
<link name="turn">{_make_inertial(MASSES["turn"], 0)}</link>
<link name="upper">{_make_inertial(MASSES["upper"], CENTRES["upper"])}</link>
<link name="fore">{_make_inertial(MASSES["fore"], CENTRES["fore"])}</link>
<link name="hand">{_make_inertial(MASSES["hand"], 0)}</link><link name="tip"/>
{_make_joint("a_turn", "revolute", "base", "turn", "0 0 0.5", "0 0 1")}
{_make_joint("shoulder", "revolute", "turn", "upper", "0 0 0", "0 1 0")}
{_make_joint("elbow", "revolute", "upper", "fore", f"{UPPER} 0 0", "0 1 0")}
{_make_joint("b_slide", "prismatic", "fore", "hand", f"{FORE} 0 0", "1 0 0")}
<joint name="weld" type="fixed"><parent link="hand"/><child link="tip"/>
<origin xyz="{SLIDE} 0 0"/></joint></robot>"""


def _make_body(name: str, joint: str, mass: float, x: float, inner: str = "") -> str:
    """Return the ``<body>`` of an MJCF, with a joint and further content."""
    low, high = RANGES[joint]
    kind = "slide" if joint == "b_slide" else "hinge"
    axis = {"a_turn": "0 0 1", "b_slide": "1 0 0"}.get(joint, "0 1 0")
    pos = {"turn": "0 0 0.5", "fore": f"{UPPER} 0 0", "hand": f"{FORE} 0 0"}.get(name, "0 0 0")
    return (
        f'<body name="{name}" pos="{pos}"><joint name="{joint}" type="{kind}" axis="{axis}" '
        f'range="{low} {high}" damping="2"/><inertial pos="{x} 0 0" mass="{mass}" '
        f'diaginertia="0.01 0.01 0.01"/>{inner}</body>'
    )


_HAND = _make_body("hand", "b_slide", MASSES["hand"], 0, f'<site name="tip" pos="{SLIDE} 0 0"/>')
_FORE = _make_body("fore", "elbow", MASSES["fore"], CENTRES["fore"], _HAND)
_UPPER = _make_body("upper", "shoulder", MASSES["upper"], CENTRES["upper"], _FORE)
_SERVOS = "".join(f'<position joint="{name}" kp="{STIFFNESS[name]}" kv="20"/>' for name in ORDER)
MJCF = f"""<mujoco model="arm"><compiler angle="radian"/>
<option timestep="0.002" integrator="implicitfast"/><worldbody><body name="base">
{_make_body("turn", "a_turn", MASSES["turn"], 0, _UPPER)}</body></worldbody>
<actuator>{_SERVOS}</actuator></mujoco>"""


@cache
def arm() -> Robot:
    """Load the arm."""
    with TemporaryDirectory() as folder:
        return load_arm(Path(folder))


def load_arm(folder: Path, urdf: str = URDF, mjcf: str = MJCF) -> Robot:
    """Load the arm of two texts."""
    files = folder / "arm.urdf", folder / "arm.xml"
    for file, text in zip(files, (urdf, mjcf), strict=True):
        file.write_text(text, encoding="utf-8")
    return load_robot(urdf=files[0], mjcf=files[1])


def holding_torques(turn: float, shoulder: float, elbow: float, slide: float) -> dict[str, float]:
    """Return the joint torques [N m, N] that hold the arm: derivatives of its potential energy."""
    del turn  # about the vertical
    ahead = shoulder + elbow
    fore = MASSES["fore"] * CENTRES["fore"] + MASSES["hand"] * (FORE + slide)
    upper = MASSES["upper"] * CENTRES["upper"] + (MASSES["fore"] + MASSES["hand"]) * UPPER
    return {
        "a_turn": 0.0,
        "shoulder": -G * (upper * np.cos(shoulder) + fore * np.cos(ahead)),
        "elbow": -G * fore * np.cos(ahead),
        "b_slide": -G * MASSES["hand"] * np.sin(ahead),
    }


def tip_position(turn: float, shoulder: float, elbow: float, slide: float) -> NDArray[np.float64]:
    """Return the position (3,) [m] of the tip in the base frame."""
    ahead, reach = shoulder + elbow, FORE + slide + SLIDE
    out = UPPER * np.cos(shoulder) + reach * np.cos(ahead)
    up = -UPPER * np.sin(shoulder) - reach * np.sin(ahead)
    return np.array([out * np.cos(turn), out * np.sin(turn), 0.5 + up])


ANCHOR = {"a_turn": 0.7, "shoulder": -0.6, "elbow": 1.1, "b_slide": 0.05}
"""Posture [rad, m] in which the hand of a tied arm is tied to the world."""


def write_tied_arm(
    folder: Path,
    kind: str,
    offsets: dict[str, float],
    servos: str = _SERVOS,
    ctrl: bool = True,
    base_mass: float = 0.0,
) -> Robot:
    """Load the arm with a tied hand, and a keyframe that differs from `ANCHOR` by ``offsets``."""
    data = mujoco.MjData(mujoco.MjModel.from_xml_string(MJCF))
    for name, position in ANCHOR.items():
        data.joint(name).qpos = position
    mujoco.mj_kinematics(data.model, data)
    hand = data.body("hand")
    pose = " ".join(map(repr, (*hand.xpos.tolist(), *hand.xquat.tolist())))
    tie = (
        f'<weld name="bolt" body1="world" body2="hand" relpose="{pose}"/>'
        if kind == "weld"
        else '<connect name="bolt" site1="tip" site2="hook"/>'
    )
    hook = " ".join(map(repr, tip_position(*ANCHOR.values()).tolist()))
    start = {name: position + offsets.get(name, 0.0) for name, position in ANCHOR.items()}
    commands = f'ctrl="{" ".join(str(start[name]) for name in ORDER)}"' if ctrl else ""
    key = f'<key name="home" qpos="{" ".join(map(str, start.values()))}" {commands}/>'
    text = MJCF.replace(_SERVOS, servos)
    text = text.replace("<worldbody>", f'<worldbody><site name="hook" pos="{hook}"/>')
    if base_mass:  # a body without mass cannot be welded
        inertial = f'<inertial pos="0 0 0" mass="{base_mass}" diaginertia="0.01 0.01 0.01"/>'
        text = text.replace('<body name="base">', f'<body name="base">{inertial}')
    end = f"<equality>{tie}</equality><keyframe>{key}</keyframe></mujoco>"
    return load_arm(folder, mjcf=text.replace("</mujoco>", end))


SOFT_SERVOS = "".join(f'<position joint="{name}" kp="2" kv="5"/>' for name in ORDER)
"""Servos that do not hold the arm, for `write_tied_arm`."""
