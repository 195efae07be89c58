"""The page of a robot whose base is held: a slider for each joint, and what the motors hold."""

from __future__ import annotations

import threading
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.errors import PupperAnalysisError
from pupper_analysis.present.formats import escape_control
from pupper_analysis.present.scene import joint_axes
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.posture import Posture, find_posture
from pupper_analysis.statics.equilibrium import gravity_compensation
from pupper_analysis.tools.live import render
from pupper_analysis.tools.live.controls import JointSliders, led_joints
from pupper_analysis.tools.live.documents import (
    failure_document,
    held_document,
    unexpected_document,
)
from pupper_analysis.tools.live.render import Language
from pupper_analysis.tools.live.scene import (
    Figure,
    colour_of,
    joint_text,
    parts_of,
    quaternion_along,
)
from pupper_analysis.tools.live.server import Served, Where
from pupper_analysis.tools.live.state import LiveSource, hold_command

Array = NDArray[np.float64]

_DISC, _ABOVE = 0.035, 0.1
"""Radius of a joint's disc, and how far above it its label is, in parts of the robot's size."""


class HeldSession:
    """What a browser sees and does.

    One thread answers it.

    Args:
        client: viser's handle of the browser.
        source: The robot, and how others name it.
        say: The page's language.
    """

    def __init__(self, client: Any, source: LiveSource, say: Language) -> None:
        self._client, self._source, self._say = client, source, say
        self._robot = robot = source.robot
        self._asked, self._closed = threading.Event(), threading.Event()
        start = find_posture(robot)
        gui, scene = client.gui, client.scene
        self._numbers = render.Numbers(gui, say, "solving")
        self.joints = JointSliders(
            gui, robot, led_joints(robot), start.qpos, lambda _joint, _at: self._asked.set()
        )
        self._command = gui.add_text(say("as-a-command"), "", multiline=True)
        self._figure = Figure(scene, "/held", robot, parts_of(robot.mj_model))
        self._size = size = robot_size(robot, start)
        scene.add_grid("/ground", 4 * size, 4 * size, cell_size=size / 10, section_size=size / 2)
        self._discs = [
            scene.add_cylinder(f"/joints/{n}", _DISC * size, 2 * _DISC * size, cast_shadow=False)
            for n in range(robot.nu)
        ]
        self._label = scene.add_label("/label", "", anchor="bottom-center")
        work = threading.Thread(target=self._answering, name="live-held", daemon=True)
        self.threads = [work]
        self._asked.set()
        work.start()

    def close(self) -> None:
        """Ends the thread, as soon as what it is at is done."""
        self._closed.set()
        self._asked.set()

    def _answering(self) -> None:
        while not self._closed.is_set():
            self._asked.wait()
            self._asked.clear()
            if self._closed.is_set():
                return
            try:
                self._show()
            except PupperAnalysisError as error:
                self._numbers.content = render.render_panel(failure_document(error), self._say)
            except Exception as error:  # a bug: the page tells of it, and goes on
                if not self._closed.is_set():
                    message = unexpected_document(error)
                    self._numbers.content = render.render_panel(message, self._say)

    def _show(self) -> None:
        """Shows the posture that the sliders say, and what its motors hold."""
        robot, positions = self._robot, self.joints.changed()
        posture = find_posture(robot, positions)
        config = Configuration(robot, posture.qpos)
        statics = gravity_compensation(config, contacts=[])
        message = render.render_panel(held_document(robot, statics), self._say)
        axes = joint_axes(config, posture.qpos, statics)
        hardest = max(axes, key=lambda one: (one.share or 0.0, abs(one.torque or 0.0)))
        with self._client.atomic():
            self._numbers.content = message
            self._command.value = escape_control(hold_command(self._source, positions))
            self._figure.pose(posture.qpos)
            for disc, one in zip(self._discs, axes, strict=True):
                disc.color, disc.position = colour_of(one.share), one.place
                disc.wxyz = quaternion_along(one.direction)
            self._label.text = joint_text(hardest.name, hardest.torque or 0.0, hardest.share)
            self._label.position = hardest.place + np.array([0.0, 0.0, _ABOVE * self._size])


class HeldPage(Served):
    """A page of a robot whose base is held.

    Args:
        source: The robot.
        **where: See ``Served``.

    Raises:
        ConfigurationError: If it cannot be served there, the base is free, or the language neither.
        MissingPackageError: If viser is not installed.
    """

    def __init__(self, source: LiveSource, **where: Unpack[Where]) -> None:
        render.import_viser()  # before the work
        robot = source.robot
        size = robot_size(robot, find_posture(robot))
        super().__init__(
            robot.name,
            size,
            lambda client, say: HeldSession(client, source, say),
            **where,
        )


def robot_size(robot: Robot, posture: Posture) -> float:
    """Returns how far the farthest joint is from the base at a posture (m); 0.1 at least."""
    config = Configuration(robot, posture.qpos)
    places = [config.joint_position(name) for name in robot.joint_names]
    return max(0.1, *(float(np.linalg.norm(place)) for place in places))
