"""Changes of collision shapes, MuJoCo's options and keyframes, and the simulated effects.

The combined effect is simulated from the first keyframe of each file, or from qpos0 without a
keyframe. If neither file has a ground and both robots have a free base, the same plane is added
under both.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import count
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Term,
    diagnose,
    format_pair,
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
    ParameterValues,
    element_values,
    find_collidable_geoms,
    joint_name,
    place_of_geom,
)
from pupper_analysis.models.stated.model import UrdfModel
from pupper_analysis.robot.compare.differences import VERSION_NAMES, Difference, Effect
from pupper_analysis.robot.contact import find_acting_contacts, list_contact_bodies

ElementKey = tuple[str, str]
"""Tag and name of an element."""


@dataclass(frozen=True, eq=False)
class ModelElement:
    """Element of a model file (shape, option, keyframe, actuator ...), with compared values.

    Attributes:
        values: {attribute: numbers}.
        place: Function that returns file and line of an attribute, or else of the element.
        shape: Shape of a geom or a URDF's collision; None for other elements.
        touches: Whether a geom can collide, by ``contype`` and ``conaffinity`` or in a pair; True
            for other elements.
        owners: Body of a geom, link of a collision, geoms of a pair, or bodies of an exclude.
    """

    values: Mapping[str, ParameterValues]
    place: Callable[[str], Place]
    shape: Shape | None = None
    touches: bool = True
    owners: tuple[str, ...] = ()


_NUM_FRICTION_COEFFICIENTS: Final = {1: 0, 3: 1, 4: 2, 6: 3}
"""{condim of a contact: number of friction coefficients that have an effect}. Of a geom, the
coefficients for the largest condim in the model, at least 3, are compared.
"""


def list_elements(file: MjcfFile) -> dict[ElementKey, ModelElement]:
    """List the elements of an MJCF that `diff` compares: {(tag, name): element}.

    Examples are geoms, contact pairs, options, keyframes and actuators.

    Args:
        file: File that MuJoCo compiles.
    """
    model = file.model
    found: dict[ElementKey, ModelElement] = {}
    names = list_geom_names(model)
    touching = find_collidable_geoms(model)
    condim = max((3, *model.geom_condim.tolist()))
    for geom, name in enumerate(names):
        values = element_values(model, "geom", geom)
        values["friction"] = values["friction"][: _NUM_FRICTION_COEFFICIENTS[condim]]
        place = partial(place_of_geom, file, geom)
        body = model.body(int(model.geom_bodyid[geom])).name
        found["geom", name] = ModelElement(
            values, place, read_shape(model, geom), geom in touching, (body,)
        )
    pairs = _find_places_by_ends(file, "pair", "geom")
    excludes = _find_places_by_ends(file, "exclude", "body")
    for pair in range(model.npair):
        ends = names[int(model.pair_geom1[pair])], names[int(model.pair_geom2[pair])]
        values = element_values(model, "pair", pair)
        at = _make_constant_finder(pairs.get(join_names(ends), Place(file.path)))
        found["pair", join_names(ends)] = ModelElement(values, at, owners=ends)
    for signature in model.exclude_signature.tolist():
        ends = model.body(signature >> 16).name, model.body(signature & 0xFFFF).name
        at = _make_constant_finder(excludes.get(join_names(ends), Place(file.path)))
        found["exclude", join_names(ends)] = ModelElement({}, at, owners=ends)
    stated = next((place for _, place in file.elements("option")), Place(file.path))
    found["option", "option"] = ModelElement(
        element_values(model, "option", 0), _make_attribute_finder(file, "option", stated)
    )
    flags = next((place for _, place in file.elements("flag")), stated)
    for bit in (*DISABLE_BITS, *ENABLE_BITS):
        enabled = {ENABLED_WORD: (float(has_flag(model, bit)),)}
        found["flag", get_flag_name(bit)] = ModelElement(enabled, _make_constant_finder(flags))
    found |= _list_tree_elements(file)
    for key in range(model.nkey):
        name = model.key(key).name or f"#{key}"
        found["key", name] = ModelElement(
            element_values(model, "key", key), _make_constant_finder(file.place("key", name))
        )
    return found


def _list_tree_elements(file: MjcfFile) -> dict[ElementKey, ModelElement]:
    """List the joints, actuators, tendons and equalities of an MJCF: {(tag, name): element}."""
    model, found = file.model, dict[ElementKey, ModelElement]()
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
            place = partial(_find_element_place, file, kind, name, row)
            found[kind, name] = ModelElement(element_values(model, kind, row), place)
    return found


def _find_element_place(file: MjcfFile, kind: str, name: str, row: int, word: str) -> Place:
    """Return file and line of an attribute (``word``) of an element, or else of the element.

    An element without a name is found by the number ``row`` among the elements of the same kind.
    """
    if name.startswith("#"):
        return file.place_by_number(kind, row)
    return file.find_attribute(kind, name, (word,)) or file.place(kind, name)


def join_names(ends: Iterable[str]) -> str:
    """Return the name of a contact pair or exclusion: ``a and b``, in alphabetical order."""
    return " and ".join(sorted(ends))


def _find_places_by_ends(file: MjcfFile, tag: str, end: str) -> dict[str, Place]:
    """Return {names of both ends, joined by `join_names`: file and line} of pairs or exclusions.

    MuJoCo sorts these elements: the order in the model differs from the order in the file.

    Args:
        file: File.
        tag: ``"pair"`` or ``"exclude"``.
        end: Attribute of an end, without the number 1 or 2: ``"geom"`` or ``"body"``.
    """
    return {
        join_names(words[f"{end}{number}"] for number in (1, 2)): place
        for words, place in file.elements(tag)
        if {f"{end}1", f"{end}2"} <= set(words)
    }


def list_geom_names(model: mujoco.MjModel) -> list[str]:
    """Return a name for each geom of a model, in the model's order.

    The name of an unnamed geom consists of the body and the number of the geom in the body: ``calf
    #2``.
    """
    names, seen = [], dict[int, int]()
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        seen[body] = seen.get(body, 0) + 1
        called = model.body(body).name or f"body #{body}"
        names.append(model.geom(geom).name or f"{called} #{seen[body]}")
    return names


def list_collisions(model: UrdfModel) -> dict[ElementKey, ModelElement]:
    """Return the collision shapes of a URDF: {("collision", link or "link #2"): element}."""
    found: dict[ElementKey, ModelElement] = {}
    for link in model.links.values():
        touching = [shape for shape in link.shapes if shape.collides]
        for number, shape in enumerate(touching, 1):
            name = link.name if number == 1 else f"{link.name} #{number}"
            place = model.file.place_of_nth(link.name, "collision", number - 1)
            found["collision", name] = ModelElement(
                {}, _make_constant_finder(place), shape, owners=(link.name,)
            )
    return found


def _make_attribute_finder(file: MjcfFile, tag: str, otherwise: Place) -> Callable[[str], Place]:
    """Return a function from the name of an attribute to its place in the elements ``tag``.

    The function returns ``otherwise`` if no element ``tag`` has the attribute.
    """

    def place(word: str) -> Place:
        """Return file and line of the first element that has the attribute ``word``."""
        stated = (where for words, where in file.elements(tag) if word in words)
        return next(stated, otherwise)

    return place


def _make_constant_finder(place: Place) -> Callable[[str], Place]:
    """Return a function of an attribute that returns ``place`` for every attribute."""
    return lambda _: place


ENABLED_WORD: Final = "enabled"
"""Key in `ModelElement.values` for a ``<flag>`` of an MJCF: the value is 1 if the flag is enabled,
0 if the flag is disabled."""

DISABLE_BITS: Final = tuple(
    bit for bit in mujoco.mjtDisableBit.__members__.values() if bit.name.startswith("mjDSBL_")
)
"""MuJoCo's disable flags. Each disables a feature that is on by default."""

ENABLE_BITS: Final = tuple(
    bit for bit in mujoco.mjtEnableBit.__members__.values() if bit.name.startswith("mjENBL_")
)
"""MuJoCo's enable flags. Each enables a feature that is off by default."""


def get_flag_name(bit: Any) -> str:
    """Return the attribute of ``<flag>`` for a MuJoCo bit: ``gravity`` for ``mjDSBL_GRAVITY``."""
    return str(bit.name).split("_", 1)[1].lower()


def has_flag(model: mujoco.MjModel, bit: Any) -> bool:
    """Return True if the feature of a MuJoCo disable or enable bit is enabled in a model."""
    if isinstance(bit, mujoco.mjtDisableBit):
        return not model.opt.disableflags & bit.value
    return bool(model.opt.enableflags & bit.value)


MIN_FELT_MOTION = 1e-4
"""Largest difference of a simulated coordinate [m, rad, 1 for quaternions], or of the final
height of the base or CoM [m], between two versions that counts as no effect. Chosen, not tuned.
"""

SIMULATION_SECONDS = 2.0
"""Largest duration of a simulation of both versions [s]. Chosen, not tuned.
"""

_MAX_SIMULATION_STEPS = 4000
"""Largest number of time steps of a simulation; with a small time step the simulated time is
shorter. Chosen, to bound the time."""

_NUM_SAMPLES = 200
"""Number of samples of a simulation that are compared: a sample per 10 ms of a full
`SIMULATION_SECONDS`. Chosen, not tuned.
"""

_MIN_FALL_HEIGHT = 1.0
"""Difference [m] by which the base or CoM of the new version ends below the old version, above
which the new robot is reported as falling through or off the floor. Chosen, not tuned.
"""

NUMBER_RTOL = 1e-9
"""Relative difference, in addition to an absolute difference of 1e-12, up to which two numbers of
elements count as equal: rounding by programs that rewrite files. Chosen, not tuned."""

SURFACE_ATOL = 1e-6
"""Largest distance between the surfaces of two shapes [m] with which the shapes count as equal. For
a shape of unknown extent, the tolerance of position [m], rotation matrix [1] and size [m]. Chosen,
not tuned."""

SHAPE_WORD: Final = "shape"
"""Name for the shape of a geom (type, size and pose together) in place of an attribute's name."""


@dataclass(frozen=True, eq=False)
class ElementDifference(Difference):
    """Equal change of an attribute in several elements, or an added or removed element.

    Attributes:
        consequences: Displacement of a surface, and effects in a simulation if there is no other
            change.
        places: File and line of the first element in both files; None if missing.
    """

    consequences: tuple[Diagnostic, ...] = ()
    places: tuple[Place | None, Place | None] = (None, None)


def measure_surface_distance(first_shape: Shape, second_shape: Shape) -> float:
    """Estimate the largest distance [m] between the surfaces of two shapes (convex hulls).

    The result is a lower bound: the largest difference of the support functions of both shapes
    along `COMPARISON_DIRECTIONS`. If the extent of a shape is unknown, the result is 0 for equal
    shapes and infinite for different shapes.
    """
    first, second = (shape.support(COMPARISON_DIRECTIONS) for shape in (first_shape, second_shape))
    if first is not None and second is not None:
        return float(np.abs(first - second).max())
    ends = [
        (shape.pose.position, shape.pose.rotation, shape.size)
        for shape in (first_shape, second_shape)
    ]
    near = (
        np.allclose(first_value, second_value, rtol=0, atol=SURFACE_ATOL)
        for first_value, second_value in zip(*ends, strict=True)
    )
    return (
        0.0
        if first_shape.kind == second_shape.kind
        and len(first_shape.size) == len(second_shape.size)
        and all(near)
        else math.inf
    )


def match_elements(
    old: Mapping[ElementKey, ModelElement],
    new: Mapping[ElementKey, ModelElement],
    bodies: Mapping[str, str],
    joints: Mapping[str, str],
) -> dict[ElementKey, ModelElement]:
    """Match the elements of two versions: return the new elements under the old names.

    Geoms without a common name are matched by equal values, by equal shape, and by order, so that a
    different order in the file is no change.

    Args:
        old: Elements of the old file.
        new: Elements of the new file.
        bodies: {body of the new file: name in the old file}.
        joints: {joint of the new file: name in the old file}.

    Returns:
        {(tag, name of the corresponding old element): new element}. New elements without a
        counterpart are included.
    """
    matched: dict[ElementKey, ModelElement] = {}
    new_names: dict[str, str] = {}
    taken = {name for _, name in (*old, *new)}
    for (kind, body), (old_keys, new_keys) in _list_unnamed_shapes(old, new, bodies).items():
        pairs = _match_similar_shapes(old_keys, new_keys, old, new)
        for key in new_keys:
            name = pairs[key][1] if key in pairs else key[1]
            if key not in pairs and ((kind, name) in old or (kind, name) in matched):
                name = next(free for n in count(2) if (free := f"{body} #{n}") not in taken)
                taken.add(name)
            matched[kind, name], new_names[key[1]] = new[key], name
    for (kind, name), element in new.items():
        if element.shape is not None and name in new_names:
            continue
        if kind in ("pair", "exclude"):
            ends = new_names if kind == "pair" else bodies
            name = join_names(ends.get(end, end) for end in element.owners)
        elif kind == "joint":
            name = joints.get(name, name)
        matched[kind, name] = element
    return matched


def align_keyframes(
    old: mujoco.MjModel,
    new: mujoco.MjModel,
    elements: Mapping[ElementKey, ModelElement],
    joints: Mapping[str, str],
) -> dict[ElementKey, ModelElement]:
    """Return ``elements`` with the numbers of each keyframe in the order of the old model.

    The numbers of a keyframe belong to joints and actuators in the order of the file: equal numbers
    in another order of the joints are another pose. Numbers are left in the order of the new model
    if joints or actuators were added or removed.

    Args:
        old: Compiled model of the old file.
        new: Compiled model of the new file.
        elements: Elements of the new file.
        joints: {joint of the new file: name in the old file}.
    """
    before, after = _list_keyframe_entries(old, {}), _list_keyframe_entries(new, joints)
    orders = {
        word: [after[word].index(entry) for entry in before[word]]
        for word in before
        if sorted(before[word]) == sorted(after[word])
    }
    aligned = dict(elements)
    for key, element in elements.items():
        if key[0] == "key":
            values = {
                word: tuple(numbers[index] for index in orders[word]) if word in orders else numbers
                for word, numbers in element.values.items()
            }
            aligned[key] = replace(element, values=values)
    return aligned


def _list_keyframe_entries(
    model: mujoco.MjModel, joints: Mapping[str, str]
) -> dict[str, list[tuple[str, int]]]:
    """Return {attribute of a keyframe: (joint or actuator, number in the element) per entry}.

    ``joints`` is {name of a joint in the model: name to use instead}.
    """
    entries: dict[str, list[tuple[str, int]]] = {
        word: [] for word in ("qpos", "qvel", "ctrl", "act")
    }
    for joint in range(model.njnt):
        name = joint_name(model, joint)
        name = joints.get(name, name)
        kind = int(model.jnt_type[joint])
        sizes = {JointKind.FREE: (7, 6), JointKind.BALL: (4, 3)}.get(JointKind(kind), (1, 1))
        for word, size in zip(("qpos", "qvel"), sizes, strict=True):
            entries[word] += [(name, number) for number in range(size)]
    for actuator in range(model.nactuator):
        name = model.actuator(actuator).name or f"#{actuator}"
        controls = int(model.actuator_ctrlnum[actuator])
        states = int(model.actuator_actnum[actuator])
        entries["ctrl"] += [(name, number) for number in range(controls)]
        entries["act"] += [(name, number) for number in range(states)]
    return entries


def _list_unnamed_shapes(
    old: Mapping[ElementKey, ModelElement],
    new: Mapping[ElementKey, ModelElement],
    bodies: Mapping[str, str],
) -> dict[ElementKey, tuple[list[ElementKey], list[ElementKey]]]:
    """List the shapes of each body that cannot be matched by name: {(tag, body): (old, new) keys}.

    Bodies have the names of the old version; ``bodies`` is {body of the new file: name in the old
    file}.
    """
    shapes_by_body: dict[ElementKey, tuple[list[ElementKey], list[ElementKey]]] = {}
    for number, elements in enumerate((old, new)):
        for key, element in elements.items():
            names = {
                counterpart.shape.name
                if (counterpart := side.get(key)) and counterpart.shape
                else ""
                for side in (old, new)
            }
            if element.shape is not None and names != {key[1]}:
                body = element.owners[0]
                body = bodies.get(body, body) if number else body
                shapes_by_body.setdefault((key[0], body), ([], []))[number].append(key)
    return shapes_by_body


def _match_similar_shapes(
    old_keys: list[ElementKey],
    new_keys: list[ElementKey],
    old: Mapping[ElementKey, ModelElement],
    new: Mapping[ElementKey, ModelElement],
) -> dict[ElementKey, ElementKey]:
    """Match shapes by equal values, by equal shape, or by equal ability to collide: {new: old}."""

    def is_of_one_shape(first: ModelElement, second: ModelElement) -> bool:
        """Return True if both shapes have equal kind and nearly equal surfaces."""
        assert first.shape is not None
        assert second.shape is not None
        return (
            first.shape.kind == second.shape.kind
            and measure_surface_distance(first.shape, second.shape) <= SURFACE_ATOL
        )

    def is_alike(first: ModelElement, second: ModelElement) -> bool:
        """Return True if old and new element agree in numbers, shape and ability to collide."""
        same = all(_numbers_agree(*values) for values in _pair_numbers(first, second).values())
        return same and first.touches == second.touches and is_of_one_shape(first, second)

    def touches_alike(first: ModelElement, second: ModelElement) -> bool:
        """Return True if old and new element can both collide, or can both not collide."""
        return first.touches == second.touches

    matches: dict[ElementKey, ElementKey] = {}
    remaining = list(old_keys)
    for test in (is_alike, is_of_one_shape, touches_alike):
        for key in new_keys:
            near = (
                candidate
                for candidate in remaining
                if key not in matches and test(old[candidate], new[key])
            )
            if (match := next(near, None)) is not None:
                matches[key] = match
                remaining.remove(match)
    return matches


def _pair_numbers(
    first: ModelElement, second: ModelElement
) -> dict[str, tuple[ParameterValues, ParameterValues]]:
    """Pair the numbers of two elements: {attribute: (first, second)}."""
    pairs = {}
    for word in dict.fromkeys((*first.values, *second.values)):
        first_numbers, second_numbers = first.values.get(word, ()), second.values.get(word, ())
        if word == "friction":  # coefficients added by another condim are not compared
            first_numbers, second_numbers = (
                values[: min(len(first_numbers), len(second_numbers))]
                for values in (first_numbers, second_numbers)
            )
        pairs[word] = first_numbers, second_numbers
    return pairs


def find_changed_elements(
    old: Mapping[ElementKey, ModelElement],
    new: Mapping[ElementKey, ModelElement],
) -> Iterator[ElementDifference]:
    """Yield the changes of elements between two versions; also added or removed elements.

    Elements with an equal change may form a common difference. Added and removed elements of the
    kinds `_TREE_ELEMENTS` are left out.

    Args:
        old: Elements of the old version.
        new: Elements of the new version, under the old names (`match_elements`).
    """
    alike: dict[tuple[Any, ...], list[ElementKey]] = {}
    for key in dict.fromkeys((*old, *new)):
        old_element, new_element = old.get(key), new.get(key)
        if not any(
            element is not None and element.touches for element in (old_element, new_element)
        ):
            continue  # visual only
        if old_element is None or new_element is None:
            if key[0] not in _TREE_ELEMENTS:
                alike.setdefault((key[0], "", old_element is None, key), []).append(key)
            continue
        own = (key,) if key[0] == "flag" else ()  # each flag has another meaning
        for word, (old_numbers, new_numbers) in _pair_numbers(old_element, new_element).items():
            if not _numbers_agree(old_numbers, new_numbers):
                alike.setdefault((key[0], word, old_numbers, new_numbers, *own), []).append(key)
        if (
            old_element.shape is not None
            and new_element.shape is not None
            and measure_surface_distance(old_element.shape, new_element.shape) > SURFACE_ATOL
        ):
            alike.setdefault(
                (key[0], SHAPE_WORD, *_make_shape_key(old_element.shape, new_element.shape)), []
            ).append(key)
    for (kind, word, *_), keys in alike.items():
        yield _make_difference(kind, word, keys, old, new)


_COMPILER_ATTRIBUTES: Final = {
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
"""{field of the compiler in MuJoCo's spec: attribute of ``<compiler>``} of the settings that are
compared."""


def find_changed_compiler_settings(old: MjcfFile, new: MjcfFile) -> Iterator[ElementDifference]:
    """Yield a difference for each changed attribute of ``<compiler>`` that is compared.

    A compiler setting changes the meaning of other lines, for example the unit of angles.
    """
    for name, word in _COMPILER_ATTRIBUTES.items():
        settings = tuple(getattr(file.spec.compiler, name) for file in (old, new))
        old_setting, new_setting = (
            _format_setting(name, *pair) for pair in (settings, settings[::-1])
        )
        if old_setting == new_setting:
            continue
        message = diagnose(
            "mjcf-element-differs",
            subject=("compiler", word),
            others=(),
            what="",
            one=old_setting,
            two=new_setting,
            **VERSION_NAMES.message_values,
        )
        places = [
            next((at for words, at in file.elements("compiler") if word in words), None)
            for file in (old, new)
        ]
        yield ElementDifference(
            kind="compiler",
            element=word,
            urdf=old_setting,
            mjcf=new_setting,
            unit="",
            diagnostic=message,
            effects={},
            places=(places[0], places[1]),
        )


def _format_setting(name: str, value: Any, other: Any) -> str:
    """Format a compiler setting as in an MJCF; ``other`` is the setting of the other version."""
    if name == "degree":
        return "degree" if value else "radian"
    if isinstance(value, bool | np.bool_):
        return str(bool(value)).lower()
    if hasattr(value, "name"):
        return str(value.name).rpartition("_")[2].lower()
    if isinstance(value, float):
        return format_pair(value, other, ".6g")[0]
    return ("" if name == "eulerseq" else " ").join(map(str, value))


_TREE_ELEMENTS: Final = ("joint", "actuator", "tendon", "equality")
"""Tags of MJCF elements whose addition or removal the comparison of elements does not report, since
joints, and values outside the tree, are compared elsewhere."""


def _make_shape_key(old_shape: Shape, new_shape: Shape) -> tuple[object, ...]:
    """Return a key that groups equal changes of different shapes."""
    ends = [(shape.pose.position, shape.pose.rotation) for shape in (old_shape, new_shape)]
    if all(np.array_equal(here, there) for here, there in zip(*ends, strict=True)):
        return old_shape.kind, tuple(old_shape.size), new_shape.kind, tuple(new_shape.size)
    return str(old_shape.diagnostic), str(new_shape.diagnostic)


def _numbers_agree(first: ParameterValues, second: ParameterValues) -> bool:
    """Return True if two lists of numbers agree within `NUMBER_RTOL` (relative) plus 1e-12."""
    return len(first) == len(second) and np.allclose(first, second, rtol=NUMBER_RTOL, atol=1e-12)


def _make_difference(
    kind: str,
    word: str,
    keys: list[ElementKey],
    old: Mapping[ElementKey, ModelElement],
    new: Mapping[ElementKey, ModelElement],
) -> ElementDifference:
    """Create the difference that reports an equal change of an attribute in all ``keys``.

    ``word`` is the attribute; "" for added or removed elements.
    """
    names = tuple(name for _, name in keys)
    old_element, new_element = old.get(keys[0]), new.get(keys[0])
    before = _format_value(old_element, word, new_element)
    after = _format_value(new_element, word, old_element)
    whole = kind in ("option", "flag")  # keys contains a single element
    message = diagnose(
        "mjcf-element-differs",
        subject=(kind, word if kind == "option" else names[0]),
        others=() if whole else names[1:],
        what="" if whole else Term(word) if word in _TRANSLATED_WORDS else word,
        one=before,
        two=after,
        **VERSION_NAMES.message_values,
    )
    consequences: tuple[Diagnostic, ...] = ()
    shapes = [
        element.shape
        for element in (old_element, new_element)
        if element is not None and element.shape
    ]
    if word == SHAPE_WORD and math.isfinite(distance := measure_surface_distance(*shapes)):
        moved = diagnose("surface-moves", distance=Quantity(distance, "m"))
        consequences = (moved,)
    return ElementDifference(
        kind=kind,
        element=word if kind == "option" else names[0],
        urdf=_to_plain(old_element, word),
        mjcf=_to_plain(new_element, word),
        unit=next(
            (row.unit for row in ELEMENT_ATTRIBUTES if (row.element, row.word) == (kind, word)), ""
        ),
        diagnostic=message,
        effects={},
        consequences=consequences,
        places=(
            old_element.place(word) if old_element else None,
            new_element.place(word) if new_element else None,
        ),
    )


_ENUM_TYPES: Final = {
    "integrator": mujoco.mjtIntegrator,
    "cone": mujoco.mjtCone,
    "solver": mujoco.mjtSolver,
    "jacobian": mujoco.mjtJacobian,
    "dyntype": mujoco.mjtDyn,
    "gaintype": mujoco.mjtGain,
    "biastype": mujoco.mjtBias,
}
"""{attribute: MuJoCo enumeration of the values}."""

_TRANSLATED_WORDS: Final = (SHAPE_WORD, "friction")
"""Attributes whose names messages translate; other names are printed as in the MJCF."""


def _format_value(element: ModelElement | None, word: str, other: ModelElement | None) -> object:
    """Return the value of an attribute for a message, with enough digits to differ from ``other``.

    ``word`` is the attribute; "" for the element itself.
    """
    if element is None:
        return Term("none")
    if not word:
        return Term("present") if element.shape is None else element.shape.diagnostic
    if word == SHAPE_WORD:
        assert element.shape is not None
        return element.shape.diagnostic
    numbers = element.values.get(word, ())
    if word in _ENUM_TYPES and numbers:
        return _ENUM_TYPES[word](int(numbers[0])).name.split("_", 1)[1].lower()
    if word == ENABLED_WORD:
        return Term("enabled" if numbers[0] else "disabled")
    others = other.values.get(word, ()) if other is not None else ()
    if len(others) != len(numbers):
        others = numbers
    pairs = zip(numbers, others, strict=True)
    return " ".join(format_pair(*pair, ".6g")[0] for pair in pairs) or Term("none")


def _to_plain(element: ModelElement | None, word: str) -> object:
    """Return the value of an attribute of an element as data for JSON; None without an element.

    For an empty name ``word`` or `SHAPE_WORD`, the result describes the shape, if any.
    """
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
class _SimulatedRun:
    """Recorded motion of a simulated version of a model.

    Attributes:
        seconds: Duration [s].
        qpos: Positions of the selected joints, shape (samples, n) [m, rad, quaternion]; NaN after
            divergence.
        slid: Whether each coordinate is a length, shape (n,).
        height: Height of the body of the first selected free joint, shape (samples,) [m]; without
            free joint, of the CoM of the moving bodies in the trees of the selected joints.
        has_base: Whether ``height`` belongs to the body of a free joint.
        friction: Smallest friction coefficient of a contact with the world at the end; None without
            contact.
    """

    seconds: float
    qpos: Array
    slid: NDArray[np.bool_]
    height: Array
    has_base: bool
    friction: float | None


ROUNDING_NUDGE = 1e-9
"""Offset of all initial velocities [rad/s, m/s] in a repeated simulation of the old version, to
test whether rounding can cause the difference between the versions. Chosen, not tuned.
"""


def _serialise_model(model: mujoco.MjModel) -> bytes:
    """Return the binary form (MJB) of a model, to test whether two models are equal."""
    image = np.empty(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, image)
    return image.tobytes()


MOTION_QUANTITY: Final = "simulated motion"
"""Name under which the largest difference of a coordinate between the simulations of both versions
is reported."""


@dataclass(frozen=True, eq=False)
class SimulatedPair:
    """Compiled models of two versions of an MJCF, for the comparison by simulation.

    Attributes:
        old: Model of the old file.
        new: Model of the new file.
        has_added_floor: Whether the same ground was added to both models, since neither has a
            ground.
    """

    old: mujoco.MjModel
    new: mujoco.MjModel
    has_added_floor: bool

    @staticmethod
    def from_files(old: MjcfFile, new: MjcfFile) -> SimulatedPair:
        """Compile two MJCFs for simulation; add the same ground to both if neither has a ground.

        The ground is added only if both models have a free joint.
        """
        models = old.model, new.model
        need_floor = all(
            has_free_joint(model) and not _find_static_geoms(model).any() for model in models
        )
        if not need_floor:
            return SimulatedPair(old.model, new.model, has_added_floor=False)
        height = min(map(_choose_ground_height, models))
        trees = [SpecTree(file.spec.copy()) for file in (old, new)]
        floors = [tree.add_floor(height) for tree in trees]
        # The feet of the old file touch the ground of both models.
        floors[1].conaffinity = floors[0].conaffinity
        before, after = (
            compile_spec(tree.spec, file.path) for tree, file in zip(trees, (old, new), strict=True)
        )
        return SimulatedPair(before, after, has_added_floor=True)

    def compute_effects(
        self, *, explained: bool
    ) -> tuple[dict[str, Effect], tuple[Diagnostic, ...]]:
        """Simulate both versions; return the differences of the motions as effects and messages.

        Args:
            explained: True if the comparison of the files has found a change. If False, effects
                that rounding errors can cause are left out.

        Returns:
            {quantity: largest difference of a joint coordinate [m, rad, 1 for quaternions]};
            messages. Both may be empty, for example if the models have no common joint.
        """
        old, new = self.old, self.new
        if not self._common_joints or (
            not explained and _serialise_model(old) == _serialise_model(new)
        ):
            return {}, ()
        before, after = self._simulate_joints(old), self._simulate_joints(new)
        effects, messages = self._compare_pair(before, after)
        if explained or not effects:
            return (effects, messages) if explained else ({}, ())
        nudged, _ = self._compare_pair(before, self._simulate_joints(old, ROUNDING_NUDGE))
        # 0.1: after divergence, deviations from rounding and from changes have any ratio.
        rounding = (
            nudged and nudged[MOTION_QUANTITY].deviation > 0.1 * effects[MOTION_QUANTITY].deviation
        )
        return ({}, ()) if rounding else (effects, messages)

    @cached_property
    def _common_joints(self) -> list[str]:
        """Names of the joints that both models have."""
        names = [
            [joint_name(model, n) for n in range(model.njnt)] for model in (self.old, self.new)
        ]
        return [name for name in names[0] if name in names[1]]

    def _simulate_joints(self, model: mujoco.MjModel, nudge: float = 0.0) -> _SimulatedRun:
        """Simulate a model, and record the common joints.

        ``nudge`` is an offset of all initial velocities [rad/s, m/s].
        """
        number = {joint_name(model, n): n for n in range(model.njnt)}
        return _simulate_model(model, [number[name] for name in self._common_joints], nudge)

    def _compare_pair(
        self, before: _SimulatedRun, after: _SimulatedRun
    ) -> tuple[dict[str, Effect], tuple[Diagnostic, ...]]:
        """Compare the simulations of both versions; return effects and messages."""
        seconds = Quantity(min(before.seconds, after.seconds), "s")
        start = self.old.key(0).name if self.old.nkey else ""
        return _compare_runs(
            before, after, {"seconds": seconds, "start": start, "laid": self.has_added_floor}
        )


def _find_static_geoms(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Return a mask of the geoms that are fixed to the world and can collide."""
    touch = (model.geom_contype | model.geom_conaffinity) != 0
    touch[[*model.pair_geom1, *model.pair_geom2]] = True
    still: NDArray[np.bool_] = touch & (model.body_weldid[model.geom_bodyid] == 0)
    return still


def _choose_ground_height(model: mujoco.MjModel) -> float:
    """Choose the height [m] at which a ground is added to a file without ground.

    The height is 0, so feet may start below the ground. If the lowest point of the geoms is below 0
    by more than a quarter of the CoM's height above this point, the height is that of the point.
    """
    data = make_start_data(model)
    middle, half = model.geom_aabb[:, :3], model.geom_aabb[:, 3:]
    up = data.geom_xmat[:, 6:]
    reach = data.geom_xpos[:, 2] + (up * middle).sum(axis=1) - (np.abs(up) * half).sum(axis=1)
    lowest, com = float(reach.min(initial=0.0)), float(data.subtree_com[0][2])
    return lowest if -lowest > 0.25 * (com - lowest) else 0.0


def _simulate_model(
    model: mujoco.MjModel, joints: Sequence[int], nudge: float = 0.0
) -> _SimulatedRun:
    """Simulate a model from the first keyframe, or from ``qpos0`` if there is none.

    ``joints`` are the ids of the recorded joints; ``nudge`` is an offset of all initial velocities
    [rad/s, m/s].
    """
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qvel += nudge
    step = float(model.opt.timestep)
    seconds = min(SIMULATION_SECONDS, _MAX_SIMULATION_STEPS * step)
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
    free = [joint for joint in joints if model.jnt_type[joint] == JointKind.FREE]
    qpos, heights, done = [], [], 0
    with silence_mujoco():
        for sample in range(1, _NUM_SAMPLES + 1):
            wanted = round(sample * seconds / _NUM_SAMPLES / step)
            try:
                mujoco.mj_step(model, data, nstep=wanted - done)
            except mujoco.FatalError:
                data.qpos[:] = np.nan
            done = wanted
            lost = not data.time > (wanted - 0.5) * step  # MuJoCo resets time after a divergence
            qpos.append(np.full(len(places), np.nan) if lost else data.qpos[places])
            height = (
                float(data.xpos[model.jnt_bodyid[free[0]], 2])
                if free
                else float(masses @ data.xipos[:, 2]) / max(float(masses.sum()), 1e-300)
            )
            heights.append(np.nan if lost else height)
    return _SimulatedRun(
        seconds,
        np.array(qpos),
        np.array(slid, dtype=bool),
        np.array(heights),
        bool(free),
        _find_min_friction(model, data),
    )


def _find_min_friction(model: mujoco.MjModel, data: mujoco.MjData) -> float | None:
    """Return the smallest friction coefficient of the contacts with the world; None without any."""
    weld_ids = model.body_weldid[list_contact_bodies(model, data)]
    at_world = find_acting_contacts(data) & (weld_ids == 0).any(axis=1)
    found = [
        float(contact.friction[0]) if contact.dim > 1 else 0.0
        for contact, counts in zip(data.contact, at_world, strict=True)
        if counts
    ]
    return min(found, default=None)


def _compare_runs(
    before: _SimulatedRun, after: _SimulatedRun, where: Mapping[str, Any]
) -> tuple[dict[str, Effect], tuple[Diagnostic, ...]]:
    """Compare the recorded motions of two simulations; return the difference and the messages.

    ``where`` are further fields of the message: duration, keyframe, and whether a ground was added.

    Returns:
        {`MOTION_QUANTITY`: largest difference of a coordinate [m, rad, 1 for quaternions]}, empty
        up to `MIN_FELT_MOTION`; messages.
    """
    if before.qpos.shape != after.qpos.shape:
        return {}, ()
    same_end = np.isnan(before.qpos) & np.isnan(after.qpos)
    offsets = np.where(same_end, 0.0, np.abs(after.qpos - before.qpos))
    offsets = np.nan_to_num(offsets, nan=math.inf).max(axis=0, initial=0.0)
    moved, turned = (float(offsets[kind].max(initial=0.0)) for kind in (after.slid, ~after.slid))
    worst = max(moved, turned)
    facts = []
    if worst > MIN_FELT_MOTION:
        rise = float(after.height[-1] - before.height[-1])
        is_moderate = rise >= -_MIN_FALL_HEIGHT and abs(rise) > MIN_FELT_MOTION
        facts.append(
            diagnose(
                "simulation-changes",
                diverges=math.isnan(rise),
                higher=Quantity(rise, "m") if rise > MIN_FELT_MOTION else None,
                lower=Quantity(-rise, "m")
                if -_MIN_FALL_HEIGHT <= rise < -MIN_FELT_MOTION
                else None,
                falls=Quantity(-rise, "m") if rise < -_MIN_FALL_HEIGHT else None,
                base=is_moderate and after.has_base,
                com=is_moderate and not after.has_base,
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
        old_angle, new_angle = (math.atan(run.friction or 0.0) for run in (before, after))
        facts.append(
            diagnose("slides-from", one=Quantity(old_angle, "rad"), two=Quantity(new_angle, "rad"))
        )
    if not facts:
        return {}, (diagnose("simulation-unchanged", **where),)
    effects = {MOTION_QUANTITY: Effect(worst, worst, math.inf)} if worst > MIN_FELT_MOTION else {}
    return effects, tuple(facts)
