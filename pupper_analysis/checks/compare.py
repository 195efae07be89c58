"""Compares any robot's URDF with its MJCF: whether they agree, and which number is to blame."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pupper_analysis.checks.attribution import EXPLAINED, align, explain
from pupper_analysis.checks.differences import Difference, Effect, Explanation
from pupper_analysis.checks.engines import CrossCheck, cross_check
from pupper_analysis.checks.matching import Match, match
from pupper_analysis.checks.tolerances import Tolerances
from pupper_analysis.errors import ModelError
from pupper_analysis.models.mjcf_file import MjcfFile, read_mjcf
from pupper_analysis.models.places import Place
from pupper_analysis.models.urdf_file import UrdfFile, read_urdf
from pupper_analysis.results import Result

ENGINES_AGREE = 1e-8
"""How far the two engines may deviate on one model, relative to a quantity's scale."""


@dataclass(frozen=True, eq=False)
class Comparison(Result):
    """What became of the comparison of a URDF with an MJCF.

    Attributes:
        urdf: The URDF's path.
        mjcf: The MJCF's path.
        base: The base's name.
        joints: The joints that both have, by the MJCF's names.
        guessed: {joint in the URDF: joint in the MJCF} matched by structure, or by names that are
            the same but for prefixes and suffixes.
        only_urdf: Joints of the URDF alone, fixed at zero for the comparison.
        only_mjcf: Joints of the MJCF alone, likewise.
        parts: What one file has and the other lacks, as a whole with its joints, in words; it was
            taken off to compare the rest.
        notes: What was assumed or left out.
        check: The cross-check: both models in both engines.
        differences: Of the files, the one with the greatest effect first.
        deviations: {quantity: relative deviation between the models}.
        left: {quantity: relative deviation that is left when all differences are taken away}.
        explained: Share of the worst deviation that the differences explain (1 is all).
        complete: Whether nothing is left unexplained.
        engines: Quantities on which the engines deviate for one and the same model.
        objections: Why the files do not agree, besides the differences, in words: what no
            difference explains, and what differences within the tolerances add up to.
        agree: Whether the models agree, within the tolerances: no difference, no joint in one file
            only, and no objection.
    """

    urdf: str
    mjcf: str
    base: str
    joints: tuple[str, ...]
    guessed: dict[str, str]
    only_urdf: tuple[str, ...]
    only_mjcf: tuple[str, ...]
    parts: tuple[str, ...]
    notes: tuple[str, ...]
    check: CrossCheck
    differences: tuple[Difference, ...]
    deviations: dict[str, float]
    left: dict[str, float]
    explained: float
    complete: bool
    engines: tuple[str, ...]
    objections: tuple[str, ...]
    agree: bool


def compare_models(
    urdf: str | Path,
    mjcf: str | Path,
    *,
    names: Mapping[str, str] | None = None,
    packages: Mapping[str, Path] | None = None,
    feet: Sequence[str] = (),
    tolerances: Tolerances | None = None,
    strict_names: bool = False,
    configurations: int = 20,
    seed: int = 0,
) -> Comparison:
    """Compares a URDF with an MJCF of the same robot, and explains how they differ.

    Args:
        urdf: Path of the URDF.
        mjcf: Path of the MJCF.
        names: {name in the URDF: name in the MJCF} of joints and frames whose names differ.
        packages: {ROS package: its folder}, for ``package://`` paths.
        feet: Frames, by their names in the MJCF, that count as feet; by default all frames that
            both files have are compared.
        tolerances: What counts as a difference; by default for files of 5 to 6 digits.
        strict_names: Joints that are matched by structure, not by their name or by ``names``, are
            a difference; otherwise `guessed` alone tells of them.
        configurations: Number of random configurations of the cross-check.
        seed: Of the random numbers, 0 or more.

    Returns:
        The comparison.

    Raises:
        ModelError: If a file cannot be read, or the two cannot be matched.
        UnknownNameError: If a name is not in its file.
        ConfigurationError: If an argument is out of its range.
    """
    tolerances = tolerances or Tolerances()
    urdf_file, mjcf_file = read_urdf(urdf, packages), read_mjcf(mjcf)
    matched = match(urdf_file, mjcf_file, names=names, feet=feet, tolerances=tolerances)
    robot = matched.robot
    if not robot.total_mass > 0:
        problem = f"its links weigh {robot.total_mass:.6g} kg together; give them <inertial>s"
        raise ModelError(urdf_file.path, problem)
    alignment = align(robot, tolerances)
    check = cross_check(
        robot,
        configurations=configurations,
        tolerance=tolerances.dynamics,
        seed=seed,
        mimics=matched.mimics,
        moved=alignment.moved,
    )
    explanation = explain(
        robot,
        tolerances=tolerances,
        reference=matched.reference,
        mimics=matched.mimics,
        alignment=alignment,
        conventions=matched.conventions,
    )
    found = list(explanation.differences)
    if strict_names:
        found += [_name(*pair) for pair in matched.guessed.items()]
    differences = tuple(
        replace(
            difference,
            urdf_place=_path(_urdf_place(difference, matched, urdf_file)),
            mjcf_place=_path(_mjcf_place(difference, matched, mjcf_file)),
        )
        for difference in found
    )
    worst = max(explanation.deviations.values())
    left = max(explanation.left.values())
    engines = tuple(
        f"{quantity.name}: {relative:.1e} ({whose})"
        for quantity in check.quantities
        for whose, relative in quantity.edges.items()
        if whose.startswith(("engines", "yourdfpy"))
        and relative > ENGINES_AGREE
        # With forces of MuJoCo's that a tree of joints has not, the two got different models.
        and not (explanation.remains and "MJCF" in whose)
    )
    unmatched = matched.only_urdf or matched.only_mjcf
    objections = tuple(_objections(explanation, tolerances))
    return Comparison(
        urdf=str(urdf_file.path),
        mjcf=str(mjcf_file.path),
        base=robot.base,
        joints=robot.joint_names,
        guessed=dict(matched.guessed),
        only_urdf=matched.only_urdf,
        only_mjcf=matched.only_mjcf,
        parts=matched.parts,
        notes=(*matched.notes, *_armature_notes(explanation)),
        check=check,
        differences=differences,
        deviations=explanation.deviations,
        left=explanation.left,
        explained=_explained(worst, left),
        complete=explanation.complete,
        engines=engines,
        objections=objections,
        agree=not (differences or unmatched or objections),
    )


def _explained(worst: float, left: float) -> float:
    """Returns the share of the worst deviation that is explained."""
    if worst <= EXPLAINED:
        return 1.0 if left <= EXPLAINED else 0.0
    return max(0.0, 1.0 - left / worst) if math.isfinite(left) else 0.0


def _name(urdf: str, mjcf: str) -> Difference:
    message = f"joint {mjcf}: it is called {urdf} in the URDF, {mjcf} in the MJCF"
    return Difference("name", mjcf, urdf, mjcf, "", message, {})


def _objections(explanation: Explanation, tolerances: Tolerances) -> Iterator[str]:
    """Yields what keeps two files from agreeing although they may have no difference."""
    left = {name: value for name, value in explanation.left.items() if value > EXPLAINED}
    if left:
        name = max(left, key=lambda quantity: left[quantity])
        because = f" ({'; '.join(explanation.remains)})" if explanation.remains else ""
        yield f"{left[name]:.1e} of {name} is left that no difference explains{because}"
        return
    if explanation.differences:
        return
    # Who lets a mass differ by 1e-2 lets what follows from it differ as much.
    allowed = max(getattr(tolerances, kind) for kind in _FELT)
    for name, value in explanation.deviations.items():
        if value > allowed:
            yield (
                f"each difference is within its tolerance, but together they make {value:.1e} of "
                f"{name}, more than {allowed:.0e}; --tolerance dynamics=... lets it pass"
            )


_FELT = ("mass", "com", "inertia", "position", "rotation", "axis", "damping", "dynamics")
"""Kinds of tolerance that the dynamics feel."""


def _armature_notes(explanation: Explanation) -> list[str]:
    """Says what the armature does, which the URDF cannot state, for who builds models from it."""
    effects = explanation.armature
    values: dict[str, list[str]] = {}
    for name, value in effects.values.items():
        values.setdefault(f"{value:.6g}", []).append(name)
    if set(values) == {"0"}:
        return []
    listed = ", ".join(
        f"{value} on {len(names)} joints" if len(names) > 3 else f"{value} on {' '.join(names)}"
        for value, names in values.items()
    )
    off = effects.effects.get("mass matrix", Effect(0.0, 0.0, 0.0)).relative
    forward = effects.effects.get("forward dynamics", Effect(0.0, 0.0, 0.0)).relative
    return [
        f"armature ({listed}; kg m^2) is in the MJCF alone, and was given to both. A model of the "
        f"URDF without it has its mass matrix off by {off:.2g}, and its accelerations by "
        f"{forward:.2g}, of their scale: set pin.Model.armature"
    ]


_URDF_CHILD = {
    "mass": "inertial/mass",
    "com": "inertial/origin",
    "inertia": "inertial/inertia",
    "zero": "origin",
    "position": "origin",
    "rotation": "origin",
    "axis": "axis",
    "lower limit": "limit",
    "upper limit": "limit",
    "effort": "limit",
    "velocity": "limit",
    "damping": "dynamics",
    "friction": "dynamics",
    "armature": "dynamics",
    "mimic": "mimic",
}

_MJCF_SECTION = {
    "tendon": "tendon",
    "actuator": "actuator",
    "equality": "equality",
    "flex": "deformable",
}
"""Sections of an MJCF whose elements a URDF has none of."""

_WHOLE = {"fluid": ("density", "viscosity"), "gravity": ("gravity",), "flag": (), "plugin": ()}
"""Kinds that concern the whole of a URDF, and the options of the MJCF that state them."""


def _path(place: Place) -> str:
    """Returns the whole path, by which a CI service finds the file."""
    return f"{place.file}" if place.line is None else f"{place.file}:{place.line}"


def _urdf_place(difference: Difference, matched: Match, file: UrdfFile) -> Place:
    child = _URDF_CHILD.get(difference.kind)
    movers = {body: mover for mover, body in matched.mjcf_body.items()}
    if difference.kind == "gravity compensation":
        mover = movers.get(difference.element)
        return Place(file.path) if mover is None else file.place("link", matched.urdf_link[mover])
    if difference.kind in _MJCF_SECTION or difference.kind in _WHOLE:
        return Place(file.path)
    if difference.kind in ("mass", "com", "inertia") or difference.element == matched.robot.base:
        return file.place("link", matched.urdf_link[difference.element], child)
    if difference.kind == "frame":
        link = matched.robot.description.frames[difference.element][0]
        joint = next(
            (
                element
                for element in file.root.findall("joint")
                if element.find("child") is not None and element.find("child").get("link") == link
            ),
            None,
        )
        if joint is None:
            return file.place("link", link)
        return file.place("joint", str(joint.get("name")), "origin")
    return file.place("joint", matched.urdf_joint[difference.element], child)


def _mjcf_place(difference: Difference, matched: Match, file: MjcfFile) -> Place:
    element, kind = difference.element, difference.kind
    if kind in _MJCF_SECTION:
        if not element.startswith("#"):
            return file.place(_MJCF_SECTION[kind], element)
        if matched.only_mjcf:  # the numbers are those of what was left
            return Place(file.path)
        return file.numbered(_MJCF_SECTION[kind], int(element[1:]))
    if kind in _WHOLE:
        words = {"flag": (element,)}.get(kind, _WHOLE[kind])
        tag = "flag" if kind == "flag" or not words else "option"
        stated = (at for found, at in file.elements(tag) if set(words) & set(found))
        return next(stated, Place(file.path))
    if kind in ("gravity compensation", "plugin"):
        return file.place("body", element)
    if difference.kind == "base frame":
        return file.place("body", matched.mjcf_body[element])
    if difference.kind in ("mass", "com", "inertia"):
        return file.place("body", matched.mjcf_body[element], "inertial")
    if element == matched.robot.base:
        return file.place("body", matched.mjcf_body[element], "joint")
    if difference.kind in ("zero", "position", "rotation", "parent"):
        return file.place("body", matched.mjcf_body[element])
    body = matched.mjcf_body.get(element, "")
    tries = [("joint", element, None), ("body", body, "joint")]
    if difference.kind == "effort":
        tries.insert(0, ("actuator", element, None))
    if difference.kind == "frame":
        name = matched.robot.description.frames[element][1]
        tries = [("site", name, None), ("body", name, None), ("geom", name, None)]
    places = [file.place(*one) for one in tries]
    return next((place for place in places if place.line is not None), places[0])
