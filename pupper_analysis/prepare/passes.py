"""Prepare a robot from a URDF and an MJCF.

The preparation is a sequence of named passes, in the order of `PREPARATION_PASSES`. Each pass gets
the draft (the robot in preparation). The pass returns the new draft, with notes on what the pass
changed or found.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import mujoco
import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Term,
    diagnose,
)
from pupper_analysis.base.errors import ConfigurationError, ModelError, PupperAnalysisError
from pupper_analysis.base.results import Result
from pupper_analysis.models.additions import (
    STIFF_FRICTION_OPTIONS,
    Addition,
    Ball,
    DisabledContacts,
    Floor,
    Options,
)
from pupper_analysis.models.description import Description
from pupper_analysis.models.mjcf import has_free_joint, name_elements, silence_mujoco
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.places import make_file_error
from pupper_analysis.models.stated.mjcf import place_of_geom
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.prepare import (
    drives,
    notes,
    start,
    touching,
)
from pupper_analysis.prepare.base import (
    free_base,
    place_base_frame,
    remove_free_joint_friction,
    states_free_base,
)
from pupper_analysis.prepare.feet import (
    CONTACT_POINT_TOLERANCE,
    MAX_SHORT_LEG_HEIGHT_FRACTION,
    Foot,
    add_contact_frames,
    count_joints_to_base,
    find_feet,
    find_named_foot,
    has_ellipsoids,
    measure_point_displacement,
    report_sideways_limbs,
)
from pupper_analysis.prepare.joints import (
    check_motors,
    couple_mimics,
    limit_continuous_joints,
    narrow_limits,
)
from pupper_analysis.prepare.limits import report_unstated_efforts
from pupper_analysis.prepare.simulable import (
    check_joint_limits,
    check_masses,
    check_simulable,
    choose_exact_solver,
    explain_model_fault,
)
from pupper_analysis.prepare.start import (
    find_start_pose,
    make_start_keyframe,
    round_start_configuration,
)
from pupper_analysis.prepare.touching import copy_visual_option, discard_visuals
from pupper_analysis.robot.alike import list_limbs
from pupper_analysis.robot.build import build_robot, copy_metadata, with_additions
from pupper_analysis.robot.contact import ground_geom, limb_ends
from pupper_analysis.robot.floor import level_ground
from pupper_analysis.robot.matching.match import Match, match_models
from pupper_analysis.robot.robot import Robot, defer_stages, release_borrowed_objects
from pupper_analysis.robot.servos import list_position_servos
from pupper_analysis.stance.soft_ground import solve_stand_on_soft_ground
from pupper_analysis.stance.stand import Stand, solve_stand, stand_statics


@dataclass(frozen=True, eq=False)
class LoadRequest:
    """Options with which the user loads a robot; see `load_robot`.

    Attributes:
        feet: {foot: (frame in the URDF, frame in the MJCF)}; None to detect feet.
        fixed_base: True to fix the base in the world.
        name: Name of the robot; None: name in the MJCF.
        joints: {joint in the URDF: joint in the MJCF}, for joints that are not matched by name.
        keyframe: Keyframe of the MJCF to start from. None: `find_start_pose` chooses the keyframe,
            with ``home`` tried before all others.
        as_is: True to add no servos, motors and contact exclusions, and to keep the contacts of all
            shapes. Soles are not replaced by balls.
        visuals: True to convert the visual meshes. False: visual geoms are usually omitted.
    """

    feet: Mapping[str, tuple[str, str]] | None = None
    fixed_base: bool = False
    name: str | None = None
    joints: Mapping[str, str] | None = None
    keyframe: str | None = None
    as_is: bool = False
    visuals: bool = True


_MIN_PARTIAL_FREE_JOINTS = 4
"""Lower bound of the number of joints with which a child body of the world counts as a free base,
although it has no free joint. Unless requested, the preparation does not fix such a base. Derived:
three slides and a ball joint move a body freely.
"""


@dataclass(frozen=True)
class PassRun(Result):
    """A pass that was run.

    Attributes:
        name: Name of the pass.
        does: Purpose of the pass.
        done: Notes on changes and findings.
    """

    name: str
    does: Term
    done: tuple[Diagnostic, ...]


@dataclass(frozen=True, eq=False)
class Draft:
    """Robot at an intermediate stage of the preparation.

    Attributes:
        urdf: URDF as read.
        mjcf: MJCF as read.
        request: Options of the user.
        spec: Spec of the MJCF, with changes.
        keyframes: {keyframe: {joint: position [rad, m]}} of the keyframes that may become the start
            pose, in the order of the trials.
        found_match: Matched joints of both files; None before the pass ``match``, and in the
            deferred passes.
        floating: Whether the matched robot has a free base; False before the pass ``match``.
        description: Both files with matched names; None before the pass ``match``.
        built: Robot; None before the passes ``build`` and ``build-with-fixed-base``.
        footless: Robot without feet; None before the pass ``find-feet``, if no feet were found, and
            in the deferred passes.
        feet: Feet; empty before the pass ``find-feet``.
        refused: Reason why no robot with a free base can be made; None if there is none. Only the
            pass ``fix-base`` is then applied.
        runs: Passes that have been run so far.
    """

    urdf: UrdfFile
    mjcf: MjcfFile
    request: LoadRequest
    spec: mujoco.MjSpec
    keyframes: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    found_match: Match | None = None
    floating: bool = False
    description: Description | None = None
    built: Robot | None = None
    footless: Robot | None = None
    feet: tuple[Foot, ...] = ()
    refused: ModelError | None = None
    runs: tuple[PassRun, ...] = ()

    @property
    def may_fix_base(self) -> bool:
        """Whether the preparation may fix the base although the user did not request this.

        False, for example, if the MJCF has a free joint.
        """
        if self.request.fixed_base or has_free_joint(self.mjcf.spec):
            return False
        if self.urdf_is_free and self.request.feet is not None and not self.request.feet:
            return False
        tops = (len(list(body.joints)) for body in self.mjcf.spec.worldbody.bodies)
        return max(tops, default=0) < _MIN_PARTIAL_FREE_JOINTS

    @property
    def urdf_is_free(self) -> bool:
        """Whether the URDF has a free base: a floating joint as the only joint of a massless root.

        For example, a URDF of a ``pin.Model`` with a free flyer.
        """
        return states_free_base(self.urdf)

    @property
    def match(self) -> Match:
        """Matched joints of URDF and MJCF; available after the pass ``match``."""
        assert self.found_match is not None
        return self.found_match

    @property
    def matched_description(self) -> Description:
        """URDF and MJCF with matched names; available after the pass ``match``."""
        assert self.description is not None
        return self.description

    @property
    def robot(self) -> Robot:
        """Robot of this draft, as built by the preparation passes that have run.

        Available after the pass ``build`` or ``build-with-fixed-base``.
        """
        assert self.built is not None
        return self.built


PassOutput = tuple[Draft, Iterable[Diagnostic]]
"""Result of a pass: the new draft (the robot in preparation), and the notes of the pass."""


@dataclass(frozen=True)
class Pass:
    """Step of the preparation, with the condition under which it is applied.

    Attributes:
        name: Name of the pass.
        does: Purpose of the pass.
        apply: Function that applies the pass to a draft (the robot in preparation). The result is
            the new draft with the notes of the pass.
        condition: Function that returns True if a draft needs the pass.
        after_refusal: True if the pass is also applied after an earlier pass found that no robot
            with a free base can be made (`Draft.refused`).
        deferred: True if the pass may be postponed until its result is first needed, for example by
            a simulation.
    """

    name: str
    does: Term
    apply: Callable[[Draft], PassOutput]
    condition: Callable[[Draft], bool]
    after_refusal: bool = False
    deferred: bool = False

    def applies(self, draft: Draft) -> bool:
        """Return True if this pass must be applied to a draft (the robot in preparation)."""
        return (draft.refused is None or self.after_refusal) and self.condition(draft)


_registered_passes: list[Pass] = []
"""Preparation passes that `_register_pass` has registered so far, in the order of application."""


def _register_pass(
    does: Term,
    condition: Callable[[Draft], bool],
    *,
    after_refusal: bool = False,
    deferred: bool = False,
) -> Callable[[Callable[[Draft], PassOutput]], Callable[[Draft], PassOutput]]:
    """Create a decorator that appends a function to the preparation passes.

    The pass is named after the function. The arguments are the fields of `Pass`.
    """

    def register(apply: Callable[[Draft], PassOutput]) -> Callable[[Draft], PassOutput]:
        """Register a function as the next pass of the preparation, and return the function."""
        name = apply.__name__.strip("_").replace("_", "-")
        _registered_passes.append(Pass(name, does, apply, condition, after_refusal, deferred))
        return apply

    return register


def _applies_always(_draft: Draft) -> bool:
    """Return True for every draft (the robot in preparation)."""
    return True


def _has_free_base_request(draft: Draft) -> bool:
    """Return True unless the user requested a fixed base; callable before the pass ``match``."""
    return not draft.request.fixed_base


def _has_free_base(draft: Draft) -> bool:
    """Return True if the robot's base is free; False before the pass ``match``."""
    return not draft.request.fixed_base and draft.floating


def _has_fixed_base(draft: Draft) -> bool:
    """Return True if the robot's base is fixed; callable only after the pass ``match``."""
    return not _has_free_base(draft)


def _stands_on_feet(draft: Draft) -> bool:
    """Return True if the base is free and the robot has feet."""
    return _has_free_base(draft) and bool(draft.robot.contact_points)


def _may_be_altered(draft: Draft) -> bool:
    """Return True if contacts and actuators of a robot on feet may be changed (no ``as_is``)."""
    return _stands_on_feet(draft) and not draft.request.as_is


def _may_get_servos(draft: Draft) -> bool:
    """Return True if servos may be added to the robot; False with ``as_is``, for example."""
    if draft.request.as_is:
        return False
    return _stands_on_feet(draft) or _has_fixed_base(draft) or draft.urdf_is_free


def _rebuild_robot(draft: Draft, description: Description | None) -> Draft:
    """Return a draft whose robot is built from ``description``; the same draft for None."""
    if description is None:
        return draft
    return replace(draft, built=build_robot(description, fixed_base=draft.request.fixed_base))


def _find_requested_feet(
    robot: Robot, frames: Mapping[str, tuple[str, str]] | None, poses: Sequence[Array]
) -> tuple[Foot, ...]:
    """Find the feet that the user names, or else the feet at the ends of limbs.

    ``frames`` is {foot: (link in the URDF, element in the MJCF)}. ``poses`` are joint positions in
    which feet are searched, (nu,) each [rad, m].
    """
    if frames is None:
        return find_feet(robot, poses) if limb_ends(robot.mj_model) else ()
    return tuple(find_named_foot(robot, foot, places, poses[0]) for foot, places in frames.items())


def _must_fix_base(draft: Draft) -> bool:
    """Return True if the robot must be prepared again (`_fix_base`), because it cannot stand.

    If the user named feet, the base may stay free: commands then report why the robot does not
    stand.
    """
    if not draft.may_fix_base or draft.refused:
        return draft.may_fix_base
    if draft.request.feet:
        return False
    return draft.robot.floating and start.solve_nominal_stand(draft.robot) is None


@_register_pass(Term("names bodies and joints that have none"), _applies_always)
def _name_elements(draft: Draft) -> PassOutput:
    """Name bodies and joints, select keyframes, and usually discard visual geoms."""
    spec = draft.spec.copy()
    name_elements(spec, set())
    if draft.request.feet is None:  # a named foot may be a visual geom
        discard_visuals(spec)
    known = start.choose_keyframes(
        draft.mjcf, start.list_keyframes(spec, draft.mjcf.path), draft.request.keyframe
    )
    return replace(draft, spec=spec, keyframes=known), ()


@_register_pass(Term("frees the base of a robot with limbs"), _has_free_base_request)
def _free_base(draft: Draft) -> PassOutput:
    """Add a free joint to a fixed base, for example of a robot with two limbs (`free_base`)."""
    spec, messages = free_base(draft.urdf, draft.spec, draft.mjcf.path)
    return replace(draft, spec=spec), messages


@_register_pass(Term("lifts the base's frame off the ground"), _has_free_base_request)
def _place_base_frame(draft: Draft) -> PassOutput:
    """Raise the MJCF's base frame to the base's CoM height, if needed (`place_base_frame`)."""
    file = draft.mjcf
    messages = place_base_frame(
        draft.spec, file.model, file.path, insert_visuals=file.deferred_visuals
    )
    return draft, messages


@_register_pass(Term("finds whose joint is whose"), _applies_always)
def _match(draft: Draft) -> PassOutput:
    """Match the joints of URDF and MJCF (`match_models`), with notes on differences and guesses."""
    files = draft.urdf, replace(draft.mjcf, spec=draft.spec)
    found = match_models(*files, names=draft.request.joints, complete=True)
    name = draft.request.name or draft.spec.modelname
    description = replace(found.robot.description, name=name)
    messages = (*found.notes, *notes.report_joint_matching(found))
    floating = found.robot.floating
    changed = replace(draft, found_match=found, floating=floating, description=description)
    return changed, messages


@_register_pass(Term("couples joints that follow others"), _applies_always)
def _couple_mimics(draft: Draft) -> PassOutput:
    """Add missing ``<mimic>`` couplings of the URDF to the MJCF (`couple_mimics`)."""
    description, messages = couple_mimics(draft.match, draft.matched_description)
    return replace(draft, description=description), messages


@_register_pass(Term("builds the robot on its fixed base"), _has_fixed_base)
def _build_with_fixed_base(draft: Draft) -> PassOutput:
    """Build the robot with a fixed base; the feet that the user named become contact points."""
    described = start.with_keyframes(draft.matched_description, draft.keyframes)
    described = replace(described, contact_points=draft.request.feet or {})
    robot = build_robot(described, fixed_base=draft.request.fixed_base)
    return replace(draft, description=described, built=robot), ()


@_register_pass(Term("adds a level ground, or makes it level"), _has_free_base)
def _level_ground(draft: Draft) -> PassOutput:
    """Make the ground of the MJCF a level plane at z = 0; add a missing floor (`level_ground`).

    Solver options that reduce the creep of contacts may be added (`STIFF_FRICTION_OPTIONS`).
    """
    leveled = draft.matched_description.mjcf.copy()  # passes before ``build`` modify it in place
    messages = level_ground(leveled)
    floors = tuple(Floor(note) for note in messages if note.code == "ground-added")
    described = replace(
        draft.matched_description, mjcf=leveled, added=(*draft.matched_description.added, *floors)
    )
    # The file of a robot without ground and free joint does not specify the friction of a ground.
    adds_ground = floors and not has_free_joint(draft.mjcf.spec)
    options = (attributes.keys() for attributes, _ in draft.mjcf.elements("option"))
    if draft.mjcf.of_urdf or (
        adds_ground and not any(STIFF_FRICTION_OPTIONS.keys() & stated for stated in options)
    ):
        grip = list_urdf_ground_additions()[1]
        described, messages = described.with_additions(grip), [*messages, grip.reason]
    return replace(draft, description=described), messages


@_register_pass(Term("takes dry friction off the free joint"), _has_free_base)
def _remove_free_joint_friction(draft: Draft) -> PassOutput:
    """Remove the dry friction of free joints."""
    return draft, remove_free_joint_friction(draft.matched_description.mjcf)


@_register_pass(Term("builds the robot"), _has_free_base)
def _build(draft: Draft) -> PassOutput:
    """Build the robot with a free base; raise an error for joints with several motors."""
    check_motors(draft.mjcf.model, draft.mjcf.path)
    return replace(draft, built=build_robot(draft.matched_description)), ()


@_register_pass(Term("limits joints of loops that have none"), _has_free_base)
def _limit_continuous_joints(draft: Draft) -> PassOutput:
    """Add limits to continuous joints of robots with closed loops or couplings, for PlaCo."""
    return _rebuild_robot(draft, limit_continuous_joints(draft.robot)), ()


@_register_pass(Term("takes the narrower of both files' joint limits"), _applies_always)
def _narrow_limits(draft: Draft) -> PassOutput:
    """Narrow the joint limits of the URDF to the overlap with the limits of the MJCF; add notes."""
    description, messages = narrow_limits(draft.robot)
    return _rebuild_robot(draft, description), messages


@_register_pass(Term("refuses joints that move no mass"), _applies_always)
def _check_masses(draft: Draft) -> PassOutput:
    """Raise an error if the inertia at a joint, with rotor inertia, is zero or negative."""
    check_masses(draft.robot, draft.urdf)
    return draft, ()


@_register_pass(Term("finds the feet, and their contact points"), _has_free_base)
def _find_feet(draft: Draft) -> PassOutput:
    """Find the feet and their contact points, and build the robot with these contact points.

    Spheres that replace ellipsoids are fitted again in the nominal stand.
    """
    footless, names = draft.robot, draft.request.feet
    poses = [start.clip_to_limits(footless, pose) for pose in (*draft.keyframes.values(), None)]
    try:
        feet = _find_requested_feet(footless, names, poses)
        if names is None and feet:
            feet = _add_short_legs(draft, feet, poses)
    except ModelError as error:
        problem = _explain_missing_feet(draft.mjcf.notes)
        if problem is not None:
            raise ModelError(draft.mjcf.path, problem) from error
        if error.cause.code in ("no-feet-found", "foot-touches-nothing"):
            refusal = _explain_contact_bits(draft.mjcf)
            if refusal is not None:
                raise refusal from error
        raise
    if not feet:
        return draft, ()
    messages = [notes.report_feet(footless, feet, given=names is not None)]
    balls = {} if draft.request.as_is else notes.report_balls(footless, feet)
    messages += dict.fromkeys(balls.values())
    if has_ellipsoids(footless, feet):
        feet = _fit_ellipsoids_again(draft, feet, balls)
    robot = build_robot(add_contact_frames(footless, feet, balls))
    return replace(draft, built=robot, footless=footless, feet=tuple(feet)), messages


def _explain_contact_bits(mjcf: MjcfFile) -> ModelError | None:
    """Return the error that contype and conaffinity keep all geoms of a limb end from the floor.

    Its source is the line of the first such geom. None if the lowest limb end at ``qpos0`` is no
    such limb end: hands may have visual geoms only. Without a floor, the bits of the floor are
    MuJoCo's default, 1. A URDF has no such bits: its limb ends then have visual shapes only.
    """
    model = mjcf.model
    floor, bits = ground_geom(model), (model.geom_contype, model.geom_conaffinity)
    floor_bits = (1, 1) if floor is None else (int(bits[0][floor]), int(bits[1][floor]))
    touching = (bits[0] & floor_bits[1]) | (bits[1] & floor_bits[0])
    bodies = model.body_weldid[model.geom_bodyid]
    ends = np.setdiff1d(limb_ends(model), bodies[touching != 0])
    geoms = np.flatnonzero(np.isin(bodies, ends)).tolist()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    lowest = min(limb_ends(model), key=lambda body: data.xipos[body, 2], default=0)
    if lowest not in bodies[geoms]:
        return None
    if mjcf.of_urdf:
        links = [model.body(body).name for body in np.unique(bodies[geoms])]
        return ModelError(mjcf.path, diagnose("no-feet-as-shapes-are-visual", links=links))
    names = [model.geom(geom).name or model.body(model.geom_bodyid[geom]).name for geom in geoms]
    problem = diagnose(
        "geoms-miss-the-floor",
        geoms=list(dict.fromkeys(names)),
        count=len(geoms),
        contype=int(bits[0][geoms[0]]),
        conaffinity=int(bits[1][geoms[0]]),
        floor_contype=floor_bits[0],
        floor_conaffinity=floor_bits[1],
    )
    return make_file_error(place_of_geom(mjcf, geoms[0], "touches"), problem)


def _explain_missing_feet(messages: Sequence[Diagnostic]) -> Diagnostic | None:
    """Return the message that no feet are found because mesh files are missing or refused.

    Missing files, which a user can add, have precedence over files that MuJoCo refuses. None if
    ``messages`` report no such file.
    """
    losses = [
        note
        for note in messages
        if note.code in ("files-missing", "meshes-left", "visual-meshes-left")
        and note.values.get("kind", "mesh") == "mesh"
    ]
    reasons = [note.values.get("why") for note in losses]
    is_refused = [
        isinstance(why, Diagnostic) and why.code != "no-such-mesh-file" for why in reasons
    ]
    missing = [note for note, refused in zip(losses, is_refused, strict=True) if not refused]
    if missing:
        package = next((name for note in missing if (name := note.values.get("package"))), None)
        return diagnose(
            "no-feet-as-files-are-missing", files=_list_file_names(missing), package=package
        )
    if losses:
        return diagnose(
            "no-feet-as-files-are-refused", files=_list_file_names(losses), why=reasons[0]
        )
    return None


def _list_file_names(losses: Sequence[Diagnostic]) -> tuple[str, ...]:
    """Return the file names, without folders, of notes on mesh files that were left out."""
    listed = [note.values["files"] for note in losses]
    return tuple(
        str(name).replace("\\", "/").rpartition("/")[2]
        for names in listed
        if isinstance(names, tuple)
        for name in names
    )


def _fit_ellipsoids_again(
    draft: Draft, feet: tuple[Foot, ...], balls: Mapping[str, Diagnostic]
) -> tuple[Foot, ...]:
    """Fit the spheres that replace ellipsoids in the nominal stand, until they no longer move.

    The nominal stand depends on the spheres. If a displacement is more than half of the previous
    one, the next fit uses the mean of the last two joint positions, since such iterations oscillate
    about the solution. If no nominal stand is found, the joint positions of the last fit are kept.

    Raises:
        ModelError: If the spheres still move after `_MAX_ELLIPSOID_FITS` fits.
    """
    fitted: Array | None = None
    largest = math.inf
    for _ in range(_MAX_ELLIPSOID_FITS):
        robot = build_robot(add_contact_frames(draft.robot, feet, balls))
        joints = _solve_nominal_joints(draft, robot)
        if joints is None:
            return feet
        new_feet = _find_requested_feet(draft.robot, draft.request.feet, [joints])
        displacement = measure_point_displacement(feet, new_feet)
        if displacement <= CONTACT_POINT_TOLERANCE:
            return feet
        if fitted is not None and displacement > largest / 2:
            joints = (fitted + joints) / 2
            new_feet = _find_requested_feet(draft.robot, draft.request.feet, [joints])
        feet, fitted, largest = new_feet, joints, displacement
    names = tuple(foot.name for foot in feet if has_ellipsoids(draft.robot, [foot]))
    raise ModelError(
        draft.mjcf.path,
        diagnose(
            "ellipsoid-feet-do-not-converge",
            feet=names,
            displacement=Quantity(largest, "m"),
            fits=_MAX_ELLIPSOID_FITS,
        ),
    )


def _add_short_legs(
    draft: Draft, feet: tuple[Foot, ...], poses: Sequence[Array]
) -> tuple[Foot, ...]:
    """Add the feet of shorter legs, such as forelegs, if the feet have too few contact points.

    The robot must then have a nominal stand.
    """
    if sum(len(foot.points) for foot in feet) >= _MIN_POLYGON_POINTS:
        return feet
    more = find_feet(draft.robot, poses, MAX_SHORT_LEG_HEIGHT_FRACTION)
    return more if len(more) > len(feet) and _stands_on(draft, more) else feet


_MIN_POLYGON_POINTS = 3
"""Number of contact points from which feet can have a support polygon."""


def _stands_on(draft: Draft, feet: tuple[Foot, ...]) -> bool:
    """Return True if a robot without feet has a nominal stand on ``feet``.

    Contacts of shapes beside the feet are disabled: a tilted foot would touch with them.
    """
    sunk = start.compute_resting_depths(draft.mjcf.model)
    try:
        robot = build_robot(add_contact_frames(draft.robot, feet))
        robot, _ = find_start_pose(robot, draft.keyframes, sunk)
        robot, _ = touching.disable_shapes_beside_feet(robot)
    except PupperAnalysisError:
        return False
    return start.solve_nominal_stand(robot) is not None


_MAX_ELLIPSOID_FITS = 40
"""Upper bound of the number of repeated fits of spheres to ellipsoids. Measured on a quadruped with
tilted ellipsoids of seven sizes, half axes 30 to 100 mm: all converge, after at most 17 fits."""


def _solve_nominal_joints(draft: Draft, robot: Robot) -> Array | None:
    """Return joint positions (nu,) [rad, m] of the nominal stand; None if no stand is found."""
    sunk = start.compute_resting_depths(draft.mjcf.model)
    stand = start.solve_nominal_stand(find_start_pose(robot, draft.keyframes, sunk)[0])
    return None if stand is None else stand.qpos[-robot.nu :]


@_register_pass(Term("adds motors to joints of loops that have none"), _may_be_altered)
def _add_loop_motors(draft: Draft) -> PassOutput:
    """Add missing torque motors to a robot with closed loops or couplings (`add_loop_motors`).

    Joints with motors come first in the actuator order, which must not change when servos are
    added.
    """
    return replace(draft, built=drives.add_loop_motors(draft.robot)), ()


def _make_rest_depth(draft: Draft) -> Callable[[str], float | None]:
    """Create a function that returns how deep the unmodified file rests in the ground [m].

    The argument of the function is the name of a keyframe. The result is None if the file falls,
    for example.
    """
    return partial(start.rest_depth_from_keyframe, draft.mjcf.model)


@_register_pass(Term("finds a pose in which it stands"), _stands_on_feet)
def _find_start_pose(draft: Draft) -> PassOutput:
    """Select the start pose of the robot: a keyframe, or a pose that is computed."""
    sunk = start.compute_resting_depths(draft.mjcf.model)
    robot, pose = find_start_pose(draft.robot, draft.keyframes, sunk, _make_rest_depth(draft))
    return replace(draft, built=robot), (*notes.report_planar_legs(robot), *pose)


@_register_pass(Term("takes hulls that carry most of the load as contact points"), _may_be_altered)
def _use_hulls_as_feet(draft: Draft) -> PassOutput:
    """Move the contact points of soft feet to another shape that carries most of the load.

    An example is the hull of the shank (`touching.find_carrying_hulls`).
    """
    if draft.footless is None or draft.robot.closure is not None:
        return draft, ()
    hulls = touching.find_carrying_hulls(draft.footless, draft.robot, draft.feet)
    if hulls is None:
        return draft, ()
    feet, message = hulls
    balls = notes.report_balls(draft.footless, feet)
    own = draft.robot.description
    kept = {foot.name for foot in draft.feet if foot in feet}
    # A new ball may have the name of an earlier ball; this ball is not in the footless model.
    shapes = {added.name: added.like for added in own.added if isinstance(added, Ball)}
    soft = tuple(
        str(shapes.get(geom, geom))
        for name, (geom, _) in own.foot_geoms.items()
        if name not in kept
    )
    described = add_contact_frames(draft.footless, feet, balls).with_additions(
        DisabledContacts(message, soft)
    )
    sunk = start.compute_resting_depths(draft.mjcf.model)
    robot, pose = find_start_pose(
        build_robot(described), draft.keyframes, sunk, _make_rest_depth(draft)
    )
    if start.solve_nominal_stand(robot) is None:
        return draft, ()
    return replace(draft, built=robot, feet=feet), (message, *dict.fromkeys(balls.values()), *pose)


@_register_pass(Term("lets feet alone touch the ground"), _may_be_altered)
def _disable_shapes_beside_feet(draft: Draft) -> PassOutput:
    """Disable contacts of shapes near the ground that are on foot bodies but are not foot geoms."""
    robot, messages = touching.disable_shapes_beside_feet(draft.robot)
    return replace(draft, built=robot), messages


@_register_pass(Term("excludes contacts of parts that overlap"), _may_get_servos)
def _exclude_overlaps(draft: Draft) -> PassOutput:
    """Exclude contacts of bodies that overlap in the start pose."""
    robot, messages = touching.exclude_overlaps(draft.robot)
    return replace(draft, built=robot), messages


@_register_pass(Term("chooses a solver that solves the equations of motion"), _may_be_altered)
def _choose_solver(draft: Draft) -> PassOutput:
    """Set dense matrices if MuJoCo's solver is accurate only with dense matrices."""
    robot, messages = choose_exact_solver(draft.robot)
    return replace(draft, built=robot), messages


@_register_pass(
    Term("tells which joints and motors are not commanded"),
    lambda draft: _stands_on_feet(draft) or _has_fixed_base(draft),
)
def _report_uncommanded_joints(draft: Draft) -> PassOutput:
    """Report coupled and play joints and uncommanded actuators; return the unchanged draft.

    An uncommanded actuator does not act on a single hinge or slide.
    """
    return draft, (
        *notes.report_coupled_joints(draft.robot),
        *notes.report_play_joints(draft.robot),
        *notes.report_uncommanded_actuators(draft.robot),
    )


def _describe_missing_stand(draft: Draft) -> Diagnostic:
    """Create the message that a robot has no nominal stand (default `StandTask`)."""
    names = tuple(foot.name for foot in draft.feet)
    count = sum(len(foot.points) for foot in draft.feet)
    if len(names) >= _MIN_STANDING_FEET or _are_soles_of_legs(draft):
        try:
            stand_statics(draft.robot, solve_stand(draft.robot, explain=False))
        except PupperAnalysisError as error:
            return diagnose("no-stand-on-feet", feet=names, why=error.diagnostic)
    elif 0 < count < _MIN_POLYGON_POINTS:
        return diagnose("stands-on-too-few-points", feet=names, count=count)
    return diagnose("stands-on-no-feet")


def _are_soles_of_legs(draft: Draft) -> bool:
    """Return True if found feet with an area are at the ends of separate legs, as of a biped.

    The fingers of a gripper share the joints of the arm, or have a single joint each.
    """
    if len(draft.feet) < 2 or sum(len(foot.points) for foot in draft.feet) < _MIN_POLYGON_POINTS:
        return False
    bodies = {foot.body for foot in draft.feet}
    legs = [limb.bodies for limb in list_limbs(draft.robot) if limb.bodies[-1] in bodies]
    shared = len({body for leg in legs for body in leg}) < sum(map(len, legs))
    joints = [count_joints_to_base(draft.robot, body) for body in bodies]
    return len(legs) == len(draft.feet) and not shared and min(joints) >= _MIN_LEG_JOINTS


_MIN_LEG_JOINTS = 2
"""Lower bound of the number of joints of a leg with a sole. A finger of a gripper has fewer.
Chosen, not tuned."""

_MIN_STANDING_FEET = 3
"""Lower bound of the number of found feet with which a note reports why the robot has no nominal
stand. Fewer feet may be the fingers of a gripper. Chosen, not tuned."""


@_register_pass(Term("fixes the base where it does not stand"), _must_fix_base, after_refusal=True)
def _fix_base(draft: Draft) -> PassOutput:
    """Prepare the robot again with the base fixed, because the robot does not stand.

    If the URDF has a free base, the base stays free, and the robot gets no feet.
    """
    refused, free = draft.refused, draft.urdf_is_free
    request = replace(draft.request, feet={}) if free else replace(draft.request, fixed_base=True)
    why = _describe_missing_stand(draft) if refused is None else refused.cause
    try:
        fixed = _run_passes(
            _IMMEDIATE_PASSES, Draft(draft.urdf, draft.mjcf, request, draft.mjcf.spec)
        )
    except ModelError:
        if refused is None:
            raise
        raise refused from None
    if free:
        return fixed, (diagnose("base-free-without-feet", why=why),)
    if refused is None:
        why = (*report_sideways_limbs(fixed.robot), why)[0]
    return fixed, (diagnose("base-kept-in-the-world", why=why),)


def _lacks_servos(robot: Robot) -> bool:
    """Return True if a joint that is not dependent (loops, couplings) has no position servo."""
    dependent = {robot.joint_names[joint] for joint in drives.list_dependent_joints(robot)}
    return not set(robot.joint_names) <= list_position_servos(robot).keys() | dependent


@_register_pass(Term("adds position servos that bring it to rest"), _may_get_servos, deferred=True)
def _add_servos(draft: Draft) -> PassOutput:
    """Add missing position servos, except at dependent joints (of closed loops or couplings)."""
    robot = draft.robot
    if _lacks_servos(robot):
        add = drives.add_suggested_servos if robot.floating else drives.add_fixed_base_servos
        robot, servo_notes = add(robot, draft.mjcf)
        return replace(draft, built=robot), servo_notes
    return draft, ()


@_register_pass(
    Term("replaces a found start pose by the stand at rest"), _may_be_altered, deferred=True
)
def _store_rest_pose(draft: Draft) -> PassOutput:
    """Replace a searched start pose by the nominal stand on soft ground, if it can be solved."""
    messages = (note for run in draft.runs for note in run.done)
    reason = next((note for note in messages if note.code == "start-pose-found"), None)
    stand = None if reason is None else _solve_rest_pose(draft.robot)
    if reason is None or stand is None:
        return draft, ()
    with contextlib.suppress(PupperAnalysisError):
        keyframe = make_start_keyframe(draft.robot, stand, reason)
        draft = replace(draft, built=with_additions(draft.robot, keyframe))
    return draft, ()


def _solve_rest_pose(robot: Robot) -> Stand | None:
    """Solve the nominal stand (default `StandTask`) on MuJoCo's soft ground; None if not found."""
    with contextlib.suppress(PupperAnalysisError):
        return solve_stand_on_soft_ground(robot, explain=False)
    return None


@release_borrowed_objects()
def _pose_without_servos(draft: Draft) -> Robot:
    """Return the robot before servos are added, with its start pose and detected passive joints."""
    robot = _add_notes(draft.robot, draft.runs)
    if _may_get_servos(draft):
        robot = drives.mark_passive_joints(robot, draft.mjcf)
    found = any(note.code == "start-pose-found" for run in draft.runs for note in run.done)
    stand = _solve_rest_pose(robot) if found and _may_be_altered(draft) else None
    if stand is None:
        return robot
    return replace(robot, home=round_start_configuration(robot, stand))


@_register_pass(Term("converts the visual meshes"), _applies_always, deferred=True)
def _convert_visual_meshes(draft: Draft) -> PassOutput:
    """Convert visual meshes; build the robot again with visual geoms if they were removed."""
    if not draft.request.visuals:
        return draft, ()
    robot, insert_visuals = draft.robot, draft.mjcf.deferred_visuals
    spec = robot.description.mjcf.copy()
    is_changed = copy_visual_option(spec, draft.mjcf.spec)
    if not is_changed and insert_visuals is None:
        return draft, ()
    messages = [] if insert_visuals is None else insert_visuals(spec)
    whole = replace(robot.description, mjcf=spec)
    built = build_robot(whole, fixed_base=draft.request.fixed_base)
    return replace(draft, built=copy_metadata(built, robot)), messages


def list_urdf_ground_additions() -> tuple[Addition, ...]:
    """Create the additions to a robot that has only a URDF: a floor, and solver options.

    The options (`STIFF_FRICTION_OPTIONS`) reduce creep: the slow slip of loaded contacts that
    MuJoCo's friction permits.
    """
    held = Options(diagnose("contacts-made-to-hold"), STIFF_FRICTION_OPTIONS)
    return Floor(diagnose("ground-added")), held


_MATCH, _FIX_BASE, _CONVERT_MESHES = "match", "fix-base", "convert-visual-meshes"
"""Names of passes, to order their notes. `_complete_preparation` puts the pass that fixed the
base last. `_add_notes` puts the notes about visual meshes after the notes about the matching of
URDF and MJCF."""

PREPARATION_PASSES = tuple(_registered_passes)
"""All passes of the preparation of a robot, in the order of application."""

_IMMEDIATE_PASSES = tuple(step for step in PREPARATION_PASSES if not step.deferred)
"""Passes that are applied when a robot is loaded: all except servos, rest pose and visual
meshes."""

_DEFERRED_PASSES = tuple(step for step in PREPARATION_PASSES if step.deferred)
"""Passes that may be postponed until their results are first needed, for example by a simulation:
servos, rest pose and visual meshes."""


def _run_passes(passes: Iterable[Pass], draft: Draft) -> Draft:
    """Apply the needed passes in order to a draft (the robot in preparation); return the new draft.

    After a `ModelError`, the robot may be prepared again with a fixed base (``fix-base``).
    """
    for step in passes:
        if step.applies(draft):
            try:
                draft, done = step.apply(draft)
            except ModelError as error:
                error = explain_model_fault(error, draft.urdf, draft.mjcf)
                if step.deferred or draft.refused or not draft.may_fix_base:
                    raise error from error.__cause__
                draft = replace(draft, refused=error)
            else:
                run = PassRun(step.name, step.does, tuple(done))
                draft = replace(draft, runs=(*draft.runs, run))
    return draft


Feet = Sequence[str] | Mapping[str, str | tuple[str, str]]
"""Feet of a robot, as named by the user. A list of names: each name is the name of the foot and of
the frame in both files. A mapping: {foot: frame in both files}, or {foot: (link in the URDF,
element in the MJCF)}."""


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
    visuals: bool = True,
    finish: Callable[[Robot], Robot] | None = None,
) -> Robot:
    """Prepare a robot from two files as read, with slow steps postponed if possible.

    The slow steps are servos, rest pose (the start pose with the feet in soft ground) and visual
    meshes. They are usually postponed until their results are first needed, for example by a
    simulation (`defer_stages`).

    Args:
        urdf: URDF as read.
        mjcf: MJCF as read.
        feet: Feet; None to detect feet.
        fixed_base: True to fix the base in the world.
        name: Name of the robot; None: name in the MJCF.
        joints: {joint in the URDF: joint in the MJCF}, for joints that are not matched by name.
        keyframe: Keyframe of the MJCF to start from; None to choose a keyframe.
        as_is: True to add no servos, and to keep the contacts of all shapes (`LoadRequest`).
        visuals: True to convert the visual meshes.
        finish: Function that is applied to the robot after all steps, and to the robot without
            servos that `Robot.before_servos` returns. None: no function.

    Raises:
        ConfigurationError: If the frame of a foot is neither a name nor a pair of names, for
            example.
        ModelError: If no robot can be made of the files.
        UnknownNameError: If a foot, joint or keyframe does not exist.
    """
    frames = None if feet is None else parse_feet(feet)
    request = LoadRequest(frames, fixed_base, name, joints, keyframe, as_is, visuals)
    draft = _begin_preparation(urdf, mjcf, request)

    def complete_preparation(*, visuals: bool = visuals) -> Robot:
        """Run postponed steps (servos, rest pose, meshes if ``visuals``); return the robot."""
        robot, _ = _complete_preparation(replace(draft, request=replace(request, visuals=visuals)))
        return robot if finish is None else finish(robot)

    def pose_without_servos() -> Robot:
        """Return the robot with its start pose, but without added servos and visual meshes."""
        robot = _pose_without_servos(draft)
        return robot if finish is None else finish(robot)

    if _keeps_joint_order(draft):
        return defer_stages(draft.robot, complete_preparation, pose_without_servos)
    if visuals and draft.mjcf.deferred_visuals is not None and not draft.robot.floating:
        robot = complete_preparation(visuals=False)
        return defer_stages(robot, complete_preparation, lambda: robot)
    return complete_preparation()


def _keeps_joint_order(draft: Draft) -> bool:
    """Return True if added servos do not change the actuator order of a robot's joints."""
    robot = draft.robot
    if not _may_get_servos(draft) or not _lacks_servos(robot):
        return True
    driven = robot.mj_convention.actuator_index >= 0
    is_uniform = bool(driven.all()) or not bool(driven.any())
    if robot.closure is None and is_uniform and not list_position_servos(robot):
        return True
    with_servos, _ = drives.add_fixed_base_servos(robot, draft.mjcf)
    return with_servos.joint_names == robot.joint_names


def prepare_robot(
    urdf: UrdfFile, mjcf: MjcfFile, request: LoadRequest
) -> tuple[Robot, list[PassRun]]:
    """Prepare a robot from two files as read; run the preparation passes immediately.

    Returns:
        Robot, whose notes include the notes of the passes, and the passes that were run.

    Raises:
        ModelError: If no robot can be made of the files.
        UnknownNameError: If a foot, joint or keyframe does not exist.
    """
    return _complete_preparation(_begin_preparation(urdf, mjcf, request))


@release_borrowed_objects()
def _begin_preparation(urdf: UrdfFile, mjcf: MjcfFile, request: LoadRequest) -> Draft:
    """Run the preparation passes of loading: all except servos, rest pose and visual meshes.

    The returned draft lacks ``found_match`` and ``footless``, whose compiled models may be large.
    """
    check_simulable(mjcf)
    check_joint_limits(urdf)
    draft = _run_passes(_IMMEDIATE_PASSES, Draft(urdf, mjcf, request, mjcf.spec))
    return replace(draft, found_match=None, footless=None)


@silence_mujoco()
@release_borrowed_objects()
def _complete_preparation(draft: Draft) -> tuple[Robot, list[PassRun]]:
    """Run the deferred preparation passes; return the robot with notes, and the passes run."""
    draft = _run_passes(_DEFERRED_PASSES, draft)
    # The reason for a fixed base is the last note of the passes.
    runs = sorted(draft.runs, key=lambda run: run.name == _FIX_BASE)
    return _add_notes(draft.robot, runs), runs


def _add_notes(robot: Robot, runs: Sequence[PassRun]) -> Robot:
    """Return a robot with the notes of preparation passes, followed by the robot's own notes."""
    notes_by_pass = {run.name: run.done for run in runs}
    # Meshes that were left out are reported with the other parts of the files that were left out.
    left_meshes = notes_by_pass.pop(_CONVERT_MESHES, ())
    notes_by_pass[_MATCH] = (*notes_by_pass[_MATCH], *left_meshes)
    messages = (note for done in notes_by_pass.values() for note in done)
    notes = (*messages, *robot.notes, *report_unstated_efforts(robot))
    return replace(robot, notes=tuple(dict.fromkeys(notes)))


def parse_feet(feet: Feet) -> dict[str, tuple[str, str]]:
    """Convert the feet that a user names to {foot: (frame in the URDF, frame in the MJCF)}.

    Args:
        feet: Names of frames, {foot: frame}, or {foot: (link in the URDF, element in the MJCF)}. A
            single frame name is used for both files.

    Raises:
        ConfigurationError: If a frame is neither a name nor a pair of names, or a foot is named
            twice.
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
