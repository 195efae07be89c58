"""A URDF as an MJCF that is ready for simulation."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ModelError, PupperAnalysisError, StanceUnreachableError
from pupper_analysis.models.additions import Ball, Floor, Servo, Start, put_all
from pupper_analysis.models.conversion import UrdfImport
from pupper_analysis.models.mjcf_file import MjcfFile, mjcf_of_text
from pupper_analysis.models.mjcf_xml import MjcfXml
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.models.urdf_tree import origin_of, set_origin
from pupper_analysis.models.xml import add_element, new_file_text, put_defaults, to_text
from pupper_analysis.prepare import drives
from pupper_analysis.prepare.convert import equip
from pupper_analysis.prepare.convert.conversion import ConversionDraft
from pupper_analysis.prepare.convert.from_urdf import WORLD, UrdfBodies
from pupper_analysis.prepare.convert.meshes import Meshes
from pupper_analysis.prepare.convert.repair import (
    Repair,
    carry_shapes,
    mend_inertials,
    merge_fixed,
    repaired_urdf,
)
from pupper_analysis.prepare.load import Feet, robot_of
from pupper_analysis.prepare.notes import describe_span
from pupper_analysis.prepare.passes import ground_of_urdf
from pupper_analysis.prepare.servo_tuning import stand_gains
from pupper_analysis.robot.contact import limb_ends
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.soft_ground import solve_stand_on_soft_ground

_LIMBS = 2
"""A base that carries so many limbs or more is free, as in ``load_robot``."""


_READ = ("link", "joint", "material")
"""What is read of a <robot>: <transmission>, <gazebo>, <mujoco> ... are other programs'."""


class _LeglessError(Exception):
    """A robot has fewer feet than legs make.

    Attributes:
        reason: What was found.
    """

    def __init__(self, reason: Diagnostic) -> None:
        self.reason = reason
        super().__init__(str(reason))


@dataclass(frozen=True)
class MjcfOptions:
    """What a URDF does not say.

    Attributes:
        feet: The feet's links, or {foot: link}; None: they are found.
        fixed_base: Whether the base is fixed; None: a base with two limbs or more is free.
        merge_fixed: Whether links on fixed joints become part of the body that carries them.
        armature: {joint: rotor inertia (kg m^2)}.
        sag: What the joint that holds most gives way (rad); None: it is found by trial.
        damping_ratio: Of the base's bounce on its servos; None: it is found by trial.
        repair_inertia: Whether inertials of moving links that no body can have are repaired.
        copy_meshes: Whether all meshes are copied to a folder beside the MJCF.
    """

    feet: Feet | None = None
    fixed_base: bool | None = None
    merge_fixed: bool = False
    armature: Mapping[str, float] | None = None
    sag: float | None = None
    damping_ratio: float | None = None
    repair_inertia: bool = False
    copy_meshes: bool = False


def mjcf_draft(urdf: UrdfFile, output: Path, options: MjcfOptions) -> ConversionDraft:
    """Makes the MJCF of a URDF.

    Args:
        urdf: The file.
        output: Where the MJCF shall be: the paths of its meshes start there.
        options: What the URDF does not say.

    Raises:
        ModelError: If MuJoCo cannot have the robot, or it does not stand.
    """
    try:
        return _made(urdf, output, options)
    except _LeglessError as error:
        # Nothing said that it is free but its number of limbs: a hand or a torso has as many.
        held = _made(urdf, output, replace(options, fixed_base=True))
        message = diagnose("base-fixed-as-it-does-not-stand", why=error.reason)
        return replace(held, notes=(*held.notes, message))


@dataclass(frozen=True)
class _Bare:
    """A URDF's links, shapes and couplings as an MJCF, before anything is added.

    Attributes:
        urdf: The URDF, with the inertials that were repaired.
        mjcf: The MJCF, without its meshes.
        meshes: Its meshes.
        bodies: What is known of its bodies.
        free: Whether its base is free.
        carried: Links whose shapes were moved to the bodies that carry them.
        notes: What was assumed.
        repairs: Inertials that were repaired.
    """

    urdf: UrdfFile
    mjcf: MjcfXml
    meshes: Meshes
    bodies: UrdfBodies
    free: bool
    carried: tuple[str, ...]
    notes: tuple[Diagnostic, ...]
    repairs: tuple[Repair, ...]

    @staticmethod
    def of(urdf: UrdfFile, output: Path, options: MjcfOptions, *, free: bool | None) -> _Bare:
        """Makes it; whether its base is free is found, if it is not said."""
        if all(joint.kind in ("fixed", "floating") for joint in urdf.tree.joints.values()):
            raise ModelError(urdf.path, diagnose("no-joint-moves"))
        meshes = Meshes(urdf, output, copied=options.copy_meshes)
        bodies = UrdfBodies(urdf, meshes, dict(options.armature or {}))
        mjcf = MjcfXml.of_urdf(str(urdf.root.get("name")))
        freed = _is_free(urdf, bodies) if free is None else free
        bodies.add(mjcf, free=freed)
        moved, repairs = mend_inertials(urdf, mjcf, repair=options.repair_inertia)
        mended = repaired_urdf(urdf, mjcf, repairs)
        notes = [*urdf.notes, *moved, *(repair.diagnostic for repair in repairs)]
        if options.merge_fixed:
            merged = merge_fixed(mjcf)
            if merged:
                notes.append(diagnose("fixed-links-are-sites", links=merged))
        carried = carry_shapes(mjcf)
        if carried:
            notes.append(diagnose("shapes-carried", links=carried))
        for name, rgba in bodies.materials.items():
            add_element(mjcf.section("asset"), "material", name=name, rgba=rgba)
        for follower, mimic in bodies.mimics.items():
            mjcf.add_coupling(follower, *mimic)
        return _Bare(
            mended, mjcf, meshes, bodies, freed, tuple(carried), tuple(notes), tuple(repairs)
        )

    def file(self, *, visuals: bool = False) -> MjcfFile:
        """Returns the MJCF as far as it is made, as if it were read from the URDF's file.

        Args:
            visuals: Whether it has what only looks are for.

        Raises:
            ModelError: If MuJoCo refuses it.
        """
        draft, assets = self.mjcf.copy(), dict[str, bytes]()
        if not visuals:
            draft.remove_visuals()
        used = None if visuals else draft.used_meshes
        self.meshes.write(draft.section("asset"), used=used, assets=assets)
        return replace(mjcf_of_text(self.urdf.path, draft.text, assets), of_urdf=True)

    def imported(self) -> UrdfImport:
        """Returns the URDF for MuJoCo's own importer, as far as it touches.

        What no body can weigh, which MuJoCo refuses, is where it was given to, and so are shapes of
        links without mass: the importer, too, makes them the body's that carries them.
        """
        tree, assets = self.urdf.tree.copy(), dict[str, bytes]()
        for body in self.mjcf.bodies:
            link, mended = tree.links[body.name], body.inertia
            link.remove("visual", *(("inertial",) if mended is None else ()))
            if mended is not None and (link.inertia is None or mended != link.inertia):
                link.set_inertia(mended)
            for _, shape, geometry in list(link.shapes):
                if geometry is not None and geometry.tag == "mesh":
                    file = self.meshes.file_of(geometry, assets)
                    geometry.set("filename", file or "")
                    if file is None:
                        link.element.remove(shape)
        for name in self.carried:
            link, joint = tree.links[name], tree.above[name]
            for shape in link.element.findall("collision"):
                set_origin(shape, joint.origin * origin_of(shape))
                tree.links[joint.parent].element.append(shape)
        return UrdfImport(self.urdf.path, to_text(tree.root), assets)


def bare_mjcf(urdf: UrdfFile) -> tuple[UrdfFile, MjcfFile, UrdfImport]:
    """Makes the MJCF of a URDF in memory, its base fixed as it is in the URDF.

    Links whose inertia no body can have get the nearest that one can, and a gram if they have no
    mass; the notes of the MJCF say so.

    Returns:
        The URDF with such inertials, the MJCF, and that URDF for MuJoCo's own importer.

    Raises:
        ModelError: If MuJoCo cannot have the robot, or nothing that moves has a mass.
    """
    bare = _Bare.of(urdf, urdf.path, MjcfOptions(repair_inertia=True), free=False)
    made_up = {repair.link for repair in bare.repairs if not repair.mass > 0}
    if {body.name for body in bare.mjcf.bodies if body.moves} <= made_up:
        # Whatever is said of its motors would be of masses that nobody stated.
        raise ModelError(urdf.path, diagnose("robot-without-mass", mass=Quantity(0.0, "kg")))
    stated = {shape.get("name") for shape in urdf.root.iter("collision")}
    for geom in bare.mjcf.geoms:
        if geom.get("name") not in stated:
            geom.attrib.pop("name", None)  # a foot is called as its link then
    left = (*bare.bodies.notes, *bare.meshes.notes)
    made = replace(bare.file(visuals=True), notes=(*bare.notes, *left))
    return bare.urdf, made, bare.imported()


def _made(urdf: UrdfFile, output: Path, options: MjcfOptions) -> ConversionDraft:
    """Makes the MJCF of a URDF, whose base may turn out to have no legs."""
    said = None if options.fixed_base is None else not options.fixed_base
    bare = _Bare.of(urdf, output, options, free=said)
    mjcf, meshes = bare.mjcf, bare.meshes
    left = [*bare.bodies.notes, *meshes.notes, *_unsaid(urdf)]
    notes, failure, on_balls = list(bare.notes), None, frozenset[str]()
    if bare.free:
        notes += [diagnose("free-joint-added", subject=("body", bare.bodies.root))]
        found, failure, on_balls = _put_stand(bare, options)
        notes = [*dict.fromkeys((*notes, *found)), equip.add_imu(mjcf, bare.bodies)]
    else:
        notes.append(diagnose("base-fixed-in-the-world"))
        notes += _put_held(bare, options)
    elsewhere = meshes.elsewhere
    notes += [*_unstated(mjcf), *([elsewhere] if elsewhere else [])]
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


def _is_free(urdf: UrdfFile, bodies: UrdfBodies) -> bool:
    """Tells whether the base carries two limbs or more, and is not the world."""
    if bodies.root == WORLD or bodies.floats:
        return bodies.floats
    tree = urdf.tree
    carried = [
        joint for link in tree.fixed_group(bodies.root) for joint in tree.below.get(link, ())
    ]
    return sum(not joint.is_fixed for joint in carried) >= _LIMBS


def _put_stand(
    bare: _Bare, options: MjcfOptions
) -> tuple[list[Diagnostic], Diagnostic | None, frozenset[str]]:
    """Adds what `load_robot` finds out: feet, servos, start pose.

    Returns:
        Its notes, why the robot does not stand, if so, and the joints whose feet are balls now.
    """
    mjcf, meshes, bodies = bare.mjcf, bare.meshes, bare.bodies
    # Without shapes nothing can stand, which is no sign of a hand.
    sure = not mjcf.touches
    sure |= bodies.floats or options.feet is not None or options.fixed_base is False
    try:
        robot = robot_of(bare.urdf, bare.file(), feet=options.feet)
    except ModelError as error:
        if options.feet is not None:
            raise
        problem = error.cause
        model = bare.file().model
        if not (meshes.missing or sure or _has_bare_legs(model, bodies.root)):
            raise _LeglessError(problem) from error
        put_all(ground_of_urdf(), mjcf)
        messages = [each.reason for each in ground_of_urdf()] + _put_held(bare, options)
        equip.lift_base(mjcf, bodies, model)
        problem = diagnose("does-not-stand", missing=meshes.missing, problem=problem)
        return messages, problem, frozenset()
    if len(robot.contact_points) < _LIMBS and not sure:
        raise _LeglessError(diagnose("lowest-limbs", limbs=robot.contact_points))
    messages = [note for note in robot.notes if note.code != "armature-from-mjcf"]
    added, failure = robot.description.added, None
    try:
        stand = solve_stand_on_soft_ground(robot)
        if options.sag is not None or options.damping_ratio is not None:
            kp, kd = stand_gains(robot, stand, options.sag, options.damping_ratio)
            added = drives.retuned(robot, kp, kd, stand)
            messages = [note for note in messages if note.code != "servos-added"]
            messages += [each.reason for each in added if isinstance(each, Servo)][:1]
    except PupperAnalysisError as error:
        if not (sure or meshes.missing) and _reaches_no_ground(robot, error):
            raise _LeglessError(
                diagnose("feet-reach-no-ground", feet=robot.contact_points)
            ) from error
        problem = error.diagnostic
        failure = diagnose("does-not-stand", missing=meshes.missing, problem=problem)
        gains = drives.held_gains_of(robot, options.sag, options.damping_ratio)
        added = drives.retuned(robot, *gains)
    put_all(added, mjcf)
    equip.lift_base(mjcf, bodies, robot.mj_model)
    return messages, failure, _joints_on_balls(robot)


def _joints_on_balls(robot: Robot) -> frozenset[str]:
    """Returns the joints that move the bodies to which balls were added in the place of shapes."""
    model = robot.mj_model
    balls = [each for each in robot.description.added if isinstance(each, Ball)]
    bodies = {int(model.body_weldid[model.body(ball.body).id]) for ball in balls}
    return frozenset(
        name for name in robot.joint_names if int(model.jnt_bodyid[model.joint(name).id]) in bodies
    )


def _reaches_no_ground(robot: Robot, error: PupperAnalysisError) -> bool:
    """Says whether what was taken for feet misses the ground by more than the base is high.

    Legs miss it by millimetres, where something is in the way; so do not a hand's fingertips.
    """
    return (
        isinstance(error, StanceUnreachableError)
        and max(error.shortfall.values(), default=0.0) > robot.stand_height
    )


def _has_bare_legs(model: mujoco.MjModel, base: str) -> bool:
    """Says whether two limbs or more hang below the base, and end without a shape that touches.

    Those are legs whose feet were left without shapes; a hand's fingers have them, and point
    elsewhere.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    bare = 0
    for end in limb_ends(model):
        away = data.xpos[end] - data.body(base).xpos
        hangs = -float(away[2]) > float(np.linalg.norm(away)) / 2
        geoms = range(
            int(model.body_geomadr[end]), int(model.body_geomadr[end] + model.body_geomnum[end])
        )
        touches = any(model.geom_contype[geom] or model.geom_conaffinity[geom] for geom in geoms)
        bare += hangs and not touches
    return bare >= _LIMBS


def _put_held(bare: _Bare, options: MjcfOptions) -> list[Diagnostic]:
    """Adds the servos of a robot that is held; returns what was added."""
    if not bare.mjcf.joints:
        return [diagnose("nothing-moves")]
    robot = _freed(bare, options) or robot_of(bare.urdf, bare.file(), fixed_base=True)
    added = robot.description.added
    if options.sag is not None or options.damping_ratio is not None:
        gains = drives.held_gains_of(robot, options.sag, options.damping_ratio)
        added = drives.retuned(robot, *gains)
    # What hangs from the world needs no ground, and no pose of its base.
    added = tuple(each for each in added if not isinstance(each, Floor | Start))
    put_all(added, bare.mjcf)
    return list(dict.fromkeys(each.reason for each in added))


def _freed(bare: _Bare, options: MjcfOptions) -> Robot | None:
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


def _unstated(mjcf: MjcfXml) -> list[Diagnostic]:
    """Tells which joints have neither armature nor damping: a URDF states no armature."""
    joints = mjcf.joints
    still, undamped = (sum(j.get(word) is None for j in joints) for word in ("armature", "damping"))
    messages = [diagnose("armature-unstated", count=still, joints=len(joints))] if still else []
    if undamped:
        messages.append(diagnose("damping-unstated", count=undamped, joints=len(joints)))
    return messages
