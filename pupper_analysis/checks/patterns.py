"""One slip that explains many differences: units, an Euler sequence, left for right, a lost tensor.

Each is tried out: the slip is undone, and what is gone of the differences is what it explains.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, islice

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.checks.alignment import aligned
from pupper_analysis.checks.changes import changes_between
from pupper_analysis.checks.differences import Difference
from pupper_analysis.checks.patterns_dropped import dropped_coms, dropped_products
from pupper_analysis.checks.tolerances import Tolerances
from pupper_analysis.checks.trees import trees
from pupper_analysis.models.parameters import Parameters
from pupper_analysis.models.xml import MAX_NUMBER
from pupper_analysis.results import Result
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]
Key = tuple[str, str]
"""The kind and the element of a difference."""


@dataclass(frozen=True, eq=False)
class Cause(Result):
    """One slip that explains several differences.

    Attributes:
        kind: ``units``, ``angles``, ``exchanged``, ``products`` or ``inertial``.
        message: What it is, in plain words.
        differences: Which of the differences it explains, by number, from 0.
    """

    kind: str
    message: str
    differences: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class _Case:
    """Two trees that differ.

    Attributes:
        robot: The robot.
        first: The URDF's tree.
        raw: The MJCF's, as it is.
        second: The MJCF's, in the URDF's link frames.
        keys: The differences.
        tolerances: What counts as one.
    """

    robot: Robot
    first: Parameters
    raw: Parameters
    second: Parameters
    keys: Sequence[Key]
    tolerances: Tolerances

    def left(self, second: Parameters, only: Collection[str] | None = None) -> set[Key]:
        """Returns the differences to another tree in place of the MJCF's.

        Args:
            second: The other tree.
            only: The joints that are compared, with what they carry; by default all and the base.
        """
        first = self.first if only is None else self.first.part(only)
        try:
            both = aligned(second, first, self.tolerances).values
            found = {(c.kind, c.element) for c in changes_between(first, both, self.tolerances)}
        except (ValueError, KeyError):  # not the same joints any more
            return set(self.keys)
        return found

    def masses_apart(self, exchange: Mapping[str, str]) -> int:
        """Returns how many masses differ where bodies are exchanged; no frame's place matters."""
        pairs = [*exchange.items(), *((two, one) for one, two in exchange.items())]
        masses = [(self.first.bodies[a].mass, self.raw.bodies[b].mass) for a, b in pairs]
        greatest = self.tolerances.mass
        return sum(abs(two - one) > greatest * max(abs(one), abs(two)) for one, two in masses)

    def gone(self, second: Parameters) -> set[Key]:
        """Returns the differences that another tree in place of the MJCF's does not have.

        None if it has others instead, or if most of them are left.
        """
        left = self.left(second)
        gone = set(self.keys) - left
        return gone if not left - set(self.keys) and len(gone) > 1 else set()


def causes(
    robot: Robot,
    second: Parameters,
    differences: Sequence[Difference],
    tolerances: Tolerances,
) -> tuple[Cause, ...]:
    """Finds slips that explain several differences each.

    Args:
        robot: The robot.
        second: The MJCF's tree, in the URDF's link frames.
        differences: All differences.
        tolerances: What counts as one.
    """
    if len(differences) < 2:
        return ()
    first, raw = trees(robot)
    keys = [(each.kind, each.element) for each in differences]
    case = _Case(robot, first, replace(raw, gravity=first.gravity), second, keys, tolerances)
    found: list[Cause] = []
    taken: set[int] = set()
    for look in (_angles, _exchanged, _units, _dropped, _inertials):
        for kind, message, explained in look(case):
            numbers = tuple(n for n, key in enumerate(keys) if key in explained and n not in taken)
            if len(numbers) > 1:
                taken |= set(numbers)
                found.append(Cause(kind, message, numbers))
    return tuple(sorted(found, key=lambda cause: cause.differences))


Found = Iterator[tuple[str, str, set[Key]]]


# ------------------------------------------------------------------------------------- angles

_SEQUENCES = ("xyz", "xzy", "yxz", "yzx", "zxy", "zyx")


def _angles(case: _Case) -> Found:
    """Finds another eulerseq, or degrees for radians, that ends differences."""
    if not {"rotation", "axis", "lower limit", "upper limit", "zero", "base frame"} & {
        kind for kind, _ in case.keys
    }:
        return
    spec = case.robot.description.mjcf
    said = "".join(
        chr(letter) if isinstance(letter, int) else letter for letter in (spec.compiler.eulerseq)
    )
    tries: list[tuple[str, Callable[[mujoco.MjSpec], None]]] = []
    if _has_euler(spec):
        for order in (*_SEQUENCES, *(sequence.upper() for sequence in _SEQUENCES)):
            if order != said:
                message = f'eulerseq="{order}" in place of "{said}"'
                tries.append((message, partial(_set_sequence, order=order)))
    degree = bool(spec.compiler.degree)
    unit, other_unit = ("degree", "radian") if degree else ("radian", "degree")
    message = f'angle="{other_unit}" in place of "{unit}"'
    if _has_euler(spec) or {"lower limit", "upper limit"} & {kind for kind, _ in case.keys}:
        tries.append((message, partial(_set_degree, degree=not degree)))
    best: tuple[int, str, set[Key]] = (0, "", set())
    for message, change in tries:
        other = spec.copy()
        change(other)
        try:
            model = other.compile()
        except (ValueError, RuntimeError):
            continue
        tree = trees(replace(case.robot, mj_model=model))[1]
        gone = case.gone(replace(tree, gravity=case.first.gravity))
        if len(gone) > best[0]:
            best = (len(gone), message, gone)
    count, message, gone = best
    turned = [key for key in case.keys if key[0] in ("rotation", "axis")]
    limits = [key for key in case.keys if key[0] in ("lower limit", "upper limit")]
    concerned = turned or limits
    if concerned and sum(key in gone for key in concerned) >= 0.6 * len(concerned):
        yield (
            "angles",
            f"the MJCF's angles are meant otherwise: with {message} in its <compiler>, {count} of "
            f"the {len(case.keys)} differences are gone",
            gone,
        )


def _has_euler(spec: mujoco.MjSpec) -> bool:
    kind = mujoco.mjtOrientation.mjORIENTATION_EULER
    return any(body.alt.type == kind or body.ialt.type == kind for body in spec.bodies)


def _set_sequence(spec: mujoco.MjSpec, order: str) -> None:
    spec.compiler.eulerseq = list(order)


def _set_degree(spec: mujoco.MjSpec, degree: bool) -> None:
    spec.compiler.degree = degree


# ------------------------------------------------------------------------------------- exchanged


def _exchanged(case: _Case) -> Found:
    """Finds limbs whose names are exchanged."""
    tops = case.first.children(case.first.base)
    limbs = {top: [top, *case.first.below(top)] for top in tops}
    concerned = {
        case.first.frames[element][0] if kind == "frame" else element for kind, element in case.keys
    }
    shaken = [top for top, names in limbs.items() if concerned & set(names)]
    pairs: list[tuple[str, str]] = []
    second, gone = case.raw, set[Key]()
    tries = ((a, b) for a, b in combinations(shaken, 2) if len(limbs[a]) == len(limbs[b]))
    for one, two in islice(tries, _EXCHANGES):
        if any({one, two} & set(pair) for pair in pairs):
            continue
        own = {*limbs[one], *limbs[two]}
        exchange = dict(zip(limbs[one], limbs[two], strict=True))
        carried = own | {frame for name in own for frame in case.first.carried_by(name)}
        before = {key for key in case.keys if key[1] in carried}
        if case.masses_apart(exchange) > _STAY * len(before):
            continue  # these alone are too many of those that would stay
        both = replace(second.part(own), frames=second.frames)
        left = case.left(_renamed(both, exchange), [*limbs[one], *limbs[two]])
        own = carried
        after = {key for key in left if key[1] in own}
        if len(before) > 1 and len(after) <= _STAY * len(before):
            pairs.append((one, two))
            second, gone = _renamed(second, exchange), gone | (before - after)
    if pairs:
        names = ", ".join(f"{one} and {two}" for one, two in pairs)
        yield (
            "exchanged",
            f"limbs are exchanged between the files: {names}; with their names exchanged in one of "
            f"the files, {len(gone)} of the {len(case.keys)} differences are gone",
            gone,
        )


_STAY = 0.2
"""Share of the differences of two limbs that may stay where they are exchanged."""

_EXCHANGES = 300
"""Pairs of limbs that are tried: all of 24 limbs and more than any robot of limbs has."""


def _renamed(values: Parameters, names: Mapping[str, str]) -> Parameters:
    """Exchanges joints of a tree, with all that they move."""
    new = {**names, **{two: one for one, two in names.items()}}
    joints = {
        new.get(name, name): replace(joint, parent=new.get(joint.parent, joint.parent))
        for name, joint in values.joints.items()
    }
    return replace(
        values,
        joints=joints,
        bodies={new.get(name, name): body for name, body in values.bodies.items()},
        frames={
            frame: (new.get(owner, owner), place) for frame, (owner, place) in values.frames.items()
        },
    )


# ------------------------------------------------------------------------------------- units

_MASS = {1e3: "g for kg", 1e-3: "kg for g", 2.20462: "pounds for kg", 0.453592: "kg for pounds"}
_ANGLE = {math.degrees(1.0): "degrees for radians"}
_LENGTH = {1e3: "mm for m", 1e2: "cm for m", 39.3701: "inches for m"}
_INERTIA = {
    1e3: "g m^2 for kg m^2",
    1e4: "kg cm^2 for kg m^2",
    1e6: "kg mm^2 for kg m^2",
    1e7: "g cm^2 for kg m^2",
    1e9: "g mm^2 for kg m^2",
}


def _units(case: _Case) -> Found:
    """Finds masses, lengths or inertias that are all the same multiple of the other file's."""
    first, raw = case.first, case.raw
    bodies = [(one, raw.bodies[name]) for name, one in first.bodies.items() if one.mass]
    masses = _factor([(np.array([a.mass]), np.array([b.mass])) for a, b in bodies])
    inertias = _factor(
        [(a.inertia, case.second.bodies[n].inertia) for n, a in first.bodies.items()]
    )
    places = [(one.position, raw.joints[name].position) for name, one in first.joints.items()]
    lengths = _factor(places)
    hinges = [(one, raw.joints[name]) for name, one in first.joints.items() if not one.slides]
    bounds = [tuple(np.array([j.lower, j.upper]) for j in pair) for pair in hinges]
    limits = _factor((a, b) for a, b in bounds if np.abs([a, b]).max() <= MAX_NUMBER)
    for what, factor, units, kinds in (
        ("limits", limits, _ANGLE, ("lower limit", "upper limit")),
        ("masses", masses, _MASS, ("mass",)),
        ("lengths", lengths, _LENGTH, ("position", "com", "frame")),
        ("inertias", inertias, _INERTIA, ("inertia",)),
    ):
        if factor is None:
            continue
        meant = _unit(factor, units)
        yield (
            "units",
            f"all {what} of the MJCF are {factor:.6g} times those of the URDF{meant}",
            {key for key in case.keys if key[0] in kinds},
        )


def _factor(pairs: Iterable[tuple[Array, Array]]) -> float | None:
    """Returns the one factor between all pairs of arrays; None if there is none, or it is 1."""
    ratios = []
    for one, two in pairs:
        size = float(np.linalg.norm(one))
        if size < 1e-12:
            continue
        ratio = float(np.sum(one * two)) / size**2
        if float(np.linalg.norm(two - ratio * one)) > 1e-3 * abs(ratio) * size:
            return None
        ratios.append(ratio)
    if len(ratios) < 2 or min(ratios) <= 0 or max(ratios) > 1.001 * min(ratios):
        return None
    factor = float(np.median(ratios))
    return None if math.isclose(factor, 1.0, rel_tol=1e-2) else factor


def _unit(factor: float, units: Mapping[float, str]) -> str:
    for size, words in units.items():
        if math.isclose(factor, size, rel_tol=2e-3):
            return f": {words} in the MJCF?"
        if math.isclose(factor, 1 / size, rel_tol=2e-3):
            return f": {words} in the URDF?"
    return ": a decimal point?" if math.isclose(abs(math.log10(factor)), 1, abs_tol=1e-3) else ""


# ------------------------------------------------------------------------------------- inertials


_MANY = 4  # bodies that are told in one line

_OTHER = 0.1
"""How far a mass is off, at least, that is taken for another body's: not a screw more or less."""


def _dropped(case: _Case) -> Found:
    """Finds what one file has left out of its inertials."""
    trees_of = (("URDF", case.first, case.first), ("MJCF", case.raw, case.second))
    for (words, own, one), (_, _, two) in (trees_of, trees_of[::-1]):
        yield from dropped_products(words, one, two, case.keys, case.tolerances)
        yield from dropped_coms(words, own, case.keys)


def _inertials(case: _Case) -> Found:
    """Finds bodies of which nothing is the other file's."""
    kinds = ("mass", "com", "inertia")
    others = []
    for name, one in case.first.bodies.items():
        two = case.second.bodies[name]
        if not {(kind, name) for kind in kinds} <= set(case.keys):
            continue
        if one.mass and two.mass and abs(two.mass - one.mass) >= _OTHER * one.mass:
            others.append(name)
    if len(others) >= _MANY:
        listed = ", ".join(others[:_MANY]) + (" …" if len(others) > _MANY else "")
        yield (
            "inertial",
            f"the inertials of {len(others)} bodies have nothing in common, neither mass nor com "
            f"nor inertia: {listed} (another version of the robot?)",
            {(kind, name) for kind in kinds for name in others},
        )
        return
    for name in others:
        one, two = case.first.bodies[name], case.second.bodies[name]
        twin = next(
            (
                other
                for other, body in case.first.bodies.items()
                if other != name
                and math.isclose(body.mass, two.mass, rel_tol=case.tolerances.mass)
                and np.allclose(body.com, two.com, atol=case.tolerances.com)
            ),
            None,
        )
        whose = f"it is that of {twin} in the URDF" if twin else "another body's, or version's?"
        yield (
            "inertial",
            f"body of {name}: nothing of its inertial is the same: mass {one.mass:.6g} kg in the "
            f"URDF, {two.mass:.6g} kg in the MJCF, and another com and inertia ({whose})",
            {(kind, name) for kind in kinds},
        )
