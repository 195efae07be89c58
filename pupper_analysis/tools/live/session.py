"""One browser's page: its panels, its scene, and the two threads that answer it.

The left panel takes the robot and the stance, the right one shows what it costs. One thread solves
each state at once, and passes over those that are out of date. The other one does what takes
longer, when nothing has changed for a moment: where servos settle, why a stance is out of reach,
simulations. What it finds is shown only with the stance that it is about.
"""

from __future__ import annotations

import itertools
import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import numpy as np

from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.base.errors import PupperAnalysisError
from pupper_analysis.present.document import Document, text
from pupper_analysis.present.formats import escape_control
from pupper_analysis.simulation.verdict import Verdict
from pupper_analysis.tools.live import export, render
from pupper_analysis.tools.live import model as answers
from pupper_analysis.tools.live.controls import Controls
from pupper_analysis.tools.live.documents import (
    brief_document,
    failure_document,
    push_document,
    refusal_document,
    simulation_document,
    stance_document,
    unforeseen_document,
)
from pupper_analysis.tools.live.model import (
    Answer,
    Model,
    PredictedSag,
)
from pupper_analysis.tools.live.render import Language, clear_but_tabs, named_tabs
from pupper_analysis.tools.live.scene import Scene
from pupper_analysis.tools.live.state import State, parse_state


class Acts(Protocol):
    """What the buttons of a page do."""

    def changed(self) -> None:
        """Is told that the controls say something else."""

    def reset(self) -> None:
        """Goes back to where a page begins."""

    def go_to(self, words: str) -> None:
        """Goes to a state that is given as a text."""

    def go_to_nearest(self) -> None:
        """Goes to the ghost."""

    def simulate(self) -> None:
        """Simulates the stance."""

    def push(self) -> None:
        """Pushes the stance."""

    def play(self) -> None:
        """Plays what was simulated once more."""

    def go_to_time(self, seconds: float) -> None:
        """Shows what was simulated at a time."""

    def speak(self, language: Language) -> None:
        """Goes on in another language."""

    def export(self) -> tuple[Answer | None, PredictedSag | None]:
        """Returns what is shown, whole."""


class Panels:
    """All that a page has beside its scene.

    Args:
        client: viser's handle of a browser.
        model: Answers for the robot.
        address: Host and port, as the browser reaches the server.
        acts: What buttons do.
        say: The language.
        before: The panels before, in the place of which these are; their tabs stay.
    """

    def __init__(
        self,
        client: Any,
        model: Model,
        address: str,
        acts: Acts,
        say: Language | None = None,
        before: Panels | None = None,
    ) -> None:
        self._client, self._model, self._address, self._acts = client, model, address, acts
        self.say = say = say or Language()
        gui = client.gui
        robot = model.robot(State())
        if before is not None:
            clear_but_tabs(gui, before.tabs)
        left = gui.add_panel()
        with left.add_tab(say("what-it-takes")):
            self._numbers = gui.add_html(render.render_waiting(text("solving"), say))
        left.dock_left()
        left.set_width(330)
        self.controls = Controls(gui, robot, model.source.scales, say, acts.changed)
        gui.add_html(render.PHONE)
        self._brief = gui.add_html("")
        other = gui.add_button(say.other.name, color="gray")
        names = (
            *map(say, ("stance", "joints-title", "body-title")),
            "MuJoCo",
            say("share-title"),
        )
        kept = None if before is None else before.tabs
        self.tabs: Any
        self.tabs, (stance, joints, body, simulated, share) = named_tabs(gui, names, other, kept)
        with stance:
            self.controls.stance()
            self._nearest = gui.add_button(say("go-to-the-nearest-stance"), visible=False)
            reset = gui.add_button(say("reset-all"), color="gray")
        with joints:
            self.controls.joints()
        with body:
            self.controls.body()
        with simulated:
            self._simulation(gui, robot.total_mass)
        with share:
            self._share(gui)
        other.on_click(lambda _: acts.speak(say.other))
        self._nearest.on_click(lambda _: acts.go_to_nearest())
        reset.on_click(lambda _: acts.reset())
        gui.main_panel.dock_right()
        gui.main_panel.set_width(360)

    def _simulation(self, gui: Any, mass: float) -> None:
        acts, say = self._acts, self.say
        self._feedforward = gui.add_checkbox(
            say("feed-forward"), False, hint=say("hint-feed-forward")
        )
        simulate = gui.add_button(say("simulate"), hint=say("hint-simulate"))
        most = max(1.0, round(2.0 * mass, 1))  # N s: 2 m/s tip over what is about as high as v3
        with gui.add_folder(say("push")):
            self._impulse = gui.add_slider(say("impulse-n"), 0.0, most, most / 100, most / 10)
            self._direction = gui.add_slider(
                say("towards-deg"), -180.0, 180.0, 5.0, 90.0, hint=say("hint-towards")
            )
            push = gui.add_button(say("push-it"))
        self._beside = gui.add_checkbox(say("beside-the-prediction"), True)
        self._time = gui.add_slider(say("time-s"), 0.0, 1.0, 0.01, 0.0, visible=False)
        self._again = gui.add_button(say("play-again"), visible=False, color="gray")
        self._result = gui.add_html(render.render_hint(text("not-simulated-yet"), say))
        simulate.on_click(lambda _: acts.simulate())
        push.on_click(lambda _: acts.push())
        self._again.on_click(lambda _: acts.play())
        self._time.on_update(self._time_chosen)

    def _time_chosen(self, event: Any) -> None:
        if event.client is not None:
            self._acts.go_to_time(float(self._time.value))

    def _share(self, gui: Any) -> None:
        say = self.say
        self._state = gui.add_text(say("state"), "", hint=say("change-it-or-paste-another"))
        self._link = gui.add_text(say("link-to"), "", hint=say("opens-a-page"))
        self._command = gui.add_text(say("as-a-command"), "", multiline=True)
        self._state.on_update(self._state_typed)
        gui.add_button(say("save-the-stance")).on_click(lambda _: self._save())

    def _state_typed(self, event: Any) -> None:
        if event.client is not None and self._state.value != str(self.controls.state):
            self._acts.go_to(self._state.value)

    def _save(self) -> None:
        """Sends a file to the browser, of the stance that is shown."""
        answer, _ = self._acts.export()
        if answer is None:
            self.notify("nothing-to-save", self.say("there-is-no-stance"))
            return
        content = export.write_stance_file(answer.state).encode()
        self._client.send_file_download("stance.toml", content, save_immediately=True)

    def like(self, other: Panels) -> None:
        """Takes over what the panels before were told, but for the state."""
        for name in ("_feedforward", "_impulse", "_direction", "_beside"):
            getattr(self, name).value = getattr(other, name).value

    @property
    def feedforward(self) -> bool:
        """Whether servos are told the torque in advance."""
        return bool(self._feedforward.value)

    @property
    def beside(self) -> bool:
        """Whether what is simulated is drawn beside the stand, and not over it."""
        return bool(self._beside.value)

    @property
    def push_asked(self) -> tuple[float, float]:
        """How hard (N s), and where to (rad)."""
        return float(self._impulse.value), math.radians(float(self._direction.value))

    def status(self, document: Document, brief: Document | None = None) -> None:
        """Shows what it takes.

        Args:
            document: All of it.
            brief: The verdict alone, for a screen that has no room for it beside the sliders.
        """
        self._numbers.content = render.render_panel(document, self.say)
        self._brief.content = "" if brief is None else render.render_brief(brief, self.say)

    def making(self) -> None:
        """Shows that a robot is made."""
        self._numbers.content = render.render_waiting(text("making-the-robot"), self.say)
        self._brief.content = ""

    def result(self, document: Document) -> None:
        """Shows what came of a simulation."""
        self._result.content = render.render_panel(document, self.say)

    def wait(self, key: str) -> None:
        """Shows that a simulation is under way."""
        self._result.content = render.render_waiting(text(key), self.say)

    def hint(self, key: str) -> None:
        """Shows why there is no result of a simulation."""
        self._result.content = render.render_hint(text(key), self.say)

    def simulated(self, duration: float) -> None:
        """Offers to look at what was simulated, for so long (s); at nothing for 0."""
        for control in (self._time, self._again):
            control.visible = duration > 0
        if duration > 0:
            self._time.max = round(duration, 2)

    def at_time(self, seconds: float) -> None:
        """Shows which time is drawn."""
        self._time.value = min(round(seconds, 2), self._time.max)

    def answered(self, answer: Answer) -> None:
        """Shows all that follows from a state at once; limits are of the state before."""
        source, state = self._model.source, answer.state
        self.limits(None)
        if answer.robot is not None:
            self.controls.follow(answer.robot)
        self.hint("not-simulated-yet")
        self.simulated(0.0)
        self._state.value = str(state)
        self._link.value = export.write_link(self._address, state, self.say.code)
        self._command.value = escape_control(export.write_command(source, state))

    def limits(self, error: Any) -> None:
        """Shows how far sliders can go, and a way to the nearest stance; nothing for None."""
        self.controls.limits({} if error is None else error.limits)
        self._nearest.visible = error is not None and error.nearest is not None

    def notify(self, title: str, words: str) -> None:
        """Says something at once.

        Args:
            title: A text of the catalogue.
            words: What there is to say.
        """
        self._client.add_notification(self.say(title), escape_control(words), color="red")


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
        problem: What was wrong with the state that it asked for; None if nothing.
        say: The language that it begins with.
    """

    def __init__(
        self,
        client: Any,
        model: Model,
        state: State,
        address: str,
        problem: Diagnostic | None = None,
        say: Language | None = None,
    ) -> None:
        self._client, self._model, self._address = client, model, address
        self._asked, self._think = threading.Event(), threading.Event()
        self._closed, self._held = threading.Event(), threading.Event()
        self._lock = threading.RLock()
        self._sag: PredictedSag | None
        self._refusal: Any
        self._job: Callable[[Answer], None] | None
        self._motion: PlayedMotion | None
        self._result: Document | None
        self._begin(None, None)
        self._scene = Scene(client.scene)
        self._panels = Panels(client, model, address, self, say)
        self._panels.controls.put(state, notify=False)
        if problem is not None:
            say = self._panels.say
            self._panels.notify("this-state-cannot-be-shown", say.sentence(problem))
        number = next(_numbers)
        self.threads = [
            threading.Thread(target=work, name=f"live-{number}-{name}", daemon=True)
            for name, work in (("solve", self._solving), ("look", self._looking))
        ]
        self._asked.set()
        for thread in self.threads:
            thread.start()

    @property
    def asked(self) -> tuple[State, Language]:
        """What its page asks for, and in which language."""
        return self._panels.controls.state, self._panels.say

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
        self._panels.controls.put(State(), notify=True)

    def speak(self, language: Language) -> None:
        """Goes on in another language: with other panels, of the same state."""
        with self._lock, self._client.atomic():
            before = self._panels
            state = before.controls.state
            self._panels = Panels(self._client, self._model, self._address, self, language, before)
            self._panels.like(before)
            self._panels.controls.put(state, notify=False)
            if self._answer is None:
                self._asked.set()
                return
            self._panels.answered(self._answer)
            self._tell()
            if self._refusal is not None:
                self._panels.limits(self._refusal)
            if self._result is not None:
                self._panels.result(self._result)
            if self._motion is not None:
                self._panels.simulated(self._motion.duration)

    def go_to(self, words: str) -> None:
        """Goes to a state that is given as a text."""
        try:
            self._panels.controls.put(parse_state(words), notify=True)
        except PupperAnalysisError as error:
            self._panels.notify("this-is-no-state", self._panels.say.sentence(error.diagnostic))

    def go_to_nearest(self) -> None:
        """Goes to the ghost."""
        with self._lock:
            answer, refusal = self._answer, self._refusal
        if answer is not None and refusal is not None and refusal.nearest is not None:
            self._panels.controls.put(answer.state.with_task(refusal.nearest.task), notify=True)

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
            self._result, self._motion = None, None
            self._panels.simulated(0.0)
            self._job = job
        self._think.set()

    def play(self) -> None:
        """Plays what was simulated once more."""
        with self._lock:
            if self._motion is None:
                return
            self._held.clear()
            self._job = self._play
        self._think.set()

    def go_to_time(self, seconds: float) -> None:
        """Shows what was simulated at a time; if it is being played, that ends."""
        self._held.set()
        with self._lock:
            if self._answer is not None and self._motion is not None:
                self._draw_motion(self._answer, self._motion, seconds)

    def export(self) -> tuple[Answer | None, PredictedSag | None]:
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
            with self._lock:
                self._panels.making()
        self._show(self._model.answer(state))

    def _begin(self, answer: Answer | None, verdict: Verdict | None) -> None:
        """Forgets what was found of the answer before."""
        self._answer, self._sag, self._refusal, self._pending = answer, None, None, True
        self._verdict, self._since = verdict, time.monotonic()
        self._job, self._motion, self._result = None, None, None

    def _safely(self, work: Callable[[], None]) -> None:
        """Does some work; an error that nobody foresaw is shown, and the page lives on."""
        try:
            work()
        except Exception as error:
            if not self._closed.is_set():
                with self._lock:
                    self._panels.status(unforeseen_document(error))

    def _show(self, answer: Answer) -> None:
        """Shows an answer, and that what follows from it is not known yet."""
        with self._lock, self._client.atomic():
            self._begin(answer, answers.expect_verdict(answer, closely=False))
            self._scene.show(answer)
            self._tell()
            self._panels.answered(answer)

    def _tell(self) -> None:
        """Says what is known of the answer."""
        answer = self._answer
        assert answer is not None
        if answer.unreachable:
            message = refusal_document(answer, self._refusal, pending=self._pending)
        else:
            message = stance_document(answer, self._sag, self._verdict)
        self._panels.status(message, brief_document(answer, self._verdict))

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
            self._if_shown(answer, partial(self._tell_result, failure_document(error)))

    def _tell_result(self, document: Document) -> None:
        """Tells what came of a simulation."""
        self._result = document
        self._panels.result(document)

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
                self._panels.limits(error)
                self._scene.ghost(robot, None if error is None else error.nearest)

            self._if_shown(answer, show_refusal)
        elif answer.statics is not None:
            sag, verdict = answers.predict_sag(answer), answers.expect_verdict(answer, closely=True)

            def show_sag() -> None:
                self._sag, self._verdict = sag, verdict
                self._tell()

            self._if_shown(answer, show_sag)

    def _simulate(self, answer: Answer) -> None:
        feedforward = self._panels.feedforward
        stance = answers.simulate_stance(answer)
        shown = stance.verification if feedforward else stance.sagging
        message = simulation_document(stance, feedforward=feedforward)
        motion = PlayedMotion(shown.motion_time, shown.motion)
        self._show_motion(answer, message, motion, stance.verdict)

    def _push(self, answer: Answer) -> None:
        impulse, direction = self._panels.push_asked
        trial = answers.push_stand(answer, impulse, direction, feedforward=self._panels.feedforward)
        message = push_document(trial)
        self._show_motion(answer, message, PlayedMotion(trial.motion_time, trial.motion))

    def _show_motion(
        self,
        answer: Answer,
        document: Document,
        motion: PlayedMotion,
        verdict: Verdict | None = None,
    ) -> None:
        """Tells what came of a simulation, and plays it."""

        def show() -> None:
            self._verdict = verdict or self._verdict
            self._tell()
            self._motion = motion
            self._held.clear()
            self._tell_result(document)
            self._panels.simulated(motion.duration)

        if self._if_shown(answer, show):
            self._play(answer)

    def _play(self, answer: Answer) -> None:
        """Plays a motion once; it stays at its end. Ends when there is something else to do."""
        with self._lock:
            motion = self._motion
        if motion is None:
            return
        begin = time.monotonic()
        last = False
        while not (last or self._think.is_set() or self._held.is_set()):
            at = time.monotonic() - begin
            last = at >= motion.duration

            def show(at: float = at) -> None:
                if not self._held.is_set():  # a hand may have taken the slider by now
                    self._draw_motion(answer, motion, min(at, motion.duration))

            if not self._if_shown(answer, show) or self._closed.wait(_FRAME):
                return

    def _draw_motion(self, answer: Answer, motion: PlayedMotion, at: float) -> None:
        """Shows what was simulated at a time (s)."""
        assert answer.robot is not None
        assert answer.task is not None
        seen = motion.at(at), answer.task.ground
        self._scene.twin(answer.robot, *seen, beside=self._panels.beside)
        self._panels.at_time(at)


# What was simulated, to be looked at at any time.


@dataclass(frozen=True, eq=False)
class PlayedMotion:
    """What was simulated.

    Attributes:
        times: (n,) of its samples (s).
        motion: (n, nq) configurations.
    """

    times: Any
    motion: Any

    @property
    def duration(self) -> float:
        """How long it lasts (s)."""
        return float(self.times[-1] - self.times[0])

    def at(self, seconds: float) -> Any:
        """Returns the configuration (nq,) at a time (s) after its begin."""
        return interpolate_motion(self.times - self.times[0], self.motion, seconds)


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
