"""What an MJCF states besides bodies and joints, and a URDF of what touches: element by element.

Geoms, contact pairs, options, keyframes: what touches what, how MuJoCo steps and where it begins
are part of a robot as its joints are. The numbers are those of
`models.attributes.ELEMENT_ATTRIBUTES`, as MuJoCo compiles them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import mujoco

from pupper_analysis.models.mjcf import equality_name
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.places import Place
from pupper_analysis.models.shapes import Shape, read_shape
from pupper_analysis.models.stated.elements import (
    Value,
    element_values,
    place_of_geom,
    touching_geoms,
)
from pupper_analysis.models.stated.mjcf import joint_name
from pupper_analysis.models.stated.model import UrdfModel

Key = tuple[str, str]
"""An element's tag and name."""


@dataclass(frozen=True, eq=False)
class Element:
    """An element of an MJCF.

    Attributes:
        row: Its row in MuJoCo's arrays.
        values: {word: its numbers}.
        place: Returns where a word of it is stated, in itself or a default class; where it stands
            itself, if it is not.
        shape: That of a geom.
        touches: Whether a geom can touch anything, by ``contype`` and ``conaffinity`` or in a pair.
        of: The body of a geom, the two geoms of a pair, or the two bodies of an exclude.
    """

    row: int
    values: Mapping[str, Value]
    place: Callable[[str], Place]
    shape: Shape | None = None
    touches: bool = True
    of: tuple[str, ...] = ()


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
    names = geom_names(model)
    touching = touching_geoms(model)
    condim = max((3, *model.geom_condim.tolist()))
    for geom, name in enumerate(names):
        values = element_values(model, "geom", geom)
        values["friction"] = values["friction"][: _FRICTION_OF[condim]]
        place = partial(place_of_geom, file, geom)
        body = model.body(int(model.geom_bodyid[geom])).name
        found["geom", name] = Element(
            geom, values, place, read_shape(model, geom), geom in touching, (body,)
        )
    pairs, excludes = ([place for _, place in file.elements(tag)] for tag in ("pair", "exclude"))
    for pair in range(model.npair):
        ends = names[int(model.pair_geom1[pair])], names[int(model.pair_geom2[pair])]
        values = element_values(model, "pair", pair)
        at = _at(_nth(pairs, pair, model.npair, file))
        found["pair", both_of(ends)] = Element(pair, values, at, of=ends)
    for exclude, signature in enumerate(model.exclude_signature.tolist()):
        ends = model.body(signature >> 16).name, model.body(signature & 0xFFFF).name
        at = _at(_nth(excludes, exclude, model.nexclude, file))
        found["exclude", both_of(ends)] = Element(exclude, {}, at, of=ends)
    stated = next((place for _, place in file.elements("option")), Place(file.path))
    found["option", "option"] = Element(
        0, element_values(model, "option", 0), _stating(file, "option", stated)
    )
    flags = next((place for _, place in file.elements("flag")), stated)
    for bit in (*DISABLE_BITS, *ENABLE_BITS):
        enabled = {ENABLED: (float(has_flag(model, bit)),)}
        found["flag", flag_name(bit)] = Element(0, enabled, _at(flags))
    found |= _bound(file)
    for key in range(model.nkey):
        name = model.key(key).name or f"#{key}"
        found["key", name] = Element(
            key, element_values(model, "key", key), _at(file.place("key", name))
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
            found[kind, name] = Element(row, element_values(model, kind, row), place)
    return found


def _place_of(file: MjcfFile, kind: str, name: str, row: int, word: str) -> Place:
    if name.startswith("#"):
        return file.numbered(kind, row)
    return file.stated(kind, name, (word,)) or file.place(kind, name)


def both_of(ends: Iterable[str]) -> str:
    """Returns what a pair or an exclude is called."""
    return " and ".join(sorted(ends))


def _nth(places: list[Place], number: int, count: int, file: MjcfFile) -> Place:
    """Returns the place of MuJoCo's n-th; the file alone where it has others than are written."""
    return places[number] if len(places) == count else Place(file.path)


def geom_names(model: mujoco.MjModel) -> list[str]:
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
            found["collision", name] = Element(number - 1, {}, _at(place), shape, of=(link.name,))
    return found


def _stating(file: MjcfFile, tag: str, otherwise: Place) -> Callable[[str], Place]:
    """Returns what finds the element of a tag that states a word."""

    def place(word: str) -> Place:
        stated = (where for words, where in file.elements(tag) if word in words)
        return next(stated, otherwise)

    return place


def _at(place: Place) -> Callable[[str], Place]:
    return lambda _: place


ENABLED: Final = "enabled"
"""What a flag says: 1 or 0."""

DISABLE_BITS: Final = tuple(
    bit for bit in mujoco.mjtDisableBit.__members__.values() if bit.name.startswith("mjDSBL_")
)
ENABLE_BITS: Final = tuple(
    bit for bit in mujoco.mjtEnableBit.__members__.values() if bit.name.startswith("mjENBL_")
)


def flag_name(bit: Any) -> str:
    """Returns a flag's attribute of ``<flag>``."""
    return str(bit.name).split("_", 1)[1].lower()


def has_flag(model: mujoco.MjModel, bit: Any) -> bool:
    """Whether what a flag is of is enabled."""
    if isinstance(bit, mujoco.mjtDisableBit):
        return not model.opt.disableflags & bit.value
    return bool(model.opt.enableflags & bit.value)
