"""The page of a robot that a policy walks: it is commanded by sliders, and pushed by buttons."""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import text
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.live import render
from pupper_analysis.tools.live.documents import unexpected_document
from pupper_analysis.tools.live.render import Language
from pupper_analysis.tools.live.scene import RobotFigure, make_body_meshes
from pupper_analysis.tools.live.server import ServedPage, ServeOptions
from pupper_analysis.tools.walk.gait import describe_fall, evaluate_tracking, joint_torques
from pupper_analysis.tools.walk.policy import Policy
from pupper_analysis.tools.walk.runs import Lockstep, Run, Stage, make_push_forces, prepare_stage

Array = NDArray[np.float64]

_SPEED, _TURN, _PUSH = 1.0, 2.0, 3.0
"""Ends of sliders (m/s, rad/s; m/s of the whole robot), or what is commanded at the beginning:
public policies are trained up to these, and the search of `walk --vary` pushes as hard."""

_WINDOW, _SHOWN, _DRAWN = 1.0, 0.25, 0.04
"""s over which speeds and torques are meant, between two lists of them, and between two pictures:
25 a second, as the page of a run has."""

_AXES = ("forward", "left", "turning")

PUSH_DIRECTIONS = {"forward": (1.0, 0.0), "backward": (-1.0, 0.0), "left": (0.0, 1.0),
              "right": (0.0, -1.0)}  # fmt: skip
"""In the world, as the robot's runs are pushed; it starts with its front along x."""


class WalkSession:
    """What a browser sees and does: its own robot, simulated in real time until it falls.

    Args:
        client: viser's handle of the browser.
        stage: The policy on its robot.
        command: (3,) what it is commanded at the beginning.
        say: The page's language.
    """

    def __init__(self, client: Any, stage: Stage, command: Array, say: Language) -> None:
        self._client, self._stage, self._say = client, stage, say
        self._closed, self._again = threading.Event(), threading.Event()
        self._lock = threading.Lock()
        self._push: tuple[float, float] | None = None
        self.fall: Diagnostic | None = None
        gui, scene = client.gui, client.scene
        self._numbers = render.NumberPanel(gui, say, "walking-begins")
        self.sliders = [
            gui.add_slider(
                say.translate(text(f"walking-slider-{name}")), -end, end, 0.01 * end, float(at)
            )
            for name, at, end in zip(
                _AXES,
                command,
                np.maximum((_SPEED, _SPEED, _TURN), np.abs(command)).tolist(),
                strict=True,
            )
        ]
        self.impulse = gui.add_slider(say("walking-slider-push"), 0.0, _PUSH, 0.01 * _PUSH, 0.5)
        for name, (x, y) in PUSH_DIRECTIONS.items():
            button = gui.add_button(say.translate(text(f"walking-push-to-{name}")))
            button.on_click(lambda _, x=x, y=y: self.push(x, y))
        again = gui.add_button(say("walking-again"))
        again.on_click(lambda _: self.begin_again())
        robot = stage.robot
        self._figure = RobotFigure(scene, "/walking", robot, make_body_meshes(robot.mj_model))
        self._cell = robot.stand_height
        self._grid = scene.add_grid(
            "/ground",
            12 * self._cell,
            12 * self._cell,
            cell_size=0.5 * self._cell,
            section_size=self._cell,
        )
        work = threading.Thread(target=self._answering, name="live-walking", daemon=True)
        self.threads = [work]
        work.start()

    def close(self) -> None:
        """Ends the thread, as soon as what it is at is done."""
        self._closed.set()
        self._again.set()

    def push(self, x: float, y: float) -> None:
        """Pushes it in a direction, as hard as the slider says, during the next action."""
        size = float(self.impulse.value) * self._stage.robot.total_mass
        with self._lock:
            self._push = (x * size, y * size)

    def begin_again(self) -> None:
        """Puts it where it began."""
        self._again.set()

    def _answering(self) -> None:
        while not self._closed.is_set():
            self._again.clear()
            try:
                self._walk()
            except Exception as error:  # a bug: the page shows it, and goes on
                if not self._closed.is_set():
                    self._numbers.content = render.render_panel(
                        unexpected_document(error), self._say
                    )
            self._again.wait()  # what has fallen lies there until it is asked to begin again

    def _walk(self) -> None:
        """Simulates until it falls, begins again, or the page is closed."""
        stage, self.fall = self._stage, None
        case = stage.case(np.array([slider.value for slider in self.sliders]))
        runs, action = Lockstep(stage, [case]), stage.substeps * stage.timestep
        seen: deque[tuple[Array, Array]] = deque(maxlen=max(2, round(_WINDOW / action)))
        draw, show = (max(1, round(period / action)) for period in (_DRAWN, _SHOWN))
        due = time.monotonic()
        while not self._again.is_set():
            runs.commands[0] = [slider.value for slider in self.sliders]
            with self._lock:
                push, self._push = self._push, None
            forces = None if push is None else make_push_forces(stage, [push])
            states, control, broken = runs.advance(forces)
            seen.append((states[0], control[0]))
            fallen = bool(broken[0]) or stage.upright.has_fallen(runs.current[0])
            window = Run(
                case=stage.case(runs.commands[0].copy()),
                states=np.concatenate([one for one, _ in seen]),
                targets=np.concatenate([one for _, one in seen]),
                fallen=fallen,
                lean=0.0,
                lost=0.0,
            )
            if fallen:
                self.fall = describe_fall(stage, window, runs.tick * action)
            if runs.tick % draw == 0 or fallen:
                self._pose(runs.current[0])
            if runs.tick % show == 0 or fallen:
                page = walking_document(stage, window, runs.tick * action, self.fall)
                self._numbers.content = render.render_panel(page, self._say)
            if fallen:
                return
            due = max(due + action, time.monotonic() - _WINDOW)  # a slow machine plays slowly
            self._closed.wait(max(0.0, due - time.monotonic()))

    def _pose(self, state: Array) -> None:
        """Draws it in the middle, on ground that moves beneath it."""
        qpos = state[1 + self._stage.robot.mj_convention.qpos_index].copy()
        if not np.isfinite(qpos).all():
            return
        place = np.array([qpos[0], qpos[1], 0.0])
        qpos[:2] = 0.0
        with self._client.atomic():
            self._figure.pose(qpos)
            self._grid.position = -np.fmod(place, self._cell)


def walking_document(
    stage: Stage, window: Run, duration: float, fall: Diagnostic | None
) -> doc.Document:
    """Returns how the last second went: speeds beside what is commanded, torques of the motors."""
    followed, torques = (
        evaluate_tracking(stage, window, 0.0),
        np.nan_to_num(joint_torques(stage, window)),
    )
    rms, peak = np.sqrt((torques**2).mean(axis=0)), np.abs(torques).max(axis=0)
    limits = stage.robot.effort_limits
    asked, reached = window.case.command, (*followed.velocity, followed.turning)
    speeds = doc.Table(
        text("walking-speeds"),
        (doc.Column(doc.Name(""), left=True), doc.Column(doc.Name(""), left=True)),
        tuple(
            (
                text(f"walking-slider-{name}"),
                text("walking-of", reached=f"{is_:z.2f}", asked=f"{wanted:z.2f}"),
            )
            for name, is_, wanted in zip(_AXES, reached, asked, strict=True)
        ),
    )
    motors = doc.Table(
        text("walking-motors"),
        (
            doc.Column(text("walking-motor"), left=True),
            doc.Column(text("walking-mean"), "N m"),
            doc.Column(text("walking-most"), "N m"),
            doc.Column(text("walking-ends"), "N m"),
        ),
        tuple(
            (doc.Name(name), doc.number_cell(rms[index], ".2f"),
             doc.number_cell(peak[index], ".2f"), doc.number_cell(limits[index], ".2f"))
            for index, name in enumerate(stage.robot.joint_names)
        ),
    )  # fmt: skip
    return doc.Document(
        text("walking-title"),
        doc.Name(f"{stage.robot.name}, {stage.policy.name}"),
        (speeds, motors),
        passed=fall is None,
        verdict=text("walking-on-feet", time=f"{duration:.0f}") if fall is None else None,
        failures=() if fall is None else (doc.diagnostic_text(fall),),
    )


class WalkPage(ServedPage):
    """A page of a robot that a policy walks.

    Args:
        robot: The robot.
        policy: What walks it.
        command: (3,) forward and to the left (m/s), and turning to the left (rad/s).
        **where: See ``Served``.

    Raises:
        ConfigurationError: If it cannot be served there, the base is fixed, or the language is
            neither.
        MissingPackageError: If viser is not installed.
        ModelError: If the policy does not fit the robot.
    """

    def __init__(
        self, robot: Robot, policy: Policy, command: Array, **where: Unpack[ServeOptions]
    ) -> None:
        render.import_viser()  # before the work
        stage = prepare_stage(robot, policy)
        super().__init__(
            robot.name,
            robot.stand_height,
            lambda client, say: WalkSession(client, stage, command, say),
            **where,
        )
