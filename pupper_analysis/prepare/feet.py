"""Find the feet of a robot, and add a frame at each contact point to URDF and MJCF.

Input is a robot model without named contact points. Outputs are the feet, each with one or several
contact points, and the description with a frame at each point in the URDF and in the MJCF. The feet
are the collision geoms at the ends of the lowest limbs (`find_feet`), or those that the user names
(`find_named_foot`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
import pinocchio as pin

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.arrays import project_perpendicular
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ModelError, UnknownNameError
from pupper_analysis.models.additions import Addition, Ball, DisabledContacts
from pupper_analysis.models.description import Description
from pupper_analysis.models.mjcf import JointKind, add_site, compile_spec
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml import make_unique_name, to_text
from pupper_analysis.prepare.contact_points import (
    ContactPoint,
    compute_lowest_height,
    find_contact_points,
)
from pupper_analysis.robot.alike import list_limbs
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.contact import ground_geom, limb_ends
from pupper_analysis.robot.robot import Robot

_MAX_LEG_HEIGHT_FRACTION = 0.15
"""Factor a [1] of a height bound. A limb counts as a leg if the lowest point of its last body is
less than max(a h, b r) above that of the lowest limb [m]. The height of the base above this lowest
point is h. For b and r see `_MAX_LEG_RISE_FRACTION`. Chosen, not tuned.
"""

MAX_SHORT_LEG_HEIGHT_FRACTION = 0.33
"""Factor a [1] of the bound that `_MAX_LEG_HEIGHT_FRACTION` describes, for robots with legs of
different lengths. Chosen, not tuned: SABO's forelegs end 21 % above its hind legs.
"""

_MAX_LEG_RISE_FRACTION = 0.05
"""Factor b [1] of the bound max(a h, b r) [m] that `_MAX_LEG_HEIGHT_FRACTION` describes. r is the
largest distance of a limb's last body from the base [m]. The term b r is needed for spread legs,
such as a spider's, which end near the height of the base. Chosen, not tuned.
"""

_MAX_SPHERE_DISTANCE = 0.02
"""Upper bound of the distance [m] between a foot frame of the user and the centre of a sphere geom.
Within this distance, `_select_sphere` selects the nearest sphere as contact shape of the foot.
Chosen, not tuned."""


_FOOT_PLACE_ATOL = 2e-3
"""Tolerance [m] with which a link of the URDF counts as at a contact point of the MJCF. Chosen, not
tuned.
"""


@dataclass(frozen=True, eq=False)
class Foot:
    """Foot of a robot, with the contact points on level ground.

    Attributes:
        name: Name.
        body: MuJoCo id of the moving body to which the foot belongs.
        points: Contact points with the ground; a sole usually has several.
    """

    name: str
    body: int
    points: tuple[ContactPoint, ...]


_MIN_DIRECTION_COSINE = 0.7
"""Lower bound [1] of the magnitude of the component of the mean limb direction along an axis of the
base, about 45 deg, with which the limbs count as pointing along this axis. Chosen, not tuned.
"""


_MIN_LIMB_LENGTH = 1e-3
"""Lower bound of the limb length [m] by which a limb vector is divided to get the direction of the
limb. The bound avoids a division by zero. Chosen, not tuned.
"""


def report_sideways_limbs(robot: Robot) -> list[Diagnostic]:
    """Report the axis along which the limbs of a robot point, if the limbs do not point downwards.

    The message proposes a frame above the base, in a URDF and in an MJCF.

    Returns:
        List with a message. Empty if the limbs point downwards, or along no axis of the base, for
        example.
    """
    joints = np.clip(np.zeros(robot.nu), robot.lower_limits, robot.upper_limits)
    data = robot.compute_kinematics(robot.make_qpos(joints))
    ends: dict[int, list[int]] = {}  # an arm with its fingers is one limb
    for limb in list_limbs(robot):
        ends.setdefault(limb.bodies[0], []).append(limb.bodies[-1])
    if len(ends) < 2:
        return []
    spans = np.array([data.xipos[ends[root]].mean(axis=0) - data.xpos[root] for root in ends])
    lengths = np.linalg.norm(spans, axis=1, keepdims=True)
    along = (spans / np.maximum(lengths, _MIN_LIMB_LENGTH)).mean(
        axis=0
    )  # equal weight of all limbs
    axis = int(np.argmax(np.abs(along)))
    sign = float(np.sign(along[axis]))
    if np.abs(along[axis]) < _MIN_DIRECTION_COSINE or (axis == 2 and sign < 0):
        return []
    turn = np.array([[0, sign, 0], [-sign, 0, 0], [2, 0, 0]])[axis] * np.pi / 2
    quaternion = np.array([np.cos(np.linalg.norm(turn) / 2), *np.sin(turn / 2)])
    return [
        diagnose(
            "limbs-aside",
            axis=f"{'-+'[sign > 0]}{'xyz'[axis]}",
            rpy=" ".join(f"{angle:.16g}" for angle in turn),
            quat=" ".join(f"{part:.6g}" for part in np.round(quaternion, 12) + 0.0),
        )
    ]


def count_joints_to_base(robot: Robot, body: int) -> int:
    """Count the joints on the chain from a body (MuJoCo id) to the base."""
    model, count = robot.mj_model, 0
    base = model.body(robot.mj_base).id
    while body not in (0, base):
        count += int(model.body_jntnum[body])
        body = int(model.body_parentid[body])
    return count


def list_ground_geoms(model: mujoco.MjModel, body: int, *, welded: bool = True) -> list[int]:
    """Return the ids of the geoms of a body that can collide with the floor; empty without a floor.

    Two geoms can collide if the contype of either matches the conaffinity of the other.

    Args:
        model: Model.
        body: Id of the body.
        welded: True to include the geoms of bodies that are fixed to the body; ``body`` must then
            be a moving body. False: only the geoms of the body itself.
    """
    floor = ground_geom(model)
    if floor is None:
        return []
    floor_bits = (model.geom_contype[floor], model.geom_conaffinity[floor])
    return [
        geom
        for geom in range(model.ngeom)
        if (model.body_weldid[model.geom_bodyid[geom]] if welded else model.geom_bodyid[geom])
        == body
        and (
            model.geom_contype[geom] & floor_bits[1] or model.geom_conaffinity[geom] & floor_bits[0]
        )
    ]


def find_feet(
    robot: Robot, poses: Iterable[Array], height_fraction: float = _MAX_LEG_HEIGHT_FRACTION
) -> tuple[Foot, ...]:
    """Detect the feet of a robot: the collision geoms at the ends of the lowest limbs.

    The result belongs to the pose with the most feet: in some poses the legs may be folded.

    Args:
        robot: Robot without feet; the MJCF has a floor.
        poses: Joint positions of each pose, at least one, shape (nu,) [rad, m].
        height_fraction: Factor a [1] of the height bound, see `_MAX_LEG_HEIGHT_FRACTION`.

    Raises:
        ModelError: If there is a pose in which no limb with collision geoms ends below the base.
    """
    return max((_find_lowest_limbs(robot, pose, height_fraction) for pose in poses), key=len)


def _find_lowest_limbs(robot: Robot, joints: Array, height_fraction: float) -> tuple[Foot, ...]:
    """Find the feet in a pose: the ends of the limbs that reach about as low as the lowest limb.

    ``joints`` are the joint positions of the pose, shape (nu,) [rad, m]; the base is level.
    """
    model, data = robot.mj_model, robot.compute_kinematics(robot.make_qpos(joints))
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
    offsets = data.xpos[list(heights)] - data.xpos[model.body(robot.mj_base).id]
    reach = float(np.linalg.norm(offsets, axis=1).max())
    tolerance = max(height_fraction * (base - bottom), _MAX_LEG_RISE_FRACTION * reach)
    legs = [body for body, height in heights.items() if height < bottom + tolerance]
    found = [
        (
            body,
            find_contact_points(model, data, body, ends[body], count_joints_to_base(robot, body)),
        )
        for body in legs
    ]
    names = _name_feet(model, found)
    return tuple(
        Foot(name, body, points)
        for name, (body, points) in zip(names, found, strict=True)
        if points
    )


def _name_feet(
    model: mujoco.MjModel, feet: Sequence[tuple[int, tuple[ContactPoint, ...]]]
) -> list[str]:
    """Choose a name for each foot: the name of its geom, or the name of its body.

    ``feet`` are pairs: id of the foot's body, and contact points.
    """
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
    """Find the contact points of a foot that the user names.

    The foot is the element ``frames[1]`` of the MJCF, or else the link ``frames[0]`` of the URDF. A
    named geom is the contact shape of the foot; otherwise the contact shapes are collision geoms of
    the foot's body, such as a sphere near the frame.

    Args:
        robot: Robot without feet; the MJCF has a floor.
        name: Name of the foot.
        frames: Name of the link in the URDF, and name of the geom, site or body in the MJCF.
        joints: Joint positions in which distances to spheres are measured (start pose), shape (nu,)
            [rad, m].

    Raises:
        UnknownNameError: If the MJCF has no such geom, site or body, and the URDF no such link.
        ModelError: If no geom of the foot gives a contact point.
    """
    model, data = robot.mj_model, robot.compute_kinematics(robot.make_qpos(joints))
    _, frame = frames
    places = [
        (kind, mujoco.mj_name2id(model, kind, frame))
        for kind in (mujoco.mjtObj.mjOBJ_GEOM, mujoco.mjtObj.mjOBJ_SITE, mujoco.mjtObj.mjOBJ_BODY)
    ]
    found = next(((kind, index) for kind, index in places if index >= 0), None)
    if found is None:
        body, place = _locate_link(robot, name, frames, joints)
        geoms = _select_sphere(model, data, list_ground_geoms(model, body), place)
    elif found[0] == mujoco.mjtObj.mjOBJ_GEOM:
        geoms = [found[1]]
        body = int(model.body_weldid[model.geom_bodyid[found[1]]])
    elif found[0] == mujoco.mjtObj.mjOBJ_SITE:
        body = int(model.body_weldid[model.site_bodyid[found[1]]])
        geoms = _select_sphere(
            model, data, list_ground_geoms(model, body), data.site_xpos[found[1]]
        )
    else:
        body = int(model.body_weldid[found[1]])
        geoms = list_ground_geoms(model, found[1], welded=False) or _select_sphere(
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


def _select_sphere(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: Sequence[int], place: Array
) -> list[int]:
    """Select the nearest sphere geom at a foot frame that the user names, else all given geoms.

    ``place`` is the position of the frame, shape (3,) [m], in the world frame.
    """
    sphere = mujoco.mjtGeom.mjGEOM_SPHERE.value
    spheres = [geom for geom in geoms if model.geom_type[geom] == sphere]
    distances = {geom: float(np.linalg.norm(data.geom_xpos[geom] - place)) for geom in spheres}
    nearest = min(distances, key=distances.__getitem__, default=None)
    return (
        [nearest]
        if nearest is not None and distances[nearest] < _MAX_SPHERE_DISTANCE
        else list(geoms)
    )


def _locate_link(
    robot: Robot, name: str, frames: tuple[str, str], joints: Array
) -> tuple[int, Array]:
    """Find the MuJoCo body that moves a link of the URDF, and the link's position (3,) [m].

    The position is in the world frame. The body is the base if no joint of the robot moves the
    link.
    """
    model, (link, frame) = robot.pin_model, frames
    number = next(
        (index for index, pin_frame in enumerate(model.frames) if pin_frame.name == link), None
    )
    if number is None:
        mj_model, files = robot.mj_model, robot.description
        geoms = [mj_model.geom(index).name for index in range(mj_model.ngeom)]
        sites = [mj_model.site(index).name for index in range(mj_model.nsite)]
        bodies = [mj_model.body(index).name for index in range(1, mj_model.nbody)]
        links = [frame.name for frame in model.frames if frame.type == pin.FrameType.BODY]
        unknown = UnknownNameError(
            ", ".join(dict.fromkeys((str(files.urdf_source), str(files.mjcf_source)))),
            "link, geom, site or body",
            frame,
            tuple(filter(None, dict.fromkeys([*links, *geoms, *sites, *bodies]))),
        )
        raise unknown.with_location(diagnose("of-foot", subject=("foot", name)))
    joint = model.names[model.frames[number].parentJoint]
    if joint in robot.joint_names:
        body = int(robot.mj_model.jnt_bodyid[robot.mj_model.joint(joint).id])
    else:
        body = int(robot.mj_model.body(robot.mj_base).id)
    qpos = robot.make_qpos(joints)
    place = Configuration(robot, qpos).frame_position(link)
    return int(robot.mj_model.body_weldid[body]), place


def add_contact_frames(
    robot: Robot, feet: Sequence[Foot], replaced: Mapping[str, Diagnostic] | None = None
) -> Description:
    """Add a frame at each contact point to URDF and MJCF; return the changed description.

    The frame is a link in the URDF and a site in the MJCF. For the feet in ``replaced``, ball geoms
    replace the contacts of the shapes that they approximate (`is_ball`).

    Args:
        robot: Robot without feet.
        feet: Feet.
        replaced: {foot: reason for replacing the collision shapes by balls}; None: no shape is
            replaced.
    """
    model, spec = robot.mj_model, robot.description.mjcf.copy()
    data = robot.compute_kinematics(robot.make_qpos(np.zeros(robot.nu)))
    config = Configuration(robot, robot.neutral())
    tree = UrdfTree.of(robot.description.urdf)
    bodies = {body.name: body for body in spec.bodies}
    _name_geoms(spec)
    compiled = compile_spec(spec.copy(), robot.description.mjcf_source)
    names: dict[str, tuple[str, str]] = {}
    points_of_foot: dict[str, tuple[str, ...]] = {}
    geoms: dict[str, tuple[str, float]] = {}
    shapes: dict[Diagnostic, list[str]] = {}
    added: list[Addition] = []
    site_names, made_frames = {site.name for site in spec.sites} | set(tree.links), set[str]()
    for foot in feet:
        link = _find_moved_link(robot, foot.body)
        link_pose = config.frame_position(link), config.frame_rotation(link)
        points = []
        for number, point in enumerate(foot.points, start=1):
            name = foot.name if len(foot.points) == 1 else f"{foot.name}/{number}"
            frame = make_unique_name(f"{name} (contact)", site_names)
            # The site is on the body of the geom: MuJoCo's contact depends on this body's inertia.
            geom_body = int(model.geom_bodyid[point.geom])
            add_site(bodies[model.body(geom_body).name], name=frame, pos=point.center)
            world = data.xpos[geom_body] + data.xmat[geom_body].reshape(3, 3) @ point.center
            world = _map_to_urdf(robot, config, data, foot.body, world)
            made_frames.add(frame)
            tree.add_link(frame, link, f"to {frame}", link_pose[1].T @ (world - link_pose[0]))
            names[name] = (frame, frame)
            touching = str(compiled.geom(point.geom).name)
            reason = (replaced or {}).get(foot.name)
            if reason is not None and is_ball(model, point):
                body, place = str(model.body(geom_body).name), tuple(map(float, point.center))
                added.append(Ball(reason, f"{name}_ball", body, point.radius, place, touching))
                shapes.setdefault(reason, []).append(touching)
                touching = f"{name}_ball"
            geoms[name] = (touching, point.radius)
            points.append(name)
        if len(points) > 1:
            points_of_foot[foot.name] = tuple(points)
    for reason, geom_names in shapes.items():  # after the balls, which copy the contact parameters
        added.append(DisabledContacts(reason, tuple(dict.fromkeys(geom_names))))
    described = replace(
        robot.description,
        urdf=to_text(tree.root),
        mjcf=spec,
        contact_points=names,
        feet=points_of_foot,
        foot_geoms=geoms,
        made_frames=frozenset(made_frames),
    )
    return described.with_additions(*added)


def has_ellipsoids(robot: Robot, feet: Sequence[Foot]) -> bool:
    """Return True if a contact point of the feet is a sphere that approximates an ellipsoid."""
    types = robot.mj_model.geom_type
    return any(
        types[point.geom] == mujoco.mjtGeom.mjGEOM_ELLIPSOID.value
        for foot in feet
        for point in foot.points
        if is_ball(robot.mj_model, point)
    )


CONTACT_POINT_TOLERANCE = 1e-6
"""Upper bound of the displacement of a contact point between two successive fits of spheres to
ellipsoids [m]. If a point moves farther, the fit is repeated. Chosen, not tuned.
"""


def measure_point_displacement(before: Sequence[Foot], after: Sequence[Foot]) -> float:
    """Return the largest displacement of a contact point between two fits of the same feet [m].

    Positions are compared in the frame of the geom's body. The result is 0 if ``before`` and
    ``after`` contain different feet or geoms.
    """
    points = [[(foot.name, point) for foot in feet for point in foot.points] for feet in
              (before, after)]  # fmt: skip
    if [(name, point.geom) for name, point in points[0]] != [(n, p.geom) for n, p in points[1]]:
        return 0.0
    return max(
        (
            float(np.linalg.norm(old.center - new.center))
            for (_, old), (_, new) in zip(*points, strict=True)
        ),
        default=0.0,
    )


_RADIUS_RTOL = 1e-9
"""Relative tolerance with which the radii of a contact point and of a cylinder are equal. Chosen,
not tuned."""


def is_ball(model: mujoco.MjModel, point: ContactPoint) -> bool:
    """Return True if a contact point is a ball that approximates a mesh or another shape.

    Contact points of spheres and capsules are no such balls: these geoms themselves touch the
    ground. A point of a cylinder with the radius of the cylinder (a wheel) is no ball either.
    """
    kind = int(model.geom_type[point.geom])
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER.value and math.isclose(
        point.radius, model.geom_size[point.geom, 0], rel_tol=_RADIUS_RTOL
    ):
        return False  # wheel on its side
    round_types = (mujoco.mjtGeom.mjGEOM_SPHERE.value, mujoco.mjtGeom.mjGEOM_CAPSULE.value)
    return point.radius > 0 and kind not in round_types


def _map_to_urdf(
    robot: Robot, config: Configuration, data: mujoco.MjData, body: int, world: Array
) -> Array:
    """Convert a position on a body of the MJCF to the position of this point in the URDF.

    If the axes of the body's last joint differ between the files, the position is usually shifted
    by their perpendicular offset. The position of a joint frame along its axis has no meaning.
    ``world`` and the result are positions, shape (3,) [m], in the world frame.
    """
    joint = _find_last_joint(robot, body, turning=True)
    if joint is None:
        return world
    axis_offset = config.joint_position(joint) - data.xanchor[robot.mj_model.joint(joint).id]
    model = robot.pin_model
    link_positions = [
        config.frame_position(frame.name)
        for frame in model.frames
        if frame.type == pin.FrameType.BODY and model.names[frame.parentJoint] == joint
    ]
    for place in (world, world + axis_offset):
        if any(np.linalg.norm(place - position) < _FOOT_PLACE_ATOL for position in link_positions):
            return place
    return world + project_perpendicular(axis_offset, config.joint_axis(joint))


def _name_geoms(spec: mujoco.MjSpec) -> None:
    """Give a name to each geom without a name, to identify the geom in the compiled model."""
    geom_names = {geom.name for geom in spec.geoms}
    for number, geom in enumerate(spec.geoms):
        geom.name = geom.name or make_unique_name(f"geom_{number}", geom_names)


def _find_moved_link(robot: Robot, body: int) -> str:
    """Return the URDF link that moves with a MuJoCo body (id); the base link without a joint."""
    joint = _find_last_joint(robot, body)
    return robot.base if joint is None else UrdfTree.of(robot.description.urdf).moved_links[joint]


def _find_last_joint(robot: Robot, body: int, *, turning: bool = False) -> str | None:
    """Return the robot's joint that is nearest to a body (id) on the chain to the base, or None.

    ``turning``: slides are skipped.
    """
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
