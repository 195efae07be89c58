"""One browser's page: its panels, its scene, and the two threads that answer it.

The left panel takes the robot and the stance, the right one shows what it costs. One thread solves
each state at once, and passes over those that are out of date. The other one does what takes
longer, when nothing has changed for a moment: where servos settle, why a stance is out of reach,
simulations. What it finds is shown only with the stance that it is about.
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
    push_document,
    refusal_document,
    simulation_document,
    stance_document,
    unexpected_document,
)
from pupper_analysis.tools.live.model import Answer, StanceSolver
from pupper_analysis.tools.live.render import Language
from pupper_analysis.tools.live.scene import Scene
from pupper_analysis.tools.live.state import State, write_stance_file


class Panels:
    """All that a page has beside its scene.

    Args:
        client: viser's handle of a browser.
        model: Answers for the robot.
        acts: What buttons do.
        say: The language.
    """

    def __init__(self, client: Any, model: StanceSolver, acts: Session, say: Language) -> None:
        self._client, self._acts, self.say = client, acts, say
        gui = client.gui
        robot = model.load_robot(State())
        self._numbers = render.NumberPanel(gui, say, "solving", 330)
        self.controls = Controls(gui, robot, say, acts.changed)
        tabs = gui.add_tab_group()
        with tabs.add_tab(say("stance")):
            self.controls.add_stance_controls()
            self._nearest = gui.add_button(say("go-to-the-nearest-stance"), visible=False)
            save = gui.add_button(say("save-the-stance"))
            reset = gui.add_button(say("reset-all"), color="gray")
        with tabs.add_tab(say("joints-title")):
            self.controls.add_joint_controls()
        with tabs.add_tab(say("body-title")):
            self.controls.add_body_controls()
        with tabs.add_tab("MuJoCo"):
            self._simulation(gui, robot.total_mass)
        self._nearest.on_click(lambda _: acts.go_to_nearest())
        save.on_click(lambda _: self._save())
        reset.on_click(lambda _: acts.reset())

    def _simulation(self, gui: Any, mass: float) -> None:
        acts, say = self._acts, self.say
        simulate = gui.add_button(say("simulate"), hint=say("hint-simulate"))
        most = max(1.0, round(2.0 * mass, 1))  # N s: 2 m/s tip over what is about as high as v3
        with gui.add_folder(say("push")):
            self._impulse = gui.add_slider(say("impulse-n"), 0.0, most, most / 100, most / 10)
            self._direction = gui.add_slider(
                say("towards-deg"), -180.0, 180.0, 5.0, 90.0, hint=say("hint-towards")
            )
            push = gui.add_button(say("push-it"))
        self._result = gui.add_html(render.render_hint(text("not-simulated-yet"), say))
        simulate.on_click(lambda _: acts.simulate())
        push.on_click(lambda _: acts.push())

    def _save(self) -> None:
        """Sends a file to the browser, of the stance that is asked for."""
        content = write_stance_file(self.controls.state).encode()
        self._client.send_file_download("stance.toml", content, save_immediately=True)

    @property
    def push_asked(self) -> tuple[float, float]:
        """How hard (N s), and where to (rad)."""
        return float(self._impulse.value), math.radians(float(self._direction.value))

    def status(self, document: Document) -> None:
        """Shows what it takes."""
        self._numbers.content = render.render_panel(document, self.say)

    def result(self, document: Document) -> None:
        """Shows the results of a simulation."""
        self._result.content = render.render_panel(document, self.say)

    def wait(self, key: str) -> None:
        """Shows that a simulation is under way."""
        self._result.content = render.render_waiting(text(key), self.say)

    def hint(self, key: str) -> None:
        """Shows why there is no result of a simulation."""
        self._result.content = render.render_hint(text(key), self.say)

    def answered(self) -> None:
        """Shows that a state has changed."""
        self.nearest(False)
        self.hint("not-simulated-yet")

    def nearest(self, there: bool) -> None:
        """Shows the way to the nearest stance, if there is one."""
        self._nearest.visible = there


QUIET_SECONDS = 0.15
"""s without a change after which it is worth to look closer: a hand on a slider moves on sooner."""

_FRAME = 1 / 30  # s between the pictures of a motion


class Session:
    """What a browser sees and does.

    Args:
        client: viser's handle of the browser.
        model: Answers for the robot.
        state: What it begins with.
        say: The page's language.
    """

    def __init__(
        self,
        client: Any,
        model: StanceSolver,
        state: State,
        say: Language,
    ) -> None:
        self._client, self._model = client, model
        self._asked, self._think = threading.Event(), threading.Event()
        self._closed = threading.Event()
        self._lock = threading.RLock()
        self._sag: SteadyState | Diagnostic | None
        self._refusal: Any
        self._job: Callable[[Answer], None] | None
        self._begin(None, None)
        self._scene = Scene(client.scene)
        self._panels = Panels(client, model, self, say)
        self._panels.controls.set_state(state, notify=False)
        self.threads = [
            threading.Thread(target=work, name=f"live-{name}", daemon=True)
            for name, work in (("solve", self._solving), ("look", self._looking))
        ]
        self._asked.set()
        for thread in self.threads:
            thread.start()

    def close(self) -> None:
        """Ends the threads, as soon as what they are at is done."""
        self._closed.set()
        self._asked.set()
        self._think.set()

    def changed(self) -> None:
        """Is called when the controls say something else."""
        self._asked.set()

    def reset(self) -> None:
        """Goes back to where a page begins."""
        self._panels.controls.set_state(State(), notify=True)

    def go_to_nearest(self) -> None:
        """Goes to the ghost."""
        with self._lock:
            answer, refusal = self._answer, self._refusal
        if answer is not None and refusal is not None and refusal.nearest is not None:
            self._panels.controls.set_state(
                answer.state.with_task(refusal.nearest.task), notify=True
            )

    def simulate(self) -> None:
        """Simulates the stance."""
        self._do("simulating", self._simulate)

    def push(self) -> None:
        """Pushes the stance."""
        self._do("pushing", self._push)

    def _do(self, words: str, job: Callable[[Answer], None]) -> None:
        with self._lock:
            if self._answer is None or self._answer.statics is None:
                self._panels.hint("nothing-to-simulate")
                return
            self._panels.wait(words)
            self._job = job
        self._think.set()

    def export(self) -> tuple[Answer | None, SteadyState | Diagnostic | None]:
        """Returns what is shown, whole."""
        with self._lock:
            return self._answer, self._sag

    def _solving(self) -> None:
        """Answers states, one after the other."""
        while not self._closed.is_set():
            self._asked.wait()
            self._asked.clear()
            if self._closed.is_set():
                return
            self._safely(self._solve)
            self._think.set()

    def _solve(self) -> None:
        """Answers the state that the controls say."""
        self._show(self._model.solve_state(self._panels.controls.state))

    def _begin(self, answer: Answer | None, verdict: Verdict | None) -> None:
        """Forgets what was found of the answer before."""
        self._answer, self._sag, self._refusal, self._pending = answer, None, None, True
        self._verdict, self._since = verdict, monotonic()
        self._job = None

    def _safely(self, work: Callable[[], None]) -> None:
        """Does some work; an error that nobody foresaw is shown, and the page lives on."""
        try:
            work()
        except Exception as error:
            if not self._closed.is_set():
                with self._lock:
                    self._panels.status(unexpected_document(error))

    def _show(self, answer: Answer) -> None:
        """Shows an answer, and that what follows from it is not known yet."""
        with self._lock, self._client.atomic():
            self._begin(answer, answers.predict_stance_verdict(answer, closely=False))
            self._scene.show(answer)
            self._tell()
            self._panels.answered()

    def _tell(self) -> None:
        answer = self._answer
        assert answer is not None
        if answer.unreachable:
            message = refusal_document(answer, self._refusal, pending=self._pending)
        else:
            message = stance_document(answer, self._sag, self._verdict)
        self._panels.status(message)

    def _looking(self) -> None:
        """Looks closer at what stays, and simulates."""
        done: Answer | None = None
        while not self._closed.is_set():
            self._think.wait()
            self._think.clear()
            with self._lock:
                answer, job, since = self._answer, self._job, self._since
                self._job = None
            if answer is None or self._closed.is_set():
                continue
            if answer is not done:
                left = QUIET_SECONDS - (monotonic() - since)
                if job is None and left > 0 and not self._closed.wait(left):
                    self._think.set()
                    continue
                self._safely(partial(self._look, answer))
                done = answer
            if job is not None:
                self._safely(partial(self._run, job, answer))

    def _run(self, job: Callable[[Answer], None], answer: Answer) -> None:
        """Runs a simulation; what is wrong with it is its result."""
        try:
            job(answer)
        except PupperAnalysisError as error:
            self._if_shown(answer, partial(self._panels.result, failure_document(error)))

    def _if_shown(self, answer: Answer, show: Callable[[], None]) -> bool:
        """Shows something of an answer, if that is still the one that is shown."""
        with self._lock:
            if self._answer is not answer or self._closed.is_set():
                return False
            with self._client.atomic():
                show()
            return True

    def _look(self, answer: Answer) -> None:
        """Finds out what takes longer."""
        if answer.unreachable:
            error = answers.explain_unreachable(answer)
            assert answer.robot is not None
            robot = answer.robot

            def show_refusal() -> None:
                self._refusal, self._pending = error, False
                self._tell()
                nearest = None if error is None else error.nearest
                self._panels.nearest(nearest is not None)
                self._scene.ghost(robot, nearest)

            self._if_shown(answer, show_refusal)
        elif answer.statics is not None:
            sag, verdict = (
                answers.predict_sag(answer),
                answers.predict_stance_verdict(answer, closely=True),
            )

            def show_sag() -> None:
                self._sag, self._verdict = sag, verdict
                self._tell()

            self._if_shown(answer, show_sag)

    def _simulate(self, answer: Answer) -> None:
        stance = answers.simulate_stance(answer)
        run, message = stance.sagging, simulation_document(stance)
        self._show_motion(answer, message, run.motion_time, run.motion, stance.verdict)

    def _push(self, answer: Answer) -> None:
        impulse, direction = self._panels.push_asked
        trial = answers.push_stand(answer, impulse, direction)
        message = push_document(trial)
        self._show_motion(answer, message, trial.motion_time, trial.motion)

    def _show_motion(
        self,
        answer: Answer,
        document: Document,
        time: Any,
        motion: Any,
        verdict: Verdict | None = None,
    ) -> None:
        """Shows the results of a simulation, and plays it."""

        def show() -> None:
            self._verdict = verdict or self._verdict
            self._tell()
            self._panels.result(document)

        if self._if_shown(answer, show):
            self._play(answer, time, motion)

    def _play(self, answer: Answer, time: Any, motion: Any) -> None:
        """Plays a motion once; it stays at its end. Ends when there is something else to do."""
        robot, task = answer.robot, answer.task
        assert robot is not None
        assert task is not None
        times, begin, at = time - time[0], monotonic(), 0.0
        while at < times[-1] and not self._think.is_set():
            at = min(monotonic() - begin, float(times[-1]))

            def show(at: float = at) -> None:
                qpos = interpolate_motion(times, motion, at)
                self._scene.twin(robot, qpos, task.ground)

            if not self._if_shown(answer, show) or self._closed.wait(_FRAME):
                return


def interpolate_motion(times: Any, motion: Any, at: float) -> Any:
    """Returns a configuration (nq,) of a motion (n, nq) at a time, between its samples."""
    after = int(np.clip(np.searchsorted(times, at), 1, len(times) - 1))
    before = after - 1
    share = (at - times[before]) / (times[after] - times[before])
    one, other = motion[before].copy(), motion[after].copy()
    if one[3:7] @ other[3:7] < 0:  # the same rotation, on the nearer side
        other[3:7] *= -1
    qpos = one + np.clip(share, 0.0, 1.0) * (other - one)
    qpos[3:7] /= np.linalg.norm(qpos[3:7])
    return qpos
