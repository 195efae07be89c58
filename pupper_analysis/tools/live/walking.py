"""Page of a walking policy: sliders for the command, buttons for pushes.

Each browser has a `WalkSession`. Its thread simulates the robot in real time with the velocity
command of the sliders, draws the robot, and reports speeds and motor torques of the last second.
After a fall the session waits for a restart.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import Any, Unpack

import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import text
from pupper_analysis.present.documents.loads import limit_cell
from pupper_analysis.robot.joints import get_common_units
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.live import render
from pupper_analysis.tools.live.documents import unexpected_document
from pupper_analysis.tools.live.render import Translator
from pupper_analysis.tools.live.scene import RobotFigure, make_body_meshes
from pupper_analysis.tools.live.server import ServedPage, ServeOptions
from pupper_analysis.tools.walk.gait import describe_run_failure, evaluate_tracking, joint_torques
from pupper_analysis.tools.walk.policy import Policy
from pupper_analysis.tools.walk.runs import (
    Lockstep,
    PolicyRun,
    Stage,
    make_push_forces,
    prepare_stage,
)

_MAX_SPEED, _MAX_TURNING_RATE, _MAX_PUSH = 1.0, 2.0, 3.0
"""Upper bounds of the sliders: speed [m/s], turning rate [rad/s], push [N s per kg of the robot].
A larger initial command extends the bounds of speed and turning rate. Chosen, not tuned."""

_AVERAGING_TIME, _TABLE_PERIOD, _FRAME_INTERVAL = 1.0, 0.25, 0.04
"""Times of a walk on the page [s]: interval over which speeds and torques are averaged, also the
largest delay that the simulation makes up; interval between two tables; interval between two
pictures. Chosen, not tuned."""

_COMMAND_AXES = ("forward", "left", "turning")
"""Names of the components of a velocity command: forward and left [m/s], turning left [rad/s]."""

PUSH_DIRECTIONS = {"forward": (1.0, 0.0), "backward": (-1.0, 0.0), "left": (0.0, 1.0),
              "right": (0.0, -1.0)}  # fmt: skip
"""Direction of each push (x, y) in the world frame, named for a robot that faces along x."""


class WalkSession:
    """Session of a browser: a walking robot that is simulated in real time until a fall.

    Args:
        client: viser's client.
        stage: Policy on the robot.
        command: Initial forward speed, speed to the left [m/s] and turning rate to the left
            [rad/s], shape (3,).
        translator: Translator into the language of the page.
    """

    def __init__(self, client: Any, stage: Stage, command: Array, translator: Translator) -> None:
        self._client, self._stage, self._translator = client, stage, translator
        self._closed, self._restart = threading.Event(), threading.Event()
        self._lock = threading.Lock()
        self._requested_push: tuple[float, float] | None = None
        self.fall: Diagnostic | None = None
        gui, scene = client.gui, client.scene
        self._numbers = render.NumberPanel(gui, translator, "walking-begins")
        self.sliders = [
            gui.add_slider(
                translator.translate(text(f"walking-slider-{name}")),
                -bound,
                bound,
                0.01 * bound,
                float(value),
            )
            for name, value, bound in zip(
                _COMMAND_AXES,
                command,
                np.maximum((_MAX_SPEED, _MAX_SPEED, _MAX_TURNING_RATE), np.abs(command)).tolist(),
                strict=True,
            )
        ]
        self.impulse = gui.add_slider(
            translator("walking-slider-push"), 0.0, _MAX_PUSH, 0.01 * _MAX_PUSH, 0.5
        )
        for name, (x, y) in PUSH_DIRECTIONS.items():
            button = gui.add_button(translator.translate(text(f"walking-push-to-{name}")))
            button.on_click(lambda _, x=x, y=y: self.push(x, y))
        restart = gui.add_button(translator("walking-again"))
        restart.on_click(lambda _: self.restart_walk())
        robot = stage.robot
        self._figure = RobotFigure(scene, "/walking", robot, make_body_meshes(robot.mj_model))
        self._cell_size = robot.stand_height
        self._grid = scene.add_grid(
            "/ground",
            12 * self._cell_size,
            12 * self._cell_size,
            cell_size=0.5 * self._cell_size,
            section_size=self._cell_size,
        )
        work = threading.Thread(target=self._run_simulations, name="live-walking", daemon=True)
        self.threads = [work]
        work.start()

    def close(self) -> None:
        """Request the end of the thread that simulates the walking robot."""
        self._closed.set()
        self._restart.set()

    def push(self, x: float, y: float) -> None:
        """Request a push in a horizontal direction, during the next action of the policy.

        The velocity change [m/s] is the value of the slider times (x, y), in world axes.
        """
        size = float(self.impulse.value) * self._stage.robot.total_mass
        with self._lock:
            self._requested_push = (x * size, y * size)

    def restart_walk(self) -> None:
        """Request a restart of the simulation from the initial state."""
        self._restart.set()

    def _run_simulations(self) -> None:
        """Loop of the thread: simulate until a fall, then wait for a restart."""
        while not self._closed.is_set():
            self._restart.clear()
            try:
                self._simulate_walk()
            except Exception as error:  # unexpected: shown on the page
                if not self._closed.is_set():
                    self._numbers.content = render.render_panel(
                        unexpected_document(error), self._translator
                    )
            self._restart.wait()  # a fallen robot remains until a restart is requested

    def _simulate_walk(self) -> None:
        """Simulate until a fall, a restart, or the end of the session."""
        stage, self.fall = self._stage, None
        case = stage.make_case(np.array([slider.value for slider in self.sliders]))
        runs, action = Lockstep(stage, [case]), stage.substeps * stage.timestep
        recent: deque[tuple[Array, Array]] = deque(maxlen=max(2, round(_AVERAGING_TIME / action)))
        draw_interval, table_interval = (
            max(1, round(period / action)) for period in (_FRAME_INTERVAL, _TABLE_PERIOD)
        )
        due = time.monotonic()
        while not self._restart.is_set():
            runs.commands[0] = [slider.value for slider in self.sliders]
            with self._lock:
                push, self._requested_push = self._requested_push, None
            forces = None if push is None else make_push_forces(stage, [push])
            states, control, broken = runs.advance(forces)
            recent.append((states[0], control[0]))
            fallen = bool(broken[0]) or stage.upright.has_fallen(runs.current[0])
            window = PolicyRun(
                case=stage.make_case(runs.commands[0].copy()),
                states=np.concatenate([array for array, _ in recent]),
                targets=np.concatenate([array for _, array in recent]),
                fallen=fallen,
                lean=0.0,
                lost=0.0,
            )
            if fallen:
                self.fall = describe_run_failure(stage, window, runs.tick * action)
            if runs.tick % draw_interval == 0 or fallen:
                self._draw_robot(runs.current[0])
            if runs.tick % table_interval == 0 or fallen:
                page = walking_document(stage, window, runs.tick * action, self.fall)
                self._numbers.content = render.render_panel(page, self._translator)
            if fallen:
                return
            due = max(
                due + action, time.monotonic() - _AVERAGING_TIME
            )  # on a slow machine the motion is slower than real time
            self._closed.wait(max(0.0, due - time.monotonic()))

    def _draw_robot(self, state: Array) -> None:
        """Draw the walking robot fixed above the origin; the grid of the ground moves instead.

        ``state`` is MuJoCo's full physics state, shape (size,).
        """
        qpos = state[1 + self._stage.robot.mj_convention.qpos_index].copy()
        if not np.isfinite(qpos).all():
            return
        place = np.array([qpos[0], qpos[1], 0.0])
        qpos[:2] = 0.0
        with self._client.atomic():
            self._figure.set_configuration(qpos)
            self._grid.position = -np.fmod(place, self._cell_size)


def walking_document(
    stage: Stage, window: PolicyRun, duration: float, fall: Diagnostic | None
) -> doc.Document:
    """Create the report of the latest walking: actual and commanded speeds, motor torques.

    ``window`` contains about the last second, ``duration`` is the simulated time since the start
    [s].
    """
    tracking, torques = (
        evaluate_tracking(stage, window, 0.0),
        np.nan_to_num(joint_torques(stage, window)),
    )
    rms, peak = np.sqrt((torques**2).mean(axis=0)), np.abs(torques).max(axis=0)
    limits = stage.robot.effort_limits
    commanded, reached = window.case.command, (*tracking.velocity, tracking.turning)
    speeds = doc.Table(
        text("walking-speeds"),
        (doc.Column(doc.Name(""), left=True), doc.Column(doc.Name(""), left=True)),
        tuple(
            (
                text(f"walking-slider-{name}"),
                text("walking-of", reached=f"{actual:z.2f}", asked=f"{target:z.2f}"),
            )
            for name, actual, target in zip(_COMMAND_AXES, reached, commanded, strict=True)
        ),
    )
    unit = get_common_units(stage.robot, stage.robot.joint_names).effort
    motors = doc.Table(
        text("walking-motors"),
        (
            doc.Column(text("walking-motor"), left=True),
            *(
                doc.Column(text(f"walking-{name}"), unit)
                for name in ("mean", "most", "ends")
            ),
        ),
        tuple(
            (doc.Name(name), doc.number_cell(rms[index], ".2f"),
             doc.number_cell(peak[index], ".2f"), limit_cell(float(limits[index]), ".2f"))
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
    """Page of a robot with a walking policy.

    Args:
        robot: Robot.
        policy: Policy.
        command: Initial forward speed, speed to the left [m/s] and turning rate to the left
            [rad/s], shape (3,).
        **server_options: See `ServedPage`.

    Raises:
        ConfigurationError: If the server cannot use this address, the base is fixed, the robot has
            no feet, the policy acts more than once per time step, or the language is unknown.
        MissingPackageError: If viser is not installed.
        ModelError: If the policy does not fit the robot.
    """

    def __init__(
        self, robot: Robot, policy: Policy, command: Array, **server_options: Unpack[ServeOptions]
    ) -> None:
        render.import_viser()  # before time-consuming work
        stage = prepare_stage(robot, policy)
        super().__init__(
            robot.name,
            robot.stand_height,
            lambda client, translator: WalkSession(client, stage, command, translator),
            **server_options,
        )
