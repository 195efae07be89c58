"""URDF, MJCF and USD, by the readers that the package has."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import PupperAnalysisError
from pupper_analysis.models.attributes import TREE_ATTRIBUTES
from pupper_analysis.models.loading import kind_of, read_model, reader_of
from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.models.mjcf_file import read_mjcf
from pupper_analysis.models.places import Place, make_file_error
from pupper_analysis.models.stated.mjcf import read_mjcf_model
from pupper_analysis.models.stated.model import Joint, MjcfModel, RobotModel
from pupper_analysis.models.stated.urdf import read_urdf_model
from pupper_analysis.models.transmission import group_actuators_by_joint, read_actuator_law
from pupper_analysis.models.urdf_file import UrdfFile, read_urdf
from pupper_analysis.robot.matching.match import match_models
from pupper_analysis.tools.contract.facts import QUANTITIES, Request, Role, Source, Statement
from pupper_analysis.tools.contract.orders import list_depth_first

SUFFIXES = (".urdf", ".xml", ".mjcf", ".xacro", ".usd", ".usda", ".usdc", ".usdz")


def read(request: Request) -> Iterator[Source]:
    """Yields what a model file states of its joints, which are in the file's order."""
    model = read_model_file(request.path)
    if isinstance(model, MjcfModel) and model.refusal is not None:
        problem, place = model.refusal
        raise make_file_error(place or Place(request.path), problem)
    compiled = model.mj_model if isinstance(model, MjcfModel) else None
    ids = {} if compiled is None else group_actuators_by_joint(compiled)
    drives = {compiled.joint(one).name: two for one, two in ids.items()} if compiled else {}
    statements = [
        one
        for joint in model.joints.values()
        if joint.moves
        for one in _of_joint(model, joint, drives.get(joint.name, []))
    ]
    if isinstance(model, MjcfModel) and compiled is not None:
        for name, driving in drives.items():
            statements += [one for drive in driving for one in _servo(model, drive, name)]
    order = list_depth_first(model)
    if order:
        yield Source(request.path.name, request.path, Role.MODEL, tuple(statements), order=order)


def _of_joint(model: RobotModel, joint: Joint, drives: list[int]) -> Iterator[Statement]:
    for attribute in TREE_ATTRIBUTES:
        kind, value = attribute.kind, joint.stated.get(attribute.kind)
        if value is None or kind not in QUANTITIES:
            continue
        _, child = model.words(attribute)
        place = model.file.place("joint", joint.name, child)  # type: ignore[attr-defined]
        if isinstance(model, MjcfModel):
            there = model.file.stated("joint", joint.name, attribute.mjcf)
            driven = drives[-1:] if kind == "effort" and not there else []
            place = there or next((_of_actuator(model, one, _RANGES) for one in driven), place)
        yield Statement(kind, float(value), place, joint.name)


_RANGES = ("ctrlrange", "forcerange")


def read_model_file(path: Path) -> RobotModel:
    """Returns the robot that a model file states."""
    reader = reader_of(path)
    with silence_mujoco():
        if reader is not None:
            return reader.read_model(reader.read_file(path))
        file = read_model(path)
        return read_urdf_model(file) if isinstance(file, UrdfFile) else read_mjcf_model(file)


def _servo(model: MjcfModel, drive: int, joint: str) -> Iterator[Statement]:
    """Yield the gains of a position servo at its joint, including a stated stiffness of zero."""
    kp, kd = read_actuator_law(model.mj_model, drive).at_joint
    place = _of_actuator(model, drive, ("kp", "kv", "biasprm", "gainprm"))
    actuator = model.mj_model.actuator(drive).name if model.mj_model else ""
    states_kp = bool(actuator) and model.file.stated("actuator", actuator, ("kp",)) is not None
    if kp or states_kp:
        yield Statement("kp", kp, place, joint)
    if kp > 0 and kd > 0:
        # Of a damping ratio MuJoCo makes what the inertia there asks for.
        name = model.mj_model.actuator(drive).name if model.mj_model else ""
        ratio = bool(name) and model.file.stated("actuator", name, ("dampratio",)) is not None
        yield Statement("kd", kd, place, joint, implied=ratio)


def _of_actuator(model: MjcfModel, number: int, words: tuple[str, ...]) -> Place:
    name = model.mj_model.actuator(number).name if model.mj_model else ""
    if not name:
        return model.file.numbered("actuator", number)
    return model.file.stated("actuator", name, words) or model.file.place("actuator", name)


def match_joint_names(
    models: Sequence[Source], given: Mapping[str, str]
) -> tuple[dict[str, str], list[Diagnostic]]:
    """Returns {a model's name of a joint: the first one's} where these differ, and notes.

    As ``crosscheck`` matches them: by name, by link, and by where they are.

    Args:
        models: The models; a USD stands for a URDF or an MJCF.
        given: {name: joint of the first}, as the user says; it counts over what is found.
    """
    found, notes = dict[str, str](), list[Diagnostic]()
    for other in (each for each in models if set(each.order) != set(models[0].order)):
        # That which can be read as a URDF, then that which can be read as an MJCF; a USD as either.
        one, two = sorted(
            (models[0].path, other.path),
            key=lambda path: 0 if reader_of(path) else 1 if kind_of(path) == "mjcf" else -1,
        )
        known = {
            old: new for old, new in given.items() if old in other.order and new in models[0].order
        }
        turned = one == models[0].path
        try:
            with silence_mujoco():
                first, second = reader_of(one), reader_of(two)
                match = match_models(
                    read_urdf(one) if first is None else first.read_as_urdf(one),
                    read_mjcf(two) if second is None else second.read_as_mjcf(two),
                    names={new: old for old, new in known.items()} if turned else known,
                )
        except PupperAnalysisError as error:
            notes.append(diagnose("contract-unmatched", why=error.diagnostic))
            continue
        pairs = [(a, b) if turned else (b, a) for a, b in match.urdf_joint.items() if a != b]
        found |= pairs
        notes += [one for one in match.notes if one.code == "joint-matches-several"]
        if pairs:
            said = [f"{old} = {new}" for old, new in pairs[:6]]
            notes.append(diagnose("contract-matched", pairs=said, count=len(pairs)))
    return {**found, **given}, notes
