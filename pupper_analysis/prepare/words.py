"""What was made up for on loading, in words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import mujoco

from pupper_analysis.checks.matching import Match
from pupper_analysis.models.joint_drives import MadeServo
from pupper_analysis.models.transmission import is_at_one_joint
from pupper_analysis.prepare.feet import Foot, is_ball
from pupper_analysis.prepare.soles import BALL
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.com_reach import moves_com


def said(matched: Match) -> Iterator[str]:
    """Says what became of joints whose names differ, or which only one file has."""
    renamed = {o: n for n, o in matched.urdf_joint.items() if o != n}
    if renamed:
        pairs = ", ".join(f"{old} = {new}" for old, new in renamed.items())
        yield f"joints that have another name in the URDF: {pairs}"
    meant = matched.conventions
    if meant.zeros:
        moved = ", ".join(f"{name} by {angle:+.4g}" for name, angle in meant.zeros.items())
        yield f"joints whose zero is elsewhere in the URDF (rad or m): {moved}; the MJCF's is taken"
    if meant.base is not None and matched.robot.floating:
        yield "the URDF's base frame is elsewhere on the base; it was put to the MJCF's"
    for names, where in ((matched.only_urdf, "URDF"), (matched.only_mjcf, "MJCF")):
        if names:
            yield f"joints that only the {where} has, held at zero: {', '.join(names)}"


def named(robot: Robot, feet: Sequence[Foot], *, given: bool) -> str:
    """Says which feet there are, and with how many contact points."""
    texts = []
    for foot in feet:
        count = len(foot.points)
        body = robot.mj_model.body(foot.body).name
        texts.append(f"{foot.name} on {body}" + (f", {count} contact points" if count > 1 else ""))
    how = "feet" if given else "no feet were named; taken were the lowest limbs' ends"
    return f"{how}: {'; '.join(texts)}"


def balls(robot: Robot, feet: Sequence[Foot]) -> Iterator[str]:
    """Says which meshes balls take the place of."""
    kinds: dict[str, list[str]] = {}
    for foot in feet:
        if any(is_ball(robot.mj_model, point) for point in foot.points):
            edgy = len(foot.points) == 1 and foot.points[0].radius == BALL
            kind = "soles" if len(foot.points) > 1 else "edges" if edgy else "round"
            kinds.setdefault(kind, []).append(foot.name)
    why = "as MuJoCo's contacts of a mesh jump from vertex to vertex"
    for kind, names in kinds.items():
        which = ", ".join(names)
        if kind == "round":
            yield (
                f"round meshes of {which}: balls that fit to them touch the ground instead, {why}"
            )
        elif kind == "soles":
            yield (
                f"soles of {which} are meshes: small balls at their corners touch the ground "
                f"instead, {why}"
            )
        else:
            yield (
                f"feet {which} are meshes that are not round: small balls where they are lowest in "
                f"the start pose touch the ground instead, {why}; a sphere as collision geom would "
                "be the robot's own"
            )


def planar(robot: Robot) -> Iterator[str]:
    """Says so if the legs cannot move the com to every place over the feet."""
    if not moves_com(robot):
        yield (
            "the legs cannot move the com in every direction over feet that stay: by default a "
            "stand has it anywhere inside the support polygon (com 'inside')"
        )


def bound(robot: Robot) -> Iterator[str]:
    """Says which joints follow others."""
    if robot.closure is not None:
        yield robot.closure.in_words()


def made(servos: Sequence[MadeServo], own: int, timestep: float) -> Iterator[str]:
    """Says which servos were made up, and instead of what.

    Args:
        servos: Those that were made up.
        own: How many joints have one of the MJCF's.
        timestep: Of the model that has them (s).
    """
    bad: dict[str, list[str]] = {}
    for servo in servos:
        if servo.instead_of.bad:
            bad.setdefault(str(servo.instead_of.value), []).append(servo.joint)
    for what, joints in bad.items():
        more = f" and {len(joints) - _TOLD} more" if len(joints) > _TOLD else ""
        yield (
            f"the MJCF has {what}, which cannot hold it, at {', '.join(joints[:_TOLD])}{more}: "
            "others were put in their place"
        )
    which = "no position servos" if not own else f"no position servos at {len(servos)} joints"
    if bad:
        which = f"no position servos that hold {len(servos)} joints"
    kp, kd = ([getattr(servo, gain) for servo in servos] for gain in ("kp", "kd"))
    yield (
        f"the MJCF has {which}: they were added, with kp {_span(kp)} N m/rad and kd "
        f"{_span(kd)} N m s/rad, integrator implicitfast, {1e3 * timestep:g} ms"
    )


def _span(values: Sequence[float]) -> str:
    low, high = min(values), max(values)
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"


_TOLD = 4  # motors


def uncommanded(robot: Robot) -> Iterator[str]:
    """Says which motors drive no joint of their own: a tendon, a site, a ball joint."""
    model = robot.mj_model
    others = [motor for motor in range(model.nactuator) if not is_at_one_joint(model, motor)]
    if not others:
        return
    names = [model.actuator(motor).name or f"#{motor}" for motor in others]
    driven = sorted({_driven(model, motor) for motor in others})
    affine = mujoco.mjtBias.mjBIAS_AFFINE.value
    pulling = [
        name
        for motor, name in zip(others, names, strict=True)
        if model.actuator_biastype[motor] == affine and model.actuator_biasprm[motor, :2].any()
    ]
    servo = f", but {', '.join(pulling[:_TOLD])}, a servo, pulls towards it" if pulling else ""
    yield (
        f"motors that drive no hinge or slide of their own are commanded 0: "
        f"{', '.join(names[:_TOLD])}{' …' if names[_TOLD:] else ''} (at {', '.join(driven)}); what "
        f"they would hold is asked of the joints' own{servo}"
    )


def _driven(model: mujoco.MjModel, motor: int) -> str:
    kind = mujoco.mjtTrn(int(model.actuator_trntype[motor])).name.removeprefix("mjTRN_").lower()
    return "a ball or free joint" if kind.startswith("joint") else f"a {kind}"
