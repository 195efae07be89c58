"""The shapes of an MJCF in a URDF."""

from __future__ import annotations

import os
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
from lxml import etree
from numpy.typing import NDArray

from pupper_analysis.base.arrays import placement_of
from pupper_analysis.base.diagnostics import Diagnostic, Term, diagnose
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.shapes import read_shape
from pupper_analysis.models.urdf_tree import set_origin
from pupper_analysis.models.xml import (
    DIGITS,
    add_element,
    free_name,
    write_numbers,
)

Array = NDArray[np.float64]
Geometry = tuple[str, dict[str, str], pin.SE3]

_SHOWN = 3
"""Geom groups below this are shown by MuJoCo's viewer by default."""


class UrdfShapes:
    """Makes the shapes of links.

    Attributes:
        left: What was left out.
    """

    def __init__(self, file: MjcfFile, model: mujoco.MjModel, folder: Path) -> None:
        """Knows the model's meshes.

        Args:
            file: The MJCF.
            model: What MuJoCo compiles it to.
            folder: Where the URDF shall be.
        """
        self.model, self.left = model, list[Diagnostic]()
        self._materials: dict[tuple[float, ...], str] = {}
        self._names: set[str] = set()
        self._files: dict[str, str] = {}
        self._moved: dict[str, pin.SE3] = {}
        self._lost: dict[str, str] = {}
        for mesh in file.spec.meshes:
            found, name = _path_of(file, mesh), mesh.name or Path(mesh.file).stem
            if found is None and mesh.file:
                self._lost[name] = mesh.file
            if found is not None:
                turn = np.array(mesh.refquat) / np.linalg.norm(mesh.refquat)
                self._moved[name] = placement_of(turn, mesh.refpos)
                self._files[name] = Path(os.path.relpath(found, folder)).as_posix()

    def add(self, link: etree._Element, body: int, inside: pin.SE3) -> None:
        """Adds the shapes of a body to its link: what touches as collision, what is seen as visual.

        Args:
            link: The link's element.
            body: The body.
            inside: Where the body's frame is in the link's.
        """
        model = self.model
        first = int(model.body_geomadr[body])
        for geom in range(first, first + int(model.body_geomnum[body])):
            touches = bool(model.geom_contype[geom] or model.geom_conaffinity[geom])
            seen = int(model.geom_group[geom]) < _SHOWN or not touches
            for tag, attributes, placed in self._geometries(geom):
                for kind in (("visual",) if seen else ()) + (("collision",) if touches else ()):
                    shape = add_element(link, kind)
                    set_origin(shape, inside * placed, DIGITS)
                    add_element(add_element(shape, "geometry"), tag, **attributes)
                    if kind == "visual":
                        self._paint(shape, geom)

    def _geometries(self, geom: int) -> list[Geometry]:
        """Returns what a geom is made of in a URDF, with its placement in the body's frame."""
        shape = read_shape(self.model, geom)
        placed, size = shape.pose.placed, np.array(shape.size)
        match shape.kind:
            case "sphere":
                return [("sphere", {"radius": write_numbers(size[0])}, placed)]
            case "box":
                return [("box", {"size": write_numbers(2 * size)}, placed)]
            case "cylinder" | "capsule":  # a URDF has no capsule: their sum is the same
                radius = write_numbers(size[0])
                tube = {"radius": radius, "length": write_numbers(2 * size[1])}
                ends = (-size[1], size[1]) if shape.kind == "capsule" else ()
                balls = [placed * pin.SE3(np.eye(3), np.array([0.0, 0.0, end])) for end in ends]
                caps = [("sphere", {"radius": radius}, ball) for ball in balls]
                return [("cylinder", tube, placed), *caps]
            case "mesh":
                return self._mesh(geom, placed)
        subject = ("geom", shape.name or f"{geom}")
        self.left.append(diagnose("shape-not-in-urdf", subject=subject, kind=Term(shape.kind)))
        return []

    def _mesh(self, geom: int, placed: pin.SE3) -> list[Geometry]:
        model = self.model
        mesh = int(model.geom_dataid[geom])
        name = str(model.mesh(mesh).name)
        if name not in self._files:
            lost = self._lost.get(name)  # MuJoCo does not tell the folder of an <attach>ed model
            self.left.append(diagnose("mesh-without-file", subject=("mesh", name), file=lost))
            return []
        # MuJoCo moves a mesh to its com and principal axes, and the geom along.
        own = placement_of(model.mesh_quat[mesh], model.mesh_pos[mesh])
        scale = np.array(model.mesh_scale[mesh])
        attributes = {"filename": self._files[name]}
        if not np.array_equal(scale, np.ones(3)):
            attributes["scale"] = write_numbers(scale)
        # Before it scaled them, MuJoCo moved the file's numbers: v' = S R^T (v - p).
        moved = self._moved[name]
        turned = not np.allclose(moved.rotation, np.eye(3))
        if turned and not np.allclose(scale, scale[0]):
            self.left.append(diagnose("mesh-turned-and-scaled", subject=("mesh", name)))
            return []
        moved = pin.SE3(moved.rotation, scale * moved.translation)
        where = placed * own.inverse() * moved.inverse()
        return [("mesh", attributes, where)]

    def _paint(self, shape: etree._Element, geom: int) -> None:
        """Adds a visual's color: a material is defined where it is first used."""
        model = self.model
        material = int(model.geom_matid[geom])
        rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
        key = tuple(float(f"{value:.4g}") for value in rgba)
        known = key in self._materials
        if not known:
            wanted = str(model.mat(material).name) if material >= 0 else "color"
            self._materials[key] = free_name(wanted or "color", self._names)
        node = add_element(shape, "material", name=self._materials[key])
        if not known:
            add_element(node, "color", rgba=write_numbers(key))


def _path_of(file: MjcfFile, mesh: mujoco.MjsMesh) -> Path | None:
    """Returns the file of a mesh; None where there is none."""
    if not mesh.file:
        return None
    name = Path(mesh.file).name if file.spec.strippath else mesh.file
    path = file.path.resolve().parent / mesh.compiler.meshdir / name
    return path if path.is_file() else None
