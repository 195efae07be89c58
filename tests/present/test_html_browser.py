"""A report in a browser without a network: it draws, sorts and switches without error messages."""

from __future__ import annotations

import io
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import pupper_analysis as pa
from pupper_analysis.present.document import Column, Name, Table, number_cell
from pupper_analysis.tools.analyze.document import compare_with_base, comparison_table
from tests.present.test_html import EVIL, analysis, evil_analysis
from tests.support.patience import PATIENCE
from tests.support.variants import load

pytestmark = pytest.mark.slow  # a chromium needs seconds of processor to start

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
OPTIONS = ("--no-sandbox", "--use-gl=swiftshader", "--enable-unsafe-swiftshader")


def test_long_names_of_first_columns_do_not_cover_numbers_on_a_phone(
    browser: Any, tmp_path: Path
) -> None:
    """Reference: boxes of the words and of the cell. A name of 40 characters covered a column."""
    name = "prototype_two_carbon_fibre_leg_front_r_3"
    columns = (Column(Name("joint"), left=True), Column(Name("torque"), "N m"))
    rows = tuple((Name(word), number_cell(1.0, ".3f")) for word in (name, "utilisation"))
    tables = [
        Table(Name("torques"), columns, rows),
        Table(
            Name("wide"),
            (*columns, *(columns[1:] * 6)),
            tuple((*row, *(row[1:] * 6)) for row in rows[1:]),
        ),
    ]
    pa.report.write_report(tables, tmp_path / "report.html")
    one = Opened(browser, tmp_path / "report.html", viewport={"width": 375, "height": 812})
    cell = one.page.locator("tbody th").first
    words = cell.locator(".name").bounding_box()
    box = cell.bounding_box()
    assert words["x"] + words["width"] <= box["x"] + box["width"]
    # A short name is on one line, also in a wide table.
    short, wide = (one.page.locator("tbody th .name").nth(index) for index in (1, 2))
    assert wide.bounding_box()["height"] == short.bounding_box()["height"]
    one.close()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    # Here, not at module level, so that each test is collected and reported as skipped.
    sync_api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
    found = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    with sync_api.sync_playwright() as driver:
        if found is None and not Path(driver.chromium.executable_path).exists():
            pytest.skip("no chromium")
        started = driver.chromium.launch(executable_path=found, args=list(OPTIONS))
        yield started
        started.close()


class Opened:
    """Report in a browser without a network, with the recorded error messages."""

    def __init__(self, browser: Any, file: Path, script: str = "", **options: Any) -> None:
        self.context = browser.new_context(offline=True, **options)
        self.context.add_init_script(script)
        self.page = self.context.new_page()
        self.page.set_default_timeout(1e3 * PATIENCE)
        self.complaints: list[str] = []
        self.asked: list[str] = []
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("console", self._hear)
        self.page.on("dialog", lambda dialog: self.complaints.append(dialog.message))
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.goto(file.as_uri())

    def close(self) -> None:
        self.context.close()
        assert self.complaints == []

    def _hear(self, message: Any) -> None:
        # A driver that renders in software says that reading pixels is slow.
        if message.type in ("error", "warning") and "GPU stall" not in message.text:
            self.complaints.append(message.text)

    def pixels(self, element: Any) -> np.ndarray:  # type: ignore[type-arg]
        return np.asarray(Image.open(io.BytesIO(element.screenshot())).convert("RGB")).astype(int)


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    pa.report.write_report(analysis(), path, robots=[load("v3")])
    return path


@pytest.fixture(scope="module")
def opened(browser: Any, file: Path) -> Iterator[Opened]:
    one = Opened(browser, file, viewport={"width": 1200, "height": 1000})
    yield one
    assert [url for url in one.asked if not url.startswith(("file:", "data:", "blob:"))] == []
    one.close()


def get_canvas(opened: Opened) -> Any:
    """Return the canvas of the view after scrolling to it."""
    canvas = opened.page.locator(".canvas canvas")
    opened.page.locator(".canvas").scroll_into_view_if_needed()
    canvas.wait_for(timeout=1e3 * PATIENCE)
    return canvas


def share_of_torso(pixels: np.ndarray) -> float:  # type: ignore[type-arg]
    """Return the fraction of yellow pixels; only the torso is yellow."""
    return float(((pixels[..., 0] > 150) & (pixels[..., 2] < 90)).mean())


def share_changed(one: np.ndarray, other: np.ndarray) -> float:  # type: ignore[type-arg]
    return float((np.abs(one - other).max(axis=-1) > 20).mean())


def test_view_draws_and_turns_the_robot(opened: Opened) -> None:
    """Pixels change with keys and mouse, and return with the reset button."""
    canvas = get_canvas(opened)
    before = opened.pixels(canvas)
    assert share_of_torso(before) > 0.005
    assert len(np.unique(before.reshape(-1, 3), axis=0)) > 500
    opened.page.locator(".canvas").press("ArrowLeft")
    assert share_changed(opened.pixels(canvas), before) > 0.01
    opened.page.locator(".reset").click()
    assert share_changed(opened.pixels(canvas), before) < 0.001
    box = canvas.bounding_box()
    opened.page.mouse.move(box["x"] + 300, box["y"] + 200)
    opened.page.mouse.down()
    opened.page.mouse.move(box["x"] + 400, box["y"] + 220, steps=4)
    opened.page.mouse.up()
    assert share_changed(opened.pixels(canvas), before) > 0.01
    opened.page.locator(".reset").click()


def test_shapes_of_a_view_can_be_hidden(opened: Opened) -> None:
    """Reference: the share of yellow pixels, which torso and arrows of forces have."""
    canvas = get_canvas(opened)
    shapes = opened.page.locator("[data-layer=shapes]")
    opened.page.locator("[data-layer=forces]").uncheck()
    assert share_of_torso(opened.pixels(canvas)) > 0.005
    shapes.uncheck()
    hidden = share_of_torso(opened.pixels(canvas))
    shapes.check()
    assert hidden < 0.001
    assert share_of_torso(opened.pixels(canvas)) > 0.005
    opened.page.locator("[data-layer=forces]").check()


def test_view_is_drawn_completely_below_the_navigation(opened: Opened) -> None:
    """The page is scrolled by 150 pixels into the view: 95 % of the visible rows show the floor."""
    canvas = get_canvas(opened)
    opened.page.evaluate(
        """() => { const top = document.querySelector(".canvas").getBoundingClientRect().top;
        scrollTo({ top: scrollY + top + 150, behavior: "instant" }); }"""
    )
    opened.page.evaluate("window.report.views[0].turn(0.1, 0)")
    opened.page.wait_for_timeout(300)
    box = canvas.bounding_box()
    assert box["y"] == pytest.approx(-150, abs=2)
    seen = Image.open(io.BytesIO(opened.page.screenshot())).convert("RGB")
    below = np.asarray(seen).astype(int)[60 : int(box["y"] + box["height"]) - 4, 100:1000]
    assert (below.std(axis=1).sum(axis=1) > 3).mean() > 0.95
    opened.page.locator(".reset").click()


def test_views_are_printed_if_they_were_never_visible(browser: Any, file: Path) -> None:
    one = Opened(browser, file, viewport={"width": 900, "height": 300})
    assert one.page.locator(".canvas canvas").count() == 0  # it is further down
    one.page.evaluate("dispatchEvent(new Event('beforeprint'))")
    one.page.emulate_media(media="print")
    picture = one.page.locator(".canvas .printed")
    picture.wait_for()
    assert share_of_torso(one.pixels(picture)) > 0.005
    assert one.page.evaluate("document.documentElement.scrollWidth") <= 900
    one.page.evaluate("dispatchEvent(new Event('afterprint'))")
    assert picture.count() == 0
    one.close()


def test_view_draws_joints_at_the_positions_of_pinocchio(opened: Opened) -> None:
    """Reference: Pinocchio with the URDF. The page transforms the axes of the MJCF."""
    get_canvas(opened)
    drawn = opened.page.evaluate(
        """() => { const view = window.report.views[0]; view.scene.updateMatrixWorld(true);
        return view.axes.map((mesh) => [mesh.matrixWorld.elements.slice(12, 15),
          mesh.matrixWorld.elements.slice(4, 7)]); }"""
    )
    config = pa.Configuration(load("v3"), analysis().stand.qpos)
    for joint, (place, along) in zip(load("v3").joint_names, drawn, strict=True):
        assert place == pytest.approx(config.joint_position(joint), abs=5e-5)
        assert along == pytest.approx(config.joint_axis(joint), abs=2e-4)


def test_view_draws_forces_from_the_contact_points(opened: Opened) -> None:
    """References: contact points [m] and force directions of the statics."""
    get_canvas(opened)
    drawn = opened.page.evaluate(
        """() => window.report.views[0].layers.forces.map((group) =>
        [group.position.toArray(), group.matrixWorld.elements.slice(4, 7)])"""
    )
    statics = analysis().statics
    assert len(drawn) == 4
    for foot, (place, along) in zip(statics.contact_forces, drawn, strict=True):
        force = statics.contact_forces[foot]
        assert place == pytest.approx(statics.contact_points[foot], abs=1e-5)
        assert along == pytest.approx(force / np.linalg.norm(force), abs=1e-5)


def test_view_highlights_and_describes_a_selected_joint(opened: Opened) -> None:
    canvas = get_canvas(opened)
    dark = opened.pixels(canvas)
    button = opened.page.get_by_role("button", name="leg_front_r_2", exact=True)
    button.focus()
    message = opened.page.locator(".hint").inner_text()
    assert message.startswith("leg_front_r_2: roll; position ")
    assert "torque -0.200 N m / 3 N m" in message
    blue = [  # the light blue of a highlighted axis, (86, 180, 233)
        ((np.abs(picture - (86, 180, 233)) < 20).all(axis=-1)).sum()
        for picture in (opened.pixels(canvas), dark)
    ]
    assert blue[0] > blue[1] + 20
    button.blur()
    assert opened.page.locator(".hint").inner_text().startswith("Drag to rotate")


def test_view_plays_the_simulated_motion(opened: Opened) -> None:
    """The force arrows belong to the stand, and are hidden during the motion."""
    canvas = get_canvas(opened)
    opened.page.locator("select.motion").select_option(label="simulated, without feed-forward")
    slider = opened.page.locator("input.time")
    forces = "window.report.views[0].layers.forces.some((arrow) => arrow.visible)"
    assert not opened.page.evaluate(forces)  # the stand's are not the motion's
    first = opened.pixels(canvas)
    count = int(slider.get_attribute("max") or 0)
    assert count > 20
    slider.fill(str(count))
    assert opened.page.locator(".at").inner_text() == "11.90 s"
    assert share_changed(opened.pixels(canvas), first) > 0.001  # it sinks
    opened.page.locator("select.motion").select_option(index=0)
    assert opened.page.evaluate(forces)


def test_table_is_sorted_by_number_and_restored(opened: Opened) -> None:
    table = opened.page.locator("figure.table", has_text="hanging").first
    header = table.locator("th", has_text="simulated")

    def column() -> list[str]:
        return [str(text) for text in table.locator("tbody tr td:nth-child(5)").all_inner_texts()]

    given = column()
    header.locator("button").click()
    assert header.get_attribute("aria-sort") == "ascending"
    assert column() == sorted(given, key=float)
    header.locator("button").press("Enter")
    assert header.get_attribute("aria-sort") == "descending"
    assert column() == sorted(given, key=float, reverse=True)
    header.locator("button").click()
    assert header.get_attribute("aria-sort") is None
    assert column() == given


def test_plot_shows_values_at_the_pointer(opened: Opened) -> None:
    """Reference: base height [mm] of the stand."""
    drawing = opened.page.locator("figure.plot", has_text="Height of the simulated base")
    svg = drawing.locator("svg").first
    svg.scroll_into_view_if_needed()
    box = svg.bounding_box()
    task = svg.locator("polyline").nth(2)
    place = task.evaluate("line => { const m = line.getScreenCTM(); const p = line.points[1];"
                          "return [m.a * p.x + m.e, m.d * p.y + m.f]; }")  # fmt: skip
    opened.page.mouse.move(place[0] + 1, place[1] + 1)
    height = 1e3 * analysis().stand.qpos[2]
    # The base has this height with feed-forward, too: the line that is drawn first is named.
    assert f"feed-forward: 11.98 s, {height:.2f} mm" in opened.page.locator("#tip").inner_text()
    opened.page.mouse.move(box["x"] + box["width"] + 30, box["y"])
    assert not opened.page.locator("#tip").is_visible()


@pytest.mark.parametrize("kind", ["svg", "png"])
def test_plot_is_saved_as_svg_and_png(opened: Opened, kind: str) -> None:
    button = opened.page.locator(f"figure.plot .save[data-as={kind}]").first
    with opened.page.expect_download() as caught:
        button.click()
    saved = Path(caught.value.path()).read_bytes()
    assert caught.value.suggested_filename == f"plot.{kind}"
    if kind == "png":
        assert len(np.unique(np.asarray(Image.open(io.BytesIO(saved)).convert("L")))) > 10
    else:
        assert saved.startswith(b"<svg")
        assert b"stroke" in saved
        assert b"var(" not in saved


def test_language_button_switches_all_texts(opened: Opened) -> None:
    page = opened.page
    assert page.locator("h2").first.inner_text() == "Summary"
    page.locator("#language").click()
    assert page.locator("html").get_attribute("lang") == "zh-Hans"
    assert page.locator("h2").first.inner_text() == "概要"
    assert page.title() == "分析：v3"
    assert page.locator(".canvas").get_attribute("aria-label").startswith("机器人三维视图")
    assert page.locator("select.motion option").nth(1).inner_text().startswith("仿真")
    page.get_by_role("button", name="leg_front_r_2", exact=True).focus()
    assert "横滚" in page.locator(".hint").inner_text()
    page.locator("#language").click()
    assert page.locator("h2").first.inner_text() == "Summary"


def test_page_opens_in_chinese_with_a_chinese_browser(browser: Any, file: Path) -> None:
    one = Opened(browser, file, locale="zh-CN")
    assert one.page.locator("html").get_attribute("lang") == "zh-Hans"
    assert one.page.locator("#language").inner_text() == "English"
    one.close()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_page_has_light_and_dark_themes_and_fits_a_phone(
    browser: Any, file: Path, scheme: str
) -> None:
    """A screen of 360 pixels: no horizontal scrolling, also with a long verdict."""
    one = Opened(browser, file, viewport={"width": 360, "height": 740}, color_scheme=scheme)
    long = "CARRIES (for moments, at peak torque)"
    one.page.locator(".verdict .en").first.evaluate(f"one => one.textContent = {long!r}")
    wide = one.page.evaluate("[document.documentElement.scrollWidth, innerWidth]")
    assert wide[0] <= wide[1]
    colour = one.page.evaluate("getComputedStyle(document.body).backgroundColor")
    light = sum(map(int, colour[4:-1].split(","))) > 600
    assert light == (scheme == "light")
    one.page.locator("#theme").click()
    assert one.page.evaluate("getComputedStyle(document.body).backgroundColor") != colour
    one.close()


def test_view_states_that_webgl_is_missing(browser: Any, file: Path) -> None:
    none = "HTMLCanvasElement.prototype.getContext = () => null"
    one = Opened(browser, file, script=none)
    one.page.locator(".canvas").scroll_into_view_if_needed()
    message = one.page.locator(".hint")
    sync_api = pytest.importorskip("playwright.sync_api")
    sync_api.expect(message).to_contain_text("the browser has no WebGL")
    one.page.get_by_role("button", name="leg_front_r_2", exact=True).focus()
    sync_api.expect(message).to_contain_text("leg_front_r_2: roll")
    one.close()


def test_names_with_markup_execute_nothing(browser: Any, tmp_path: Path) -> None:
    file = tmp_path / "evil.html"
    pa.report.write_report(evil_analysis(), file, robots=())
    one = Opened(browser, file)
    assert EVIL[0] in one.page.locator("h2").nth(1).inner_text()
    assert one.page.locator("img").count() == 0
    one.close()


def test_sections_are_folded_and_verdicts_are_visible(browser: Any, tmp_path: Path) -> None:
    """Two robots: a link opens its section, and print opens all; a view appears once."""
    file = tmp_path / "two.html"
    both = [analysis(), replace(analysis(), name="other")]
    rows = [compare_with_base(result, "v3", 1.0, None) for result in both]
    pa.report.write_report([*both, comparison_table(rows)], file, robots=[load("v3")])
    one = Opened(browser, file, viewport={"width": 1280, "height": 900})
    page = one.page
    assert page.title() == "Analysis: v3, other"
    parts = "[...document.querySelectorAll('details.part')].map((part) => part.open)"
    assert page.evaluate(parts) == [False, False]
    assert page.evaluate("document.documentElement.scrollHeight") < 3000
    page.locator("nav a").nth(1).click()
    page.locator("#s1 .canvas canvas").wait_for(timeout=1e3 * PATIENCE)
    assert page.evaluate(parts) == [True, False]
    wide = "[...document.querySelectorAll('.scroll')].every((e) => e.scrollWidth <= e.clientWidth)"
    assert page.evaluate(wide)
    for _ in range(2):  # a preview sends the event twice
        page.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert page.evaluate(parts) == [True, True]
    page.emulate_media(media="print")
    seen = "[...document.querySelectorAll('.canvas > *')].filter((e) => e.offsetParent).length"
    page.locator(".canvas .printed").first.wait_for()
    assert page.evaluate(seen) == page.locator(".canvas").count() == 1
    page.evaluate("dispatchEvent(new Event('afterprint'))")
    assert page.evaluate(parts) == [True, False]
    one.close()


@pytest.mark.parametrize("width", [390, 1200])
def test_triangle_of_a_section_is_inside_the_page(browser: Any, file: Path, width: int) -> None:
    """Reference: pixels of the first line of the section's title. The page cut the triangle."""
    one = Opened(browser, file, viewport={"width": width, "height": 900})
    summary = one.page.locator(".part > summary").first
    summary.scroll_into_view_if_needed()
    heading = summary.locator("h2").bounding_box()
    box = summary.bounding_box()
    assert heading["x"] - box["x"] > 8.0  # room for the triangle
    room = {"x": box["x"], "y": box["y"], "width": heading["x"] - box["x"], "height": box["height"]}
    picture = Image.open(io.BytesIO(one.page.screenshot(clip=room))).convert("L")
    dark = (np.asarray(picture) < 128).any(axis=0)
    assert dark.any()
    assert not dark[0]  # not cut at the left
    one.close()


def test_first_columns_wrap_on_a_phone(browser: Any, file: Path) -> None:
    """The values of the simulation were outside of the screen, which is 390 pixels wide."""
    one = Opened(browser, file, viewport={"width": 390, "height": 844})
    tables = one.page.locator("figure.table", has_text="with feed-forward")
    widths = tables.first.locator(".scroll").evaluate("box => [box.scrollWidth, box.clientWidth]")
    assert widths[0] <= widths[1]
    one.close()
