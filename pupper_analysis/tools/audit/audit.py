"""Audit of a model file: runs the rules for the format of the file, except disabled rules.

Input is a URDF, an MJCF, a file of a registered format, or a robot in memory. The values that the
file states are read into a ``RobotModel``, without the preparation that other commands apply.
Output is an ``Audit`` with the findings. A finding contains the line, if known, and possible
repairs. Some rules report several violations as a single finding.
"""

from __future__ import annotations

import difflib
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import Severity, Subject, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.results import shorten_memory_paths
from pupper_analysis.models.loading import Check, CheckFinding, ModelFile, read_model, reader_of
from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.objects import ModelObject, is_object
from pupper_analysis.models.places import NO_LINE, Place
from pupper_analysis.models.published import make_xacro_request
from pupper_analysis.models.stated.mjcf import read_mjcf_model
from pupper_analysis.models.stated.model import RobotModel
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.pupper.named_robots import find_model
from pupper_analysis.pupper.variants import VariantSpec
from pupper_analysis.tools.audit import rules as _rules  # noqa: F401  (registers the rules)
from pupper_analysis.tools.audit.registry import (
    CHECKS,
    RULES,
    Audit,
    Finding,
    Rule,
    ValueRepair,
)
from pupper_analysis.tools.audit.repairs import find_repairs
from pupper_analysis.tools.audit.rules.files import choose_mesh_axes

__all__ = ["RULES", "Audit", "Finding", "Rule", "Severity", "audit_model"]


@check_arguments
def audit_model(
    path: str | Path | ModelObject | VariantSpec,
    *,
    packages: Mapping[str, Path] | None = None,
    disabled: Iterable[str] = (),
    xacro: bool = False,
    xacro_args: Mapping[str, str] | None = None,
) -> Audit:
    """Find physical and practical errors in a model file of any supported format.

    Args:
        path: Model file, name of a published robot, or a robot in memory, as for ``load_robot``;
            for a variant, the MJCF is audited. Findings about a robot in memory, a scaled variant
            or a xacro file may have no lines.
        packages: {ROS package: folder}, for ``package://`` paths in a URDF.
        disabled: Ids of rules that are not run.
        xacro: True to expand a xacro file, which evaluates the Python expressions in the file.
        xacro_args: {argument of the xacro file: value}, with ``xacro=True``.

    Returns:
        Audit with the findings, sorted by severity. At equal severity, causes precede consequences.

    Raises:
        ModelError: If the file cannot be read, or is no valid URDF, for example.
        ConfigurationError: If a rule in ``disabled`` does not exist, an argument has a wrong type,
            or there are ``xacro_args`` without ``xacro`` or a xacro file.
        MissingPackageError: If the package that reads the format is not installed, for example
            usd-core.
        VariantError: If ``path`` is a word without suffix that names no variant, existing path or
            published robot, or the scales of a variant give no valid model.
        UnknownNameError: If MuJoCo Menagerie has no robot with the name in ``path``.
        OutputError: If this run of the command line also writes the file.
    """
    path = find_model(path, "mjcf")
    if isinstance(disabled, str):
        disabled = (disabled,)
    unwanted = tuple(dict.fromkeys(disabled))
    unknown = [name for name in unwanted if name not in RULES]
    if unknown:
        alike = dict.fromkeys(
            rule
            for name in unknown
            for rule in difflib.get_close_matches(str(name), RULES, cutoff=0.5)
        )
        message = diagnose("rules-unknown", names=unknown, alike=list(alike), known=RULES)
        raise ConfigurationError("disabled", message)
    request = make_xacro_request([path], packages, xacro=xacro, arguments=xacro_args)
    reader = reader_of(path)
    with warnings.catch_warnings(), np.errstate(all="ignore"), silence_mujoco():
        warnings.simplefilter("ignore")  # MuJoCo's warnings are replaced by findings
        if reader is not None:
            assert isinstance(path, str | Path)  # objects have no reader
            read = reader.read_file(Path(path))
            return _run_rules(str(path), read, reader.read_model(read), unwanted, reader.CHECKS)
        file = read_model(path, packages, request)
        name = str(file.path if is_object(path) else path)
        audit = _run_rules(name, file, _read_stated_model(file), unwanted, {})
        return shorten_memory_paths(audit, file.path)


def _run_rules(
    path: str,
    file: ModelFile,
    robot: RobotModel,
    unwanted: tuple[str, ...],
    extra_checks: Mapping[str, Check],
) -> Audit:
    """Run the checks of the rules for the format of a model, and collect the findings.

    ``extra_checks`` is {rule id: check} of the reader of a further format, such as USD.
    """
    findings, run = [], []
    for rule in RULES.values():
        if robot.format not in rule.formats or rule.id in unwanted:
            continue
        run.append(rule.id)
        checks = [
            checks_by_rule[rule.id]
            for checks_by_rule in (CHECKS, extra_checks)
            if rule.id in checks_by_rule
        ]
        findings += [
            _make_finding(file, rule, found, find_repairs(robot, rule.id, found))
            for check in checks
            for found in check(robot)
        ]
    findings.sort(
        key=lambda finding: (
            finding.severity.rank,
            _CONSEQUENCES.get(finding.diagnostic.code, RULES[finding.rule].precedence),
            finding.file,
            finding.line or 0,
            finding.prim or "",
        )
    )
    counts = {
        str(severity): sum(finding.severity == severity for finding in findings)
        for severity in Severity
    }
    return Audit(
        file=path,
        format=robot.format,
        passed=counts[Severity.ERROR] == 0,
        counts=counts,
        findings=tuple(findings),
        rules_run=tuple(run),
        disabled=unwanted,
        notes=robot.notes,
        floating=robot.has_free_base,
    )


_CONSEQUENCES = {"hardly-any-mass": 3}
"""{code of a message: precedence}, for messages whose precedence differs from the precedence of the
rule. ``hardly-any-mass`` comes late, since wrong masses of the attached links may be the cause.
"""


def _read_stated_model(file: UrdfFile | MjcfFile) -> RobotModel:
    """Return the values that a file states, as the model that the rules check."""
    return choose_mesh_axes(file) if isinstance(file, UrdfFile) else read_mjcf_model(file)


def _make_finding(
    file: ModelFile, rule: Rule, found: CheckFinding, repairs: tuple[ValueRepair, ...]
) -> Finding:
    """Create the reported finding from the result of a check: add place, severity and texts."""
    place = found.place
    if place is None and found.name:
        place = file.place(found.kind, found.name, found.child)
    if place is None:
        place = Place(file.path)
    if place.line == NO_LINE:  # of an expanded or converted text
        place = replace(place, line=None)
    severity = found.severity or rule.severity
    message = replace(
        found.message,
        severity=severity,
        subject=Subject(found.kind, found.name),
        sources=(place.source,),
    )
    return Finding(
        rule=rule.id,
        severity=severity,
        file=str(place.file),
        line=place.line,
        prim=place.element,
        element=f"{found.kind} {found.name!r}" if found.name else found.kind,
        why=rule.why,
        todo=rule.todo,
        diagnostic=message,
        repairs=repairs,
    )
