"""Take the pictures of the live page and of a report, with chromium, and draw stances.

    python docs/take_pictures.py

Other figures: ``benchmarks/size.py`` draws ``size.png``, ``docs/draw_architecture.py`` draws
``architecture.svg``.

Requires the groups ``browser`` and ``test`` of pyproject.toml, chromium, and a font with Chinese.
Inspect the written pictures.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from pathlib import Path

from playwright.sync_api import Browser, sync_playwright

import pupper_analysis as pa
from pupper_analysis.present.figures.pose import write_pose_figure
from pupper_analysis.tools.analyze.figures import render_variants
from pupper_analysis.tools.live.server import Page
from pupper_analysis.tools.live.state import State
from pupper_analysis.tools.stand.stance import study_stance

IMAGES = Path(__file__).resolve().parent / "images"
"""Folder of the pictures."""

OPTIONS = ["--no-sandbox", "--use-gl=swiftshader", "--enable-unsafe-swiftshader"]
"""Options of chromium."""

STATE = State("inside", height=128.0, pitch=-3.0, swing={"FL": 25.0}, com_margin=10.0, slope=7.0)
"""State of the live page in the picture."""

TIMEOUT = 120_000.0
"""Maximum time of a step [ms]: without graphics hardware, a picture takes seconds."""


def take_live_picture(browser: Browser, path: Path) -> None:
    """Take the picture of the live page: v3 on three legs, uphill, beside the simulated robot."""
    served = Page(pa.load_variant("v3"), STATE)
    page = browser.new_page(viewport={"width": 1240, "height": 840})
    page.set_default_timeout(TIMEOUT)
    page.goto(served.address)
    page.add_style_tag(content=".mantine-Notification-root {visibility: hidden}")
    page.get_by_text("leg_back_l_3").first.wait_for()
    page.locator("[role=tab]", has_text="MuJoCo").first.click()
    page.get_by_role("button", name="Simulate", exact=True).first.click()
    page.get_by_text("base height").first.wait_for()
    time.sleep(20.0)  # the motion is played to its end
    page.locator("[role=tab]", has_text="Stance").first.click()
    time.sleep(5.0)
    page.screenshot(path=path)
    page.close()
    served.close()


def take_report_picture(browser: Browser, path: Path) -> None:
    """Take the picture of the report of v3's stand, with a highlighted joint axis."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "report.html"
        robot = pa.load_variant("v3")
        pa.report.write_report(study_stance(robot, pa.StandTask()), file, robots=[robot])
        page = browser.new_page(viewport={"width": 1100, "height": 900})
        page.set_default_timeout(TIMEOUT)
        page.goto(file.as_uri())
        joint = page.get_by_role("button", name="leg_front_r_3", exact=True).first
        heading = page.get_by_text("The stand in three dimensions").first
        heading.evaluate("element => window.scrollTo(0, element.offsetTop - 90)")
        joint.hover()
        time.sleep(5.0)
        page.screenshot(path=path)
        page.close()


def draw_stances() -> None:
    """Draw the stand of v3, and the stands of all variants, as ``analyze`` does."""
    robots = [pa.load_variant(name) for name in pa.VARIANTS]
    stands = [pa.solve_stand_as_simulated(robot) for robot in robots]
    names = list(pa.VARIANTS)
    robot, stand = robots[names.index("v3")], stands[names.index("v3")]
    statics = pa.stance.stand_statics(robot, stand)
    write_pose_figure(robot, stand, statics, IMAGES / "pose_v3.png")
    picture = render_variants(list(zip(robots, stands, strict=True)), IMAGES / "variants.png")
    assert picture.note is None, picture.note


def main() -> None:
    """Take and draw all pictures."""
    draw_stances()
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=OPTIONS)
        take_report_picture(browser, IMAGES / "report_v3.png")
        take_live_picture(browser, IMAGES / "live_v3.png")
        browser.close()


if __name__ == "__main__":
    main()
