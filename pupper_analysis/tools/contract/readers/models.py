"""URDF, MJCF and USD, by the readers that the package has."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import mujoco
import numpy as np

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import PupperAnalysisError
from pupper_analysis.models.attributes import IN_A_TREE
from pupper_analysis.models.loading import read_model, reader_of
from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.models.places import Place
from pupper_analysis.models.stated.mjcf import read_mjcf_model
from pupper_analysis.models.stated.model import MjcfModel, RobotModel
from pupper_analysis.models.stated.urdf import read_urdf_model
from pupper_analysis.models.transmission import actuator_gear
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.robot.matching.match import match_models
from pupper_analysis.tools.contract.facts import QUANTITIES, Request, Role, Source, Statement
from pupper_analysis.tools.contract.orders import depth_first

SUFFIXES = (".urdf", ".xml", ".mjcf", ".xacro", ".usd", ".usda", ".usdc", ".usdz")


def read(request: Request) -> Iterator[Source]:
    """Yields what a model file states of its joints, which are in the file's order."""
    model = read_stated(request)
    moving = [joint for joint in model.joints.values() if joint.moves]
    if not moving:
        return
    statements = []
    motors = _motors(model.mj_model) if isinstance(model, MjcfModel) and model.mj_model else {}
    for joint in moving:
        for attribute in IN_A_TREE:
            value = joint.stated.get(attribute.kind)
            # An effort or velocity of 0 in a URDF is how it says that it states none.
            placeholder = attribute.kind in ("effort", "velocity") and not value
            if value is None or placeholder or attribute.kind not in QUANTITIES:
                continue
            _, child = model.words(attribute)
            place = model.file.place("joint", joint.name, child)  # type: ignore[attr-defined]
            if isinstance(model, MjcfModel):
                there = model.file.stated("joint", joint.name, attribute.mjcf)
                driven = motors.get(joint.name) if attribute.kind == "effort" else None
                place = there or (driven and _of_actuator(model, *driven, _RANGES)) or place
            statements.append(Statement(attribute.kind, float(value), place, joint.name))
    if isinstance(model, MjcfModel) and model.mj_model is not None:
        statements += _servos(model, model.mj_model)
        statements += _keyframe(model, model.mj_model)
    order = depth_first(model)
    yield Source(request.path.name, request.path, Role.MODEL, tuple(statements), order=order)


def read_stated(request: Request) -> RobotModel:
    """Returns the robot that a model file states."""
    reader = reader_of(request.path)
    with silence_mujoco():
        if reader is not None:
            return reader.read_model(reader.read_file(request.path))
        file = read_model(request.path)
        return read_urdf_model(file) if isinstance(file, UrdfFile) else read_mjcf_model(file)


def _servos(model: MjcfModel, compiled: mujoco.MjModel) -> Iterator[Statement]:
    """Yields gains of position servos, as they are at the joint."""
    for number in range(compiled.nu):
        servo = compiled.actuator_biastype[number] == mujoco.mjtBias.mjBIAS_AFFINE
        turns = compiled.actuator_trntype[number] == mujoco.mjtTrn.mjTRN_JOINT
        kp, kd = -compiled.actuator_biasprm[number, 1:3]
        if not (servo and turns and kp > 0):
            continue
        name = compiled.joint(int(compiled.actuator_trnid[number, 0])).name
        gear = float(np.ravel(actuator_gear(compiled, number))[0])
        place = _of_actuator(model, compiled, number, ("kp", "kv", "biasprm", "gainprm"))
        yield Statement("kp", float(kp) * gear**2, place, name)
        if kd > 0:
            yield Statement("kd", float(kd) * gear**2, place, name)


_RANGES = ("ctrlrange", "forcerange")


def _motors(compiled: mujoco.MjModel) -> dict[str, tuple[mujoco.MjModel, int]]:
    """Returns {joint: the actuator that drives it alone}."""
    turned = [number for number in range(compiled.nu)
              if compiled.actuator_trntype[number] == mujoco.mjtTrn.mjTRN_JOINT]  # fmt: skip
    return {compiled.joint(int(compiled.actuator_trnid[one, 0])).name: (compiled, one)
            for one in turned}  # fmt: skip


def _of_actuator(
    model: MjcfModel, compiled: mujoco.MjModel, number: int, words: tuple[str, ...]
) -> Place:
    name = compiled.actuator(number).name
    if not name:
        return model.file.numbered("actuator", number)
    stated = model.file.stated("actuator", name, words)
    return stated or model.file.place("actuator", name)


def _keyframe(model: MjcfModel, compiled: mujoco.MjModel) -> Iterator[Statement]:
    if not compiled.nkey:
        return
    names = [compiled.key(number).name for number in range(compiled.nkey)]
    key = names.index("home") if "home" in names else 0
    place = model.file.place("key", names[key])
    for joint in model.joints.values():
        if joint.moves and not joint.name.startswith("("):
            at = compiled.jnt_qposadr[compiled.joint(joint.name).id]
            yield Statement("start angle", float(compiled.key_qpos[key, at]), place, joint.name)


def match_names(
    models: Sequence[Source], given: Mapping[str, str]
) -> tuple[dict[str, str], list[Diagnostic]]:
    """Returns {a URDF's name of a joint: the MJCF's} where these differ, and what was assumed.

    As ``crosscheck`` matches them: by name, by link, and by where they are.

    Args:
        models: The models; only one URDF beside one MJCF is matched so.
        given: {name: joint of the MJCF}, as the user says; it counts over what is found.
    """
    files = [read_model(one.path) for one in models if reader_of(one.path) is None]
    urdf = next((one for one in files if isinstance(one, UrdfFile)), None)
    mjcf = next((one for one in files if not isinstance(one, UrdfFile)), None)
    orders = {tuple(sorted(one.order)) for one in models}
    if urdf is None or mjcf is None or len(orders) < 2:
        return dict(given), []
    theirs = {name for one in models for name in one.order}
    known = {old: new for old, new in given.items() if old in theirs and new in theirs}
    try:
        with silence_mujoco():
            match = match_models(urdf, mjcf, names=known)
    except PupperAnalysisError as error:
        return dict(given), [diagnose("contract-unmatched", why=error.diagnostic)]
    names = {old: new for new, old in match.urdf_joint.items() if old != new}
    pairs = [f"{old} = {new}" for old, new in names.items()][:6]
    messages = [diagnose("contract-matched", pairs=pairs, count=len(names))] if names else []
    messages += [one for one in match.notes if one.code == "joint-matches-several"]
    return {**names, **given}, messages
