"""How two files become a robot, pass by pass: what ``stand --explain`` shows."""

from __future__ import annotations

from dataclasses import dataclass

from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.base.results import Result
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.prepare.draft import PassRun
from pupper_analysis.prepare.load import prepare_robot
from pupper_analysis.prepare.ready import Request
from pupper_analysis.robot.robot import Robot


@dataclass(frozen=True)
class Preparation(Result):
    """How two files became a robot.

    Attributes:
        name: The robot's name.
        mass: What it weighs (kg).
        floating: Whether its base is free.
        joints: Its joints, in the order of its coordinates.
        feet: Its feet.
        passes: What was run to make it ready, in this order; none if the files were ready.
        notes: What was found, and which defaults were added.
    """

    name: str
    mass: float
    floating: bool
    joints: tuple[str, ...]
    feet: tuple[str, ...]
    passes: tuple[PassRun, ...]
    notes: tuple[Diagnostic, ...]


def explain_loading(urdf: UrdfFile, mjcf: MjcfFile, request: Request) -> tuple[Preparation, Robot]:
    """Makes two files a robot, and tells how.

    Raises:
        ModelError: If no robot can be made of them.
        UnknownNameError: If a foot, joint or keyframe is not there.
    """
    robot, runs = prepare_robot(urdf, mjcf, request)
    message = Preparation(
        name=robot.name,
        mass=robot.total_mass,
        floating=robot.floating,
        joints=tuple(robot.joint_names),
        feet=tuple(robot.feet),
        passes=tuple(runs),
        notes=robot.notes,
    )
    return message, robot
