"""Features of MJCF, and mistakes, each written into the file of a quadruped that stands."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from tests.support import legged

LEGS = ("FL", "FR", "RL", "RR")
"""Names of the legs."""

CTRL = " ".join(["0 0.6 -1.2"] * 4)
"""Commands of the keyframe."""

Edit = Callable[[str], str]


def make_replacement(old: str, new: str, count: int = -1) -> Edit:
    """Return an edit that replaces a text, which must be present."""

    def edit(text: str) -> str:
        assert old in text, old
        return text.replace(old, new, count)

    return edit


def make_option_edit(attributes: str, inside: str = "") -> Edit:
    """Return an edit that adds an ``<option>``."""
    return make_replacement("<worldbody>", f"<option {attributes}>{inside}</option><worldbody>", 1)


def make_section_edit(text: str) -> Edit:
    """Return an edit that appends a section to the MJCF."""
    return make_replacement("</mujoco>", f"{text}</mujoco>", 1)


def add_to_servos(attributes: str) -> Edit:
    """Return an edit that adds attributes to all servos."""
    return make_replacement('kp="150" kv="1"', f'kp="150" kv="1" {attributes}')


def replace_servo_attributes(attributes: str) -> Edit:
    """Return an edit that replaces the attributes of all servos."""
    return make_replacement('kp="150" kv="1"', attributes)


def replace_one_servo(attributes: str) -> Edit:
    """Return an edit that replaces the attributes of the servo at a knee."""
    return make_replacement('joint="FL_knee" kp="150" kv="1"', f'joint="FL_knee" {attributes}', 1)


def add_visual_shapes(attributes: str) -> Edit:
    """Return an edit that adds a visual shape to each link, and attributes to ``<compiler>``."""
    seen = '<geom type="sphere" size="0.03" contype="0" conaffinity="0" group="2"/>'

    def edit(text: str) -> str:
        text = text.replace("<compiler ", f"<compiler {attributes} ", 1)
        return re.sub(r"(<inertial [^>]*/>)", rf"\1{seen}", text)

    return edit


def add_to_knees(attributes: str) -> Edit:
    """Return an edit that adds attributes to the knee joints."""
    return make_replacement('_knee" axis', f'_knee" {attributes} axis')


def add_to_feet(attributes: str) -> Edit:
    """Return an edit that adds attributes to the feet."""
    return make_replacement('<geom name="foot"', f'<geom {attributes} name="foot"')


def replace_floor(attributes: str) -> Edit:
    """Return an edit that replaces the attributes of the floor."""
    plane = '<geom name="floor" type="plane" size="0 0 1"/>'
    return make_replacement(plane, f'<geom name="floor" type="plane" {attributes}/>', 1)


def replace_commands(leg: str) -> Edit:
    """Return an edit that sets the commands of each leg in the keyframe."""
    return make_replacement(f'ctrl="{CTRL}"', f'ctrl="{" ".join([leg] * 4)}"')


FEATURES: dict[str, Edit] = {
    "as it is": lambda text: text,
    # ---- joints
    "joint damping": add_to_knees('damping="2"'),
    "joint frictionloss": add_to_knees('frictionloss="0.3"'),
    "joint stiffness": add_to_knees('stiffness="20" springref="-1.2"'),
    "joint springdamper": add_to_knees('springdamper="0.5 1"'),
    "joint armature": add_to_knees('armature="0.02"'),
    "joint margin": add_to_knees('margin="0.2"'),
    "joint range elsewhere": make_replacement('range="-2.6 -0.4"', 'range="-1.1 -0.4"'),
    "joint actuatorfrcrange": add_to_knees('actuatorfrcrange="-1 1"'),
    "joint actuatorgravcomp": add_to_knees('actuatorgravcomp="true"'),
    "joint ref": add_to_knees('ref="0.1"'),
    # ---- bodies
    "gravcomp of the trunk": make_replacement(
        '<body name="trunk"', '<body name="trunk" gravcomp="0.3"'
    ),
    "gravcomp of the calves": make_replacement('_calf" pos', '_calf" gravcomp="1" pos'),
    "a mocap body": make_replacement("<worldbody>", '<worldbody><body name="m" mocap="true"/>'),
    "welded to a mocap body": lambda text: make_section_edit(
        '<equality><weld body1="trunk" body2="m"/></equality>'
    )(
        make_replacement("<worldbody>", '<worldbody><body name="m" mocap="true" pos="0 0 0.35"/>')(
            text
        )
    ),
    "welded to the world": make_section_edit('<equality><weld body1="trunk"/></equality>'),
    "connected to the world": make_section_edit(
        '<equality><connect body1="trunk" anchor="0 0 0"/></equality>'
    ),
    "an extra limb": make_replacement(
        '<geom type="box" size="0.2 0.1 0.04"/>',
        '<geom type="box" size="0.2 0.1 0.04"/><body pos="0.1 0 0.1"><joint axis="0 1 0"/>'
        '<inertial pos="0.1 0 0" mass="0.5" diaginertia="1e-3 1e-3 1e-3"/></body>',
    ),
    "a heavier trunk": make_replacement('mass="4"', 'mass="6"'),
    "a ball beside it": make_replacement(
        "<worldbody>",
        '<worldbody><body name="ball" pos="2 0 0.2"><freejoint/><geom size="0.1"/></body>',
    ),
    "shapes that are only seen": add_visual_shapes(""),
    "inertiafromgeom": add_visual_shapes('inertiafromgeom="true"'),
    "discardvisual": add_visual_shapes('discardvisual="true"'),
    "inertiafromgeom and discardvisual": add_visual_shapes(
        'inertiafromgeom="true" discardvisual="true"'
    ),
    # ---- equality, tendons
    "knees coupled": make_section_edit(
        '<equality><joint joint1="FL_knee" joint2="FR_knee"/></equality>'
    ),
    "a tendon's spring": make_section_edit(
        '<tendon><fixed stiffness="10" springlength="0"><joint joint="FL_knee" coef="1"/>'
        "</fixed></tendon>"
    ),
    "a tendon's limit": make_section_edit(
        '<tendon><fixed range="-1.1 0" limited="true"><joint joint="FL_knee" coef="1"/>'
        "</fixed></tendon>"
    ),
    # ---- contacts
    "feet's friction 0.3": add_to_feet('friction="0.3"'),
    "feet's condim 1": add_to_feet('condim="1" priority="1"'),
    "feet's condim 6": add_to_feet('condim="6" friction="1 0.01 0.01"'),
    "feet's solref": add_to_feet('solref="0.05 1"'),
    "feet's solref direct": add_to_feet('solref="-5000 -100"'),
    "feet's solimp": add_to_feet('solimp="0.5 0.9 0.01"'),
    "feet's margin": add_to_feet('margin="0.01"'),
    "feet's gap": add_to_feet('margin="0.01" gap="0.01"'),
    "feet's priority": add_to_feet('priority="2"'),
    "feet's solmix": add_to_feet('solmix="10" solref="0.08 1"'),
    "feet that do not touch": add_to_feet('contype="0" conaffinity="0"'),
    "feet of another bit": add_to_feet('contype="2" conaffinity="2"'),
    "an exclude of a foot": lambda text: make_section_edit(
        '<contact><exclude body1="floor_body" body2="FL_calf"/></contact>'
    )(move_floor_to_body(text)),
    "a pair of friction 0.1": make_section_edit(
        '<contact><pair geom1="floor" geom2="FL_foot" friction="0.1 0.1 0.01 0.001 0.001"/>'
        "</contact>"
    ),
    "a pair's anisotropic friction": make_section_edit(
        "<contact>"
        + "".join(
            f'<pair geom1="floor" geom2="{leg}_foot" friction="1 0.001 0.01 0.001 0.001"/>'
            for leg in LEGS
        )
        + "</contact>"
    ),
    "a tilted floor": replace_floor('size="0 0 1" euler="0 0.05 0"'),
    "a higher floor": replace_floor('size="0 0 1" pos="0 0 0.05"'),
    "a soft floor": replace_floor('size="0 0 1" solref="0.1 1" priority="3"'),
    # ---- options
    "implicitfast": make_option_edit('integrator="implicitfast"'),
    "RK4": make_option_edit('integrator="RK4"'),
    "elliptic cone": make_option_edit('cone="elliptic"'),
    "impratio 50, elliptic": make_option_edit('cone="elliptic" impratio="50"'),
    "impratio 50, pyramidal": make_option_edit('impratio="50"'),
    "noslip": make_option_edit('noslip_iterations="10"'),
    "PGS": make_option_edit('solver="PGS"'),
    "CG": make_option_edit('solver="CG"'),
    "one iteration": make_option_edit('solver="PGS" iterations="1"'),
    "a time step of 5 ms": make_option_edit('timestep="0.005"'),
    "a time step of 20 ms": make_option_edit('timestep="0.02"'),
    "the Moon": make_option_edit('gravity="0 0 -1.62"'),
    "gravity sideways": make_option_edit('gravity="1 0 -9.81"'),
    "wind": make_option_edit('wind="5 0 0" density="1.2" viscosity="2e-5"'),
    "water": make_option_edit('density="1000" viscosity="1e-3"'),
    "contacts overridden": make_option_edit(
        'o_solref="0.2 1" o_margin="0.005"', '<flag override="enable"/>'
    ),
    "no contacts": make_option_edit("", '<flag contact="disable"/>'),
    "no gravity": make_option_edit("", '<flag gravity="disable"/>'),
    "no actuation": make_option_edit("", '<flag actuation="disable"/>'),
    "no limits": make_option_edit("", '<flag limit="disable"/>'),
    "no springs": make_option_edit("", '<flag spring="disable"/>'),
    "no clamping of ctrl": make_option_edit("", '<flag clampctrl="disable"/>'),
    "servos in a disabled group": lambda text: make_option_edit('actuatorgroupdisable="1"')(
        add_to_servos('group="1"')(text)
    ),
    # ---- servos
    "kv 0": replace_servo_attributes('kp="150"'),
    "dampratio": replace_servo_attributes('kp="150" dampratio="1"'),
    "timeconst 20 ms": add_to_servos('timeconst="0.02"'),
    "timeconst 1e5": add_to_servos('timeconst="1e5"'),
    "gear 2": add_to_servos('gear="2"'),
    "gear -1": add_to_servos('gear="-1"'),
    "gear -1 at a knee": replace_one_servo('kp="150" kv="1" gear="-1"'),
    "forcerange 2": add_to_servos('forcerange="-2 2"'),
    "forcerange of one side": add_to_servos('forcerange="0 30"'),
    "forcerange 5 to 25": add_to_servos('forcerange="5 25"'),
    "ctrlrange narrow": add_to_servos('ctrlrange="-0.5 0.5"'),
    "ctrlrange inverted": add_to_servos('ctrlrange="0.8 -0.8"'),
    "kp -150": replace_servo_attributes('kp="-150" kv="5"'),
    "kp -150 at a knee": replace_one_servo('kp="-150" kv="5"'),
    "kp 0 at a knee": replace_one_servo('kp="0"'),
    "kp 0": replace_servo_attributes('kp="0"'),
    "kp 15": replace_servo_attributes('kp="15" kv="0.5"'),
    "kp 1500": replace_servo_attributes('kp="1500" kv="5"'),
    "kp 150000": replace_servo_attributes('kp="150000" kv="5"'),
    "two servos at a knee": make_replacement(
        "</actuator>", '<position joint="FL_knee" kp="150" kv="1"/></actuator>'
    ),
    "a motor besides": make_replacement("</actuator>", '<motor joint="FL_knee"/></actuator>'),
    "a damper besides": make_replacement(
        "</actuator>", '<damper joint="FL_knee" kv="2" ctrlrange="0 1"/></actuator>'
    ),
    "intvelocity": make_replacement(
        '<position joint="FL_knee" kp="150" kv="1"/>',
        '<intvelocity joint="FL_knee" kp="150" actrange="-3 3"/>',
    ),
    "motors": lambda text: text.replace("<position ", "<motor ").replace(' kp="150" kv="1"', ""),
    "adhesion": make_replacement(
        "</actuator>", '<adhesion body="FL_calf" gain="20" ctrlrange="0 1"/></actuator>'
    ),
    "a thruster": make_replacement(
        "</actuator>", '<motor site="nose" gear="0 0 20 0 0 0" ctrlrange="0 1"/></actuator>'
    ),
    # ---- keyframes
    "a keyframe without ctrl": make_replacement(f' ctrl="{CTRL}"', ""),
    "a keyframe's ctrl of zeros": replace_commands("0 0 0"),
    "a keyframe's ctrl of another pose": replace_commands("0 1.4 -2.4"),
    "a keyframe's ctrl 1e9": replace_commands("0 1e9 0"),
    "no keyframe": lambda text: text[: text.index("<keyframe>")] + "</mujoco>",
    # ---- numbers that nothing can have
    "damping -2": add_to_knees('damping="-2"'),
    "frictionloss -1": add_to_knees('frictionloss="-1"'),
    "armature -0.01": add_to_knees('armature="-0.01"'),
    "stiffness -20": add_to_knees('stiffness="-20" springref="-1.2"'),
    "range inverted": make_replacement('range="-2.6 -0.4"', 'range="-0.4 -2.6"'),
    "timestep 10": make_option_edit('timestep="10"'),
    "timestep 0": make_option_edit('timestep="0"'),
    "timestep -0.002": make_option_edit('timestep="-0.002"'),
    "timestep 1e-9": make_option_edit('timestep="1e-9"'),
    "impratio -1": make_option_edit('impratio="-1"'),
    "iterations 0": make_option_edit('iterations="0"'),
    "tolerance 1e9": make_option_edit('tolerance="1e9"'),
    "gravity upwards": make_option_edit('gravity="0 0 9.81"'),
    "density -1": make_option_edit('density="-1"'),
    "friction -1": add_to_feet('friction="-1"'),
    "a foot of negative size": make_replacement('size="0.02"', 'size="-0.02"'),
    "mass -4": make_replacement('mass="4"', 'mass="-4"'),
}
"""{name: edit of the MJCF's text}."""


def move_floor_to_body(text: str) -> str:
    """Move the floor of an MJCF from the world into a body."""
    plane = '<geom name="floor" type="plane" size="0 0 1"/>'
    return text.replace(plane, f'<body name="floor_body">{plane}</body>', 1)


def write_files(folder: Path, edit: Edit) -> tuple[Path, Path]:
    """Write a quadruped that stands by the commands of its keyframe, with an edit of its MJCF."""
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
