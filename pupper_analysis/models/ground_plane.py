"""A plane to stand on, put into an MJCF."""

from __future__ import annotations

from typing import Final

import mujoco

CONTACT_OF_GEOM: Final = (
    *("contype", "conaffinity", "condim", "priority", "friction", "solmix", "solref", "solimp"),
    *("margin", "gap", "group"),
)
"""What a geom of an MJCF has that makes its contacts, and in which group it is shown."""


def add_plane(spec: mujoco.MjSpec, name: str, bits: int = 1) -> mujoco.MjsGeom:
    """Adds a plane at z = 0 with MuJoCo's own contact: an MJCF's defaults are for its robot.

    Args:
        spec: The MJCF's.
        name: The plane's.
        bits: What it lets touch it (``conaffinity``).
    """
    plane, plain = spec.worldbody.add_geom(name=name), mujoco.MjSpec().default.geom
    for word in CONTACT_OF_GEOM:
        setattr(plane, word, getattr(plain, word))
    plane.type, plane.size, plane.conaffinity = mujoco.mjtGeom.mjGEOM_PLANE, (0, 0, 0.05), bits
    return plane
