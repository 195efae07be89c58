"""Search for a single mistake that explains many differences between a URDF and an MJCF.

Examples: wrong units, another Euler sequence, exchanged limbs, dropped products of inertia. Most
hypotheses are tested: the mistake is undone in one of the trees, and the differences that disappear
are explained. Some mistakes, such as wrong units, follow from the numbers alone.

Before files are compared, links on fixed joints are combined with the moving body. Mass, first and
second moments about the frame's origin are additive, so the difference of two combined bodies is
the difference of the links. Most mistakes in inertials are undone link by link.
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, islice, product
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.arrays import INERTIA_ENTRIES, inertia_tensor
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, Term, diagnose
from pupper_analysis.models.conversion import inertia_of_body, pinocchio_from_mujoco
from pupper_analysis.models.multibody import MultibodyTree, TreeBody, TreeJoint
from pupper_analysis.models.transmission import actuator_gear, list_joint_actuators
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml import MAX_NUMBER
from pupper_analysis.robot.compare.differences import (
    INERTIAL_KINDS,
    Difference,
    PatternCause,
    PropertyKey,
    body_changes,
    changes_between,
)
from pupper_analysis.robot.matching.alignment import align_frames, in_body_frame
from pupper_analysis.robot.matching.conventions import quarter_turns
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.robot.matching.trees import compute_poses_at_zero, kinematic_trees
from pupper_analysis.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class ComparedLink:
    """Inertial of a link, in the frame of the rigid body to which the link belongs.

    Attributes:
        name: Link of the URDF, or body of the MJCF.
        body: Mass [kg], CoM [m], and inertia about the CoM [kg m^2].
        axes: Rotation matrix from the axes of the link to the axes of the body, shape (3, 3).
        origin: Origin of the link in the frame of the moving body, shape (3,) [m].
    """

    name: str
    body: TreeBody
    axes: Array
    origin: Array

    @property
    def offset(self) -> Array:
        """CoM relative to the origin of the link, in the axes of the moving body, (3,) [m]."""
        return self.body.com - self.origin


Links = Mapping[str, tuple[ComparedLink, ...]]
"""{base or joint: links with mass that move with this joint}."""


def list_urdf_links(robot: Robot) -> Links:
    """Return the inertials of the links of each body of the URDF, in the frame of the body.

    Returns:
        {base or joint: links with mass that move with it}.
    """
    model = robot.pin_model
    links_by_joint: dict[str, list[ComparedLink]] = {}
    for name, link in UrdfTree.of(robot.description.urdf).links.items():
        inertia = link.inertia
        if inertia is None or not inertia.mass or not model.existFrame(name, pin.FrameType.BODY):
            continue
        frame = model.frames[model.getFrameId(name, pin.FrameType.BODY)]
        body = TreeBody.of(inertia).transform(frame.placement)
        moving_joint = _get_moving_joint(robot, model, int(frame.parentJoint))
        links_by_joint.setdefault(moving_joint, []).append(
            ComparedLink(
                name,
                body,
                np.array(frame.placement.rotation),
                np.array(frame.placement.translation),
            )
        )
    return {moving_joint: tuple(links) for moving_joint, links in links_by_joint.items()}


def list_mjcf_links(robot: Robot, raw: MultibodyTree, aligned: MultibodyTree) -> Links:
    """Return the inertials of the links of each body of the MJCF, in the URDF's body frames.

    Args:
        robot: Robot.
        raw: Tree of the MJCF, in the body frames of the MJCF.
        aligned: The same tree, in the body frames of the URDF.

    Returns:
        {base or joint: links with mass that move with it}.
    """
    model, mujoco_model = pinocchio_from_mujoco(robot.mj_model), robot.mj_model
    raw_poses, aligned_poses = compute_poses_at_zero(raw), compute_poses_at_zero(aligned)
    links_by_joint: dict[str, list[ComparedLink]] = {}
    for index in np.flatnonzero(mujoco_model.body_mass > 0):
        name = str(mujoco_model.body(index).name)
        frame = model.frames[model.getFrameId(name, pin.FrameType.BODY)]
        moving_joint = _get_moving_joint(robot, model, int(frame.parentJoint))
        pose = aligned_poses[moving_joint].actInv(raw_poses[moving_joint]) * frame.placement
        link_body = TreeBody.of(inertia_of_body(mujoco_model, index)).transform(pose)
        links_by_joint.setdefault(moving_joint, []).append(
            ComparedLink(name, link_body, np.array(pose.rotation), np.array(pose.translation))
        )
    return {moving_joint: tuple(links) for moving_joint, links in links_by_joint.items()}


def _get_moving_joint(robot: Robot, model: pin.Model, joint: int) -> str:
    """Return the name of a Pinocchio joint if the joint belongs to the robot, else the base."""
    name = str(model.names[joint])
    return name if name in robot.joint_names else robot.base


def combine_bodies(*bodies: TreeBody) -> TreeBody:
    """Combine bodies to one rigid body: mass [kg], CoM [m] and inertia about the CoM [kg m^2].

    The bodies and the result are expressed in a common frame.
    """
    return body_from_moments(sum((compute_moments(body) for body in bodies), start=np.zeros(10)))


def compute_moments(body: TreeBody) -> Array:
    """Compute mass, first moments and rotational inertia of a body about the origin of the frame.

    Returns:
        Shape (10,): mass m [kg]; first moments m c, with the CoM c [kg m]; ixx, iyy, izz, ixy, ixz,
        iyz of the inertia tensor about the origin [kg m^2]. Additive for bodies in a common frame.
    """
    c = body.com
    inertia = body.inertia + body.mass * (float(c @ c) * np.eye(3) - np.outer(c, c))
    entries = [inertia[place] for place in INERTIA_ENTRIES.values()]
    return np.array([body.mass, *(body.mass * c), *entries])


def body_from_moments(values: Array) -> TreeBody:
    """Compute mass, CoM and inertia about the CoM of a body from its moments about the origin.

    Inverse of `compute_moments`. The CoM of a body without mass is set to zero.
    """
    mass = float(values[0])
    com = values[1:4] / mass if mass else np.zeros(3)
    shift = mass * (float(com @ com) * np.eye(3) - np.outer(com, com))
    return TreeBody(mass, com, inertia_tensor(values[4:]) - shift)


@dataclass(frozen=True, eq=False)
class PatternCase:
    """Trees of a URDF and an MJCF that differ, and the differences for which causes are searched.

    Attributes:
        robot: Robot.
        urdf_tree: Tree of the URDF.
        mjcf_tree: Tree of the MJCF, in the body frames of the MJCF.
        aligned_mjcf_tree: Tree of the MJCF, in the body frames of the URDF.
        keys: Kind and element of each difference.
        tolerances: Tolerances of the comparison.
        urdf_links: Links of the URDF's bodies, in the frames of ``urdf_tree``; empty without
            inertial differences.
        mjcf_links: Links of the MJCF's bodies, in the frames of ``aligned_mjcf_tree``; empty
            without inertial differences.
        from_geoms: Bodies of the MJCF whose mass is computed from geoms.
        explained: Differences that a previous cause explains.
    """

    robot: Robot
    urdf_tree: MultibodyTree
    mjcf_tree: MultibodyTree
    aligned_mjcf_tree: MultibodyTree
    keys: Sequence[PropertyKey]
    tolerances: Tolerances
    urdf_links: Links
    mjcf_links: Links
    from_geoms: Collection[str] = ()
    explained: Collection[PropertyKey] = ()

    @property
    def unexplained(self) -> list[PropertyKey]:
        """(kind, element) of each difference that no cause found so far explains."""
        return [key for key in self.keys if key not in self.explained]

    def find_remaining(
        self, modified: MultibodyTree, only: Collection[str] | None = None
    ) -> set[PropertyKey]:
        """Return the differences between the URDF's tree and a modified tree of the MJCF.

        Args:
            modified: Modified tree. With ``only``, a tree with these joints and without a base.
            only: Joints that are compared, with the attached bodies and frames; by default all
                joints and the base.

        Returns:
            (kind, element) of each difference; ``keys`` if the trees cannot be compared.
        """
        first = self.urdf_tree if only is None else self.urdf_tree.select_joints(only)
        try:
            aligned = align_frames(modified, first, self.tolerances).values
            differences = {
                (c.kind, c.element) for c in changes_between(first, aligned, self.tolerances)
            }
        except (ValueError, KeyError):  # the joints differ
            return set(self.keys)
        return differences

    def find_explained(self, modified: MultibodyTree) -> set[PropertyKey]:
        """Return the differences between the files that disappear if the MJCF's tree is modified.

        Args:
            modified: Modified tree of the MJCF.

        Returns:
            Differences as pairs (kind, element). Empty if the modified tree has a new difference,
            or if fewer than two differences disappear.
        """
        remaining = self.find_remaining(modified)
        vanished = set(self.keys) - remaining
        return vanished if not remaining - set(self.keys) and len(vanished) > 1 else set()


@dataclass(frozen=True, eq=False)
class PatternFinding:
    """Mistake in a file that explains one or more differences between the URDF and the MJCF.

    Attributes:
        kind: Kind of the cause.
        diagnostic: Message with the numbers.
        explained: Differences that disappear.
    """

    kind: str
    diagnostic: Diagnostic
    explained: set[PropertyKey]


PatternFindings = Iterator[PatternFinding]
"""Result of a search for one kind of mistake: each mistake with the differences it explains."""


_EULER_SEQUENCES = ("xyz", "xzy", "yxz", "yzx", "zxy", "zyx")
"""Values of the MJCF's ``eulerseq`` that `find_angle_settings` tests: Euler angles about moving
axes. Upper case, for fixed axes, is also tested; the stated sequence is not."""


def find_angle_settings(case: PatternCase) -> PatternFindings:
    """Find another ``eulerseq`` or ``angle`` unit of the MJCF with which differences disappear.

    A finding explains at least 60 % of the differences in rotations and axes, or in joint limits if
    no rotation or axis differs.
    """
    if not {"rotation", "axis", "lower limit", "upper limit", "zero", "base frame"} & {
        kind for kind, _ in case.keys
    }:
        return
    spec = case.robot.description.mjcf
    stated_sequence = "".join(
        chr(letter) if isinstance(letter, int) else letter for letter in (spec.compiler.eulerseq)
    )
    degree = bool(spec.compiler.degree)
    unit, other_unit = ("degree", "radian") if degree else ("radian", "degree")
    candidates: list[tuple[tuple[str, str, str], str, Any]] = [
        (("eulerseq", order, stated_sequence), "eulerseq", list(order))
        for order in (*_EULER_SEQUENCES, *(sequence.upper() for sequence in _EULER_SEQUENCES))
        if _has_euler(spec) and order != stated_sequence
    ]
    if _has_euler(spec) or {"lower limit", "upper limit"} & {kind for kind, _ in case.keys}:
        candidates.append((("angle", other_unit, unit), "degree", not degree))
    best: tuple[tuple[str, str, str], set[PropertyKey]] = (("", "", ""), set())
    for setting, name, new in candidates:
        copied_spec = spec.copy()
        setattr(copied_spec.compiler, name, new)
        try:
            model = copied_spec.compile()
        except (ValueError, RuntimeError):
            continue
        tree = kinematic_trees(replace(case.robot, mj_model=model))[1]
        vanished = case.find_explained(replace(tree, gravity=case.urdf_tree.gravity))
        if len(vanished) > len(best[1]):
            best = (setting, vanished)
    (attribute, value, stated), vanished = best
    rotations = [key for key in case.keys if key[0] in ("rotation", "axis")]
    limits = [key for key in case.keys if key[0] in ("lower limit", "upper limit")]
    concerned = rotations or limits
    if concerned and sum(key in vanished for key in concerned) >= 0.6 * len(concerned):
        yield PatternFinding(
            "angles",
            diagnose(
                "angles-meant-otherwise",
                attribute=attribute,
                value=value,
                stated=stated,
                count=len(vanished),
                total=len(case.keys),
            ),
            vanished,
        )


def _has_euler(spec: mujoco.MjSpec) -> bool:
    """Return True if a body's orientation or inertial frame is specified by Euler angles."""
    kind = mujoco.mjtOrientation.mjORIENTATION_EULER
    return any(body.alt.type == kind or body.ialt.type == kind for body in spec.bodies)


def find_exchanged_limbs(case: PatternCase) -> PatternFindings:
    """Find pairs of limbs whose names are exchanged between the files.

    A limb consists of a joint of the base and all joints below. The names of two limbs with equal
    numbers of joints are exchanged for the test, for at most `_MAX_EXCHANGES` pairs. An exchange
    counts if at most `_MAX_REMAINING_FRACTION` of the differences of both limbs remain.
    """
    tops = case.urdf_tree.children(case.urdf_tree.base)
    limbs = {top: [top, *case.urdf_tree.list_descendants(top)] for top in tops}
    concerned = {
        case.urdf_tree.frames[element][0] if kind == "frame" else element
        for kind, element in case.keys
    }
    concerned_limbs = [top for top, names in limbs.items() if concerned & set(names)]
    pairs: list[tuple[str, str]] = []
    second, vanished = case.mjcf_tree, set[PropertyKey]()
    candidates = (
        (a, b) for a, b in combinations(concerned_limbs, 2) if len(limbs[a]) == len(limbs[b])
    )
    for first_limb, second_limb in islice(candidates, _MAX_EXCHANGES):
        if any({first_limb, second_limb} & set(pair) for pair in pairs):
            continue
        limb_joints = [*limbs[first_limb], *limbs[second_limb]]
        exchange = dict(zip(limbs[first_limb], limbs[second_limb], strict=True))
        carried = {
            *limb_joints,
            *(frame for name in limb_joints for frame in case.urdf_tree.list_frames(name)),
        }
        before = {key for key in case.keys if key[1] in carried}
        part = replace(second.select_joints(limb_joints), frames=second.frames)
        after = {
            key
            for key in case.find_remaining(_exchange_names(part, exchange), limb_joints)
            if key[1] in carried
        }
        if len(before) > 1 and len(after) <= _MAX_REMAINING_FRACTION * len(before):
            pairs.append((first_limb, second_limb))
            second, vanished = _exchange_names(second, exchange), vanished | (before - after)
    if pairs:
        listed_limbs = [
            diagnose("limbs-of-a-pair", one=first_limb, two=second_limb)
            for first_limb, second_limb in pairs
        ]
        yield PatternFinding(
            "exchanged",
            diagnose(
                "limbs-exchanged", pairs=listed_limbs, count=len(vanished), total=len(case.keys)
            ),
            vanished,
        )


_MAX_REMAINING_FRACTION = 0.2
"""Largest ratio between the numbers of differences of two limbs after and before an exchange of
their names. With a larger ratio, the exchange is not reported as a cause. Chosen, not tuned.
"""

_MAX_EXCHANGES = 60
"""Largest number of pairs of limbs for which an exchange of names is tested: more than all pairs of
eleven limbs. Chosen, to bound the time."""


def _exchange_names(values: MultibodyTree, names: Mapping[str, str]) -> MultibodyTree:
    """Exchange the names of pairs of joints in a tree, also in parents, bodies and frame owners.

    ``names`` is {joint: the other joint of the pair}.
    """
    exchanged = {**names, **{new_name: old_name for old_name, new_name in names.items()}}
    joints = {
        exchanged.get(name, name): replace(joint, parent=exchanged.get(joint.parent, joint.parent))
        for name, joint in values.joints.items()
    }
    return replace(
        values,
        joints=joints,
        bodies={exchanged.get(name, name): body for name, body in values.bodies.items()},
        frames={
            frame: (exchanged.get(owner, owner), place)
            for frame, (owner, place) in values.frames.items()
        },
    )


_MASS_UNITS = {
    1e3: ("g", "kg"),
    1e-3: ("kg", "g"),
    2.20462: ("pounds", "kg"),
    0.453592: ("kg", "pounds"),
}
"""{factor on a mass: (unit used, unit required)}: number in the unit used / number in the required
unit.
"""

_ANGLE_UNITS = {math.degrees(1.0): ("degrees", "radians")}
"""{factor on an angle: (unit used, unit required)}. The factor is the number in the unit used,
divided by the number in the required unit."""

_LENGTH_UNITS = {1e3: ("mm", "m"), 1e2: ("cm", "m"), 39.3701: ("inches", "m")}
"""{factor on a length: (unit used, unit required)}. The factor is the number in the unit used,
divided by the number in the required unit."""

_INERTIA_UNITS = {
    1e3: ("g m^2", "kg m^2"),
    1e4: ("kg cm^2", "kg m^2"),
    1e6: ("kg mm^2", "kg m^2"),
    1e7: ("g cm^2", "kg m^2"),
    1e9: ("g mm^2", "kg m^2"),
}
"""{factor on a moment of inertia: (unit used, unit required)}. The factor is the number in the unit
used, divided by the number in the required unit.
"""


def find_scaled_quantities(case: PatternCase) -> PatternFindings:
    """Find a common factor between the joint limits, masses, lengths or inertias of both files.

    Of limits, only limits of hinges are compared. The message may name a wrong unit (such as
    degrees, g or mm) or a wrong decimal point.
    """
    first, raw = case.urdf_tree, case.mjcf_tree
    bodies = [(body, raw.bodies[name]) for name, body in first.bodies.items() if body.mass]
    masses = _find_common_factor([(np.array([a.mass]), np.array([b.mass])) for a, b in bodies])
    inertias = _find_common_factor(
        [(a.inertia, case.aligned_mjcf_tree.bodies[n].inertia) for n, a in first.bodies.items()]
    )
    places = [(joint.position, raw.joints[name].position) for name, joint in first.joints.items()]
    lengths = _find_common_factor(places)
    hinges = [(joint, raw.joints[name]) for name, joint in first.joints.items() if not joint.slides]
    bounds = [tuple(np.array([j.lower, j.upper]) for j in pair) for pair in hinges]
    limits = _find_common_factor((a, b) for a, b in bounds if np.abs([a, b]).max() <= MAX_NUMBER)
    for what, factor, units, kinds in (
        ("limits", limits, _ANGLE_UNITS, ("lower limit", "upper limit")),
        ("masses", masses, _MASS_UNITS, ("mass",)),
        ("lengths", lengths, _LENGTH_UNITS, ("position", "com", "frame")),
        ("inertias", inertias, _INERTIA_UNITS, ("inertia",)),
    ):
        if factor is None:
            continue
        explained = {key for key in case.keys if key[0] in kinds}
        if what == "limits":
            explained = {key for key in explained if not first.joints[key[1]].slides}
        elif what == "lengths":
            explained -= _find_remaining_after_scaling(case, factor)
        yield PatternFinding(
            "units",
            diagnose(
                "all-scaled", what=Term(what), factor=factor, guess=_guess_unit(factor, units)
            ),
            explained,
        )


def _find_remaining_after_scaling(case: PatternCase, factor: float) -> set[PropertyKey]:
    """Return the differences that remain after a common factor of all lengths is removed.

    ``factor`` is length in the MJCF / length in the URDF. The larger numbers are scaled, so that
    the tolerances apply to the smaller numbers.
    """
    if factor > 1:
        return case.find_remaining(_scale_lengths(case.mjcf_tree, 1 / factor))
    return replace(case, urdf_tree=_scale_lengths(case.urdf_tree, factor)).find_remaining(
        case.mjcf_tree
    )


def _scale_lengths(tree: MultibodyTree, factor: float) -> MultibodyTree:
    """Return a tree whose joint positions, CoMs and frame positions are multiplied by a factor."""
    return replace(
        tree,
        joints={
            name: replace(joint, position=factor * joint.position)
            for name, joint in tree.joints.items()
        },
        bodies={name: replace(body, com=factor * body.com) for name, body in tree.bodies.items()},
        frames={
            name: (owner, factor * np.asarray(place))
            for name, (owner, place) in tree.frames.items()
        },
    )


def _find_common_factor(pairs: Iterable[tuple[Array, Array]]) -> float | None:
    """Return the common factor second / first of two or more pairs of proportional arrays, or None.

    The tolerance is 0.1 %. Pairs whose first array is zero are ignored. A factor does not count if
    it is negative, or within 1 % of 1.
    """
    ratios = []
    for first, second in pairs:
        size = float(np.linalg.norm(first))
        if size < 1e-12:
            continue
        ratio = float(np.sum(first * second)) / size**2
        if float(np.linalg.norm(second - ratio * first)) > 1e-3 * abs(ratio) * size:
            return None
        ratios.append(ratio)
    if len(ratios) < 2 or min(ratios) <= 0 or max(ratios) > 1.001 * min(ratios):
        return None
    factor = float(np.median(ratios))
    return None if math.isclose(factor, 1.0, rel_tol=1e-2) else factor


def _guess_unit(factor: float, units: Mapping[float, tuple[str, str]]) -> Diagnostic | None:
    """Return a message about a wrong unit or decimal point that explains a factor, or None.

    ``factor`` is the number in the MJCF / number in the URDF.
    """
    for size, (meant, right) in units.items():
        for file, times in (("MJCF", size), ("URDF", 1 / size)):
            if math.isclose(factor, times, rel_tol=2e-3):
                return diagnose("guess-unit", meant=Term(meant), right=Term(right), file=file)
    decimal = math.isclose(abs(math.log10(factor)), 1, abs_tol=1e-3)
    return diagnose("guess-decimal-point") if decimal else None


def find_efforts_before_gears(case: PatternCase) -> PatternFindings:
    """Find efforts of a URDF that are the efforts of the motor, before the gear.

    The criterion is (effort in the URDF) * |gear| = (effort in the MJCF), both [N m] or [N].
    """
    model = case.robot.mj_model
    joints_by_gear: dict[tuple[float, float], list[str]] = defaultdict(list)
    for kind, name in case.unexplained:
        if kind == "effort":
            effort = case.urdf_tree.joints[name].effort
            motors = list_joint_actuators(model, model.joint(name).id)
            gear = abs(float(actuator_gear(model, motors[0])[0])) if len(motors) == 1 else 1.0
            mjcf_effort = case.aligned_mjcf_tree.joints[name].effort
            if gear != 1.0 and math.isclose(effort * gear, mjcf_effort, rel_tol=1e-6):
                joints_by_gear[effort, gear].append(name)
    if not joints_by_gear:
        return
    efforts = [
        diagnose("effort-times-gear", effort=effort, gear=gear, product=effort * gear, joints=names)
        for (effort, gear), names in joints_by_gear.items()
    ]
    joints = [name for names in joints_by_gear.values() for name in names]
    yield PatternFinding(
        "gears",
        diagnose("efforts-before-gears", count=len(joints), efforts=efforts),
        {("effort", name) for name in joints},
    )


def find_dropped_products(case: PatternCase, lacking: str) -> PatternFindings:
    """Find inertias that differ because one file has no products of inertia.

    For the test, the products are removed from the other file. ``lacking`` is the file without
    products of inertia: ``URDF`` or ``MJCF``.
    """
    if sum(kind == "inertia" for kind, _ in case.unexplained) < 2:
        return
    lacking_links, other_links = (
        (case.urdf_links, case.mjcf_links)
        if lacking == "URDF"
        else (case.mjcf_links, case.urdf_links)
    )
    tree, other = (
        (case.aligned_mjcf_tree, case.urdf_tree)
        if lacking == "URDF"
        else (case.urdf_tree, case.aligned_mjcf_tree)
    )
    if not all(
        _is_diagonal(_get_inertia_in_link_axes(link))
        for links in lacking_links.values()
        for link in links
    ):
        return
    in_links = {
        name: tuple(_drop_products(link) for link in links) for name, links in other_links.items()
    }
    of_links = {
        name: combine_bodies(*(link.body for link in in_links.get(name, ())))
        for name in tree.bodies
    }
    of_bodies = {
        name: replace(body, inertia=_keep_diagonal(body.inertia))
        for name, body in tree.bodies.items()
    }
    for bodies in (of_links, of_bodies):
        remaining = {
            (change.kind, name)
            for name, body in bodies.items()
            for change in body_changes(name, body, other.bodies[name], case.tolerances)
            if change.kind == "inertia"
        }
        vanished = {key for key in case.unexplained if key[0] == "inertia"} - remaining
        if len(vanished) > 1 and remaining <= set(case.keys):
            count = sum(
                not _is_diagonal(_get_inertia_in_link_axes(link))
                for group in other_links.values()
                for link in group
            )
            yield PatternFinding(
                "products",
                diagnose("products-of-inertia-dropped", file=lacking, count=count),
                vanished,
            )
            return


def _get_inertia_in_link_axes(link: ComparedLink) -> Array:
    """Return the inertia of a link about the CoM, (3, 3) [kg m^2], in the axes of the link."""
    return link.axes.T @ link.body.inertia @ link.axes


def _drop_products(link: ComparedLink) -> ComparedLink:
    """Return a link without products of inertia in the axes of the link."""
    bare = link.axes @ _keep_diagonal(_get_inertia_in_link_axes(link)) @ link.axes.T
    return replace(link, body=replace(link.body, inertia=bare))


def _keep_diagonal(inertia: Array) -> Array:
    """Return an inertia tensor, shape (3, 3) [kg m^2], with zeros off the diagonal."""
    return np.diag(np.diag(inertia))


def _is_diagonal(inertia: Array) -> bool:
    """Return True if the products of an inertia, (3, 3), are at most 1e-9 of the largest entry."""
    off = inertia - _keep_diagonal(inertia)
    return float(np.abs(off).max()) <= 1e-9 * max(float(np.abs(inertia).max()), 1e-300)


def find_products_dropped_by_either(case: PatternCase) -> PatternFindings:
    """Find products of inertia that the URDF or the MJCF lacks."""
    for file in ("URDF", "MJCF"):
        yield from find_dropped_products(case, file)


@dataclass(frozen=True, eq=False)
class _TensorPair:
    """Different inertia tensors of a body that consists of a single link in both files.

    All tensors are about the CoM and in the axes of the body.

    Attributes:
        moving_joint: Joint that moves the body, or the base.
        urdf: Link of the URDF.
        mjcf: Body of the MJCF.
        inertial_rotation: Rotation of ``<inertial><origin>`` in the URDF, in the axes of the body,
            shape (3, 3).
    """

    moving_joint: str
    urdf: ComparedLink
    mjcf: ComparedLink
    inertial_rotation: Array


def _have_equal_tensors(urdf: Array, mjcf: Array, tolerances: Tolerances) -> bool:
    """Return True if two inertia tensors, shape (3, 3) [kg m^2], agree within the tolerance."""
    scale = max(float(np.abs(urdf).max()), float(np.abs(mjcf).max()))
    return float(np.abs(urdf - mjcf).max()) <= tolerances.inertia * scale


def _list_tensor_pairs(case: PatternCase) -> Iterator[_TensorPair]:
    """Yield the differing inertia tensors of single-link bodies with equal mass and CoM."""
    links = UrdfTree.of(case.robot.description.urdf).links
    differing = {element for kind, element in case.keys if kind in ("mass", "com")}
    for kind, name in case.unexplained:
        pair = case.urdf_links.get(name, ()), case.mjcf_links.get(name, ())
        if kind != "inertia" or name in differing or not len(pair[0]) == len(pair[1]) == 1:
            continue
        (urdf,), (mjcf,) = pair
        rotation = links[urdf.name].inertial_rotation
        yield _TensorPair(name, urdf, mjcf, urdf.axes @ rotation @ urdf.axes.T)


def _compute_origin_shift(link: ComparedLink) -> Array:
    """Compute a link's inertia about its origin minus inertia about the CoM, shape (3, 3) [kg m^2].

    m (c.c E - c c^T) in the axes of the moving body, with the CoM c relative to the link's origin.
    """
    offset = link.offset
    tensor: Array = link.body.mass * (float(offset @ offset) * np.eye(3) - np.outer(offset, offset))
    return tensor


def _has_inverse_axes(pair: _TensorPair, tolerances: Tolerances) -> bool:
    """Return True if one file has the inverse rotation of the principal axes of inertia.

    With a rotation E and a diagonal matrix D, the tensors are then E D E^T and E^T D E.
    """
    urdf, mjcf = pair.urdf, pair.mjcf
    for link, other_link in ((mjcf, urdf), (urdf, mjcf)):
        stated, right = (
            link.axes.T @ link_of_file.body.inertia @ link.axes
            for link_of_file in (link, other_link)
        )
        moments, axes = np.linalg.eigh(right)
        axes = axes * float(np.sign(np.linalg.det(axes)))
        for turn in quarter_turns():
            inverse = (axes @ turn).T @ (turn.T @ np.diag(moments) @ turn) @ (axes @ turn)
            if _have_equal_tensors(inverse, stated, tolerances):
                return True
    return False


_MIN_TURN = 1e-3
"""Angle of ``<inertial><origin rpy>`` [rad] above which the loss of this rotation in the MJCF is
tested as a cause. Chosen, not tuned."""


def find_tensor_mistakes(case: PatternCase) -> PatternFindings:
    """Find mistakes that explain different inertia tensors of bodies with equal mass and CoM.

    Tested mistakes: tensors about the origin of the link instead of the CoM; a lost rotation of
    ``<inertial><origin>``; the inverse rotation of the principal axes. For the first two a single
    body is sufficient evidence, since six numbers are hardly equal by chance.
    """
    pairs = list(_list_tensor_pairs(case))
    total, tolerances = len(pairs), case.tolerances
    candidates: list[tuple[str, str, list[_TensorPair]]] = []
    for file in ("URDF", "MJCF"):
        about_origin, unturned = [], []
        for pair in pairs:
            urdf, mjcf = pair.urdf.body.inertia, pair.mjcf.body.inertia
            if file == "URDF":
                moved = urdf - _compute_origin_shift(pair.urdf)
                about_origin += [pair] if _have_equal_tensors(moved, mjcf, tolerances) else []
                continue
            moved = mjcf - _compute_origin_shift(pair.mjcf)
            about_origin += [pair] if _have_equal_tensors(urdf, moved, tolerances) else []
            written = pair.inertial_rotation.T @ urdf @ pair.inertial_rotation
            is_turned = float(np.linalg.norm(pin.log3(pair.inertial_rotation))) > _MIN_TURN
            unturned += (
                [pair] if is_turned and _have_equal_tensors(written, mjcf, tolerances) else []
            )
        candidates.append(("inertia origin", file, about_origin))
        candidates.append(("inertia turn", file, unturned))
    conjugate = [pair for pair in pairs if _has_inverse_axes(pair, tolerances)]
    candidates.append(("inertia axes", "", conjugate if len(conjugate) > 1 else []))
    explained: set[str] = set()
    for kind, file, found in sorted(candidates, key=lambda candidate: -len(candidate[2])):
        new = [pair for pair in found if pair.moving_joint not in explained]
        if new:
            explained |= {pair.moving_joint for pair in new}
            message = _describe_tensor_mistake(kind, file, new, total)
            yield PatternFinding(kind, message, {("inertia", pair.moving_joint) for pair in new})


def _describe_tensor_mistake(
    kind: str, file: str, pairs: Sequence[_TensorPair], total: int
) -> Diagnostic:
    """Create the message about a mistake that explains different inertia tensors of bodies.

    ``kind`` is ``inertia axes``, ``inertia origin`` or ``inertia turn`` (a lost rotation).
    """
    links, count = [pair.urdf.name for pair in pairs], len(pairs)
    other = "URDF" if file == "MJCF" else "MJCF"
    if kind == "inertia axes":
        return diagnose("tensors-of-inverse-axes", links=links, count=count, total=total)
    if kind == "inertia origin":
        return diagnose(
            "tensors-about-origin", file=file, other=other, links=links, count=count, total=total
        )
    angle = Quantity(float(np.linalg.norm(pin.log3(pairs[0].inertial_rotation))), "rad")
    return diagnose("inertial-turns-lost", file=file, other=other, links=links, angle=angle)


def find_lost_mimics(case: PatternCase) -> PatternFindings:
    """Find joints that mimic a joint in the URDF, without an active joint equality in the MJCF."""
    model = case.robot.mj_model
    leaders = {name: mimic[0] for name, mimic in case.robot.description.mimics.items()}
    coupled = set()
    for index in np.flatnonzero(model.eq_active0 & (model.eq_type == mujoco.mjtEq.mjEQ_JOINT)):
        first, second = int(model.eq_obj1id[index]), int(model.eq_obj2id[index])
        pair = [model.joint(joint).name for joint in (first, second) if joint >= 0]
        coupled.add(pair[0])
        coupled |= {name for name in pair[1:] if leaders.get(name) == pair[0]}
    lost = [name for kind, name in case.unexplained if kind == "mimic" and name not in coupled]
    if lost:
        message = diagnose("mimics-lost", joints=lost)
        without_motor = [
            name
            for name in lost
            if math.isinf(case.aligned_mjcf_tree.joints[name].effort)
            and not list_joint_actuators(model, model.joint(name).id)
        ]
        efforts = {("effort", name) for name in without_motor}
        found = {("mimic", name) for name in lost} | (efforts & set(case.unexplained))
        yield PatternFinding("mimics", message, found)


_SINGLE_KINDS = ("inertia origin", "inertia turn")
"""Kinds of causes that are reported even if they explain a single difference; other causes must
explain at least two. The message of such a cause names the repair, while the message of the
difference only contains six numbers."""


_MAX_SUBSET_LINKS = 12
"""Largest number of links of a body of which subsets are tested as the links that one file lacks:
2^12 = 4096 subsets. Of more links, the heaviest are tested.
"""

_MAX_RESIDUAL = 0.02
"""Largest fraction of the inertial difference of a body that may remain after a tested mistake is
undone. Files with 5 to 6 digits leave some thousandths, if a link has a hundredth of the body's
mass. Subsets of links are tested if the mass fits within 1.5 times this fraction (`_list_subsets`).
"""


_INERTIA_ALWAYS_FROM_GEOM = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
"""Value of the MJCF's compiler option ``inertiafromgeom`` with which geoms override <inertial>;
`find_masses_of_geoms` reports it."""


def find_masses_of_geoms(case: PatternCase) -> PatternFindings:
    """Find inertial differences of bodies with a link whose mass MuJoCo computes from geoms.

    Such links have no ``<inertial>`` in the MJCF, or ``inertiafromgeom`` overrules it.
    """
    geom_links = {
        moving_joint: [link.name for link in links if link.name in case.from_geoms]
        for moving_joint, links in case.mjcf_links.items()
    }
    found = {key for key in case.unexplained if key[0] in INERTIAL_KINDS and geom_links.get(key[1])}
    moving_joints = list(
        dict.fromkeys(name for _, name in case.unexplained if name in {n for _, n in found})
    )
    if found:
        urdf, mjcf = (
            Quantity(sum(tree.bodies[name].mass for name in moving_joints), "kg")
            for tree in (case.urdf_tree, case.aligned_mjcf_tree)
        )
        bodies = [body for name in moving_joints for body in geom_links[name]]
        is_overruled = (
            case.robot.description.mjcf.compiler.inertiafromgeom == _INERTIA_ALWAYS_FROM_GEOM
        )
        message = diagnose(
            "masses-of-geoms", bodies=bodies, overruled=is_overruled, urdf=urdf, mjcf=mjcf
        )
        yield PatternFinding("geoms", message, found)


def find_missing_equalities(case: PatternCase) -> PatternFindings:
    """Report one common cause for two or more equality constraints that are missing in the URDF."""
    found = [name for kind, name in case.unexplained if kind == "equality"]
    if len(found) > 1:
        message = diagnose("equalities-of-the-mjcf-alone", names=found)
        yield PatternFinding("equalities", message, {("equality", name) for name in found})


@dataclass(frozen=True, eq=False)
class _LinkMistake:
    """Mistake in the inertials of some links of a body.

    Attributes:
        moving_joint: Joint that moves the body, or the base.
        links: Links concerned.
        lacks: File without these links, ``URDF`` or ``MJCF``; empty if the mass differs by a
            factor.
        factor: Mass in the MJCF divided by mass in the URDF; 0 if a file lacks the links.
        inertia: Whether the inertia has the same factor; False if a file lacks the links.
    """

    moving_joint: str
    links: tuple[ComparedLink, ...]
    lacks: str
    factor: float = 0.0
    inertia: bool = False


def find_link_mistakes(case: PatternCase) -> PatternFindings:
    """Find links that a file lacks, or whose mass is scaled, as causes of inertial differences."""
    bodies = dict.fromkeys(name for kind, name in case.unexplained if kind in INERTIAL_KINDS)
    if not bodies:
        return
    mistakes = [
        mistake for name in bodies if (mistake := _find_link_mistake(case, name)) is not None
    ]
    groups: dict[tuple[str, float, bool], list[_LinkMistake]] = defaultdict(list)
    for mistake in mistakes:
        groups[mistake.lacks, float(f"{mistake.factor:.3g}"), mistake.inertia].append(mistake)
    for (lacks, *_), group in groups.items():
        moving_joints = {mistake.moving_joint for mistake in group}
        explained = {
            key for key in case.unexplained if key[0] in INERTIAL_KINDS and key[1] in moving_joints
        }
        if lacks:
            yield PatternFinding("links", _describe_lacking_links(group), explained)
        else:
            yield PatternFinding("scaled links", _describe_scaled_links(group), explained)


def _find_link_mistake(case: PatternCase, name: str) -> _LinkMistake | None:
    """Return the mistake in a body's links that explains the body's inertial difference, or None.

    ``name`` is the joint that moves the body, or the base.
    """
    first, second = case.urdf_tree.bodies[name], case.aligned_mjcf_tree.bodies[name]
    difference = compute_moments(first) - compute_moments(second)
    if not first.mass or not second.mass or not difference[0]:
        return None
    lacks, links = ("MJCF", case.urdf_links) if difference[0] > 0 else ("URDF", case.mjcf_links)
    candidates = [
        link for link in links.get(name, ()) if link.body.mass <= 1.01 * abs(difference[0])
    ]
    if len(candidates) < len(links.get(name, ())):  # missing bodies are no missing links
        for subset in _list_subsets(candidates, abs(difference[0])):
            removed = sum((compute_moments(link.body) for link in subset), start=np.zeros(10))
            reduced = body_from_moments(
                compute_moments(first if lacks == "MJCF" else second) - removed
            )
            if _explains_difference(
                case, name, reduced, second if lacks == "MJCF" else first, removed, difference
            ):
                return _LinkMistake(name, subset, lacks)
    kinds = {kind for kind, element in case.unexplained if element == name}
    is_single_link = len(case.urdf_links.get(name, ())) == len(case.mjcf_links.get(name, ())) == 1
    if (
        is_single_link
        and not kinds & {"com", "inertia"}
        and not _is_scaling_by_ten(second.mass / first.mass)
    ):
        return None  # a single number of a single link needs no further cause
    # If another cause explains the inertia, only the mass of the link is tested.
    inertia_options = (False,) if ("inertia", name) in case.explained else (True, False)
    for link, inertia in product(case.urdf_links.get(name, ()), inertia_options):
        factor = 1.0 - float(difference[0]) / link.body.mass
        if factor <= 0:
            continue
        changed = TreeBody(
            factor * link.body.mass,
            link.body.com,
            (factor if inertia else 1.0) * link.body.inertia,
        )
        removed = compute_moments(link.body) - compute_moments(changed)
        if _explains_difference(
            case,
            name,
            body_from_moments(compute_moments(first) - removed),
            second,
            removed,
            difference,
        ):
            return _LinkMistake(name, (link,), "", factor, inertia)
    return None


def _list_subsets(links: Sequence[ComparedLink], mass: float) -> Iterator[tuple[ComparedLink, ...]]:
    """Yield sets of links with a total mass within 3 % of ``mass`` [kg], small sets first."""
    heaviest = sorted(links, key=lambda link: -link.body.mass)[:_MAX_SUBSET_LINKS]
    masses = np.array([link.body.mass for link in heaviest])
    choices = np.array(list(product((False, True), repeat=len(heaviest))))
    near = np.abs(choices @ masses - mass) <= 1.5 * _MAX_RESIDUAL * mass
    for choice in sorted(choices[near].tolist(), key=sum):
        if any(choice):
            yield tuple(link for link, taken in zip(heaviest, choice, strict=True) if taken)


def _explains_difference(
    case: PatternCase,
    name: str,
    first: TreeBody,
    second: TreeBody,
    removed: Array,
    difference: Array,
) -> bool:
    """Return True if a tested mistake explains the inertial difference of a body.

    The two bodies may then differ only in kinds that an earlier cause explains, and at most
    `_MAX_RESIDUAL` of the difference remains. ``first`` is the body without the mistake, ``second``
    the body in the other file. ``removed`` (by undoing the mistake) and ``difference`` (URDF -
    MJCF) are moments, shape (10,), as from `compute_moments`.
    """
    explained_kinds = {kind for kind, element in case.explained if element == name}
    changes = {change.kind for change in body_changes(name, first, second, case.tolerances)}
    if not first.mass > 0 or changes - explained_kinds:
        return False
    scale = _compute_moment_scale(case.urdf_tree.bodies[name], case.aligned_mjcf_tree.bodies[name])
    if "inertia" in explained_kinds:
        scale[4:] = math.inf
    removed = removed if float(removed[0] * difference[0]) >= 0 else -removed
    remaining, total = (
        float(np.linalg.norm(moments / scale)) for moments in (difference - removed, difference)
    )
    return remaining <= _MAX_RESIDUAL * total


def _compute_moment_scale(first: TreeBody, second: TreeBody) -> Array:
    """Compute divisors that make mass, first moments and inertia comparable, shape (10,).

    The divisors are 1, L (3 times) and L^2 (6 times), with a length L [m] of the bodies.
    """
    mass = max(abs(first.mass), abs(second.mass))
    inertia_trace = max(float(np.trace(body.inertia)) for body in (first, second))
    com_distance = max(float(np.linalg.norm(body.com)) for body in (first, second))
    length = max(math.sqrt(max(inertia_trace, 0.0) / mass), com_distance, 1e-6)
    return np.array([1.0, *(length,) * 3, *(length**2,) * 6])


def _describe_lacking_links(mistakes: Sequence[_LinkMistake]) -> Diagnostic:
    """Create the message about the links that a file lacks, with masses [kg], by name pattern."""
    links = {link.name: link.body.mass for mistake in mistakes for link in mistake.links}
    other = "URDF" if mistakes[0].lacks == "MJCF" else "MJCF"
    groups = sorted(
        group_by_pattern(list(links)).items(),
        key=lambda group: -sum(links[name] for name in group[1]),
    )
    messages = []
    for pattern, names in groups:
        masses = [links[name] for name in names]
        alike = len(names) > 1 and math.isclose(min(masses), max(masses), rel_tol=1e-6)
        messages.append(
            diagnose(
                "links-of-a-pattern",
                pattern=pattern,
                count=len(names) if len(names) > 1 else None,
                mass=Quantity(masses[0] if alike else sum(masses), "kg"),
                each=alike,
            )
        )
    mass = Quantity(sum(links.values()), "kg")
    return diagnose("links-lacking", lacks=mistakes[0].lacks, has=other, mass=mass, links=messages)


def _describe_scaled_links(mistakes: Sequence[_LinkMistake]) -> Diagnostic:
    """Create the message about links whose masses in the two files differ by a common factor."""
    factor = float(f"{mistakes[0].factor:.6g}")
    links = [
        diagnose(
            "mass-of-a-link",
            subject=("link", link.name),
            urdf=Quantity(link.body.mass, "kg"),
            mjcf=Quantity(mistake.factor * link.body.mass, "kg"),
        )
        for mistake in mistakes
        for link in mistake.links
    ]
    return diagnose("links-scaled", links=links, factor=factor, inertia=mistakes[0].inertia)


def _is_scaling_by_ten(factor: float) -> bool:
    """Return True if a factor is an integer power of ten other than 1, up to 1e-3 in the log10."""
    if factor <= 0:
        return False
    power = math.log10(factor)
    return math.isclose(power, round(power), abs_tol=1e-3) and round(power) != 0


def group_by_pattern(names: Sequence[str]) -> dict[str, list[str]]:
    """Group names by a common prefix that ends with a separator, or a suffix that begins with one.

    Returns:
        {``*_rotor``, ``sensor_*``, or the complete name: names}.
    """
    remaining, groups = list(names), dict[str, list[str]]()
    while remaining:
        candidates: dict[str, list[str]] = defaultdict(list)
        for name in remaining:
            for place in (match.start() for match in re.finditer(r"[^A-Za-z0-9]", name)):
                candidates[f"*{name[place:]}"].append(name)
                candidates[f"{name[: place + 1]}*"].append(name)
        pattern, group = max(
            candidates.items(), key=lambda item: (len(item[1]), len(item[0])), default=("", [])
        )
        if len(group) < 2:
            return groups | {name: [name] for name in remaining}
        groups[pattern] = group
        remaining = [name for name in remaining if name not in group]
    return groups


_MIN_FOREIGN_MASS_CHANGE = 0.1
"""Smallest relative difference between the masses of a body in both files at which an inertial of
another body is suspected. Chosen, not tuned.
"""


def find_foreign_inertials(case: PatternCase) -> PatternFindings:
    """Find bodies that may have the inertial of another body: mass, CoM and inertia all differ.

    The masses must differ by at least `_MIN_FOREIGN_MASS_CHANGE`. There is no test of this cause.
    """
    kinds = ("mass", "com", "inertia")
    foreign = []
    for name, first in case.urdf_tree.bodies.items():
        second = case.aligned_mjcf_tree.bodies[name]
        if not {(kind, name) for kind in kinds} <= set(case.unexplained):
            continue
        if (
            first.mass
            and second.mass
            and abs(second.mass - first.mass) >= _MIN_FOREIGN_MASS_CHANGE * first.mass
        ):
            foreign.append(name)
    if foreign:
        changes = {
            name: case.aligned_mjcf_tree.bodies[name].mass / case.urdf_tree.bodies[name].mass - 1
            for name in foreign
        }
        foreign.sort(key=lambda name: -round(abs(changes[name]), 9))
        links = [case.urdf_tree.bodies[name].link or name for name in foreign]
        yield PatternFinding(
            "inertial",
            diagnose(
                "inertials-of-another-robot",
                bodies=links,
                one=Quantity(case.urdf_tree.bodies[foreign[0]].mass, "kg"),
                two=Quantity(case.aligned_mjcf_tree.bodies[foreign[0]].mass, "kg"),
                change=Quantity(changes[foreign[0]], "1"),
            ),
            {(kind, name) for kind in kinds for name in foreign},
        )


_MIN_AXIS_SINE = 1e-9
"""Largest sine of the angle between two joint axes [1] that count as parallel when the distance
between them is computed, since the angle may be rounding. Chosen, not tuned.
"""

_MAX_MOVED_JOINTS = 20
"""Largest number of joints with different positions for which a displaced axis of a single joint is
tested as the cause. With more such joints the files describe different robots, and each test takes
as long as a comparison."""


def find_moved_axes(case: PatternCase) -> PatternFindings:
    """Find joints whose axis has another position, and maybe another direction, in the MJCF.

    Such a mistake also changes CoM, children and frames, since these are expressed in the frame of
    the joint.
    """
    names = [element for kind, element in case.keys if kind == "position"]
    for name in names if len(names) <= _MAX_MOVED_JOINTS else ():
        moved = copy_joint_axis(case.aligned_mjcf_tree, case.urdf_tree, name)
        vanished = case.find_explained(moved)
        if ("position", name) not in vanished:
            continue
        distance, angle = _measure_axis_offset(
            case.urdf_tree.joints[name], case.aligned_mjcf_tree.joints[name]
        )
        yield PatternFinding(
            "line",
            diagnose(
                "axis-elsewhere",
                subject=("joint", name),
                distance=Quantity(distance, "m") if distance > case.tolerances.position else None,
                angle=Quantity(angle, "rad") if angle > case.tolerances.axis else None,
            ),
            vanished,
        )


def copy_joint_axis(values: MultibodyTree, other: MultibodyTree, name: str) -> MultibodyTree:
    """Return a copy of a tree in which a joint has the placement and axis of another tree.

    With all joint positions at zero, the bodies have the same poses as before. In both trees the
    frame of the parent must be the same.
    """
    old_joint, new_joint = values.joints[name], other.joints[name]
    shift = new_joint.placement.actInv(old_joint.placement)
    joint = replace(
        old_joint, position=new_joint.position, rotation=new_joint.rotation, axis=new_joint.axis
    )
    shifted = in_body_frame(values, name, np.array(shift.rotation), np.array(shift.translation))
    return replace(shifted, joints={**shifted.joints, name: joint})


def _measure_axis_offset(first_joint: TreeJoint, second_joint: TreeJoint) -> tuple[float, float]:
    """Compute distance [m] and angle [rad] between two joint axes, in the frame of the parent."""
    first, second = (
        first_joint.rotation @ first_joint.axis,
        second_joint.rotation @ second_joint.axis,
    )
    offset, normal = second_joint.position - first_joint.position, np.cross(first, second)
    sine = float(np.linalg.norm(normal))
    if sine > _MIN_AXIS_SINE:
        distance = abs(float(offset @ normal)) / sine
    else:
        distance = float(np.linalg.norm(np.cross(offset, first)))
    return distance, float(np.arctan2(sine, abs(float(first @ second))))


def find_causes(
    robot: Robot,
    second: MultibodyTree,
    differences: Sequence[Difference],
    tolerances: Tolerances,
    from_geoms: Collection[str] = (),
) -> tuple[PatternCause, ...]:
    """Find mistakes that explain two or more differences each, or a single different tensor.

    Args:
        robot: Robot.
        second: Tree of the MJCF, in the body frames of the URDF.
        differences: All differences.
        tolerances: Tolerances of the comparison.
        from_geoms: Bodies of the MJCF whose mass is computed from geoms.

    Returns:
        Causes, each with the indices of differences. A difference belongs to at most one cause.
    """
    if not differences:
        return ()
    first, raw = kinematic_trees(robot)
    keys = [(difference.kind, difference.element) for difference in differences]
    bodies = any(kind in INERTIAL_KINDS for kind, _ in keys)
    urdf = list_urdf_links(robot) if bodies else {}
    mjcf = list_mjcf_links(robot, raw, second) if bodies else {}
    raw = replace(raw, gravity=first.gravity)
    case = PatternCase(robot, first, raw, second, keys, tolerances, urdf, mjcf, from_geoms)
    causes: list[PatternCause] = []
    explained_numbers: set[int] = set()
    for search in _SEARCHES:
        for finding in search(replace(case, explained={keys[n] for n in explained_numbers})):
            numbers = tuple(
                n
                for n, key in enumerate(keys)
                if key in finding.explained and n not in explained_numbers
            )
            if len(numbers) > 1 or (numbers and finding.kind in _SINGLE_KINDS):
                explained_numbers |= set(numbers)
                causes.append(PatternCause(finding.kind, finding.diagnostic, numbers))
    return tuple(sorted(causes, key=lambda cause: (not cause.is_reported_first, cause.differences)))


_SEARCHES = (
    find_angle_settings,
    find_exchanged_limbs,
    find_scaled_quantities,
    find_efforts_before_gears,
    find_products_dropped_by_either,
    find_masses_of_geoms,
    find_missing_equalities,
    find_lost_mimics,
    find_tensor_mistakes,
    find_link_mistakes,
    find_foreign_inertials,
    find_moved_axes,
)
"""Functions that search for causes of differences, in the order of execution. A difference belongs
to the first reported cause that explains it."""
