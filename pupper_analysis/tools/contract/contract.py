"""Reads what trainer, deployment, driver and model state of a robot: where do they differ?"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import Diagnostic, Severity, diagnose
from pupper_analysis.base.errors import (
    ConfigurationError,
    InputError,
    ModelError,
    PupperAnalysisError,
)
from pupper_analysis.base.results import Result
from pupper_analysis.models.places import make_input_error
from pupper_analysis.tools.contract.facts import Fact, Request, Role, Source, load_readers
from pupper_analysis.tools.contract.findings import (
    Disagreement,
    Pose,
    add_height_effects,
    find_disagreements,
)
from pupper_analysis.tools.contract.orders import PlacedSource, RobotJoints, assign_joints
from pupper_analysis.tools.contract.readers.models import match_joint_names, read_model_file

MAX_FOLDER_FILES = 500
"""Files of a folder that are read."""

_PASSED_OVER = (
    "node_modules",
    "site-packages",
    "build",
    "install",
    "log",
    "logs",
    "thirdparty",
    "__pycache__",
)


@dataclass(frozen=True, eq=False)
class SourceRead(Result):
    """A source.

    Attributes:
        name: The file's name, and the configuration's in it.
        path: The file.
        role: trainer, policy, deployment, driver or model.
        order: Its joints in the order in which a policy has them.
        how: How that is known: named, motors, policy or assumed.
        unknown: Names in it that are of no joint of the model.
        observations: What a policy observes, in order.
    """

    name: str
    path: str
    role: str
    order: tuple[str, ...]
    how: str
    unknown: tuple[str, ...]
    observations: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Contract(Result):
    """What sources state of a robot, and where they differ.

    Attributes:
        model: The model file by whose joints all is ordered.
        joints: Its joints.
        sources: What was read.
        facts: Every number, with its place.
        findings: What differs, the worst first.
        poses: How the robot stands in each source's default pose, with its gains.
        notes: What was assumed, and what could not be read.
        passed: Whether nothing differs that is as bad as ``fail_on``.
    """

    model: str
    joints: tuple[str, ...]
    sources: tuple[SourceRead, ...]
    facts: tuple[Fact, ...]
    findings: tuple[Disagreement, ...]
    poses: tuple[Pose, ...]
    notes: tuple[Diagnostic, ...]
    passed: bool


@check_arguments
def read_contract(
    *sources: str | Path,
    names: Mapping[str, str] | None = None,
    stand: bool = True,
    fail_on: str = "warning",
) -> Contract:
    """Reads sources, at least one of them a model of the robot, and compares what they state.

    Nothing of a source is imported or run: Python is read by its syntax.

    Args:
        *sources: Files or folders; of a file with several configurations ``FILE:NAME``. Folders
            are also where modules are looked for that a Python file imports.
        names: {a source's name of a joint: the model's}, where they are not matched.
        stand: Whether the robot is stood in each source's default pose.
        fail_on: The least severity of a finding with which it is not passed.

    Raises:
        ConfigurationError: If no model is given, or an argument is not valid.
        ModelError: If a source cannot be read, has no joint of the robot, or several
            configurations that fit; one line that tells where, and what would be valid.
    """
    if fail_on not in list(map(str, Severity)):
        message = diagnose("one-of", names=[str(each) for each in Severity])
        raise ConfigurationError("fail_on", message)
    asked, folders = _asked(sources)
    read = [source for request in asked for source in _one_of(request, _read(request))]
    models = [one for one in read if one.role is Role.MODEL]
    if not models:
        raise ConfigurationError("sources", diagnose("contract-without-model"))
    # By its joints all is ordered: an MJCF's, as it is what trainers and engines go by.
    models.sort(key=lambda one: one.path.suffix.lower() not in (".xml", ".mjcf"))
    names, notes = match_joint_names(models, names or {})
    joints = RobotJoints(read_model_file(models[0].path), models[0].order, names)
    for folder in folders:
        found, said = _in_folder(folder, read, joints)
        read += found
        notes += said
    first, *rest = _named_apart([models[0], *(one for one in read if one is not models[0])])
    placed = [assign_joints(one, joints, rest) for one in (first, *rest)]
    for one in placed:
        notes += _check(one, first)
    placed.sort(key=lambda one: list(Role).index(one.source.role))
    poses = tuple[Pose, ...]()
    if stand:
        from pupper_analysis.tools.contract.poses import stand_poses  # PlaCo, which a guard lacks

        paths = list(dict.fromkeys(one.path for one in models))
        poses, unstood = stand_poses(paths, placed, first.order)
        notes += unstood
    findings = add_height_effects(find_disagreements(placed, joints), poses)
    worst = Severity(fail_on).rank
    facts = tuple(fact for one in placed for fact in one.facts.values())
    passed = all(one.severity.rank > worst for one in findings)
    return Contract(
        str(first.path),
        first.order,
        tuple(map(_source_read, placed)),
        facts,
        findings,
        poses,
        tuple(notes),
        passed,
    )


def _check(one: PlacedSource, model: Source) -> list[Diagnostic]:
    """Returns what is noted of a source; one without a joint of the robot is refused."""
    said = [fact for fact in one.facts.values() if fact.joint and not fact.implied]
    theirs = [*one.unknown, *(each.joint for each in one.source.statements if each.joint)]
    # A network without names states how many joints it is for.
    alone = any(not fact.joint for fact in one.facts.values()) and not (theirs or one.notes)
    if not (said or any(one.order) or alone):
        names = tuple(dict.fromkeys(theirs))[:4]
        message = diagnose(
            "contract-no-joint", model=model.name, names=names, joints=model.order[:4]
        )
        raise ModelError(one.source.path, next(iter(one.notes), message))
    unknown = (
        [diagnose("contract-names-unknown", file=one.source.name, names=one.unknown)]
        if one.unknown
        else []
    )
    return [*one.source.notes, *one.notes, *unknown]


def _named_apart(read: Sequence[Source]) -> list[Source]:
    """Returns sources with names that differ: by as many folders as that takes."""
    done = []
    for one in read:
        mine = one.path.absolute().parts
        same = [each.path.absolute().parts for each in read if each.name == one.name]
        others = [parts for parts in same if parts != mine]
        least = next(
            least
            for least in range(1, len(mine) + 1)
            if mine[-least:] not in [parts[-least:] for parts in others]
        )
        done.append(replace(one, name="/".join((*mine[-least:-1], one.name))))
    return done


def _asked(sources: Sequence[str | Path]) -> tuple[list[Request], list[Path]]:
    folders, files = [], list[tuple[Path, str]]()
    for each in sources:
        path, name = Path(each), ""
        if not path.exists() and ":" in path.name:
            file, _, name = str(each).rpartition(":")
            path = Path(file)
        if path.is_dir():
            folders.append(path)
        else:
            files.append((path, name))
    return [Request(path, name, tuple(folders)) for path, name in files], folders


def _read(request: Request) -> list[Source]:
    ending = request.path.suffix.lower()
    able = [one for one in load_readers() if ending in one.SUFFIXES]
    if not able:
        known = sorted({suffix for one in load_readers() for suffix in one.SUFFIXES})
        raise ModelError(request.path, diagnose("contract-of-no-kind", known=known))
    try:
        return [source for one in able for source in one.read(request)]
    except InputError as error:
        raise make_input_error(Path(error.path), error) from error
    except RecursionError as error:
        raise ModelError(request.path, diagnose("contract-too-deep")) from error


def _one_of(request: Request, found: Sequence[Source]) -> list[Source]:
    """Returns the configuration of a file, if there is one; several controllers are several.

    Configurations that say the same are one, and of a trainer one that another one holds is a part.
    """
    kept = list({one.content: one for one in reversed(found)}.values())[::-1]
    if kept and kept[0].role is Role.TRAINER:
        said = [frozenset(one.content[0]) for one in kept]
        kept = [
            one
            for number, one in enumerate(kept)
            if not any(
                said[number] < each or (said[number] == each and other < number)
                for other, each in enumerate(said)
            )
        ]
        if len(kept) > 1:
            names = [one.name.rpartition(":")[2] for one in kept]
            message = diagnose("contract-several", names=names, file=request.path.name)
            raise ModelError(request.path, message)
    if not kept and request.name:
        raise ModelError(request.path, diagnose("contract-name-unknown", name=request.name))
    if not kept:
        raise ModelError(request.path, diagnose("contract-states-nothing"))
    return kept


def _in_folder(
    folder: Path, read: Sequence[Source], joints: RobotJoints
) -> tuple[list[Source], list[Diagnostic]]:
    """Returns the deployments of a folder that name joints of the robot; not its modules.

    What cannot be read, or has no joint of it, is another robot's: it is counted.
    """
    seen = {one.path.absolute() for one in read}
    found, left, refused = list[Source](), 0, list[str]()
    for path in _files(folder):
        try:
            sources = [] if path.absolute() in seen else _read(Request(path))
        except PupperAnalysisError:
            refused.append(path.name)
            continue
        for one in sources:
            by_name = assign_joints(one, joints, ())
            every = set(by_name.names.values()) == set(joints.order)
            fits = every or (by_name.how == "named" and all(by_name.order))
            left += not fits
            found += [one] if fits else []
    notes = [diagnose("contract-folder", file=str(folder), count=len(found), left=left)]
    if refused:
        notes.append(diagnose("contract-folder-refused", count=len(refused), names=refused[:5]))
    return found, notes


def _files(folder: Path) -> Iterator[Path]:
    """Returns the files of a folder that may be a deployment's, in the order of their names."""
    found = (
        path
        for path in sorted(folder.rglob("*"))
        if path.suffix.lower() in (".yaml", ".yml", ".json", ".onnx")
        and not any(
            part[0] == "." or part in _PASSED_OVER for part in path.relative_to(folder).parts
        )
    )
    return islice(found, MAX_FOLDER_FILES)


def _source_read(one: PlacedSource) -> SourceRead:
    source, seen = one.source, tuple(name for name, _, _ in one.source.observations)
    return SourceRead(
        source.name, str(source.path), str(source.role), one.order, one.how, one.unknown, seen
    )
