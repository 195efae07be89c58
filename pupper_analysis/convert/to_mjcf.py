"""A URDF as an MJCF that is ready for simulation."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.convert import equip
from pupper_analysis.convert.conversion import ConversionDraft
from pupper_analysis.convert.from_urdf import WORLD, UrdfBodies
from pupper_analysis.convert.meshes import Meshes
from pupper_analysis.convert.repair import carry_shapes, mend_inertials, merge_fixed, repaired_urdf
from pupper_analysis.diagnostics import Diagnostic, diagnose
from pupper_analysis.errors import ModelError, PupperAnalysisError, StanceUnreachableError
from pupper_analysis.models.joint_kinds import JointKind
from pupper_analysis.models.mjcf_file import read_mjcf
from pupper_analysis.models.mjcf_xml import MjcfXml
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.models.xml_layout import put_defaults, to_text
from pupper_analysis.models.xml_text import add_element, write_numbers
from pupper_analysis.prepare.load import Feet, robot_of
from pupper_analysis.prepare.notes import describe_span
from pupper_analysis.prepare.servo_tuning import held_gains, stand_gains
from pupper_analysis.robot.feet import limb_ends
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.soft_ground import solve_stand_on_soft_ground

Array = NDArray[np.float64]

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
        told = diagnose("base-fixed-as-it-does-not-stand", why=error.reason)
        return replace(held, notes=(*held.notes, told))


def _made(urdf: UrdfFile, output: Path, options: MjcfOptions) -> ConversionDraft:
    """Makes the MJCF of a URDF, whose base may turn out to have no legs."""
    if all(joint.kind in ("fixed", "floating") for joint in urdf.tree.joints.values()):
        raise ModelError(urdf.path, diagnose("no-joint-moves"))
    meshes = Meshes(urdf, output, copied=options.copy_meshes)
    bodies = UrdfBodies(urdf, meshes, dict(options.armature or {}))
    free = _is_free(urdf, bodies) if options.fixed_base is None else not options.fixed_base
    mjcf = MjcfXml.of_urdf(str(urdf.root.get("name")))
    bodies.add(mjcf, free=free)
    moved, repairs = mend_inertials(urdf, mjcf, repair=options.repair_inertia)
    mended = repaired_urdf(urdf, mjcf, repairs)
    notes = [*urdf.notes, *moved, *(repair.diagnostic for repair in repairs)]
    left = [*bodies.notes, *meshes.notes, *_unsaid(urdf)]
    if options.merge_fixed:
        merged = merge_fixed(mjcf)
        if merged:
            notes.append(diagnose("fixed-links-are-sites", links=merged))
    carried = carry_shapes(mjcf)
    if carried:
        notes.append(diagnose("shapes-carried", links=carried))
    asset = mjcf.section("asset")
    for name, rgba in bodies.materials.items():
        add_element(asset, "material", name=name, rgba=rgba)
    if free:
        mjcf.add_floor()
        notes += [diagnose("floor-and-free-joint-added"), diagnose("contacts-made-to-hold")]
    for follower, mimic in bodies.mimics.items():
        mjcf.add_coupling(follower, *mimic)
    failure = None
    if free:
        found, failure = _put_stand(mjcf, mended, meshes, bodies, options)
        notes = [*dict.fromkeys((*notes, *found)), equip.add_imu(mjcf, bodies)]
    else:
        notes.append(diagnose("base-fixed-in-the-world"))
        notes += _put_held(mjcf, _trial(mjcf, urdf, meshes), bodies, options)
    elsewhere = meshes.elsewhere
    notes += [*_unstated(mjcf), *([elsewhere] if elsewhere else [])]
    meshes.write(asset)
    mjcf.remove_empty_sections()
    put_defaults(mjcf.root)
    header = f"Converted from {urdf.path.name} by pupper-analysis."
    return ConversionDraft(
        text=to_text(mjcf.root, header),
        meshes=meshes.made,
        notes=tuple(notes),
        not_converted=tuple(left),
        repairs=tuple(repairs),
        urdf=mended,
        stands=free,
        failure=failure,
        lost=tuple(meshes.lost),
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
    mjcf: MjcfXml,
    urdf: UrdfFile,
    meshes: Meshes,
    bodies: UrdfBodies,
    options: MjcfOptions,
) -> tuple[list[Diagnostic], Diagnostic | None]:
    """Adds what `load_robot` finds out: feet, servos, start pose.

    Returns:
        Its notes, and why the robot does not stand, if so.
    """
    # Without shapes nothing can stand, which is no sign of a hand.
    sure = not mjcf.touches
    sure |= bodies.floats or options.feet is not None or options.fixed_base is False
    try:
        robot = _loaded(mjcf, urdf, meshes, options.feet)
    except ModelError as error:
        if options.feet is not None:
            raise
        problem = error.cause
        model = _trial(mjcf, urdf, meshes)
        if not (meshes.missing or sure or _has_bare_legs(model, bodies.root)):
            raise _LeglessError(problem) from error
        _put_held(mjcf, model, bodies, options)
        equip.lift_base(mjcf, bodies, model)
        return [], diagnose("does-not-stand", missing=meshes.missing, problem=problem)
    if len(robot.contact_points) < _LIMBS and not sure:
        raise _LeglessError(diagnose("lowest-limbs", limbs=robot.contact_points))
    told = [note for note in robot.notes if note.code != "armature-from-mjcf"]
    failure = None
    try:
        equip.add_contacts(mjcf, robot)
        stand = solve_stand_on_soft_ground(robot)
        kp, kd = stand_gains(robot, stand, options.sag, options.damping_ratio)
        equip.add_home(mjcf, bodies, robot, stand, kp)
        if options.sag is not None or options.damping_ratio is not None:
            told = [note for note in told if note.code != "servos-added"]
            told.append(_servos(kp, kd))
    except PupperAnalysisError as error:
        if not (sure or meshes.missing) and _reaches_no_ground(robot, error):
            raise _LeglessError(
                diagnose("feet-reach-no-ground", feet=robot.contact_points)
            ) from error
        problem = error.diagnostic
        failure = diagnose("does-not-stand", missing=meshes.missing, problem=problem)
        kp, kd = held_gains(robot.mj_model, options.sag, options.damping_ratio)
    equip.lift_base(mjcf, bodies, robot.mj_model)
    mjcf.set_options(timestep=write_numbers(robot.mj_model.opt.timestep))
    mjcf.use_implicit_damping()
    gains = zip(kp.tolist(), kd.tolist(), strict=True)
    equip.add_servos(mjcf, bodies, dict(zip(robot.joint_names, gains, strict=True)))
    return told, failure


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


def _put_held(
    mjcf: MjcfXml, model: mujoco.MjModel, bodies: UrdfBodies, options: MjcfOptions
) -> list[Diagnostic]:
    """Adds the servos of a robot that is held; returns what was added."""
    mjcf.use_implicit_damping()
    moving = np.flatnonzero(model.jnt_type != JointKind.FREE)
    if not len(moving):
        return [diagnose("nothing-moves")]
    kp, kd = held_gains(model, options.sag, options.damping_ratio)
    names = [str(model.joint(int(index)).name) for index in moving]
    gains = zip(kp.tolist(), kd.tolist(), strict=True)
    equip.add_servos(mjcf, bodies, dict(zip(names, gains, strict=True)))
    return [_servos(kp, kd)]


def _unstated(mjcf: MjcfXml) -> list[Diagnostic]:
    """Tells which joints have neither armature nor damping: a URDF states no armature."""
    joints = mjcf.joints
    still, undamped = (sum(j.get(word) is None for j in joints) for word in ("armature", "damping"))
    told = [diagnose("armature-unstated", count=still, joints=len(joints))] if still else []
    if undamped:
        told.append(diagnose("damping-unstated", count=undamped, joints=len(joints)))
    return told


def _servos(kp: Array, kd: Array) -> Diagnostic:
    return diagnose(
        "servos-made", kp=describe_span(kp, "N m/rad"), kd=describe_span(kd, "N m s/rad")
    )


def _loaded(mjcf: MjcfXml, urdf: UrdfFile, meshes: Meshes, feet: Feet | None) -> Robot:
    """Loads the robot from the MJCF as far as it is made."""
    with _draft(mjcf, urdf, meshes) as path:
        return robot_of(urdf, read_mjcf(path), feet=feet)


def _trial(mjcf: MjcfXml, urdf: UrdfFile, meshes: Meshes) -> mujoco.MjModel:
    """Compiles the MJCF as far as it is made."""
    with _draft(mjcf, urdf, meshes) as path:
        return read_mjcf(path).model


@contextmanager
def _draft(mjcf: MjcfXml, urdf: UrdfFile, meshes: Meshes) -> Iterator[Path]:
    """Writes the MJCF as far as it is made, without what only looks are for.

    Raises:
        ModelError: What is raised about the draft, which nobody knows, as about the URDF.
    """
    draft = mjcf.copy()
    draft.remove_visuals()
    with tempfile.TemporaryDirectory() as folder:
        meshes.write(draft.section("asset"), used=draft.used_meshes, trial=Path(folder))
        path = Path(folder) / "draft.xml"
        path.write_text(draft.text)
        try:
            yield path
        except ModelError as error:
            if str(path) in error.source:
                raise ModelError(urdf.path, error.cause) from error
            raise
