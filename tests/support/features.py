"""Features of MJCF, and slips, each put into the file of a quadruped that stands."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from tests.support import legged

LEGS = ("FL", "FR", "RL", "RR")
CTRL = " ".join(["0 0.6 -1.2"] * 4)

Edit = Callable[[str], str]


def put(old: str, new: str, count: int = -1) -> Edit:
    def edit(text: str) -> str:
        assert old in text, old
        return text.replace(old, new, count)

    return edit


def option(attributes: str, inside: str = "") -> Edit:
    return put("<worldbody>", f"<option {attributes}>{inside}</option><worldbody>", 1)


def section(text: str) -> Edit:
    return put("</mujoco>", f"{text}</mujoco>", 1)


def of_servos(attributes: str) -> Edit:
    return put('kp="150" kv="1"', f'kp="150" kv="1" {attributes}')


def servos_as(attributes: str) -> Edit:
    return put('kp="150" kv="1"', attributes)


def one_servo(attributes: str) -> Edit:
    return put('joint="FL_knee" kp="150" kv="1"', f'joint="FL_knee" {attributes}', 1)


def shown(attributes: str) -> Edit:
    """Give each link a shape that is only seen, and the compiler an attribute."""
    seen = '<geom type="sphere" size="0.03" contype="0" conaffinity="0" group="2"/>'

    def edit(text: str) -> str:
        text = text.replace("<compiler ", f"<compiler {attributes} ", 1)
        return re.sub(r"(<inertial [^>]*/>)", rf"\1{seen}", text)

    return edit


def knees(attributes: str) -> Edit:
    return put('_knee" axis', f'_knee" {attributes} axis')


def feet(attributes: str) -> Edit:
    return put('<geom name="foot"', f'<geom {attributes} name="foot"')


def floor(attributes: str) -> Edit:
    plane = '<geom name="floor" type="plane" size="0 0 1"/>'
    return put(plane, f'<geom name="floor" type="plane" {attributes}/>', 1)


def commanded(leg: str) -> Edit:
    return put(f'ctrl="{CTRL}"', f'ctrl="{" ".join([leg] * 4)}"')


FEATURES: dict[str, Edit] = {
    "as it is": lambda text: text,
    # ---- joints
    "joint damping": knees('damping="2"'),
    "joint frictionloss": knees('frictionloss="0.3"'),
    "joint stiffness": knees('stiffness="20" springref="-1.2"'),
    "joint springdamper": knees('springdamper="0.5 1"'),
    "joint armature": knees('armature="0.02"'),
    "joint margin": knees('margin="0.2"'),
    "joint range elsewhere": put('range="-2.6 -0.4"', 'range="-1.1 -0.4"'),
    "joint actuatorfrcrange": knees('actuatorfrcrange="-1 1"'),
    "joint actuatorgravcomp": knees('actuatorgravcomp="true"'),
    "joint ref": knees('ref="0.1"'),
    # ---- bodies
    "gravcomp of the trunk": put('<body name="trunk"', '<body name="trunk" gravcomp="0.3"'),
    "gravcomp of the calves": put('_calf" pos', '_calf" gravcomp="1" pos'),
    "a mocap body": put("<worldbody>", '<worldbody><body name="m" mocap="true"/>'),
    "welded to a mocap body": lambda text: section(
        '<equality><weld body1="trunk" body2="m"/></equality>'
    )(put("<worldbody>", '<worldbody><body name="m" mocap="true" pos="0 0 0.35"/>')(text)),
    "welded to the world": section('<equality><weld body1="trunk"/></equality>'),
    "connected to the world": section(
        '<equality><connect body1="trunk" anchor="0 0 0"/></equality>'
    ),
    "an extra limb": put(
        '<geom type="box" size="0.2 0.1 0.04"/>',
        '<geom type="box" size="0.2 0.1 0.04"/><body pos="0.1 0 0.1"><joint axis="0 1 0"/>'
        '<inertial pos="0.1 0 0" mass="0.5" diaginertia="1e-3 1e-3 1e-3"/></body>',
    ),
    "a heavier trunk": put('mass="4"', 'mass="6"'),
    "a ball beside it": put(
        "<worldbody>",
        '<worldbody><body name="ball" pos="2 0 0.2"><freejoint/><geom size="0.1"/></body>',
    ),
    "shapes that are only seen": shown(""),
    "inertiafromgeom": shown('inertiafromgeom="true"'),
    "discardvisual": shown('discardvisual="true"'),
    "inertiafromgeom and discardvisual": shown('inertiafromgeom="true" discardvisual="true"'),
    # ---- equality, tendons
    "knees coupled": section('<equality><joint joint1="FL_knee" joint2="FR_knee"/></equality>'),
    "a tendon's spring": section(
        '<tendon><fixed stiffness="10" springlength="0"><joint joint="FL_knee" coef="1"/>'
        "</fixed></tendon>"
    ),
    "a tendon's limit": section(
        '<tendon><fixed range="-1.1 0" limited="true"><joint joint="FL_knee" coef="1"/>'
        "</fixed></tendon>"
    ),
    # ---- contacts
    "feet's friction 0.3": feet('friction="0.3"'),
    "feet's condim 1": feet('condim="1" priority="1"'),
    "feet's condim 6": feet('condim="6" friction="1 0.01 0.01"'),
    "feet's solref": feet('solref="0.05 1"'),
    "feet's solref direct": feet('solref="-5000 -100"'),
    "feet's solimp": feet('solimp="0.5 0.9 0.01"'),
    "feet's margin": feet('margin="0.01"'),
    "feet's gap": feet('margin="0.01" gap="0.01"'),
    "feet's priority": feet('priority="2"'),
    "feet's solmix": feet('solmix="10" solref="0.08 1"'),
    "feet that do not touch": feet('contype="0" conaffinity="0"'),
    "feet of another bit": feet('contype="2" conaffinity="2"'),
    "an exclude of a foot": lambda text: section(
        '<contact><exclude body1="floor_body" body2="FL_calf"/></contact>'
    )(floor_in_a_body(text)),
    "a pair of friction 0.1": section(
        '<contact><pair geom1="floor" geom2="FL_foot" friction="0.1 0.1 0.01 0.001 0.001"/>'
        "</contact>"
    ),
    "a pair's anisotropic friction": section(
        "<contact>"
        + "".join(
            f'<pair geom1="floor" geom2="{leg}_foot" friction="1 0.001 0.01 0.001 0.001"/>'
            for leg in LEGS
        )
        + "</contact>"
    ),
    "a tilted floor": floor('size="0 0 1" euler="0 0.05 0"'),
    "a higher floor": floor('size="0 0 1" pos="0 0 0.05"'),
    "a soft floor": floor('size="0 0 1" solref="0.1 1" priority="3"'),
    # ---- options
    "implicitfast": option('integrator="implicitfast"'),
    "RK4": option('integrator="RK4"'),
    "elliptic cone": option('cone="elliptic"'),
    "impratio 50, elliptic": option('cone="elliptic" impratio="50"'),
    "impratio 50, pyramidal": option('impratio="50"'),
    "noslip": option('noslip_iterations="10"'),
    "PGS": option('solver="PGS"'),
    "CG": option('solver="CG"'),
    "one iteration": option('solver="PGS" iterations="1"'),
    "a time step of 5 ms": option('timestep="0.005"'),
    "a time step of 20 ms": option('timestep="0.02"'),
    "the Moon": option('gravity="0 0 -1.62"'),
    "gravity sideways": option('gravity="1 0 -9.81"'),
    "wind": option('wind="5 0 0" density="1.2" viscosity="2e-5"'),
    "water": option('density="1000" viscosity="1e-3"'),
    "contacts overridden": option('o_solref="0.2 1" o_margin="0.005"', '<flag override="enable"/>'),
    "no contacts": option("", '<flag contact="disable"/>'),
    "no gravity": option("", '<flag gravity="disable"/>'),
    "no actuation": option("", '<flag actuation="disable"/>'),
    "no limits": option("", '<flag limit="disable"/>'),
    "no springs": option("", '<flag spring="disable"/>'),
    "no clamping of ctrl": option("", '<flag clampctrl="disable"/>'),
    "servos in a disabled group": lambda text: option('actuatorgroupdisable="1"')(
        of_servos('group="1"')(text)
    ),
    # ---- servos
    "kv 0": servos_as('kp="150"'),
    "dampratio": servos_as('kp="150" dampratio="1"'),
    "timeconst 20 ms": of_servos('timeconst="0.02"'),
    "timeconst 1e5": of_servos('timeconst="1e5"'),
    "gear 2": of_servos('gear="2"'),
    "gear -1": of_servos('gear="-1"'),
    "gear -1 at a knee": one_servo('kp="150" kv="1" gear="-1"'),
    "forcerange 2": of_servos('forcerange="-2 2"'),
    "forcerange of one side": of_servos('forcerange="0 30"'),
    "forcerange 5 to 25": of_servos('forcerange="5 25"'),
    "ctrlrange narrow": of_servos('ctrlrange="-0.5 0.5"'),
    "ctrlrange inverted": of_servos('ctrlrange="0.8 -0.8"'),
    "kp -150": servos_as('kp="-150" kv="5"'),
    "kp -150 at a knee": one_servo('kp="-150" kv="5"'),
    "kp 0 at a knee": one_servo('kp="0"'),
    "kp 0": servos_as('kp="0"'),
    "kp 15": servos_as('kp="15" kv="0.5"'),
    "kp 1500": servos_as('kp="1500" kv="5"'),
    "kp 150000": servos_as('kp="150000" kv="5"'),
    "two servos at a knee": put(
        "</actuator>", '<position joint="FL_knee" kp="150" kv="1"/></actuator>'
    ),
    "a motor besides": put("</actuator>", '<motor joint="FL_knee"/></actuator>'),
    "a damper besides": put(
        "</actuator>", '<damper joint="FL_knee" kv="2" ctrlrange="0 1"/></actuator>'
    ),
    "intvelocity": put(
        '<position joint="FL_knee" kp="150" kv="1"/>',
        '<intvelocity joint="FL_knee" kp="150" actrange="-3 3"/>',
    ),
    "motors": lambda text: text.replace("<position ", "<motor ").replace(' kp="150" kv="1"', ""),
    "adhesion": put(
        "</actuator>", '<adhesion body="FL_calf" gain="20" ctrlrange="0 1"/></actuator>'
    ),
    "a thruster": put(
        "</actuator>", '<motor site="nose" gear="0 0 20 0 0 0" ctrlrange="0 1"/></actuator>'
    ),
    # ---- keyframes
    "a keyframe without ctrl": put(f' ctrl="{CTRL}"', ""),
    "a keyframe's ctrl of zeros": commanded("0 0 0"),
    "a keyframe's ctrl of another pose": commanded("0 1.4 -2.4"),
    "a keyframe's ctrl 1e9": commanded("0 1e9 0"),
    "no keyframe": lambda text: text[: text.index("<keyframe>")] + "</mujoco>",
    # ---- numbers that nothing can have
    "damping -2": knees('damping="-2"'),
    "frictionloss -1": knees('frictionloss="-1"'),
    "armature -0.01": knees('armature="-0.01"'),
    "stiffness -20": knees('stiffness="-20" springref="-1.2"'),
    "range inverted": put('range="-2.6 -0.4"', 'range="-0.4 -2.6"'),
    "timestep 10": option('timestep="10"'),
    "timestep 0": option('timestep="0"'),
    "timestep -0.002": option('timestep="-0.002"'),
    "timestep 1e-9": option('timestep="1e-9"'),
    "impratio -1": option('impratio="-1"'),
    "iterations 0": option('iterations="0"'),
    "tolerance 1e9": option('tolerance="1e9"'),
    "gravity upwards": option('gravity="0 0 9.81"'),
    "density -1": option('density="-1"'),
    "friction -1": feet('friction="-1"'),
    "a foot of negative size": put('size="0.02"', 'size="-0.02"'),
    "mass -4": put('mass="4"', 'mass="-4"'),
}


def floor_in_a_body(text: str) -> str:
    plane = '<geom name="floor" type="plane" size="0 0 1"/>'
    return text.replace(plane, f'<body name="floor_body">{plane}</body>', 1)


def files(folder: Path, edit: Edit) -> tuple[Path, Path]:
    """Write a quadruped that stands by itself on its keyframe's commands, with an edit of it."""
    foot = '<geom name="foot" type="sphere" size="0.02" pos="0 0 -0.2"/>'
    pair = legged.quadruped(folder, foot=foot, floor=True, actuators="position")
    text = pair.mjcf.read_text().replace('kv="5"', 'kv="1"')  # stable with Euler, at 2 ms
    text = text.replace('type="plane"', 'name="floor" type="plane"', 1)
    text = text.replace("<freejoint/>", '<freejoint/><site name="nose" pos="0.2 0 0"/>', 1)
    text = text.replace('"/></keyframe>', f'" ctrl="{CTRL}"/></keyframe>', 1)
    changed = edit(text)
    for leg in LEGS:  # four feet of one name become those of four legs
        changed = changed.replace('name="foot"', f'name="{leg}_foot"', 1)
    pair.mjcf.write_text(changed)
    return pair.urdf, pair.mjcf
