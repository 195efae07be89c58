"""Comparison of the joint numbers in a trainer, a deployment, a driver and a model of a robot.

`read_contract` reads each source (`readers`), assigns the statements to joints of the robot
(`orders`), lists the disagreements (`findings`), and computes the default poses (`poses`).
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import ClassVar, cast

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import Diagnostic, Severity, diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError
from pupper_analysis.base.results import Result, shorten_paths
from pupper_analysis.models.published import find_file, is_published_name, is_uri
from pupper_analysis.pupper.named_robots import find_files, is_variant, refuse_unknown_variant
from pupper_analysis.pupper.variants import VariantSpec
from pupper_analysis.tools.contract.facts import Fact, JointSource, Role, find_quantity_kind
from pupper_analysis.tools.contract.findings import (
    DefaultPoseStand,
    Disagreement,
    add_height_effects,
    find_disagreements,
    find_lost_quantities,
    find_unmatched_joints,
    note_servo_damping,
)
from pupper_analysis.tools.contract.orders import PlacedSource, RobotJoints, assign_joints
from pupper_analysis.tools.contract.readers import models as models_reader
from pupper_analysis.tools.contract.readers.models import (
    list_unshared_joints,
    match_joint_names,
    read_model_file,
)
from pupper_analysis.tools.contract.reading import (
    check_source,
    make_names_distinct,
    read_folder,
    read_sources,
    split_arguments,
)

PARSED, SIMULATED, TRACED = "parsed", "simulated", "traced"
"""Levels of evidence of a verdict of `contract` or `walk`. ``parsed``: numbers were only read.
``simulated``: the robot was also simulated. ``traced``: the policy was also compared with a
recorded trace."""


@dataclass(frozen=True, eq=False)
class SourceRead(Result):
    """Summary of a source (file or configuration) that was read: role and joint order.

    Attributes:
        name: Name of the file, if needed with parent folders and the name of the configuration.
        path: Path of the file.
        role: trainer, policy, deployment, driver or model.
        order: Joints in the order of the policy's arrays, "" for a name without match; of a model,
            the joints in its own order. Empty if the order is not known.
        order_source: Source of the order: named, motors, policy or assumed; empty if the order is
            unknown.
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
        model: Path of the model file that defines the joint order, or the name of its variant.
        joints: Moving joints of this model, depth first.
        sources: Sources that were compared.
        facts: All numbers, with file and line.
        findings: Disagreements, the most severe first.
        poses: Stands of the robot in the default poses of sources, with the gains of each source.
        unread: Sources and quantities that were not compared, with the reason.
        notes: Assumptions, and content that could not be read.
        evidence: ``parsed`` if the numbers were only read; ``simulated`` if the robot was also
            simulated in a default pose.
        passed: True if every disagreement is less severe than ``fail_on``, and ``fail_on`` is
            ``error``, or ``unread`` is empty and some content of two sources was compared
            (not required of a single source).
        floating: True if the base counts as free, for example if a URDF or MJCF contains a free
            joint, or if two or more limbs are attached to the base.
    """

    _key_fields: ClassVar[tuple[str, ...]] = ("passed", "findings")

    model: str
    joints: tuple[str, ...]
    sources: tuple[SourceRead, ...]
    facts: tuple[Fact, ...]
    findings: tuple[Disagreement, ...]
    poses: tuple[DefaultPoseStand, ...]
    unread: tuple[Diagnostic, ...]
    notes: tuple[Diagnostic, ...]
    evidence: str
    passed: bool
    floating: bool


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
            is a model. A model may also be the name of a published robot, or of a variant, such as
            ``"v3"`` or ``"v3-long-leg"``, which stands for its URDF and its MJCF. Modules that a
            Python file imports are also searched in the folders.
        names: {joint name in a source: joint name in the model} of joints that are not matched
            automatically.
        stand: Whether to compute how the robot stands in the default poses of the sources.
        fail_on: Lowest severity of a disagreement that makes ``passed`` False.

    Returns:
        Numbers, disagreements and poses.

    Raises:
        ConfigurationError: If no model is passed, or an argument is invalid.
        VariantError: If a source is probably a misspelled variant name, or the scales of a variant
            give no valid model.
        UnknownNameError: If MuJoCo Menagerie has no robot with the name in a source.
        MissingPackageError: If the package that reads the format of a model is not installed.
        OutputError: If this run of the command line also writes a source.
        ModelError: If a file does not exist, no model can be read, or no other source can be used,
            for example because it contains no joint of the robot.
    """
    if fail_on not in list(map(str, Severity)):
        message = diagnose("one-of", names=[str(severity) for severity in Severity])
        raise ConfigurationError("fail_on", message)
    # Scaled variants are written to files, because every source is read from a file.
    with TemporaryDirectory() as name:
        folder = Path(name).resolve()
        found, variants = _find_model_files(sources, folder)
        contract = _compare_sources(found, names or {}, stand=stand, fail_on=fail_on)
        # Other commands accept the name of a variant, which is shorter than the path of its file.
        contract = replace(contract, model=variants.get(contract.model, contract.model))
        return shorten_paths(contract, f"{folder}{os.sep}")


def _compare_sources(
    sources: Sequence[str | Path], names: Mapping[str, str], *, stand: bool, fail_on: str
) -> Contract:
    """Read files and folders, and compare the numbers of the robot's joints; see `read_contract`.

    Raises:
        ConfigurationError: If no model is passed, or an argument is invalid.
        ModelError: If no model can be read, or no other source can be used, for example.
    """
    requests, folders = split_arguments(sources)
    read, errors = read_sources(requests)
    models = _select_models(read, errors)
    names, notes = match_joint_names(models, names)
    model = read_model_file(models[0].path)
    joints = RobotJoints.from_model(model, models[0].order, names)
    for folder in folders:
        folder_sources, folder_notes = read_folder(folder, read, joints)
        read += folder_sources
        notes += folder_notes
    first, *rest = make_names_distinct(
        [models[0], *(source for source in read if source is not models[0])]
    )
    placed, placing_notes, placing_errors = _place_sources(first, rest, joints)
    unshared = _list_unshared_joints(placed)
    notes += placing_notes
    errors += placing_errors
    if errors and all(source.source.role is Role.MODEL for source in placed):
        raise errors[0]
    unread = [diagnose("contract-unread", file=error.source, why=error.cause) for error in errors]
    lost = find_lost_quantities(placed, joints)
    unread += [*find_unmatched_joints(placed, first, lost, unshared), *lost]
    notes = [note for note in notes if note not in unread] + note_servo_damping(placed)
    placed.sort(key=lambda source: list(Role).index(source.source.role))
    poses: tuple[DefaultPoseStand, ...] = ()
    if stand:
        # Imported late: this module imports PlaCo, which `check` does not need.
        from pupper_analysis.tools.contract.poses import stand_poses

        # The first URDF and the first MJCF; the first model defines the joints.
        paths = {model.format == "urdf": model.path for model in reversed(models)}
        poses, unstood = stand_poses(list(paths.values()), placed, first.order)
        notes += unstood
    findings = add_height_effects(find_disagreements(placed, joints), poses)
    worst = Severity(fail_on).rank
    facts = tuple(fact for placed_source in placed for fact in placed_source.facts.values())
    passed = all(finding.severity.rank > worst for finding in findings)
    summaries = tuple(map(_summarise_source, placed))
    is_incomplete = bool(unread) or is_uncompared(facts, summaries)
    passed = passed and not (is_incomplete and worst >= Severity.WARNING.rank)
    return Contract(
        str(first.path),
        first.order,
        summaries,
        facts,
        findings,
        poses,
        tuple(unread),
        tuple(notes),
        SIMULATED if any(pose.stays is not None for pose in poses) else PARSED,
        passed,
        model.has_free_base,
    )


def find_compared_numbers(facts: Iterable[Fact]) -> list[tuple[str, str]]:
    """Return the (quantity, joint) pairs that at least two sources state; "" for a setting.

    Quantities that are only listed, and expressions that are not constant, are omitted.
    """
    sources: dict[tuple[str, str], set[str]] = {}
    for fact in facts:
        if fact.value is not None and find_quantity_kind(fact.quantity).severity is not None:
            sources.setdefault((fact.quantity, fact.joint), set()).add(fact.source)
    return [key for key, names in sources.items() if len(names) > 1]


def is_uncompared(facts: Iterable[Fact], sources: Sequence[SourceRead]) -> bool:
    """Return True if there are two or more sources, and no content of two sources was compared.

    Compared contents are numbers, joint orders of sources that are no models, and observations.
    """
    orders = [source for source in sources if source.order and source.role != Role.MODEL]
    observations = [source for source in sources if source.observations]
    has_pair = len(orders) > 1 or len(observations) > 1 or bool(find_compared_numbers(facts))
    return len(sources) > 1 and not has_pair


def _find_model_files(
    sources: Sequence[str | Path | VariantSpec], folder: Path
) -> tuple[list[str | Path], dict[str, str]]:
    """Return sources in which model files replace the names of variants and published robots.

    The files of scaled variants are written to ``folder``.

    Returns:
        Sources; {file of a variant: name of the variant}.
    """
    found: list[str | Path] = []
    variants: dict[str, str] = {}
    for source in sources:
        if is_variant(source):
            files = find_files(source, folder)
            found += files
            name = source.name if isinstance(source, VariantSpec) else str(source)
            variants |= {str(file): name for file in files}
        else:
            refuse_unknown_variant(str(source), is_robot=False)
            named = is_published_name(str(source)) or is_uri(str(source))
            found.append(find_file(str(source)) if named else cast(str | Path, source))
    return found, variants


def _select_models(read: Sequence[JointSource], errors: Sequence[ModelError]) -> list[JointSource]:
    """Return the sources that are robot models, MJCFs first.

    The first model defines the joint order; trainers and engines use the order of an MJCF.

    Raises:
        ConfigurationError: If no model was passed.
        ModelError: If no model can be read: the error of the first model file.
    """
    models = [source for source in read if source.role is Role.MODEL]
    if not models:
        for error in errors:  # its source may be ``file:line``
            file = error.source.rpartition(":")[0] or error.source
            if Path(file).suffix.lower() in models_reader.FILE_SUFFIXES:
                raise error
        raise ConfigurationError("sources", diagnose("contract-without-model"))
    return sorted(models, key=lambda source: source.format != "mjcf")


def _place_sources(
    first: JointSource, others: Sequence[JointSource], joints: RobotJoints
) -> tuple[list[PlacedSource], list[Diagnostic], list[ModelError]]:
    """Assign the numbers in all sources to joints of the robot.

    ``first`` is the model that defines the joint order.

    Returns:
        Sources that can be compared; notes about these; errors of the sources that cannot.
    """
    placed, notes, errors = list[PlacedSource](), list[Diagnostic](), list[ModelError]()
    for source in (first, *others):
        placed_source = assign_joints(source, joints, others)
        try:
            notes += check_source(placed_source, first)
        except ModelError as error:
            errors.append(error)
            continue
        placed.append(placed_source)
    return placed, notes, errors


def _list_unshared_joints(placed: Sequence[PlacedSource]) -> dict[str, set[str]]:
    """Return {name of a model: its joints that are no joints of the robot itself}.

    Models with the same joints are omitted, since their joints are compared in any case.
    """
    models = [source for source in placed if source.source.role is Role.MODEL]
    names = [set(source.order) for source in models]
    if all(source_names == names[0] for source_names in names):
        return {}
    return {
        source.source.name: list_unshared_joints(
            source.source,
            {name for model in models if model is not source for name in model.source.order},
        )
        for source in models
    }


def _summarise_source(placed_source: PlacedSource) -> SourceRead:
    """Return the summary of a source for the result: name, role, joint order, observations."""
    source = placed_source.source
    return SourceRead(
        source.name,
        str(source.path),
        str(source.role),
        placed_source.order,
        placed_source.how,
        placed_source.unknown,
        tuple(term.name for term in source.observations),
    )
