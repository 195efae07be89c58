"""Matching of a URDF and an MJCF of the same robot: same base, same joints, same names.

Input: two files. Output: a ``Match`` with a ``Robot`` built from both. Method:

1. Objects of a scene are removed from the MJCF.
2. Joints are paired. Joints that only one file contains are fixed at zero.
3. If the masses indicate that one file lacks a part (gripper, tail, head), the part is removed and
   reported.
4. The URDF is converted to the base frame and joint zeros of the MJCF.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from lxml import etree

from pupper_analysis.base.arrays import make_placement
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
from pupper_analysis.models.efforts import find_null_efforts
from pupper_analysis.models.mjcf import JointKind, compile_spec, name_elements
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.multibody import TreeJoint
from pupper_analysis.models.spec_tree import (
    SpecTree,
    delete_joint,
    join_free_base,
    write_joint_parameter,
)
from pupper_analysis.models.urdf_file import UrdfFile, to_engine_xml
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.robot.build import build_robot
from pupper_analysis.robot.matching.alignment import with_base
from pupper_analysis.robot.matching.conventions import (
    Conventions,
    apply_conventions,
    describe_pose,
    find_conventions,
)
from pupper_analysis.robot.matching.pairs import common_frames, match_joints, match_without_affixes
from pupper_analysis.robot.matching.sources import MjcfSources, Sources, UrdfSources
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.robot.matching.trees import (
    Mimics,
    Reference,
    base_pose,
    fix_other_joints,
    kinematic_trees,
    links_of,
    remove_base_mass,
    strip_roots,
    urdf_mimics,
    urdf_tree,
    without_shapes,
)
from pupper_analysis.robot.robot import Robot


@dataclass(frozen=True)
class RemovablePart:
    """Part of a robot (subtree) whose joints the other file lacks, so that the part may be removed.

    Attributes:
        root: Link or body at the root of the subtree.
        parent_joint: Nearest moving joint above the part, as named in the file; "" for the base.
        joints: Joints of the part.
        mass: Mass [kg] of the part.
    """

    root: str
    parent_joint: str
    joints: tuple[str, ...]
    mass: float


def report_part(part: RemovablePart, has: str, lacks: str) -> Diagnostic:
    """Return the diagnostic of a part that one file contains and the other file lacks.

    Args:
        part: The part.
        has: Type of the file with the part, "URDF" or "MJCF".
        lacks: Type of the file without the part, "MJCF" or "URDF".
    """
    return diagnose(
        "part-of-one-file",
        subject=("link" if has == "URDF" else "body", part.root),
        has=has,
        lacks=lacks,
        carrier=part.parent_joint,
        mass=Quantity(part.mass, "kg"),
        joints=part.joints,
    )


Removals = list[tuple[str, list[list[RemovablePart]]]]
"""Parts of a file that could be removed: [(parent joint, alternatives)]. An alternative is a list
of parts that are removed together. The alternatives are sorted from small to large parts."""


def list_removals(tree: ModelTree, extra: Collection[str]) -> Removals:
    """List the parts (subtrees) of a file that could be removed: the other file lacks their joints.

    The root of a part is the link that a missing joint moves, or a link above this link on a fixed
    joint.

    Args:
        tree: Tree of the file with the parts.
        extra: Joints that the other file lacks.

    Returns:
        [(parent joint, alternatives)], see `Removals`. The parent joint is the nearest moving joint
        above the parts, "" for the base.
    """
    chains: dict[str, list[list[RemovablePart]]] = {}
    for name in tree.names:
        link: str | None = name if set(tree.movers(name)) & set(extra) else None
        chain: list[RemovablePart] = []
        while link is not None and (part := _make_part(tree, link, extra)) is not None:
            chain.append(part)
            parent = tree.parent(link)
            link = (
                parent
                if parent is not None and not tree.movers(parent) and tree.parent(parent)
                else None
            )
        if chain and chain[0].parent_joint not in extra:  # otherwise removed together with it
            chains.setdefault(chain[0].parent_joint, []).append(chain)
    removals = []
    for parent_joint, part_chains in chains.items():
        alternatives = []
        for level in range(max(map(len, part_chains))):
            parts = dict.fromkeys(
                part_chain[min(level, len(part_chain) - 1)] for part_chain in part_chains
            )
            alternatives.append(
                [
                    part
                    for part in parts
                    if not any(set(part.joints) < set(larger_part.joints) for larger_part in parts)
                ]
            )
        removals.append((parent_joint, alternatives))
    return removals


def _make_part(tree: ModelTree, link: str, extra: Collection[str]) -> RemovablePart | None:
    """Return the subtree of a link as a removable part; None if a joint is not in ``extra``."""
    inside = list(tree.subtree(link))
    joints = tuple(joint for name in inside for joint in tree.movers(name))
    if any(joint not in extra for joint in joints):
        return None
    parent = tree.parent(link)
    while parent is not None and not tree.movers(parent):
        parent = tree.parent(parent)
    mover = tree.movers(parent)[-1] if parent is not None else ""
    return RemovablePart(link, mover, joints, sum(map(tree.link_mass, inside)))


def remove_parts(
    trees: tuple[UrdfTree, SpecTree],
    files: tuple[Path, Path],
    removals: tuple[Removals, Removals],
    pairs: Mapping[str, str],
) -> list[Diagnostic]:
    """Remove the parts of each file that the other file lacks, in place, and report these parts.

    For each body with such parts, the parts are removed with which the mass of the body differs
    least from the mass in the other file before any removal. This may be no part.

    Args:
        trees: Trees of URDF and MJCF; modified.
        files: URDF and MJCF.
        removals: Alternatives for both files, from ``list_removals``.
        pairs: {joint in the URDF: joint in the MJCF}.

    Returns:
        A diagnostic of each removed part.
    """
    if not any(removals):
        return []
    urdf = urdf_tree(trees[0].root, files[0])
    mjcf = mjcf_tree(compile_spec(trees[1].spec.copy(), files[1]))
    notes = []
    for tree, alternatives_by_joint, own_tree, other_tree, file_types in (
        (trees[0], removals[0], urdf, mjcf, ("URDF", "MJCF")),
        (trees[1], removals[1], mjcf, urdf, ("MJCF", "URDF")),
    ):
        for parent_joint, alternatives in alternatives_by_joint:
            name = (
                pairs.get(parent_joint, parent_joint) if file_types[0] == "URDF" else parent_joint
            )
            if name not in own_tree.bodies or name not in other_tree.bodies:
                continue
            excess = own_tree.bodies[name].mass - other_tree.bodies[name].mass
            remaining = [
                abs(excess - sum(part.mass for part in parts)) for parts in ([], *alternatives)
            ]
            # The smallest alternative within a milligram of the best.
            best_index = next(
                index for index, mass in enumerate(remaining) if mass <= min(remaining) + 1e-6
            )
            for part in ([], *alternatives)[best_index]:
                notes.append(report_part(part, *file_types))
                tree.remove_subtree(part.root)
    return notes


@dataclass(frozen=True, eq=False)
class Match:
    """Matched URDF and MJCF of a robot: robot of both files, names, and removed differences.

    Attributes:
        robot: Robot of both files, with the joint names of the MJCF.
        urdf_joint: {joint: name in the URDF}.
        urdf_link: {base or joint: link of the URDF that moves with it}.
        mjcf_body: {base or joint: body of the MJCF that moves with it}.
        guessed: {joint in the URDF: joint in the MJCF} of pairs with different names, matched by
            structure, or by names without prefixes and suffixes.
        only_urdf: Joints that the MJCF lacks, including floating and planar joints; fixed at zero
            for the comparison.
        only_mjcf: Joints that the URDF lacks, including ball joints; fixed at zero for the
            comparison.
        notes: Diagnostics of assumptions and omissions.
        reference: Compiled model of the MJCF with the whole scene. If the URDF lacks joints, it is
            the model of the robot without the scene, with these joints fixed at zero.
        conventions: Original base frame and joint zeros of the URDF, relative to the MJCF. The URDF
            was converted to the base frame and joint zeros of the MJCF.
        parts: Diagnostics of parts that only one file has; removed for the comparison.
        unstated: {"damping" or "friction": joints whose URDF has no value, so that the value of the
            MJCF was copied}.
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
    conventions: Conventions
    parts: tuple[Diagnostic, ...]
    unstated: Mapping[str, tuple[str, ...]]

    @cached_property
    def urdf_tree(self) -> UrdfTree:
        """Links and joints of the matched URDF (``description.urdf`` of the robot)."""
        return UrdfTree.of(self.robot.description.urdf)

    def sources(self, urdf: UrdfFile, mjcf: MjcfFile) -> tuple[Sources, Sources]:
        """Return two objects that find file and line of a value: in the URDF, and in the MJCF."""
        base = tuple(dict.fromkeys((self.robot.base, self.reference.base)))
        frames = self.robot.description.frames
        urdf_sources = UrdfSources(
            file=urdf,
            tree=self.urdf_tree,
            links=self.urdf_link,
            joints=self.urdf_joint,
            frames={name: link for name, (link, _) in frames.items()},
            base=base,
        )
        mjcf_sources = MjcfSources(
            file=mjcf,
            model=self.robot.mj_model,
            bodies=self.mjcf_body,
            frames={name: site for name, (_, site) in frames.items()},
            base=base,
            renumbered=bool(self.only_mjcf),
        )
        return urdf_sources, mjcf_sources


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
    """Match a URDF and an MJCF of the same robot, and build a robot with equal names from both.

    Joints that only one file contains are fixed at zero. If the base of the MJCF is fixed, the base
    of the URDF is fixed as well.

    Args:
        urdf: The URDF.
        mjcf: The MJCF.
        names: {name in the URDF: name in the MJCF} of joints or frames whose names differ. Other
            joints are matched by name or structure, other frames by name.
        feet: Frames, as named in the MJCF, whose positions are compared; all common frames by
            default.
        complete: Whether the robot keeps the URDF's shapes, and parts that only one file contains.
        tolerances: Tolerances of the comparison.
        strict: If True, damping or friction that the URDF does not state is 0. If False, the value
            of the MJCF is used.

    Raises:
        ModelError: If too few joints match, or if a file cannot be analysed, for example.
        UnknownNameError: If ``names`` or ``feet`` contain unknown names.
    """
    trees = _prepare_trees(urdf, mjcf, with_shapes=complete)
    root, spec, tree = trees.root, trees.spec, trees.mjcf_tree
    notes = [*urdf.notes, *mjcf.notes, *trees.notes]
    requested = dict(names or {})
    urdf_joints, mjcf_joints = trees.urdf_joints, trees.mjcf_joints
    _check_mapping(requested, (urdf_joints, root, urdf.path), (mjcf_joints, spec, mjcf.path))
    matched = match_joints(
        root, tree, (urdf.path, mjcf.path), (urdf_joints, mjcf_joints), requested
    )
    pairs, notes = matched.pairs, [*notes, *matched.notes]
    if is_fused(spec, pairs.values()):
        notes += remove_base_mass(root, urdf.path)
    only_urdf, only_mjcf = trees.list_unmatched_joints(pairs)
    for key in list(spec.keys):
        spec.delete(key)  # the number of coordinates may have changed
    if complete:
        _refuse_loops(spec, only_mjcf, trees.deleted_balls, mjcf.path)
    sides, paths = (UrdfTree(root), SpecTree(spec)), (urdf.path, mjcf.path)
    removals = list_removals(sides[0], only_urdf), list_removals(sides[1], only_mjcf)
    mimics = _unify_joints(root, spec, pairs, only_urdf, only_mjcf)
    # The weight of the parts affects a stand, so a complete robot keeps the parts.
    parts = [] if complete else remove_parts(sides, paths, removals, pairs)
    models = trees.scene_model, _choose_values_model(mjcf, trees)
    notes += copy_unknown_values(root, spec, models, {} if strict else mjcf.unknown, mjcf.path)
    unstated = {} if strict else copy_unstated_values(root, tree.joints, urdf.unknown, pairs)
    frames = common_frames(root, spec, requested)
    _check_foot_frames(feet, frames, urdf.path)
    description = Description(
        name=spec.modelname,
        urdf=to_engine_xml(root),
        urdf_source=urdf.path,
        mjcf=spec,
        mjcf_source=mjcf.path,
        contact_points={},
        frames={name: frames[name] for name in feet or frames},
        null_efforts=find_null_efforts(mjcf),
    )
    robot, conventions, base_notes = _build_in_mjcf_convention(
        root, description, tolerances or Tolerances()
    )
    described = replace(robot.description, mimics=_shift_mimics(mimics, conventions))
    robot = replace(robot, description=described)
    return Match(
        robot=robot,
        urdf_joint={new: old for old, new in pairs.items()},
        urdf_link=links_of(root, robot),
        mjcf_body=bodies_of(robot),
        guessed=matched.guessed,
        only_urdf=only_urdf,
        only_mjcf=only_mjcf,
        notes=(*notes, *base_notes),
        reference=Reference(
            robot.mj_model if only_mjcf else models[1],
            robot.mj_model if only_mjcf else trees.scene_model,
            robot.joint_names,
            robot.mj_base,
        ),
        conventions=conventions,
        parts=tuple(parts),
        unstated=unstated,
    )


class _PreparedTrees(NamedTuple):
    """Trees of both files with only the robot's links and joints, before the joints are matched.

    Attributes:
        root: Root element of the URDF (a copy), in which all joints are fixed, hinges or slides.
        spec: Spec of the MJCF (a copy), without other objects and ball joints.
        mjcf_tree: Joints and links of ``spec``.
        scene_model: Compiled MJCF, with the objects and joints that ``spec`` lacks.
        is_base_joined: Whether a free joint replaced other joints of a free base in ``spec``, for
            example three slides and three hinges.
        urdf_joints: Hinges and slides of the URDF.
        mjcf_joints: Hinges and slides of the MJCF.
        fixed_urdf_joints: Joints of the URDF that were fixed.
        deleted_balls: Ball joints of the MJCF that were deleted.
        notes: Notes about the changes.
    """

    root: etree._Element
    spec: mujoco.MjSpec
    mjcf_tree: multibody.MultibodyTree
    scene_model: mujoco.MjModel
    is_base_joined: bool
    urdf_joints: list[str]
    mjcf_joints: list[str]
    fixed_urdf_joints: list[str]
    deleted_balls: list[str]
    notes: list[Diagnostic]

    def list_unmatched_joints(
        self, pairs: Mapping[str, str]
    ) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return the joints of URDF and MJCF without partner in ``pairs``, {URDF: MJCF}."""
        partners = set(pairs.values())
        return (
            (*self.fixed_urdf_joints, *(name for name in self.urdf_joints if name not in pairs)),
            (*self.deleted_balls, *(name for name in self.mjcf_joints if name not in partners)),
        )


def _prepare_trees(urdf: UrdfFile, mjcf: MjcfFile, *, with_shapes: bool) -> _PreparedTrees:
    """Copy both files, reduced to the robot with its hinges and slides."""
    root = copy.deepcopy(urdf.root) if with_shapes else without_shapes(urdf.root)
    urdf_joint_names, spec = set(UrdfTree(root).joints), mjcf.spec.copy()
    naming_notes = name_elements(spec, urdf_joint_names)
    joined = join_free_base(spec, stated=urdf_joint_names)
    scene_model = compile_spec(spec.copy(), mjcf.path)  # includes the objects removed below
    scene_notes = drop_other_objects(spec, mjcf.path, root)
    mjcf_joints, balls, ball_notes = delete_ball_joints(spec, mjcf.path)
    tree = mjcf_tree(compile_spec(spec.copy(), mjcf.path))
    root, root_notes = strip_roots(root, urdf.path, tree)
    urdf_joints, other_urdf_joints, fixed_notes = fix_other_joints(root)
    notes = [*naming_notes, *([joined] if joined else [])]
    notes += [*scene_notes, *ball_notes, *root_notes, *fixed_notes]
    return _PreparedTrees(
        root,
        spec,
        tree,
        scene_model,
        bool(joined),
        urdf_joints,
        mjcf_joints,
        other_urdf_joints,
        balls,
        notes,
    )


def _choose_values_model(mjcf: MjcfFile, trees: _PreparedTrees) -> mujoco.MjModel:
    """Return a compiled model of the MJCF that `copy_unknown_values` may change."""
    if trees.is_base_joined:
        return trees.scene_model
    return copy.copy(mjcf.model) if mjcf.unknown else mjcf.model  # a copy is slow


def _check_foot_frames(
    feet: Sequence[str], frames: Mapping[str, tuple[str, str]], urdf: Path
) -> None:
    """Raise an UnknownNameError if a foot is not in ``frames``, the frames of both files."""
    for foot in feet:
        if foot not in frames:
            raise UnknownNameError(urdf, "frame of both files (for a foot)", foot, frames)


def _build_in_mjcf_convention(
    root: etree._Element, description: Description, tolerances: Tolerances
) -> tuple[Robot, Conventions, list[Diagnostic]]:
    """Build the robot; its URDF is converted, in place, to the MJCF's joint zeros and base frame.

    Returns the robot, the differences before the conversion, and notes about a fixed base.
    """
    robot = build_robot(description)
    conventions, notes = _compare_conventions(robot, tolerances)
    if conventions.base is not None or conventions.zeros:
        apply_conventions(root, robot.base, conventions, kinematic_trees(robot)[0])
        text = to_engine_xml(root)
        robot = build_robot(replace(description, urdf=text))
    return robot, conventions, notes


def _compare_conventions(
    robot: Robot, tolerances: Tolerances
) -> tuple[Conventions, list[Diagnostic]]:
    """Return differences of base frame and joint zeros; diagnostics of a fixed base's pose."""
    urdf, mjcf = kinematic_trees(robot)
    if robot.floating:
        return find_conventions(urdf, mjcf, tolerances, fixed=False), []
    pose, notes, base = base_pose(robot), [], ("body", robot.mj_base)
    if not pose.isIdentity(1e-9):
        notes.append(diagnose("fixed-base-stands", subject=base, pose=describe_pose(pose)))
    urdf_in_base, mjcf_in_base = (with_base(tree, pose.inverse()) for tree in (urdf, mjcf))
    conventions = find_conventions(urdf_in_base, mjcf_in_base, tolerances, fixed=True)
    if conventions.base is not None and conventions.shown:
        notes.append(
            diagnose("fixed-base-frame-moved", subject=base, pose=describe_pose(conventions.base))
        )
    return conventions, notes


def _shift_mimics(mimics: Mimics, conventions: Conventions) -> Mimics:
    """Convert the URDF's mimic couplings to the zero positions of the MJCF's joints."""
    zeros = conventions.zeros
    return {
        name: (
            leader,
            multiplier,
            offset + multiplier * zeros.get(leader, 0.0) - zeros.get(name, 0.0),
        )
        for name, (leader, multiplier, offset) in mimics.items()
    }


def _check_mapping(
    wanted: Mapping[str, str],
    urdf: tuple[Sequence[str], etree._Element, Path],
    mjcf: tuple[Sequence[str], mujoco.MjSpec, Path],
) -> None:
    """Raise an error if ``wanted`` {URDF name: MJCF name} has unknown or repeated names."""
    (urdf_joints, root, source), (mjcf_joints, spec, target) = urdf, mjcf
    links = UrdfTree(root).links
    frame_names = {element.name for element in (*spec.sites, *spec.bodies, *spec.geoms)}
    for old, new in wanted.items():
        if old not in urdf_joints and old not in links:
            raise UnknownNameError(source, "joint or link (of a mapping)", old, urdf_joints)
        if old in urdf_joints and old not in links and new not in mjcf_joints:
            raise UnknownNameError(target, "joint (of a mapping)", new, mjcf_joints)
        if new not in mjcf_joints and new not in frame_names:
            raise UnknownNameError(target, "joint or frame (of a mapping)", new, mjcf_joints)
        rivals = [name for name, value in wanted.items() if value == new and name != old]
        if rivals:
            duplicates = (old, rivals[0])
            raise ModelError(source, diagnose("names-mapped-to-one", names=duplicates, other=new))


def _unify_joints(
    root: etree._Element,
    spec: mujoco.MjSpec,
    pairs: Mapping[str, str],
    only_urdf: Collection[str],
    only_mjcf: Collection[str],
) -> Mimics:
    """Fix the joints that one file lacks, and give URDF joints the names of the MJCF, in place.

    The mimic couplings are removed from the URDF; the couplings of matched joints are returned.
    """
    mjcf_names = {*pairs.values(), *only_mjcf}
    mimics = {
        pairs[name]: (pairs.get(leader, leader), multiplier, offset)
        for name, (leader, multiplier, offset) in urdf_mimics(root).items()
        if name in pairs
    }
    tree = UrdfTree(root)
    tree.fix(only_urdf)
    for joint in list(spec.joints):
        if joint.name in only_mjcf:
            delete_joint(spec, joint)
    for name, joint in tree.joints.items():
        # An unmatched joint must not have the name of a joint of the MJCF.
        joint.element.set("name", pairs.get(name, f"{name} (URDF)" if name in mjcf_names else name))
        joint.remove("mimic")
    return mimics


def copy_unstated_values(
    root: etree._Element,
    mjcf_joints: Mapping[str, TreeJoint],
    unknown: Mapping[str, tuple[str, ...]],
    pairs: Mapping[str, str],
) -> dict[str, tuple[str, ...]]:
    """Copy damping and friction of the MJCF to joints of a URDF that state no value, in place.

    Efforts that the URDF states as unknown are copied as well, but the result does not list them.

    Args:
        root: Root element of the URDF, with the MJCF's joint names; modified.
        mjcf_joints: {name: joint of the MJCF}.
        unknown: {kind: joints} of values that the URDF states as unknown (`UrdfFile.unknown`).
        pairs: {joint in the URDF file: joint in the MJCF}.

    Returns:
        {``damping`` or ``friction``: joints with copied values}.
    """
    optional = [attribute for attribute in PASSIVE_ATTRIBUTES if attribute.is_in_both_formats]
    copied: dict[str, list[str]] = {attribute.kind: [] for attribute in optional}
    movable_joints = [joint for joint in UrdfTree(root).joints.values() if not joint.is_fixed]
    incomplete = [
        joint
        for joint in movable_joints
        if any(joint.parameter_text(attribute) is None for attribute in optional)
    ]
    if not (incomplete or unknown.get("effort")):
        return dict.fromkeys(copied, ())
    effort = BY_KIND["effort"]
    for name in (pairs.get(name, name) for name in unknown.get("effort", ())):
        if name in mjcf_joints and math.isfinite(mjcf_joints[name].effort):
            UrdfTree(root).joints[name].set_parameter(effort, mjcf_joints[name].effort)
    for joint in incomplete:
        for attribute in optional if joint.name in mjcf_joints else ():
            value = float(getattr(mjcf_joints[joint.name], attribute.field))
            if value and joint.parameter_text(attribute) is None:
                joint.set_parameter(attribute, value)
                copied[attribute.kind].append(joint.name)
    return {kind: tuple(names) for kind, names in copied.items()}


def copy_unknown_values(
    root: etree._Element,
    spec: mujoco.MjSpec,
    models: Collection[mujoco.MjModel],
    unknown: Mapping[str, tuple[str, ...]],
    source: Path,
) -> list[Diagnostic]:
    """Copy values of the URDF to joints of an MJCF that states these values as unknown, in place.

    Args:
        root: Root element of the URDF, with the MJCF's joint names.
        spec: The MJCF; modified.
        models: Compiled models of the MJCF; modified as well.
        unknown: {kind: joints} of unknown values (`MjcfFile.unknown`).
        source: File of the MJCF, for messages.

    Returns:
        Diagnostics of the copied values.
    """
    notes, urdf_joints = [], UrdfTree(root).joints
    mjcf_joints = {joint.name: joint for joint in spec.joints}
    for kind, names in unknown.items():
        attribute = BY_KIND[kind]
        texts = {
            name: urdf_joints[name].parameter_text(attribute)
            for name in names
            if name in urdf_joints.keys() & mjcf_joints
        }
        values = {name: float(value) for name, value in texts.items() if value is not None}
        if kind == "effort":  # 0 means unspecified in a URDF
            values = {name: value for name, value in values.items() if value > 0}
        for name, value in values.items():
            write_joint_parameter(mjcf_joints[name], attribute, value)
            for model in models if attribute.mujoco else ():
                getattr(model, attribute.mujoco)[model.jnt_dofadr[model.joint(name).id]] = value
        if values:
            notes.append(
                diagnose(
                    "unknown-taken-from-urdf", file=source.name, what=Term(kind), joints=values
                )
            )
    return notes


# Normalisation of an MJCF for matching.


def delete_ball_joints(
    spec: mujoco.MjSpec, source: Path
) -> tuple[list[str], list[str], list[Diagnostic]]:
    """Delete the ball joints of an MJCF, in place, because a URDF cannot contain them.

    Args:
        spec: MJCF; modified. If ball joints are deleted, the keyframes are deleted as well.
        source: File of the MJCF, for messages.

    Returns:
        Names of hinges and slides; names of ball joints; diagnostics of the ball joints.

    Raises:
        ModelError: If there are ball joints, but neither hinges nor slides.
    """
    names, balls = [], []
    for joint in list(spec.joints):
        if joint.type == JointKind.BALL:
            balls.append(joint.name)
            delete_joint(spec, joint)
        elif joint.type != JointKind.FREE:
            names.append(joint.name)
    if balls and not names:
        raise ModelError(source, diagnose("ball-joints-alone", joints=balls))
    if not balls:
        return names, balls, []
    for key in list(spec.keys):
        spec.delete(key)  # the number of coordinates has changed
    return names, balls, [diagnose("ball-joints-fixed", joints=balls)]


def drop_other_objects(
    spec: mujoco.MjSpec, source: Path, urdf: etree._Element | None
) -> list[Diagnostic]:
    """Delete scene objects, such as tables, that do not belong to the robot, in place.

    The robot is the child body of the world with the largest number of joints. MuJoCo's import of a
    URDF merges a fixed base with the world: the limbs are then children of the world, identified by
    the joint names of the URDF. The masses of kept mocap bodies are set to zero.

    Args:
        spec: Spec to modify.
        source: File, for messages.
        urdf: Root element of the URDF; None if two versions of an MJCF are compared. Without a
            URDF, no limbs and link names are known.

    Returns:
        Diagnostics of the deleted bodies.

    Raises:
        ModelError: If the spec has no joints.
    """
    object_types = mujoco.mjtObj
    links, limbs = set[str](), set[str]()
    if urdf is not None:
        links = set(UrdfTree(urdf).links)
        limbs = {body.name for body in limbs_on_the_world(spec, urdf)}
    num_joints = {
        body.name: len(body.find_all(object_types.mjOBJ_JOINT)) for body in spec.worldbody.bodies
    }
    if not any(num_joints.values()):
        raise ModelError(source, diagnose("no-joints"))
    robot = max(spec.worldbody.bodies, key=lambda body: num_joints[body.name])
    fixed = not any(joint.type == JointKind.FREE for joint in robot.joints)
    notes = []
    for body in list(spec.worldbody.bodies):
        names = {body.name, *(below.name for below in body.find_all(object_types.mjOBJ_BODY))}
        # Beside a free robot, static bodies other than the ground are scenery.
        scenery = not body.mocap and not (names & links if fixed else _has_plane(body))
        if body.name in limbs and robot.name in limbs:
            continue
        if body.mocap:
            _remove_mass(body)
        if body.name != robot.name and (num_joints[body.name] or scenery):
            subject = "body", body.name
            notes.append(
                diagnose("body-left-out", subject=subject, file=source.name, sources=source)
            )
            # MuJoCo rejects cameras and lights whose target does not exist.
            for element in (*spec.cameras, *spec.lights):
                if element.targetbody in names:
                    spec.delete(element)
            spec.delete(body)
    return notes


def _remove_mass(body: mujoco.MjsBody) -> None:
    """Set the masses of a mocap body and of its descendants to zero, in place.

    Otherwise these masses would be added to a fixed base.
    """
    for part in [body, *body.find_all(mujoco.mjtObj.mjOBJ_BODY)]:
        part.mass, part.inertia = 0.0, np.zeros(3)
        for geom in part.geoms:
            geom.mass = geom.density = 0.0


def _has_plane(body: mujoco.MjsBody) -> bool:
    """Return True if a body or a descendant has a plane."""
    geoms = body.find_all(mujoco.mjtObj.mjOBJ_GEOM)
    return any(geom.type == mujoco.mjtGeom.mjGEOM_PLANE for geom in geoms)


def limbs_on_the_world(spec: mujoco.MjSpec, urdf: etree._Element) -> list[mujoco.MjsBody]:
    """Return the children of the world that are limbs of the robot: they have joints of the URDF.

    MuJoCo's import of a URDF merges a fixed base with the world: the limbs of the robot are then
    children of the world. Names of joints may differ by prefixes and suffixes.

    Args:
        spec: The MJCF.
        urdf: Root element of the URDF.
    """
    urdf_joints = [joint.name for joint in UrdfTree(urdf).joints.values() if not joint.is_fixed]
    mjcf_joints = [joint.name for joint in spec.joints]
    joint_names = {*urdf_joints, *match_without_affixes(urdf_joints, mjcf_joints, {}).values()}
    return [
        body
        for body in spec.worldbody.bodies
        if any(joint.name in joint_names for joint in body.joints)
        and all(joint.type != JointKind.FREE for joint in body.joints)
    ]


def is_fused(spec: mujoco.MjSpec, joints: Collection[str]) -> bool:
    """Return True if the base of the robot is fused with the world, so that no body is the base.

    MuJoCo's import of a URDF, for example, fuses a fixed base with the world.

    Args:
        spec: The MJCF.
        joints: Names of joints of the robot.
    """
    world_joints = (joint for body in spec.worldbody.bodies for joint in body.joints)
    return any(joint.name in joints and joint.type != JointKind.FREE for joint in world_joints)


def bodies_of(robot: Robot) -> dict[str, str]:
    """Return the MJCF body that moves with each joint, {joint or base: name of the body}.

    The key of the base is the name of the base link.
    """
    model = robot.mj_model
    bodies = {robot.base: robot.mj_base}
    for name in robot.joint_names:
        bodies[name] = str(model.body(int(model.jnt_bodyid[model.joint(name).id])).name)
    return bodies


def mjcf_tree(
    compiled: mujoco.MjModel, base: str = "", frames: Iterable[str] = ()
) -> multibody.MultibodyTree:
    """Return the multibody tree of a compiled MJCF, expressed in the base frame.

    Args:
        compiled: MuJoCo model. All joints, except a free joint, must be hinges or slides with
            names.
        base: Name that the base gets in the tree.
        frames: Bodies and sites that become frames of the tree.
    """
    model = pinocchio_from_mujoco(compiled)
    names = [
        compiled.joint(joint).name
        for joint in range(compiled.njnt)
        if compiled.jnt_type[joint] != JointKind.FREE
    ]
    tree = multibody.from_pinocchio(model, base, names, {name: name for name in frames})
    if tree.floating or not names:
        return tree
    body = int(compiled.jnt_bodyid[compiled.joint(names[0]).id])
    while compiled.body_weldid[body] != 0:
        body = int(compiled.body_parentid[body])
    data = mujoco.MjData(compiled)
    mujoco.mj_kinematics(compiled, data)
    return with_base(tree, make_placement(data.xquat[body], data.xpos[body]).inverse())


_LOOP_TYPES = (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD)
"""Types of equality constraints that close kinematic loops."""


def _refuse_loops(
    spec: mujoco.MjSpec, fixed_joints: Collection[str], balls: Collection[str], source: Path
) -> None:
    """Raise a ModelError if fixed joints may block closed loops or couplings of an MJCF.

    Ball joints (``balls``) are reported first, since they are fixed without the URDF, too.
    """
    for equality in spec.equalities if fixed_joints else ():
        names = {equality.name1, equality.name2} - {""}
        is_coupled = equality.type == mujoco.mjtEq.mjEQ_JOINT and not names.isdisjoint(fixed_joints)
        is_coupled = is_coupled and not names.issubset(fixed_joints)
        if equality.active and (is_coupled or equality.type in _LOOP_TYPES):
            code = "loops-with-ball-joints" if balls else "loops-through-other-joints"
            raise ModelError(source, diagnose(code, joints=balls or fixed_joints))
