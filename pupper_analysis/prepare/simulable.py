"""Numbers with which no simulation, or no equation of motion, means anything: they are refused.

And MuJoCo's constraint solver, where a model is more than it solves as it is set.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.base.units import EARTH_GRAVITY
from pupper_analysis.models.additions import Options
from pupper_analysis.models.mjcf import TIMESTEP_RANGE
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.places import Place, make_file_error
from pupper_analysis.models.transmission import actuator_gear, is_at_one_joint
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.robot.build import with_additions
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot

_TOLERANCE = 1e-2
"""Of the solver of contacts, in units of the robot's own inertia and accelerations: a robot hangs
in the air at 1e9."""

_GEARS = 1e-6, 1e6
"""Screws of a millimetre's pitch have some thousand rad/m; beyond, squares leave a double's range
of digits."""


_LEAST = 1e-9
"""Of an ``impratio``: friction that is so soft is none."""

_FARTHEST = 1e4
"""m: no robot is as large, nor feels the ground from so far; a float32's micrometre is lost at 8 m,
and a double's, squared, at this."""


def check_simulable(mjcf: MjcfFile) -> None:
    """Checks the options, rotors, lengths and gears on which all simulations rest.

    Raises:
        ModelError: If one is beyond what has a meaning; it names the file, the line and the value.
    """
    for kind, field, stated, (least, most) in _bounded(mjcf.model):
        numbers = np.atleast_2d(np.asarray(stated, dtype=float).T).T
        bad = ~((least <= numbers) & (numbers <= most)).all(axis=1)
        for row in np.flatnonzero(bad).tolist():
            raise make_file_error(
                _place(mjcf, kind, field, row),
                diagnose(
                    "number-not-simulated",
                    subject=None if kind == "option" else (kind, _name(mjcf.model, kind, row)),
                    field=field,
                    value=" ".join(f"{number:g}" for number in numbers[row]),
                    least=None if least == -most else f"{least:g}",
                    most=f"{most:g}" if math.isfinite(most) else None,
                ),
            )


def _bounded(model: mujoco.MjModel) -> Iterator[tuple[str, str, ArrayLike, tuple[float, float]]]:
    """Yields elements and attributes, their numbers, and between which these have a meaning."""
    option, near, any_mass = model.opt, (-_FARTHEST, _FARTHEST), (0.0, math.inf)
    yield "option", "timestep", [option.timestep], TIMESTEP_RANGE
    yield "option", "impratio", [option.impratio], (_LEAST, math.inf)
    yield "option", "iterations", [option.iterations], (1, math.inf)
    yield "option", "tolerance", [option.tolerance], (0.0, _TOLERANCE)
    yield "joint", "armature", model.dof_armature[model.jnt_dofadr], any_mass
    yield "actuator", "armature", model.actuator_armature, any_mass
    # What stands in the world for itself may be hidden far away.
    yield "body", "pos", model.body_pos * (model.body_weldid != 0)[:, None], near
    yield "joint", "pos", model.jnt_pos, near
    yield "geom", "margin", model.geom_margin, near
    yield "pair", "margin", model.pair_margin, near
    gears = [actuator_gear(model, motor) for motor in range(model.nactuator)]
    at_joints = [abs(gear[0]) if len(gear) == 1 and gear[0] else 1.0 for gear in gears]
    yield "actuator", "gear", at_joints, _GEARS


def _name(model: mujoco.MjModel, kind: str, row: int) -> str:
    """Returns an element's name; of an actuator without one, its joint's."""
    name = str(getattr(model, kind)(row).name)
    if kind == "actuator" and not name and is_at_one_joint(model, row):
        return str(model.joint(int(model.actuator_trnid[row, 0])).name)
    return name


def _place(mjcf: MjcfFile, kind: str, field: str, row: int) -> Place:
    if kind == "option":
        stated = (place for words, place in mjcf.elements("option") if field in words)
        return next(stated, Place(mjcf.path))
    return mjcf.place("contact" if kind == "pair" else kind, _name(mjcf.model, kind, row))


def explain_refused_body(error: ModelError, urdf: UrdfFile, mjcf: MjcfFile) -> ModelError:
    """Return the error of a body that MuJoCo refuses, with the URDF's link and line.

    Args:
        error: The error, which is returned if it is about something else.
        urdf: The URDF.
        mjcf: The MJCF; the URDF is named only if the MJCF was made of it.
    """
    message = str(error.cause.values.get("message", ""))
    found = re.search(r"larger than mjMINVAL.*Element name '([^']+)'", message)
    if found is None:
        return error
    name = found[1]
    place, kind = mjcf.place("body", name), "body"
    if mjcf.of_urdf and name in urdf.tree.links:
        place, kind = urdf.place("link", name), "link"
    where = f"{place.file.name}:{place.line}" if place.line else place.file.name
    problem = diagnose("moving-link-without-mass", subject=(kind, name), place=where)
    return make_file_error(place, problem)


def check_masses(robot: Robot, urdf: UrdfFile) -> None:
    """Checks that each joint moves a mass in the URDF, as it has to in MuJoCo.

    Raises:
        ModelError: If one does not: its acceleration would be anything.
    """
    felt = np.diag(Configuration(robot, robot.home).mass_matrix())[robot.nv - robot.nu :]
    for name, inertia in zip(robot.joint_names, felt.tolist(), strict=True):
        if inertia <= 0:
            robot.check_bodies()  # a mass below zero is called so
            problem = diagnose("joint-moves-no-mass", subject=("joint", name))
            raise make_file_error(urdf.place("joint", name), problem)


MAX_SOLVER_RESIDUAL = 0.01
"""Of a robot's weight: what is left out of its equation of motion is to be below what simulations
are compared to."""

_PUSH = 0.1
"""Of the weight: at rest constraints balance what acts, and nothing shows."""

_SOLVES = 20
"""Solvers of few iterations begin where they ended before, as they do from step to step."""


def compute_solver_residual(model: mujoco.MjModel, data: mujoco.MjData, base: int) -> float:
    """Returns how much of the weight is missing in M qacc = f when a free base is pushed.

    Args:
        model: The model.
        data: Its state; the base is pushed, and what follows of it computed.
        base: The body with the free joint.

    Returns:
        The largest of the base's three forces that is left out, in parts of the robot's weight.
    """
    # What weighs nothing is pushed with a tenth of its weight on Earth.
    gravity = float(np.linalg.norm(model.opt.gravity)) or EARTH_GRAVITY
    weight = float(model.body_subtreemass[base]) * gravity
    first = int(model.body_dofadr[base])
    data.xfrc_applied[base, :3] = _PUSH * weight
    for _ in range(_SOLVES):
        mujoco.mj_forward(model, data)
    data.xfrc_applied[base] = 0.0
    moved = np.zeros(model.nv)
    mujoco.mj_mulM(model, data, moved, data.qacc)
    missing = (moved - data.qfrc_smooth - data.qfrc_constraint)[first : first + 3]
    return float(np.abs(missing).max()) / weight


_INTO_GROUND = 1e-3  # m: where feet that just touch push


def find_solver_error(robot: Robot) -> float | None:
    """Returns what the solver leaves out, in parts of the weight, if it is too much."""
    model, base = robot.mj_model, robot.mj_model.body(robot.mj_base).id
    data = mujoco.MjData(model)
    qpos = robot.home.copy()
    qpos[2] -= _INTO_GROUND
    robot.mj_convention.set_state(data, qpos)
    share = compute_solver_residual(model, data, base)
    return share if share > MAX_SOLVER_RESIDUAL else None


def choose_exact_solver(robot: Robot) -> tuple[Robot, list[Diagnostic]]:
    """Gives a robot dense matrices if MuJoCo's solver is exact with these alone.

    Args:
        robot: The robot, with a free base.

    Returns:
        The robot, and that it was done, or that nothing helps.
    """
    part = find_solver_error(robot)
    if part is None:
        return robot, []
    share = Quantity(part, "1")
    if mujoco.mj_isSparse(robot.mj_model):
        message = diagnose("solver-made-dense", share=share)
        dense = with_additions(robot, Options(message, {"jacobian": "dense"}))
        if find_solver_error(dense) is None:
            return dense, [message]
    return robot, [diagnose("solver-inexact", share=share)]
