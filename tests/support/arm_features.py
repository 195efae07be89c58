"""Features of MJCF, and mistakes, each written into the file of an arm whose servos hold it."""

from __future__ import annotations

import re
from pathlib import Path

from tests.support import arm
from tests.support.features import Edit, make_option_edit, make_replacement, make_section_edit

KEYFRAME = '<keyframe><key name="home" qpos="0 -0.75 1.3 0.1" ctrl="1.3 0.1 -0.75 0"/></keyframe>'
"""Keyframe at the middle of the joint ranges, with the same commands."""

SERVO = '<position joint="shoulder" kp="800.0" kv="20"/>'
"""Servo of the shoulder in the MJCF."""


def joints(attributes: str) -> Edit:
    return make_replacement('damping="2"', attributes)


def servos(attributes: str) -> Edit:
    return make_replacement('kv="20"', f'kv="20" {attributes}')


def shoulder(actuator: str) -> Edit:
    return make_replacement(SERVO, actuator, 1)


def law(gain: float = 800, bias: float = 0, damping: float = -20, words: str = "") -> Edit:
    return shoulder(
        f'<general joint="shoulder" gainprm="{gain}{" 200 0" if words else ""}" {words} '
        f'biastype="affine" biasprm="{bias} -800 {damping}"/>'
    )


def replace_ctrl(ctrl: str) -> Edit:
    return make_replacement('ctrl="1.3 0.1 -0.75 0"', f'ctrl="{ctrl}"')


def _inertials_of_geoms(text: str) -> str:
    """Replace the inertials of the MJCF by spheres."""
    return re.sub(r"<inertial[^>]*/>", '<geom size="0.05"/>', text)


def _stiffen_servos(text: str) -> str:
    """Multiply the stiffness of the servos by 1000."""
    return re.sub(r'kp="(\d+)\.0"', r'kp="\g<1>000"', text)


def _use_motors(text: str) -> str:
    """Replace the servos by torque motors."""
    return re.sub(r'<position (joint="\w+") kp="[\d.]+" kv="20"/>', r"<motor \1/>", text)


FEATURES: dict[str, Edit] = {
    "as it is": lambda text: text,
    # ---- joints
    "joint damping 0": joints(""),
    "joint damping -30": joints('damping="-30"'),
    "joint frictionloss": joints('damping="2" frictionloss="1"'),
    "joint stiffness": joints('damping="2" stiffness="200" springref="1"'),
    "joint stiffness below zero": joints('damping="2" stiffness="-900"'),
    "joint armature": joints('damping="2" armature="1"'),
    "joint actuatorfrcrange": joints('damping="2" actuatorfrcrange="-1 1"'),
    "joint actuatorgravcomp": joints('damping="2" actuatorgravcomp="true"'),
    "joint ref": joints('damping="2" ref="0.2"'),
    "joint range elsewhere": make_replacement('range="-2.0 0.5"', 'range="-2.0 -1.2"'),
    # ---- bodies
    "gravcomp": make_replacement('<body name="upper"', '<body name="upper" gravcomp="1"'),
    "a heavier link": make_replacement('mass="2.0"', 'mass="6.0"'),
    "inertials of geoms": _inertials_of_geoms,
    "a free base": make_replacement(
        '<body name="base">',
        '<body name="base"><freejoint/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>',
    ),
    "a loose joint": make_replacement(
        '<site name="tip"',
        '<body name="flap"><joint axis="0 1 0"/><inertial pos="0.1 0 0" mass="0.3" '
        'diaginertia="1e-3 1e-3 1e-3"/></body><site name="tip"',
    ),
    "a ball beside it": make_replacement(
        '<body name="base">',
        '<body name="ball" pos="3 0 2"><freejoint/><geom size="0.1"/></body><body name="base">',
    ),
    # ---- equality, tendons
    "a weld of the hand": make_section_edit('<equality><weld body1="hand"/></equality>'),
    "joints coupled": make_section_edit(
        '<equality><joint joint1="shoulder" joint2="elbow" polycoef="-2.05 1 0 0 0"/></equality>'
    ),
    "a tendon's spring": make_section_edit(
        '<tendon><fixed stiffness="300" springlength="0"><joint joint="shoulder" coef="1"/>'
        "</fixed></tendon>"
    ),
    # ---- options
    "a time step of 20 ms": make_replacement('timestep="0.002"', 'timestep="0.02"'),
    "RK4": make_replacement('integrator="implicitfast"', 'integrator="RK4"'),
    "gravity upwards": make_replacement('timestep="0.002"', 'timestep="0.002" gravity="0 0 9.81"'),
    "gravity sideways": make_replacement('timestep="0.002"', 'timestep="0.002" gravity="9.81 0 0"'),
    "no gravity": make_option_edit("", '<flag gravity="disable"/>'),
    "no actuation": make_option_edit("", '<flag actuation="disable"/>'),
    "water": make_option_edit('density="1000" viscosity="1"'),
    "wind": make_option_edit('density="1.2" wind="50 0 0"'),
    "servos in a disabled group": lambda text: make_option_edit('actuatorgroupdisable="1"')(
        servos('group="1"')(text)
    ),
    # ---- servos
    "gear 2": servos('gear="2"'),
    "gear -1 at a joint": shoulder('<position joint="shoulder" kp="800" kv="20" gear="-1"/>'),
    "kp -800 at a joint": shoulder('<position joint="shoulder" kp="-800" kv="20"/>'),
    "kp 0 at a joint": shoulder('<position joint="shoulder" kp="0" kv="20"/>'),
    "kp a thousandfold": _stiffen_servos,
    "damping of the other sign": law(damping=20),
    "a bias of 20": law(bias=20),
    "a bias of 500": law(bias=500),
    "a gain of half": law(gain=400),
    "an affine gain": law(words='gaintype="affine"'),
    "one motor": shoulder('<motor joint="shoulder"/>'),
    "one velocity servo": shoulder('<velocity joint="shoulder" kv="20"/>'),
    "one damper": shoulder('<damper joint="shoulder" kv="20" ctrlrange="0 1"/>'),
    "one intvelocity": shoulder('<intvelocity joint="shoulder" kp="800" actrange="-3 3"/>'),
    "one dcmotor": shoulder('<dcmotor joint="shoulder" motorconst="0.05" resistance="1"/>'),
    "a motor besides": make_replacement("</actuator>", '<motor joint="shoulder"/></actuator>'),
    "two servos at a joint": make_replacement("</actuator>", f"{SERVO}</actuator>"),
    "motors": _use_motors,
    "forcerange 5": servos('forcerange="-5 5"'),
    "forcerange of one side": servos('forcerange="0 30"'),
    "ctrlrange": servos('ctrlrange="0.5 0.9"'),
    "timeconst 10": servos('timeconst="10"'),
    "timeconst 1e5": servos('timeconst="1e5"'),
    "delay": servos('delay="0.1" nsample="60"'),
    "a thruster": lambda text: replace_ctrl("1.3 0.1 -0.75 0 0")(
        make_replacement(
            "</actuator>",
            '<general site="tip" gear="0 0 1 0 0 0" biastype="affine" gainprm="0" '
            'biasprm="40 0 0"/></actuator>',
        )(text)
    ),
    # ---- keyframes
    "no keyframe": make_replacement(KEYFRAME, ""),
    "a keyframe without ctrl": make_replacement(' ctrl="1.3 0.1 -0.75 0"', ""),
    "a keyframe's ctrl of zeros": replace_ctrl("0 0 0 0"),
    "a keyframe's ctrl of another pose": replace_ctrl("1.3 0.1 -1.75 0"),
    "a keyframe's ctrl 1e9": replace_ctrl("1.3 0.1 1e9 0"),
}
"""{description: edit of the arm's MJCF}."""


def files(folder: Path, edit: Edit) -> tuple[Path, Path]:
    """Write an arm that its servos hold in its keyframe, with an edit of it."""
    urdf, mjcf = folder / "arm.urdf", folder / "arm.xml"
    urdf.write_text(arm.URDF)
    mjcf.write_text(edit(arm.MJCF.replace("</mujoco>", f"{KEYFRAME}</mujoco>")))
    return urdf, mjcf
