"""One browser's page: its controls, its scene, and the two threads that answer it.

One thread solves each state at once, and passes over those that are out of date by then. The other
one does what takes longer, when nothing has changed for a moment: where servos settle, why a stance
is out of reach, and simulations. What it finds is shown only with the stance that it is about.
"""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from pupper_analysis.errors import PupperAnalysisError
from pupper_analysis.live import model as answers
from pupper_analysis.live import text
from pupper_analysis.live.model import Answer, Model, Sag
from pupper_analysis.live.panels import Panels
from pupper_analysis.live.scene import Scene
from pupper_analysis.live.state import State, parse

QUIET = 0.15
"""s without a change after which it is worth to look closer: a hand on a slider moves on sooner."""

_FRAME = 1 / 30  # s between the pictures of a motion

_numbers = itertools.count(1)


class Session:
    """What a browser sees and does.

    Args:
        client: viser's handle of the browser.
        model: Answers for the robot.
        state: What it begins with.
        address: Host and port, as the browser reaches the server.
        problem: What was wrong with the state that it asked for; empty if nothing.
    """

    def __init__(
        self, client: Any, model: Model, state: State, address: str, problem: str = ""
    ) -> None:
        self._client, self._model = client, model
        self._asked, self._think = threading.Event(), threading.Event()
        self._closed = threading.Event()
        self._lock = threading.RLock()
        self._answer: Answer | None = None
        self._sag: Sag | None = None
        self._refusal: Any = None
        self._job: Callable[[Answer], None] | None = None
        self._since = 0.0
        self._scene = Scene(client.scene)
        self._panels = Panels(client, model, address, self)
        self._panels.controls.put(state, told=False)
        if problem:
            self._panels.notify("This state cannot be shown", problem)
        number = next(_numbers)
        self.threads = [
            threading.Thread(target=work, name=f"live-{number}-{name}", daemon=True)
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
        """Is told that the controls say something else."""
        self._asked.set()

    def reset(self) -> None:
        """Goes back to where a page begins."""
        self._panels.controls.put(State(), told=True)

    def go_to(self, words: str) -> None:
        """Goes to a state that is given as a text."""
        try:
            self._panels.controls.put(parse(words), told=True)
        except PupperAnalysisError as error:
            self._panels.notify("This is no state", str(error))

    def go_to_nearest(self) -> None:
        """Goes to the ghost."""
        with self._lock:
            answer, refusal = self._answer, self._refusal
        if answer is not None and refusal is not None and refusal.nearest is not None:
            self._panels.controls.put(answer.state.with_task(refusal.nearest.task), told=True)

    def draw_again(self, labels: bool) -> None:
        """Shows the names of all joints, or of one."""
        with self._lock:
            self._scene.joint_labels = labels
            if self._answer is not None and self._answer.stand is not None:
                self._scene.show(self._answer)

    def simulate(self) -> None:
        """Simulates the stance."""
        self._do("simulating …", self._simulate)

    def push(self) -> None:
        """Pushes the stance."""
        self._do("pushing …", self._push)

    def _do(self, words: str, job: Callable[[Answer], None]) -> None:
        with self._lock:
            if self._answer is None or self._answer.statics is None:
                self._panels.result(text.nothing("There is no stance that could be simulated."))
                return
            self._panels.result(text.waiting(words))
            self._job = job
        self._think.set()

    def export(self) -> tuple[Answer | None, Sag | None]:
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
        state = self._panels.controls.state
        if not self._model.made(state):
            self._panels.status(text.waiting("making the robot …"))
        answer = self._model.answer(state)
        with self._lock, self._client.atomic():
            self._answer, self._sag, self._refusal = answer, None, None
            self._job, self._since = None, time.monotonic()
            self._show(answer)

    def _safely(self, work: Callable[[], None]) -> None:
        """Does some work; an error that nobody foresaw is shown, and the page lives on."""
        try:
            work()
        except Exception as error:
            if not self._closed.is_set():
                self._panels.status(text.unforeseen(error))

    def _show(self, answer: Answer) -> None:
        """Shows an answer, and that what follows from it is not known yet."""
        self._scene.show(answer)
        if answer.unreachable:
            self._panels.status(text.refusal(answer, None, pending=True))
        else:
            self._panels.status(text.numbers(answer, None))
        self._panels.answered(answer)

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
                left = QUIET - (time.monotonic() - since)
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
            self._if_shown(answer, partial(self._panels.result, text.failure(error)))

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
            error = answers.explained(answer)
            assert answer.robot is not None
            robot = answer.robot

            def show_refusal() -> None:
                self._refusal = error
                self._panels.status(text.refusal(answer, error, pending=False))
                self._panels.limits(error)
                self._scene.ghost(robot, None if error is None else error.nearest)

            self._if_shown(answer, show_refusal)
        elif answer.statics is not None:
            sag = answers.sag(answer)

            def show_sag() -> None:
                self._sag = sag
                self._panels.status(text.numbers(answer, sag))

            self._if_shown(answer, show_sag)

    def _simulate(self, answer: Answer) -> None:
        held = answers.held_stand(answer)
        report = answers.simulated(answer, held, feedforward=self._panels.feedforward)
        said = text.simulation(report, held, self._sag)
        if self._if_shown(answer, lambda: self._panels.result(said)):
            self._play(answer, report.motion_time, report.motion)

    def _push(self, answer: Answer) -> None:
        impulse, direction = self._panels.push_asked
        trial = answers.pushed(answer, impulse, direction, feedforward=self._panels.feedforward)
        if self._if_shown(answer, lambda: self._panels.result(text.push(trial))):
            self._play(answer, trial.motion_time, trial.motion)

    def _play(self, answer: Answer, times: Any, motion: Any) -> None:
        """Plays a motion once; it stays at its end. Ends when there is something else to do."""
        assert answer.robot is not None
        assert answer.task is not None
        robot, ground = answer.robot, answer.task.ground
        begin = time.monotonic()
        last = False
        while not last and not self._think.is_set():
            at = time.monotonic() - begin
            last = at >= times[-1] - times[0]
            qpos = between(times - times[0], motion, min(at, times[-1] - times[0]))
            beside = self._panels.beside

            def show(qpos: Any = qpos, beside: bool = beside) -> None:
                self._scene.twin(robot, qpos, ground, beside=beside)

            if not self._if_shown(answer, show) or self._closed.wait(_FRAME):
                return


def between(times: Any, motion: Any, at: float) -> Any:
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
