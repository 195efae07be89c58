"""Flat meshes of an MJCF, which MuJoCo refuses as solids and takes as shells."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection
from typing import Final

import mujoco

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.models.missing import gives_mass
from pupper_analysis.models.mjcf import silence_mujoco

_FLAT: Final = re.compile(r"mesh volume is too small: (.*?) \. Try setting inertia to shell")


def flat_mesh(error: BaseException) -> str | None:
    """Returns the mesh whose volume is too small for MuJoCo; None if the error is another."""
    found = _FLAT.search(str(error))
    return found[1] if found else None


def compile_with_shells(make: Callable[[], mujoco.MjSpec]) -> tuple[mujoco.MjModel, list[str], str]:
    """Compiles a spec with its flat meshes as shells.

    A mesh gives its geom a centre and axes, a mass only where a body has no <inertial>: then a
    shell would weigh something else, and it stays refused.

    Args:
        make: Makes the spec, anew each time, for compiling changes it.

    Returns:
        The model, the meshes that were taken as shells, and what MuJoCo says of the first.
    """
    shells: list[str] = []
    said = ""
    while True:
        spec = make()
        put_shells(spec, shells)
        try:
            with silence_mujoco():
                return spec.compile(), shells, said
        except ValueError as error:
            name = flat_mesh(error)
            if name is None or name in shells or _weighs(spec, name):
                raise
            shells.append(name)
            said = said or str(error)


def put_shells(spec: mujoco.MjSpec, names: Collection[str]) -> None:
    """Makes shells of some meshes, in place."""
    for mesh in spec.meshes:
        if mesh.name in names:
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL


def taken_as_shells(names: list[str]) -> Diagnostic:
    """Tells which meshes are taken as shells."""
    return diagnose("flat-meshes-as-shells", names=names, version=mujoco.__version__)


def _weighs(spec: mujoco.MjSpec, name: str) -> bool:
    return any(geom.meshname == name and gives_mass(spec, geom) for geom in spec.geoms)
