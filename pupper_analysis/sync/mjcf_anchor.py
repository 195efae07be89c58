"""Where a joint is in its body: one number of an MJCF, and many differences of a robot."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.sync.frames import Key

if TYPE_CHECKING:
    from pupper_analysis.sync.mjcf_side import MjcfSide

Array = NDArray[np.float64]

_APART = 1e-9
"""Up to which two steps are the same (m)."""


def move_anchors(side: MjcfSide, taken: Collection[Key]) -> set[Key]:
    """Notes the joints that are merely elsewhere in their bodies.

    A joint is where the file puts it in its body. If that is changed, its place differs, and so do
    the com and all that is on the body, all by one step: as many differences, whose one cause is
    mended here, lest the body is moved beneath its shapes.

    Returns:
        The differences that are mended by it.
    """
    mended: set[Key] = set()
    for kind, name in taken:
        if kind == "position":
            keys = {key for key, _ in _carried(side, name)} & set(taken)
            step = _step(side, name)
            if step is not None and _write(side, name, step):
                mended |= {(kind, name), *keys}
    return mended


def _carried(side: MjcfSide, name: str) -> Iterator[tuple[Key, tuple[Array, Array]]]:
    """Yields what is on a body: the difference it would be, what it is and shall be."""
    now, wanted = side.sides.mjcf, side.wanted
    yield ("com", name), (now.bodies[name].com, wanted.bodies[name].com)
    for child in now.children(name):
        places = now.joints[child].position, wanted.joints[child].position
        yield ("position", child), places
    for frame, (owner, position) in now.frames.items():
        if owner == name:
            yield ("frame", frame), (position, wanted.frames[frame][1])


def _step(side: MjcfSide, name: str) -> Array | None:
    """Returns how far a joint shall be moved in its body, in that's axes; None if it is not that.

    All that is on the body must say so, its com at least.
    """
    now, wanted = side.sides.mjcf.joints[name], side.wanted.joints[name]
    step = now.rotation.T @ (wanted.position - now.position)
    carried = [places for _, places in _carried(side, name)]
    apart = [there - here + step for here, there in carried]
    if float(np.abs(now.rotation - wanted.rotation).max()) > _APART:
        return None
    if any(float(np.abs(one).max()) > _APART for one in apart):
        return None
    return np.array(side.sides.mjcf_frames[name].rotation).T @ step


def _write(side: MjcfSide, name: str, step: Array) -> bool:
    index = side.model.joint(name).id
    element = side.joint_in_file(name)
    body = int(side.model.jnt_bodyid[index])
    if element is None or int(side.model.body_jntnum[body]) != 1:
        return False
    around = side.elements.frame_of(element).inverse()
    now = np.array(side.model.jnt_pos[index])
    return side.set_position(("position", name), element, around * now, around * (now + step))
