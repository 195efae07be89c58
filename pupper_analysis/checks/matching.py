"""Brings a URDF and an MJCF of one robot to the same base, the same joints and the same names."""

from __future__ import annotations

import copy
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
from lxml import etree
from numpy.typing import NDArray

from pupper_analysis.checks.passive import Mimics, Reference, urdf_mimics
from pupper_analysis.errors import ModelError, UnknownNameError
from pupper_analysis.models import parameters
from pupper_analysis.models.conversion import pinocchio_from_mujoco
from pupper_analysis.models.description import Description
from pupper_analysis.models.mjcf import compile_spec
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.robot.build import build_robot
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]

_MOVING = ("revolute", "continuous", "prismatic")
_PARALLEL = 0.99  # least |cosine| between the axes of joints that may be one
_NEAR = 0.25  # greatest distance of joints that may be one, relative to the robot's size


@dataclass(frozen=True, eq=False)
class Match:
    """A URDF and an MJCF that have been matched.

    Attributes:
        robot: Both as one robot, with the MJCF's joint names.
        urdf_joint: {joint: its name in the URDF}.
        urdf_link: {base or joint: the URDF's link that it moves}.
        mjcf_body: {base or joint: the MJCF's body that it moves}.
        guessed: {joint in the URDF: joint in the MJCF} matched by structure.
        only_urdf: Joints that the MJCF does not have; fixed at zero for the comparison.
        only_mjcf: Joints that the URDF does not have; likewise.
        notes: What was assumed or left out, in plain words.
        reference: The MJCF as it is, with all else in its scene. Where it has joints that the URDF
            lacks, these are fixed at zero.
        mimics: The joints that follow others in the URDF.
    """

    robot: Robot
    urdf_joint: Mapping[str, str]
    urdf_link: Mapping[str, str]
    mjcf_body: Mapping[str, str]
    guessed: Mapping[str, str]
    only_urdf: tuple[str, ...]
    only_mjcf: tuple[str, ...]
    notes: tuple[str, ...]
    reference: Reference
    mimics: Mimics


def read_mapping(path: Path) -> dict[str, str]:
    """Reads names from a TOML file: ``"name in the URDF" = "name in the MJCF"``, a line each.

    Raises:
        ModelError: If it cannot be read, or holds anything but text.
    """
    try:
        values = tomllib.loads(path.read_text())
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ModelError(path, f"not a TOML file of names: {error}") from error
    for name, value in values.items():
        if not isinstance(value, str):
            raise ModelError(path, f"{name} = {value!r}: give the name in the MJCF, in quotes")
    return values


def match(
    urdf: UrdfFile,
    mjcf: MjcfFile,
    *,
    names: Mapping[str, str] | None = None,
    feet: Sequence[str] = (),
) -> Match:
    """Matches joints and frames by name, then by ``names``, and the rest by structure.

    Dummy root links, and a floating joint at the base, are left out of the URDF. A joint that only
    one file has is fixed at zero. Where the MJCF's base is fixed, so is the URDF's.

    Args:
        urdf: The URDF.
        mjcf: The MJCF.
        names: {name in the URDF: name in the MJCF} of joints or frames.
        feet: Frames, by their names in the MJCF, to be compared as feet.

    Raises:
        ModelError: If the two have no joint in common, or one cannot be analysed.
        UnknownNameError: If ``names`` or ``feet`` name what is not there.
    """
    notes = [*urdf.notes, *mjcf.notes]
    root = copy.deepcopy(urdf.root)
    for link in root.iter("link"):
        for tag in ("visual", "collision"):
            for shape in link.findall(tag):
                link.remove(shape)
    spec = mjcf.spec.copy()
    _name_all(spec, {str(joint.get("name")) for joint in root.findall("joint")}, notes)
    whole = compile_spec(spec.copy(), mjcf.path)  # what is dropped below is still in it
    _drop_other_objects(spec, mjcf.path, {str(e.get("name")) for e in root.iter("link")}, notes)
    theirs = _hinges(spec, mjcf.path)
    root = _strip_roots(root, urdf.path, _mjcf_tree(spec, mjcf.path), notes)

    mine = _moving_joints(root, urdf.path)
    wanted = dict(names or {})
    links = {link.get("name") for link in root.findall("link")}
    places = {element.name for element in (*spec.sites, *spec.bodies, *spec.geoms)}
    for old, new in wanted.items():
        if old not in mine and old not in links:
            raise UnknownNameError(urdf.path, "joint or link (of a mapping)", old, mine)
        if old in mine and old not in links and new not in theirs:
            raise UnknownNameError(mjcf.path, "joint (of a mapping)", new, theirs)
        if new not in theirs and new not in places:
            raise UnknownNameError(mjcf.path, "joint or frame (of a mapping)", new, theirs)
        rivals = [name for name, value in wanted.items() if value == new and name != old]
        if rivals:
            raise ModelError(urdf.path, f"{old!r} and {rivals[0]!r} are both mapped to {new!r}")
    pairs = {old: new for old, new in wanted.items() if old in mine and new in theirs}
    taken = set(pairs.values())
    pairs |= {name: name for name in mine if name in theirs and name not in {*pairs, *taken}}
    guessed = _guess(root, spec, urdf.path, mjcf.path, pairs)
    pairs |= guessed
    if not pairs:
        raise ModelError(
            urdf.path,
            f"no joint in common with {mjcf.path}: {', '.join(mine[:6])} … against "
            f"{', '.join(theirs[:6])} …; name the pairs with a mapping",
        )
    only_urdf = tuple(name for name in mine if name not in pairs)
    only_mjcf = tuple(name for name in theirs if name not in pairs.values())
    mimics = {
        pairs[name]: (pairs.get(other, other), multiplier, offset)
        for name, (other, multiplier, offset) in urdf_mimics(root).items()
        if name in pairs
    }
    _fix_in_urdf(root, only_urdf)
    for joint in list(spec.joints):
        if joint.name in only_mjcf:
            _delete_joint(spec, joint)
    for joint in root.findall("joint"):
        name = str(joint.get("name"))
        # One that is left over must not take the name of another.
        joint.set("name", pairs.get(name, f"{name} (URDF)" if name in theirs else name))
        mimic = joint.find("mimic")
        if mimic is not None:
            joint.remove(mimic)

    frames = _common_frames(root, spec, wanted)
    for foot in feet:
        if foot not in frames:
            raise UnknownNameError(urdf.path, "frame of both files (for a foot)", foot, frames)
    for key in list(spec.keys):
        spec.delete(key)  # its size may no longer fit
    description = Description(
        name=spec.modelname,
        urdf=etree.tostring(root, encoding="unicode"),
        urdf_source=urdf.path,
        mjcf=spec,
        mjcf_source=mjcf.path,
        feet={},
        frames={name: frames[name] for name in (feet or frames)},
    )
    robot = build_robot(description)
    return Match(
        robot=robot,
        urdf_joint={new: old for old, new in pairs.items()},
        urdf_link=_links(root, robot),
        mjcf_body=_bodies(robot),
        guessed=guessed,
        only_urdf=only_urdf,
        only_mjcf=only_mjcf,
        notes=(*notes, *(note for note in robot.notes if "free joint" in note)),
        reference=Reference(
            robot.mj_model if only_mjcf else mjcf.compile(),
            robot.mj_model if only_mjcf else whole,
            robot.joint_names,
            robot.mj_base,
        ),
        mimics=mimics,
    )


# ------------------------------------------------------------------------------------- the URDF


def _root_link(root: etree._Element) -> etree._Element:
    children = {child.get("link") for child in root.findall("joint/child")}
    return next(link for link in root.findall("link") if link.get("name") not in children)


def _strip_roots(
    root: etree._Element, source: Path, other: parameters.Parameters, notes: list[str]
) -> etree._Element:
    """Takes out root links without mass, as long as they carry one fixed or floating joint.

    Where such a link's frame, not that of the base on it, is the one that the MJCF has, the link
    stays: whichever brings the joints nearer to the MJCF's.
    """
    candidates = [(root, list(notes))]
    while True:
        tree, said = copy.deepcopy(candidates[-1][0]), list(candidates[-1][1])
        link = _root_link(tree)
        name = link.get("name")
        mass = link.find("inertial/mass")
        heavy = mass is not None and float(mass.get("value")) > 0
        joints = [joint for joint in tree.findall("joint") if _end(joint, "parent") == name]
        if heavy or len(joints) != 1 or joints[0].get("type") not in ("fixed", "floating"):
            break
        said.append(f"{source.name}: root link {name!r} has no mass and was left out")
        tree.remove(link)
        tree.remove(joints[0])
        if joints[0].get("type") == "floating":
            candidates.clear()  # the base cannot stay on a joint that floats by itself
        candidates.append((tree, said))
    there = _at_zero(other)

    def distance(tree: etree._Element) -> float:
        here = _at_zero(_urdf_tree(tree, source))
        common = [name for name in here if name in there]
        apart = sum(float(np.linalg.norm(here[name][0] - there[name][0])) for name in common)
        return round(apart, 6)

    if len(candidates) == 1 or not other.floating:
        best, said = candidates[-1]  # a fixed base is put where the MJCF has it
    else:  # the last of the equally good: no needless root
        best, said = min(reversed(candidates), key=lambda candidate: distance(candidate[0]))
    notes[:] = said
    return best


def _end(joint: etree._Element, tag: str) -> str:
    return str(joint.find(tag).get("link"))


def _moving_joints(root: etree._Element, source: Path) -> list[str]:
    moving = []
    for joint in root.findall("joint"):
        kind = joint.get("type")
        if kind in _MOVING:
            moving.append(str(joint.get("name")))
        elif kind != "fixed":
            raise ModelError(
                source,
                f"joint {joint.get('name')!r} is {kind}; revolute, continuous, prismatic and fixed "
                "joints, and a floating one at the root, can be analysed",
            )
    return moving


def _fix_in_urdf(root: etree._Element, names: Iterable[str]) -> None:
    fixed = set(names)
    for joint in root.findall("joint"):
        if joint.get("name") in fixed:
            joint.set("type", "fixed")


def _links(root: etree._Element, robot: Robot) -> dict[str, str]:
    links = {robot.base: str(_root_link(root).get("name"))}
    for joint in root.findall("joint"):
        if joint.get("name") in robot.joint_names:
            links[str(joint.get("name"))] = _end(joint, "child")
    return links


# ------------------------------------------------------------------------------------- the MJCF


def _name_all(spec: mujoco.MjSpec, taken: set[str], notes: list[str]) -> None:
    """Names the bodies and joints that have no name, by names that are not taken."""

    def new(name: str, known: set[str]) -> str:
        while name in known:
            name += "_"
        known.add(name)
        return name

    bodies = {body.name for body in spec.bodies}
    for number, body in enumerate(spec.bodies):
        if not body.name:
            body.name = new(f"body_{number}", bodies)
    joints = {joint.name for joint in spec.joints} | taken
    for joint in spec.joints:
        if not joint.name and joint.type != mujoco.mjtJoint.mjJNT_FREE:
            joint.name = new(f"{joint.parent.name}_joint", joints)
            notes.append(f"a joint without a name in the MJCF is called {joint.name!r}")


def _hinges(spec: mujoco.MjSpec, source: Path) -> list[str]:
    names = []
    for joint in spec.joints:
        if joint.type == mujoco.mjtJoint.mjJNT_BALL:
            raise ModelError(
                source,
                f"joint {joint.name!r} is a ball joint; hinge and slide joints, and one free joint "
                "at the base, can be analysed",
            )
        if joint.type != mujoco.mjtJoint.mjJNT_FREE:
            names.append(joint.name)
    return names


def _drop_other_objects(
    spec: mujoco.MjSpec, source: Path, links: set[str], notes: list[str]
) -> None:
    """Keeps the largest tree of joints: a scene may have loose objects besides the robot.

    Beside a robot on a fixed base, a table or a wall would count as part of that base, unless it
    has the name of one of the URDF's links.
    """
    kinds = mujoco.mjtObj
    size = {body.name: len(body.find_all(kinds.mjOBJ_JOINT)) for body in spec.worldbody.bodies}
    if not any(size.values()):
        raise ModelError(source, "it has no joints; give a robot with hinge or slide joints")
    robot = max(spec.worldbody.bodies, key=lambda body: size[body.name])
    fixed = not any(joint.type == mujoco.mjtJoint.mjJNT_FREE for joint in robot.joints)
    for body in list(spec.worldbody.bodies):
        names = {body.name, *(below.name for below in body.find_all(kinds.mjOBJ_BODY))}
        scenery = fixed and not body.mocap and not names & links
        if body.name != robot.name and (size[body.name] or scenery):
            notes.append(f"{source.name}: body {body.name!r} is not part of the robot: left out")
            spec.delete(body)


def _delete_joint(spec: mujoco.MjSpec, joint: mujoco.MjsJoint) -> None:
    """Deletes a joint with all that refers to it."""
    name = joint.name
    for actuator in list(spec.actuators):
        if actuator.target == name:
            _delete_sensors(spec, actuator.name)
            spec.delete(actuator)
    for equality in list(spec.equalities):
        if name in (equality.name1, equality.name2):
            spec.delete(equality)
    _delete_sensors(spec, name)
    spec.delete(joint)


def _delete_sensors(spec: mujoco.MjSpec, name: str) -> None:
    for sensor in list(spec.sensors):
        if name and name in (sensor.objname, sensor.refname):
            spec.delete(sensor)


def _bodies(robot: Robot) -> dict[str, str]:
    model = robot.mj_model
    bodies = {robot.base: robot.mj_base}
    for name in robot.joint_names:
        bodies[name] = str(model.body(int(model.jnt_bodyid[model.joint(name).id])).name)
    return bodies


# ------------------------------------------------------------------------------------- matching


def _common_frames(
    root: etree._Element, spec: mujoco.MjSpec, names: Mapping[str, str]
) -> dict[str, tuple[str, str]]:
    """Returns the frames of both: links on fixed joints, and sites or bodies without joints."""
    places = {site.name for site in spec.sites if site.name}
    places |= {body.name for body in spec.bodies if body.name and not list(body.joints)}
    frames = {}
    for joint in root.findall("joint"):
        link = _end(joint, "child")
        place = names.get(link, link)
        if joint.get("type") == "fixed" and place in places:
            frames[place] = (link, place)
    return frames


def _guess(
    root: etree._Element,
    spec: mujoco.MjSpec,
    urdf: Path,
    mjcf: Path,
    pairs: Mapping[str, str],
) -> dict[str, str]:
    """Matches joints without a partner by structure.

    Below the same parent, with parallel axes at zero angles, each the nearest to the other.
    """
    one = _urdf_tree(root, urdf)
    two = _mjcf_tree(spec, mjcf)
    free_one = [name for name in one.joints if name not in pairs]
    free_two = [name for name in two.joints if name not in pairs.values()]
    if not free_one or not free_two:
        return {}
    place_one, place_two = _at_zero(one), _at_zero(two)
    size = max(float(np.linalg.norm(place[0])) for place in place_one.values())
    partner = {one.base: two.base, **pairs}
    guessed: dict[str, str] = {}

    def likeness(name: str, other: str) -> float:
        (here, axis), (there, other_axis) = place_one[name], place_two[other]
        distance = float(np.linalg.norm(here - there))
        parallel = abs(float(axis @ other_axis)) > _PARALLEL
        return distance if parallel and distance < _NEAR * size else np.inf

    for parent in (one.base, *one.joints):  # parents first
        twin = partner.get(parent)
        mine = [name for name in one.children(parent) if name in free_one]
        theirs = [other for other in two.children(twin or "") if other in free_two]
        if twin is None or not mine or not theirs:
            continue
        table = np.array([[likeness(name, other) for other in theirs] for name in mine])
        for row, name in enumerate(mine):
            column = int(np.argmin(table[row]))
            least = table[row, column]
            rivals = np.concatenate(
                [np.delete(table[row], column), np.delete(table[:, column], row)]
            )
            if np.isfinite(least) and (least < 0.5 * rivals).all():
                guessed[name] = partner[name] = theirs[column]
    return guessed


def _urdf_tree(root: etree._Element, source: Path) -> parameters.Parameters:
    text = etree.tostring(root, encoding="unicode")
    try:
        model = pin.buildModelFromXML(text, pin.JointModelFreeFlyer())
    except (ValueError, RuntimeError) as error:
        raise ModelError(source, f"not a valid URDF: {' '.join(str(error).split())}") from error
    return parameters.from_pinocchio(model, "", list(model.names)[2:], {})


def _mjcf_tree(spec: mujoco.MjSpec, source: Path) -> parameters.Parameters:
    try:
        compiled = spec.copy().compile()
    except (ValueError, RuntimeError) as error:
        message = " ".join(str(error).split())
        raise ModelError(source, f"MuJoCo cannot compile it: {message}") from error
    model = pinocchio_from_mujoco(compiled)
    names = [joint.name for joint in spec.joints if joint.type != mujoco.mjtJoint.mjJNT_FREE]
    return parameters.from_pinocchio(model, "", names, {})


def _at_zero(tree: parameters.Parameters) -> dict[str, tuple[Array, Array]]:
    """Returns where each joint is at zero, and its axis, both in the base's frame."""
    poses = {tree.base: pin.SE3.Identity()}
    places = {}
    for name, joint in tree.joints.items():
        poses[name] = poses[joint.parent] * pin.SE3(joint.rotation, joint.position)
        places[name] = (np.array(poses[name].translation), poses[name].rotation @ joint.axis)
    return places
