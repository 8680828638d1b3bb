"""The page in a real, headless Chromium, with an arm that this test moves itself."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import fields, replace

import numpy as np
import pytest

pytest.importorskip("viser", reason="needs the extra view")
playwright = pytest.importorskip("playwright.sync_api", reason="needs the extra browser-test")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
if CHROMIUM is None:
    pytest.skip("there is no Chromium", allow_module_level=True)

from test_live_trial import ended, moved, sample, status, trial  # noqa: E402

from tel_ros.app.plane import viewpoint  # noqa: E402
from tel_ros.app.view.live_trial import History  # noqa: E402
from tel_ros.app.view.page import Page  # noqa: E402
from tel_ros.app.view.server import OwnersServer  # noqa: E402
from tel_ros.core.config import ArmConfig  # noqa: E402
from tel_ros.recording.config_file import load_config  # noqa: E402

pytestmark = pytest.mark.timeout(400)
PATIENCE_MS = 120_000
"""Software rendering on a busy machine takes seconds a picture."""
FLAGS = [
    *("--headless", "--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader", "--disable-quic"),
    *("--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync"),
]


class Pressed:
    """Notes which buttons were pressed."""

    def __init__(self) -> None:
        self.calls: list[str] = []

    def emergency_stop(self) -> None:
        self.calls.append("emergency stop")

    def reset(self) -> None:
        self.calls.append("reset")

    def end_run(self) -> None:
        self.calls.append("end of the run")

    def pause(self, paused: bool) -> None:
        self.calls.append("pause" if paused else "go on")

    def wait_for(self, *calls: str) -> None:
        end = time.monotonic() + PATIENCE_MS / 1000
        while self.calls != list(calls) and time.monotonic() < end:
            time.sleep(0.02)
        assert self.calls == list(calls)


@pytest.fixture
def pressed() -> Pressed:
    return Pressed()


def one_joint(arm: ArmConfig) -> ArmConfig:
    """Return the arm of the trials that this test makes up: the first joint alone moves."""
    values = {field.name: getattr(arm, field.name) for field in fields(arm)}
    return replace(arm, **{name: value[:1] for name, value in values.items() if isinstance(value, tuple)})


@pytest.fixture
def shown(pressed: Pressed) -> Iterator[tuple[Page, str]]:
    arm = one_joint(load_config("config/paper.yaml").arm)
    server = OwnersServer("a-secret-for-tests", 0, "test")
    path_m = np.array([[0.0, 0.0, 0.0], [0.4, 0.3, 0.0], [0.5, -0.1, 0.0]])
    yield Page(server.viser, arm, viewpoint(path_m), pressed), server.link
    server.stop()


@pytest.fixture
def browse() -> Iterator[Callable[[str], object]]:
    with playwright.sync_playwright() as play:
        browser = play.chromium.launch(executable_path=CHROMIUM, args=FLAGS)

        def go(link: str) -> object:
            page = browser.new_page(viewport={"width": 900, "height": 700})
            page.set_default_timeout(PATIENCE_MS)
            page.goto(link, wait_until="commit")
            return page

        yield go
        browser.close()


def test_the_page_shows_the_arm_and_its_numbers_and_its_buttons_act(
    shown: tuple[Page, str], pressed: Pressed, browse: Callable[[str], object]
) -> None:
    page, link = shown
    page.show_arm(np.array([0.3]))
    page.show_status(status())
    browser = browse(link)
    browser.get_by_text("trial 3 of 15").wait_for()
    assert "token" not in browser.url
    assert browser.locator(".uplot").count() == 3
    canvas = browser.locator("canvas[data-engine]").first
    before = [b"", canvas.screenshot()]
    end = time.monotonic() + PATIENCE_MS / 1000
    while before[-1] != before[-2]:  # until everything has been loaded and drawn
        assert time.monotonic() < end, "the picture does not come to rest"
        browser.wait_for_timeout(1000.0)
        before.append(canvas.screenshot())

    page.show_arm(np.array([1.8]))  # the arm moves
    while canvas.screenshot() == before[-1]:
        assert time.monotonic() < end, "the arm did not move on the page"
    history = History()
    history.end(ended(7), None)
    page.show_history(history)  # the numbers change
    page.show_status(status(trial=8, progress=0.5))
    browser.get_by_text("trial 8 of 15").wait_for()
    assert "0.0123" in browser.get_by_test_id("trials").inner_text()

    for button, call in (
        ("EMERGENCY STOP", "emergency stop"),
        ("Pause after this trial", "pause"),
        ("Stop the run", "end of the run"),
    ):
        pressed.calls.clear()
        browser.get_by_role("button", name=button, exact=True).click()
        pressed.wait_for(call)
    page.show_status(status(stopped=True, paused=True))
    pressed.calls.clear()
    browser.get_by_role("button", name="Go on").click()
    pressed.wait_for("go on")
    browser.get_by_role("button", name="Reset the emergency stop").click()
    pressed.wait_for("go on", "reset")


def test_a_trial_is_drawn_without_a_complaint_of_the_browser(
    shown: tuple[Page, str], browse: Callable[[str], object]
) -> None:
    page, link = shown
    errors: list[str] = []
    browser = browse(link)
    browser.on("pageerror", lambda error: errors.append(str(error)))
    live = trial(1, std_rad=0.02)
    live.see(sample(0.5, 0.2))
    page.show_plan(live)
    page.show_progress(live)
    page.show_ghost(np.array([0.3]))
    history = History()
    history.end(ended(1), moved(1))
    page.show_history(history)
    page.show_status(status(trial=2))
    browser.get_by_text("trial 2 of 15").wait_for()
    browser.wait_for_timeout(500.0)
    assert errors == []
