"""Reading of the sources of a contract, which `contract` and `walk` share.

`split_arguments` separates files from folders; `read_sources` reads files with all readers for
their suffix. If other files can be used, the errors of a file are returned, not raised.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import InputError, ModelError, PupperAnalysisError
from pupper_analysis.base.inputs import (
    GENERATED_FOLDERS,
    MAX_FILE_BYTES,
    check_input,
    is_folder,
    path_exists,
)
from pupper_analysis.models.places import Place, make_file_error, make_input_error
from pupper_analysis.tools.contract.facts import JointSource, Request, Role, load_readers
from pupper_analysis.tools.contract.orders import PlacedSource, RobotJoints, assign_joints
from pupper_analysis.tools.contract.readers import tables

MAX_FOLDER_FILES = 500
"""Largest number of files that are read from a folder, to bound the time. Chosen, not tuned."""

_SKIPPED_FOLDERS = (*GENERATED_FOLDERS, "logs", "thirdparty", "__pycache__")
"""Folders that are not searched: generated or installed files, and logs of training."""


def read_sources(requests: Sequence[Request]) -> tuple[list[JointSource], list[ModelError]]:
    """Read files with all readers; errors are collected as long as another file can be used.

    Returns:
        Sources of all files; errors of the files that cannot be used.

    Raises:
        ModelError: If a path is no readable file, or if no file can be used: the first error.
    """
    read, errors = list[JointSource](), list[ModelError]()
    for request in requests:
        try:
            check_input(request.path, MAX_FILE_BYTES)
        except InputError as error:
            raise make_input_error(request.path, error) from error
        try:
            sources = select_configurations(request, read_file(request))
            _check_orders(sources)
            read += sources
        except ModelError as error:
            errors.append(error)
    if errors and not read:
        raise errors[0]
    return read, errors


def _check_orders(sources: Sequence[JointSource]) -> None:
    """Raise a ModelError, with the line, if a source lists a joint name more than once."""
    for source in sources:
        repeated = [name for name in dict.fromkeys(source.order) if source.order.count(name) > 1]
        if repeated:
            place = source.order_place or Place(source.path)
            raise make_file_error(place, diagnose("contract-joint-twice", names=repeated))


def make_names_distinct(read: Sequence[JointSource]) -> list[JointSource]:
    """Add parent folders to the names of sources, until sources of different files differ in name.

    A name that is unique among the files remains unchanged.
    """
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


def split_arguments(sources: Sequence[str | Path]) -> tuple[list[Request], list[Path]]:
    """Convert the arguments of the user to requests for files, and folders for imports.

    ``FILE:NAME`` selects a configuration of a file, if no file has this whole name.

    Returns:
        Requests, one per file; folders.
    """
    folders, files = [], list[tuple[Path, str]]()
    for source in sources:
        path, name = Path(source), ""
        if not path_exists(path) and ":" in path.name:
            file, _, name = str(source).rpartition(":")
            path = Path(file)
        if is_folder(path):
            folders.append(path)
        else:
            files.append((path, name))
    return [Request(path, name, tuple(folders)) for path, name in files], folders


def read_file(request: Request) -> list[JointSource]:
    """Return the sources of a file, read with all readers for its suffix.

    Raises:
        ModelError: If no reader has this suffix, or the file cannot be read, for example.
    """
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


def select_configurations(request: Request, sources: Sequence[JointSource]) -> list[JointSource]:
    """Select the configurations of a file whose joint values are compared with the robot's.

    A configuration is a named set of joint values in the file. Of configurations with the same
    content, one is selected. In a training file, a configuration is also dropped if another
    configuration contains all of its statements.

    Raises:
        ModelError: If a training file has several configurations that contain different
            statements, or if no configuration is found.
    """
    kept = list({source.content: source for source in reversed(sources)}.values())[::-1]
    if kept and kept[0].role is Role.TRAINER:
        statement_sets = [frozenset(source.content[0]) for source in kept]
        kept = [
            source
            for index, source in enumerate(kept)
            if not any(
                statement_sets[index] < statement_set
                or (statement_sets[index] == statement_set and other_index < index)
                for other_index, statement_set in enumerate(statement_sets)
            )
        ]
        if len(kept) > 1:
            names = [source.name.rpartition(":")[2] for source in kept]
            message = diagnose("contract-several", names=names, file=request.path.name)
            raise ModelError(request.path, message)
    if not kept and request.name:
        raise ModelError(request.path, diagnose("contract-name-unknown", name=request.name))
    if not kept:
        is_table = request.path.suffix.lower() in tables.FILE_SUFFIXES
        keys = tables.list_numeric_keys(request.path) if is_table else ()
        raise ModelError(request.path, diagnose("contract-states-nothing", keys=keys[:4] or None))
    return kept


def read_folder(
    folder: Path, read: Sequence[JointSource], joints: RobotJoints
) -> tuple[list[JointSource], list[Diagnostic]]:
    """Read the deployment files in a folder that belong to this robot.

    YAML, JSON and ONNX files are read, without the files of the sources ``read``. A deployment
    belongs to the robot if the joint names fit; others are counted in a note.

    Returns:
        Sources that belong to the robot; notes.
    """
    known_paths = {source.path.absolute() for source in read}
    fitting, num_rejected, refused = list[JointSource](), 0, list[str]()
    for path in _list_source_files(folder):
        try:
            sources = [] if path.absolute() in known_paths else read_file(Request(path))
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


def check_source(placed_source: PlacedSource, model: JointSource) -> list[Diagnostic]:
    """Return the notes on a source, and check that the source states something about the robot.

    Args:
        placed_source: Source whose statements are assigned to joints of the robot.
        model: Robot model, whose name and joints the error states.

    Raises:
        ModelError: If the source states neither a number for a joint of the robot nor a joint
            order. Default values and derived numbers do not count. A source without joint names may
            state settings only, such as the size of a network.
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
    return [*placed_source.source.notes, *placed_source.notes]
