"""Changes of what touches, of MuJoCo's options and of keyframes, and what they do.

What they do together, MuJoCo says: both files are simulated, each from its first keyframe. Robots
are published without a ground, in a file that scenes include: where neither file has one, both
stand on a plane that is laid under them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import count
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Term,
    diagnose,
)
from pupper_analysis.models.attributes import ELEMENT_ATTRIBUTES
from pupper_analysis.models.mjcf import (
    JointKind,
    compile_spec,
    equality_name,
    has_free_joint,
    make_start_data,
    silence_mujoco,
)
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.places import Place
from pupper_analysis.models.shapes import COMPARISON_DIRECTIONS, Shape, read_shape
from pupper_analysis.models.spec_tree import SpecTree
from pupper_analysis.models.stated.mjcf import (
    Value,
    element_values,
    find_collidable_geoms,
    joint_name,
    place_of_geom,
)
from pupper_analysis.models.stated.model import UrdfModel
from pupper_analysis.robot.compare.differences import VERSION_NAMES, Difference, Effect

Key = tuple[str, str]
"""An element's tag and name."""


@dataclass(frozen=True, eq=False)
class Element:
    """An element of an MJCF.

    Attributes:
        values: {word: its numbers}.
        place: Returns where a word of it is stated, in itself or a default class; where it stands
            itself, if it is not.
        shape: That of a geom.
        touches: Whether a geom can touch anything, by ``contype`` and ``conaffinity`` or in a pair.
        owners: The body of a geom, the two geoms of a pair, or the two bodies of an exclude.
    """

    values: Mapping[str, Value]
    place: Callable[[str], Place]
    shape: Shape | None = None
    touches: bool = True
    owners: tuple[str, ...] = ()


_FRICTION_OF: Final = {1: 0, 3: 1, 4: 2, 6: 3}
"""{condim: how many of a geom's three coefficients of friction act}; the greater one of two geoms
counts, and that of a scene's ground is 3."""


def list_elements(file: MjcfFile) -> dict[Key, Element]:
    """Returns what an MJCF states besides bodies and joints.

    Pairs and excludes are called after what they are of.

    Args:
        file: A file that MuJoCo compiles.
    """
    model = file.model
    found: dict[Key, Element] = {}
    names = list_geom_names(model)
    touching = find_collidable_geoms(model)
    condim = max((3, *model.geom_condim.tolist()))
    for geom, name in enumerate(names):
        values = element_values(model, "geom", geom)
        values["friction"] = values["friction"][: _FRICTION_OF[condim]]
        place = partial(place_of_geom, file, geom)
        body = model.body(int(model.geom_bodyid[geom])).name
        found["geom", name] = Element(
            values, place, read_shape(model, geom), geom in touching, (body,)
        )
    pairs, excludes = ([place for _, place in file.elements(tag)] for tag in ("pair", "exclude"))
    for pair in range(model.npair):
        ends = names[int(model.pair_geom1[pair])], names[int(model.pair_geom2[pair])]
        values = element_values(model, "pair", pair)
        at = _at(_nth(pairs, pair, model.npair, file))
        found["pair", join_names(ends)] = Element(values, at, owners=ends)
    for exclude, signature in enumerate(model.exclude_signature.tolist()):
        ends = model.body(signature >> 16).name, model.body(signature & 0xFFFF).name
        at = _at(_nth(excludes, exclude, model.nexclude, file))
        found["exclude", join_names(ends)] = Element({}, at, owners=ends)
    stated = next((place for _, place in file.elements("option")), Place(file.path))
    found["option", "option"] = Element(
        element_values(model, "option", 0), _stating(file, "option", stated)
    )
    flags = next((place for _, place in file.elements("flag")), stated)
    for bit in (*DISABLE_BITS, *ENABLE_BITS):
        enabled = {ENABLED_WORD: (float(has_flag(model, bit)),)}
        found["flag", get_flag_name(bit)] = Element(enabled, _at(flags))
    found |= _bound(file)
    for key in range(model.nkey):
        name = model.key(key).name or f"#{key}"
        found["key", name] = Element(
            element_values(model, "key", key), _at(file.place("key", name))
        )
    return found


def _bound(file: MjcfFile) -> dict[Key, Element]:
    """Returns joints, motors, tendons and equalities, with what no tree of joints has of them."""
    model, found = file.model, dict[Key, Element]()
    counts = {
        "joint": model.njnt,
        "actuator": model.nactuator,
        "tendon": model.ntendon,
        "equality": model.neq,
    }
    for kind, number in counts.items():
        for row in range(number):
            name = getattr(model, kind)(row).name or f"#{row}"
            if kind == "joint":
                name = joint_name(model, row)
            elif kind == "equality":
                name = equality_name(model, row)
            place = partial(_place_of, file, kind, name, row)
            found[kind, name] = Element(element_values(model, kind, row), place)
    return found


def _place_of(file: MjcfFile, kind: str, name: str, row: int, word: str) -> Place:
    if name.startswith("#"):
        return file.numbered(kind, row)
    return file.stated(kind, name, (word,)) or file.place(kind, name)


def join_names(ends: Iterable[str]) -> str:
    """Returns what a pair or an exclude is called."""
    return " and ".join(sorted(ends))


def _nth(places: list[Place], number: int, count: int, file: MjcfFile) -> Place:
    """Returns the place of MuJoCo's n-th; the file alone where it has others than are written."""
    return places[number] if len(places) == count else Place(file.path)


def list_geom_names(model: mujoco.MjModel) -> list[str]:
    """Returns each geom's name; one without is called after its body and its place there."""
    names, seen = [], dict[int, int]()
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        seen[body] = seen.get(body, 0) + 1
        called = model.body(body).name or f"body #{body}"
        names.append(model.geom(geom).name or f"{called} #{seen[body]}")
    return names


def list_collisions(model: UrdfModel) -> dict[Key, Element]:
    """Returns the shapes of a URDF that touch, {("collision", link, or "link #2"): element}."""
    found: dict[Key, Element] = {}
    for link in model.links.values():
        touching = [shape for shape in link.shapes if shape.collides]
        for number, shape in enumerate(touching, 1):
            name = link.name if number == 1 else f"{link.name} #{number}"
            place = model.file.nth(link.name, "collision", number - 1)
            found["collision", name] = Element({}, _at(place), shape, owners=(link.name,))
    return found


def _stating(file: MjcfFile, tag: str, otherwise: Place) -> Callable[[str], Place]:
    """Returns what finds the element of a tag that states a word."""

    def place(word: str) -> Place:
        stated = (where for words, where in file.elements(tag) if word in words)
        return next(stated, otherwise)

    return place


def _at(place: Place) -> Callable[[str], Place]:
    return lambda _: place


ENABLED_WORD: Final = "enabled"
"""What a flag says: 1 or 0."""

DISABLE_BITS: Final = tuple(
    bit for bit in mujoco.mjtDisableBit.__members__.values() if bit.name.startswith("mjDSBL_")
)
ENABLE_BITS: Final = tuple(
    bit for bit in mujoco.mjtEnableBit.__members__.values() if bit.name.startswith("mjENBL_")
)


def get_flag_name(bit: Any) -> str:
    """Returns a flag's attribute of ``<flag>``."""
    return str(bit.name).split("_", 1)[1].lower()


def has_flag(model: mujoco.MjModel, bit: Any) -> bool:
    """Whether what a flag is of is enabled."""
    if isinstance(bit, mujoco.mjtDisableBit):
        return not model.opt.disableflags & bit.value
    return bool(model.opt.enableflags & bit.value)


Array = NDArray[np.float64]

MIN_FELT_MOTION = 1e-4
"""Smallest difference of a simulated coordinate [m, rad] within `SIMULATION_SECONDS` that is
reported. A stand is settled to 1e-5."""

SIMULATION_SECONDS = 2.0
"""Of a simulation (s): what falls has fallen, and servos of some hertz have come to rest."""

_MOST_STEPS = 4000
"""Of a simulation with a small time step; it is cut then, and says its seconds."""

_SAMPLES = 200
"""Of a simulation: what a blow moves for 10 ms is seen."""

_FALL = 1.0
"""m: what loses more has gone through the floor, or off it."""

NUMBER_RTOL = 1e-9
"""Relative: files that were written anew round their numbers so."""

SURFACE_ATOL = 1e-6
"""m: shapes whose surfaces are no further apart are one."""

SHAPE_WORD: Final = "shape"


@dataclass(frozen=True, eq=False)
class ElementDifference(Difference):
    """A change of one number or shape of elements that had it alike; or what came or went.

    Attributes:
        consequences: What it does in a simulation.
        places: Where the first of them stands, in both files; None where it does not.
    """

    consequences: tuple[Diagnostic, ...] = ()
    places: tuple[Place | None, Place | None] = (None, None)


def measure_surface_distance(one: Shape, two: Shape) -> float:
    """Returns how far the surfaces of two shapes' hulls are apart at most (m).

    Of shapes without extents (planes, missing meshes) their places and sizes are compared: infinite
    if they differ.
    """
    first, second = (shape.support(COMPARISON_DIRECTIONS) for shape in (one, two))
    if first is not None and second is not None:
        return float(np.abs(first - second).max())
    ends = [(shape.pose.position, shape.pose.rotation, shape.size) for shape in (one, two)]
    near = (
        np.allclose(here, there, rtol=0, atol=SURFACE_ATOL)
        for here, there in zip(*ends, strict=True)
    )
    return (
        0.0 if one.kind == two.kind and len(one.size) == len(two.size) and all(near) else math.inf
    )


def match_elements(
    old: Mapping[Key, Element],
    new: Mapping[Key, Element],
    bodies: Mapping[str, str],
    joints: Mapping[str, str],
) -> dict[Key, Element]:
    """Returns new elements by what the old file calls those that they are like.

    Geoms of one name are one. Of the others of a body those are one that are exactly alike, then
    those of one shape, and the rest in their order: another number in the file is no change. What
    only the new file has is numbered on.

    Args:
        old: The old file's.
        new: The new one's.
        bodies: {body of the new file: what it is called in the old one}.
        joints: Likewise.
    """
    found: dict[Key, Element] = {}
    calls: dict[str, str] = {}
    taken = {name for _, name in (*old, *new)}
    for (kind, body), (here, there) in _unnamed(old, new, bodies).items():
        pairs = _most_alike(here, there, old, new)
        for key in there:
            name = pairs[key][1] if key in pairs else key[1]
            if key not in pairs and ((kind, name) in old or (kind, name) in found):
                name = next(free for n in count(2) if (free := f"{body} #{n}") not in taken)
                taken.add(name)
            found[kind, name], calls[key[1]] = new[key], name
    for (kind, name), element in new.items():
        if element.shape is not None and name in calls:
            continue
        if kind in ("pair", "exclude"):
            ends = calls if kind == "pair" else bodies
            name = join_names(ends.get(end, end) for end in element.owners)
        elif kind == "joint":
            name = joints.get(name, name)
        found[kind, name] = element
    return found


def _unnamed(
    old: Mapping[Key, Element], new: Mapping[Key, Element], bodies: Mapping[str, str]
) -> dict[Key, tuple[list[Key], list[Key]]]:
    """Returns {tag and body: the shapes of both files that have no name in common}."""
    found: dict[Key, tuple[list[Key], list[Key]]] = {}
    for number, elements in enumerate((old, new)):
        for key, element in elements.items():
            names = {
                one.shape.name if (one := side.get(key)) and one.shape else ""
                for side in (old, new)
            }
            if element.shape is not None and names != {key[1]}:
                body = element.owners[0]
                body = bodies.get(body, body) if number else body
                found.setdefault((key[0], body), ([], []))[number].append(key)
    return found


def _most_alike(
    here: list[Key], there: list[Key], old: Mapping[Key, Element], new: Mapping[Key, Element]
) -> dict[Key, Key]:
    """Returns {one there: that of the ones here which it is}."""

    def is_of_one_shape(one: Element, two: Element) -> bool:
        assert one.shape is not None
        assert two.shape is not None
        return (
            one.shape.kind == two.shape.kind
            and measure_surface_distance(one.shape, two.shape) <= SURFACE_ATOL
        )

    def is_alike(one: Element, two: Element) -> bool:
        same = all(_same(*values) for values in _numbers_of_both(one, two).values())
        return same and one.touches == two.touches and is_of_one_shape(one, two)

    def touches_alike(one: Element, two: Element) -> bool:
        return one.touches == two.touches

    found: dict[Key, Key] = {}
    left = list(here)
    for test in (is_alike, is_of_one_shape, touches_alike):
        for key in there:
            near = (
                candidate
                for candidate in left
                if key not in found and test(old[candidate], new[key])
            )
            if (match := next(near, None)) is not None:
                found[key] = match
                left.remove(match)
    return found


def _numbers_of_both(one: Element, two: Element) -> dict[str, tuple[Value, Value]]:
    """Returns {word: its numbers in both}, as far as both have them."""
    found = {}
    for word in dict.fromkeys((*one.values, *two.values)):
        here, there = one.values.get(word, ()), two.values.get(word, ())
        if word == "friction":  # those that another condim adds are no change of their own
            here, there = (values[: min(len(here), len(there))] for values in (here, there))
        found[word] = here, there
    return found


def find_changed_elements(
    old: Mapping[Key, Element],
    new: Mapping[Key, Element],
) -> Iterator[ElementDifference]:
    """Yields what has changed; elements whose number has changed alike are one change."""
    alike: dict[tuple[Any, ...], list[Key]] = {}
    for key in dict.fromkeys((*old, *new)):
        one, two = old.get(key), new.get(key)
        if not any(element is not None and element.touches for element in (one, two)):
            continue  # it is seen alone
        if one is None or two is None:
            if key[0] not in _IN_TREES:
                alike.setdefault((key[0], "", one is None, key), []).append(key)
            continue
        for word, (here, there) in _numbers_of_both(one, two).items():
            if not _same(here, there):
                alike.setdefault((key[0], word, here, there), []).append(key)
        if (
            one.shape is not None
            and two.shape is not None
            and measure_surface_distance(one.shape, two.shape) > SURFACE_ATOL
        ):
            alike.setdefault((key[0], SHAPE_WORD, *_reshaped(one.shape, two.shape)), []).append(key)
    for (kind, word, *_), keys in alike.items():
        yield _change(kind, word, keys, old, new)


_COMPILER: Final = {
    "degree": "angle",
    **{
        word: word
        for word in (
            "eulerseq",
            "autolimits",
            "inertiafromgeom",
            "inertiagrouprange",
            "boundmass",
            "boundinertia",
            "settotalmass",
            "balanceinertia",
            "alignfree",
            "fitaabb",
            "fusestatic",
        )
    },
}
"""{what MuJoCo's spec calls a number of the compiler that others follow from: its attribute}."""


def find_changed_compiler_settings(old: MjcfFile, new: MjcfFile) -> Iterator[ElementDifference]:
    """Yields what has changed of the compiler: numbers change with it whose lines have not."""
    for name, word in _COMPILER.items():
        one, two = (_stated_flag(name, getattr(file.spec.compiler, name)) for file in (old, new))
        if one == two:
            continue
        message = diagnose(
            "mjcf-element-differs",
            subject=("compiler", word),
            others=(),
            what="",
            one=one,
            two=two,
            **VERSION_NAMES.named,
        )
        places = [
            next((at for words, at in file.elements("compiler") if word in words), None)
            for file in (old, new)
        ]
        yield ElementDifference(
            kind="compiler",
            element=word,
            urdf=one,
            mjcf=two,
            unit="",
            diagnostic=message,
            effects={},
            places=(places[0], places[1]),
        )


def _stated_flag(name: str, value: Any) -> str:
    if name == "degree":
        return "degree" if value else "radian"
    if isinstance(value, bool | np.bool_):
        return str(bool(value)).lower()
    if hasattr(value, "name"):
        return str(value.name).rpartition("_")[2].lower()
    if isinstance(value, float):
        return f"{value:.6g}"
    return ("" if name == "eulerseq" else " ").join(map(str, value))


_IN_TREES: Final = ("joint", "actuator", "tendon", "equality")
"""Elements that come and go with the trees of joints, and what acts on them."""


def _reshaped(one: Shape, two: Shape) -> tuple[object, ...]:
    """Returns what has changed of a shape: left and right are one change where it is the size."""
    ends = [(shape.pose.position, shape.pose.rotation) for shape in (one, two)]
    if all(np.array_equal(here, there) for here, there in zip(*ends, strict=True)):
        return one.kind, tuple(one.size), two.kind, tuple(two.size)
    return str(one.diagnostic), str(two.diagnostic)


def _same(one: Value, two: Value) -> bool:
    return len(one) == len(two) and np.allclose(one, two, rtol=NUMBER_RTOL, atol=1e-12)


def _change(
    kind: str,
    word: str,
    keys: list[Key],
    old: Mapping[Key, Element],
    new: Mapping[Key, Element],
) -> ElementDifference:
    names = tuple(name for _, name in keys)
    one, two = old.get(keys[0]), new.get(keys[0])
    before, after = (_value(element, word) for element in (one, two))
    whole = kind in ("option", "flag")  # of which there is one, with many numbers
    message = diagnose(
        "mjcf-element-differs",
        subject=(kind, word if kind == "option" else names[0]),
        others=() if whole else names[1:],
        what="" if whole else Term(word) if word in _TERMS else word,
        one=before,
        two=after,
        **VERSION_NAMES.named,
    )
    consequences: tuple[Diagnostic, ...] = ()
    shapes = [element.shape for element in (one, two) if element is not None and element.shape]
    if word == SHAPE_WORD and math.isfinite(distance := measure_surface_distance(*shapes)):
        moved = diagnose("surface-moves", distance=Quantity(distance, "m"))
        consequences = (moved,)
    return ElementDifference(
        kind=kind,
        element=word if kind == "option" else names[0],
        urdf=_plain(one, word),
        mjcf=_plain(two, word),
        unit=next(
            (row.unit for row in ELEMENT_ATTRIBUTES if (row.element, row.word) == (kind, word)), ""
        ),
        diagnostic=message,
        effects={},
        consequences=consequences,
        places=(one.place(word) if one else None, two.place(word) if two else None),
    )


_CHOICES: Final = {
    "integrator": mujoco.mjtIntegrator,
    "cone": mujoco.mjtCone,
    "solver": mujoco.mjtSolver,
    "jacobian": mujoco.mjtJacobian,
    "dyntype": mujoco.mjtDyn,
    "gaintype": mujoco.mjtGain,
    "biastype": mujoco.mjtBias,
}

_TERMS: Final = (SHAPE_WORD, "friction")


def _value(element: Element | None, word: str) -> object:
    if element is None:
        return Term("none")
    if not word:
        return Term("there") if element.shape is None else element.shape.diagnostic
    if word == SHAPE_WORD:
        assert element.shape is not None
        return element.shape.diagnostic
    numbers = element.values.get(word, ())
    if word in _CHOICES and numbers:
        return _CHOICES[word](int(numbers[0])).name.split("_", 1)[1].lower()
    if word == ENABLED_WORD:
        return Term("enabled" if numbers[0] else "disabled")
    return " ".join(f"{number:.6g}" for number in numbers) or Term("none")


def _plain(element: Element | None, word: str) -> object:
    """Returns a value as data."""
    if element is None:
        return None
    if word in ("", SHAPE_WORD):
        shape = element.shape
        return (
            "there" if shape is None else [shape.kind, *shape.size, *shape.pose.position.tolist()]
        )
    numbers = list(element.values.get(word, ()))
    return numbers[0] if len(numbers) == 1 else numbers


@dataclass(frozen=True, eq=False)
class _Run:
    """What a simulation came to.

    Attributes:
        seconds: How long it was (s).
        qpos: (samples, n) of the joints looked at; not numbers from where it diverged.
        slid: (n,) which of them are lengths.
        com: (samples,) height of all that moves (m).
        friction: The least coefficient of a contact with the world at the end; None without any.
    """

    seconds: float
    qpos: Array
    slid: NDArray[np.bool_]
    com: Array
    friction: float | None


ROUNDING_NUDGE = 1e-9
"""rad, m: what files that mean the same are apart by; a fall may make centimetres of it."""


def _image(model: mujoco.MjModel) -> bytes:
    image = np.empty(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, image)
    return image.tobytes()


MOTION_QUANTITY: Final = "simulated motion"


@dataclass(frozen=True, eq=False)
class SimulatedPair:
    """Two MJCFs that are simulated.

    Attributes:
        old: What MuJoCo makes of the old file.
        new: Of the new one.
        has_added_floor: Whether a ground was laid under both, because neither has one.
    """

    old: mujoco.MjModel
    new: mujoco.MjModel
    has_added_floor: bool

    @staticmethod
    def from_files(old: MjcfFile, new: MjcfFile) -> SimulatedPair:
        """Returns two files' models, on a ground if they have one to stand on or none at all."""
        models = old.model, new.model
        stand = all(has_free_joint(model) and not _stays(model).any() for model in models)
        if not stand:
            return SimulatedPair(old.model, new.model, has_added_floor=False)
        height = min(map(_ground_under, models))
        trees = [SpecTree(file.spec.copy()) for file in (old, new)]
        floors = [tree.add_floor(height) for tree in trees]
        floors[1].conaffinity = floors[0].conaffinity  # one ground, that the old file's feet touch
        before, after = (
            compile_spec(tree.spec, file.path) for tree, file in zip(trees, (old, new), strict=True)
        )
        return SimulatedPair(before, after, has_added_floor=True)

    def compute_effects(
        self, *, explained: bool
    ) -> tuple[dict[str, Effect], tuple[Diagnostic, ...]]:
        """Returns by how much the two differ as they are, and what of it a user would see.

        Args:
            explained: Whether a change was found; if not, what rounding can do is no effect.
        """
        old, new = self.old, self.new
        if not self._common or (not explained and _image(old) == _image(new)):
            return {}, ()
        before, after = self._simulate(old), self._simulate(new)
        effects, messages = self._weigh(before, after)
        if explained or not effects:
            return (effects, messages) if explained else ({}, ())
        nudged, _ = self._weigh(before, self._simulate(old, ROUNDING_NUDGE))
        # A tenth: where both have left their course, they are apart by any part of the way.
        rounding = (
            nudged and nudged[MOTION_QUANTITY].deviation > 0.1 * effects[MOTION_QUANTITY].deviation
        )
        return ({}, ()) if rounding else (effects, messages)

    @cached_property
    def _common(self) -> list[str]:
        """The joints that both have: what moves otherwise is in one file alone."""
        names = [
            [joint_name(model, n) for n in range(model.njnt)] for model in (self.old, self.new)
        ]
        return [name for name in names[0] if name in names[1]]

    def _simulate(self, model: mujoco.MjModel, nudge: float = 0.0) -> _Run:
        number = {joint_name(model, n): n for n in range(model.njnt)}
        return _simulate(model, [number[name] for name in self._common], nudge)

    def _weigh(self, before: _Run, after: _Run) -> tuple[dict[str, Effect], tuple[Diagnostic, ...]]:
        """Returns by how much two simulations differ, and what of it a user would see."""
        seconds = Quantity(min(before.seconds, after.seconds), "s")
        start = self.old.key(0).name if self.old.nkey else ""
        return _weigh(
            before, after, {"seconds": seconds, "start": start, "laid": self.has_added_floor}
        )


def _stays(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Says which geoms stand in the world and can touch."""
    touch = (model.geom_contype | model.geom_conaffinity) != 0
    touch[[*model.pair_geom1, *model.pair_geom2]] = True
    still: NDArray[np.bool_] = touch & (model.body_weldid[model.geom_bodyid] == 0)
    return still


def _ground_under(model: mujoco.MjModel) -> float:
    """Returns the height of a ground (m): 0, as in scenes, if the robot begins above it.

    Home poses are published with feet centimetres in the ground; who is in it by more than a
    quarter of his height up to the com is below it, and is put on one at his lowest point.
    """
    data = make_start_data(model)
    middle, half = model.geom_aabb[:, :3], model.geom_aabb[:, 3:]
    up = data.geom_xmat[:, 6:]
    reach = data.geom_xpos[:, 2] + (up * middle).sum(axis=1) - (np.abs(up) * half).sum(axis=1)
    lowest, com = float(reach.min(initial=0.0)), float(data.subtree_com[0][2])
    return lowest if -lowest > 0.25 * (com - lowest) else 0.0


def _simulate(model: mujoco.MjModel, joints: Sequence[int], nudge: float = 0.0) -> _Run:
    """Simulates a model from its first keyframe, as MuJoCo leaves it when it is reset to it.

    Args:
        model: The model; it begins at its ``qpos0`` if it has no keyframe.
        joints: Those that are looked at, and the trees that they move.
        nudge: Of all velocities at the start (rad/s, m/s).
    """
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qvel += nudge
    step = float(model.opt.timestep)
    seconds = min(SIMULATION_SECONDS, _MOST_STEPS * step)
    ends = [*model.jnt_qposadr.tolist(), model.nq]
    places = [place for joint in joints for place in range(ends[joint], ends[joint + 1])]
    lengths = {JointKind.SLIDE: 1, JointKind.FREE: 3}
    slid = [
        place < lengths.get(model.jnt_type[joint], 0)
        for joint in joints
        for place in range(ends[joint + 1] - ends[joint])
    ]
    roots = model.body_rootid[model.jnt_bodyid[list(joints)]]
    masses = model.body_mass * np.isin(model.body_rootid, roots) * (model.body_weldid != 0)
    qpos, com, done = [], [], 0
    with silence_mujoco():
        for sample in range(1, _SAMPLES + 1):
            wanted = round(sample * seconds / _SAMPLES / step)
            try:
                mujoco.mj_step(model, data, nstep=wanted - done)
            except mujoco.FatalError:
                data.qpos[:] = np.nan
            done = wanted
            lost = not data.time > (wanted - 0.5) * step  # MuJoCo begins anew where it diverges
            qpos.append(np.full(len(places), np.nan) if lost else data.qpos[places])
            height = float(masses @ data.xipos[:, 2]) / max(float(masses.sum()), 1e-300)
            com.append(np.nan if lost else height)
    return _Run(
        seconds,
        np.array(qpos),
        np.array(slid, dtype=bool),
        np.array(com),
        _least_friction(model, data),
    )


def _least_friction(model: mujoco.MjModel, data: mujoco.MjData) -> float | None:
    found = [
        float(contact.friction[0]) if contact.dim > 1 else 0.0
        for contact in data.contact
        if 0 in model.body_weldid[model.geom_bodyid[contact.geom]]
    ]
    return min(found, default=None)


def _weigh(
    before: _Run, after: _Run, where: Mapping[str, Any]
) -> tuple[dict[str, Effect], tuple[Diagnostic, ...]]:
    if before.qpos.shape != after.qpos.shape:
        return {}, ()
    same_end = np.isnan(before.qpos) & np.isnan(after.qpos)
    off = np.where(same_end, 0.0, np.abs(after.qpos - before.qpos))
    off = np.nan_to_num(off, nan=math.inf).max(axis=0, initial=0.0)
    moved, turned = (float(off[kind].max(initial=0.0)) for kind in (after.slid, ~after.slid))
    worst = max(moved, turned)
    facts = []
    if worst > MIN_FELT_MOTION:
        rise = float(after.com[-1] - before.com[-1])
        facts.append(
            diagnose(
                "simulation-changes",
                diverges=math.isnan(rise),
                higher=Quantity(rise, "m") if rise > MIN_FELT_MOTION else None,
                lower=Quantity(-rise, "m") if -_FALL <= rise < -MIN_FELT_MOTION else None,
                falls=Quantity(-rise, "m") if rise < -_FALL else None,
                ends=abs(rise) > MIN_FELT_MOTION,
                off=[
                    diagnose("coordinate-off", length=unit == "m", most=Quantity(most, unit))
                    for unit, most in (("m", moved), ("rad", turned))
                    if MIN_FELT_MOTION < most < math.inf
                ],
                **where,
            )
        )
    if None not in (before.friction, after.friction) and before.friction != after.friction:
        one, two = (math.atan(run.friction or 0.0) for run in (before, after))
        facts.append(diagnose("slides-from", one=Quantity(one, "rad"), two=Quantity(two, "rad")))
    if not facts:
        return {}, (diagnose("simulation-unchanged", **where),)
    effects = {MOTION_QUANTITY: Effect(worst, worst, math.inf)} if worst > MIN_FELT_MOTION else {}
    return effects, tuple(facts)
