"""Text of converted model files, before writing.

`draft_mjcf` converts a URDF to an MJCF, and adds servos and, for a free base, a floor, feet and a
keyframe in which the robot stands. `draft_urdf` converts an MJCF to a URDF. Both list the
quantities that the new format cannot express.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from lxml import etree
from numpy.typing import ArrayLike

from pupper_analysis.base.diagnostics import Diagnostic, Term, diagnose
from pupper_analysis.base.errors import ModelError, PupperAnalysisError
from pupper_analysis.base.units import DOWNWARD_GRAVITY, select_joint_units
from pupper_analysis.models.additions import (
    Addition,
    Ball,
    Floor,
    Servo,
    StartKeyframe,
    apply_additions,
)
from pupper_analysis.models.attributes import (
    FLOOR_NAME,
    HOME_KEYFRAME,
    IMU_SENSORS,
    AttributeValue,
    known_limit,
)
from pupper_analysis.models.efforts import EffortCode
from pupper_analysis.models.mjcf import JointKind
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.stated.mjcf import (
    ParameterValues,
    element_values,
    find_collidable_geoms,
)
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.models.urdf_tree import WORLD_LINK
from pupper_analysis.models.xml import add_element, join_numbers, new_file_text
from pupper_analysis.prepare.contact_points import compute_lowest_height
from pupper_analysis.prepare.convert.from_urdf import (
    COLLISION_CLASS,
    ConvertedMjcf,
    MjcfOptions,
    MjcfXml,
    UrdfBodies,
    format_xml_value,
)
from pupper_analysis.prepare.convert.repair import Repair
from pupper_analysis.prepare.convert.to_urdf import ConvertedUrdf
from pupper_analysis.prepare.notes import describe_span
from pupper_analysis.prepare.passes import list_urdf_ground_additions, make_robot
from pupper_analysis.prepare.published_model import PublishedModel, place_at_state
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.soft_ground import solve_stand_on_soft_ground

_CONVERTED_TAGS = ("link", "joint", "material")
"""Children of ``<robot>`` that are converted. Other tags (``<transmission>``, ``<gazebo>``,
``<mujoco>`` ...) belong to other programs."""

_LOST_JOINT_TAGS = ("safety_controller", "calibration")
"""Children of a URDF's ``<joint>`` that an MJCF cannot express."""


@dataclass(frozen=True)
class ConversionDraft:
    """A converted model file before writing.

    Attributes:
        text: XML text. Mesh paths are relative to the folder of the output file.
        meshes: Mesh files to be written beside the output file, with contents.
        notes: Additions and assumptions.
        not_converted: Quantities that the new format cannot express, and omitted elements.
        repairs: Repaired inertials.
        urdf: Source URDF with repaired inertials, with which a new MJCF is compared. None for a new
            URDF.
        stands: True for a new MJCF with a free base. The stand of such a robot must be verified.
        failure: Reason why the robot does not stand, if already known.
        lost: Missing parts that make the conversion fail, for example collision meshes.
        on_balls: Joints whose foot has a collision sphere in place of a mesh; a note reports them.
    """

    text: str
    meshes: dict[Path, bytes]
    notes: tuple[Diagnostic, ...]
    not_converted: tuple[Diagnostic, ...]
    repairs: tuple[Repair, ...] = ()
    urdf: UrdfFile | None = None
    stands: bool = False
    failure: Diagnostic | None = None
    lost: tuple[Diagnostic, ...] = ()
    on_balls: frozenset[str] = frozenset()


@dataclass(frozen=True, eq=False)
class NewMjcf(MjcfXml):
    """XML tree of a new MJCF, with methods that add what a simulation needs.

    `apply_additions` makes the same additions to this tree and to a `SpecTree`.
    """

    @property
    def joints(self) -> list[etree._Element]:
        """Elements of all hinge and slide joints of the new MJCF."""
        return list(self.section("worldbody").iter("joint"))

    def remove_empty_sections(self) -> None:
        """Remove the top-level elements without children and attributes, except ``<worldbody>``."""
        for node in list(self.root):
            if node.tag != "worldbody" and not len(node) and not node.attrib:
                self.root.remove(node)

    def set_options(self, values: Mapping[str, AttributeValue]) -> None:
        """Set attributes of ``<option>``, for example ``{"timestep": 0.002}``."""
        option = self.root.find("option")
        if option is None:
            option = etree.Element("option")
            self.root.insert(1, option)
        option.attrib.update({name: format_xml_value(value) for name, value in values.items()})

    def add_floor(self) -> None:
        """Add a light, and a horizontal floor at height 0 with a checkered material."""
        asset, world = self.section("asset"), self.section("worldbody")
        add_element(
            asset, "texture", name=FLOOR_NAME, type="2d", builtin="checker", width="256",
            height="256", rgb1="0.75 0.77 0.8", rgb2="0.85 0.87 0.9",
        )  # fmt: skip
        add_element(
            asset,
            "material",
            name=FLOOR_NAME,
            texture=FLOOR_NAME,
            texrepeat="4 4",
            texuniform="true",
        )
        light = etree.Element("light", {"pos": "0 0 3", "dir": "0 0 -1", "directional": "true"})
        floor = {"name": FLOOR_NAME, "type": "plane", "size": "0 0 0.05", "material": FLOOR_NAME}
        world.insert(0, light)
        world.insert(1, etree.Element("geom", floor))

    def add_imu(self, body: str, site: str) -> None:
        """Add gyro, accelerometer and orientation sensor of an IMU at a site.

        A missing site is added at the origin of the body.
        """
        if all(node.get("name") != site for node in self.root.iter("site")):
            add_element(self.body(body), "site", name=site)
        sensors = self.section("sensor")
        for kind in IMU_SENSORS:
            add_element(sensors, kind, name=kind, site=site)
        add_element(sensors, "framequat", name="orientation", objtype="site", objname=site)

    def add_position_servo(
        self,
        joint: str,
        kp: float,
        kd: float,
        limits: tuple[AttributeValue, AttributeValue] | None = None,
    ) -> None:
        """Add a position servo with the name of the joint.

        Args:
            joint: Joint.
            kp: Stiffness [N m/rad, N/m].
            kd: Damping [N m s/rad, N s/m].
            limits: Lower and upper bound of the torque or force [N m, N]; none by default.
        """
        add_element(
            self.section("actuator"),
            "position",
            name=joint,
            joint=joint,
            kp=join_numbers(kp),
            kv=join_numbers(kd),
            forcerange=None if limits is None else " ".join(map(format_xml_value, limits)),
        )

    def exclude_contact(self, first: str, second: str) -> None:
        """Exclude contacts between two bodies, by their names."""
        add_element(self.section("contact"), "exclude", body1=first, body2=second)

    def turn_off_contact(self, geoms: Sequence[str]) -> None:
        """Disable all contacts of the named geoms."""
        for geom in self.geoms:
            if geom.get("name") in geoms:
                geom.set("contype", "0")
                geom.set("conaffinity", "0")

    def add_ball(
        self,
        name: str,
        body: str,
        radius: float,
        place: ArrayLike,
        like: str | None = None,  # noqa: ARG002 - a URDF states nothing of contacts
    ) -> None:
        """Add a collision sphere without mass to a body.

        Args:
            name: Name of the sphere.
            body: Body of the sphere.
            radius: Radius [m].
            place: Centre, shape (3,) [m], in the frame of the body.
            like: Ignored in a new MJCF.
        """
        add_element(
            self.body(body),
            "geom",
            name=name,
            class_=COLLISION_CLASS,
            type="sphere",
            size=join_numbers(radius),
            pos=join_numbers(place),
        )

    @property
    def home(self) -> list[float] | None:
        """``qpos`` of the new MJCF's keyframe, in MuJoCo's order; None without a keyframe."""
        key = self.root.find("keyframe/key")
        return None if key is None else [float(word) for word in str(key.get("qpos")).split()]

    def set_home(self, qpos: ArrayLike, ctrl: Sequence[float] = ()) -> None:
        """Add the keyframe `HOME_KEYFRAME`.

        Args:
            qpos: Configuration in MuJoCo's order.
            ctrl: Commands of the actuators; omitted if empty.
        """
        key = add_element(
            self.section("keyframe"), "key", name=HOME_KEYFRAME, qpos=join_numbers(qpos)
        )
        if len(ctrl):
            key.set("ctrl", join_numbers(ctrl))


def draft_mjcf(urdf: UrdfFile, output: Path, options: MjcfOptions) -> ConversionDraft:
    """Convert a URDF to the text of an MJCF, without writing a file.

    Args:
        urdf: Source file.
        output: Path of the MJCF, to which mesh paths are relative.
        options: Properties that a URDF cannot state.

    Returns:
        Text, mesh files, additions, losses and repairs.

    Raises:
        ModelError: If MuJoCo cannot represent the robot, or an inertial is invalid, for example.
    """
    free = None if options.fixed_base is None else not options.fixed_base
    bare = ConvertedMjcf.from_urdf(urdf, output, options, free=free)
    mjcf, meshes = NewMjcf(bare.mjcf.root), bare.meshes
    left = [*bare.bodies.notes, *meshes.notes, *_list_losses_in_mjcf(urdf)]
    notes, failure, on_balls = list(bare.notes), None, frozenset[str]()
    if bare.free:
        notes += [diagnose("free-joint-added", subject=("body", bare.bodies.root))]
        found, failure, on_balls = _add_stand(bare, options)
        notes = [*dict.fromkeys((*notes, *found)), _add_imu(mjcf, bare.bodies)]
    else:
        notes.append(diagnose("base-fixed-in-the-world"))
        notes += _add_fixed_base_additions(bare, options)
    notes += _list_unstated_numbers(mjcf)
    meshes.write(mjcf.section("asset"))
    mjcf.remove_empty_sections()
    put_defaults(mjcf.root)
    header = f"Converted from {urdf.path.name} by pupper-analysis."
    return ConversionDraft(
        text=new_file_text(mjcf.root, header),
        meshes=meshes.made,
        notes=tuple(notes),
        not_converted=tuple(left),
        repairs=bare.repairs,
        urdf=bare.urdf,
        stands=bare.free,
        failure=failure,
        lost=tuple(meshes.lost_collision_meshes),
        on_balls=on_balls,
    )


def _list_losses_in_mjcf(urdf: UrdfFile) -> list[Diagnostic]:
    """List parts of a URDF that the new MJCF does not contain, with their counts."""
    losses, count, spans = [], 0, []
    for are_slides in (False, True):
        speeds = [
            float(limit.get("velocity"))
            for joint in urdf.tree.joints.values()
            if not joint.is_fixed and (joint.kind == "prismatic") == are_slides
            for limit in joint.element.findall("limit")
            if float(limit.get("velocity")) != 0
            and math.isfinite(known_limit(float(limit.get("velocity"))))
        ]
        if speeds:
            count += len(speeds)
            spans.append(describe_span(speeds, select_joint_units(slides=are_slides).velocity))
    if spans:
        slides = spans[1] if len(spans) > 1 else None
        losses.append(diagnose("velocity-limits-left", count=count, limits=spans[0], slides=slides))
    textured = len(list(urdf.root.iter("texture")))
    if textured:
        losses.append(diagnose("textures-left", count=textured))
    other_tags = Counter(str(node.tag) for node in urdf.root if node.tag not in _CONVERTED_TAGS)
    other_tags += Counter(
        str(node.tag)
        for joint in urdf.root.findall("joint")
        for node in joint
        if node.tag in _LOST_JOINT_TAGS
    )
    elements = [
        diagnose("elements-left", tag=tag, count=count) for tag, count in other_tags.items()
    ]
    return losses + elements


def _add_stand(
    bare: ConvertedMjcf, options: MjcfOptions
) -> tuple[list[Diagnostic], Diagnostic | None, frozenset[str]]:
    """Add ground, feet, servos and start pose to a new MJCF, so that the robot stands.

    Returns:
        Notes; the reason if the robot does not stand, otherwise None; the joints whose feet were
        replaced by balls.
    """
    mjcf, meshes, bodies = NewMjcf(bare.mjcf.root), bare.meshes, bare.bodies
    try:
        robot = make_robot(bare.urdf, bare.make_file(), feet=options.feet)
    except ModelError as error:
        if options.feet is not None:
            raise
        apply_additions(list_urdf_ground_additions(), mjcf)
        messages = [addition.reason for addition in list_urdf_ground_additions()]
        messages += _add_fixed_base_additions(bare, options)
        _lift_base(mjcf, bodies, bare.make_file().model)
        problem = diagnose("does-not-stand", missing=meshes.missing_files, problem=error.cause)
        return messages, problem, frozenset()
    added, failure = robot.description.added, None
    try:
        solve_stand_on_soft_ground(robot)
    except PupperAnalysisError as error:
        problem = error.diagnostic
        failure = diagnose("does-not-stand", missing=meshes.missing_files, problem=problem)
        added = tuple(addition for addition in added if not isinstance(addition, StartKeyframe))
    published = PublishedModel.from_model(bare.make_file().model, robot)
    added = _limit_servos_without_torque(added, robot)
    apply_additions([_convert_start_pose(addition, published, robot) for addition in added], mjcf)
    _lift_base(mjcf, bodies, published.model)
    messages = [note for note in robot.notes if note.code != "armature-from-mjcf"]
    return messages, failure, _find_joints_on_balls(robot)


WRITTEN_ZERO_EFFORT = 1e-9
"""Torque limit [N m, N] that a new MJCF states for a motor without torque. MuJoCo ignores or
refuses a range from 0 to 0. Chosen, not tuned: below `MIN_EFFORT`, so it is read as zero."""


def _limit_servos_without_torque(
    additions: Iterable[Addition], robot: Robot
) -> tuple[Addition, ...]:
    """Give servos of joints with an effort limit of zero a range of `WRITTEN_ZERO_EFFORT`.

    Without a range, such a servo is unlimited in MuJoCo.
    """
    null = {limit.joint for limit in robot.efforts if limit.code is EffortCode.ZERO}
    limits = (-WRITTEN_ZERO_EFFORT, WRITTEN_ZERO_EFFORT)
    return tuple(
        replace(addition, limits=limits)
        if isinstance(addition, Servo) and addition.joint in null
        else addition
        for addition in additions
    )


def _find_joints_on_balls(robot: Robot) -> frozenset[str]:
    """Return the joints that move bodies whose collision shapes were replaced by balls."""
    model = robot.mj_model
    balls = [addition for addition in robot.description.added if isinstance(addition, Ball)]
    bodies = {int(model.body_weldid[model.body(ball.body).id]) for ball in balls}
    return frozenset(
        name for name in robot.joint_names if int(model.jnt_bodyid[model.joint(name).id]) in bodies
    )


def _convert_start_pose(addition: Addition, published: PublishedModel, robot: Robot) -> Addition:
    """Convert the start pose that is added to a new file to the coordinates of this file.

    If the origin of the base frame is below the feet, `load_robot` may move the frame. The new file
    keeps the original frame.
    """
    if not isinstance(addition, StartKeyframe):
        return addition
    data = mujoco.MjData(robot.mj_model)
    data.qpos[:] = addition.qpos
    placed = place_at_state(published, robot, data)
    return addition if placed is None else replace(addition, qpos=tuple(placed.qpos.tolist()))


def _add_fixed_base_additions(bare: ConvertedMjcf, options: MjcfOptions) -> list[Diagnostic]:
    """Add the additions of a fixed-base robot, such as servos, to the new MJCF; return notes."""
    mjcf = NewMjcf(bare.mjcf.root)
    if not mjcf.joints:
        return [diagnose("nothing-moves")]
    robot = _free_legged_robot(bare, options) or make_robot(
        bare.urdf, bare.make_file(), fixed_base=True
    )
    # A robot that hangs from the world needs neither a ground nor a pose of its base.
    added = [
        addition
        for addition in robot.description.added
        if not isinstance(addition, Floor | StartKeyframe)
    ]
    apply_additions(_limit_servos_without_torque(added, robot), mjcf)
    return list(dict.fromkeys(addition.reason for addition in added))


def _free_legged_robot(bare: ConvertedMjcf, options: MjcfOptions) -> Robot | None:
    """Load a legged robot, whose URDF fixes it to the link "world", with a free base.

    None for an arm, for example.
    """
    if options.fixed_base is not None or bare.bodies.root != WORLD_LINK:
        return None
    try:
        robot = make_robot(bare.urdf, bare.make_file(), feet=options.feet)
        solve_stand_on_soft_ground(robot)
    except PupperAnalysisError:
        return None
    return robot


def _list_unstated_numbers(mjcf: NewMjcf) -> list[Diagnostic]:
    """Return notes that count the joints of a new MJCF without armature and without damping."""
    joints = mjcf.joints
    missing = {
        attribute: sum(joint.get(attribute) is None for joint in joints)
        for attribute in ("armature", "damping")
    }
    notes = []
    if count := missing["armature"]:
        notes.append(diagnose("armature-unstated", count=count, joints=len(joints)))
    if count := missing["damping"]:
        notes.append(diagnose("damping-unstated", count=count, joints=len(joints)))
    return notes


_HEIGHT_DECIMALS = 6
"""Number of decimals with which the height of the base [m] is written to a new file: one
micrometre. Chosen, not tuned."""


def _add_imu(mjcf: NewMjcf, bodies: UrdfBodies) -> Diagnostic:
    """Add an IMU at the link with the shortest name that contains "imu", else at the base.

    The result is a note about the addition.
    """
    named = sorted(
        (name for name in bodies.frames if "imu" in name.lower()),
        key=lambda name: (len(name), name),
    )
    mjcf.add_imu(named[0] if named else bodies.root, named[0] if named else "imu")
    return diagnose("imu-added", link=named[0] if named else None)


def _lift_base(mjcf: NewMjcf, bodies: UrdfBodies, model: mujoco.MjModel) -> None:
    """Raise the base so that no collision shape is below the ground at zero joint positions.

    Otherwise, in a simulation that does not start from the keyframe, contact forces would throw the
    robot upward. ``model`` is the compiled new MJCF so far.
    """
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    touching = [
        geom
        for geom in range(model.ngeom)
        if model.body_weldid[model.geom_bodyid[geom]]
        and (model.geom_contype[geom] or model.geom_conaffinity[geom])
    ]
    heights = [-compute_lowest_height(model, data, touching)] if touching else []
    home = mjcf.home
    if home is not None:
        heights.append(float(home[2]))
    if heights and max(heights) > 0:
        height = join_numbers([0.0, 0.0, float(f"{max(heights):.{_HEIGHT_DECIMALS}f}")])
        mjcf.body(bodies.root).set("pos", height)


_DEFAULT_ATTRIBUTES = {
    "joint": ("type", "axis", "range", "damping", "frictionloss", "armature"),
    "position": ("kp", "kv", "forcerange"),
}
"""Attributes that ``put_defaults`` may move into the top default class, for each element type."""


def put_defaults(root: etree._Element) -> None:
    """Move common attribute values of an MJCF into its main default class; ``root`` is changed.

    A value is common if more than half of the elements have it, and no element lacks the attribute.
    `_DEFAULT_ATTRIBUTES` lists the tags and attributes.
    """
    top = root.find("default")
    assert top is not None
    for tag, attributes in _DEFAULT_ATTRIBUTES.items():
        other_parents = ("default", "equality")  # couplings are elements <joint> as well
        elements = [found for found in root.iter(tag) if found.getparent().tag not in other_parents]
        common = _find_common_values(elements, attributes) if len(elements) > 1 else {}
        if common:
            top.insert(len(top.findall("joint")), etree.Element(tag, common))
        for element in elements:
            for name, value in common.items():
                if element.get(name) == value:
                    del element.attrib[name]


def _find_common_values(
    elements: Sequence[etree._Element], attributes: Sequence[str]
) -> dict[str, str]:
    """Return {attribute: value} of values that most elements have, if each has the attribute."""
    common = {}
    for name in attributes:
        values = Counter(element.get(name) for element in elements)
        if None in values:
            continue
        value, count = values.most_common(1)[0]
        if 2 * count > len(elements):
            common[name] = str(value)
    return common


def draft_urdf(file: MjcfFile, output: Path) -> ConversionDraft:
    """Convert an MJCF to the text of a URDF, without writing a file.

    Mesh paths are relative to the folder of ``output``.

    Raises:
        ModelError: If a URDF cannot represent the robot.
    """
    bare = ConvertedUrdf.from_mjcf(file, output)
    left = [*bare.left, *_list_losses_in_urdf(bare.model, bare.bodies)]
    left += _list_lost_contact_numbers(bare.model, bare.bodies)
    missing, why = file.missing_collision_meshes, diagnose("no-such-mesh-file")
    lost = [diagnose("collision-meshes-lost", files=missing, why=why)] if missing else []
    return ConversionDraft(bare.text, {}, bare.notes, tuple(left), lost=tuple(lost))


def _list_losses_in_urdf(model: mujoco.MjModel, robot: frozenset[int]) -> list[Diagnostic]:
    """List elements and values of an MJCF that the URDF does not contain.

    ``robot`` contains the ids of the bodies that become links.
    """
    moving = model.jnt_type != JointKind.FREE
    dofs = model.jnt_dofadr[moving]
    losses: list[Diagnostic] = []
    slides = model.jnt_type[moving] == JointKind.SLIDE
    for are_slides in (False, True):
        armatures = model.dof_armature[dofs[slides == are_slides]]
        if armatures.any():
            values = describe_span(armatures, select_joint_units(slides=are_slides).armature)
            losses.append(diagnose("armature-not-in-urdf", armature=values))
    fixed = np.setdiff1d(np.arange(model.nv), dofs)
    resisting = model.dof_damping + model.dof_frictionloss + model.dof_armature
    other_bodies = [body for body in range(1, model.nbody) if body not in robot]
    away = [*other_bodies] if 0 in robot else [0, *other_bodies]
    affine = mujoco.mjtBias.mjBIAS_AFFINE.value
    for count, what in (
        (np.count_nonzero(model.jnt_stiffness[moving]), "springs"),
        (np.count_nonzero(resisting[fixed]), "damping, friction, armature of the free joint"),
        (np.count_nonzero(model.body_gravcomp), "bodies with gravity compensation"),
        (model.ntendon, "tendons"),
        (model.nkey, "keyframes"),
        (model.nsensor, "sensors"),
        (model.nexclude, "excluded contacts"),
        (model.npair, "pairs of geoms that touch"),
        (model.nactuator, "actuators"),
        (np.count_nonzero(model.actuator_biastype == affine), "gains of servos"),
        (np.isin(model.geom_bodyid, away).sum(), "geoms of the world and of such bodies"),
        (np.isin(model.site_bodyid, away).sum(), "sites there"),
        (model.ncam, "cameras"),
        (model.nlight, "lights"),
        (bool(model.opt.density or model.opt.viscosity), "fluid around the robot"),
    ):
        if count:
            losses.append(diagnose("not-in-urdf", what=Term(what), count=int(count)))
    if other_bodies:
        names = [model.body(body).name or f"{body}" for body in other_bodies]
        losses.append(diagnose("bodies-not-carried", bodies=names))
    if not np.allclose(model.opt.gravity, DOWNWARD_GRAVITY):
        losses.append(diagnose("gravity-not-in-urdf", gravity=model.opt.gravity))
    return losses


def _list_lost_contact_numbers(model: mujoco.MjModel, robot: frozenset[int]) -> list[Diagnostic]:
    """Report contact parameters and options of an MJCF, other than defaults, that a URDF loses.

    ``robot`` contains the ids of the bodies that become links.
    """
    geoms = [
        geom
        for geom in sorted(find_collidable_geoms(model))
        if int(model.geom_bodyid[geom]) in robot
    ]
    losses = []
    for tag, rows in (("geom", geoms), ("option", [0])):
        for attribute, values in _find_changed_values(model, tag, rows).items():
            distinct = dict.fromkeys(" ".join(f"{n:.6g}" for n in value) for value in values)
            if tag == "geom":
                arguments: dict[str, Any] = {"values": tuple(distinct), "count": len(values)}
                losses.append(diagnose("contact-number-not-in-urdf", what=attribute, **arguments))
            else:
                losses.append(
                    diagnose("option-not-in-urdf", what=attribute, values=tuple(distinct))
                )
    return losses


def _find_changed_values(
    model: mujoco.MjModel, tag: str, rows: Iterable[int]
) -> dict[str, list[ParameterValues]]:
    """Find values of geoms or options that differ from MuJoCo's defaults: {attribute: values}.

    ``rows`` are ids of geoms; ``[0]`` for options.
    """
    default = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><geom size='1'/></worldbody></mujoco>"
    )
    defaults, changed = element_values(default, tag, 0), dict[str, list[ParameterValues]]()
    for row in rows:
        for attribute, value in element_values(model, tag, row).items():
            if value != defaults[attribute]:
                changed.setdefault(attribute, []).append(value)
    return changed
