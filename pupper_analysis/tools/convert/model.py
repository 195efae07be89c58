"""Conversion of a model file to the other format, with verification.

`convert_model` writes the new file and compares it with the source. For a new MJCF with a free
base, it simulates the stand of the robot and the file itself from the keyframe.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, ClassVar, cast

import mujoco
import numpy as np
import pinocchio as pin

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, Severity, diagnose
from pupper_analysis.base.errors import (
    ConfigurationError,
    ModelError,
    OutputError,
    UnknownNameError,
)
from pupper_analysis.base.files import Writing, check_writable, write_all
from pupper_analysis.base.kinds import MODEL_KIND
from pupper_analysis.base.results import Result
from pupper_analysis.base.runs import ensure_run, register_input
from pupper_analysis.base.units import select_joint_units
from pupper_analysis.models.loading import read_model
from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.models.mjcf_file import MjcfFile, read_mjcf
from pupper_analysis.models.objects import ModelObject, is_object
from pupper_analysis.models.published import find_file, make_xacro_request
from pupper_analysis.models.urdf_file import UrdfFile, read_urdf
from pupper_analysis.prepare.convert.from_urdf import MjcfOptions
from pupper_analysis.prepare.convert.repair import Repair
from pupper_analysis.prepare.judge import list_file_remarks
from pupper_analysis.prepare.notes import describe_span
from pupper_analysis.prepare.passes import Feet, make_robot
from pupper_analysis.prepare.simulable import check_simulable
from pupper_analysis.pupper.named_robots import find_model, is_variant
from pupper_analysis.pupper.variant_files import load_variant
from pupper_analysis.pupper.variants import VariantSpec
from pupper_analysis.robot.alike import report_limbs_without_feet
from pupper_analysis.robot.compare.compare import FilesCompared, compare_files
from pupper_analysis.robot.compare.differences import INERTIAL_KINDS
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import list_position_servos
from pupper_analysis.robot.stability import HOLD_DURATION, Stability
from pupper_analysis.simulation.causes import find_instability, lacks_decay
from pupper_analysis.simulation.rollout import full_state
from pupper_analysis.simulation.stability import (
    Nudge,
    is_solver_error,
    judge_stability,
    measure_response,
    simulate_nudge,
)
from pupper_analysis.simulation.verdict import IMPOSSIBLE_CODES
from pupper_analysis.simulation.verify import StandVerification, verify_stand
from pupper_analysis.stance.soft_ground import solve_stand_on_soft_ground
from pupper_analysis.tools.convert.draft import ConversionDraft, draft_mjcf, draft_urdf


@check_arguments
@silence_mujoco()
@ensure_run()
def convert_model(
    source: str | Path | ModelObject | VariantSpec,
    output: str | Path,
    *,
    feet: Feet | None = None,
    fixed_base: bool | None = None,
    armature: Mapping[str, float] | None = None,
    repair_inertia: bool = False,
    copy_meshes: bool = False,
    packages: Mapping[str, Path] | None = None,
    xacro: bool = False,
    xacro_args: Mapping[str, str] | None = None,
    force: bool = False,
) -> Conversion:
    """Convert a URDF to an MJCF, or an MJCF to a URDF, and verify the new file.

    A new MJCF keeps the numbers of the URDF that an MJCF can express. These are masses, inertia
    tensors, frames, position limits, damping, friction, effort limits (as force ranges), mimic
    joints (as equalities), collision and visual shapes, and mesh scales. Velocity limits, for
    example, are lost. If the base is free, a new MJCF also contains additions for simulation: a
    floor, a free joint, feet, position servos, an IMU, and a keyframe ``home`` with the commands
    that hold this configuration. Contacts between bodies that overlap in the stand are excluded. If
    the base is fixed, no floor, keyframe or IMU is added. A new URDF contains the numbers that
    MuJoCo compiles from the MJCF. Quantities that the new format cannot express are listed in
    ``not_converted``.

    Args:
        source: Path of the URDF or MJCF, name of a published robot, variant, or a robot in memory,
            as for ``load_robot``. Of a variant, the model in the other format than ``output`` is
            converted. If the source is an MJCF, ``feet``, ``fixed_base``, ``armature``,
            ``repair_inertia``, ``copy_meshes`` and ``xacro`` must not be passed.
        output: Path of the new file.
        feet: Links of the feet, or the link for each foot name. Default: detected as by
            ``load_robot``.
        fixed_base: Fix the base in the world. Default: False for a base with two or more limbs that
            is not named ``world``.
        armature: {joint: rotor inertia [kg m^2; kg for a slide]}. Default: the rotor inertias of
            the source if the source is a ``pin.Model``, otherwise none.
        repair_inertia: Replace physically impossible inertias of moving links by the nearest
            possible inertias, and masses of zero by 1 g. Default: such links are refused.
        copy_meshes: Copy all meshes to the folder ``NAME_meshes`` beside the new file. Default: the
            new file contains relative paths to the existing meshes.
        packages: Folder of each ROS package, for ``package://`` paths.
        xacro: True to expand a xacro file, which evaluates the Python expressions in the file.
        xacro_args: {argument of the xacro file: value}, with ``xacro=True``.
        force: Replace existing outputs. Input files are never replaced.

    Returns:
        Written files, notes, and the results of the verification.

    Raises:
        ConfigurationError: If an argument is out of range. Also if ``source`` is an MJCF, and an
            argument is passed that only concerns URDFs as sources.
        VariantError: If ``source`` is probably a misspelled variant name.
        ModelError: For example, if the source cannot be read, the other format cannot represent the
            robot, or the URDF has no joint of ``armature``.
        OutputError: If the output or a mesh exists and ``force`` is False, is an input file, has
            another suffix, is no regular file, or cannot be written.
    """
    output = Path(output)
    name = _name_source(source)
    to_mjcf = output.suffix.lower() != ".urdf"
    variant = None
    if to_mjcf and is_variant(source):
        variant = source if isinstance(source, VariantSpec) else str(source)
    source = find_model(source, "urdf" if to_mjcf else "mjcf")
    if not is_object(source):
        source = find_file(cast(str | Path, source), packages)
        register_input(source)
    _check_output(output, force=force)
    request = make_xacro_request([source], packages, xacro=xacro, arguments=xacro_args)
    file = read_model(source, packages, request)
    if request is not None and isinstance(file, UrdfFile):
        source = file  # the comparison reads the expanded model
    name = name or str(file.path)
    if isinstance(source, pin.Model) and armature is None:
        armature = _list_armatures(source)
    wanted = ".xml" if isinstance(file, UrdfFile) else ".urdf"
    if output.suffix.lower() != wanted:
        made = diagnose("output-named-otherwise", source=name, ending=wanted, mjcf=wanted == ".xml")
        raise OutputError(output, made)
    options = MjcfOptions(feet, fixed_base, armature, repair_inertia, copy_meshes)
    if isinstance(file, MjcfFile):
        _refuse_urdf_options(options, name, xacro=xacro)
    draft = _draft_other_format(file, output, options)
    contents = {**draft.meshes, output: draft.text.encode(errors="backslashreplace")}
    write_all([Writing(path, data, MODEL_KIND, force=force) for path, data in contents.items()])
    urdf, mjcf = (source, output) if isinstance(file, UrdfFile) else (output, source)
    comparison = compare_files(urdf, mjcf, packages=packages, tolerances=Tolerances.fine()).result
    disagreements = tuple(_list_disagreements(comparison, draft))
    checks = _check_new_file(file, draft, output, feet)
    failures = (*disagreements, *checks.failures)
    return Conversion(
        source=name,
        output=str(output),
        written=tuple(map(str, contents)),
        notes=(
            *_list_changed_servos(variant, checks.robot),
            *(remark for remark in checks.remarks if remark.severity is not Severity.ERROR),
            *draft.notes,
        ),
        not_converted=draft.not_converted,
        repairs=draft.repairs,
        comparison=comparison,
        verification=checks.verification,
        kept=checks.keyframe_run,
        floating=checks.robot is not None and checks.robot.floating and bool(checks.robot.feet),
        failures=_put_impossible_first(failures, checks.remarks),
        agree=not (disagreements or comparison.only_urdf or comparison.only_mjcf),
        passed=not failures,
    )


@dataclass(frozen=True, eq=False)
class _NewFileChecks:
    """Results of loading and simulating a converted file.

    Attributes:
        failures: Reasons why the conversion fails.
        robot: Robot of the source and the new file; None if the draft has a failure.
        remarks: Remarks on the robot, of any severity.
        verification: Simulation of the stand; None if no stand is expected.
        keyframe_run: Simulation of a new MJCF from its keyframe; None if there is none.
    """

    failures: tuple[Diagnostic, ...]
    robot: Robot | None = None
    remarks: tuple[Diagnostic, ...] = ()
    verification: StandVerification | None = None
    keyframe_run: KeyframeRun | None = None


def _check_new_file(
    file: UrdfFile | MjcfFile, draft: ConversionDraft, output: Path, feet: Feet | None
) -> _NewFileChecks:
    """Load the source with the new file and, if the robot should stand, simulate its stand."""
    if draft.failure is not None:
        return _NewFileChecks((draft.failure, *draft.lost))
    robot = _make_converted_robot(draft, *_read_converted_pair(file, draft, output), feet)
    remarks = (*report_limbs_without_feet(robot), *list_file_remarks(robot))
    failures = [*draft.lost]
    failures += [remark for remark in remarks if remark.severity is Severity.ERROR]
    if not draft.stands:
        return _NewFileChecks(tuple(failures), robot, remarks)
    verification = verify_stand(robot, solve_stand_on_soft_ground(robot))
    failures += verification.failures
    keyframe_run = run_from_keyframe(output) if isinstance(file, UrdfFile) else None
    if keyframe_run is not None:
        failures += [
            diagnose("fails-from-keyframe", problem=problem) for problem in keyframe_run.failures
        ]
    return _NewFileChecks(tuple(failures), robot, remarks, verification, keyframe_run)


def _name_source(source: str | Path | ModelObject | VariantSpec) -> str:
    """Return the name of a source as the caller typed it; "" for a robot in memory."""
    if isinstance(source, VariantSpec):
        return source.name
    return "" if is_object(source) else str(source)


def _draft_other_format(
    file: UrdfFile | MjcfFile, output: Path, options: MjcfOptions
) -> ConversionDraft:
    """Draft the MJCF of a URDF, or the URDF of an MJCF; nothing is written.

    ``options`` are those of a new MJCF.
    """
    if isinstance(file, UrdfFile):
        check_armatures(file, dict(options.armature or {}))
        return draft_mjcf(file, output, options)
    draft = draft_urdf(file, output)
    if draft.failure is None:
        check_simulable(file)
    return draft


def _read_converted_pair(
    file: UrdfFile | MjcfFile, draft: ConversionDraft, output: Path
) -> tuple[UrdfFile, MjcfFile]:
    """Return URDF and MJCF of a conversion: the source, and the new file as read from ``output``.

    With a new MJCF, impossible inertials may be repaired in the returned URDF.
    """
    if isinstance(file, MjcfFile):
        return read_urdf(output), file
    return draft.urdf or file, read_mjcf(output)


def _list_changed_servos(
    variant: str | VariantSpec | None, robot: Robot | None
) -> Iterator[Diagnostic]:
    """Yield a note if servos or armature of a new MJCF differ from those of the variant's own MJCF.

    The note states both armatures, if they differ: a URDF contains none. ``variant`` is None for
    another source, ``robot`` if the new file has no robot.
    """
    if variant is None or robot is None:
        return
    published = load_variant(variant)
    own, new = list_position_servos(published), list_position_servos(robot)
    own_armatures, new_armatures = map(_read_joint_armatures, (published, robot))
    other_armature = not np.allclose(own_armatures, new_armatures, rtol=1e-6, atol=0.0)
    spans: dict[str, Any] = {
        "variant": str(getattr(variant, "name", variant)),
        "own_armature": describe_span(own_armatures, "kg m^2"),
        "new_armature": describe_span(new_armatures, "1"),
    }
    if not own or not new or own == new:
        if other_armature:
            yield diagnose("armature-of-variant-not-used", **spans)
        return
    for owner, servos in (("new", new), ("own", own)):
        for index, (name, unit) in enumerate((("kp", "N m/rad"), ("kd", "N m s/rad"))):
            values = [gains[index] for gains in servos.values()]
            spans[f"{owner}_{name}"] = describe_span(values, unit)
            spans[f"{owner}_{name}_number"] = describe_span(values, "1")
    yield diagnose("servos-of-variant-not-used", other_armature=other_armature, **spans)


def _read_joint_armatures(robot: Robot) -> Array:
    """Return the armature of each joint in MuJoCo, in actuator order, shape (nu,) [kg m^2, kg]."""
    joints = robot.mj_convention.qvel_index[-robot.nu :]
    armatures: Array = robot.mj_model.dof_armature[joints]
    return armatures


def _check_output(output: Path, *, force: bool) -> None:
    """Raise an OutputError if the path of the new file cannot be used as an output."""
    check_writable(output, MODEL_KIND, force=force)
    if output.exists() and not output.is_file():
        raise OutputError(output, diagnose("output-not-regular"))


def _put_impossible_first(
    failures: Iterable[Diagnostic], remarks: Iterable[Diagnostic]
) -> tuple[Diagnostic, ...]:
    """Put remarks about impossible inertials, as possible causes, before the failures, if any."""
    found = tuple(failures)
    return (*(remark for remark in remarks if found and remark.code in IMPOSSIBLE_CODES), *found)


def _make_converted_robot(
    draft: ConversionDraft, urdf: UrdfFile, mjcf: MjcfFile, feet: Feet | None
) -> Robot:
    """Return the robot of source and new file, with a free base if possible."""
    if draft.urdf is None:
        with contextlib.suppress(ModelError):
            return make_robot(urdf, mjcf, feet=feet)
    return make_robot(urdf, mjcf, feet=feet, fixed_base=not draft.stands)


def _list_armatures(model: pin.Model) -> dict[str, float]:
    """Return {joint: rotor inertia [kg m^2, kg]} of joints with one DoF and an armature."""
    return {
        name: float(model.armature[joint.idx_v])
        for name, joint in list(zip(model.names, model.joints, strict=True))[1:]
        if joint.nv == 1 and model.armature[joint.idx_v]
    }


def _refuse_urdf_options(options: MjcfOptions, source: str, *, xacro: bool) -> None:
    """Raise an error if an option that only concerns URDFs as sources is passed for an MJCF."""
    if xacro:
        raise ConfigurationError("xacro", diagnose("not-of-an-mjcf", source=source))
    for field in fields(options):
        if getattr(options, field.name) != field.default:
            raise ConfigurationError(field.name, diagnose("not-of-an-mjcf", source=source))


def _list_disagreements(comparison: FilesCompared, draft: ConversionDraft) -> Iterator[Diagnostic]:
    """Yield differences between source and new file that no note explains, and objections."""
    repaired = {repair.body for repair in draft.repairs}
    for difference in comparison.differences:
        mended = difference.kind in INERTIAL_KINDS and difference.element in repaired
        on_ball = difference.kind == "collision" and difference.element in draft.on_balls
        if not (mended or on_ball):
            yield difference.diagnostic
    yield from comparison.objections


@dataclass(frozen=True, eq=False)
class Conversion(Result):
    """Result of a conversion.

    Attributes:
        source: Source as passed: path of a file, or name of a variant or published robot. Path of
            the model for a robot in memory.
        output: Path of the new file.
        written: Paths of all written files.
        notes: Additions and assumptions.
        not_converted: Quantities that the new format cannot express, and omitted elements.
        repairs: Physically impossible inertials, with the written values.
        comparison: Comparison of the new file with the source.
        verification: Simulation of the stand for 12 s. None for a new URDF, if the base is fixed,
            or if the robot is known not to stand.
        kept: Simulation of a new MJCF from the keyframe, with a small velocity disturbance (nudge).
            None if ``verification`` is None.
        floating: True if the robot of both files has a free base and feet; False if the robot is
            known not to stand.
        failures: Reasons for a negative result, for example unexplained differences from the
            source, a robot that does not stand, lost collision meshes, impossible inertials.
        agree: True if both files agree, except for repaired inertials and replaced feet.
        passed: True if there are no failures.
    """

    _key_fields: ClassVar[tuple[str, ...]] = ("passed", "agree", "failures")

    source: str
    output: str
    written: tuple[str, ...]
    notes: tuple[Diagnostic, ...]
    not_converted: tuple[Diagnostic, ...]
    repairs: tuple[Repair, ...]
    comparison: FilesCompared
    verification: StandVerification | None
    kept: KeyframeRun | None
    floating: bool
    failures: tuple[Diagnostic, ...]
    agree: bool
    passed: bool


@dataclass(frozen=True, eq=False)
class KeyframeRun(Result):
    """Simulation of an MJCF from the first keyframe, after a nudge (small initial velocity).

    Attributes:
        keyframe: Name of the keyframe.
        stability: Stability of the simulation step after the keyframe has settled.
        nudge: Response to a nudge at the start.
        failures: Reasons why the robot does not return to rest.
    """

    keyframe: str
    stability: Stability
    nudge: Nudge
    failures: tuple[Diagnostic, ...]


def run_from_keyframe(path: Path, duration: float = HOLD_DURATION) -> KeyframeRun | None:
    """Simulate an unmodified MJCF from the first keyframe, after a small velocity disturbance.

    The actuator commands are taken from the keyframe. The disturbance (nudge) tests whether the
    robot returns to rest.

    Args:
        path: MJCF.
        duration: Simulated time [s].

    Returns:
        Stability of the state to which the keyframe settles (`judge_stability`), response to the
        nudge, and reasons why the robot does not return to rest; None if the file has no keyframe.

    Raises:
        ValueError: If MuJoCo refuses the file.
    """
    model = mujoco.MjModel.from_xml_path(str(path))
    if not model.nkey:
        return None
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    start = full_state(model, data)
    nudge = measure_response(model, start, simulate_nudge(model, start, data.ctrl.copy(), duration))
    stability = judge_stability(model, data)
    is_harmless = lacks_decay(nudge) and is_solver_error(model, start, data.ctrl.copy(), nudge)
    failures = tuple(find_instability(stability, nudge, is_harmless=is_harmless))
    return KeyframeRun(model.key(0).name, stability, nudge, failures)


def check_armatures(urdf: UrdfFile, armatures: dict[str, float]) -> None:
    """Check that requested armatures are finite and >= 0, and that the joints exist in the URDF.

    Args:
        urdf: URDF.
        armatures: {joint: armature [kg m^2; kg of a slide]}.

    Raises:
        ConfigurationError: If an armature is negative, infinite or NaN.
        UnknownNameError: If the URDF has no such joint; the message lists the joints.
    """
    known = list(urdf.tree.joints)
    for name, value in armatures.items():
        if name not in known:
            raise UnknownNameError(urdf.path, "joint", name, known)
        if not 0 <= value < float("inf"):
            slides = urdf.tree.joints[name].kind == "prismatic"
            inertia = Quantity(value, select_joint_units(slides=slides).armature)
            problem = diagnose("armature-not-valid", subject=("joint", name), armature=inertia)
            raise ConfigurationError("armature", problem)
