"""New files that are not written yet: the MJCF of a URDF, the URDF of an MJCF.

The MJCF has feet, servos, a floor and a keyframe in which it stands.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from lxml import etree
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.diagnostics import Diagnostic, Term, diagnose
from pupper_analysis.base.errors import ModelError, PupperAnalysisError
from pupper_analysis.base.units import DOWN
from pupper_analysis.models.additions import Addition, Ball, Floor, Start, put_all
from pupper_analysis.models.attributes import FLOOR_NAME, HOME_KEYFRAME, IMU_SENSORS, Number
from pupper_analysis.models.mjcf import JointKind
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.stated.mjcf import Value, element_values, touching_geoms
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.models.xml import add_element, new_file_text, write_numbers
from pupper_analysis.prepare.bare import Bare, place_as
from pupper_analysis.prepare.contact_points import lowest_point
from pupper_analysis.prepare.convert.from_urdf import (
    COLLISION,
    BareMjcf,
    MjcfOptions,
    MjcfXml,
    UrdfBodies,
    text_of,
)
from pupper_analysis.prepare.convert.repair import WORLD, Repair
from pupper_analysis.prepare.convert.to_urdf import BareUrdf
from pupper_analysis.prepare.notes import describe_span
from pupper_analysis.prepare.passes import ground_of_urdf, robot_of
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.soft_ground import solve_stand_on_soft_ground

Array = NDArray[np.float64]

_READ = ("link", "joint", "material")
"""What is read of a <robot>: <transmission>, <gazebo>, <mujoco> ... are other programs'."""


@dataclass(frozen=True)
class ConversionDraft:
    """A new model file that is not written yet.

    Attributes:
        text: Its XML, for the folder it is meant for.
        meshes: {file to be written beside it: its content}.
        notes: What was added, or assumed.
        not_converted: What the new format cannot say, or what was left out.
        repairs: Inertials that were repaired.
        urdf: The URDF with them, if the draft is of one: what the new file is proven against.
        stands: Whether it is a robot that shall stand.
        failure: Why it does not, if that is known already.
        lost: What it cannot do without, and lacks.
        on_balls: The joints whose feet touch with balls in the place of their meshes, as is
            reported.
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
    """An MJCF that is made of a URDF: what it can be given for a simulation, as `SpecTree` can."""

    @property
    def joints(self) -> list[etree._Element]:
        """All hinges and slides."""
        return list(self.section("worldbody").iter("joint"))

    @property
    def touches(self) -> bool:
        """Whether it has shapes of its robot that touch."""
        return any(geom.get("class") == COLLISION for geom in self.geoms)

    def remove_empty_sections(self) -> None:
        """Takes out sections that state nothing."""
        for node in list(self.root):
            if node.tag != "worldbody" and not len(node) and not node.attrib:
                self.root.remove(node)

    def set_options(self, values: Mapping[str, Number]) -> None:
        """States attributes of ``<option>``."""
        option = self.root.find("option")
        if option is None:
            option = etree.Element("option")
            self.root.insert(1, option)
        option.attrib.update({name: text_of(value) for name, value in values.items()})

    def add_floor(self) -> None:
        """Adds light, a floor and its look."""
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
        """Adds an IMU at a site of a body, which is added at its origin where there is none."""
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
        limits: tuple[Number, Number] | None = None,
    ) -> None:
        """Adds a position servo at a joint, of its name."""
        add_element(
            self.section("actuator"),
            "position",
            name=joint,
            joint=joint,
            kp=write_numbers(kp),
            kv=write_numbers(kd),
            forcerange=None if limits is None else " ".join(map(text_of, limits)),
        )

    def exclude_contact(self, one: str, two: str) -> None:
        """Lets two bodies not touch each other."""
        add_element(self.section("contact"), "exclude", body1=one, body2=two)

    def turn_off_contact(self, geoms: Sequence[str]) -> None:
        """Lets geoms touch nothing."""
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
        """Adds a sphere that touches, as all its shapes do, and weighs nothing."""
        add_element(
            self.body(body),
            "geom",
            name=name,
            class_=COLLISION,
            type="sphere",
            size=write_numbers(radius),
            pos=write_numbers(place),
        )

    @property
    def home(self) -> list[float] | None:
        """The positions of its keyframe; None if it has none."""
        key = self.root.find("keyframe/key")
        return None if key is None else [float(word) for word in str(key.get("qpos")).split()]

    def set_home(self, qpos: ArrayLike, ctrl: Sequence[float] = ()) -> None:
        """Adds the keyframe to start from."""
        key = add_element(
            self.section("keyframe"), "key", name=HOME_KEYFRAME, qpos=write_numbers(qpos)
        )
        if len(ctrl):
            key.set("ctrl", write_numbers(ctrl))


def mjcf_draft(urdf: UrdfFile, output: Path, options: MjcfOptions) -> ConversionDraft:
    """Makes the MJCF of a URDF.

    Args:
        urdf: The file.
        output: Where the MJCF shall be: the paths of its meshes start there.
        options: What the URDF does not say.

    Raises:
        ModelError: If MuJoCo cannot have the robot, or it does not stand.
    """
    said = None if options.fixed_base is None else not options.fixed_base
    bare = BareMjcf.of(urdf, output, options, free=said)
    mjcf, meshes = NewMjcf(bare.mjcf.root), bare.meshes
    left = [*bare.bodies.notes, *meshes.notes, *_unsaid(urdf)]
    notes, failure, on_balls = list(bare.notes), None, frozenset[str]()
    if bare.free:
        notes += [diagnose("free-joint-added", subject=("body", bare.bodies.root))]
        found, failure, on_balls = _put_stand(bare, options)
        notes = [*dict.fromkeys((*notes, *found)), _add_imu(mjcf, bare.bodies)]
    else:
        notes.append(diagnose("base-fixed-in-the-world"))
        notes += _put_held(bare, options)
    notes += _unstated(mjcf)
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
        lost=tuple(meshes.lost),
        on_balls=on_balls,
    )


def _unsaid(urdf: UrdfFile) -> list[Diagnostic]:
    """Tells what else no MJCF, or none of this package's, has from the URDF."""
    some = []
    speeds = [
        float(limit.get("velocity"))
        for joint in urdf.tree.joints.values()
        for limit in joint.element.findall("limit")
        if not joint.is_fixed and float(limit.get("velocity")) != 0
    ]
    if speeds:
        limits = describe_span(speeds, "rad/s")
        some.append(diagnose("velocity-limits-left", count=len(speeds), limits=limits))
    textured = len(list(urdf.root.iter("texture")))
    if textured:
        some.append(diagnose("textures-left", count=textured))
    others = Counter(str(node.tag) for node in urdf.root if node.tag not in _READ)
    left = [diagnose("elements-left", tag=tag, count=count) for tag, count in others.items()]
    return some + left


def _put_stand(
    bare: BareMjcf, options: MjcfOptions
) -> tuple[list[Diagnostic], Diagnostic | None, frozenset[str]]:
    """Adds what `load_robot` finds out: feet, servos, start pose.

    Returns:
        Its notes, why the robot does not stand, if so, and the joints whose feet are balls now.
    """
    mjcf, meshes, bodies = NewMjcf(bare.mjcf.root), bare.meshes, bare.bodies
    try:
        robot = robot_of(bare.urdf, bare.file(), feet=options.feet)
    except ModelError as error:
        if options.feet is not None:
            raise
        put_all(ground_of_urdf(), mjcf)
        messages = [each.reason for each in ground_of_urdf()] + _put_held(bare, options)
        _lift_base(mjcf, bodies, bare.file().model)
        problem = diagnose("does-not-stand", missing=meshes.missing, problem=error.cause)
        return messages, problem, frozenset()
    added, failure = robot.description.added, None
    try:
        solve_stand_on_soft_ground(robot)
    except PupperAnalysisError as error:
        problem = error.diagnostic
        failure = diagnose("does-not-stand", missing=meshes.missing, problem=problem)
        added = tuple(each for each in added if not isinstance(each, Start))
    own = Bare.of(bare.file().model, robot)
    put_all([_in_own_frame(each, own, robot) for each in added], mjcf)
    _lift_base(mjcf, bodies, own.model)
    messages = [note for note in robot.notes if note.code != "armature-from-mjcf"]
    return messages, failure, _joints_on_balls(robot)


def _joints_on_balls(robot: Robot) -> frozenset[str]:
    """Returns the joints that move the bodies to which balls were added in the place of shapes."""
    model = robot.mj_model
    balls = [each for each in robot.description.added if isinstance(each, Ball)]
    bodies = {int(model.body_weldid[model.body(ball.body).id]) for ball in balls}
    return frozenset(
        name for name in robot.joint_names if int(model.jnt_bodyid[model.joint(name).id]) in bodies
    )


def _in_own_frame(added: Addition, own: Bare, robot: Robot) -> Addition:
    """Returns what is added as the new file has it, whose base's frame may lie below its feet."""
    if not isinstance(added, Start):
        return added
    there = mujoco.MjData(robot.mj_model)
    there.qpos[:] = added.qpos
    placed = place_as(own, robot, there)
    return added if placed is None else replace(added, qpos=tuple(placed.qpos.tolist()))


def _put_held(bare: BareMjcf, options: MjcfOptions) -> list[Diagnostic]:
    """Adds the servos of a robot that is held; returns what was added."""
    mjcf = NewMjcf(bare.mjcf.root)
    if not mjcf.joints:
        return [diagnose("nothing-moves")]
    robot = _freed(bare, options) or robot_of(bare.urdf, bare.file(), fixed_base=True)
    # What hangs from the world needs no ground, and no pose of its base.
    added = [each for each in robot.description.added if not isinstance(each, Floor | Start)]
    put_all(added, mjcf)
    return list(dict.fromkeys(each.reason for each in added))


def _freed(bare: BareMjcf, options: MjcfOptions) -> Robot | None:
    """Returns a robot on legs that its URDF ties to the link "world", as ``load_robot`` frees it.

    Its servos are those with which it stands, as ``stand`` of either file answers.
    """
    if options.fixed_base is not None or bare.bodies.root != WORLD:
        return None
    try:
        robot = robot_of(bare.urdf, bare.file(), feet=options.feet)
        solve_stand_on_soft_ground(robot)
    except PupperAnalysisError:
        return None  # an arm, a hand
    return robot


def _unstated(mjcf: NewMjcf) -> list[Diagnostic]:
    """Tells which joints have neither armature nor damping: a URDF states no armature."""
    joints = mjcf.joints
    still, undamped = (sum(j.get(word) is None for j in joints) for word in ("armature", "damping"))
    messages = [diagnose("armature-unstated", count=still, joints=len(joints))] if still else []
    if undamped:
        messages.append(diagnose("damping-unstated", count=undamped, joints=len(joints)))
    return messages


_KEY_DIGITS = 6
"""Decimals of the base's height: a micrometre."""


def _add_imu(mjcf: NewMjcf, bodies: UrdfBodies) -> Diagnostic:
    """Adds an IMU: on the link that is named after one, otherwise at the base's origin.

    Returns:
        What was added.
    """
    named = sorted(
        (name for name in bodies.frames if "imu" in name.lower()),
        key=lambda name: (len(name), name),
    )
    mjcf.add_imu(named[0] if named else bodies.root, named[0] if named else "imu")
    return diagnose("imu-added", link=named[0] if named else None)


def _lift_base(mjcf: NewMjcf, bodies: UrdfBodies, model: mujoco.MjModel) -> None:
    """Puts the base where nothing is in the ground, with all joints at zero or as it stands.

    A simulation that is begun without the keyframe would throw it up by what is in the ground.

    Args:
        mjcf: The MJCF, with its keyframe if it has one.
        bodies: What is known of the URDF.
        model: What MuJoCo compiles of it, so far.
    """
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    touching = [
        geom
        for geom in range(model.ngeom)
        if model.body_weldid[model.geom_bodyid[geom]]
        and (model.geom_contype[geom] or model.geom_conaffinity[geom])
    ]
    heights = [-lowest_point(model, data, touching)] if touching else []
    home = mjcf.home
    if home is not None:
        heights.append(float(home[2]))
    if heights and max(heights) > 0:
        height = write_numbers([0.0, 0.0, float(f"{max(heights):.{_KEY_DIGITS}f}")])
        mjcf.body(bodies.root).set("pos", height)


_SHARED = {
    "joint": ("type", "axis", "range", "damping", "frictionloss", "armature"),
    "position": ("kp", "kv", "forcerange"),
}
"""Attributes that several elements of a kind may share."""


def put_defaults(root: etree._Element) -> None:
    """Moves what more than half of a kind share into the top default, if all have some of it."""
    top = root.find("default")
    assert top is not None
    for tag, attributes in _SHARED.items():
        elements = [found for found in root.iter(tag) if found.getparent().tag != "default"]
        common = _common(elements, attributes) if len(elements) > 1 else {}
        if common:
            top.insert(len(top.findall("joint")), etree.Element(tag, common))
        for element in elements:
            for name, value in common.items():
                if element.get(name) == value:
                    del element.attrib[name]


def _common(elements: Sequence[etree._Element], attributes: Sequence[str]) -> dict[str, str]:
    """Returns {attribute: its value in most elements}, of attributes that all of them have."""
    common = {}
    for name in attributes:
        values = Counter(element.get(name) for element in elements)
        if None in values:
            continue
        value, count = values.most_common(1)[0]
        if 2 * count > len(elements):
            common[name] = str(value)
    return common


# An MJCF as a URDF.


def urdf_draft(file: MjcfFile, output: Path) -> ConversionDraft:
    """Makes the URDF of an MJCF.

    Args:
        file: The MJCF.
        output: Where the URDF shall be: the paths of its meshes start there.

    Raises:
        ModelError: If a URDF cannot have the robot.
    """
    bare = BareUrdf.of(file, output)
    left = [*bare.left, *_not_in_urdf(bare.model, bare.bodies)]
    left += _lost_numbers(bare.model, bare.bodies)
    gone, why = file.lacking, diagnose("no-such-mesh-file")
    lost = [diagnose("collision-meshes-lost", files=gone, why=why)] if gone else []
    return ConversionDraft(bare.text, {}, bare.notes, tuple(left), lost=tuple(lost))


def _not_in_urdf(model: mujoco.MjModel, robot: frozenset[int]) -> list[Diagnostic]:
    """Tells what else a URDF cannot say, and what is around the robot and on it.

    Args:
        model: The model.
        robot: The bodies that are links.
    """
    moving = model.jnt_type != JointKind.FREE
    dofs = model.jnt_dofadr[moving]
    some: list[Diagnostic] = []
    if model.dof_armature[dofs].any():
        values = describe_span(model.dof_armature[dofs], "kg m^2")
        some.append(diagnose("armature-not-in-urdf", armature=values))
    fixed = np.setdiff1d(np.arange(model.nv), dofs)
    resisting = model.dof_damping + model.dof_frictionloss + model.dof_armature
    others = [body for body in range(1, model.nbody) if body not in robot]
    away = [*others] if 0 in robot else [0, *others]
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
            some.append(diagnose("not-in-urdf", what=Term(what), count=int(count)))
    if others:
        names = [model.body(body).name or f"{body}" for body in others]
        some.append(diagnose("bodies-not-carried", bodies=names))
    if not np.allclose(model.opt.gravity, DOWN):
        some.append(diagnose("gravity-not-in-urdf", gravity=model.opt.gravity))
    return some


def _lost_numbers(model: mujoco.MjModel, robot: frozenset[int]) -> list[Diagnostic]:
    """Lists what an MJCF states of contacts and of MuJoCo's options, and a URDF cannot.

    Args:
        model: The model.
        robot: The bodies that are links.
    """
    touching = [g for g in sorted(touching_geoms(model)) if int(model.geom_bodyid[g]) in robot]
    some = []
    for tag, rows in (("geom", touching), ("option", [0])):
        for word, values in _stated_numbers(model, tag, rows).items():
            distinct = dict.fromkeys(" ".join(f"{n:.6g}" for n in value) for value in values)
            if tag == "geom":
                given: dict[str, Any] = {"values": tuple(distinct), "count": len(values)}
                some.append(diagnose("contact-number-not-in-urdf", what=word, **given))
            else:
                some.append(diagnose("option-not-in-urdf", what=word, values=tuple(distinct)))
    return some


def _stated_numbers(model: mujoco.MjModel, tag: str, rows: Iterable[int]) -> dict[str, list[Value]]:
    """Returns {word: the values that elements have of it} where they are not MuJoCo's defaults.

    Args:
        model: What MuJoCo compiles.
        tag: ``geom`` or ``option``.
        rows: Which geoms; of options, ``[0]``.
    """
    default = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><geom size='1'/></worldbody></mujoco>"
    )
    usual, found = element_values(default, tag, 0), dict[str, list[Value]]()
    for row in rows:
        for word, value in element_values(model, tag, row).items():
            if value != usual[word]:
                found.setdefault(word, []).append(value)
    return found
