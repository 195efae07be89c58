"""Which feet a robot has, and where they are in both of its files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.arrays import project_perpendicular
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ModelError, UnknownNameError
from pupper_analysis.models.additions import Addition, Ball, DisabledContacts
from pupper_analysis.models.description import Description
from pupper_analysis.models.mjcf import JointKind, compile_spec
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml import make_unique_name, to_text
from pupper_analysis.prepare.contact_points import (
    ContactPoint,
    compute_lowest_height,
    find_contact_points,
)
from pupper_analysis.robot.alike import limbs_of
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.contact import ground_geom, limb_ends
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]

_AS_LOW = 0.15
"""Limbs that end no higher than this above the lowest, in parts of the base's height above it, are
legs: hands and heads are higher, and feet in a start pose rarely at more than a few percent."""

_LEVEL = 0.05
"""Or in parts of how far the limbs' last bodies are from the base: legs that are spread as a
spider's end at the base's height, or so."""

_SPHERE_DISTANCE = 0.02
"""A sphere whose centre is no further from a URDF's link is the foot that the link means (m)."""


_SAME_PLACE = 2e-3
"""A link of the URDF that is no further away is at a foot's place (m)."""


@dataclass(frozen=True, eq=False)
class Foot:
    """A foot, as it was found.

    Attributes:
        name: Its name.
        body: The id of the moving body that carries it.
        points: Where it touches the ground.
    """

    name: str
    body: int
    points: tuple[ContactPoint, ...]


_DOWN = 0.7
"""Cosine of how far from downwards limbs end, on the whole, to be told: 45 deg."""


_SHORTEST = 1e-3  # m: of a wheel there is no direction


def report_sideways_limbs(robot: Robot) -> list[Diagnostic]:
    """Tells along which axis of its base's frame a robot's limbs end, if that is not downwards.

    With joints as near to zero as they come. A file of such a frame says nowhere what is up.
    """
    joints = np.clip(np.zeros(robot.nu), robot.lower_limits, robot.upper_limits)
    data = robot.placed(robot.posed(joints))
    ends: dict[int, list[int]] = {}  # an arm is one limb, however many fingers it has
    for limb in limbs_of(robot):
        ends.setdefault(limb.bodies[0], []).append(limb.bodies[-1])
    if len(ends) < 2:
        return []
    spans = np.array([data.xipos[ends[root]].mean(axis=0) - data.xpos[root] for root in ends])
    lengths = np.linalg.norm(spans, axis=1, keepdims=True)
    along = (spans / np.maximum(lengths, _SHORTEST)).mean(axis=0)  # one long arm is no robot's legs
    axis = int(np.argmax(np.abs(along)))
    sign = float(np.sign(along[axis]))
    if np.abs(along[axis]) < _DOWN or (axis == 2 and sign < 0):
        return []
    turn = np.array([[0, sign, 0], [-sign, 0, 0], [2, 0, 0]])[axis] * np.pi / 2
    where, rpy = f"{'-+'[sign > 0]}{'xyz'[axis]}", " ".join(f"{angle:.16g}" for angle in turn)
    return [diagnose("limbs-aside", axis=where, rpy=rpy)]


def count_joints_to_base(robot: Robot, body: int) -> int:
    """Returns how many joints move a body (its id) against the base."""
    model, count = robot.mj_model, 0
    base = model.body(robot.mj_base).id
    while body not in (0, base):
        count += int(model.body_jntnum[body])
        body = int(model.body_parentid[body])
    return count


def list_ground_geoms(model: mujoco.MjModel, body: int, *, welded: bool = True) -> list[int]:
    """Returns the geoms of a body, and of those welded to it, that can touch the floor."""
    floor = ground_geom(model)
    bits = (model.geom_contype[floor], model.geom_conaffinity[floor])
    return [
        geom
        for geom in range(model.ngeom)
        if (model.body_weldid[model.geom_bodyid[geom]] if welded else model.geom_bodyid[geom])
        == body
        and (model.geom_contype[geom] & bits[1] or model.geom_conaffinity[geom] & bits[0])
    ]


def find_feet(robot: Robot, poses: Iterable[Array]) -> tuple[Foot, ...]:
    """Finds the feet: the collision geoms at the ends of the limbs that are lowest in a pose.

    Of several poses the one counts in which the most limbs are as low as the lowest: a robot that
    lies, or whose legs are folded, shows fewer.

    Args:
        robot: The robot, without feet; its MJCF has a floor.
        poses: Joint positions (nu,).

    Raises:
        ModelError: If no limb has anything that touches.
    """
    return max((_lowest_limbs(robot, pose) for pose in poses), key=len)


def _lowest_limbs(robot: Robot, joints: Array) -> tuple[Foot, ...]:
    model, data = robot.mj_model, robot.placed(robot.posed(joints))
    ends = {body: list_ground_geoms(model, body) for body in limb_ends(model)}
    heights = {
        body: compute_lowest_height(model, data, geoms) for body, geoms in ends.items() if geoms
    }
    base = float(data.xpos[model.body(robot.mj_base).id][2])
    if not heights or min(heights.values()) >= base:
        limbs = [model.body(body).name for body in ends]
        aside = report_sideways_limbs(robot) if heights else []
        problem = (*aside, diagnose("no-feet-found", limbs=limbs))[0]
        raise ModelError(robot.description.mjcf_source, problem)
    bottom = min(heights.values())
    away = data.xpos[list(heights)] - data.xpos[model.body(robot.mj_base).id]
    reach = float(np.linalg.norm(away, axis=1).max())
    near = max(_AS_LOW * (base - bottom), _LEVEL * reach)
    legs = [b for b, height in heights.items() if height < bottom + near]
    found = [
        (
            body,
            find_contact_points(model, data, body, ends[body], count_joints_to_base(robot, body)),
        )
        for body in legs
    ]
    names = _names(model, found)
    return tuple(
        Foot(name, body, points)
        for name, (body, points) in zip(names, found, strict=True)
        if points
    )


def _names(
    model: mujoco.MjModel, feet: Sequence[tuple[int, tuple[ContactPoint, ...]]]
) -> list[str]:
    """Names feet by their geom, if all that touches is one with a name; else by their body."""
    names = []
    for body, points in feet:
        geoms = {point.geom for point in points}
        geom = min(geoms, default=-1)
        own = int(model.geom_bodyid[geom]) if geoms else body
        name = model.geom(geom).name if len(geoms) == 1 else ""
        names.append(str(name or model.body(own).name))
    if len(set(names)) < len(names):
        names = [str(model.body(body).name) for body, _ in feet]
    return names


def find_named_foot(robot: Robot, name: str, frames: tuple[str, str], joints: Array) -> Foot:
    """Finds a foot that is named, in one file or in both.

    Args:
        robot: The robot, without feet; its MJCF has a floor.
        name: What the foot is called.
        frames: Its link in the URDF, and its geom, site or body in the MJCF.
        joints: (nu,) the start pose.

    Raises:
        UnknownNameError: If neither file has it.
        ModelError: If nothing there touches the ground.
    """
    model, data = robot.mj_model, robot.placed(robot.posed(joints))
    _, frame = frames
    places = [
        (kind, mujoco.mj_name2id(model, kind, frame))
        for kind in (mujoco.mjtObj.mjOBJ_GEOM, mujoco.mjtObj.mjOBJ_SITE, mujoco.mjtObj.mjOBJ_BODY)
    ]
    found = next(((kind, index) for kind, index in places if index >= 0), None)
    if found is None:
        body, place = _by_link(robot, name, frames, joints)
        geoms = _around(model, data, list_ground_geoms(model, body), place)
    elif found[0] == mujoco.mjtObj.mjOBJ_GEOM:
        geoms = [found[1]]
        body = int(model.body_weldid[model.geom_bodyid[found[1]]])
    elif found[0] == mujoco.mjtObj.mjOBJ_SITE:
        body = int(model.body_weldid[model.site_bodyid[found[1]]])
        geoms = _around(model, data, list_ground_geoms(model, body), data.site_xpos[found[1]])
    else:
        body = int(model.body_weldid[found[1]])
        geoms = list_ground_geoms(model, found[1], welded=False) or _around(
            model, data, list_ground_geoms(model, body), data.xpos[found[1]]
        )
    points = (
        find_contact_points(model, data, body, geoms, count_joints_to_base(robot, body))
        if geoms
        else ()
    )
    if not points:
        carrier = model.body(body).name
        problem = diagnose("foot-touches-nothing", subject=("foot", name), body=carrier)
        raise ModelError(robot.description.mjcf_source, problem)
    return Foot(name, body, points)


def _around(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: Sequence[int], place: Array
) -> list[int]:
    """Returns the sphere that is centred at a place, if there is one; else all."""
    sphere = mujoco.mjtGeom.mjGEOM_SPHERE.value
    spheres = [geom for geom in geoms if model.geom_type[geom] == sphere]
    away = {geom: float(np.linalg.norm(data.geom_xpos[geom] - place)) for geom in spheres}
    nearest = min(away, key=away.__getitem__, default=None)
    return [nearest] if nearest is not None and away[nearest] < _SPHERE_DISTANCE else list(geoms)


def _by_link(robot: Robot, name: str, frames: tuple[str, str], joints: Array) -> tuple[int, Array]:
    """Returns the moving body (its id) that carries a link of the URDF, and the link's place."""
    model, (link, frame) = robot.pin_model, frames
    number = next((i for i, known in enumerate(model.frames) if known.name == link), None)
    if number is None:
        sites = [robot.mj_model.site(i).name for i in range(robot.mj_model.nsite)]
        bodies = [robot.mj_model.body(i).name for i in range(1, robot.mj_model.nbody)]
        links = [known.name for known in model.frames]
        unknown = UnknownNameError(
            f"{robot.description.urdf_source}, {robot.description.mjcf_source}",
            "link, geom, site or body",
            frame,
            list(dict.fromkeys([*links, *sites, *bodies])),
        )
        raise unknown.at(diagnose("of-foot", subject=("foot", name)))
    joint = model.names[model.frames[number].parentJoint]
    if joint in robot.joint_names:
        body = int(robot.mj_model.jnt_bodyid[robot.mj_model.joint(joint).id])
    else:
        body = int(robot.mj_model.body(robot.mj_base).id)
    qpos = robot.posed(joints)
    place = Configuration(robot, qpos).frame_position(link)
    return int(robot.mj_model.body_weldid[body]), place


def with_feet(
    robot: Robot, feet: Sequence[Foot], replaced: Mapping[str, Diagnostic] | None = None
) -> Description:
    """Returns the robot's description with a frame at every contact point, in both files.

    Args:
        robot: The robot, without feet.
        feet: Its feet.
        replaced: {foot with balls in the place of its shape: why}.
    """
    model, spec = robot.mj_model, robot.description.mjcf.copy()
    data = robot.placed(robot.posed(np.zeros(robot.nu)))
    still = Configuration(robot, robot.neutral())
    tree = UrdfTree.of(robot.description.urdf)
    bodies = {body.name: body for body in spec.bodies}
    _name_geoms(spec)
    # It may lack what is only seen.
    compiled = compile_spec(spec.copy(), robot.description.mjcf_source)
    names: dict[str, tuple[str, str]] = {}
    several: dict[str, tuple[str, ...]] = {}
    geoms: dict[str, tuple[str, float]] = {}
    shapes: dict[Diagnostic, list[str]] = {}
    added: list[Addition] = []
    taken, made = {site.name for site in spec.sites} | set(tree.links), set[str]()
    for foot in feet:
        link = _link_of(robot, foot.body)
        placed = still.frame_position(link), still.frame_rotation(link)
        points = []
        for number, point in enumerate(foot.points, start=1):
            name = foot.name if len(foot.points) == 1 else f"{foot.name}/{number}"
            frame = make_unique_name(f"{name} (contact)", taken)
            own = int(model.geom_bodyid[point.geom])  # its weight is what MuJoCo's contact knows
            bodies[model.body(own).name].add_site(name=frame, pos=point.center)
            world = data.xpos[own] + data.xmat[own].reshape(3, 3) @ point.center
            world = _in_urdf(robot, still, data, foot.body, world)
            made.add(frame)
            tree.add_link(frame, link, f"to {frame}", placed[1].T @ (world - placed[0]))
            names[name] = (frame, frame)
            touching = str(compiled.geom(point.geom).name)
            if is_ball(model, point):
                reason = (replaced or {})[foot.name]
                body, place = str(model.body(own).name), tuple(map(float, point.center))
                added.append(Ball(reason, f"{name}_ball", body, point.radius, place, touching))
                shapes.setdefault(reason, []).append(touching)
                touching = f"{name}_ball"
            geoms[name] = (touching, point.radius)
            points.append(name)
        if len(points) > 1:
            several[foot.name] = tuple(points)
    for reason, names_of in shapes.items():  # the balls have their contact before it is turned off
        added.append(DisabledContacts(reason, tuple(dict.fromkeys(names_of))))
    described = replace(
        robot.description,
        urdf=to_text(tree.root),
        mjcf=spec,
        contact_points=names,
        feet=several,
        foot_geoms=geoms,
        made_frames=frozenset(made),
    )
    return described.given(*added)


def has_ellipsoids(robot: Robot, feet: Sequence[Foot]) -> bool:
    """Return whether a sphere takes the place of an ellipsoid at a contact point of the feet."""
    types = robot.mj_model.geom_type
    return any(
        types[point.geom] == mujoco.mjtGeom.mjGEOM_ELLIPSOID.value
        for foot in feet
        for point in foot.points
        if is_ball(robot.mj_model, point)
    )


_CONTACT_POINT_TOLERANCE = 1e-6
"""Distance [m] by which the sphere of an ellipsoid may miss the fit at the nominal stand. Chosen:
a hundredth of the depth of a loaded contact."""


def have_contact_points_moved(before: Sequence[Foot], after: Sequence[Foot]) -> bool:
    """Return whether two fits of the same contact points differ; False if the feet differ."""
    points = [[(foot.name, point) for foot in feet for point in foot.points] for feet in
              (before, after)]  # fmt: skip
    if [(name, point.geom) for name, point in points[0]] != [(n, p.geom) for n, p in points[1]]:
        return False
    return any(
        np.linalg.norm(old.center - new.center) > _CONTACT_POINT_TOLERANCE
        for (_, old), (_, new) in zip(*points, strict=True)
    )


def is_ball(model: mujoco.MjModel, point: ContactPoint) -> bool:
    """Tells whether a contact point is that of a sphere which fits to a mesh or another shape."""
    kind = int(model.geom_type[point.geom])
    if (
        kind == mujoco.mjtGeom.mjGEOM_CYLINDER.value
        and point.radius == model.geom_size[point.geom, 0]
    ):
        return False  # a wheel, which lies
    round_ones = (mujoco.mjtGeom.mjGEOM_SPHERE.value, mujoco.mjtGeom.mjGEOM_CAPSULE.value)
    return point.radius > 0 and kind not in round_ones


def _in_urdf(
    robot: Robot, still: Configuration, data: mujoco.MjData, body: int, world: Array
) -> Array:
    """Returns where the URDF has a place (3,) of the MJCF, both at zero angles (m).

    Where the last joint's axis is one line in both files, it is the same place against the base:
    how far along its axis a joint's frame is says nothing. Where it is not, and the URDF has a
    link in the place against the joint, it is there. A slide is a direction, and no line.
    """
    joint = _last_joint(robot, body, turning=True)
    if joint is None:
        return world
    apart = still.joint_position(joint) - data.xanchor[robot.mj_model.joint(joint).id]
    model = robot.pin_model
    own = [
        still.frame_position(frame.name)
        for frame in model.frames
        if frame.type == pin.FrameType.BODY and model.names[frame.parentJoint] == joint
    ]
    for place in (world, world + apart):
        if any(np.linalg.norm(place - there) < _SAME_PLACE for there in own):
            return place
    return world + project_perpendicular(apart, still.joint_axis(joint))


def _name_geoms(spec: mujoco.MjSpec) -> None:
    """Names the geoms that have no name, so that they are found again."""
    known = {geom.name for geom in spec.geoms}
    for number, geom in enumerate(spec.geoms):
        geom.name = geom.name or make_unique_name(f"geom_{number}", known)


def _link_of(robot: Robot, body: int) -> str:
    """Returns the URDF's link that the last joint of a body moves."""
    joint = _last_joint(robot, body)
    return robot.base if joint is None else UrdfTree.of(robot.description.urdf).moved_links[joint]


def _last_joint(robot: Robot, body: int, *, turning: bool = False) -> str | None:
    """Returns the last joint that moves a body against the base; if wanted, the last that turns."""
    model = robot.mj_model
    slide = JointKind.SLIDE
    while body:
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        for joint in range(first + count - 1, first - 1, -1):
            name = str(model.joint(joint).name)
            if name not in robot.joint_names:
                return None
            if not (turning and model.jnt_type[joint] == slide):
                return name
        body = int(model.body_parentid[body])
    return None
