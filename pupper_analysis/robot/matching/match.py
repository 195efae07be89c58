"""Brings a URDF and an MJCF of one robot to the same base, the same joints and the same names.

Parts that one file has and the other lacks (a gripper, a tail, a head) are left out, and said.
"""

from __future__ import annotations

import copy
import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import mujoco
from lxml import etree

from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Term,
    diagnose,
)
from pupper_analysis.base.errors import InputError, ModelError, UnknownNameError
from pupper_analysis.base.inputs import read_toml
from pupper_analysis.models.attributes import BY_KIND, PASSIVE
from pupper_analysis.models.description import Description, ModelTree
from pupper_analysis.models.free_base import delete_joint, join_free_base
from pupper_analysis.models.mjcf import compile_spec, name_all
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.multibody import TreeJoint
from pupper_analysis.models.places import refuse_input
from pupper_analysis.models.spec_tree import SpecTree, state_number
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
from pupper_analysis.robot.matching.mjcf import (
    ball_joints,
    bodies_of,
    drop_other_objects,
    is_fused,
    list_hinges,
    mjcf_tree,
    open_loops,
)
from pupper_analysis.robot.matching.pairs import common_frames, pair_up
from pupper_analysis.robot.matching.sources import MjcfSources, Sources, UrdfSources
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.robot.matching.trees import Reference, base_pose, kinematic_trees
from pupper_analysis.robot.matching.urdf import (
    Mimics,
    links_of,
    moving_joints,
    strip_roots,
    take_mass_of_base,
    urdf_mimics,
    urdf_tree,
    without_shapes,
)
from pupper_analysis.robot.robot import Robot

_KINDS = (
    ("gripper", re.compile(r"finger|grip|jaw|claw|pinch", re.IGNORECASE)),
    ("hand", re.compile(r"hand|thumb|palm", re.IGNORECASE)),
    ("head", re.compile(r"head|neck", re.IGNORECASE)),
    ("tail", re.compile(r"tail", re.IGNORECASE)),
    ("arm", re.compile(r"(^|_)arm", re.IGNORECASE)),
)


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
    names = [part.root, *part.joints]
    kind = next(
        (word for word, pattern in _KINDS if any(pattern.search(name) for name in names)), "part"
    )
    return diagnose(
        "part-of-one-file",
        subject=("link" if has == "URDF" else "body", part.root),
        has=has,
        lacks=lacks,
        kind=Term(kind),
        arm=kind == "arm",
        carrier=part.carrier,
        mass=Quantity(part.mass, "kg"),
        joints=part.joints,
    )


def best_parts(candidates: list[list[RemovablePart]], short: float) -> list[RemovablePart]:
    """Chooses how much to take off a carrier, so that its mass becomes the other file's.

    Args:
        candidates: Ways to take off the joints that one file lacks, the least first.
        short: How much heavier the carrier is than in the other file with all of it left on (kg).

    Returns:
        The parts to be taken off; none if the mass fits best with them left on, at rest.
    """
    best: list[RemovablePart] = []
    least = abs(short)
    for parts in candidates:
        off = abs(short - sum(part.mass for part in parts))
        if off < least - 1e-6:
            best, least = parts, off
    return best


def parts_of(tree: ModelTree, extra: Collection[str]) -> dict[str, list[list[RemovablePart]]]:
    """Returns {carrier: ways to take off the joints of a file that the other one lacks}."""

    def part(link: str) -> RemovablePart | None:
        inside = list(tree.subtree(link))
        joints = tuple(joint for name in inside for joint in tree.movers(name))
        if any(joint not in extra for joint in joints):
            return None
        carrier = tree.parent(link)
        while carrier is not None and not tree.movers(carrier):
            carrier = tree.parent(carrier)
        mover = tree.movers(carrier)[-1] if carrier is not None else ""
        return RemovablePart(link, mover, joints, sum(map(tree.weight, inside)))

    def holder(link: str) -> str | None:
        up = tree.parent(link)
        return up if up is not None and not tree.movers(up) and tree.parent(up) else None

    tops = [part(link) for link in tree.names if set(tree.movers(link)) & set(extra)]
    return _removals([top for top in tops if top is not None], part, holder)


def _removals(
    tops: list[RemovablePart],
    part: Callable[[str], RemovablePart | None],
    parent: Callable[[str], str | None],
) -> dict[str, list[list[RemovablePart]]]:
    """Returns {carrier: the parts as they move, and then with more and more of what holds them}."""
    largest = [
        top for top in tops if not any(set(top.joints) < set(other.joints) for other in tops)
    ]
    removals: dict[str, list[list[RemovablePart]]] = {}
    for carrier in dict.fromkeys(top.carrier for top in largest):
        level = [top for top in largest if top.carrier == carrier]
        removals[carrier] = [level]
        while True:
            higher: dict[str, RemovablePart] = {}
            for each in level:
                up = parent(each.root)
                found = part(up) if up is not None else None
                higher[found.root if found else each.root] = found or each
            if set(higher) == {each.root for each in level}:
                break
            level = [
                each
                for each in higher.values()
                if not any(set(each.joints) < set(other.joints) for other in higher.values())
            ]
            removals[carrier].append(level)
    return removals


Removals = Mapping[str, list[list[RemovablePart]]]


def removable_subtrees(
    trees: tuple[UrdfTree, SpecTree], only_urdf: Collection[str], only_mjcf: Collection[str]
) -> tuple[Removals, Removals]:
    """Returns the ways to take off the joints that one file lacks, of the URDF and of the MJCF."""
    return parts_of(trees[0], only_urdf), parts_of(trees[1], only_mjcf)


def take_off(
    trees: tuple[UrdfTree, SpecTree],
    files: tuple[Path, Path],
    removals: tuple[Removals, Removals],
    pairs: Mapping[str, str],
) -> list[Diagnostic]:
    """Takes off what one file has and the other lacks, where masses say so; returns what it is."""
    if not any(removals):
        return []
    one, two = urdf_tree(trees[0].root, files[0]), mjcf_tree(trees[1].spec, files[1])
    said = []
    for tree, candidates, here, there, words in (
        (trees[0], removals[0], one, two, ("URDF", "MJCF")),
        (trees[1], removals[1], two, one, ("MJCF", "URDF")),
    ):
        for carrier, way in candidates.items():
            name = pairs.get(carrier, carrier) if words[0] == "URDF" else carrier
            if name not in here.bodies or name not in there.bodies:
                continue
            short = here.bodies[name].mass - there.bodies[name].mass
            for part in best_parts(way, short):
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
        cut_joints: Those of these by which closed loops led, which were cut.
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
    cut_joints: tuple[str, ...]
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
            movers={body: mover for mover, body in self.mjcf_body.items()},
            base=base,
        )
        two = MjcfSources(
            file=mjcf,
            model=self.robot.mj_model,
            bodies=self.mjcf_body,
            frames={name: site for name, (_, site) in frames.items()},
            base=base,
            renumbered=bool(self.only_mjcf),  # the numbers are those of what was left
        )
        return one, two


def read_mapping(path: Path) -> dict[str, str]:
    """Reads names from a TOML file: ``"name in the URDF" = "name in the MJCF"``, a line each.

    Raises:
        ModelError: If it cannot be read, or holds anything but text.
    """
    try:
        _, values = read_toml(path)
    except InputError as error:
        raise refuse_input(path, error) from error
    for name, value in values.items():
        if not isinstance(value, str):
            problem = diagnose("mapping-not-a-name", subject=("joint", name), value=repr(value))
            raise ModelError(path, problem)
    return values


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
        ModelError: If the two have no joint in common, or one cannot be analysed.
        UnknownNameError: If ``names`` or ``feet`` name what is not there.
    """
    root = copy.deepcopy(urdf.root) if complete else without_shapes(urdf.root)
    taken, spec = set(UrdfTree(root).joints), mjcf.spec.copy()
    named = name_all(spec, taken)
    joined = join_free_base(spec, mjcf.path, stated=taken)
    whole = compile_spec(spec.copy(), mjcf.path)  # what is dropped below is still in it
    dropped = drop_other_objects(spec, mjcf.path, root)
    at_bodies = ball_joints(spec)
    theirs, balls, held = list_hinges(spec, mjcf.path)
    tree = mjcf_tree(spec, mjcf.path)
    root, stripped = strip_roots(root, urdf.path, tree)
    mine, others, fixed = moving_joints(root)
    notes = [*urdf.notes, *mjcf.notes, *named, *([joined] if joined else [])]
    notes += [*dropped, *held, *stripped, *fixed]
    wanted = dict(names or {})
    _check_names(wanted, (mine, root, urdf.path), (theirs, spec, mjcf.path))
    found = pair_up(root, spec, tree, (urdf.path, mjcf.path), (mine, theirs), wanted)
    pairs, notes = found.pairs, [*notes, *found.notes]
    if is_fused(spec, pairs.values()):
        notes += take_mass_of_base(root, urdf.path)
    only_urdf = (*others, *(name for name in mine if name not in pairs))
    partners = set(pairs.values())
    only_mjcf = (*balls, *(name for name in theirs if name not in partners))
    for key in list(spec.keys):
        spec.delete(key)  # its size may no longer fit
    opened, freed = open_loops(spec, at_bodies, only_mjcf) if complete else ((), [])
    sides, paths = (UrdfTree(root), SpecTree(spec)), (urdf.path, mjcf.path)
    removals = removable_subtrees(sides, only_urdf, only_mjcf)
    mimics = _make_alike(root, spec, pairs, only_urdf, only_mjcf)
    # In a robot that shall stand, what one file lacks is weight: it stays.
    parts = [] if complete else take_off(sides, paths, removals, pairs)
    own = copy.copy(mjcf.model) if mjcf.unknown else mjcf.model  # as long as compiling
    models = whole, whole if joined else own
    notes += take_unknown(root, spec, models, {} if strict else mjcf.unknown, mjcf.path)
    unstated = {} if strict else take_unstated(root, tree.joints, urdf.unknown, pairs)
    frames = common_frames(root, spec, wanted)
    _check_feet(feet, frames, urdf.path)
    description = _described(root, spec, (urdf, mjcf), {n: frames[n] for n in feet or frames})
    robot, meant, moved = _in_one_convention(root, description, tolerances or Tolerances())
    return Match(
        robot=robot,
        urdf_joint={new: old for old, new in pairs.items()},
        urdf_link=links_of(root, robot),
        mjcf_body=bodies_of(robot),
        guessed=found.guessed,
        only_urdf=only_urdf,
        only_mjcf=only_mjcf,
        cut_joints=opened,
        notes=(*notes, *freed, *moved),
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


def _described(
    root: etree._Element,
    spec: mujoco.MjSpec,
    files: tuple[UrdfFile, MjcfFile],
    frames: Mapping[str, tuple[str, str]],
) -> Description:
    """Describes a robot by two files that have been made alike."""
    urdf, mjcf = files
    return Description(
        name=spec.modelname,
        urdf=for_engines(root),
        urdf_source=urdf.path,
        mjcf=spec,
        mjcf_source=mjcf.path,
        contact_points={},
        frames=frames,
    )


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
    optional = [one for one in PASSIVE if one.in_both]
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
