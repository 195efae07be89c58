"""Converts a model file into the other format, and proves that both agree."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path

import mujoco

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, Severity, diagnose
from pupper_analysis.base.errors import (
    ConfigurationError,
    OutputError,
    UnknownNameError,
)
from pupper_analysis.base.files import Writing, check_writable, write_all
from pupper_analysis.base.kinds import MODEL
from pupper_analysis.base.results import Result
from pupper_analysis.base.runs import note_input, running
from pupper_analysis.models.loading import read_model
from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.models.mjcf_file import read_mjcf
from pupper_analysis.models.urdf_file import UrdfFile, read_urdf
from pupper_analysis.prepare.convert.from_urdf import MjcfOptions
from pupper_analysis.prepare.convert.repair import Repair
from pupper_analysis.prepare.judge import remarks_of_files
from pupper_analysis.prepare.passes import Feet, robot_of
from pupper_analysis.prepare.simulable import check_simulable
from pupper_analysis.robot.alike import structure
from pupper_analysis.robot.compare.compare import FilesCompared, compare_files
from pupper_analysis.robot.compare.differences import OF_INERTIALS
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.robot.stability import LASTING, Stability, step_stability
from pupper_analysis.simulation.causes import find_instability
from pupper_analysis.simulation.rollout import full_state
from pupper_analysis.simulation.stability import Nudge, measure_response, simulate_nudge
from pupper_analysis.simulation.verify import StandVerification, verify_stand
from pupper_analysis.stance.soft_ground import solve_stand_on_soft_ground
from pupper_analysis.tools.convert.draft import ConversionDraft, mjcf_draft, urdf_draft


@check_arguments
@silence_mujoco()
@running()
def convert_model(
    source: str | Path,
    output: str | Path,
    *,
    feet: Feet | None = None,
    fixed_base: bool | None = None,
    armature: Mapping[str, float] | None = None,
    repair_inertia: bool = False,
    copy_meshes: bool = False,
    packages: Mapping[str, Path] | None = None,
    force: bool = False,
) -> Conversion:
    """Converts a URDF into an MJCF, or an MJCF into a URDF.

    Of an MJCF the URDF has what MuJoCo compiles it to; what no URDF can say is ``not_converted``.

    All that a URDF states is kept, number by number: masses, products of inertia, frames, limits,
    damping, friction, effort limits as force ranges, mimic joints as equalities, shapes for
    collision and for looks apart, scales of meshes. What a simulation needs besides is added: a
    floor and a free joint, feet, position servos, pairs of bodies that overlap where they stand, a
    keyframe ``home`` with the commands that hold it, an IMU. The new file is proven before the call
    returns: cross-checked with the source, its robot stood for 12 s and nudged, and the file itself
    simulated from its keyframe.

    Args:
        source: Path of the URDF, or of the MJCF; then only ``output``, ``packages`` and ``force``
            are for it.
        output: Path of the new file.
        feet: The feet's links, or {foot: link}; by default they are found, as by ``load_robot``.
        fixed_base: Whether the base is fixed in the world; by default a base with two limbs or more
            is free, unless it is called ``world``.
        armature: {joint: rotor inertia (kg m^2)}, which no URDF states.
        repair_inertia: Give links that move, and whose inertia no body can have, the nearest that
            one can, and a gram to those without mass; by default they are refused.
        copy_meshes: Copy all meshes to a folder ``NAME_meshes`` beside the new file; by default it
            names them where they are, relative to itself.
        packages: {ROS package: its folder}, for ``package://`` paths.
        force: Replace the output, and meshes, if they exist; never what is read.

    Returns:
        What was written, and the proof.

    Raises:
        ConfigurationError: If an argument is out of its range.
        ModelError: If the source cannot be read, or the other format cannot have the robot.
        OutputError: If the output or a mesh exists, is one of the files that are read, or cannot be
            written.
    """
    source, output = Path(source), Path(output)
    note_input(source)
    check_writable(output, MODEL, force=force)
    if output.exists() and not output.is_file():
        raise OutputError(output, diagnose("output-not-regular"))
    file = read_model(source, packages)
    wanted = ".xml" if isinstance(file, UrdfFile) else ".urdf"
    if output.suffix.lower() != wanted:
        made = diagnose(
            "output-named-otherwise", source=source, ending=wanted, mjcf=wanted == ".xml"
        )
        raise OutputError(output, made)
    options = MjcfOptions(feet, fixed_base, armature, repair_inertia, copy_meshes)
    if isinstance(file, UrdfFile):
        check_joints(file, dict(armature or {}))
        draft = mjcf_draft(file, output, options)
        urdf, mjcf = source, output
    else:
        _refuse_given(options, source)
        draft = urdf_draft(file, output)
        urdf, mjcf = output, source
        if draft.failure is None:
            check_simulable(file)  # before anything is written
    contents = {**draft.meshes, output: draft.text.encode(errors="backslashreplace")}
    write_all([Writing(path, data, MODEL, force=force) for path, data in contents.items()])
    comparison = compare_files(urdf, mjcf, packages=packages, tolerances=Tolerances.fine()).result
    verification, kept = None, None
    failures = list(_disagreements(comparison, draft))
    agree = not (failures or comparison.only_urdf or comparison.only_mjcf)
    if draft.failure is not None:
        failures.append(draft.failure)
    failures += draft.lost
    unlike: tuple[Diagnostic, ...] = ()
    if draft.failure is None:
        pair = draft.urdf or read_urdf(urdf), read_mjcf(mjcf)
        robot = robot_of(*pair, feet=feet, fixed_base=not draft.stands)
        unlike = (*structure(robot), *remarks_of_files(robot))
        failures += [one for one in unlike if one.severity is Severity.ERROR]
    if draft.failure is None and draft.stands:
        verification = verify_stand(robot, solve_stand_on_soft_ground(robot))
        failures += verification.failures
        if mjcf == output:
            kept = keyframe_run(mjcf)
            why = [] if kept is None else kept.failures
            failures += [diagnose("fails-from-keyframe", problem=problem) for problem in why]
    return Conversion(
        source=str(source),
        output=str(output),
        written=tuple(map(str, contents)),
        notes=(*(one for one in unlike if one.severity is not Severity.ERROR), *draft.notes),
        not_converted=draft.not_converted,
        repairs=draft.repairs,
        comparison=comparison,
        verification=verification,
        kept=kept,
        failures=tuple(failures),
        agree=agree,
        passed=not failures,
    )


def _refuse_given(options: MjcfOptions, source: Path) -> None:
    """Refuses what only a new MJCF can have."""
    for field in fields(options):
        if getattr(options, field.name) != field.default:
            raise ConfigurationError(field.name, diagnose("not-of-an-mjcf", source=source))


def _disagreements(comparison: FilesCompared, draft: ConversionDraft) -> Iterator[Diagnostic]:
    """Yields what makes the files disagree, but for what the notes tell.

    Inertials that were repaired, of which the comparison proves that they explain all that is left,
    and feet on balls in the place of their meshes.
    """
    repaired = {repair.body for repair in draft.repairs}
    for difference in comparison.differences:
        mended = difference.kind in OF_INERTIALS and difference.element in repaired
        on_ball = difference.kind == "collision" and difference.element in draft.on_balls
        if not (mended or on_ball):
            yield difference.diagnostic
    yield from comparison.objections


@dataclass(frozen=True, eq=False)
class Conversion(Result):
    """What became of a conversion.

    Attributes:
        source: The file that was converted.
        output: The new file.
        written: All files that were written.
        notes: What was added that the source does not say, or assumed.
        not_converted: What the new format cannot say, or what was left out.
        repairs: Inertials that no body can have, and what was written in their places.
        comparison: The new file against the source.
        verification: The simulated stand, 12 s long; None where there is none to be simulated.
        kept: What a new MJCF does from its own keyframe, nudged; None where there is none.
        failures: Why the new file is not what it shall be: it disagrees with the source beyond what
            is ``not_converted``, its robot does not stand, or it lost what touches.
        agree: Whether both files agree, but for what was repaired.
        passed: Whether they agree, and the robot stands if it is one that shall.
    """

    source: str
    output: str
    written: tuple[str, ...]
    notes: tuple[Diagnostic, ...]
    not_converted: tuple[Diagnostic, ...]
    repairs: tuple[Repair, ...]
    comparison: FilesCompared
    verification: StandVerification | None
    kept: KeyframeRun | None
    failures: tuple[Diagnostic, ...]
    agree: bool
    passed: bool


@dataclass(frozen=True, eq=False)
class KeyframeRun(Result):
    """What an MJCF does from its own keyframe when it is nudged.

    Attributes:
        keyframe: Its name.
        stability: Of where it settles.
        nudge: What becomes of a nudge that is given at once.
        failures: Why it does not stay there.
    """

    keyframe: str
    stability: Stability
    nudge: Nudge
    failures: tuple[Diagnostic, ...]


def keyframe_run(path: Path, duration: float = LASTING) -> KeyframeRun | None:
    """Simulates a file from its first keyframe, with nothing added and nothing changed.

    Args:
        path: The MJCF, as it was written.
        duration: s.

    Returns:
        What it does; None if it has no keyframe.
    """
    model = mujoco.MjModel.from_xml_path(str(path))
    if not model.nkey:
        return None
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    start = full_state(model, data)
    nudge = measure_response(model, start, simulate_nudge(model, start, data.ctrl.copy(), duration))
    stability = step_stability(model, data)
    failures = tuple(find_instability(stability, nudge))
    return KeyframeRun(model.key(0).name, stability, nudge, failures)


def check_joints(urdf: UrdfFile, names: dict[str, float]) -> None:
    """Refuses armatures that are negative, or of joints that a URDF does not have.

    Raises:
        ConfigurationError: If one is negative, or no number.
        ModelError: If a joint is not there; the message lists those that are.
    """
    known = list(urdf.tree.joints)
    for name, value in names.items():
        if name not in known:
            raise UnknownNameError(urdf.path, "joint", name, known)
        if not 0 <= value < float("inf"):
            inertia = Quantity(value, "kg m^2")
            problem = diagnose("armature-not-valid", subject=("joint", name), armature=inertia)
            raise ConfigurationError("armature", problem)
