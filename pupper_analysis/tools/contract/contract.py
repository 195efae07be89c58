"""Comparison of the joint numbers in a trainer, a deployment, a driver and a model of a robot.

`read_contract` reads each source (`readers`), assigns the statements to joints of the robot
(`orders`), lists the disagreements (`findings`), and computes the default poses (`poses`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import cast

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import Diagnostic, Severity, diagnose
from pupper_analysis.base.errors import (
    ConfigurationError,
    InputError,
    ModelError,
    PupperAnalysisError,
)
from pupper_analysis.base.results import Result
from pupper_analysis.models.objects import require_path
from pupper_analysis.models.places import make_input_error
from pupper_analysis.models.published import PACKAGE_PREFIX, find_file, is_published_name
from pupper_analysis.pupper.named_robots import find_model_pair, is_variant, refuse_unknown_variant
from pupper_analysis.pupper.variants import VariantSpec
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
"""Largest number of files that are read from a folder. Chosen, to bound the time."""

_SKIPPED_FOLDERS = (
    "node_modules",
    "site-packages",
    "build",
    "install",
    "log",
    "logs",
    "thirdparty",
    "__pycache__",
)
"""Folders of installed or generated files; not searched."""


@dataclass(frozen=True, eq=False)
class SourceRead(Result):
    """Source that was read.

    Attributes:
        name: Name of the file, if needed with parent folders and the name of the configuration.
        path: Path of the file.
        role: trainer, policy, deployment, driver or model.
        order: Joints in the order of the policy's arrays.
        order_source: How the order is known: named, motors, policy or assumed; empty if it is not
            known.
        unknown: Names in the source that match no joint of the model.
        observations: Observations of the policy, in order.
    """

    name: str
    path: str
    role: str
    order: tuple[str, ...]
    order_source: str
    unknown: tuple[str, ...]
    observations: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Contract(Result):
    """Joint numbers of all sources, and the disagreements between them.

    Attributes:
        model: Path of the model file that defines the joint order.
        joints: Joints of this model.
        sources: Sources that were read.
        facts: All numbers, with file and line.
        findings: Disagreements, the most severe first.
        poses: Stand of the robot in the default pose of each source, with the gains of the source.
        notes: Assumptions, and content that could not be read.
        passed: True if every disagreement is less severe than ``fail_on``.
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
    *sources: str | Path | VariantSpec,
    names: Mapping[str, str] | None = None,
    stand: bool = True,
    fail_on: str = "warning",
) -> Contract:
    """Compare the numbers (such as gains and limits) that a robot's model and other files state.

    No code of a source is imported or executed: Python files are evaluated from the syntax tree.

    Args:
        *sources: Files, folders, or ``FILE:NAME`` to select a configuration in a file; at least one
            is a model. A model may also be the name of a published robot, or a base model of the
            package, such as ``"v3"``, for both of its files. Modules that a Python file imports are
            searched in the folders as well.
        names: {joint name in a source: joint name in the model} of joints that are not matched
            automatically.
        stand: Whether to compute how the robot stands in the default pose of each source.
        fail_on: Lowest severity of a disagreement that makes ``passed`` False.

    Returns:
        Numbers, disagreements and poses.

    Raises:
        ConfigurationError: If no model is passed, or an argument is invalid, for example a scaled
            variant, which has no files.
        VariantError: If a source is probably a misspelled variant name.
        ModelError: If a source cannot be read, contains no joint of the robot, or if a trainer's
            file contains several configurations and no name is passed. The message states the
            place and the valid choices.
    """
    if fail_on not in list(map(str, Severity)):
        message = diagnose("one-of", names=[str(severity) for severity in Severity])
        raise ConfigurationError("fail_on", message)
    requests, folders = _split_arguments(_find_model_files(sources))
    read = [
        source
        for request in requests
        for source in _select_configurations(request, _read_file(request))
    ]
    models = [source for source in read if source.role is Role.MODEL]
    if not models:
        raise ConfigurationError("sources", diagnose("contract-without-model"))
    # The joint order is that of the MJCF if there is one: trainers and engines use this order.
    models.sort(key=lambda source: source.path.suffix.lower() not in (".xml", ".mjcf"))
    names, notes = match_joint_names(models, names or {})
    joints = RobotJoints(read_model_file(models[0].path), models[0].order, names)
    for folder in folders:
        folder_sources, folder_notes = _read_folder(folder, read, joints)
        read += folder_sources
        notes += folder_notes
    first, *rest = _make_names_distinct(
        [models[0], *(source for source in read if source is not models[0])]
    )
    placed = [assign_joints(source, joints, rest) for source in (first, *rest)]
    for placed_source in placed:
        notes += _check_source(placed_source, first)
    placed.sort(key=lambda source: list(Role).index(source.source.role))
    poses = tuple[Pose, ...]()
    if stand:
        # Imported late: this module imports PlaCo, which `check` does not need.
        from pupper_analysis.tools.contract.poses import stand_poses

        paths = list(dict.fromkeys(model.path for model in models))
        poses, unstood = stand_poses(paths, placed, first.order)
        notes += unstood
    findings = add_height_effects(find_disagreements(placed, joints), poses)
    worst = Severity(fail_on).rank
    facts = tuple(fact for placed_source in placed for fact in placed_source.facts.values())
    passed = all(finding.severity.rank > worst for finding in findings)
    return Contract(
        str(first.path),
        first.order,
        tuple(map(_summarise_source, placed)),
        facts,
        findings,
        poses,
        tuple(notes),
        passed,
    )


def _check_source(placed_source: PlacedSource, model: Source) -> list[Diagnostic]:
    """Return the notes on a source.

    Raises:
        ModelError: If the source states neither a number for a joint of the robot nor a joint
            order, and is not a network that states the number of joints without names.
    """
    stated_facts = [
        fact for fact in placed_source.facts.values() if fact.joint and not fact.implied
    ]
    source_names = [
        *placed_source.unknown,
        *(statement.joint for statement in placed_source.source.statements if statement.joint),
    ]
    # A network without joint names still states the number of joints.
    is_unnamed_network = any(not fact.joint for fact in placed_source.facts.values()) and not (
        source_names or placed_source.notes
    )
    if not (stated_facts or any(placed_source.order) or is_unnamed_network):
        names = tuple(dict.fromkeys(source_names))[:4]
        message = diagnose(
            "contract-no-joint", model=model.name, names=names, joints=model.order[:4]
        )
        raise ModelError(placed_source.source.path, next(iter(placed_source.notes), message))
    unknown = (
        [
            diagnose(
                "contract-names-unknown",
                file=placed_source.source.name,
                names=placed_source.unknown,
            )
        ]
        if placed_source.unknown
        else []
    )
    return [*placed_source.source.notes, *placed_source.notes, *unknown]


def _make_names_distinct(read: Sequence[Source]) -> list[Source]:
    """Return the sources with distinct names: equal names get parent folders as a prefix."""
    renamed = []
    for source in read:
        own_parts = source.path.absolute().parts
        all_parts = [peer.path.absolute().parts for peer in read if peer.name == source.name]
        other_parts = [parts for parts in all_parts if parts != own_parts]
        num_parts = next(
            num_parts
            for num_parts in range(1, len(own_parts) + 1)
            if own_parts[-num_parts:] not in [parts[-num_parts:] for parts in other_parts]
        )
        renamed.append(replace(source, name="/".join((*own_parts[-num_parts:-1], source.name))))
    return renamed


def _find_model_files(sources: Sequence[str | Path | VariantSpec]) -> list[str | Path]:
    """Return the sources, with the files of base models and published robots instead of names."""
    found: list[str | Path] = []
    for source in sources:
        if is_variant(source):
            models = find_model_pair(source, None)
            for model in models:
                require_path("sources", model)
            found += models
        else:
            refuse_unknown_variant(str(source))
            named = is_published_name(str(source)) or str(source).startswith(PACKAGE_PREFIX)
            found.append(find_file(str(source)) if named else cast(str | Path, source))
    return found


def _split_arguments(sources: Sequence[str | Path]) -> tuple[list[Request], list[Path]]:
    """Separate files (with the name of a configuration) from folders."""
    folders, files = [], list[tuple[Path, str]]()
    for source in sources:
        path, name = Path(source), ""
        if not path.exists() and ":" in path.name:
            file, _, name = str(source).rpartition(":")
            path = Path(file)
        if path.is_dir():
            folders.append(path)
        else:
            files.append((path, name))
    return [Request(path, name, tuple(folders)) for path, name in files], folders


def _read_file(request: Request) -> list[Source]:
    """Read a file with all readers for the suffix."""
    ending = request.path.suffix.lower()
    able = [reader for reader in load_readers() if ending in reader.FILE_SUFFIXES]
    if not able:
        known = sorted({suffix for reader in load_readers() for suffix in reader.FILE_SUFFIXES})
        raise ModelError(request.path, diagnose("contract-of-no-kind", known=known))
    try:
        return [source for reader in able for source in reader.read(request)]
    except InputError as error:
        raise make_input_error(Path(error.path), error) from error
    except RecursionError as error:
        raise ModelError(request.path, diagnose("contract-too-deep")) from error


def _select_configurations(request: Request, sources: Sequence[Source]) -> list[Source]:
    """Select the configurations (named sets of values) of a file that are compared.

    Of configurations with the same content, one is kept. In a file of a training program, a
    configuration is also dropped if another one contains all of its values.

    Raises:
        ModelError: If a file of a training program has several configurations left, or if no
            configuration is found.
    """
    kept = list({source.content: source for source in reversed(sources)}.values())[::-1]
    if kept and kept[0].role is Role.TRAINER:
        statement_sets = [frozenset(source.content[0]) for source in kept]
        kept = [
            one
            for number, one in enumerate(kept)
            if not any(
                statement_sets[number] < each or (statement_sets[number] == each and other < number)
                for other, each in enumerate(statement_sets)
            )
        ]
        if len(kept) > 1:
            names = [source.name.rpartition(":")[2] for source in kept]
            message = diagnose("contract-several", names=names, file=request.path.name)
            raise ModelError(request.path, message)
    if not kept and request.name:
        raise ModelError(request.path, diagnose("contract-name-unknown", name=request.name))
    if not kept:
        raise ModelError(request.path, diagnose("contract-states-nothing"))
    return kept


def _read_folder(
    folder: Path, read: Sequence[Source], joints: RobotJoints
) -> tuple[list[Source], list[Diagnostic]]:
    """Read the deployments in a folder that name joints of this robot; Python modules are not read.

    A deployment is kept if it names all joints, or if the order consists of joints of the robot.
    Other deployments are counted in a note, as are files that cannot be read.
    """
    known_paths = {source.path.absolute() for source in read}
    fitting, num_rejected, refused = list[Source](), 0, list[str]()
    for path in _list_source_files(folder):
        try:
            sources = [] if path.absolute() in known_paths else _read_file(Request(path))
        except PupperAnalysisError:
            refused.append(path.name)
            continue
        for source in sources:
            by_name = assign_joints(source, joints, ())
            every = set(by_name.names.values()) == set(joints.order)
            fits = every or (by_name.how == "named" and all(by_name.order))
            num_rejected += not fits
            fitting += [source] if fits else []
    notes = [diagnose("contract-folder", file=str(folder), count=len(fitting), left=num_rejected)]
    if refused:
        notes.append(diagnose("contract-folder-refused", count=len(refused), names=refused[:5]))
    return fitting, notes


def _list_source_files(folder: Path) -> Iterator[Path]:
    """Yield up to `MAX_FOLDER_FILES` possible deployment files below a folder, sorted by path."""
    found = (
        path
        for path in sorted(folder.rglob("*"))
        if path.suffix.lower() in (".yaml", ".yml", ".json", ".onnx")
        and not any(
            part[0] == "." or part in _SKIPPED_FOLDERS for part in path.relative_to(folder).parts
        )
    )
    return islice(found, MAX_FOLDER_FILES)


def _summarise_source(placed_source: PlacedSource) -> SourceRead:
    """Return name, role, joint order and observations of a source."""
    source, seen = (
        placed_source.source,
        tuple(name for name, _, _ in placed_source.source.observations),
    )
    return SourceRead(
        source.name,
        str(source.path),
        str(source.role),
        placed_source.order,
        placed_source.how,
        placed_source.unknown,
        seen,
    )
