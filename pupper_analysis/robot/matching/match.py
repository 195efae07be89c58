"""Brings a URDF and an MJCF of one robot to the same base, the same joints and the same names.

Parts that one file has and the other lacks (a gripper, a tail, a head) are left out, and said.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import mujoco
import numpy as np
from lxml import etree

from pupper_analysis.base.arrays import placement_of
from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Term,
    diagnose,
)
from pupper_analysis.base.errors import ModelError, UnknownNameError
from pupper_analysis.models import multibody
from pupper_analysis.models.attributes import BY_KIND, PASSIVE_ATTRIBUTES
from pupper_analysis.models.conversion import pinocchio_from_mujoco
from pupper_analysis.models.description import Description, ModelTree
from pupper_analysis.models.mjcf import JointKind, compile_spec, name_all
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.multibody import TreeJoint
from pupper_analysis.models.spec_tree import SpecTree, delete_joint, join_free_base, state_number
from pupper_analysis.models.urdf_file import UrdfFile, for_engines
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.robot.build import build_robot
from pupper_analysis.robot.matching.alignment import with_base
from pupper_analysis.robot.matching.conventions import (
    Conventions,
    describe_pose,
    find_conventions,
    take_conventions,
)
from pupper_analysis.robot.matching.pairs import common_frames, pair_up, without_affixes
from pupper_analysis.robot.matching.sources import MjcfSources, Sources, UrdfSources
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.robot.matching.trees import (
    Mimics,
    Reference,
    base_pose,
    kinematic_trees,
    links_of,
    moving_joints,
    strip_roots,
    take_mass_of_base,
    urdf_mimics,
    urdf_tree,
    without_shapes,
)
from pupper_analysis.robot.robot import Robot


@dataclass(frozen=True)
class RemovablePart:
    """A subtree with joints that the other file lacks, as it may be taken off.

    Attributes:
        root: The link or body that goes, with all below it.
        carrier: The moving joint that carries it, by its name in the file; "" for the base.
        joints: The joints in it.
        mass: Of all of it (kg).
    """

    root: str
    carrier: str
    joints: tuple[str, ...]
    mass: float


def tell_lacking(part: RemovablePart, has: str, lacks: str) -> Diagnostic:
    """Tells what one file has and the other lacks."""
    return diagnose(
        "part-of-one-file",
        subject=("link" if has == "URDF" else "body", part.root),
        has=has,
        lacks=lacks,
        carrier=part.carrier,
        mass=Quantity(part.mass, "kg"),
        joints=part.joints,
    )


Ways = list[tuple[str, list[list[RemovablePart]]]]
"""Carriers, and what may be taken off each, the least first."""


def ways_off(tree: ModelTree, extra: Collection[str]) -> Ways:
    """Returns each carrier of joints that the other file lacks, and the ways to take these off it.

    The parts as they move come first, and then with more and more of what holds them.
    """
    chains: dict[str, list[list[RemovablePart]]] = {}
    for name in tree.names:
        link: str | None = name if set(tree.movers(name)) & set(extra) else None
        chain: list[RemovablePart] = []
        while link is not None and (part := _part(tree, link, extra)) is not None:
            chain.append(part)
            up = tree.parent(link)
            link = up if up is not None and not tree.movers(up) and tree.parent(up) else None
        if chain and chain[0].carrier not in extra:  # else it goes with that
            chains.setdefault(chain[0].carrier, []).append(chain)
    ways = []
    for carrier, those in chains.items():
        listed = []
        for level in range(max(map(len, those))):
            parts = dict.fromkeys(each[min(level, len(each) - 1)] for each in those)
            listed.append(
                [one for one in parts if not any(set(one.joints) < set(o.joints) for o in parts)]
            )
        ways.append((carrier, listed))
    return ways


def _part(tree: ModelTree, link: str, extra: Collection[str]) -> RemovablePart | None:
    """Returns what is on a link with the link itself, if none of its joints is the other file's."""
    inside = list(tree.subtree(link))
    joints = tuple(joint for name in inside for joint in tree.movers(name))
    if any(joint not in extra for joint in joints):
        return None
    carrier = tree.parent(link)
    while carrier is not None and not tree.movers(carrier):
        carrier = tree.parent(carrier)
    mover = tree.movers(carrier)[-1] if carrier is not None else ""
    return RemovablePart(link, mover, joints, sum(map(tree.weight, inside)))


def take_off(
    trees: tuple[UrdfTree, SpecTree],
    files: tuple[Path, Path],
    ways: tuple[Ways, Ways],
    pairs: Mapping[str, str],
) -> list[Diagnostic]:
    """Takes off what one file has and the other lacks, where masses say so; returns what it is.

    So much goes that the carrier's mass comes nearest to the other file's: nothing, if that is
    nearest with all of it left on, at rest.
    """
    if not any(ways):
        return []
    one, two = urdf_tree(trees[0].root, files[0]), mjcf_tree(trees[1].spec, files[1])
    said = []
    for tree, of_carriers, here, there, words in (
        (trees[0], ways[0], one, two, ("URDF", "MJCF")),
        (trees[1], ways[1], two, one, ("MJCF", "URDF")),
    ):
        for carrier, listed in of_carriers:
            name = pairs.get(carrier, carrier) if words[0] == "URDF" else carrier
            if name not in here.bodies or name not in there.bodies:
                continue
            short = here.bodies[name].mass - there.bodies[name].mass
            left = [abs(short - sum(part.mass for part in parts)) for parts in ([], *listed)]
            # The least that does as well, to a milligram.
            best = next(number for number, off in enumerate(left) if off <= min(left) + 1e-6)
            for part in ([], *listed)[best]:
                said.append(tell_lacking(part, *words))
                tree.remove_subtree(part.root)
    return said


@dataclass(frozen=True, eq=False)
class Match:
    """A URDF and an MJCF that have been matched.

    Attributes:
        robot: Both as one robot, with the MJCF's joint names.
        urdf_joint: {joint: its name in the URDF}.
        urdf_link: {base or joint: the URDF's link that it moves}.
        mjcf_body: {base or joint: the MJCF's body that it moves}.
        guessed: {joint in the URDF: joint in the MJCF} matched by structure, or by names that are
            the same but for prefixes and suffixes.
        only_urdf: Joints that the MJCF does not have; fixed at zero for the comparison.
        only_mjcf: Joints that the URDF does not have; likewise.
        notes: What was assumed or left out.
        reference: The MJCF as it is, with all else in its scene. Where it has joints that the URDF
            lacks, these are fixed at zero.
        mimics: The joints that follow others in the URDF.
        conventions: What the URDF was given of the MJCF's: the base's frame, zeros of joints.
        parts: What one file has and the other lacks, and was taken off.
        unstated: {"damping" or "friction": joints for which the URDF does not state it, and was
            given the MJCF's}.
    """

    robot: Robot
    urdf_joint: Mapping[str, str]
    urdf_link: Mapping[str, str]
    mjcf_body: Mapping[str, str]
    guessed: Mapping[str, str]
    only_urdf: tuple[str, ...]
    only_mjcf: tuple[str, ...]
    notes: tuple[Diagnostic, ...]
    reference: Reference
    mimics: Mimics
    conventions: Conventions
    parts: tuple[Diagnostic, ...]
    unstated: Mapping[str, tuple[str, ...]]

    @cached_property
    def urdf_tree(self) -> UrdfTree:
        """The links and joints of the URDF as it was matched."""
        return UrdfTree.of(self.robot.description.urdf)

    def sources(self, urdf: UrdfFile, mjcf: MjcfFile) -> tuple[Sources, Sources]:
        """Returns where the numbers stand in the two files that were matched."""
        base = tuple(dict.fromkeys((self.robot.base, self.reference.base)))
        frames = self.robot.description.frames
        one = UrdfSources(
            file=urdf,
            tree=self.urdf_tree,
            links=self.urdf_link,
            joints=self.urdf_joint,
            frames={name: link for name, (link, _) in frames.items()},
            base=base,
        )
        two = MjcfSources(
            file=mjcf,
            model=self.robot.mj_model,
            bodies=self.mjcf_body,
            frames={name: site for name, (_, site) in frames.items()},
            base=base,
        )
        return one, two


def match_models(
    urdf: UrdfFile,
    mjcf: MjcfFile,
    *,
    names: Mapping[str, str] | None = None,
    feet: Sequence[str] = (),
    complete: bool = False,
    tolerances: Tolerances | None = None,
    strict: bool = False,
) -> Match:
    """Matches joints and frames by name, then by ``names``, and the rest by structure.

    Dummy root links, and a floating joint at the base, are left out of the URDF. A joint that only
    one file has is fixed at zero. Where the MJCF's base is fixed, so is the URDF's.

    Args:
        urdf: The URDF.
        mjcf: The MJCF.
        names: {name in the URDF: name in the MJCF} of joints or frames.
        feet: Frames, by their names in the MJCF, to be compared as feet.
        complete: Keep the URDF's shapes, and the parts that only one file has.
        tolerances: What counts as a difference.
        strict: Damping and friction that the URDF does not state are 0; else they are the MJCF's.

    Raises:
        ModelError: If the two have no joint in common, one cannot be analysed, or (``complete``)
            the MJCF closes loops and has joints that the URDF lacks.
        UnknownNameError: If ``names`` or ``feet`` name what is not there.
    """
    root = copy.deepcopy(urdf.root) if complete else without_shapes(urdf.root)
    taken, spec = set(UrdfTree(root).joints), mjcf.spec.copy()
    named = name_all(spec, taken)
    joined = join_free_base(spec, stated=taken)
    whole = compile_spec(spec.copy(), mjcf.path)  # what is dropped below is still in it
    dropped = drop_other_objects(spec, mjcf.path, root)
    theirs, balls, held = list_hinges(spec, mjcf.path)
    tree = mjcf_tree(spec, mjcf.path)
    root, stripped = strip_roots(root, urdf.path, tree)
    mine, others, fixed = moving_joints(root)
    notes = [*urdf.notes, *mjcf.notes, *named, *([joined] if joined else [])]
    notes += [*dropped, *held, *stripped, *fixed]
    wanted = dict(names or {})
    _check_names(wanted, (mine, root, urdf.path), (theirs, spec, mjcf.path))
    found = pair_up(root, tree, (urdf.path, mjcf.path), (mine, theirs), wanted)
    pairs, notes = found.pairs, [*notes, *found.notes]
    if is_fused(spec, pairs.values()):
        notes += take_mass_of_base(root, urdf.path)
    only_urdf = (*others, *(name for name in mine if name not in pairs))
    partners = set(pairs.values())
    only_mjcf = (*balls, *(name for name in theirs if name not in partners))
    for key in list(spec.keys):
        spec.delete(key)  # its size may no longer fit
    if complete:
        _refuse_loops(spec, only_mjcf, mjcf.path)
    sides, paths = (UrdfTree(root), SpecTree(spec)), (urdf.path, mjcf.path)
    ways = ways_off(sides[0], only_urdf), ways_off(sides[1], only_mjcf)
    mimics = _make_alike(root, spec, pairs, only_urdf, only_mjcf)
    # In a robot that shall stand, what one file lacks is weight: it stays.
    parts = [] if complete else take_off(sides, paths, ways, pairs)
    own = copy.copy(mjcf.model) if mjcf.unknown else mjcf.model  # as long as compiling
    models = whole, whole if joined else own
    notes += take_unknown(root, spec, models, {} if strict else mjcf.unknown, mjcf.path)
    unstated = {} if strict else take_unstated(root, tree.joints, urdf.unknown, pairs)
    frames = common_frames(root, spec, wanted)
    _check_feet(feet, frames, urdf.path)
    description = Description(
        name=spec.modelname,
        urdf=for_engines(root),
        urdf_source=urdf.path,
        mjcf=spec,
        mjcf_source=mjcf.path,
        contact_points={},
        frames={name: frames[name] for name in feet or frames},
    )
    robot, meant, moved = _in_one_convention(root, description, tolerances or Tolerances())
    return Match(
        robot=robot,
        urdf_joint={new: old for old, new in pairs.items()},
        urdf_link=links_of(root, robot),
        mjcf_body=bodies_of(robot),
        guessed=found.guessed,
        only_urdf=only_urdf,
        only_mjcf=only_mjcf,
        notes=(*notes, *moved),
        reference=Reference(
            robot.mj_model if only_mjcf else models[1],
            robot.mj_model if only_mjcf else whole,
            robot.joint_names,
            robot.mj_base,
        ),
        mimics=_with_zeros(mimics, meant),
        conventions=meant,
        parts=tuple(parts),
        unstated=unstated,
    )


def _check_feet(feet: Sequence[str], frames: Mapping[str, tuple[str, str]], urdf: Path) -> None:
    """Raises UnknownNameError for a foot that is no frame of both files."""
    for foot in feet:
        if foot not in frames:
            raise UnknownNameError(urdf, "frame of both files (for a foot)", foot, frames)


def _in_one_convention(
    root: etree._Element, description: Description, tolerances: Tolerances
) -> tuple[Robot, Conventions, list[Diagnostic]]:
    """Builds the robot, with the URDF in the MJCF's conventions; and tells how they differed."""
    robot = build_robot(description)
    meant, notes = _conventions(robot, tolerances)
    if meant.base is not None or meant.zeros:
        take_conventions(root, robot.base, meant, kinematic_trees(robot)[0])
        text = for_engines(root)
        robot = build_robot(replace(description, urdf=text))
    return robot, meant, notes


def _conventions(robot: Robot, tolerances: Tolerances) -> tuple[Conventions, list[Diagnostic]]:
    """Finds how the files' conventions differ, and tells where a fixed base stands."""
    urdf, mjcf = kinematic_trees(robot)
    if robot.floating:
        return find_conventions(urdf, mjcf, tolerances, fixed=False), []
    pose, notes, base = base_pose(robot), [], ("body", robot.mj_base)
    if not pose.isIdentity(1e-9):
        notes.append(diagnose("fixed-base-stands", subject=base, pose=describe_pose(pose)))
    one, two = (with_base(tree, pose.inverse()) for tree in (urdf, mjcf))
    found = find_conventions(one, two, tolerances, fixed=True)
    if found.base is not None and found.shown:
        notes.append(
            diagnose("fixed-base-frame-moved", subject=base, pose=describe_pose(found.base))
        )
    return found, notes


def _with_zeros(mimics: Mimics, found: Conventions) -> Mimics:
    """Returns the couplings q = m q' + c in coordinates with other zeros."""
    zeros = found.zeros
    return {
        name: (
            leader,
            multiplier,
            offset + multiplier * zeros.get(leader, 0.0) - zeros.get(name, 0.0),
        )
        for name, (leader, multiplier, offset) in mimics.items()
    }


def _check_names(
    wanted: Mapping[str, str],
    urdf: tuple[Sequence[str], etree._Element, Path],
    mjcf: tuple[Sequence[str], mujoco.MjSpec, Path],
) -> None:
    """Refuses a mapping of what is not there, or of two to one.

    Args:
        wanted: {name in the URDF: name in the MJCF}.
        urdf: The joints, the XML, and the file.
        mjcf: The joints, the spec, and the file.
    """
    (mine, root, source), (theirs, spec, target) = urdf, mjcf
    links = UrdfTree(root).links
    places = {element.name for element in (*spec.sites, *spec.bodies, *spec.geoms)}
    for old, new in wanted.items():
        if old not in mine and old not in links:
            raise UnknownNameError(source, "joint or link (of a mapping)", old, mine)
        if old in mine and old not in links and new not in theirs:
            raise UnknownNameError(target, "joint (of a mapping)", new, theirs)
        if new not in theirs and new not in places:
            raise UnknownNameError(target, "joint or frame (of a mapping)", new, theirs)
        rivals = [name for name, value in wanted.items() if value == new and name != old]
        if rivals:
            both = (old, rivals[0])
            raise ModelError(source, diagnose("names-mapped-to-one", names=both, other=new))


def _make_alike(
    root: etree._Element,
    spec: mujoco.MjSpec,
    pairs: Mapping[str, str],
    only_urdf: Collection[str],
    only_mjcf: Collection[str],
) -> Mimics:
    """Fixes the joints that one side lacks, and gives the URDF's the MJCF's names; in place.

    Returns:
        The joints that followed others in the URDF, by their new names; they move freely now.
    """
    theirs = {*pairs.values(), *only_mjcf}
    mimics = {
        pairs[name]: (pairs.get(other, other), multiplier, offset)
        for name, (other, multiplier, offset) in urdf_mimics(root).items()
        if name in pairs
    }
    tree = UrdfTree(root)
    tree.fix(only_urdf)
    for joint in list(spec.joints):
        if joint.name in only_mjcf:
            delete_joint(spec, joint)
    for name, joint in tree.joints.items():
        # One that is left over must not take the name of another.
        joint.element.set("name", pairs.get(name, f"{name} (URDF)" if name in theirs else name))
        joint.remove("mimic")
    return mimics


def take_unstated(
    root: etree._Element,
    theirs: Mapping[str, TreeJoint],
    unknown: Mapping[str, tuple[str, ...]],
    pairs: Mapping[str, str],
) -> dict[str, tuple[str, ...]]:
    """Gives a URDF's joints the MJCF's damping and dry friction where it states none, in place.

    Args:
        root: The URDF, with the MJCF's names of joints.
        theirs: The MJCF's joints.
        unknown: What the URDF leaves open, see `UrdfFile.unknown`: its efforts become the MJCF's.
        pairs: {joint in the URDF's file: in the MJCF}.

    Returns:
        {``damping`` or ``friction``: the joints that were given it}.
    """
    optional = [one for one in PASSIVE_ATTRIBUTES if one.in_both]
    given: dict[str, list[str]] = {one.kind: [] for one in optional}
    mine = [joint for joint in UrdfTree(root).joints.values() if not joint.is_fixed]
    lacking = [joint for joint in mine if any(joint.stated(one) is None for one in optional)]
    if not (lacking or unknown.get("effort")):
        return dict.fromkeys(given, ())
    effort = BY_KIND["effort"]
    for name in (pairs.get(name, name) for name in unknown.get("effort", ())):
        if name in theirs and math.isfinite(theirs[name].effort):
            UrdfTree(root).joints[name].state(effort, theirs[name].effort)
    for joint in lacking:
        for one in optional if joint.name in theirs else ():
            value = float(getattr(theirs[joint.name], one.field))
            if value and joint.stated(one) is None:
                joint.state(one, value)
                given[one.kind].append(joint.name)
    return {kind: tuple(names) for kind, names in given.items()}


def take_unknown(
    root: etree._Element,
    spec: mujoco.MjSpec,
    models: Collection[mujoco.MjModel],
    unknown: Mapping[str, tuple[str, ...]],
    source: Path,
) -> list[Diagnostic]:
    """Gives an MJCF's joints the URDF's numbers where its file leaves them open, in place.

    Args:
        root: The URDF, with the MJCF's names of joints.
        spec: The MJCF.
        models: What MuJoCo makes of it; they are given them, too.
        unknown: {kind: joints}, see `MjcfFile.unknown`.
        source: The MJCF's file.

    Returns:
        What was given to which.
    """
    messages, mine = [], UrdfTree(root).joints
    theirs = {joint.name: joint for joint in spec.joints}
    for kind, names in unknown.items():
        one = BY_KIND[kind]
        stated = {name: mine[name].stated(one) for name in names if name in mine.keys() & theirs}
        given = {name: float(value) for name, value in stated.items() if value is not None}
        if kind == "effort":  # of 0 is how a URDF says that it states none
            given = {name: value for name, value in given.items() if value > 0}
        for name, value in given.items():
            state_number(theirs[name], one, value)
            for model in models if one.mujoco else ():
                getattr(model, one.mujoco)[model.jnt_dofadr[model.joint(name).id]] = value
        if given:
            messages.append(
                diagnose("unknown-taken-from-urdf", file=source.name, what=Term(kind), joints=given)
            )
    return messages


# The side of an MJCF in matching: names, what is not the robot, joints that go.


def list_hinges(spec: mujoco.MjSpec, source: Path) -> tuple[list[str], list[str], list[Diagnostic]]:
    """Returns the names of the hinges and slides, and of the ball joints, which are taken out.

    A URDF has no ball joints: what they carry is compared as it is at rest. The third says so.
    """
    names, balls = [], []
    for joint in list(spec.joints):
        if joint.type == JointKind.BALL:
            balls.append(joint.name)
            delete_joint(spec, joint)
        elif joint.type != JointKind.FREE:
            names.append(joint.name)
    if balls and not names:
        raise ModelError(source, diagnose("ball-joints-alone"))
    if not balls:
        return names, balls, []
    for key in list(spec.keys):
        spec.delete(key)  # its size no longer fits
    return names, balls, [diagnose("ball-joints-fixed", joints=balls)]


def drop_other_objects(
    spec: mujoco.MjSpec, source: Path, urdf: etree._Element | None
) -> list[Diagnostic]:
    """Keeps the largest tree of joints: a scene may have loose objects besides the robot.

    Beside a robot on a fixed base, a table or a wall would count as part of that base, unless it
    has the name of one of the URDF's links; beside a free one, as part of its com. Limbs that stand
    in the world itself, because the base was fused with it, are the robot's. (Without a URDF, of
    two versions of an MJCF, neither is known.)

    Returns:
        What was left out.
    """
    kinds = mujoco.mjtObj
    links, limbs = set[str](), set[str]()
    if urdf is not None:
        links = set(UrdfTree(urdf).links)
        limbs = {body.name for body in limbs_on_the_world(spec, urdf)}
    size = {body.name: len(body.find_all(kinds.mjOBJ_JOINT)) for body in spec.worldbody.bodies}
    if not any(size.values()):
        raise ModelError(source, diagnose("no-joints"))
    robot = max(spec.worldbody.bodies, key=lambda body: size[body.name])
    fixed = not any(joint.type == JointKind.FREE for joint in robot.joints)
    notes = []
    for body in list(spec.worldbody.bodies):
        names = {body.name, *(below.name for below in body.find_all(kinds.mjOBJ_BODY))}
        # Beside a free robot nothing that stands in the world is of it, but for its ground.
        scenery = not body.mocap and not (names & links if fixed else _has_plane(body))
        if body.name in limbs and robot.name in limbs:
            continue
        if body.mocap:
            _weightless(body)
        if body.name != robot.name and (size[body.name] or scenery):
            left = "body", body.name
            notes.append(diagnose("body-left-out", subject=left, file=source.name, sources=source))
            for eye in (*spec.cameras, *spec.lights):  # MuJoCo refuses those that follow nothing
                if eye.targetbody in names:
                    spec.delete(eye)
            spec.delete(body)
    return notes


def _weightless(body: mujoco.MjsBody) -> None:
    """Takes the mass off a body that is moved by hand: a fixed base would count it as its own."""
    for below in [body, *body.find_all(mujoco.mjtObj.mjOBJ_BODY)]:
        below.mass, below.inertia = 0.0, np.zeros(3)
        for geom in below.geoms:
            geom.mass = geom.density = 0.0


def _has_plane(body: mujoco.MjsBody) -> bool:
    geoms = body.find_all(mujoco.mjtObj.mjOBJ_GEOM)
    return any(geom.type == mujoco.mjtGeom.mjGEOM_PLANE for geom in geoms)


def limbs_on_the_world(spec: mujoco.MjSpec, urdf: etree._Element) -> list[mujoco.MjsBody]:
    """Returns the bodies of the world that move by the joints of a URDF: limbs without a base.

    MuJoCo makes that of a URDF: it fuses what does not move with the world. The joints are known
    by their names, or their names without prefixes and suffixes.
    """
    mine = [joint.name for joint in UrdfTree(urdf).joints.values() if not joint.is_fixed]
    theirs = [joint.name for joint in spec.joints]
    known = {*mine, *without_affixes(mine, theirs, {}).values()}
    return [
        body
        for body in spec.worldbody.bodies
        if any(joint.name in known for joint in body.joints)
        and all(joint.type != JointKind.FREE for joint in body.joints)
    ]


def is_fused(spec: mujoco.MjSpec, joints: Collection[str]) -> bool:
    """Tells whether the world is the base: whether one of some joints is between it and a body."""
    there = (joint for body in spec.worldbody.bodies for joint in body.joints)
    return any(j.name in joints and j.type != JointKind.FREE for j in there)


def bodies_of(robot: Robot) -> dict[str, str]:
    """Returns {base or joint: the body that it moves}."""
    model = robot.mj_model
    bodies = {robot.base: robot.mj_base}
    for name in robot.joint_names:
        bodies[name] = str(model.body(int(model.jnt_bodyid[model.joint(name).id])).name)
    return bodies


def mjcf_tree(
    spec: mujoco.MjSpec, source: Path, base: str = "", frames: Iterable[str] = ()
) -> multibody.MultibodyTree:
    """Returns the parameters of an MJCF's joints and bodies, in the frame of its base.

    Args:
        spec: The MJCF; all its joints but a free one are named hinges or slides.
        source: Where it came from, for messages.
        base: What its base is called.
        frames: Bodies and sites whose places count.

    Raises:
        ModelError: If MuJoCo cannot compile it.
    """
    compiled = compile_spec(spec.copy(), source)
    model = pinocchio_from_mujoco(compiled)
    names = [joint.name for joint in spec.joints if joint.type != JointKind.FREE]
    tree = multibody.from_pinocchio(model, base, names, {name: name for name in frames})
    if tree.floating or not names:
        return tree
    body = int(compiled.jnt_bodyid[compiled.joint(names[0]).id])
    while compiled.body_weldid[body] != 0:
        body = int(compiled.body_parentid[body])
    data = mujoco.MjData(compiled)
    mujoco.mj_kinematics(compiled, data)
    return with_base(tree, placement_of(data.xquat[body], data.xpos[body]).inverse())


_CLOSING = (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD)


def _refuse_loops(spec: mujoco.MjSpec, gone: Collection[str], source: Path) -> None:
    """Refuses loops, and couplings through joints that only the MJCF has: held, they would bind.

    A rod that is held at zero would hold the ankle that it turns.
    """
    for equality in spec.equalities if gone else ():
        ends = {equality.name1, equality.name2} - {""}
        coupled = equality.type == mujoco.mjtEq.mjEQ_JOINT and not ends.isdisjoint(gone)
        coupled = coupled and not ends.issubset(gone)
        if equality.active and (coupled or equality.type in _CLOSING):
            raise ModelError(source, diagnose("loops-through-other-joints", joints=gone))
