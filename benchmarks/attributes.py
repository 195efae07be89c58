"""Set each attribute of MJCF and URDF to extreme values: `python benchmarks/attributes.py`.

In the files of a quadruped that stands, a single attribute of an element gets another value. All
attributes of MuJoCo's schema and of URDF are tested. The table contains a letter for each value, in
the order zero, least (1e-9), greatest (1e9), wrong sign (for a range: inverted), not a number, and
a word, then other keywords:

* `r`: no engine reads the file and `audit` reports ERRORS, or our reader refuses the file;
* `f`: without this package, MuJoCo lets the robot fall from its keyframe, and neither `audit`
  reports OK nor `stand` HOLDS;
* `m`: the robot stands, but its base is displaced by more than 0.1 % of its height;
* `e`: the robot stands as before, or the file is read, but `audit` reports ERRORS;
* `d`: an engine reads the URDF, and `crosscheck` reports DISAGREE;
* `.`: base position, or mass matrix and limits, are unchanged within 1e-3;
* `!`: a report is wrong; the program then ends with status 1.

Sensors, `visual`, `statistic`, `custom`, cameras, lights, textures, materials and sites cannot move
a robot: no force depends on them. Plugins are not tested.
"""

from __future__ import annotations

import sys
import tempfile
import time
import warnings
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import click
import mujoco
import numpy as np
from lxml import etree

from pupper_analysis.models.mjcf import silence_mujoco

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import guarded
from one_slip import add_audit, is_wrong, judge_mjcf, judge_urdf, read_base
from tables import write_csv

from tests.support.legged import Pair

CLASSES = ("zero", "least", "greatest", "sign", "nan", "word")
"""Classes of values, in the order of the letters."""

NUMBERS = {"zero": "0", "least": "1e-9", "greatest": "1e9", "sign": "-1", "nan": "nan"}
"""{class: text of the number}."""

BOOLEANS = ("true", "false", "auto")
"""Keywords of attributes that are true, false or automatic."""

KEYWORDS: dict[str, tuple[str, ...]] = {
    "integrator": ("Euler", "RK4", "implicit"),
    "solver": ("PGS", "CG"),
    "cone": ("elliptic",),
    "jacobian": ("sparse", "dense"),
    "angle": ("degree",),
    "coordinate": ("local", "global"),
    "inertiafromgeom": BOOLEANS,
    "type": ("hinge", "slide", "ball", "sphere", "box", "capsule", "cylinder", "ellipsoid", "mesh"),
    "dyntype": ("none", "integrator", "filter", "filterexact", "muscle"),
    "gaintype": ("fixed", "affine", "muscle"),
    "biastype": ("none", "affine", "muscle"),
    "fluidshape": ("ellipsoid",),
    "mode": ("fixed", "track", "trackcom"),
    "limited": BOOLEANS,
    **{f"{what}limited": BOOLEANS for what in ("ctrl", "force", "act", "actuatorfrc")},
    **dict.fromkeys(
        (
            "actuatorgravcomp", "mocap", "active", "shellinertia", "autolimits", "balanceinertia",
            "fusestatic", "discardvisual", "usethread", "strippath", "fitaabb", "alignfree",
            "saveinertial", "jointinparent", "directional", "castshadow", "align",
        ),
        ("true", "false"),
    ),
    "sleep": ("never", "allowed", "init"),
    "eulerseq": ("zyx", "XYZ"),
    "simple": ("true", "false"),
}  # fmt: skip
"""{attribute of an MJCF: keywords that are also tested}."""

IGNORED_ATTRIBUTES = {"name", "class", "user"}
"""Attributes that have no effect on the dynamics."""

SECTIONS = (
    '<size/>', "<statistic/>",
    "<visual><global/><quality/><headlight/><map/><scale/><rgba/></visual>",
    '<asset><mesh name="tile" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/>'
    '<hfield name="hills" nrow="2" ncol="2" size="1 1 1 1"/>'
    '<texture name="check" type="2d" builtin="checker" width="8" height="8"/>'
    '<material name="grey" texture="check"/></asset>',
    '<custom><numeric name="n" data="1"/><text name="t" data="x"/>'
    '<tuple name="u"><element objtype="body" objname="trunk"/></tuple></custom>',
    '<contact><pair geom1="floor" geom2="FL_foot"/>'
    '<exclude body1="trunk" body2="FL_calf"/></contact>',
    '<tendon><spatial name="rope" range="0 9"><site site="eye"/><site site="nose"/></spatial>'
    '<fixed name="sum" range="-9 9"><joint joint="FL_knee" coef="1"/></fixed></tendon>',
    '<equality><connect body1="trunk" body2="FL_hip" anchor="0 0 0" active="false"/>'
    '<weld body1="FL_calf" body2="FR_calf" active="false"/>'
    '<joint joint1="FL_knee" joint2="FR_knee" active="false"/>'
    '<tendon tendon1="sum" active="false"/></equality>',
)  # fmt: skip
"""Sections that are added to the MJCF, so that its attributes can be tested; none changes the
motion."""

ACTUATORS = {
    "general": "", "motor": "", "velocity": 'kv="0.1"', "intvelocity": 'kp="1" actrange="-1 1"',
    "damper": 'kv="0.1" ctrlrange="0 1"', "cylinder": "", "muscle": 'force="1" lengthrange="0.1 1"',
    "pid": 'kp="1"', "dcmotor": 'motorconst="0.1" resistance="1"', "adhesion": 'ctrlrange="0 1"',
    "orientation": 'kp="1e-6"',
}  # fmt: skip
"""{actuator element: attributes that MuJoCo requires, or that keep its force at zero}."""

NUM_INPUTS = {"pid": 2, "orientation": 3}
"""{actuator element: number of controls}, of elements with several controls."""

TRANSMISSIONS = {"adhesion": 'body="FL_calf"', "orientation": 'site="nose" refsite="eye"'}
"""{actuator element: transmission attributes}, of elements that do not act on a joint."""

CLASS_DEFAULTS = ("damper", "adhesion", "dcmotor", "orientation")
"""Actuator elements whose defaults are set in a default class of their own, because as global
defaults they would change the servos."""

SENSORS = {
    'site="nose"': "touch accelerometer velocimeter gyro force torque magnetometer rangefinder",
    'joint="FL_knee"': "jointpos jointvel jointactuatorfrc jointlimitpos jointlimitvel "
    "jointlimitfrc",
    'tendon="sum"': "tendonpos tendonvel tendonactuatorfrc tendonlimitpos tendonlimitvel",
    'actuator="FL_knee"': "actuatorpos actuatorvel actuatorfrc",
    'objtype="body" objname="trunk"': "framepos framequat framexaxis framelinvel frameangvel "
    "framelinacc frameangacc",
    'body="trunk"': "subtreecom subtreelinvel subtreeangmom",
    'geom1="floor" geom2="FL_foot"': "distance normal fromto contact",
    "": "e_potential e_kinetic clock",
    'dim="1"': "user",
}
"""{attributes: sensor elements with these attributes}."""

URDF_TREE = {
    "robot": ("version",),
    "link/inertial/origin": ("xyz", "rpy"),
    "link/inertial/mass": ("value",),
    "link/inertial/inertia": ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"),
    "link/visual/origin": ("xyz", "rpy"),
    "link/visual/geometry/box": ("size",),
    "link/visual/material": ("name",),
    "link/visual/material/color": ("rgba",),
    "link/collision/origin": ("xyz", "rpy"),
    "link/collision/geometry/cylinder": ("radius", "length"),
    "link/collision/geometry/sphere": ("radius",),
    "link/collision/geometry/capsule": ("radius", "length"),
    "link/collision/geometry/mesh": ("filename", "scale"),
    "joint": ("type",),
    "joint/origin": ("xyz", "rpy"),
    "joint/parent": ("link",),
    "joint/child": ("link",),
    "joint/axis": ("xyz",),
    "joint/calibration": ("rising", "falling"),
    "joint/dynamics": ("damping", "friction"),
    "joint/limit": ("lower", "upper", "effort", "velocity"),
    "joint/mimic": ("joint", "multiplier", "offset"),
    "joint/safety_controller": ("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity"),
}
"""{path of a URDF element: attributes}."""

URDF_KEYWORDS = {"type": ("continuous", "prismatic", "fixed", "floating", "planar", "screw")}
"""{attribute of a URDF: keywords that are also tested}."""

MIN_REPORTED_LOSS = 1e-3
"""Relative change of the base height above which a robot counts as displaced. Chosen, not tuned."""


def read_schema() -> dict[str, tuple[str, ...]]:
    """Return {path of an element: attributes} of MuJoCo's schema."""
    found: dict[str, list[str]] = {}
    above: list[str] = []
    path = ""
    for line in mujoco.mj_printSchema(False, False).splitlines():
        head, words = line[:27], [word for word in line[27:].split() if word.isidentifier()]
        if head.strip():
            depth = (len(head) - len(head.lstrip())) // 3
            above[depth:] = [head.split()[0].replace("(world)", "")]
            path = "/".join(above[1:])
        found.setdefault(path, []).extend(words)
    return {path: tuple(names) for path, names in found.items() if path and names}


def add_elements(mjcf: bytes) -> etree._Element:
    """Return the quadruped's MJCF with an element of most kinds; none changes the motion."""
    root = etree.fromstring(mjcf)
    for number, foot in enumerate(g for g in root.iter("geom") if g.get("type") == "sphere"):
        foot.set("name", ("FL", "FR", "RL", "RR")[number] + "_foot")
    trunk = next(root.iter("body"))
    for text in (
        '<site name="nose" pos="0.2 0 0"/>', '<camera name="cam"/>', '<light name="lamp"/>',
    ):  # fmt: skip
        trunk.append(etree.fromstring(text))
    root.find("worldbody").append(etree.fromstring('<site name="eye" pos="1 0 1"/>'))
    etree.SubElement(root.find("option"), "flag")
    etree.SubElement(root.find("compiler"), "lengthrange")
    for text in SECTIONS:
        root.append(etree.fromstring(text))
    sensors = etree.SubElement(root, "sensor")
    for words, tags in SENSORS.items():
        for tag in tags.split():
            sensors.append(etree.fromstring(f"<{tag} {words}/>"))
    return root


@cache
def add_urdf_elements(urdf: bytes) -> bytes:
    """Return the quadruped's URDF with optional elements, of which none changes the dynamics."""
    root = etree.fromstring(urdf)
    for joint in root.findall("joint"):
        for tag, text in (
            ("dynamics", '<dynamics damping="0" friction="0"/>'),
            ("calibration", '<calibration rising="0"/>'),
            ("safety_controller", '<safety_controller k_velocity="1"/>'),
        ):
            if joint.find(tag) is None:
                joint.append(etree.fromstring(text))
    link = root.find("link")
    for text in (
        '<visual><origin xyz="0 0 0" rpy="0 0 0"/><geometry><box size="0.1 0.1 0.1"/></geometry>'
        '<material name="red"><color rgba="1 0 0 1"/></material></visual>',
        *(
            f'<collision><origin xyz="0 0 0" rpy="0 0 0"/><geometry>{shape}</geometry></collision>'
            for shape in (
                '<cylinder radius="0.03" length="0.1"/>', '<sphere radius="0.03"/>',
                '<capsule radius="0.03" length="0.1"/>', '<mesh filename="tile.obj"/>',
            )
        ),
    ):  # fmt: skip
        link.append(etree.fromstring(text))
    return etree.tostring(root)


MESH_TEXT = "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
"""Mesh of a tetrahedron in OBJ format."""


def find_elements(root: etree._Element, path: str) -> list[etree._Element]:
    """Return the elements at a path of the schema; missing actuators and defaults are created."""
    top, _, rest = path.partition("/")
    if top == "default":
        section = root.find("default")
        if section is None:
            section = etree.Element("default")
            root.insert(0, section)
        if not rest or "/" in rest:
            return []
        if rest in CLASS_DEFAULTS:
            section = etree.SubElement(section, "default", {"class": "other"})
            _add_actuator(root, rest, 'class="other"')
            section.append(etree.fromstring(f"<{rest} {ACTUATORS[rest]}/>"))
            return [section[-1]]
        return [etree.SubElement(section, rest)]
    if top == "body":
        if not rest:
            return list(root.iter("body"))
        if "/" in rest:
            return []
        found = list(root.iter(rest))
        inside = [e for e in found if any(a.tag == "body" for a in e.iterancestors())]
        if rest == "joint":
            return [e for e in inside if str(e.get("name")).endswith("_knee")]
        if rest == "geom":
            return [e for e in inside if str(e.get("name")).endswith("_foot")]
        return inside
    if top == "actuator" and rest in ACTUATORS:
        return [_add_actuator(root, rest, ACTUATORS[rest])]
    return root.findall(path) if path else []


def _add_actuator(root: etree._Element, kind: str, words: str) -> etree._Element:
    """Add an actuator beside the servos, with zero control in the keyframe."""
    acts_on = TRANSMISSIONS.get(kind, 'joint="FL_roll"')
    section, key = root.find("actuator"), root.find("keyframe/key")
    section.append(etree.fromstring(f'<{kind} name="other" {acts_on} {words}/>'))
    key.set("ctrl", key.get("ctrl") + " 0" * NUM_INPUTS.get(kind, 1))
    return section[-1]


def parse_error(root: etree._Element) -> str:
    """Return MuJoCo's message about the elements and attributes of an MJCF; "" if it reads them.

    The model is not compiled.
    """
    try:
        mujoco.MjSpec.from_string(etree.tostring(root).decode())
    except ValueError as error:
        return str(error) or "?"
    return ""


@silence_mujoco()
def compile_error(root: etree._Element) -> str:
    """Return MuJoCo's message about an MJCF; "" if it compiles."""
    try:
        mujoco.MjModel.from_xml_string(etree.tostring(root).decode())
    except (ValueError, RuntimeError) as error:
        return str(error) or "?"
    except mujoco.FatalError as error:
        return str(error)
    return ""


def count_numbers(mjcf: bytes, path: str, name: str) -> int:
    """Return the number of values of an attribute in the file, or the smallest that MuJoCo accepts.

    1 if MuJoCo accepts none of the tried numbers.
    """
    for number in (1, 2, 3, 4, 5, 6, 7, 9, 10):
        root = add_elements(mjcf)
        found = find_elements(root, path)
        if found and found[0].get(name):
            return len(str(found[0].get(name)).split())
        for element in found:
            element.set(name, " ".join(["0.1"] * number))
        said = parse_error(root)
        if not ("enough data" in said or ("attribute" in said.lower() and "data" in said.lower())):
            return number
    return 1


def list_values(name: str, number: int, keywords: tuple[str, ...]) -> Iterator[tuple[str, str]]:
    """Yield (class, text) of the values to test.

    Args:
        name: Attribute.
        number: Number of values of the attribute.
        keywords: Keywords that are also tested.
    """
    for kind, text in NUMBERS.items():
        if "range" in name and number == 2:
            ends = {"zero": "0 0", "least": "-1e-9 1e-9", "greatest": "-1e9 1e9", "sign": "1 -1"}
            yield kind, ends.get(kind, "nan nan")
        else:
            yield kind, " ".join([text] * number)
    yield "word", "much"
    for word in keywords:
        yield word, word


def list_cases(folder: str, only: tuple[str, ...]) -> list[tuple[str, Any]]:
    """Return all cases as (key, (folder, format, element path, attribute, value))."""
    _, mjcf = read_base("quadruped", folder)
    found = []
    for path, names in read_schema().items():
        if only and path not in only:
            continue
        if not find_elements(add_elements(mjcf), path):
            continue
        for name in names:
            if name in IGNORED_ATTRIBUTES:
                continue
            words = ("disable", "enable") if path == "option/flag" else KEYWORDS.get(name, ())
            for kind, text in list_values(name, count_numbers(mjcf, path, name), words):
                found.append((f"{path}@{name}@{kind}", (folder, "mjcf", path, name, text)))
    for path, names in URDF_TREE.items():
        if only and f"urdf/{path}" not in only:
            continue
        for name in names:
            number = 3 if name in ("xyz", "rpy", "size", "scale") else 4 if name == "rgba" else 1
            for kind, text in list_values(name, number, URDF_KEYWORDS.get(name, ())):
                found.append((f"urdf/{path}@{name}@{kind}", (folder, "urdf", path, name, text)))
    return found


@cache
def simulate_unmodified(folder: str, path: str) -> tuple[str, tuple[float, ...]]:
    """Return the MJCF with all elements but without the modified attribute, and its final qpos."""
    _, mjcf = read_base("quadruped", folder)
    root = add_elements(mjcf)
    if path.startswith(("actuator", "default")):
        find_elements(root, path)
    text = etree.tostring(root).decode()
    return text, simulate(text)


@silence_mujoco()
def simulate(text: str) -> tuple[float, ...]:
    """Return qpos 50 time steps after the keyframe; empty if MuJoCo stops with an error."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    try:
        mujoco.mj_step(model, data, 50)
    except mujoco.FatalError:
        return ()
    return tuple(data.qpos.tolist())


def run_case(argument: tuple[str, str, str, str, str]) -> dict[str, Any]:
    """Set an attribute to a value, and return the reports about the file.

    Args:
        argument: (folder, format, element path, attribute, value) of the case.
    """
    folder, kind, path, name, text = argument
    urdf, mjcf = read_base("quadruped", folder)
    began = time.process_time()
    whole = sum(map(ord, path + name + text)) % 7 == 0
    with tempfile.TemporaryDirectory() as top, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        pair = Pair(Path(top) / "robot.urdf", Path(top) / "robot.xml")
        pair.urdf.write_bytes(urdf)
        pair.mjcf.write_bytes(mjcf)
        (Path(top) / "tile.obj").write_text(MESH_TEXT)
        if kind == "urdf":
            root = etree.fromstring(add_urdf_elements(urdf))
            for element in [root] if path == "robot" else root.findall(path)[-1:]:
                element.set(name, text)
            pair.urdf.write_bytes(etree.tostring(root))
            plain = Path(folder) / "rich.urdf"
            if not plain.exists():
                plain.write_bytes(add_urdf_elements(urdf))
                (Path(folder) / "tile.obj").write_text(MESH_TEXT)
            result = judge_urdf(pair, Pair(plain, pair.mjcf), whole=whole)
            if "audit" not in result:
                add_audit(result, pair.urdf)
        else:
            root = add_elements(mjcf)
            for element in find_elements(root, path):
                element.set(name, text)
            pair.mjcf.write_bytes(etree.tostring(root))
            plain_text, state = simulate_unmodified(folder, path)
            plain = Path(folder) / f"{path.replace('/', '_')}.xml"
            if not plain.exists():
                plain.write_text(plain_text)
            same = not compile_error(root) and _equal(
                simulate(etree.tostring(root).decode()), state
            )
            if same and not whole:
                result: dict[str, Any] = {"bad": [], "bare": "stands", "lost": 0.0}
                add_audit(result, pair.mjcf)
            else:
                result = judge_mjcf(pair, Pair(pair.urdf, plain), whole=whole)
                if "audit" not in result:
                    add_audit(result, pair.mjcf)
    return {**result, "value": text, "seconds": round(time.process_time() - began, 3)}


def _equal(one: tuple[float, ...], two: tuple[float, ...]) -> bool:
    """Return True if two states have the same numbers."""
    return len(one) == len(two) and bool(np.array_equal(one, two))


def choose_letter(result: dict[str, Any]) -> str:
    """Return the letter of a result; see the table in the docstring of this module."""
    if is_wrong(result):
        return "!"
    if result["bare"] == "refused" or str(result.get("audit")).startswith("refused"):
        return "r"
    if result["bare"] == "falls":
        return "f"
    if abs(result.get("lost", 0.0)) > MIN_REPORTED_LOSS:
        return "m"
    if result.get("audit") == "ERRORS":
        return "e"
    return "d" if result["bare"] == "taken" and result.get("crosscheck") == "DISAGREE" else "."


def make_table(found: list[tuple[str, dict[str, Any]]]) -> list[tuple[str, str, str]]:
    """Return rows (element, letters, attributes with these letters) of all results."""
    rows: dict[str, dict[str, str]] = {}
    for key, result in found:
        path, name, _ = key.split("@")
        row = rows.setdefault(path, {})
        row[name] = row.get(name, "") + choose_letter(result)
    lines = []
    for path, names in rows.items():
        alike: dict[str, list[str]] = {}
        for name, letters in names.items():
            alike.setdefault(letters, []).append(name)
        lines += [(path, letters, ", ".join(names)) for letters, names in alike.items()]
    return lines


@click.command()
@click.argument("paths", nargs=-1)
@click.option("--again", is_flag=True, help="Run the cases with a wrong report again.")
@click.option("--folder", type=click.Path(path_type=Path), default=Path("build/attributes"))
@click.option("--csv", "to", type=click.Path(path_type=Path), help="Write the table here.")
def main(paths: tuple[str, ...], again: bool, folder: Path, to: Path | None) -> None:
    """Set attributes of all elements, or of the elements at PATHS, to extreme values; resumes a
    stopped run.
    """
    folder.mkdir(parents=True, exist_ok=True)
    asked = list_cases(str(folder), paths)
    click.echo(f"{len(asked)} values of {len({k.rpartition('@')[0] for k, _ in asked})} attributes")
    if again:
        guarded.remove_results(folder / "attributes.jsonl", is_wrong)
    results = guarded.run_cases(run_case, asked, folder / "attributes.jsonl")
    found = [(key, result) for (key, _), result in zip(asked, results, strict=True)]
    lines = make_table(found)
    click.echo("\n".join(" | ".join(line) for line in lines))
    if to is not None:
        write_csv(to, ("element", "outcomes", "attributes"), lines)
    bad = [(key, result) for key, result in found if is_wrong(result)]
    for key, result in bad:
        click.echo(f"WRONG {key} {result}")
    if bad:
        raise SystemExit(f"{len(bad)} of {len(found)}")


if __name__ == "__main__":
    main()
