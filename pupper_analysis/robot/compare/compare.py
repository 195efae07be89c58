"""Comparison of a robot's URDF and MJCF: agreement, differences, and causes of differences.

The world pose of a fixed base is no difference: before the comparison, the URDF is moved to the
base of the MJCF. A tilt of the base is reported, because a tilt changes the torques for users of
the unmodified URDF.

Collision shapes of feet are compared by height: another radius changes the height of the robot, and
a missing shape lets the robot fall. The form of a foot (such as a sphere instead of a mesh) and
other collision shapes are not compared.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import ClassVar

import mujoco
import numpy as np
from lxml import etree

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Term,
    diagnose,
)
from pupper_analysis.base.errors import PupperAnalysisError
from pupper_analysis.base.results import Tabular
from pupper_analysis.base.tools import find_tool_modules
from pupper_analysis.base.units import DOWNWARD_GRAVITY, select_joint_units
from pupper_analysis.models.loading import read_as_mjcf, read_as_urdf
from pupper_analysis.models.mjcf import make_start_data, silence_mujoco
from pupper_analysis.models.mjcf_file import MjcfFile, gives_mass
from pupper_analysis.models.objects import ModelObject
from pupper_analysis.models.places import Place
from pupper_analysis.models.shapes import COMPARISON_DIRECTIONS, Pose, Shape, read_shape
from pupper_analysis.models.sides import LEG_JOINT_NAME
from pupper_analysis.models.stated.mjcf import find_collidable_geoms, place_of_geom, read_mjcf_model
from pupper_analysis.models.stated.model import MjcfModel, RobotModel
from pupper_analysis.models.stated.urdf import read_urdf_model
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.robot.compare.attribution import (
    MAX_RESIDUAL,
    align_robot,
    compute_joint_effects,
    explain_differences,
)
from pupper_analysis.robot.compare.differences import (
    CONVENTION_KINDS,
    FORMAT_NAMES,
    SERVO_GAIN_KINDS,
    Difference,
    Effect,
    Explanation,
    PatternCause,
    change_of,
    guess_degrees,
    with_names_of_models,
)
from pupper_analysis.robot.contact import limb_ends
from pupper_analysis.robot.matching.alignment import Alignment
from pupper_analysis.robot.matching.match import Match, match_models
from pupper_analysis.robot.matching.sources import Sources
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.robot.matching.trees import base_pose, kinematic_trees
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import list_position_servos
from pupper_analysis.robot.shapes import may_touch

CONTACT_HEIGHT_ATOL = 2e-4
"""Largest accepted difference between the heights of a foot's contact surface in URDF and MJCF [m];
also the tolerance of the distance of equally near geoms. Reason: files contain rounded radii, such
as 0.02 for 19.95 mm. Chosen, not tuned."""

_FOOT_HEIGHT_RTOL = 0.15
"""Upper bound [1] of the height of a limb's lowest point, with which the limb counts as a leg with
a foot. Heights are measured in the initial pose from the lowest point of all limbs. The height is
divided by the height of the CoM. Chosen, not tuned."""


@dataclass(frozen=True, eq=False)
class _PlacedShape:
    """Collision shape in MuJoCo's world at the initial pose.

    Attributes:
        shape: Shape in the frame of the link or body.
        world: Shape in the world frame.
        place: Function that returns the location in the file.
    """

    shape: Shape
    world: Shape
    place: Callable[[], Place]


def compare_collisions(
    matched: Match,
    urdf: UrdfFile,
    mjcf: MjcfFile,
    mjcf_model: MjcfModel,
    moved: Collection[str],
) -> tuple[list[Difference], list[Diagnostic]]:
    """Compare the height of the lowest collision shape of each foot, in a URDF and an MJCF.

    The robot is in the initial pose of the MJCF. A limb end that is about as low as the lowest limb
    end counts as a foot. The feet of a robot with a fixed base are not compared.

    Args:
        matched: Matched joints, links and bodies of both files.
        urdf: The URDF.
        mjcf: The MJCF.
        mjcf_model: Model of the MJCF.
        moved: Joints (or the base) whose placement differs between the files. Shapes that move with
            these joints are not compared.

    Returns:
        Differences of feet; notes. Feet are not compared if the files have different base frames or
        joint zeros.
    """
    conventions = matched.conventions
    urdf_model = read_urdf_model(urdf)
    has_collision_shapes = any(
        shape.collides for link in urdf_model.links.values() for shape in link.shapes
    )
    if (
        mjcf_model.mj_model is None
        or not has_collision_shapes
        or not mjcf_model.mj_model.geom_bodyid.any()
    ):
        return [], []  # a file has no collision shapes
    if conventions.base is not None or conventions.zeros:
        return [], [diagnose("collisions-not-compared")]
    data = make_start_data(mjcf.model)
    moved_bodies = {matched.mjcf_body[name] for name in moved if name in matched.mjcf_body}
    ends = limb_ends(mjcf.model)
    shapes_by_joint = {
        name: _collect_limb_shapes(name, matched, (urdf_model, urdf), (mjcf_model, mjcf), data)
        for name, body in matched.mjcf_body.items()
        if body in mjcf_model.links
        and moved_bodies.isdisjoint((body, *mjcf_model.ancestors(body)))
        and mjcf.model.body_weldid[mjcf.model.body(body).id] in ends
    }
    limbs = {name: pair for name, pair in shapes_by_joint.items() if pair is not None}
    feet = _find_foot_joints(limbs, matched, data) if matched.robot.floating else []
    return list(_compare_feet({name: limbs[name] for name in feet}, matched, urdf, mjcf)), []


MovingShapes = tuple[tuple[_PlacedShape, ...], tuple[_PlacedShape, ...]]
"""(collision shapes of the URDF, collision shapes of the MJCF) that move with a joint."""


def _collect_limb_shapes(
    name: str,
    matched: Match,
    of_urdf: tuple[RobotModel, UrdfFile],
    of_mjcf: tuple[RobotModel, MjcfFile],
    data: mujoco.MjData,
) -> MovingShapes | None:
    """Return the collision shapes of URDF and MJCF that move with a joint, in the world frame.

    Shapes of the MJCF that cannot touch the world are omitted. None if the shapes cannot be
    compared, for example because the extent of a mesh is unknown.
    """
    (urdf_model, urdf_file), (mjcf_model, mjcf_file) = of_urdf, of_mjcf
    body, link, base = matched.mjcf_body[name], matched.urdf_link[name], matched.robot.base
    bases = matched.mjcf_body.get(base), matched.urdf_link.get(base)
    if not (
        {body, bases[0]} <= mjcf_model.links.keys() and {link, bases[1]} <= urdf_model.links.keys()
    ):
        return None
    model = data.model
    carrier = model.body(body).id
    # Transformation from the frame of the base to that of the body, at zero angles.
    to_body = (
        mjcf_model.links[str(bases[0])].pose.inverse() * mjcf_model.links[body].pose
    ).inverse()
    to_base = urdf_model.links[str(bases[1])].pose.inverse()
    link_origin_pose = Pose.of_body(data, carrier) * to_body * to_base
    urdf = tuple(
        _PlacedShape(
            shape,
            shape.placed_in(link_origin_pose * part.pose),
            partial(urdf_file.place_of_nth, part.name, "collision", number),
        )
        for part in urdf_model.fixed_group(link)
        for number, shape in enumerate(shape for shape in part.shapes if shape.collides)
    )
    moving = model.body_weldid[model.geom_bodyid] == model.body_weldid[carrier]
    mjcf = tuple(
        _PlacedShape(
            shape := read_shape(model, geom),
            shape.placed_in(Pose.of_body(data, int(model.geom_bodyid[geom]))),
            partial(place_of_geom, mjcf_file, geom, "shape"),
        )
        for geom in _find_ground_geoms(model)
        if moving[geom]
    )
    has_point = any(not any(placed.shape.size) and placed.shape.kind != "mesh" for placed in urdf)
    if has_point or any(
        placed.world.support(COMPARISON_DIRECTIONS[:1]) is None for placed in (*urdf, *mjcf)
    ):
        return None
    return urdf, mjcf


def _find_ground_geoms(model: mujoco.MjModel) -> list[int]:
    """Return the ids of geoms that can touch the world; all that can collide, if it has none."""
    ids = sorted(find_collidable_geoms(model))
    world_geoms = [geom for geom in ids if model.body_weldid[model.geom_bodyid[geom]] == 0]
    if not world_geoms:
        return ids
    return [
        geom
        for geom in ids
        if any(may_touch(model, geom, world_geom) for world_geom in world_geoms)
    ]


def _find_foot_joints(
    limbs: Mapping[str, MovingShapes], matched: Match, data: mujoco.MjData
) -> list[str]:
    """Return the joints of ``limbs`` whose limb is low enough to end in a foot."""
    model = data.model
    ends = {
        name: min(float(-placed.world.support(_DOWN_DIRECTION)[0]) for placed in (*urdf, *mjcf))  # type: ignore[index]
        for name, (urdf, mjcf) in limbs.items()
        if urdf or mjcf
    }
    if not ends:
        return []
    lowest = min(ends.values())
    base = model.body(matched.mjcf_body[matched.robot.base]).id
    com_height = float(data.subtree_com[base][2]) - lowest
    return [
        name for name, height in ends.items() if height - lowest <= _FOOT_HEIGHT_RTOL * com_height
    ]


def _locate_disabled_contact(mjcf: MjcfFile, body: str, urdf_shape: _PlacedShape) -> Place:
    """Return the location in the MJCF at which contacts of a foot are disabled, or of its body."""
    model = mjcf.model
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT:
        places = (place for words, place in mjcf.elements("flag") if "contact" in words)
        return next(places, Place(mjcf.path))
    data = make_start_data(model)
    moving = model.body_weldid == model.body_weldid[model.body(body).id]
    geoms = np.flatnonzero(moving[model.geom_bodyid])
    if not len(geoms):
        return mjcf.place("body", body)
    distances = np.linalg.norm(data.geom_xpos[geoms] - urdf_shape.world.pose.position, axis=1)
    # Of equally near geoms, the last is usually the collision geom.
    nearest = geoms[np.flatnonzero(distances < distances.min() + CONTACT_HEIGHT_ATOL)[-1]]
    return place_of_geom(mjcf, int(nearest), "touches")


_DOWN_DIRECTION = np.array([[0.0, 0.0, -1.0]])
"""Downward unit vector in the world frame, shape (1, 3), as argument of ``Shape.support``."""


def _compare_feet(
    feet: Mapping[str, MovingShapes], matched: Match, urdf: UrdfFile, mjcf: MjcfFile
) -> Iterator[Difference]:
    """Yield feet with shapes in one file only, or with different heights of the lowest points."""
    for name, (urdf_shapes, mjcf_shapes) in feet.items():
        subject, sides = (
            ("joint", name),
            (_find_lowest_shape(urdf_shapes), _find_lowest_shape(mjcf_shapes)),
        )
        urdf_lowest, mjcf_lowest = sides[0][2], sides[1][2]
        link, body = matched.urdf_link[name], matched.mjcf_body[name]
        if mjcf_lowest is not None:
            mjcf_place = mjcf_lowest.place()
        elif urdf_lowest is not None:
            mjcf_place = _locate_disabled_contact(mjcf, body, urdf_lowest)
        else:
            mjcf_place = mjcf.place("body", body)
        places = (
            (urdf.place("link", link) if urdf_lowest is None else urdf_lowest.place()).path,
            mjcf_place.path,
        )
        values = {"one": sides[0][1], "two": sides[1][1], **FORMAT_NAMES.message_values}
        if not (urdf_shapes and mjcf_shapes):
            message = diagnose("foot-touches-in-one-file", subject=subject, **values)
            presence = [None if not shapes else "there" for shapes in (urdf_shapes, mjcf_shapes)]
            yield Difference("collision", name, presence[0], presence[1], "", message, {}, *places)
            continue
        lower = sides[0][0] - sides[1][0]  # positive if the MJCF's foot is lower
        if abs(lower) > CONTACT_HEIGHT_ATOL:
            message = diagnose(
                "foot-surface-differs",
                subject=subject,
                lower=Quantity(lower, "m") if lower > 0 else None,
                higher=Quantity(-lower, "m") if lower < 0 else None,
                **values,
            )
            # The scale of the relative effect is 1 m.
            effects = {"contact surface": Effect(abs(lower), abs(lower), math.inf)}
            yield Difference(
                "collision",
                name,
                sides[0][0],
                sides[1][0],
                "m",
                message,
                effects,
                *places,
            )


def _find_lowest_shape(
    shapes: Sequence[_PlacedShape],
) -> tuple[float, Diagnostic | Term, _PlacedShape | None]:
    """Return lowest height [m], description and shape; NaN, "none" and None without shapes."""
    if not shapes:
        return math.nan, Term("none"), None
    heights = [float(-shape.world.support(_DOWN_DIRECTION)[0]) for shape in shapes]  # type: ignore[index]
    index = int(np.argmin(heights))
    return heights[index], shapes[index].shape.diagnostic, shapes[index]


def report_base_tilt(
    matched: Match, urdf: etree._Element, tolerances: Tolerances
) -> Diagnostic | None:
    """Return a diagnostic of the tilt of a fixed base in the MJCF relative to the URDF.

    The tilt is the angle between the directions of gravity in both base frames.

    Args:
        matched: Matched files.
        urdf: Root element of the unmodified URDF.
        tolerances: Tolerances of the comparison.

    Returns:
        Diagnostic; None, for example, without a tilt beyond the tolerance for rotations.
    """
    robot = matched.robot
    if robot.floating:
        return None
    mjcf_rotation = base_pose(robot).rotation
    if matched.conventions.base is not None:
        mjcf_rotation = mjcf_rotation @ matched.conventions.base.rotation
    relative_rotation = mjcf_rotation @ _rotation_in_root(urdf, matched.urdf_link[robot.base]).T
    down, gravity = relative_rotation @ DOWNWARD_GRAVITY, kinematic_trees(robot)[1].gravity
    tilt = math.atan2(float(np.linalg.norm(np.cross(down, gravity))), float(down @ gravity))
    if not gravity.any() or tilt <= tolerances.rotation:
        return None
    return diagnose("base-tilted", subject=("body", robot.mj_base), tilt=Quantity(tilt, "rad"))


def _rotation_in_root(urdf: etree._Element, link: str) -> Array:
    """Return the rotation (3, 3) from link to root axes of a URDF, along fixed joints."""
    axes = np.eye(3)
    for joint in UrdfTree(urdf).chain(link):
        axes = joint.origin.rotation @ axes
    return axes


@dataclass(frozen=True, eq=False)
class FilesCompared(Tabular):
    """Result of the comparison of a URDF with an MJCF.

    Attributes:
        urdf: Path of the URDF.
        mjcf: Path of the MJCF.
        base: Name of the base.
        joints: Joints of both files, with the names of the MJCF.
        guessed: {joint in the URDF: joint in the MJCF} of pairs with different names, matched by
            structure, or by names without prefixes and suffixes.
        only_urdf: Joints that only the URDF has; fixed at zero for the comparison.
        only_mjcf: Joints that only the MJCF has; fixed at zero for the comparison.
        parts: Diagnostics of parts (such as a gripper) that only one file has, with their joints;
            removed for the comparison.
        notes: Diagnostics of assumptions and omissions.
        differences: Differences, the most urgent first; see `Difference.rank`.
        causes: Mistakes that explain differences; see `PatternCause`.
        deviations: {quantity: relative deviation between the models}.
        residual: {quantity: relative deviation after all differences are removed}.
        explained: Fraction of the largest deviation that the differences explain.
        complete: Whether each residual is at most 1e-9.
        mount: Diagnostic of the tilt of a fixed base in the MJCF relative to the URDF. None if
            `report_base_tilt` reports no tilt.
        objections: Further reasons for which the models do not agree. Possible reasons are an
            unexplained residual; differences within the tolerances whose total deviation is too
            large; a missing mass of a base with legs; and, if names must be equal, the tilt of a
            fixed base.
        agree: Whether the models agree within the tolerances: no difference, no joint in a single
            file only, and no objection.
        same_robot: Whether the models agree except for the conventions: frame of the base and zeros
            of joints.
        floating: Whether the MJCF has a free base, or a base with at least two limbs.
        refusal: Reason why MuJoCo does not load the unmodified MJCF, such as missing mesh files;
            None if MuJoCo loads the MJCF.
    """

    _key_fields: ClassVar[tuple[str, ...]] = ("agree", "same_robot", "differences")

    urdf: str
    mjcf: str
    base: str
    joints: tuple[str, ...]
    guessed: dict[str, str]
    only_urdf: tuple[str, ...]
    only_mjcf: tuple[str, ...]
    parts: tuple[Diagnostic, ...]
    notes: tuple[Diagnostic, ...]
    differences: tuple[Difference, ...]
    causes: tuple[PatternCause, ...]
    deviations: dict[str, float] = field(metadata={"unit": "1"})
    residual: dict[str, float] = field(metadata={"unit": "1"})
    explained: float = field(metadata={"unit": "1"})
    complete: bool
    mount: Diagnostic | None
    objections: tuple[Diagnostic, ...]
    agree: bool
    same_robot: bool
    floating: bool
    refusal: Diagnostic | None

    @property
    def unexplained_differences(self) -> list[list[Difference]]:
        """Differences that no mistake in ``causes`` explains, grouped by kind and values."""
        explained = {index for cause in self.causes for index in cause.differences}
        groups: dict[tuple[str, str, str], list[Difference]] = {}
        for index, difference in enumerate(self.differences):
            if index not in explained:
                groups.setdefault(
                    (difference.kind, str(difference.urdf), str(difference.mjcf)), []
                ).append(difference)
        return list(groups.values())

    @property
    def main_problem(self) -> Diagnostic:
        """Diagnostic of the problem to repair first, or of the agreement."""
        causes, groups = self.causes, self.unexplained_differences
        if causes and causes[0].is_reported_first:
            return causes[0].diagnostic
        if self.parts:
            return self.parts[0]
        if causes and (any(0 in cause.differences for cause in causes) or not groups):
            return causes[0].diagnostic
        if groups:
            return groups[0][0].diagnostic
        if self.objections:
            return self.objections[0]
        if self.agree and self.mount is not None:
            return diagnose("agree-but-tilted", tilt=self.mount)
        return diagnose("agree" if self.agree else "joints-not-the-same")

    def _columns(self) -> dict[str, list[object]]:
        """Return {column: values} of the table of differences, one row per difference."""
        names = ("kind", "element", "urdf", "mjcf", "unit", "message", "urdf_place", "mjcf_place")
        return {name: [getattr(found, name) for found in self.differences] for name in names}


@dataclass(frozen=True, eq=False)
class Compared:
    """Result of the comparison of two files, with intermediate results for further analyses.

    Attributes:
        result: Differences.
        matched: Matched files.
        explanation: Differences of the multibody trees and of MJCF-only effects, and the residual.
        sources: Locations of the values in both files.
    """

    result: FilesCompared
    matched: Match
    explanation: Explanation
    sources: tuple[Sources, Sources]


@silence_mujoco()
def compare_files(
    urdf: str | Path | ModelObject,
    mjcf: str | Path | ModelObject,
    *,
    names: Mapping[str, str] | None = None,
    packages: Mapping[str, Path] | None = None,
    feet: Sequence[str] = (),
    tolerances: Tolerances | None = None,
    strict_names: bool = False,
    xacro: Mapping[str, str] | None = None,
) -> Compared:
    """Compare a URDF with an MJCF of the same robot, and evaluate the effect of each difference.

    Args:
        urdf: URDF, or a file that is converted to URDF; a path, or a model in memory.
        mjcf: MJCF, or a file that is converted to MJCF; a path, or a model in memory.
        names: {name in the URDF: name in the MJCF} of joints or frames whose names differ.
        packages: {ROS package: folder}, for mesh paths in the URDF.
        feet: Frames, as named in the MJCF, whose positions are compared; by default all common
            frames of both files.
        tolerances: Tolerances of the comparison; by default for files with 5 to 6 digits.
        strict_names: If True, different joint names, missing damping or friction in the URDF, and
            the tilt of a fixed base count as disagreement.
        xacro: {argument: value} with which a xacro file is expanded; None: nothing is evaluated.

    Raises:
        ModelError: If a file cannot be read, the files cannot be matched, or the robot has no mass.
        MissingPackageError: If the reader of a format is not installed.
        UnknownNameError: If a name is not in the file.
        ConfigurationError: If an argument is out of range.
        OutputError: If this run of the command line also writes a file that is read.
    """
    tolerances = tolerances or Tolerances()
    urdf_file, mjcf_file = read_as_urdf(urdf, packages, xacro), read_as_mjcf(mjcf, packages)
    matched = match_models(
        urdf_file, mjcf_file, names=names, feet=feet, tolerances=tolerances, strict=strict_names
    )
    mount = report_base_tilt(matched, urdf_file.root, tolerances)
    robot = matched.robot
    robot.check_total_mass(urdf_file.path)
    alignment = align_robot(robot, tolerances)
    explanation = explain_differences(
        robot,
        tolerances=tolerances,
        reference=matched.reference,
        mimics=matched.robot.description.mimics,
        alignment=alignment,
        conventions=matched.conventions,
        unstated=matched.unstated,
    )
    sources = matched.sources(urdf_file, mjcf_file)
    mjcf_model = read_mjcf_model(mjcf_file)
    differences, contact_notes = _list_differences(
        matched, explanation, sources, (urdf_file, mjcf_file), mjcf_model, tolerances, strict_names
    )
    causes = _find_causes(robot, alignment, explanation, differences, tolerances, mjcf_file)
    unmatched = matched.only_urdf or matched.only_mjcf
    objections = (*_report_missing_base_mass(matched), *_find_objections(explanation, tolerances))
    if mount is not None and strict_names:
        objections = (*objections, mount)
    result = FilesCompared(
        urdf=str(urdf_file.path),
        mjcf=str(mjcf_file.path),
        base=robot.base,
        joints=robot.joint_names,
        guessed=dict(matched.guessed),
        only_urdf=matched.only_urdf,
        only_mjcf=matched.only_mjcf,
        parts=matched.parts,
        notes=(*matched.notes, *explanation.notes, *contact_notes),
        differences=differences,
        causes=causes,
        deviations=explanation.deviations,
        residual=explanation.residual,
        explained=_compute_explained_fraction(explanation),
        complete=explanation.complete,
        mount=mount,
        objections=objections,
        agree=not (differences or unmatched or objections),
        same_robot=not (_has_mechanical_difference(differences) or unmatched or objections),
        floating=mjcf_model.has_free_base,
        refusal=_describe_refusal(mjcf_file),
    )
    return Compared(result, matched, explanation, sources)


def _describe_refusal(mjcf: MjcfFile) -> Diagnostic | None:
    """Return the reason why MuJoCo does not load the unmodified MJCF; None if MuJoCo loads it.

    A file that was converted from another format is no MJCF that MuJoCo could load.
    """
    if mjcf.of_urdf or mjcf.stands_for:
        return None
    name, missing = mjcf.path.name, mjcf.missing_files
    if missing:
        return diagnose(
            "mjcf-refused-by-mujoco", file=name, count=len(missing), missing=missing, problem=None
        )
    if mjcf.as_it_is is not None:
        return diagnose(
            "mjcf-refused-by-mujoco",
            file=name,
            count=None,
            missing=None,
            problem=mjcf.as_it_is[0],
        )
    return None


def _list_differences(
    matched: Match,
    explanation: Explanation,
    sources: tuple[Sources, Sources],
    files: tuple[UrdfFile, MjcfFile],
    mjcf_model: MjcfModel,
    tolerances: Tolerances,
    strict_names: bool,
) -> tuple[tuple[Difference, ...], list[Diagnostic]]:
    """List the differences of dynamics, joint names, servo gains and foot heights.

    Returns:
        Differences with their locations, sorted by rank; notes on the comparison of foot heights.
    """
    renamed_joints = matched.guessed if strict_names else {}
    servos = _compare_servo_gains(matched, *files, tolerances)
    name_differences = (_report_name(*pair) for pair in renamed_joints.items())
    unplaced = (*explanation.differences, *name_differences, *servos)
    located = tuple(_add_places(unplaced, sources, *files))
    contact_differences, notes = _compare_ground_contact(matched, *files, mjcf_model, located)
    differences = (*located, *contact_differences)
    return tuple(sorted(differences, key=lambda difference: difference.rank)), notes


def _find_causes(
    robot: Robot,
    alignment: Alignment,
    explanation: Explanation,
    differences: Sequence[Difference],
    tolerances: Tolerances,
    mjcf: MjcfFile,
) -> tuple[PatternCause, ...]:
    """Find mistakes in a file, with their joint effects, in the order of `_sort_causes`."""
    bodies = _bodies_with_geom_mass(mjcf)
    causes = _find_mistakes(robot, alignment.values, differences, tolerances, bodies)
    groups = [
        [(differences[index].kind, differences[index].element) for index in cause.differences]
        for cause in causes
    ]
    effects = compute_joint_effects(
        robot, groups, explanation, tolerances=tolerances, alignment=alignment
    )
    return _sort_causes(tuple(map(_set_effects, causes, effects)), differences)


def _find_mistakes(*of: object) -> tuple[PatternCause, ...]:
    """Find mistakes in a file, such as wrong units, that explain differences.

    ``of`` contains the arguments of the module ``causes`` of a tool: robot, tree of the MJCF,
    differences, tolerances, and bodies of the MJCF whose mass is computed from geoms.
    """
    modules = (
        import_module(f"{package}.causes") for package in find_tool_modules("causes").values()
    )
    return next((tuple(module.find_causes(*of)) for module in modules), ())


def _set_effects(cause: PatternCause, effects: dict[str, Effect]) -> PatternCause:
    """Return a cause with the effects of all its differences together."""
    return replace(cause, effects=effects)


def _sort_causes(
    causes: Sequence[PatternCause], differences: Sequence[Difference]
) -> tuple[PatternCause, ...]:
    """Sort causes as differences (`Difference.rank`), with the joint effects of each cause.

    Causes that are reported first precede other causes.
    """

    def rank(cause: PatternCause) -> tuple[object, ...]:
        """Return the sorting key of a cause."""
        first = differences[cause.differences[0]]
        together = replace(first, effects=cause.effects or first.effects)
        return not cause.is_reported_first, together.rank, cause.differences

    return tuple(sorted(causes, key=rank))


def _bodies_with_geom_mass(mjcf: MjcfFile) -> set[str]:
    """Return the names of the bodies of an MJCF whose mass MuJoCo computes from geoms."""
    spec = mjcf.spec
    return {geom.parent.name for geom in spec.geoms if gives_mass(spec, geom)}


def _report_missing_base_mass(matched: Match) -> Iterator[Diagnostic]:
    """Yield a diagnostic if the MJCF lacks the mass of a base with legs.

    The base of a robot without legs (an arm) does not move, so that its mass has no effect.
    """
    notes = [note for note in matched.notes if note.code == "mass-of-base-left-out"]
    legs = [name for name in matched.robot.joint_names if LEG_JOINT_NAME.search(name)]
    if notes and len(legs) > 1:
        yield diagnose("base-of-legs-left-out", mass=notes[0].values["mass"], joints=legs)


def _compare_ground_contact(
    matched: Match,
    urdf: UrdfFile,
    mjcf: MjcfFile,
    mjcf_model: MjcfModel,
    found: Iterable[Difference],
) -> tuple[list[Difference], list[Diagnostic]]:
    """Compare the heights of feet that no difference displaces, unless a file was converted."""
    if urdf.stands_for or mjcf.stands_for:
        return [], []
    moved = {difference.element for difference in found if difference.kind in _DISPLACING_KINDS}
    return compare_collisions(matched, urdf, mjcf, mjcf_model, moved)


_DISPLACING_KINDS = ("type", "parent", "base frame", "zero", "position", "rotation", "axis")
"""Kinds of differences that displace the bodies on a joint. The collision shapes of displaced
bodies are not compared."""


def _has_mechanical_difference(differences: Iterable[Difference]) -> bool:
    """Return True if a difference affects the robot itself, and not only its coordinates."""
    return any(difference.kind not in CONVENTION_KINDS for difference in differences)


def _add_places(
    differences: Iterable[Difference],
    sources: tuple[Sources, Sources],
    urdf: UrdfFile,
    mjcf: MjcfFile,
) -> Iterator[Difference]:
    """Yield the differences with their locations, and original formats of files in messages."""
    format_names = {
        term: Term(file.stands_for)
        for term, file in (("the URDF", urdf), ("the MJCF", mjcf))
        if file.stands_for
    }
    for difference in differences:
        urdf_place, mjcf_place = (
            source.place(difference.kind, difference.element).path for source in sources
        )
        diagnostic = with_names_of_models(difference.diagnostic, format_names)
        yield replace(
            difference, diagnostic=diagnostic, urdf_place=urdf_place, mjcf_place=mjcf_place
        )


def _compute_explained_fraction(explanation: Explanation) -> float:
    """Return the fraction (0 to 1) of the largest deviation that the differences explain."""
    worst, residual = (
        max(values.values()) for values in (explanation.deviations, explanation.residual)
    )
    if worst <= MAX_RESIDUAL:
        return 1.0 if residual <= MAX_RESIDUAL else 0.0
    return max(0.0, 1.0 - residual / worst) if math.isfinite(residual) else 0.0


def _report_name(urdf: str, mjcf: str) -> Difference:
    """Create the difference for a matched joint with different names in both files."""
    message = diagnose("joint-name-differs", subject=("joint", mjcf), urdf=urdf, mjcf=mjcf)
    return Difference("name", mjcf, urdf, mjcf, "", message, {})


def _compare_servo_gains(
    matched: Match, urdf: UrdfFile, mjcf: MjcfFile, tolerances: Tolerances
) -> Iterator[Difference]:
    """Yield the differences of servo gains, if the URDF was converted from a file with gains."""
    if urdf.gains is None:
        return
    mjcf_gains = list_position_servos(matched.robot) if mjcf.gains is None else mjcf.gains
    joints = kinematic_trees(matched.robot)[0].joints
    for name in matched.robot.joint_names:
        urdf_gains = urdf.gains.get(matched.urdf_joint[name])
        if urdf_gains is None or name not in mjcf_gains:
            continue
        of_joint = select_joint_units(slides=joints[name].slides)
        units = of_joint.stiffness, of_joint.damping
        for kind, urdf_gain, mjcf_gain, unit in zip(
            SERVO_GAIN_KINDS, urdf_gains, mjcf_gains[name], units, strict=True
        ):
            if abs(mjcf_gain - urdf_gain) > tolerances.damping * max(
                abs(urdf_gain), abs(mjcf_gain)
            ):
                details = {"what": Term(kind), "guess": guess_degrees(urdf_gain, mjcf_gain)}
                code, subject = "joint-number-differs", ("joint", name)
                change = change_of(
                    code, kind, subject, (urdf_gain, mjcf_gain), unit, FORMAT_NAMES, details
                )
                yield change.to_difference({})


def _find_objections(explanation: Explanation, tolerances: Tolerances) -> Iterator[Diagnostic]:
    """Yield reasons, other than differences, for which URDF and MJCF do not agree."""
    residual = {name: value for name, value in explanation.residual.items() if value > MAX_RESIDUAL}
    if residual:
        name = max(residual, key=lambda quantity: residual[quantity])
        yield diagnose(
            "deviation-unexplained",
            subject=("quantity", name),
            left=residual[name],
            what=Term(name),
        )
        return
    if _has_mechanical_difference(explanation.differences):
        return
    # A tolerance of 1e-2 for masses also permits resulting deviations of 1e-2.
    allowed = max(getattr(tolerances, kind) for kind in _DYNAMIC_KINDS)
    for name, value in explanation.deviations.items():
        if value > allowed:
            yield diagnose(
                "tolerances-add-up",
                subject=("quantity", name),
                deviation=value,
                what=Term(name),
                allowed=allowed,
            )


_DYNAMIC_KINDS = ("mass", "com", "inertia", "position", "rotation", "axis", "damping", "dynamics")
"""Fields of `Tolerances` for values that affect the dynamics. The largest of these tolerances also
bounds the relative deviation of each dynamic quantity."""


def find_first_difference(robot: Robot) -> Diagnostic | None:
    """Find the first difference of a robot's two files that affects inertia, gravity or positions.

    Returns:
        Diagnostic of the difference, or of a part that only one file has. None if no difference is
        found, or the files cannot be compared.
    """
    file = None if robot.published is None else robot.published.file
    if file is None or robot.description.converted:
        return None
    with contextlib.suppress(PupperAnalysisError):
        comparison = compare_files(robot.description.urdf_source, file.path).result
        affecting = [
            similar.diagnostic
            for similar in comparison.differences
            if similar.relative_effects[0] > 0
        ]
        return next(iter([*affecting, *comparison.parts]), None)
    return None
