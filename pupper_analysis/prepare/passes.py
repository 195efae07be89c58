"""Prepare a robot that can stand from two published files.

The preparation is a sequence of named passes, in the order of `PREPARATION_PASSES`. Each pass takes
the draft of the robot and returns the new draft with notes on what the pass changed or found.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Term,
    diagnose,
)
from pupper_analysis.base.errors import ConfigurationError, ModelError, PupperAnalysisError
from pupper_analysis.base.results import Result
from pupper_analysis.models.additions import (
    STIFF_FRICTION_OPTIONS,
    Addition,
    DisabledContacts,
    Floor,
    Options,
)
from pupper_analysis.models.description import Description
from pupper_analysis.models.mjcf import has_free_joint, name_elements
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.prepare import (
    drives,
    notes,
    start,
    touching,
)
from pupper_analysis.prepare.base import free_base, place_base_frame, remove_free_joint_friction
from pupper_analysis.prepare.feet import (
    Foot,
    find_feet,
    find_named_foot,
    has_ellipsoids,
    have_contact_points_moved,
    report_sideways_limbs,
    with_feet,
)
from pupper_analysis.prepare.joints import (
    check_motors,
    couple_mimics,
    limit_continuous_joints,
    narrow_limits,
)
from pupper_analysis.prepare.simulable import (
    check_masses,
    check_simulable,
    choose_exact_solver,
    explain_refused_body,
)
from pupper_analysis.prepare.start import find_start_pose, make_start_keyframe
from pupper_analysis.prepare.touching import copy_visual_option, discard_visuals
from pupper_analysis.robot.build import build_robot, copy_metadata, with_additions
from pupper_analysis.robot.contact import limb_ends
from pupper_analysis.robot.floor import level_ground
from pupper_analysis.robot.matching.match import Match, match_models
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import list_position_servos
from pupper_analysis.stance.soft_ground import solve_stand_on_soft_ground


@dataclass(frozen=True, eq=False)
class LoadRequest:
    """What is asked for when a robot is loaded.

    Attributes:
        feet: {foot: its frames in URDF and MJCF}; None: they are looked for.
        fixed_base: Whether the base is fixed in the world.
        name: The robot's name; None: the MJCF's.
        joints: {joint in the URDF: joint in the MJCF}.
        keyframe: The MJCF's keyframe to start from; None: the first in which the robot stands.
        as_is: Whether no servos are added, and no shapes altered.
    """

    feet: Mapping[str, tuple[str, str]] | None = None
    fixed_base: bool = False
    name: str | None = None
    joints: Mapping[str, str] | None = None
    keyframe: str | None = None
    as_is: bool = False


_FREE_IN_PARTS = 4
"""Joints of a base that is free by three slides and a ball joint, or more."""


@dataclass(frozen=True)
class PassRun(Result):
    """A pass that was run.

    Attributes:
        name: What it is called.
        does: What it does, in words.
        done: What it had to do, or found; empty where the files needed nothing.
    """

    name: str
    does: Term
    done: tuple[Diagnostic, ...]


@dataclass(frozen=True, eq=False)
class Draft:
    """A robot as far as it is made.

    Attributes:
        urdf: As it was read.
        mjcf: As it was read.
        request: What is asked for.
        spec: The MJCF's, changed.
        keyframes: {name: {joint: position}} of the MJCF's that may be started from.
        found: Whose joint is whose; from the pass ``match`` on.
        description: Both files made alike; from the pass ``match`` on.
        built: The robot; from the pass ``build`` on.
        footless: Robot before feet were added; from the pass ``put-feet`` on.
        feet: Feet; from the pass ``put-feet`` on.
        refused: Why no robot with a free base can be made: then only ``hold-base`` applies.
        runs: The passes that were run.
    """

    urdf: UrdfFile
    mjcf: MjcfFile
    request: LoadRequest
    spec: mujoco.MjSpec
    keyframes: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    found_match: Match | None = None
    description: Description | None = None
    built: Robot | None = None
    footless: Robot | None = None
    feet: tuple[Foot, ...] = ()
    refused: ModelError | None = None
    runs: tuple[PassRun, ...] = ()

    @property
    def may_fix_base(self) -> bool:
        """Whether its base may be fixed, as the file has it, though it was to be free."""
        if self.request.fixed_base or has_free_joint(self.mjcf.spec):
            return False
        tops = (len(list(body.joints)) for body in self.mjcf.spec.worldbody.bodies)
        return max(tops, default=0) < _FREE_IN_PARTS

    @property
    def match(self) -> Match:
        """Whose joint is whose."""
        assert self.found_match is not None
        return self.found_match

    @property
    def described(self) -> Description:
        """Both files, made alike."""
        assert self.description is not None
        return self.description

    @property
    def robot(self) -> Robot:
        """The robot."""
        assert self.built is not None
        return self.built


Array = NDArray[np.float64]


PassOutput = tuple[Draft, Iterable[Diagnostic]]


@dataclass(frozen=True)
class Pass:
    """A step in making a robot ready.

    Attributes:
        name: What it is called.
        does: What it does, in words.
        apply: Does it; returns the draft with what was done.
        condition: Tells whether it condition a draft.
        after_refusal: Whether it is for drafts of which no robot could be made, too.
    """

    name: str
    does: Term
    apply: Callable[[Draft], PassOutput]
    condition: Callable[[Draft], bool]
    after_refusal: bool = False

    def applies(self, draft: Draft) -> bool:
        """Tells whether it is to be run."""
        return (draft.refused is None or self.after_refusal) and self.condition(draft)


_PASSES: list[Pass] = []


def _pass(
    does: Term, condition: Callable[[Draft], bool], *, after_refusal: bool = False
) -> Callable[[Callable[[Draft], PassOutput]], Callable[[Draft], PassOutput]]:
    """Makes the next pass of a function; it is called as that is."""

    def added(apply: Callable[[Draft], PassOutput]) -> Callable[[Draft], PassOutput]:
        name = apply.__name__.strip("_").replace("_", "-")
        _PASSES.append(Pass(name, does, apply, condition, after_refusal))
        return apply

    return added


def _any(_draft: Draft) -> bool:
    return True


def _free(draft: Draft) -> bool:
    """Before the two files are matched: whether the base is to be free."""
    return not draft.request.fixed_base


def _stands(draft: Draft) -> bool:
    """After they are matched: whether the base is free, so that the robot is to stand."""
    return not draft.request.fixed_base and draft.match.robot.floating


def _held(draft: Draft) -> bool:
    return not _stands(draft)


def _on_feet(draft: Draft) -> bool:
    return _stands(draft) and bool(draft.robot.contact_points)


def _altered(draft: Draft) -> bool:
    return _on_feet(draft) and not draft.request.as_is


def _commanded(draft: Draft) -> bool:
    """Tells whether it is to be brought to rest by servos, on its feet or held."""
    return _altered(draft) or (_held(draft) and not draft.request.as_is)


def _rebuilt(draft: Draft, description: Description | None) -> Draft:
    return draft if description is None else replace(draft, built=build_robot(description))


def _feet(
    robot: Robot, frames: Mapping[str, tuple[str, str]] | None, poses: Sequence[Array]
) -> tuple[Foot, ...]:
    if frames is None:
        return find_feet(robot, poses) if limb_ends(robot.mj_model) else ()
    return tuple(find_named_foot(robot, foot, places, poses[0]) for foot, places in frames.items())


def _stands_on_no_feet(draft: Draft) -> bool:
    """Tells whether the base is to be as the file has it: no robot can be made of it otherwise."""
    if not draft.may_fix_base or draft.refused:
        return draft.may_fix_base
    return draft.robot.floating and start.solve_nominal_stand(draft.robot) is None


@_pass(Term("names bodies and joints that have none"), _any)
def _name_elements(draft: Draft) -> PassOutput:
    spec = draft.spec.copy()
    name_elements(spec, set())
    if draft.request.feet is None:  # a foot may be named by a shape that is only seen
        discard_visuals(spec)
    known = start.choose_keyframes(
        draft.mjcf, start.list_keyframes(spec, draft.mjcf.path), draft.request.keyframe
    )
    return replace(draft, spec=spec, keyframes=known), ()


@_pass(Term("frees the base of a robot with limbs"), _free)
def _free_base(draft: Draft) -> PassOutput:
    spec, messages = free_base(draft.urdf, draft.spec, draft.mjcf.path)
    return replace(draft, spec=spec), messages


@_pass(Term("lifts the base's frame off the ground"), _free)
def _place_base_frame(draft: Draft) -> PassOutput:
    return draft, place_base_frame(draft.spec, draft.mjcf.model, draft.mjcf.path)


@_pass(Term("finds whose joint is whose"), _any)
def _match(draft: Draft) -> PassOutput:
    files = draft.urdf, replace(draft.mjcf, spec=draft.spec)
    found = match_models(*files, names=draft.request.joints, complete=True)
    name = draft.request.name or draft.spec.modelname
    description = replace(found.robot.description, name=name)
    messages = (*found.notes, *notes.report_joint_matching(found))
    return replace(draft, found_match=found, description=description), messages


@_pass(Term("couples joints that follow others"), _any)
def _couple_mimics(draft: Draft) -> PassOutput:
    description, messages = couple_mimics(draft.match, draft.described)
    return replace(draft, description=description), messages


@_pass(Term("builds the robot on its fixed base"), _held)
def _build_held(draft: Draft) -> PassOutput:
    described = start.with_keyframes(draft.described, draft.keyframes)
    described = replace(described, contact_points=draft.request.feet or {})
    robot = build_robot(described, fixed_base=draft.request.fixed_base)
    return replace(draft, description=described, built=robot), ()


@_pass(Term("adds a level ground, or makes it level"), _stands)
def _level_ground(draft: Draft) -> PassOutput:
    ready = draft.described.mjcf.copy()  # which the passes up to the building change in place
    messages = level_ground(ready)
    floors = tuple(Floor(note) for note in messages if note.code == "ground-added")
    described = replace(draft.described, mjcf=ready, added=(*draft.described.added, *floors))
    # Of a robot that stood on nothing, whoever lays the ground says how it grips.
    laid = floors and not has_free_joint(draft.mjcf.spec)
    options = (attributes.keys() for attributes, _ in draft.mjcf.elements("option"))
    if draft.mjcf.of_urdf or (
        laid and not any(STIFF_FRICTION_OPTIONS.keys() & stated for stated in options)
    ):
        grip = list_urdf_ground_additions()[1]
        described, messages = described.given(grip), [*messages, grip.reason]
    return replace(draft, description=described), messages


@_pass(Term("takes dry friction off the free joint"), _stands)
def _free_of_friction(draft: Draft) -> PassOutput:
    return draft, remove_free_joint_friction(draft.described.mjcf)


@_pass(Term("builds the robot"), _stands)
def _build(draft: Draft) -> PassOutput:
    check_motors(draft.mjcf.model, draft.mjcf.path)
    return replace(draft, built=build_robot(draft.described)), ()


@_pass(Term("limits joints of loops that have none"), _stands)
def _bound_joints(draft: Draft) -> PassOutput:
    return _rebuilt(draft, limit_continuous_joints(draft.robot)), ()


@_pass(Term("takes the narrower of both files' joint limits"), _stands)
def _narrow_limits(draft: Draft) -> PassOutput:
    description, messages = narrow_limits(draft.robot)
    return _rebuilt(draft, description), messages


@_pass(Term("refuses joints that move no mass"), _any)
def _check_masses(draft: Draft) -> PassOutput:
    check_masses(draft.robot, draft.urdf)
    return draft, ()


@_pass(Term("finds the feet, and their contact points"), _stands)
def _put_feet(draft: Draft) -> PassOutput:
    bare, given = draft.robot, draft.request.feet
    poses = [start.clip_to_limits(bare, pose) for pose in (*draft.keyframes.values(), None)]
    try:
        feet = _feet(bare, given, poses)
    except ModelError as error:
        gone = [note for note in draft.mjcf.notes if note.code in ("files-missing", "meshes-left")]
        gone = [note for note in gone if note.values.get("kind", "mesh") == "mesh"]
        if not gone:
            raise
        named = [note.values["files"] for note in gone]
        problem = diagnose(
            "no-feet-as-files-are-missing",
            files=tuple(name for names in named if isinstance(names, tuple) for name in names),
            package=next((name for note in gone if (name := note.values.get("package"))), None),
        )
        raise ModelError(draft.mjcf.path, problem) from error
    if not feet:
        return draft, ()
    messages = [notes.report_feet(bare, feet, given=given is not None)]
    balls = notes.report_balls(bare, feet)
    messages += dict.fromkeys(balls.values())
    robot = build_robot(with_feet(bare, feet, balls))
    for _ in range(_MAX_ELLIPSOID_FITS):
        joints = _joints_of_nominal_stand(draft, robot) if has_ellipsoids(bare, feet) else None
        again = feet if joints is None else _feet(bare, given, [joints])
        if not have_contact_points_moved(feet, again):
            break
        feet, robot = again, build_robot(with_feet(bare, again, balls))
    return replace(draft, built=robot, footless=bare, feet=tuple(feet)), messages


_MAX_ELLIPSOID_FITS = 6
"""Upper bound of how often spheres are fitted anew to ellipsoids. Half axes of 30, 20 and 10 mm,
tilted by 0.6 rad, need 2 to 5 (measured for all orders of the axes)."""


def _joints_of_nominal_stand(draft: Draft, robot: Robot) -> Array | None:
    """Return the joint positions, shape (nu,), of the nominal stand; None if there is no stand."""
    sunk = start.compute_resting_depths(draft.mjcf.model)
    stand = start.solve_nominal_stand(find_start_pose(robot, draft.keyframes, sunk)[0])
    return None if stand is None else stand.qpos[-robot.nu :]


@_pass(Term("adds motors to joints of loops that have none"), _altered)
def _add_motors(draft: Draft) -> PassOutput:
    return replace(draft, built=drives.add_loop_motors(draft.robot)), ()


def _rest_depth(draft: Draft) -> Callable[[str], float | None]:
    """Return the function from a keyframe to the penetration at which the file stands from it."""
    return partial(start.rest_depth_from_keyframe, draft.mjcf.model)


@_pass(Term("finds a pose in which it stands"), _on_feet)
def _start_pose(draft: Draft) -> PassOutput:
    sunk = start.compute_resting_depths(draft.mjcf.model)
    robot, pose = find_start_pose(draft.robot, draft.keyframes, sunk, _rest_depth(draft))
    return replace(draft, built=robot), (*notes.report_planar_legs(robot), *pose)


@_pass(Term("takes hulls that carry most of the load as contact points"), _altered)
def _stand_on_hulls(draft: Draft) -> PassOutput:
    if draft.footless is None or draft.robot.closure is not None:
        return draft, ()
    hulls = touching.find_carrying_hulls(draft.footless, draft.robot, draft.feet)
    if hulls is None:
        return draft, ()
    feet, message = hulls
    balls = notes.report_balls(draft.footless, feet)
    own = draft.robot.description.foot_geoms
    kept = {foot.name for foot in draft.feet if foot in feet}
    soft = tuple(geom for name, (geom, _) in own.items() if name not in kept)
    described = with_feet(draft.footless, feet, balls).given(DisabledContacts(message, soft))
    sunk = start.compute_resting_depths(draft.mjcf.model)
    robot, pose = find_start_pose(build_robot(described), draft.keyframes, sunk, _rest_depth(draft))
    if start.solve_nominal_stand(robot) is None:
        return draft, ()
    return replace(draft, built=robot, feet=feet), (message, *dict.fromkeys(balls.values()), *pose)


@_pass(Term("lets feet alone touch the ground"), _altered)
def _touch_with_feet_alone(draft: Draft) -> PassOutput:
    robot, messages = touching.disable_shapes_beside_feet(draft.robot)
    return replace(draft, built=robot), messages


@_pass(Term("excludes contacts of parts that overlap"), _commanded)
def _keep_apart(draft: Draft) -> PassOutput:
    robot, messages = touching.exclude_overlaps(draft.robot)
    return replace(draft, built=robot), messages


@_pass(Term("chooses a solver that solves the equations of motion"), _altered)
def _solve_exactly(draft: Draft) -> PassOutput:
    robot, messages = choose_exact_solver(draft.robot)
    return replace(draft, built=robot), messages


@_pass(
    Term("tells which joints and motors are not commanded"),
    lambda draft: _on_feet(draft) or _held(draft),
)
def _tell_what_follows(draft: Draft) -> PassOutput:
    return draft, (
        *notes.report_coupled_joints(draft.robot),
        *notes.report_uncommanded_actuators(draft.robot),
    )


@_pass(Term("adds position servos that bring it to rest"), _commanded)
def _add_servos(draft: Draft) -> PassOutput:
    robot = draft.robot
    idle = {robot.joint_names[joint] for joint in drives.list_dependent_joints(robot)}
    if not set(robot.joint_names) <= list_position_servos(robot).keys() | idle:
        add = drives.add_suggested_servos if robot.floating else drives.add_fixed_base_servos
        robot, made = add(robot, draft.mjcf)
        return replace(draft, built=robot), made
    return draft, ()


@_pass(Term("has the start pose that was found as the robot rests in it"), _altered)
def _rest_at_start(draft: Draft) -> PassOutput:
    messages = (note for run in draft.runs for note in run.done)
    found = next((note for note in messages if note.code == "start-pose-found"), None)
    if found is None:
        return draft, ()
    with contextlib.suppress(PupperAnalysisError):  # where it does not, no verdict will have it
        stand = solve_stand_on_soft_ground(draft.robot, explain=False)
        draft = replace(
            draft, built=with_additions(draft.robot, make_start_keyframe(draft.robot, stand, found))
        )
    return draft, ()


@_pass(Term("builds the robot with all that is seen of it"), _any)
def _build_whole(draft: Draft) -> PassOutput:
    robot = draft.robot
    spec = robot.description.mjcf.copy()
    if not copy_visual_option(spec, draft.mjcf.spec):
        return draft, ()
    whole = replace(robot.description, mjcf=spec)
    built = build_robot(whole, fixed_base=draft.request.fixed_base)
    return replace(draft, built=copy_metadata(built, robot)), ()


@_pass(Term("fixes the base where it does not stand"), _stands_on_no_feet, after_refusal=True)
def _hold_base(draft: Draft) -> PassOutput:
    refused, request = draft.refused, replace(draft.request, fixed_base=True)
    why = diagnose("stands-on-no-feet") if refused is None else refused.cause
    try:
        held = _passed(Draft(draft.urdf, draft.mjcf, request, draft.mjcf.spec))
    except ModelError:
        if refused is None:
            raise
        raise refused from None
    if refused is None:
        why = (*report_sideways_limbs(held.robot), why)[0]
    return held, (diagnose("base-kept-in-the-world", why=why),)


def list_urdf_ground_additions() -> tuple[Addition, ...]:
    """Returns what a robot stands on of which a URDF is all that is known."""
    held = Options(diagnose("contacts-made-to-hold"), STIFF_FRICTION_OPTIONS)
    return Floor(diagnose("ground-added")), held


PREPARATION_PASSES = tuple(_PASSES)
"""In the order in which they are run: that of their functions above."""


def _passed(draft: Draft) -> Draft:
    """Runs the passes on a draft.

    Raises:
        ModelError: If no robot can be made of it.
        UnknownNameError: If a foot, joint or keyframe is not there.
    """
    for each in PREPARATION_PASSES:
        if each.applies(draft):
            try:
                draft, done = each.apply(draft)
            except ModelError as error:
                error = explain_refused_body(error, draft.urdf, draft.mjcf)
                if draft.refused or not draft.may_fix_base:
                    raise error from error.__cause__
                draft = replace(draft, refused=error)
            else:
                run = PassRun(each.name, each.does, tuple(done))
                draft = replace(draft, runs=(*draft.runs, run))
    return draft


Feet = Sequence[str] | Mapping[str, str | tuple[str, str]]


def make_robot(
    urdf: UrdfFile,
    mjcf: MjcfFile,
    *,
    feet: Feet | None = None,
    fixed_base: bool = False,
    name: str | None = None,
    joints: Mapping[str, str] | None = None,
    keyframe: str | None = None,
    as_is: bool = False,
) -> Robot:
    """Makes a robot of two files that have been read, made ready in memory.

    What its arguments mean says ``load_robot``, which reads the files.
    """
    frames = None if feet is None else parse_feet(feet)
    request = LoadRequest(frames, fixed_base, name, joints, keyframe, as_is)
    robot, _ = prepare_robot(urdf, mjcf, request)
    return robot


def prepare_robot(
    urdf: UrdfFile, mjcf: MjcfFile, request: LoadRequest
) -> tuple[Robot, list[PassRun]]:
    """Makes two files a robot, whose notes are what the passes did.

    Returns:
        The robot, and each pass that was run.

    Raises:
        ModelError: If no robot can be made of them.
        UnknownNameError: If a foot, joint or keyframe is not there.
    """
    check_simulable(mjcf)
    draft = _passed(Draft(urdf, mjcf, request, mjcf.spec))
    messages = (note for run in draft.runs for note in run.done)
    robot = draft.robot
    return replace(robot, notes=tuple(dict.fromkeys((*messages, *robot.notes)))), list(draft.runs)


def parse_feet(feet: Feet) -> dict[str, tuple[str, str]]:
    """Returns {foot: its frames in URDF and MJCF}.

    Raises:
        ConfigurationError: If a frame is neither a name nor a pair of names, or named twice.
    """
    named = dict(feet) if isinstance(feet, Mapping) else {foot: foot for foot in feet}
    if len(named) < len(feet):
        raise ConfigurationError("feet", diagnose("feet-named-twice", feet=map(str, feet)))
    frames = {}
    for foot, frame in named.items():
        pair = (frame, frame) if isinstance(frame, str) else tuple(np.atleast_1d(frame).tolist())
        if len(pair) != 2 or not all(isinstance(name, str) for name in pair):
            problem = diagnose("foot-frame-not-valid", subject=("foot", foot), frame=repr(frame))
            raise ConfigurationError("feet", problem)
        frames[foot] = (str(pair[0]), str(pair[1]))
    return frames
