"""Session of a browser: panels, scene, and two threads.

One thread solves each new state at once and skips outdated states. The other thread computes sag
and explanations after a pause without changes, and runs requested simulations. The results of this
thread are shown only if the state has not changed.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from functools import partial
from time import monotonic
from typing import Any

import numpy as np

from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.base.errors import PupperAnalysisError
from pupper_analysis.present.document import Document, text
from pupper_analysis.simulation.verdict import Verdict
from pupper_analysis.stance.sag.steady_state import SteadyState
from pupper_analysis.tools.live import model as answers
from pupper_analysis.tools.live import render
from pupper_analysis.tools.live.controls import Controls
from pupper_analysis.tools.live.documents import (
    failure_document,
    live_push_document,
    live_stance_document,
    refusal_document,
    simulation_document,
    unexpected_document,
)
from pupper_analysis.tools.live.model import Answer, PageSolver
from pupper_analysis.tools.live.render import Translator
from pupper_analysis.tools.live.scene import Scene
from pupper_analysis.tools.live.state import State, write_stance_file


class Panels:
    """Panels of a page beside the scene.

    Args:
        client: viser's client.
        model: Solver of the robot's states.
        session: Session of the browser, called by buttons.
        translator: Translator into the language of the page.
    """

    def __init__(
        self, client: Any, model: PageSolver, session: Session, translator: Translator
    ) -> None:
        self._client, self._session, self.translator = client, session, translator
        gui = client.gui
        robot = model.load_robot(State())
        self._numbers = render.NumberPanel(gui, translator, "solving", 330)
        self.controls = Controls(gui, robot, translator, session.report_change)
        tabs = gui.add_tab_group()
        with tabs.add_tab(translator("stance")):
            self.controls.add_stance_controls()
            self._nearest = gui.add_button(translator("go-to-the-nearest-stance"), visible=False)
            save = gui.add_button(translator("save-the-stance"))
            reset = gui.add_button(translator("reset-all"), color="gray")
        with tabs.add_tab(translator("joints-title")):
            self.controls.add_joint_controls()
        with tabs.add_tab(translator("body-title")):
            self.controls.add_body_controls()
        with tabs.add_tab("MuJoCo"):
            self._add_simulation_controls(gui, robot.total_mass)
        self._nearest.on_click(lambda _: session.go_to_nearest())
        save.on_click(lambda _: self._download_stance())
        reset.on_click(lambda _: session.reset())

    def _add_simulation_controls(self, gui: Any, mass: float) -> None:
        """Add the controls of simulations and pushes; ``mass`` [kg] scales the largest impulse."""
        session, translator = self._session, self.translator
        simulate = gui.add_button(translator("simulate"), hint=translator("hint-simulate"))
        max_impulse = max(
            1.0, round(2.0 * mass, 1)
        )  # N s: 2 m/s topple a robot of about the height of v3
        with gui.add_folder(translator("push")):
            self._impulse = gui.add_slider(
                translator("impulse-n"), 0.0, max_impulse, max_impulse / 100, max_impulse / 10
            )
            self._direction = gui.add_slider(
                translator("towards-deg"), -180.0, 180.0, 5.0, 90.0, hint=translator("hint-towards")
            )
            push = gui.add_button(translator("push-it"))
        self._result = gui.add_html(render.render_hint(text("not-simulated-yet"), translator))
        simulate.on_click(lambda _: session.simulate())
        push.on_click(lambda _: session.push())

    def _download_stance(self) -> None:
        """Send the stance that the sliders define to the browser, as the file ``stance.toml``."""
        content = write_stance_file(self.controls.state).encode()
        self._client.send_file_download("stance.toml", content, save_immediately=True)

    @property
    def requested_push(self) -> tuple[float, float]:
        """Impulse [N s] and direction [rad, from the forward axis] of a push, from the sliders."""
        return float(self._impulse.value), math.radians(float(self._direction.value))

    def show_status(self, document: Document) -> None:
        """Show the report of the stance (loads, sag, contact forces) in the number panel."""
        self._numbers.content = render.render_panel(document, self.translator)

    def show_result(self, document: Document) -> None:
        """Show the report of a simulation in the simulation panel."""
        self._result.content = render.render_panel(document, self.translator)

    def show_waiting(self, key: str) -> None:
        """Show a text of the catalogue in the simulation panel while a simulation is running."""
        self._result.content = render.render_waiting(text(key), self.translator)

    def show_hint(self, key: str) -> None:
        """Show a text of the catalogue in place of a simulation result."""
        self._result.content = render.render_hint(text(key), self.translator)

    def clear_results(self) -> None:
        """Clear the simulation result, and hide the button of the nearest reachable stance."""
        self.show_nearest_button(False)
        self.show_hint("not-simulated-yet")

    def show_nearest_button(self, visible: bool) -> None:
        """Show or hide the button that sets the nearest reachable stance."""
        self._nearest.visible = visible


QUIET_SECONDS = 0.15
"""Age [s] of the shown stance from which the slower analysis (static deflection, stability,
explanation of a refusal) starts, if no simulation is queued. Chosen, not tuned."""

_FRAME_PERIOD = 1 / 30
"""Pause [s] after each picture of a simulated motion. Chosen, not tuned."""


class Session:
    """Session of a browser: solves, simulates and shows the stances that its user requests.

    Args:
        client: viser's client.
        model: Solver of the robot's states.
        state: Initial state.
        translator: Translator into the language of the page.

    Attributes:
        threads: Threads of the session.
    """

    def __init__(
        self,
        client: Any,
        model: PageSolver,
        state: State,
        translator: Translator,
    ) -> None:
        self._client, self._model = client, model
        self._state_changed, self._work_pending = threading.Event(), threading.Event()
        self._closed = threading.Event()
        self._lock = threading.RLock()
        self._sag: SteadyState | Diagnostic | None
        self._refusal: Any
        self._pending_job: Callable[[Answer], None] | None
        self._reset_results(None, None)
        self._scene = Scene(client.scene)
        self._panels = Panels(client, model, self, translator)
        self._panels.controls.set_state(state, notify=False)
        self.threads = [
            threading.Thread(target=work, name=f"live-{name}", daemon=True)
            for name, work in (("solve", self._run_solver), ("look", self._run_worker))
        ]
        self._state_changed.set()
        for thread in self.threads:
            thread.start()

    def close(self) -> None:
        """Request the end of the session's threads; each ends after the current work."""
        self._closed.set()
        self._state_changed.set()
        self._work_pending.set()

    def report_change(self) -> None:
        """Notify the solver thread that the user has changed a control."""
        self._state_changed.set()

    def reset(self) -> None:
        """Set the controls of stance, joints, payload and gains to the default state."""
        self._panels.controls.set_state(State(), notify=True)

    def go_to_nearest(self) -> None:
        """Set the controls to the nearest reachable stance, if one was found."""
        with self._lock:
            answer, refusal = self._answer, self._refusal
        if answer is not None and refusal is not None and refusal.nearest is not None:
            self._panels.controls.set_state(
                answer.state.with_task(refusal.nearest.task), notify=True
            )

    def simulate(self) -> None:
        """Queue a simulation of the shown stance, whose motion and verdict the page then shows."""
        self._request_job("simulating", self._simulate_stance)

    def push(self) -> None:
        """Queue a simulation of a push on the robot in the shown stance.

        Impulse and direction are those on the page, which then shows the motion.
        """
        self._request_job("pushing", self._simulate_push)

    def _request_job(self, words: str, job: Callable[[Answer], None]) -> None:
        """Queue a simulation of the current stance; without a balanced stance, show a hint.

        ``words`` is the catalogue key of the text that is shown while the user waits.
        """
        with self._lock:
            if self._answer is None or self._answer.statics is None:
                self._panels.show_hint("nothing-to-simulate")
                return
            self._panels.show_waiting(words)
            self._pending_job = job
        self._work_pending.set()

    def get_shown_stance(self) -> tuple[Answer | None, SteadyState | Diagnostic | None]:
        """Return the solved stance that the page shows, and the predicted sag of the servos.

        Returns:
            Solved stance, None before the first; predicted sag, a message if there is no
            equilibrium, or None until computed.
        """
        with self._lock:
            return self._answer, self._sag

    def _run_solver(self) -> None:
        """Solve the state of the controls whenever it changes; runs in its own thread."""
        while not self._closed.is_set():
            self._state_changed.wait()
            self._state_changed.clear()
            if self._closed.is_set():
                return
            self._run_safely(self._solve_current)
            self._work_pending.set()

    def _solve_current(self) -> None:
        """Solve the stance that the controls specify, and show the answer."""
        self._show_answer(self._model.solve_state(self._panels.controls.state))

    def _reset_results(self, answer: Answer | None, verdict: Verdict | None) -> None:
        """Store a solved stance and its first verdict; clear the results of the previous stance."""
        self._answer, self._sag, self._refusal, self._pending = answer, None, None, True
        self._verdict, self._answer_time = verdict, monotonic()
        self._pending_job = None

    def _run_safely(self, work: Callable[[], None]) -> None:
        """Run a function; show an unexpected error on the page, unless the session is closed."""
        try:
            work()
        except Exception as error:
            if not self._closed.is_set():
                with self._lock:
                    self._panels.show_status(unexpected_document(error))

    def _show_answer(self, answer: Answer) -> None:
        """Show a solved stance with a first verdict; sag and the close analysis follow later."""
        with self._lock, self._client.atomic():
            self._reset_results(answer, answers.predict_stance_verdict(answer, closely=False))
            self._scene.show(answer)
            self._show_status()
            self._panels.clear_results()

    def _show_status(self) -> None:
        """Show loads, sag and contact forces of the current stance in the number panel."""
        answer = self._answer
        assert answer is not None
        if answer.unreachable:
            message = refusal_document(answer, self._refusal, pending=self._pending)
        else:
            message = live_stance_document(answer, self._sag, self._verdict)
        self._panels.show_status(message)

    def _run_worker(self) -> None:
        """Analyse the shown stance closely and run queued simulations, until the page is closed."""
        analysed: Answer | None = None
        while not self._closed.is_set():
            self._work_pending.wait()
            self._work_pending.clear()
            with self._lock:
                answer, job, answer_time = self._answer, self._pending_job, self._answer_time
                self._pending_job = None
            if answer is None or self._closed.is_set():
                continue
            if answer is not analysed:
                remaining = QUIET_SECONDS - (monotonic() - answer_time)
                if job is None and remaining > 0 and not self._closed.wait(remaining):
                    self._work_pending.set()
                    continue
                self._run_safely(partial(self._analyse_closely, answer))
                analysed = answer
            if job is not None:
                self._run_safely(partial(self._run_job, job, answer))

    def _run_job(self, job: Callable[[Answer], None], answer: Answer) -> None:
        """Run a simulation; an error of this package is shown as the result on the page."""
        try:
            job(answer)
        except PupperAnalysisError as error:
            self._run_if_current(answer, partial(self._panels.show_result, failure_document(error)))

    def _run_if_current(self, answer: Answer, show: Callable[[], None]) -> bool:
        """Call ``show`` if the page still shows the stance ``answer``; return True if called."""
        with self._lock:
            if self._answer is not answer or self._closed.is_set():
                return False
            with self._client.atomic():
                show()
            return True

    def _analyse_closely(self, answer: Answer) -> None:
        """Analyse the shown stance in detail, and show the result."""
        if answer.unreachable:
            error = answers.explain_unreachable(answer)
            assert answer.robot is not None
            robot = answer.robot

            def show_refusal() -> None:
                """Show the error of the unreachable stance, and the nearest reachable stance."""
                self._refusal, self._pending = error, False
                self._show_status()
                nearest = None if error is None else error.nearest
                self._panels.show_nearest_button(nearest is not None)
                self._scene.draw_ghost(robot, nearest)

            self._run_if_current(answer, show_refusal)
        elif answer.statics is not None:
            sag, verdict = (
                answers.predict_sag(answer),
                answers.predict_stance_verdict(answer, closely=True),
            )

            def show_sag() -> None:
                """Show the predicted sag and the predicted verdict."""
                self._sag, self._verdict = sag, verdict
                self._show_status()

            self._run_if_current(answer, show_sag)

    def _simulate_stance(self, answer: Answer) -> None:
        """Simulate the stance and show the motion."""
        stance = answers.simulate_stance(answer)
        run, message = stance.sagging, simulation_document(stance)
        self._show_motion(answer, message, run.motion_time, run.motion, stance.verdict)

    def _simulate_push(self, answer: Answer) -> None:
        """Simulate a push and show the motion."""
        impulse, direction = self._panels.requested_push
        trial = answers.push_stand(answer, impulse, direction)
        message = live_push_document(trial)
        self._show_motion(answer, message, trial.motion_time, trial.motion)

    def _show_motion(
        self,
        answer: Answer,
        document: Document,
        time: Any,
        motion: Any,
        verdict: Verdict | None = None,
    ) -> None:
        """Show the result of a simulation and play the motion, if ``answer`` is still shown.

        ``time`` are times, shape (n,) [s]; ``motion`` are configurations, shape (n, nq).
        ``verdict`` replaces the predicted verdict, unless None.
        """

        def show() -> None:
            self._verdict = verdict or self._verdict
            self._show_status()
            self._panels.show_result(document)

        if self._run_if_current(answer, show):
            self._play_motion(answer, time, motion)

    def _play_motion(self, answer: Answer, time: Any, motion: Any) -> None:
        """Play a motion in real time on the page, until the motion ends or is interrupted.

        ``time`` are times, shape (n,) [s]; ``motion`` are configurations, shape (n, nq).
        """
        robot, task = answer.robot, answer.task
        assert robot is not None
        assert task is not None
        times, start, elapsed = time - time[0], monotonic(), 0.0
        while elapsed < times[-1] and not self._work_pending.is_set():
            elapsed = min(monotonic() - start, float(times[-1]))

            def show(instant: float = elapsed) -> None:
                qpos = interpolate_motion(times, motion, instant)
                self._scene.draw_twin(robot, qpos, task.ground)

            if not self._run_if_current(answer, show) or self._closed.wait(_FRAME_PERIOD):
                return


def interpolate_motion(times: Any, motion: Any, instant: float) -> Any:
    """Return the configuration of a motion at an instant, by linear interpolation.

    Args:
        times: Times of the samples, shape (n,) [s], not decreasing.
        motion: Configurations of a robot with a free base, shape (n, nq) [m, quaternion, rad].
        instant: Time [s], clipped to the first and last sample.

    Returns:
        Configuration, shape (nq,), with a normalised quaternion.
    """
    after = min(int(np.searchsorted(times, instant)), len(times) - 1)
    before = max(after - 1, 0)
    step = times[after] - times[before]
    weight = (instant - times[before]) / step if step > 0 else 0.0
    start, end = motion[before].copy(), motion[after].copy()
    if start[3:7] @ end[3:7] < 0:  # q and -q are the same rotation: take the nearer one
        end[3:7] *= -1
    qpos = start + np.clip(weight, 0.0, 1.0) * (end - start)
    qpos[3:7] /= np.linalg.norm(qpos[3:7])
    return qpos
