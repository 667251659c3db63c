"""Pages in a real browser: they play, can be driven by keys, and say nothing on the console."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import risfleet
from experiments.cli import main

CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
if CHROMIUM is None or DRIVER is None:
    pytest.skip("needs chromium and chromedriver", allow_module_level=True)

from selenium.webdriver import Chrome, ChromeOptions, ChromeService, Keys  # noqa: E402
from selenium.webdriver.common.by import By  # noqa: E402
from selenium.webdriver.support.ui import WebDriverWait  # noqa: E402

OPTIONS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
)  # fmt: skip
DESKTOP, PHONE = (1280, 900), (390, 844)


@pytest.fixture(scope="module")
def chrome(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chrome]:
    options = ChromeOptions()
    options.binary_location = str(CHROMIUM)
    for option in (*OPTIONS, f"--user-data-dir={tmp_path_factory.mktemp('chromium')}"):
        options.add_argument(option)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    browser = Chrome(options=options, service=ChromeService(DRIVER))
    yield browser
    browser.quit()


@pytest.fixture
def opened(chrome: Chrome) -> Iterator[Callable[..., Chrome]]:
    """Opens a page at a size; afterwards the console must be empty."""

    def at(address: str, size: tuple[int, int] = DESKTOP) -> Chrome:
        width, height = size
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
        chrome.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
        chrome.get(address)
        return chrome

    yield at
    assert chrome.get_log("browser") == []


@pytest.fixture(scope="module")
def replay(tiny_run: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    out = tmp_path_factory.mktemp("pages") / "replay.html"
    assert main(["replay", str(tiny_run), "--out", str(out), "--against", "oracle"]) == 0
    return out.as_uri()


def shown(browser: Chrome) -> int:
    """The number of the slot that is shown, from 1."""
    return int(browser.find_element(By.ID, "slot").text.split()[1])


def press(browser: Chrome, *keys: str) -> None:
    browser.find_element(By.TAG_NAME, "body").send_keys(*keys)


def until(browser: Chrome, holds: Callable[[Chrome], Any]) -> Any:
    return WebDriverWait(browser, 30).until(holds)


def test_a_replay_plays_by_itself_and_robots_move(
    opened: Callable[..., Chrome], replay: str
) -> None:
    browser = opened(replay)
    way = browser.find_element(By.CSS_SELECTOR, "polyline")
    before = len((way.get_attribute("points") or "").split())
    until(browser, lambda b: shown(b) > before + 2)
    assert len((way.get_attribute("points") or "").split()) > before
    assert len(browser.find_elements(By.CSS_SELECTOR, ".panel")) == 2


def test_keys_pause_step_and_jump(opened: Callable[..., Chrome], replay: str) -> None:
    browser = opened(replay)
    until(browser, lambda b: shown(b) > 1)
    press(browser, Keys.SPACE)
    assert browser.find_element(By.ID, "play").text == "Play"
    press(browser, Keys.HOME)
    assert shown(browser) == 1
    press(browser, Keys.ARROW_RIGHT, Keys.ARROW_RIGHT)
    assert shown(browser) == 3
    press(browser, Keys.ARROW_LEFT)
    assert shown(browser) == 2
    stopped = shown(browser)
    time.sleep(0.6)
    assert shown(browser) == stopped
    spoken = browser.find_element(By.ID, "spoken").get_attribute("textContent") or ""
    assert spoken.startswith("Slot 2 of ")
    press(browser, Keys.END)
    of = browser.find_element(By.ID, "slot").text.split()
    assert of[1] == of[3]


def test_the_button_and_the_slider_do_what_keys_do(
    opened: Callable[..., Chrome], replay: str
) -> None:
    browser = opened(replay)
    button = browser.find_element(By.ID, "play")
    button.click()
    assert button.text == "Play"
    slider = browser.find_element(By.ID, "scrub")
    slider.send_keys(Keys.END)
    assert browser.find_element(By.ID, "slot").text.split()[1] != "1"
    assert slider.get_attribute("aria-valuetext") == browser.find_element(By.ID, "slot").text
    button.click()
    assert button.text == "Pause"
    until(browser, lambda b: shown(b) == 1)  # from the end it begins anew


def test_what_is_drawn_is_told_to_a_screen_reader(
    opened: Callable[..., Chrome], replay: str
) -> None:
    browser = opened(replay)
    drawing = browser.find_element(By.CSS_SELECTOR, "svg[role=img]")
    assert "robots arrive" in (drawing.get_attribute("aria-label") or "")
    for selector in ("#scrub", "section"):
        assert browser.find_element(By.CSS_SELECTOR, selector).get_attribute("aria-label")
    heads = [each.text for each in browser.find_elements(By.CSS_SELECTOR, ".panel thead th")]
    assert heads[:5] == ["Robot", "Rate, bit/s/Hz", "Power, mW", "Decoded", "Channel"]


def test_a_page_fits_a_phone(
    opened: Callable[..., Chrome], replay: str, building_run: Path, watched: Callable[..., Any]
) -> None:
    widths = "return [document.documentElement.scrollWidth, window.innerWidth]"
    browser = opened(replay, PHONE)
    wide, width = browser.execute_script(widths)
    assert wide <= width == PHONE[0]
    with watched(building_run) as server:
        browser = opened(server.url, PHONE)
        until(browser, lambda b: b.find_elements(By.CSS_SELECTOR, ".panel"))
        wide, width = browser.execute_script(widths)
        assert wide <= width


def test_whoever_prefers_no_motion_starts_it_by_hand(
    opened: Callable[..., Chrome], chrome: Chrome, replay: str
) -> None:
    feature = {"name": "prefers-reduced-motion", "value": "reduce"}
    chrome.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [feature]})
    browser = opened(replay)
    assert browser.find_element(By.ID, "play").text == "Play"
    chrome.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})


def test_a_notebooks_cell_plays_it_too(
    opened: Callable[..., Chrome], tiny_run: Path, tmp_path: Path
) -> None:
    cell = tmp_path / "cell.html"
    cell.write_text(risfleet.load(tiny_run).replay()._repr_html_(), encoding="utf-8")
    browser = opened(cell.as_uri())
    browser.switch_to.frame(0)
    until(browser, lambda b: shown(b) > 2)
    browser.switch_to.default_content()


def test_the_page_of_a_run_shows_its_episode_and_its_curves(
    opened: Callable[..., Chrome], tiny_run: Path, watched: Callable[..., Any]
) -> None:
    with watched(tiny_run) as server:
        browser = opened(server.url)
        until(browser, lambda b: b.find_elements(By.CSS_SELECTOR, ".panel"))
        until(browser, lambda b: shown(b) > 2)
        assert browser.find_element(By.ID, "state").text == "done."
        assert len(browser.find_elements(By.CSS_SELECTOR, ".chart svg")) == 3
        assert not browser.find_element(By.ID, "wall").is_displayed()
        browser.get("about:blank")


def test_a_room_on_the_wall_is_enlarged_by_a_click(
    opened: Callable[..., Chrome], building_run: Path, watched: Callable[..., Any]
) -> None:
    with watched(building_run) as server:
        browser = opened(server.url, (1280, 2400))
        drawn = ".room canvas"
        until(browser, lambda b: len(b.find_elements(By.CSS_SELECTOR, drawn)) == 4)
        heading = "article.panel h2"
        until(browser, lambda b: "Room 0000" in b.find_element(By.CSS_SELECTOR, heading).text)
        browser.find_elements(By.CSS_SELECTOR, ".room")[3].click()
        until(
            browser,
            lambda b: "Room held-out-0000" in b.find_element(By.CSS_SELECTOR, heading).text,
        )
        pressed = browser.find_elements(By.CSS_SELECTOR, '.room[aria-pressed="true"]')
        assert len(pressed) == 1
        browser.get("about:blank")
