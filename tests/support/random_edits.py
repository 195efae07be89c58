"""Random edits of one place in an MJCF: contacts, options, keyframes, contact pairs and structure.

The answer of ``diff`` to each edit is compared with bare MuJoCo: both files are simulated from the
first keyframe, and all steps are compared. A robot without a floor is placed on a plane.
"""

from __future__ import annotations

import copy
import shutil
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from lxml import etree

import pupper_analysis as pa

MAX_HARMLESS_DIFFERENCE = 1e-4
"""Largest harmless difference of a position [m] or angle [rad] between two rollouts."""

TOLERANCE_FACTOR = 1.5
"""Factor around ``MAX_HARMLESS_DIFFERENCE`` within which either answer is accepted, because impacts
amplify small differences. Chosen, not tuned."""

ROLLOUT_DURATION = 2.0
"""Duration of a rollout [s]."""

Element = etree._Element


class Edit(NamedTuple):
    """Kind of an edit, and the edited element if the edit has a single one."""

    what: str
    element: Element | None = None


class Answer(NamedTuple):
    """Effect of an edit by bare MuJoCo and by ``diff``.

    Attributes:
        edit: Kind of the edit, with its seed.
        truth: Largest difference between the two rollouts [m, rad].
        felt: Whether ``diff`` reports that a simulation changes.
        same: Whether ``diff`` reports that the files are the same.
        placed: Whether ``diff`` reports the line of the edit.
    """

    edit: str
    truth: float
    felt: bool
    same: bool
    placed: bool

    @property
    def right(self) -> bool:
        """Whether the answer of ``diff`` is right, by the rollouts of bare MuJoCo.

        ``diff`` must report an edit that changes a rollout, with its line, and no change of the
        simulation otherwise. Both answers are right if ``truth`` is within a factor of
        `TOLERANCE_FACTOR` from `MAX_HARMLESS_DIFFERENCE`.
        """
        if self.truth > MAX_HARMLESS_DIFFERENCE * TOLERANCE_FACTOR:
            return self.felt and self.placed
        return self.truth >= MAX_HARMLESS_DIFFERENCE / TOLERANCE_FACTOR or not self.felt


def _draw_numbers(random: np.random.Generator, *spans: tuple[float, float]) -> str:
    return " ".join(f"{np.exp(random.uniform(*np.log(span))):.4g}" for span in spans)


Value = Callable[[np.random.Generator], str]


def _draw_choice(*choices: str) -> Value:
    """Return a generator of one of several texts."""
    return lambda random: str(random.choice(choices))


def _draw_within(*spans: tuple[float, float]) -> Value:
    """Return a generator of numbers, one per interval, uniform in their logarithm."""
    return lambda random: _draw_numbers(random, *spans)


_GEOM: dict[str, Value] = {
    "friction": _draw_within((0.01, 2.0), (1e-3, 0.1), (1e-4, 0.01)),
    "condim": _draw_choice("1", "3", "4", "6"),
    "solref": _draw_within((0.004, 0.3), (0.3, 2.0)),
    "solimp": lambda random: (
        f"{random.uniform(0.01, 0.9):.3f} 0.95 {random.uniform(1e-3, 0.05):.4f}"
    ),
    "margin": _draw_within((1e-3, 0.03)),
    "gap": _draw_within((1e-4, 5e-3)),
    "contype": _draw_choice("0", "1", "2", "3"),
    "conaffinity": _draw_choice("0", "1", "2", "3"),
    "priority": _draw_choice("1", "2"),
    "solmix": _draw_within((0.01, 10.0)),
    "rgba": _draw_choice("1 0 0 1"),
    "group": _draw_choice("1", "4"),
}
"""{attribute of a geom: generator of a random value}."""

_OPTION: dict[str, Value] = {
    "timestep": _draw_within((5e-4, 8e-3)),
    "integrator": _draw_choice("Euler", "RK4", "implicit", "implicitfast"),
    "cone": _draw_choice("pyramidal", "elliptic"),
    "solver": _draw_choice("PGS", "CG", "Newton"),
    "jacobian": _draw_choice("dense", "sparse"),
    "impratio": _draw_within((0.5, 100.0)),
    "iterations": _draw_choice("1", "2", "5", "50", "100"),
    "tolerance": _draw_within((1e-12, 1e-3)),
    "ls_iterations": _draw_choice("1", "5", "50"),
    "noslip_iterations": _draw_choice("0", "1", "5"),
    "gravity": lambda random: f"0 0 {-random.uniform(1.0, 12.0):.3f}",
    "wind": _draw_choice("1 0 0"),
    "density": _draw_within((0.1, 100.0)),
}
"""{attribute of ``option``: generator of a random value}."""

_FLAG: dict[str, Value] = {
    name: _draw_choice("enable", "disable")
    for name in ("contact", "constraint", "gravity", "frictionloss", "limit", "warmstart",
                 "filterparent", "actuation", "refsafe", "eulerdamp", "multiccd", "energy")
}  # fmt: skip
"""{attribute of ``flag``: generator of a random value}."""


def edit(tree: etree._ElementTree, random: np.random.Generator) -> Edit:
    """Make one random edit of a geom, an option, a keyframe or a contact pair in an MJCF's tree."""
    root = tree.getroot()
    geoms = list(root.iter("geom"))
    keys = [key for key in root.iter("key") if key.get("qpos")]
    kind = str(random.choice(["geom", "geom", "geom", "size", "option", "flag", "key", "pair"]))
    if kind == "key" and keys:
        key = keys[0]
        words = [word for word in ("qpos", "ctrl") if key.get(word)]
        word = str(random.choice(words))
        values = [float(value) for value in str(key.get(word)).split()]
        number = int(random.integers(len(values)))
        values[number] += float(random.choice([-1, 1])) * 10 ** random.uniform(-6.0, -0.7)
        key.set(word, " ".join(map(repr, values)))
        return Edit(f"key {word}", key)
    if kind == "pair":
        named = [geom for geom in geoms if geom.get("name") and not _in_default(geom)]
        bodies = [body.get("name") for body in root.iter("body") if body.get("name")]
        if len(named) > 1 and random.integers(2):
            first, second = random.choice(len(named), 2, replace=False)
            ends = {"geom1": str(named[first].get("name")), "geom2": str(named[second].get("name"))}
            contact = etree.SubElement(root, "contact")
            etree.SubElement(contact, "pair", ends)
        elif len(bodies) > 1:
            first, second = random.choice(bodies, 2, replace=False)
            contact = etree.SubElement(root, "contact")
            etree.SubElement(contact, "exclude", body1=str(first), body2=str(second))
        return Edit("pair or exclude")
    if kind in ("option", "flag"):
        options = list(root.iter("option"))
        option = options[0] if options else etree.SubElement(root, "option")
        table = _OPTION if kind == "option" else _FLAG
        word = str(random.choice(list(table)))
        if kind == "flag":
            found = option.find("flag")
            option = etree.SubElement(option, "flag") if found is None else found
        option.set(word, table[word](random))
        return Edit(f"{kind} {word}")
    geom = geoms[int(random.integers(len(geoms)))]
    if kind == "size" and geom.get("size") and geom.get("type") != "plane":
        sizes = [float(value) * random.uniform(0.5, 2.0) for value in str(geom.get("size")).split()]
        geom.set("size", " ".join(map(repr, sizes)))
        return Edit("geom size", geom)
    word = str(random.choice(list(_GEOM)))
    geom.set(word, _GEOM[word](random))
    return Edit(f"geom {word}", geom)


def edit_structure(
    tree: etree._ElementTree, random: np.random.Generator, folder: Path
) -> tuple[etree._ElementTree, Edit]:
    """Make one random edit of the structure, for example of defaults, compiler or included parts.

    Args:
        tree: MJCF. For an edit of an included, attached or repeated part, this part is added to
            the MJCF.
        random: Random generator.
        folder: Folder of the MJCF, to which parts are written.

    Returns:
        Edited tree; kind of the edit.
    """
    root = tree.getroot()
    kind = str(random.choice([*_STRUCTURE]))
    if kind in ("include", "attach", "replicate"):
        _STRUCTURE[kind](root, random, folder, "part.xml")
        state = random.bit_generator.state
        edited = copy.deepcopy(tree)
        random.bit_generator.state = state
        what = _STRUCTURE[kind](edited.getroot(), random, folder, "edited_part.xml")
    else:
        edited = copy.deepcopy(tree)
        what = _STRUCTURE[kind](edited.getroot(), random, folder, "")
    return edited, Edit(f"{kind} {what}", edited.find("compiler") if kind == "compiler" else None)


def _change_number(element: Element, random: np.random.Generator) -> str:
    """Change one number of an element or of its descendants; return the tag and the attribute."""
    having = [
        (descendant, word)
        for descendant in element.iter()
        if isinstance(descendant.tag, str)
        for word, text in descendant.items()
        if word not in ("name", "class", "childclass", "rgba", "file", "mesh", "material")
        and any(_is_number(word_text) for word_text in text.split())
    ]
    if not having:
        return "nothing"
    each, word = having[int(random.integers(len(having)))]
    values = each.get(word, "").split()
    number = int(random.choice([n for n, one in enumerate(values) if _is_number(one)]))
    value = float(values[number])
    factor = float(random.choice([0.5, 0.9, 1.1, 1.5, -1.0]))
    values[number] = repr(value * factor if value else 0.02)
    each.set(word, " ".join(values))
    return f"{each.tag} {word}"


def _is_number(text: str) -> bool:
    try:
        return bool(np.isfinite(float(text)))
    except ValueError:
        return False


def _edit_default(root: Element, random: np.random.Generator, _: Path, __: str) -> str:
    """Change a default class, or the class of an element; return a description of the change."""
    classes = [default for default in root.iter("default") if default.get("class")]
    using = [geom for geom in root.iter("geom", "joint", "motor", "position", "general")
             if geom.get("class") and not _in_default(geom)]  # fmt: skip
    if using and not random.integers(3):
        one = using[int(random.integers(len(using)))]
        one.set("class", str(random.choice([str(default.get("class")) for default in classes])))
        return f"class of a {one.tag}"
    if classes and not random.integers(3):
        one = classes[int(random.integers(len(classes)))]
        word = str(random.choice(["margin", "friction", "condim", "solref", "contype", "group"]))
        geom = one.find("geom")
        geom = etree.SubElement(one, "geom") if geom is None else geom
        geom.set(word, _GEOM[word](random))
        return f"geom {word}"
    found = [default for default in root.iter("default") if len(default)]
    return _change_number(found[int(random.integers(len(found)))], random) if found else "nothing"


_COMPILER: dict[str, Value] = {
    "angle": _draw_choice("degree", "radian"),
    "eulerseq": _draw_choice("xyz", "XYZ", "zyx"),
    "autolimits": _draw_choice("false", "true"),
    "inertiafromgeom": _draw_choice("true", "false", "auto"),
    "fusestatic": _draw_choice("true", "false"),
    "boundmass": _draw_within((1e-4, 1.0)),
    "boundinertia": _draw_within((1e-6, 1e-2)),
    "settotalmass": _draw_within((3.0, 60.0)),
    "balanceinertia": _draw_choice("true"),
    "discardvisual": _draw_choice("true", "false"),
    "inertiagrouprange": _draw_choice("0 2", "2 5", "0 5"),
    "alignfree": _draw_choice("true", "false"),
    "saveinertial": _draw_choice("true"),
}
"""{attribute of ``compiler``: generator of a random value}."""


def _edit_compiler(root: Element, random: np.random.Generator, _: Path, __: str) -> str:
    """Set a random attribute of ``compiler``; return the attribute with its value."""
    found = root.find("compiler")
    compiler = etree.SubElement(root, "compiler") if found is None else found
    word = str(random.choice(list(_COMPILER)))
    compiler.set(word, _COMPILER[word](random))
    return f"{word} {compiler.get(word)}"


def _add_size(root: Element, random: np.random.Generator, _: Path, __: str) -> str:
    """Add a ``size`` element with one attribute; return the attribute with its value."""
    size = etree.SubElement(root, "size")
    word = str(random.choice(["njmax", "nconmax", "memory", "nuserdata", "nkey", "nuser_geom"]))
    choices = {"memory": ("64K", "16M"), "njmax": ("20", "2000"), "nconmax": ("4", "400")}
    size.set(word, _draw_choice(*choices.get(word, ("3", "9")))(random))
    return f"{word} {size.get(word)}"


def _edit_keyframe(root: Element, random: np.random.Generator, _: Path, __: str) -> str:
    """Make a mistake in the first keyframe, such as a reordered quaternion; return the kind."""
    keys = list(root.iter("key"))
    if not keys:
        return "nothing"
    key, slip = (
        keys[0],
        str(random.choice(["ctrl", "qvel", "time", "name", "order", "gone", "quat"])),
    )
    qpos = str(key.get("qpos", "")).split()
    above = key.getparent()
    assert above is not None
    if slip == "ctrl" and key.get("ctrl"):
        del key.attrib["ctrl"]
    elif slip == "qvel" and qpos:
        key.set("qvel", " ".join(["0.3", *["0"] * (len(qpos) - 2)]))
    elif slip == "time":
        key.set("time", "1.5")
    elif slip == "name":
        key.set("name", "another")
    elif slip == "order":
        above.append(key)
    elif slip == "gone":
        above.remove(key)
    elif len(qpos) > 6:
        qpos[3:7] = [qpos[4], qpos[5], qpos[6], qpos[3]]  # x, y, z, w
        key.set("qpos", " ".join(qpos))
    return slip


def _move_to_include(root: Element, random: np.random.Generator, folder: Path, name: str) -> str:
    """Move a random section into an included file; change one of its numbers in an edited part."""
    one_key = len(list(root.iter("key"))) == 1  # rollouts begin at the first keyframe
    tags = ("default", "actuator", "contact", "worldbody", *(["keyframe"] if one_key else []))
    sections = [
        section_element
        for section_element in root
        if section_element.tag in tags and len(section_element)
    ]
    section = sections[int(random.integers(len(sections)))]
    part = etree.Element("mujoco")
    section.addprevious(etree.Element("include", file=name))
    part.append(section)
    what = _change_number(section, random) if name.startswith("edited") else ""
    (folder / name).write_bytes(etree.tostring(part))
    return f"{section.tag}: {what}"


def _attach_tool(root: Element, random: np.random.Generator, folder: Path, name: str) -> str:
    """Attach a model of a tool to the first body; change one of its numbers in an edited part."""
    tool = etree.fromstring(
        '<mujoco><compiler angle="radian"/><worldbody><body name="tool" pos="0.05 0.01 0.08">'
        '<geom name="hand" type="box" size="0.03 0.02 0.05" mass="0.7" friction="0.8"/>'
        '<body name="tip" pos="0.1 0 0"><joint name="wrist" axis="0 1 0" damping="0.1" '
        'range="-0.5 0.5" limited="true"/><geom size="0.02" mass="0.1"/></body></body>'
        "</worldbody></mujoco>"
    )
    what = ""
    if name.startswith("edited"):
        what = _change_number(tool[1], random)
    (folder / name).write_bytes(etree.tostring(tool))
    body = next(root.iter("body"))
    asset = etree.SubElement(root, "asset")
    etree.SubElement(asset, "model", name="tool", file=name)
    attach = etree.SubElement(body, "attach", model="tool", body="tool", prefix="on_")
    if name.startswith("edited") and not random.integers(4):
        attach.set("prefix", "at_")
        what += ", prefix"
    for key in list(root.iter("keyframe")):  # keyframes do not contain the joint of the tool
        root.remove(key)
    return what


def _add_repeated_geoms(root: Element, random: np.random.Generator, _: Path, name: str) -> str:
    """Add repeated geoms to the first body; change the count or a value in an edited part."""
    body = next(root.iter("body"))
    several = etree.SubElement(body, "replicate", count="3", offset="0.04 0 0.01")
    etree.SubElement(several, "geom", name="rack", size="0.01 0.02 0.03", type="box", mass="0.2",
                     pos="-0.1 0.03 0.1")  # fmt: skip
    if not name.startswith("edited"):
        return ""
    if random.integers(2):
        several.set("count", str(random.choice(["2", "4"])))
        return "count"
    return _change_number(several, random)


_STRUCTURE: dict[str, Callable[[Element, np.random.Generator, Path, str], str]] = {
    "default": _edit_default,
    "compiler": _edit_compiler,
    "size": _add_size,
    "key": _edit_keyframe,
    "include": _move_to_include,
    "attach": _attach_tool,
    "replicate": _add_repeated_geoms,
}
"""{kind of a structural edit: function that makes the edit}."""


def _in_default(geom: Element) -> bool:
    return any(parent.tag == "default" for parent in geom.iterancestors())


def rollout(path: Path, seconds: float = ROLLOUT_DURATION) -> np.ndarray:
    """Return time [s] and qpos at each step of a simulation by bare MuJoCo, shape (n, 1 + nq).

    The simulation begins at the first keyframe, if any, at time 0. The time decreases if MuJoCo
    resets a diverged state, or has no memory for the contacts; the simulation may then end early.
    """
    model = _on_ground(path)
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    found, begun = [], data.time
    for _ in range(round(seconds / model.opt.timestep)):
        try:
            mujoco.mj_step(model, data)
        except mujoco.FatalError:  # no memory for the contacts
            data.time = begun - 1.0
        found.append([data.time - begun, *data.qpos])
        if data.time < begun:  # MuJoCo has reset the state, or has no memory
            break
    return np.array(found)


def measure_difference(one: np.ndarray, two: np.ndarray) -> float:
    """Return the largest difference of qpos between two rollouts at equal times (m, rad mixed).

    Infinite if only one rollout diverges, if nq differs, or if no times are equal. 0 if both
    diverge.
    """
    if one.shape[1] != two.shape[1]:
        return float("inf")
    begun_anew = [bool((np.diff(run[:, 0], prepend=0.0) < 0).any()) for run in (one, two)]
    if any(begun_anew):
        return 0.0 if all(begun_anew) else float("inf")
    times = one[:, 0] if len(one) <= len(two) else two[:, 0]
    times = times[times <= min(one[-1, 0], two[-1, 0])]
    steps = max(one[0, 0], two[0, 0])
    at = []
    for run in (one, two):  # the time steps may differ: select the nearest steps
        near = np.abs(run[:, 0][:, None] - times[None, :]).argmin(axis=0)
        at.append(run[near])
    same = np.abs(at[0][:, 0] - at[1][:, 0]) < 1e-6 * steps
    gaps = np.abs(at[0][same, 1:] - at[1][same, 1:])
    return float(gaps.max(initial=0.0)) if same.any() else float("inf")


def _on_ground(path: Path) -> mujoco.MjModel:
    """Compile an MJCF; add a plane if the file contains none.

    The plane has no friction: MuJoCo uses the larger coefficient, which is that of the robot's
    geom.
    """
    spec = mujoco.MjSpec.from_file(str(path))
    if not any(geom.type == mujoco.mjtGeom.mjGEOM_PLANE for geom in spec.geoms):
        plane = spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=(1, 1, 1))
        usual = mujoco.MjSpec().default.geom  # the defaults of the file are for the robot
        for word in ("condim", "solref", "solimp", "margin", "gap", "solmix"):
            setattr(plane, word, getattr(usual, word))
        plane.friction = (0, 0, 0)
        plane.contype = plane.conaffinity = 1
        plane.priority = 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # deprecated attributes
        return spec.compile()


def compute_answers(
    source: Path,
    count: int,
    first: int,
    scratch: Path,
    *,
    structure: bool = False,
) -> list[Answer]:
    """Return the answers of ``diff`` and of bare MuJoCo to random edits of a file.

    Args:
        source: MJCF.
        count: Number of edits that MuJoCo accepts.
        first: First seed.
        scratch: Folder for the edited files.
        structure: Whether the structure of the file is edited; see ``edit_structure``.
    """
    folder = scratch / "robot"
    shutil.copytree(source.parent, folder, copy_function=_link_file)
    original, edited = folder / source.name, folder / f"edited_{source.name}"
    before, found = rollout(original), []
    for seed in range(first, first + 20 * count):
        if len(found) == count:
            break
        tree, random = etree.parse(original), np.random.default_rng([seed, 44])
        if structure:
            begun = etree.parse(source)
            tree, made = edit_structure(begun, random, folder)
            original.unlink()
            begun.write(original)
        else:
            made = edit(tree, random)
        tree.write(edited)
        try:
            before = rollout(original) if structure else before
            truth = measure_difference(before, rollout(edited))
        except ValueError:  # MuJoCo refuses the edited file
            continue
        diff = pa.diff_models(original, edited)
        messages = [change for change in diff.changes if change.effects]
        felt = bool(messages) or any(
            message.code == "simulation-changes" for message in diff.combined
        )
        places = [change.new_place.rpartition(":")[2] for change in diff.changes]
        placed = made.element is None or str(_find_line(tree, made.element, edited)) in places
        found.append(Answer(f"{made.what}, seed {seed}", truth, felt, diff.same, placed))
    return found


def _find_line(tree: etree._ElementTree, element: Element, written: Path) -> int:
    """Return the line of an element in the file ``written``, which contains the element's tree."""
    (there,) = etree.parse(written).xpath(tree.getpath(element))
    return int(there.sourceline)


def _link_file(source: str, target: str) -> None:
    """Link a file instead of copying it, as ``copy_function`` of ``shutil.copytree``."""
    Path(target).symlink_to(Path(source).resolve())
