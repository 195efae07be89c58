"""Reject values with which a simulation has no meaning; choose an accurate constraint solver.

Inputs are the compiled models of a robot. Options, rotor inertias, lengths, gears and masses that
make a simulation meaningless are errors with file and line. If the residual of MuJoCo's constraint
solver for a pushed base is too large, dense matrices are used, if this reduces the residual enough.
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
from pupper_analysis.models.urdf_file import UrdfFile, states_no_limits
from pupper_analysis.robot.build import with_additions
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot

_MAX_SOLVER_TOLERANCE = 1e-2
"""Upper bound of MuJoCo's solver option ``tolerance`` [1]. `check_simulable` raises an error for a
larger value. Chosen, not tuned.
"""

_GEAR_RANGE = 1e-6, 1e6
"""Lower and upper bound of the absolute gear ratio of an actuator at a joint [1, or rad/m at a
slide]. Outside of this range, `check_simulable` raises an error, except for a gear of 0. A screw
with a pitch of 1 mm has some thousand rad/m. Chosen, not tuned: stiffness is multiplied by the
square of the gear."""


_MIN_IMPRATIO = 1e-9
"""Lower bound of MuJoCo's option ``impratio`` (dimensionless). `check_simulable` raises an error
for a smaller value. Chosen, not tuned.
"""

_MAX_LENGTH = 1e4
"""Upper bound of the magnitude of contact margins, and of the coordinates of moving bodies and of
joints, in an MJCF [m]. `check_simulable` raises an error for a larger value. Chosen, not tuned.
"""


def check_simulable(mjcf: MjcfFile) -> None:
    """Raise an error if a value of an MJCF is so extreme that a simulation has no meaning.

    Examples are the time step, solver tolerance, rotor inertias and gears.

    Raises:
        ModelError: If a value is out of range; the error contains file, value and, if found, line.
    """
    for kind, field, stated, (least, most) in _list_bounded_values(mjcf.model):
        numbers = np.atleast_2d(np.asarray(stated, dtype=float).T).T
        bad = ~((least <= numbers) & (numbers <= most)).all(axis=1)
        for row in np.flatnonzero(bad).tolist():
            raise make_file_error(
                _find_place(mjcf, kind, field, row),
                diagnose(
                    "number-not-simulated",
                    subject=None
                    if kind == "option"
                    else (kind, _name_element_or_joint(mjcf.model, kind, row)),
                    field=field,
                    value=" ".join(f"{number:g}" for number in numbers[row]),
                    least=None if least == -most else f"{least:g}",
                    most=f"{most:g}" if math.isfinite(most) else None,
                ),
            )


def _list_bounded_values(
    model: mujoco.MjModel,
) -> Iterator[tuple[str, str, ArrayLike, tuple[float, float]]]:
    """Yield the values of a model to check, with bounds outside which a simulation has no meaning.

    Each item is (tag of the element, attribute, values, (minimum, maximum)). Values and bounds have
    the unit of the MJCF attribute, for example s, m or kg m^2.
    """
    option, length_range, mass_range = model.opt, (-_MAX_LENGTH, _MAX_LENGTH), (0.0, math.inf)
    yield "option", "timestep", [option.timestep], TIMESTEP_RANGE
    yield "option", "impratio", [option.impratio], (_MIN_IMPRATIO, math.inf)
    yield "option", "iterations", [option.iterations], (1, math.inf)
    yield "option", "tolerance", [option.tolerance], (0.0, _MAX_SOLVER_TOLERANCE)
    yield "joint", "armature", model.dof_armature[model.jnt_dofadr], mass_range
    yield "actuator", "armature", model.actuator_armature, mass_range
    # Objects fixed in the world may be hidden far away.
    yield "body", "pos", model.body_pos * (model.body_weldid != 0)[:, None], length_range
    yield "joint", "pos", model.jnt_pos, length_range
    yield "geom", "margin", model.geom_margin, length_range
    yield "pair", "margin", model.pair_margin, length_range
    gears = [actuator_gear(model, motor) for motor in range(model.nactuator)]
    at_joints = [abs(gear[0]) if len(gear) == 1 and gear[0] else 1.0 for gear in gears]
    yield "actuator", "gear", at_joints, _GEAR_RANGE


def _name_element_or_joint(model: mujoco.MjModel, kind: str, row: int) -> str:
    """Return the name of an element; for an unnamed actuator, the name of its joint.

    ``kind`` is the kind of the element, for example ``actuator``; ``row`` is the id.
    """
    name = str(getattr(model, kind)(row).name)
    if kind == "actuator" and not name and is_at_one_joint(model, row):
        return str(model.joint(int(model.actuator_trnid[row, 0])).name)
    return name


def _find_place(mjcf: MjcfFile, kind: str, field: str, row: int) -> Place:
    """Find the file and line of an element of the model, or of a MuJoCo option, for an error.

    ``kind`` is the kind of the element, for example ``actuator``, or ``option``; ``field`` is the
    name of the option; ``row`` is the id of the element.
    """
    if kind == "option":
        stated = (place for words, place in mjcf.elements("option") if field in words)
        return next(stated, Place(mjcf.path))
    return mjcf.place(
        "contact" if kind == "pair" else kind, _name_element_or_joint(mjcf.model, kind, row)
    )


def explain_model_fault(error: ModelError, urdf: UrdfFile, mjcf: MjcfFile) -> ModelError:
    """Add file and line to an error about crossed joint limits, or about a body without mass.

    MuJoCo reports a moving body without mass by its name.

    Args:
        error: Error of a compilation, or of the search for a stand.
        urdf: URDF.
        mjcf: MJCF, which may have been converted from the URDF.

    Returns:
        The new error; ``error`` itself if the cause is another problem.
    """
    if error.cause.code == "joint-limits-crossed" and error.cause.subject is not None:
        return make_file_error(urdf.place("joint", error.cause.subject.name, "limit"), error.cause)
    message = str(error.cause.values.get("message", ""))
    found = re.search(r"larger than mjMINVAL.*Element name '([^']+)'", message)
    if found is None:
        return error
    name = found[1]
    place, kind = mjcf.place("body", name), "body"
    if mjcf.of_urdf and name in urdf.tree.links:
        place, kind = urdf.place("link", name), "link"
    return make_massless_link_error(place, kind, name)


def make_massless_link_error(place: Place, kind: str, name: str) -> ModelError:
    """Create the error, with file and line, that a moving link or body has no mass."""
    where = f"{place.file.name}:{place.line}" if place.line else place.file.name
    problem = diagnose("moving-link-without-mass", subject=(kind, name), place=where)
    return make_file_error(place, problem)


def check_joint_limits(urdf: UrdfFile) -> None:
    """Raise an error if the lower limit of a joint in a URDF is above its upper limit.

    No position is permitted, so statements about postures and ranges of the robot have no meaning.

    Raises:
        ModelError: If limits are crossed; the error contains the line of the first such joint.
    """
    for joint in urdf.tree.moving:
        limit = joint.element.find("limit")
        if limit is None or joint.kind == "continuous" or states_no_limits(joint):
            continue
        least, most = (float(limit.get(end) or 0) for end in ("lower", "upper"))
        if least > most:
            unit = "m" if joint.kind == "prismatic" else "rad"
            crossed = diagnose(
                "joint-limits-crossed",
                subject=("joint", joint.name),
                least=Quantity(least, unit),
                most=Quantity(most, unit),
            )
            raise make_file_error(urdf.place("joint", joint.name, "limit"), crossed)


def check_masses(robot: Robot, urdf: UrdfFile) -> None:
    """Raise an error if a joint has no inertia: its acceleration would be undefined.

    The inertia of a joint is a diagonal element of Pinocchio's mass matrix at the start pose,
    including rotor inertia. Rotor inertia carries no weight, so the total mass is checked as well.

    Raises:
        ModelError: If the inertia at a joint, or the total mass, is zero or negative.
    """
    inertias = np.diag(Configuration(robot, robot.home).mass_matrix())[robot.nv - robot.nu :]
    for name, inertia in zip(robot.joint_names, inertias.tolist(), strict=True):
        if inertia <= 0:
            robot.check_bodies()  # reports a negative mass by itself
            problem = diagnose("joint-moves-no-mass", subject=("joint", name))
            raise make_file_error(urdf.place("joint", name), problem)
    robot.check_total_mass(urdf.path)


MAX_SOLVER_RESIDUAL = 0.01
"""Upper bound of the residual of the equations of motion, divided by the robot's weight [1]. If the
residual is larger, MuJoCo's solver counts as inaccurate (`find_solver_error`). Chosen, not tuned.
"""

_PUSH_FRACTION = 0.1
"""Force along each axis on the robot in the test of the solver's accuracy, divided by the robot's
weight [1]. Without a push the constraint forces are in equilibrium, and an inaccurate solver may
not be detected. Chosen, not tuned.
"""


def compute_solver_residual(model: mujoco.MjModel, data: mujoco.MjData, base: int) -> float:
    """Compute the error of MuJoCo's constraint solver for a robot whose free base is pushed.

    The error is the residual of M qacc = f in the three translational equations of the base. The
    push is 10 % of the robot's weight along each axis (`_PUSH_FRACTION`). If the model has no
    gravity, the weight is that on Earth.

    Args:
        model: Model.
        data: State; the accelerations of the pushed robot are computed in place.
        base: Id of the body with the free joint.

    Returns:
        Largest of the three residuals, divided by the robot's weight [1].
    """
    gravity = float(np.linalg.norm(model.opt.gravity)) or EARTH_GRAVITY
    weight = float(model.body_subtreemass[base]) * gravity
    first = int(model.body_dofadr[base])
    data.xfrc_applied[base, :3] = _PUSH_FRACTION * weight
    mujoco.mj_forward(model, data)
    data.xfrc_applied[base] = 0.0
    inertial_force = np.zeros(model.nv)
    mujoco.mj_mulM(model, data, inertial_force, data.qacc)
    residual = (inertial_force - data.qfrc_smooth - data.qfrc_constraint)[first : first + 3]
    return float(np.abs(residual).max()) / weight


_TEST_PENETRATION = 1e-3
"""Distance by which the robot is lowered in the test of the solver's accuracy [m], so that contact
forces act. Chosen, not tuned."""


def find_solver_error(robot: Robot) -> float | None:
    """Test if MuJoCo's constraint solver is accurate for a robot; return the residual if not.

    The residual is that of `compute_solver_residual` at the start pose, with the feet 1 mm deeper
    in the ground (`_TEST_PENETRATION`).

    Returns:
        Residual, divided by the robot's weight [1]; None if the residual is at most
        `MAX_SOLVER_RESIDUAL`.
    """
    model, base = robot.mj_model, robot.mj_model.body(robot.mj_base).id
    data = mujoco.MjData(model)
    qpos = robot.home.copy()
    qpos[2] -= _TEST_PENETRATION
    robot.mj_convention.set_state(data, qpos)
    residual = compute_solver_residual(model, data, base)
    return None if residual <= MAX_SOLVER_RESIDUAL else residual  # not a number: inaccurate


def choose_exact_solver(robot: Robot) -> tuple[Robot, list[Diagnostic]]:
    """Set dense matrices for MuJoCo's solver if the solver is inaccurate with sparse matrices.

    Dense matrices are set only if the solver is accurate with dense matrices (`find_solver_error`).

    Returns:
        Robot, and a list with a note if dense matrices are set or if the solver remains inaccurate.
        The list is empty if the solver of the robot is accurate.
    """
    residual = find_solver_error(robot)
    if residual is None:
        return robot, []
    residual_fraction = Quantity(residual, "1")
    if mujoco.mj_isSparse(robot.mj_model):
        message = diagnose("solver-made-dense", share=residual_fraction)
        dense = with_additions(robot, Options(message, {"jacobian": "dense"}))
        if find_solver_error(dense) is None:
            return dense, [message]
    return robot, [diagnose("solver-inexact", share=residual_fraction)]
