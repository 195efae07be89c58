"""Each attribute of MJCF and URDF, with values at its ends: `python benchmarks/attributes.py`.

A quadruped that stands by itself gets one attribute of one element another value. Each attribute
that MuJoCo's schema has is looked at, and each of URDF's; element by element, once or in all legs.
The letters say what came of the values zero, least (1e-9), greatest (1e9), of the wrong sign (of a
range: the wrong way round), not a number, and a word, in this order; then of other keywords:

* `r`: no engine takes the file, and `audit` says ERRORS; or our reader refuses it in a sentence;
* `f`: bare MuJoCo makes it fall from its keyframe; `audit` does not say OK, `stand` not HOLDS;
* `m`: it stands, and its base is elsewhere by more than 0.1 % of its height;
* `e`: it stands as before, or the file is taken, and `audit` says ERRORS all the same;
* `d`: a URDF that is taken, and of which `crosscheck` says DISAGREE;
* `.`: the base stays where it is, or mass matrix and limits are the same within 1e-3;
* `!`: something is said that is not so; the program then ends with status 1.

Sensors, `visual`, `statistic`, `custom`, cameras, lights, textures, materials and sites cannot move
a robot: MuJoCo reads them, and no force depends on them. Plugins are not swept: MuJoCo knows none
until one is loaded.
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
from one_slip import audited, base, judge_mjcf, judge_urdf, wrong
from tables import write_csv

from tests.support.legged import Pair

CLASSES = ("zero", "least", "greatest", "sign", "nan", "word")

NUMBERS = {"zero": "0", "least": "1e-9", "greatest": "1e9", "sign": "-1", "nan": "nan"}

BOOLEANS = ("true", "false", "auto")

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

UNSEEN = {"name", "class", "user"}

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

ACTUATORS = {
    "general": "", "motor": "", "velocity": 'kv="0.1"', "intvelocity": 'kp="1" actrange="-1 1"',
    "damper": 'kv="0.1" ctrlrange="0 1"', "cylinder": "", "muscle": 'force="1" lengthrange="0.1 1"',
    "pid": 'kp="1"', "dcmotor": 'motorconst="0.1" resistance="1"', "adhesion": 'ctrlrange="0 1"',
    "orientation": 'kp="1e-6"',
}  # fmt: skip

INPUTS = {"pid": 2, "orientation": 3}
"""Of an actuator, where they are not one."""

ACTS_ON = {"adhesion": 'body="FL_calf"', "orientation": 'site="nose" refsite="eye"'}
"""Where it is no joint."""

OF_A_CLASS = ("damper", "adhesion", "dcmotor", "orientation")
"""Actuators whose numbers, as defaults of all, would be those of the servos: a class has them."""

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
URDF_KEYWORDS = {"type": ("continuous", "prismatic", "fixed", "floating", "planar", "screw")}
MOVED = 1e-3


def schema() -> dict[str, tuple[str, ...]]:
    """Returns the attributes of each element, by its path, from MuJoCo's own schema."""
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


def rich(mjcf: bytes) -> etree._Element:
    """Returns the quadruped's MJCF with an element of most kinds, none of which changes it."""
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
def rich_urdf(urdf: bytes) -> bytes:
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


TILE = "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def placed(root: etree._Element, path: str) -> list[etree._Element]:
    """Returns the elements of a path of the schema, which are made where there are none."""
    top, _, rest = path.partition("/")
    if top == "default":
        section = root.find("default")
        if section is None:
            section = etree.Element("default")
            root.insert(0, section)
        if not rest or "/" in rest:
            return []
        if rest in OF_A_CLASS:
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
    """Adds an actuator beside the servos, which is asked for nothing."""
    acts_on = ACTS_ON.get(kind, 'joint="FL_roll"')
    section, key = root.find("actuator"), root.find("keyframe/key")
    section.append(etree.fromstring(f'<{kind} name="other" {acts_on} {words}/>'))
    key.set("ctrl", key.get("ctrl") + " 0" * INPUTS.get(kind, 1))
    return section[-1]


@silence_mujoco()
def taken(root: etree._Element) -> str:
    """Returns MuJoCo's refusal, "" if it takes it."""
    try:
        mujoco.MjModel.from_xml_string(etree.tostring(root).decode())
    except (ValueError, RuntimeError) as error:
        return str(error) or "?"
    except mujoco.FatalError as error:
        return str(error)
    return ""


def count(mjcf: bytes, path: str, name: str) -> int:
    """Returns how many numbers an attribute takes at least."""
    for number in (1, 2, 3, 4, 5, 6, 7, 9, 10):
        root = rich(mjcf)
        found = placed(root, path)
        if found and found[0].get(name):
            return len(str(found[0].get(name)).split())
        for element in found:
            element.set(name, " ".join(["0.1"] * number))
        said = taken(root)
        if not ("enough data" in said or ("attribute" in said.lower() and "data" in said.lower())):
            return number
    return 1


def values(name: str, number: int, keywords: tuple[str, ...]) -> Iterator[tuple[str, str]]:
    """Yields the values to try: their class, and what is written."""
    for kind, text in NUMBERS.items():
        if "range" in name and number == 2:
            ends = {"zero": "0 0", "least": "-1e-9 1e-9", "greatest": "-1e9 1e9", "sign": "1 -1"}
            yield kind, ends.get(kind, "nan nan")
        else:
            yield kind, " ".join([text] * number)
    yield "word", "much"
    for word in keywords:
        yield word, word


def cases(folder: str, only: tuple[str, ...]) -> list[tuple[str, Any]]:
    """Returns all cases: their key, and element, attribute and value."""
    _, mjcf = base("quadruped", folder)
    found = []
    for path, names in schema().items():
        if only and path not in only:
            continue
        if not placed(rich(mjcf), path):
            continue
        for name in names:
            if name in UNSEEN:
                continue
            words = ("disable", "enable") if path == "option/flag" else KEYWORDS.get(name, ())
            for kind, text in values(name, count(mjcf, path, name), words):
                found.append((f"{path}@{name}@{kind}", (folder, "mjcf", path, name, text)))
    for path, names in URDF_TREE.items():
        if only and f"urdf/{path}" not in only:
            continue
        for name in names:
            number = 3 if name in ("xyz", "rpy", "size", "scale") else 4 if name == "rgba" else 1
            for kind, text in values(name, number, URDF_KEYWORDS.get(name, ())):
                found.append((f"urdf/{path}@{name}@{kind}", (folder, "urdf", path, name, text)))
    return found


@cache
def plain_rich(folder: str, path: str) -> tuple[str, tuple[float, ...]]:
    """Returns the file with all elements, but for the attribute, and how its base moves."""
    _, mjcf = base("quadruped", folder)
    root = rich(mjcf)
    if path.startswith(("actuator", "default")):
        placed(root, path)
    text = etree.tostring(root).decode()
    return text, moved(text)


@silence_mujoco()
def moved(text: str) -> tuple[float, ...]:
    """Returns the state of 0.1 s from the keyframe; none if MuJoCo gives up."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    try:
        mujoco.mj_step(model, data, 50)
    except mujoco.FatalError:
        return ()
    return tuple(data.qpos.tolist())


def case(argument: tuple[str, str, str, str, str]) -> dict[str, Any]:
    """Puts one value into the file, and looks at what is said of it."""
    folder, kind, path, name, text = argument
    urdf, mjcf = base("quadruped", folder)
    began = time.process_time()
    whole = sum(map(ord, path + name + text)) % 7 == 0
    with tempfile.TemporaryDirectory() as top, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        pair = Pair(Path(top) / "robot.urdf", Path(top) / "robot.xml")
        pair.urdf.write_bytes(urdf)
        pair.mjcf.write_bytes(mjcf)
        (Path(top) / "tile.obj").write_text(TILE)
        if kind == "urdf":
            root = etree.fromstring(rich_urdf(urdf))
            for element in [root] if path == "robot" else root.findall(path)[-1:]:
                element.set(name, text)
            pair.urdf.write_bytes(etree.tostring(root))
            plain = Path(folder) / "rich.urdf"
            if not plain.exists():
                plain.write_bytes(rich_urdf(urdf))
                (Path(folder) / "tile.obj").write_text(TILE)
            result = judge_urdf(pair, Pair(plain, pair.mjcf), whole=whole)
            if "audit" not in result:
                audited(result, pair.urdf)
        else:
            root = rich(mjcf)
            for element in placed(root, path):
                element.set(name, text)
            pair.mjcf.write_bytes(etree.tostring(root))
            plain_text, state = plain_rich(folder, path)
            plain = Path(folder) / f"{path.replace('/', '_')}.xml"
            if not plain.exists():
                plain.write_text(plain_text)
            same = not taken(root) and _equal(moved(etree.tostring(root).decode()), state)
            if same and not whole:
                result: dict[str, Any] = {"bad": [], "bare": "stands", "lost": 0.0}
                audited(result, pair.mjcf)
            else:
                result = judge_mjcf(pair, Pair(pair.urdf, plain), whole=whole)
                if "audit" not in result:
                    audited(result, pair.mjcf)
    return {**result, "value": text, "seconds": round(time.process_time() - began, 3)}


def _equal(one: tuple[float, ...], two: tuple[float, ...]) -> bool:
    return len(one) == len(two) and bool(np.array_equal(one, two))


def letter(result: dict[str, Any]) -> str:
    """Returns what came of a value."""
    if wrong(result):
        return "!"
    if result["bare"] == "refused" or str(result.get("audit")).startswith("refused"):
        return "r"
    if result["bare"] == "falls":
        return "f"
    if abs(result.get("lost", 0.0)) > MOVED:
        return "m"
    if result.get("audit") == "ERRORS":
        return "e"
    return "d" if result["bare"] == "taken" and result.get("crosscheck") == "DISAGREE" else "."


def table(found: list[tuple[str, dict[str, Any]]]) -> list[tuple[str, str, str]]:
    """Returns (element, letters, attributes of which they are) for all that was tried."""
    rows: dict[str, dict[str, str]] = {}
    for key, result in found:
        path, name, _ = key.split("@")
        row = rows.setdefault(path, {})
        row[name] = row.get(name, "") + letter(result)
    lines = []
    for path, names in rows.items():
        alike: dict[str, list[str]] = {}
        for name, letters in names.items():
            alike.setdefault(letters, []).append(name)
        lines += [(path, letters, ", ".join(names)) for letters, names in alike.items()]
    return lines


@click.command()
@click.argument("paths", nargs=-1)
@click.option("--again", is_flag=True, help="Run those anew of which something is said wrongly.")
@click.option("--folder", type=click.Path(path_type=Path), default=Path("build/attributes"))
@click.option("--csv", "to", type=click.Path(path_type=Path), help="Write the table here.")
def main(paths: tuple[str, ...], again: bool, folder: Path, to: Path | None) -> None:
    """Puts values into attributes, of all elements or those of the PATHS; resumes."""
    folder.mkdir(parents=True, exist_ok=True)
    asked = cases(str(folder), paths)
    click.echo(f"{len(asked)} values of {len({k.rpartition('@')[0] for k, _ in asked})} attributes")
    if again:
        guarded.forget(folder / "attributes.jsonl", wrong)
    results = guarded.run(case, asked, folder / "attributes.jsonl")
    found = [(key, result) for (key, _), result in zip(asked, results, strict=True)]
    lines = table(found)
    click.echo("\n".join(" | ".join(line) for line in lines))
    if to is not None:
        write_csv(to, ("element", "outcomes", "attributes"), lines)
    bad = [(key, result) for key, result in found if wrong(result)]
    for key, result in bad:
        click.echo(f"WRONG {key} {result}")
    if bad:
        raise SystemExit(f"{len(bad)} of {len(found)}")


if __name__ == "__main__":
    main()
