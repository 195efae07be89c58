"""The panels of a page: what it takes on the left, what is asked on the right."""

from __future__ import annotations

import math
from functools import partial
from typing import Any, Protocol

from pupper_analysis.present.document import Document
from pupper_analysis.present.formats import escape_control
from pupper_analysis.present.words import text
from pupper_analysis.tools.live import export, render
from pupper_analysis.tools.live.controls import Controls
from pupper_analysis.tools.live.documents import hanging_document
from pupper_analysis.tools.live.model import (
    Answer,
    Hanging,
    Model,
    PredictedSag,
)
from pupper_analysis.tools.live.render import Language, clear_but_tabs, named_tabs
from pupper_analysis.tools.live.state import State


class Acts(Protocol):
    """What the buttons of a page do."""

    def changed(self, *, hangs: bool = False) -> None:
        """Is told that the controls say something else.

        Args:
            hangs: Whether joints are to be as their sliders have them: the base is held, no stand.
        """

    def reset(self) -> None:
        """Goes back to where a page begins."""

    def go_to(self, words: str) -> None:
        """Goes to a state that is given as a text."""

    def go_to_nearest(self) -> None:
        """Goes to the ghost."""

    def draw_again(self, labels: bool) -> None:
        """Shows the names of all joints, or of one."""

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
        self.controls = Controls(
            gui, robot, model.source.scales, say, acts.changed, partial(acts.changed, hangs=True)
        )
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
            self._back = gui.add_button(say("back-to-the-stand"), visible=False)
        with body:
            self.controls.body()
        with simulated:
            self._simulation(gui, robot.total_mass)
        with share:
            self._share(gui)
        other.on_click(lambda _: acts.speak(say.other))
        self._nearest.on_click(lambda _: acts.go_to_nearest())
        self._back.on_click(lambda _: acts.changed())
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
        labels = gui.add_checkbox(say("torques-at-all-joints"), False)
        self._time = gui.add_slider(say("time-s"), 0.0, 1.0, 0.01, 0.0, visible=False)
        self._again = gui.add_button(say("play-again"), visible=False, color="gray")
        self._result = gui.add_html(render.render_hint(text("not-simulated-yet"), say))
        simulate.on_click(lambda _: acts.simulate())
        push.on_click(lambda _: acts.push())
        labels.on_update(lambda event: acts.draw_again(bool(event.target.value)))
        self._again.on_click(lambda _: acts.play())
        self._time.on_update(self._time_chosen)

    def _time_chosen(self, event: Any) -> None:
        if event.client is not None:
            self._acts.go_to_time(float(self._time.value))

    def _share(self, gui: Any) -> None:
        say = self.say
        self._state = gui.add_text(say("state"), "", hint=say("change-it-or-paste-another"))
        self._link = gui.add_text(say("link-to"), "", hint=say("opens-a-page"))
        self._live = gui.add_text(say("this-page"), "", multiline=True)
        self._command = gui.add_text(say("as-a-command"), "", multiline=True)
        self._python = gui.add_text(say("as-python"), "", multiline=True)
        self._state.on_update(self._state_typed)
        for label, name in (
            (say("save-the-stance"), "stance.toml"),
            (say("save-the-python"), "stance.py"),
        ):
            button = gui.add_button(label)
            button.on_click(lambda _, n=name: self._save(n))

    def _state_typed(self, event: Any) -> None:
        if event.client is not None and self._state.value != str(self.controls.state):
            self._acts.go_to(self._state.value)

    def _save(self, name: str) -> None:
        """Sends a file to the browser, of the stance that is shown."""
        answer, _ = self._acts.export()
        if answer is None:
            self.notify("nothing-to-save", self.say("there-is-no-stance"))
            return
        if name.endswith(".toml"):
            content = export.write_stance_file(answer.state)
        else:
            content = export.write_python(self._model.source, answer.state)
        self._client.send_file_download(name, content.encode(), save_immediately=True)

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

    def status(self, told: Document, brief: Document | None = None) -> None:
        """Shows what it takes.

        Args:
            told: All of it.
            brief: The verdict alone, for a screen that has no room for it beside the sliders.
        """
        self._numbers.content = render.render_panel(told, self.say)
        self._brief.content = "" if brief is None else render.render_brief(brief, self.say)

    def making(self) -> None:
        """Shows that a robot is made."""
        self._numbers.content = render.render_waiting(text("making-the-robot"), self.say)
        self._brief.content = ""

    def result(self, told: Document) -> None:
        """Shows what came of a simulation."""
        self._result.content = render.render_panel(told, self.say)

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
        self._back.visible = False
        if answer.robot is not None:
            self.controls.follow(answer.robot, answer.stand)
        self.hint("not-simulated-yet")
        self.simulated(0.0)
        self._state.value = str(state)
        self._link.value = export.write_link(self._address, state, self.say.code)
        self._live.value = escape_control(export.live_command(source, state, self.say.code))
        self._command.value = escape_control(export.write_command(source, state))
        self._python.value = export.write_python(source, state)

    def hanging(self, hanging: Hanging) -> None:
        """Shows what the motors of a robot hold that hangs, and that it is no stand."""
        self.status(hanging_document(hanging))
        self.limits(None)
        self._back.visible = True
        self.hint("nothing-to-simulate")
        self.simulated(0.0)
        # A payload that is welded on is none of that command's.
        state = hanging.state
        command = export.hold_command(self._model.source, state.scales(), hanging.joints)
        self._command.value = "" if state.payload else escape_control(command)
        self._python.value = ""

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
