"""Numbers of an MJCF besides bodies and joints: of geoms, contact pairs, options, keyframes.

Those of `models.attributes.ELEMENT_ATTRIBUTES`, as MuJoCo compiles them.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import mujoco
import numpy as np

from pupper_analysis.models.attributes import ELEMENT_ATTRIBUTES
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.places import Place

Value = tuple[float, ...]


def place_of_geom(file: MjcfFile, geom: int, word: str) -> Place:
    """Finds where a geom's attribute is stated, in itself or a default class.

    Args:
        file: What it is of.
        geom: Its row in MuJoCo's arrays.
        word: The attribute; ``"shape"`` is any that a shape has, ``"touches"`` any that says what
            it touches, ``""`` is the geom itself.
    """
    model = file.model
    name, body = model.geom(geom).name, model.geom_bodyid[geom]
    words = _WORDS_OF.get(word, (word,))
    if not name:
        number = geom - int(model.body_geomadr[body])
        return file.nth(model.body(body).name, "geom", number, words)
    return (file.stated("geom", name, words) if words else None) or file.place("geom", name)


_WORDS_OF: Final = {
    "shape": ("size", "fromto", "type", "pos", "quat", "mesh"),
    "touches": ("contype", "conaffinity"),
    "": (),
}


def stated_numbers(model: mujoco.MjModel, tag: str, rows: Iterable[int]) -> dict[str, list[Value]]:
    """Returns {word: the values that elements have of it} where they are not MuJoCo's defaults.

    Args:
        model: What MuJoCo compiles.
        tag: ``geom`` or ``option``.
        rows: Which geoms; of options, ``[0]``.
    """
    default = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><geom size='1'/></worldbody></mujoco>"
    )
    usual, found = element_values(default, tag, 0), dict[str, list[Value]]()
    for row in rows:
        for word, value in element_values(model, tag, row).items():
            if value != usual[word]:
                found.setdefault(word, []).append(value)
    return found


def touching_geoms(model: mujoco.MjModel) -> set[int]:
    """Returns the geoms that can touch anything, by their bits or in a pair; others are seen."""
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT:
        return set()
    bits = np.flatnonzero((model.geom_contype != 0) | (model.geom_conaffinity != 0))
    return {*bits.tolist(), *model.pair_geom1.tolist(), *model.pair_geom2.tolist()}


def element_values(model: mujoco.MjModel, element: str, row: int) -> dict[str, Value]:
    """Returns an element's numbers, those of a table's rows that it has."""
    rows = [one for one in ELEMENT_ATTRIBUTES if one.element == element]
    if element == "option":
        return {one.word: _numbers(getattr(model.opt, one.mujoco)) for one in rows}
    return {
        one.word: _numbers(getattr(model, one.mujoco)[rows_of(model, one.mujoco, row)])
        for one in rows
    }


def rows_of(model: mujoco.MjModel, array: str, row: int) -> int | slice:
    """Returns an element's row in one of MuJoCo's arrays; of velocities, all of its joint."""
    if not array.startswith("dof_"):
        return row
    later = model.jnt_dofadr[row + 1] if row + 1 < model.njnt else model.nv
    return slice(int(model.jnt_dofadr[row]), int(later))


def _numbers(value: object) -> Value:
    return tuple(np.asarray(value, dtype=float).ravel().tolist())
