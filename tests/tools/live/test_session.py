"""Threads of a page, with viser's server in place of a browser: shown results are never
outdated.
"""

from __future__ import annotations

import math
import re
import threading
import time
import tomllib
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.tools.live import render
from pupper_analysis.tools.live.model import PageSolver
from pupper_analysis.tools.live.render import Translator
from pupper_analysis.tools.live.session import Session, interpolate_motion
from pupper_analysis.tools.live.state import State, write_stance_file
from tests.support.patience import PATIENCE
from tests.support.variants import load

pytest.importorskip("viser", reason="viser is not installed")

HAN = re.compile("[\u4e00-\u9fff]")
"""Chinese character."""


def wait_for(condition: Callable[[], object], what: str) -> None:
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, what
        time.sleep(0.01)


class Browser:
    """Parts of a browser that a session uses, by viser's server; saved files are recorded."""

    def __init__(self, server: Any) -> None:
        self.gui, self.scene, self.atomic = server.gui, server.scene, server.atomic
        self.saved: dict[str, bytes] = {}

    def send_file_download(self, name: str, content: bytes, **_: Any) -> None:
        self.saved[name] = content


class Open:
    """Session with access to the texts of its page."""

    def __init__(self, server: Any, language: str = "en") -> None:
        self.browser = Browser(server)
        model = PageSolver(load("v3"))
        self.session = Session(self.browser, model, State(), Translator(language))
        self.controls = self.session._panels.controls

    def ask(self, state: State) -> None:
        self.controls.set_state(state, notify=True)

    @property
    def numbers(self) -> str:
        return str(self.session._panels._numbers.content)

    @property
    def result(self) -> str:
        return str(self.session._panels._result.content)

    def shows(self, state: State) -> bool:
        answer, _ = self.session.get_shown_stance()
        return answer is not None and answer.state == state

    def settled(self) -> bool:
        answer, sag = self.session.get_shown_stance()
        return answer is not None and answer.state == self.controls.state and sag is not None


def end(session: Any) -> None:
    """Close a session, and assert that its threads end."""
    session.close()
    for thread in session.threads:
        thread.join(PATIENCE)
        assert not thread.is_alive()


@pytest.fixture
def server() -> Iterator[Any]:
    host = "127.0.0.1"
    one = render.start_server(host, render.find_free_port(host, None), "test")
    yield one
    render.stop_server(one)


@pytest.fixture
def page(server: Any) -> Iterator[Open]:
    one = Open(server)
    wait_for(one.settled, "nothing is solved")
    yield one
    end(one.session)


@pytest.mark.slow
def test_last_of_many_quick_moves_is_shown(page: Open) -> None:
    """Reference: steady state and torques of the Python functions for the last of 200 positions."""
    angles = np.linspace(0.0, 6.0, 200)
    for angle in angles:
        page.ask(State(roll=float(angle)))
    last = State(roll=6.0)
    wait_for(lambda: page.shows(last) and page.settled(), "the last one is not shown")
    stand = pa.stance.solve_stand_on_soft_ground(load("v3"), last.task())
    settled = pa.steady_state(load("v3"), stand)
    assert f">{1e3 * settled.height_loss:.3f}</td><td>mm<" in page.numbers
    for torque in pa.stance.stand_statics(load("v3"), stand).joint_torques:
        assert f">{torque:+.4f}<" in page.numbers
    page.session._panels._download_stance()
    assert page.browser.saved["stance.toml"] == b'roll = "6.0deg"\n'


@pytest.mark.slow
def test_pending_result_is_marked(page: Open, monkeypatch: pytest.MonkeyPatch) -> None:
    """The steady state is delayed: the page has the torques, and marks the sag as being
    computed."""
    go_on = threading.Event()
    real = pa.steady_state

    def slow(*arguments: Any, **options: Any) -> Any:
        go_on.wait(PATIENCE)
        return real(*arguments, **options)

    monkeypatch.setattr("pupper_analysis.tools.live.model.steady_state", slow)
    page.ask(State(pitch=4.0))
    wait_for(lambda: page.shows(State(pitch=4.0)), "it is not solved")
    assert "computing …" in page.numbers
    # Meanwhile the stance changes, so that the delayed steady state must not be shown.
    page.ask(State(pitch=5.0))
    wait_for(lambda: page.shows(State(pitch=5.0)), "it waits for the sag")
    go_on.set()
    wait_for(page.settled, "no sag")
    settled = real(
        load("v3"), pa.stance.solve_stand_on_soft_ground(load("v3"), State(pitch=5.0).task())
    )
    assert f">{1e3 * settled.height_loss:.3f}</td><td>mm<" in page.numbers


@pytest.mark.slow
def test_unreachable_stance_is_reported_before_its_explanation(page: Open) -> None:
    page.ask(State(roll=35.0))
    wait_for(lambda: "Out of reach" in page.numbers, "it is in reach")
    wait_for(lambda: "unchanged: roll 23.8 deg" in page.numbers, "it is not explained")
    panels = page.session._panels
    wait_for(lambda: panels._nearest.visible, "there is no way to the nearest")
    page.session.go_to_nearest()
    wait_for(lambda: "in balance" in page.numbers, "the nearest is out of reach")
    assert page.controls.state == State(roll=23.8)
    wait_for(lambda: not panels._nearest.visible, "there is a way to the nearest still")


@pytest.mark.slow
def test_a_stance_that_changes_during_a_simulation_ends_it(page: Open) -> None:
    page.session.simulate()
    assert "simulating" in page.result
    for mass in (0.1, 0.2, 0.3):
        page.ask(State(payload=mass))
    wait_for(lambda: page.shows(State(payload=0.3)) and page.settled(), "not shown")
    time.sleep(0.5)  # longer than the rest of the simulation
    assert "Not simulated yet" in page.result


@pytest.mark.slow
def test_simulation_and_push_results_are_shown(page: Open) -> None:
    page.session.simulate()
    wait_for(lambda: "HOLDS" in page.result, "it is not verified")
    page.session.push()  # while it is played
    wait_for(lambda: "recovers" in page.result, "it does not recover")


@pytest.mark.slow
def test_simulation_is_compared_with_the_prediction_of_its_commands(page: Open) -> None:
    """Reference: ``verify_stand`` of the stand on soft ground, whose legs are longer by the
    penetration, half a millimetre."""
    page.ask(State(roll=5.0))
    wait_for(lambda: page.shows(State(roll=5.0)), "not shown")
    page.session.simulate()
    wait_for(lambda: "base height" in page.result, "it is not simulated")
    robot, task = load("v3"), State(roll=5.0).task()
    held = pa.stance.solve_stand_on_soft_ground(robot, task)
    (height,) = re.findall(r"base height</td><td[^>]*>(-?[\d.]+)</td><td>mm<", page.result)
    report = pa.verify_stand(robot, held, feedforward=False, duration=12.0)
    assert float(height) / 1000 == pytest.approx(report.base_height, abs=6e-6)
    # Half a millimetre lower, it would be the stand on rigid ground.
    assert pa.steady_state(robot, held).base_height == pytest.approx(report.base_height, abs=1e-4)


class Hand:
    """Event of viser for a control that a user moves."""

    client = object()

    def __init__(self, target: Any) -> None:
        self.target = target


def move(control: Any, value: object) -> None:
    """Set a control as a user does, and call its listeners."""
    control.value = value
    for call in control._impl.update_cb:
        call(Hand(control))


@pytest.mark.slow
def test_each_foot_can_be_lifted_or_put_on_a_step(page: Open) -> None:
    """Reference: torques [N m] of the Python functions for the same task."""
    controls = page.controls
    for foot, height in (("FL", 12.0), ("RR", 30.0)):
        move(controls.foot, foot)
        assert not controls.lifted.value
        move(controls.sliders["lift"], height)
        assert controls.lifted.value
    move(controls.foot, "FR")
    move(controls.sliders["step"], 15.0)
    assert controls.state == State(swing={"FL": 12.0, "RR": 30.0}, heights={"FR": 15.0})
    move(controls.foot, "FL")
    assert controls.sliders["lift"].value == 12.0
    assert controls.sliders["step"].value == 0.0
    move(controls.lifted, False)
    assert controls.state == State(swing={"RR": 30.0}, heights={"FR": 15.0})
    wait_for(lambda: "in balance" in page.numbers and page.settled(), "not shown")
    stand = pa.stance.solve_stand_on_soft_ground(load("v3"), controls.state.task())
    for torque in pa.stance.stand_statics(load("v3"), stand).joint_torques:
        assert f">{torque:+.4f}<" in page.numbers


@pytest.mark.slow
def test_typed_value_beyond_a_slider_is_kept(page: Open) -> None:
    payload = page.controls.sliders["payload"]
    assert payload.max < 12.0
    move(payload, 12.0)
    assert payload.max == payload.value == 12.0  # else the browser cuts it off
    move(page.controls.sliders["roll"], 2.0)
    typed = State(payload=12.0, roll=2.0)
    assert page.controls.state == typed
    wait_for(lambda: page.shows(typed), "not shown")


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_value_that_is_not_finite_changes_no_state(page: Open, value: float) -> None:
    """A browser may send any number; a later valid number is accepted."""
    controls = page.controls
    roll = controls.sliders["roll"]
    move(roll, value)
    controls._set_joint("leg_front_l_1", value)
    assert controls.state == State()
    assert (roll.min, roll.max) == (-45.0, 45.0)
    move(roll, 2.0)
    assert controls.state == State(roll=2.0)


@pytest.mark.slow
def test_stance_out_of_reach_is_not_simulated(page: Open) -> None:
    page.ask(State(height=500.0))
    wait_for(lambda: "Out of reach" in page.numbers, "it is in reach")
    for request in (page.session.simulate, page.session.push):
        request()
        assert "No stance to simulate" in page.result
        page.session._panels.clear_results()


@pytest.mark.slow
def test_chinese_page_has_no_english_text(server: Any) -> None:
    """Only names, numbers, units and single letters are not Chinese."""
    one = Open(server, "zh")
    wait_for(one.settled, "nothing is solved")
    one.session.simulate()
    wait_for(lambda: "保持稳定" in one.result, "it is not simulated")
    shown = [one.numbers, one.result]
    one.ask(State(roll=35.0, swing={"FL": 10.0}, heights={"RR": 4.0}))
    wait_for(lambda: "站姿不可达" in one.numbers, "it is in reach")
    shown.append(one.numbers)
    end(one.session)
    for html in shown:
        texts = re.sub(r"<style>.*?</style>|<[^>]*>", "|", html, flags=re.DOTALL)
        for text in filter(None, (part.strip() for part in texts.split("|"))):
            known = re.fullmatch(
                r"(leg_\w+|FR|FL|RR|RL|v3, .* kg|[-+\d.e%/ ]*( ?(N|mm|m|rad|mm/s|s|°))*|0)", text
            )
            assert known or HAN.search(text), text
    for slider in one.controls.sliders.values():
        assert HAN.search(slider.label), slider.label


@pytest.mark.slow
def test_contacts_are_typed_drawn_moved_and_copied(page: Open) -> None:
    """A foot on a slope and a foot on a table; sliders move the planes, and the saved file
    contains them."""
    controls = page.controls
    move(controls.contacts, "FR=slope:10deg,uphill=90deg\n\nRL=table:2cm,mu=0.7\nRR=tab")
    assert not controls.state.contacts  # a line is no contact yet
    move(controls.contacts, "FR=slope:10deg,uphill=90deg\n\nRL=table:2cm,mu=0.7\n")
    for foot, value in (("RL", 30.0), ("FR", 20.0)):
        move(controls.foot, foot)
        move(controls.sliders["contact"], value)
    slope = pa.Slope(math.radians(20), math.pi / 2)
    table = pa.Plane((0, 0, 0.03), (0, 0, 1), 0.7)
    expected = {"FR": pa.Contact(slope), "RL": pa.Contact(table)}
    for foot, contact in controls.state.contacts.items():
        assert contact.plane.parameter == pytest.approx(expected[foot].plane.parameter, rel=1e-12)
        assert contact == expected[foot].with_plane_parameter(contact.plane.parameter)
    assert controls.contacts.value.startswith("FR=slope:20deg,uphill=90deg\n")
    state = controls.state
    wait_for(lambda: page.shows(state), "not shown")
    answer, _ = page.session.get_shown_stance()
    assert answer is not None
    assert answer.stand is not None
    drawn = [node for name, node in page.session._scene._nodes.items() if name.startswith("steps/")]
    tops = [n.position[2] + n.dimensions[2] / 2 for n in drawn if n.wxyz[0] == pytest.approx(1.0)]
    assert tops == [pytest.approx(0.03, abs=1e-9)]
    assert len(drawn) == 2
    file = write_stance_file(state)
    assert tomllib.loads(file)["contact"] == {of: str(one) for of, one in state.contacts.items()}
    move(controls.foot, "FL")  # on the ground: nothing to move
    move(controls.sliders["contact"], 50.0)
    assert controls.state == state
    bar = "FL=bar:0.1m,0.0m,0.02m,0.0,1.0,0.0,0.01m"
    for typed in ("FL=bar:0,0,1cm", f"{bar},grip=-1N", f"{bar},grip=x", bar[:-5] + "0m"):
        move(controls.contacts, typed)
        assert controls.state == state  # none of them is a contact
    move(controls.contacts, f"{bar},grip=60N")
    wait_for(lambda: page.shows(controls.state), "not shown")
    assert str(controls.state.contacts["FL"]) == f"{bar},grip=60.0N".removeprefix("FL=")
    drawn = {name: node for name, node in page.session._scene._nodes.items() if "steps/" in name}
    (rod,) = (node for node in drawn.values() if node.visible)
    assert rod.radius == pytest.approx(0.01)


def test_unexpected_error_is_shown_and_the_page_continues(
    page: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: Any, **__: Any) -> None:
        raise ZeroDivisionError("<b>oh</b>")

    with monkeypatch.context() as patched:
        patched.setattr("pupper_analysis.tools.live.model.solve_stand", fails)
        page.ask(State(roll=1.0))
        wait_for(lambda: "ZeroDivisionError: &lt;b&gt;oh" in page.numbers, "it is not told")
    page.ask(State(roll=2.0))
    wait_for(lambda: "in balance" in page.numbers, "it is dead")


def test_a_page_that_is_closed_in_a_simulation_ends(server: Any) -> None:
    one = Open(server)
    wait_for(one.settled, "nothing is solved")
    one.session.simulate()
    end(one.session)


def test_a_motion_is_played_between_its_samples() -> None:
    """Closed form: half of a rotation by 0.2 rad between two configurations, whose quaternions have
    opposite signs.
    """
    qpos = np.array([0.0, 0, 0, 1, 0, 0, 0, 0.5])
    other = np.array([1.0, 0, 0, -np.cos(0.1), 0, 0, -np.sin(0.1), 0.7])  # turned by 0.2 rad
    motion, times = np.array([qpos, other]), np.array([0.0, 0.2])
    middle = interpolate_motion(times, motion, 0.1)
    assert middle[0] == pytest.approx(0.5)
    assert middle[7] == pytest.approx(0.6)
    assert middle[3:7] == pytest.approx([np.cos(0.05), 0, 0, np.sin(0.05)], abs=1e-3)
    assert interpolate_motion(times, motion, 5.0)[7] == pytest.approx(0.7)
    assert interpolate_motion(times[:1], motion[:1], 0.1) == pytest.approx(qpos)  # one sample
    assert interpolate_motion(times, motion, -1.0) == pytest.approx(qpos)
