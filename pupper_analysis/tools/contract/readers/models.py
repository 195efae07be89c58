"""Reader of URDF, MJCF and USD files for the contract of a robot.

Input is a model file; output is a `JointSource` with limits, passive terms and servo gains of each
moving joint, each with its line. The joint order is limb by limb, as in MuJoCo.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import mujoco

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import PupperAnalysisError
from pupper_analysis.models.attributes import TREE_ATTRIBUTES
from pupper_analysis.models.loading import read_as_mjcf, read_as_urdf, read_model, reader_of
from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.places import Place, make_file_error
from pupper_analysis.models.spec_tree import find_free_base
from pupper_analysis.models.stated.mjcf import read_mjcf_model
from pupper_analysis.models.stated.model import FREE_JOINT, Joint, MjcfModel, RobotModel
from pupper_analysis.models.stated.urdf import read_urdf_model
from pupper_analysis.models.transmission import group_actuators_by_joint, read_actuator_law
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.robot.matching.match import match_models
from pupper_analysis.robot.matching.trees import without_shapes
from pupper_analysis.tools.contract.facts import (
    QUANTITIES,
    JointSource,
    Origin,
    Request,
    Role,
    Statement,
)
from pupper_analysis.tools.contract.orders import list_depth_first

FILE_SUFFIXES = (".urdf", ".xml", ".mjcf", ".xacro", ".usd", ".usda", ".usdc", ".usdz")
"""Suffixes of the files that this reader of model files reads."""


def read(request: Request) -> Iterator[JointSource]:
    """Yield the joint parameters that a URDF, MJCF or USD states, and the order of the joints.

    Parameters are, for example, effort limits and servo gains. The order is depth first, limb by
    limb. Nothing is yielded for a model without moving joints. `read_model_file` raises the errors
    of a file that cannot be read.
    """
    model, notes = read_model_file(request.path), list[Diagnostic]()
    if isinstance(model, MjcfModel) and model.refusal is not None:
        problem, _ = model.refusal
        notes.append(diagnose("contract-text-alone", file=request.path.name, why=problem))
    compiled = model.mj_model if isinstance(model, MjcfModel) else None
    ids = {} if compiled is None else group_actuators_by_joint(compiled)
    drives = (
        {compiled.joint(joint).name: actuators for joint, actuators in ids.items()}
        if compiled
        else {}
    )
    statements = [
        statement
        for joint in model.joints.values()
        if joint.moves
        for statement in _list_joint_statements(model, joint, drives.get(joint.name, []))
    ]
    unlimited = dict[str, Place]()
    if isinstance(model, MjcfModel) and compiled is not None:
        for name, driving in drives.items():
            if driving and name in model.joints and math.isinf(model.joints[name].effort):
                unlimited[name] = _find_actuator_place(model, driving[-1], ())
            statements += [
                statement
                for drive in driving
                for statement in _list_servo_statements(model, drive, name)
            ]
    order = list_depth_first(model)
    if order:
        yield JointSource(
            request.path.name,
            request.path,
            Role.MODEL,
            tuple(statements),
            order=order,
            notes=tuple(notes),
            unlimited=unlimited,
            format=model.format,
        )


def _list_joint_statements(
    model: RobotModel, joint: Joint, drives: list[int]
) -> Iterator[Statement]:
    """Yield the limits and passive terms of a joint, each with the line in the file.

    ``drives`` are the indices of the joint's actuators, at which an MJCF may state the effort.
    """
    for attribute in TREE_ATTRIBUTES:
        kind, value = attribute.kind, joint.stated.get(attribute.kind)
        if value is None or kind not in QUANTITIES:
            continue
        _, child = model.locate_parameter(attribute)
        place = model.file.place("joint", joint.name, child)  # type: ignore[attr-defined]
        if isinstance(model, MjcfModel):
            there = model.file.find_attribute("joint", joint.name, attribute.mjcf)
            driven = drives[-1:] if kind == "effort" and not there else []
            place = there or next(
                (_find_actuator_place(model, actuator, _RANGE_ATTRIBUTES) for actuator in driven),
                place,
            )
        yield Statement(kind, float(value), place, joint.name)


_RANGE_ATTRIBUTES = ("ctrlrange", "forcerange")
"""Attributes of an actuator that limit the torque."""


def read_model_file(path: Path) -> RobotModel:
    """Read the values that a URDF, MJCF or file of a registered format states, as a model.

    Of an MJCF that MuJoCo does not compile, joints and actuators are read, if possible.

    Raises:
        ModelError: If the file cannot be read, or is no valid model, for example.
        OutputError: If this run of the command line also writes the file, or a file that a xacro
            file includes.
        MissingPackageError: If the reader of the format needs a package that is not installed.
    """
    reader = reader_of(path)
    with silence_mujoco():
        if reader is not None:
            return reader.read_model(reader.read_file(path))
        file = read_model(path)
        if isinstance(file, UrdfFile):
            return read_urdf_model(file)
        model = read_mjcf_model(file)
        return model if model.links else _read_refused_mjcf(model)


def _read_refused_mjcf(model: MjcfModel) -> MjcfModel:
    """Return the joints and actuators of an MJCF that MuJoCo does not compile.

    MuJoCo compiles a copy without elements, such as keyframes, that do not affect the numbers of
    joints, except for a kd that MuJoCo computes from a damping ratio.

    Raises:
        ModelError: If MuJoCo does not compile the rest either: the error about the file.
    """
    assert model.refusal is not None
    problem, place = model.refusal
    spec = model.file.spec.copy()
    for element in (*spec.pairs, *spec.excludes, *spec.sensors, *spec.keys, *spec.equalities):
        spec.delete(element)
    for geom in [
        candidate for candidate in spec.geoms if candidate.type == mujoco.mjtGeom.mjGEOM_MESH
    ]:
        spec.delete(geom)
    spec.compiler.boundmass = spec.compiler.boundinertia = _MIN_REFUSED_INERTIA
    spec.compiler.balanceinertia = True
    try:
        with silence_mujoco():
            file = replace(model.file, spec=spec, refusal=None, as_it_is=None)
            return replace(read_mjcf_model(file), refusal=model.refusal)
    except (ValueError, RuntimeError, TypeError) as error:
        raise make_file_error(place or Place(model.file.path), problem) from error


_MIN_REFUSED_INERTIA = 1e-6
"""Minimum mass [kg] and inertia [kg m^2] of bodies of a file that MuJoCo does not compile. Chosen:
only numbers of joints and actuators are read from such a file."""


def _list_servo_statements(model: MjcfModel, drive: int, joint: str) -> Iterator[Statement]:
    """Yield kp [N m/rad, N/m] and kd [N m s/rad, N s/m] of a servo at a joint, with lines.

    ``drive`` is the id of the actuator.
    """
    kp, kd = read_actuator_law(model.mj_model, drive).joint_gains
    place = _find_actuator_place(model, drive, ("kp", "kv", "biasprm", "gainprm"))
    actuator = model.mj_model.actuator(drive).name if model.mj_model else ""
    states_kp = (
        bool(actuator) and model.file.find_attribute("actuator", actuator, ("kp",)) is not None
    )
    if kp or states_kp:
        yield Statement("kp", kp, place, joint)
    if kp > 0 and kd > 0:
        # From a damping ratio MuJoCo computes kv with the inertia at the joint.
        name = model.mj_model.actuator(drive).name if model.mj_model else ""
        ratio = (
            bool(name) and model.file.find_attribute("actuator", name, ("dampratio",)) is not None
        )
        origin = Origin.DERIVED if ratio else Origin.STATED
        yield Statement("kd", kd, place, joint, origin=origin)


def _find_actuator_place(model: MjcfModel, number: int, words: tuple[str, ...]) -> Place:
    """Return the file and line that set an attribute of an actuator, or else of the actuator.

    ``number`` is the index of the actuator. ``words`` are names of attributes, of which one is
    sufficient.
    """
    name = model.mj_model.actuator(number).name if model.mj_model else ""
    if not name:
        return model.file.place_by_number("actuator", number)
    return model.file.find_attribute("actuator", name, words) or model.file.place("actuator", name)


def match_joint_names(
    models: Sequence[JointSource], given: Mapping[str, str]
) -> tuple[dict[str, str], list[Diagnostic]]:
    """Match the joints of further models to the joints of the first model, as `crosscheck` does.

    Args:
        models: Sources of models.
        given: {joint name in another model: joint name in the first model}, passed by the user;
            takes precedence.

    Returns:
        {joint name in another model: joint name in the first model} of names that differ, with the
        pairs of ``given``; and notes.
    """
    matched, notes = dict[str, str](), list[Diagnostic]()
    first_names = set(models[0].order)
    # If one model contains all names of the other model, no joint can have another name.
    for model_source in (
        model_source
        for model_source in models[1:]
        if set(model_source.order) - first_names and first_names - set(model_source.order)
    ):
        # First the file readable as a URDF, then the one readable as an MJCF; a USD is both.
        urdf_source, mjcf_source = sorted(
            (models[0], model_source), key=lambda source: _FORMAT_RANKS.get(source.format, 0)
        )
        user_pairs = {
            old: new
            for old, new in given.items()
            if old in model_source.order and new in models[0].order
        }
        first_is_urdf = urdf_source is models[0]
        try:
            with silence_mujoco():
                match = match_models(
                    _read_as_urdf(urdf_source),
                    _read_as_mjcf(mjcf_source),
                    names={new: old for old, new in user_pairs.items()}
                    if first_is_urdf
                    else user_pairs,
                )
        except PupperAnalysisError as error:
            notes.append(diagnose("contract-unmatched", why=error.diagnostic))
            continue
        pairs = [(a, b) if first_is_urdf else (b, a) for a, b in match.urdf_joint.items() if a != b]
        matched |= pairs
        notes += [note for note in match.notes if note.code == "joint-matches-several"]
        if pairs:
            pair_texts = [f"{old} = {new}" for old, new in pairs[:6]]
            matched_note = diagnose("contract-matched", pairs=pair_texts, count=len(pairs))
            notes += [] if matched_note in notes else [matched_note]
    return {**matched, **given}, notes


_FORMAT_RANKS = {"urdf": -1, "mjcf": 1}
"""{format of a model: rank}: of two models that are matched, the model of the lower rank is read as
the URDF. A format without entry has the rank 0, and can be read as both."""


def _read_as_urdf(source: JointSource) -> UrdfFile:
    """Read a model as a URDF; an MJCF is converted."""
    if source.format != "mjcf":
        return read_as_urdf(source.path)
    # Imported late: only two models of the same format with different joints need a conversion.
    from pupper_analysis.prepare.convert.load import read_pair

    return read_pair(source.path).urdf


def _read_as_mjcf(source: JointSource) -> MjcfFile:
    """Read a model as an MJCF; a URDF is converted without shapes, because joints are matched."""
    if source.format != "urdf":
        return read_as_mjcf(source.path)
    from pupper_analysis.prepare.convert.load import ModelPair  # see `_read_as_urdf`

    urdf = read_as_urdf(source.path)
    return ModelPair.from_file(replace(urdf, root=without_shapes(urdf.root))).mjcf


def list_unshared_joints(model: JointSource, others: Collection[str]) -> set[str]:
    """Return the joints of a model that are no joints of the robot itself.

    These joints move the free base of an MJCF in place of a free joint (`find_free_base`), or
    belong to other objects of a scene, beside a robot with a free joint.

    Args:
        model: Source of the model.
        others: Joints that another model contains.
    """
    stated = read_model_file(model.path)
    if not isinstance(stated, MjcfModel) or stated.base not in stated.links:
        return set()
    base = stated.links[stated.base]
    root = [base.name, *stated.ancestors(base.name)][-1]
    links = {root, *(link.name for link in stated.descendants(root))}
    free_base = find_free_base(stated.file.spec, others)
    has_free_base = free_base is not None and free_base.name == root
    joints = {joint.name for joint in stated.links[root].joints} if has_free_base else set()
    if any(joint.kind == FREE_JOINT for joint in stated.links[root].joints) or has_free_base:
        joints |= {name for name, joint in stated.joints.items() if joint.child not in links}
    return joints - set(others)
