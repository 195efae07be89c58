"""Numbers with which no simulation, or no equation of motion, means anything: they are refused."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.models.mjcf import TIMESTEPS
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.places import Place, refuse_file
from pupper_analysis.models.transmission import actuator_gear, is_at_one_joint
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot

_TOLERANCE = 1e-2
"""Of the solver of contacts, in units of the robot's own inertia and accelerations: a robot hangs
in the air at 1e9."""

_GEARS = 1e-6, 1e6
"""Screws of a millimetre's pitch have some thousand rad/m; beyond, squares leave a double's range
of digits."""


_FARTHEST = 1e4
"""m: no robot is as large, nor feels the ground from so far; a float32's micrometre is lost at 8 m,
and a double's, squared, at this."""


def check_simulable(mjcf: MjcfFile) -> None:
    """Checks the options, rotors and gears on which all simulations rest.

    Raises:
        ModelError: If one is beyond what has a meaning; it names the file, the line and the value.
    """
    model = mjcf.model
    low, high = TIMESTEPS
    step, ratio = float(model.opt.timestep), float(model.opt.impratio)
    rounds, tolerance = int(model.opt.iterations), float(model.opt.tolerance)
    for word, good, problem in (
        (
            "timestep",
            low <= step <= high,
            diagnose("timestep-not-simulated", value=step, low=low, high=high),
        ),
        ("impratio", 0 < ratio < math.inf, diagnose("impratio-not-valid", value=ratio)),
        ("iterations", rounds >= 1, diagnose("iterations-not-valid", value=rounds)),
        (
            "tolerance",
            0 <= tolerance <= _TOLERANCE,
            diagnose("tolerance-not-valid", value=tolerance, most=_TOLERANCE),
        ),
    ):
        if not good:
            stated = (place for words, place in mjcf.elements("option") if word in words)
            raise refuse_file(next(stated, Place(mjcf.path)), problem)
    _check_rotors(mjcf, model)
    _check_lengths(mjcf, model)
    _check_motors(mjcf, model)


def _check_rotors(mjcf: MjcfFile, model: mujoco.MjModel) -> None:
    for dof in range(model.nv):
        armature, joint = (
            float(model.dof_armature[dof]),
            model.joint(int(model.dof_jntid[dof])).name,
        )
        if armature < 0:
            problem = diagnose(
                "rotor-inertia-negative", subject=("joint", joint), armature=armature
            )
            raise refuse_file(mjcf.place("joint", joint), problem)


def _check_lengths(mjcf: MjcfFile, model: mujoco.MjModel) -> None:
    for kind, field, numbers in (
        ("body", "pos", model.body_pos),
        ("joint", "pos", model.jnt_pos),
        ("geom", "margin", model.geom_margin[:, None]),
        ("pair", "margin", model.pair_margin[:, None]),
    ):
        far = ~(np.abs(numbers) <= _FARTHEST).all(axis=1)
        if kind == "body":  # what stands in the world for itself may be hidden far away
            far &= model.body_weldid != 0
        for found in np.flatnonzero(far)[:1]:
            name = str(getattr(model, kind)(int(found)).name)
            place = mjcf.place("contact" if kind == "pair" else kind, name)
            most = Quantity(_FARTHEST, "m")
            problem = diagnose(
                "length-of-no-robot",
                subject=(kind, name),
                field=field,
                value=" ".join(f"{number:g}" for number in numbers[found]),
                most=most,
            )
            raise refuse_file(place, problem)


def _check_motors(mjcf: MjcfFile, model: mujoco.MjModel) -> None:
    for motor in range(model.nactuator):
        if model.actuator_armature[motor] < 0:
            name = model.actuator(motor).name
            place = mjcf.place("actuator", name) if name else mjcf.numbered("actuator", motor)
            armature = float(model.actuator_armature[motor])
            problem = diagnose(
                "rotor-inertia-negative", subject=("actuator", name), armature=armature
            )
            raise refuse_file(place, problem)
        if not is_at_one_joint(model, motor):
            continue
        gear = float(actuator_gear(model, motor)[0])
        if gear and not _GEARS[0] <= abs(gear) <= _GEARS[1]:
            joint = str(model.joint(int(model.actuator_trnid[motor, 0])).name)
            place = mjcf.place("actuator", model.actuator(motor).name or joint)
            least, most = _GEARS
            driven = "joint", joint
            problem = diagnose(
                "gear-of-no-motor", subject=driven, gear=gear, least=least, most=most
            )
            raise refuse_file(place, problem)


def check_masses(robot: Robot, urdf: UrdfFile) -> None:
    """Checks that each joint moves a mass in the URDF, as it has to in MuJoCo.

    Raises:
        ModelError: If one does not: its acceleration would be anything.
    """
    felt = np.diag(Configuration(robot, robot.home).mass_matrix())[robot.nv - robot.nu :]
    for name, inertia in zip(robot.joint_names, felt.tolist(), strict=True):
        if inertia <= 0:
            problem = diagnose("joint-moves-no-mass", subject=("joint", name))
            raise refuse_file(urdf.place("joint", name), problem)
