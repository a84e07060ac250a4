"""The live page in headless Chromium: ``make test-page``, with screenshots in ``results/page``."""

import asyncio
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Event
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import psutil
import pytest
from PIL import Image
from selenium.webdriver import Chrome
from selenium.webdriver.common.keys import Keys
from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect

import drivers
from drivers.base import paths
from drivers.chain.case import build_case
from drivers.engines import codes, installed
from drivers.scene.read_scene import read_scene
from postproc.draw.overlay import lay_over
from postproc.read.measured import entries_of
from postproc.read.motion import exact
from postproc.read.signals import sensor_signals
from validation.tests.helpers.browser import browser, devtools, keep_screenshot, need_browser, requests, said, view
from validation.tests.helpers.live import Live, served, status_of, until

pytestmark = pytest.mark.page

SCENE = "fig4"
SCREENSHOTS = paths.RESULTS / "page"


@pytest.fixture(scope="module")
def driver() -> Iterator[Chrome]:
    need_browser()
    with browser() as driver:
        yield driver


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("explored")


@pytest.fixture(scope="module")
def addresses(folder: Path) -> Iterator[dict[str, str]]:
    """Addresses of pages by scene."""
    where = ("--runs", folder / "runs", "--results", folder / "results")
    with served(SCENE, *where) as (plain, _), served("example-measured", *where) as (measured, _):
        yield {SCENE: plain, "measured": measured}


@pytest.fixture(scope="module")
def opened(driver: Chrome, addresses: dict[str, str]) -> tuple[Live, str]:
    view(driver, 1280)
    return Live(driver, addresses[SCENE]), driver.current_window_handle


@pytest.fixture
def page(opened: tuple[Live, str]) -> Live:
    """The page of Fig. 4 with the values of its file."""
    page, window = opened
    page.driver.switch_to.window(window)
    page.press("drop")
    page.press("reset")
    if page.value("engine") != "auto":
        page.press("engine", "a")
    until(lambda: page.text("command") == "beads run fig4 --engine reference" and not page.text("problem"))
    return page


@pytest.fixture
def measured(driver: Chrome, addresses: dict[str, str]) -> Iterator[Live]:
    """A new page of measured traces, in a tab of its own."""
    window = driver.current_window_handle
    driver.switch_to.new_window("tab")
    view(driver, 1280)
    page = Live(driver, addresses["measured"])
    until(lambda: "readings" in page.text("overlay"))
    yield page
    driver.close()
    driver.switch_to.window(window)


def assert_as_run(page: Live, folder: Path, scene: str, engine: str, settings: dict[str, Any]) -> None:
    """Check that the curves are those of ``beads run``, to the last bit."""
    run = drivers.run_scene(scene, engine, settings, runs=folder / "runs")
    for gauge, force_N in sensor_signals(run.layout, run.trace).items():
        time_us, shown_N = page.curve(gauge)
        assert shown_N == force_N.tolist()
        assert time_us == (1e6 * run.trace.time_s).tolist()


@pytest.mark.parametrize(
    ("knob", "text"),
    [
        ("striker.speed", "1.5 m/s"),
        ("striker.mass", "0.2 g"),
        ("striker.diameter", "4 mm"),
        ("chain.count", "30"),
        ("chain.diameter", "4.9 mm"),
        ("chain.precompression", "2 N"),
        ("chain.angle", "30 deg"),
        ("gravity", "1 m/s^2"),
        ("materials.ptfe.youngs_modulus", "0.9 GPa"),
        ("sensor.time_constant", "1 ms"),
        ("run.duration", "0.6 ms"),
        ("run.time_step", "50 ns"),
    ],
)
def test_a_knob_gives_the_run_of_its_setting(page: Live, folder: Path, knob: str, text: str) -> None:
    page.turn(knob, text)
    until(lambda: page.value(knob) == text)
    assert_as_run(page, folder, SCENE, "reference", {knob: text})


@pytest.mark.parametrize(
    ("knob", "key", "settings"),
    [
        ("striker.shape", "f", {"striker.shape": "flat", "striker.diameter": None, "striker.mass": "0.1226 g"}),
        ("contact.dissipation", "k", {"contact.dissipation": "kuwabara-kono", "contact.relaxation": "1 us"}),
        ("wall.material", "g", {"wall.material": "glass"}),
        ("wall.material", "n", {"wall": None}),
    ],
)
def test_a_choice_gives_the_run_of_its_settings(
    page: Live, folder: Path, knob: str, key: str, settings: dict[str, Any]
) -> None:
    page.press(knob, key)
    until(lambda: "--set" in page.text("command"))
    assert_as_run(page, folder, SCENE, "reference", settings)


def test_gauges_a_drive_and_any_other_key(page: Live, folder: Path) -> None:
    page.type("chain.sensors", "15, 2")
    until(lambda: "from_wall=15" in page.text("command"))
    sensors = [{"from_wall": place, "mass": "0.116 g"} for place in (15, 2)]
    assert_as_run(page, folder, SCENE, "reference", {"chain.sensors": sensors})
    page.type("other", 'drive={form="half-sine", force="-5 N", duration="20 us"}')
    drive = {"form": "half-sine", "force": "-5 N", "duration": "20 us"}
    until(lambda: "drive=" in page.text("command") and page.ask('model("drive.force") !== undefined'))
    page.turn("drive.force", "-7 N")
    assert_as_run(page, folder, SCENE, "reference", {"chain.sensors": sensors, "drive": drive | {"force": "-7 N"}})


def test_a_slider_by_keys_and_the_engine(page: Live, folder: Path) -> None:
    page.press("striker.speed slider", Keys.ARROW_RIGHT)
    until(lambda: "striker.speed=2.02" in page.text("command"))
    assert_as_run(page, folder, SCENE, "reference", {"striker.speed": page.value("striker.speed")})
    page.press("engine", "v")
    until(lambda: "--engine verlet" in page.text("command"))
    assert_as_run(page, folder, SCENE, "verlet", {"striker.speed": page.value("striker.speed")})
    page.press("reset")
    until(lambda: page.text("command") == "beads run fig4 --engine verlet")


@pytest.mark.parametrize("rest_ms", [10, 40])
def test_the_newest_of_rapid_turns_stands_everywhere(page: Live, rest_ms: int) -> None:
    turns = [("striker.speed", "1553 mm/s"), ("striker.speed", "1.6 m/s"), ("chain.precompression slider", 0.8),
             ("gravity", "3000 mm/s^2"), ("chain.precompression slider", 0.5181)]  # fmt: skip
    for name, value in turns:
        page.ask("void (model(arguments[0]).value = arguments[1])", name, value)
        time.sleep(rest_ms / 1e3)
    until(lambda: "precompression=10.4 N" in page.text("command") and "e-" in page.text("table"))
    for name, value in dict(turns).items():
        assert page.value(name) == value
    for key in ("striker.speed", "gravity", "chain.precompression"):
        assert f"{key}={page.value(key)}" in page.text("command")


def test_a_slider_follows_a_typed_value_and_keeps_its_range(page: Live) -> None:
    page.press("gravity slider", Keys.HOME)
    until(lambda: "gravity=" in page.text("command"))
    page.turn("striker.speed", "0.5 m/s")
    until(lambda: 0 < page.value("striker.speed slider") < 0.25)
    assert page.value("gravity slider") == 0


def test_a_refused_key_is_taken_back(page: Live) -> None:
    page.type("other", "striker.sped=1 m/s")
    until(lambda: "did you mean speed?" in page.text("problem"))
    page.type("gravity", "3 m/s^2")
    page.type("other", "striker.sped")
    until(lambda: "allowed: KEY=VALUE" in page.text("problem"))
    page.type("other", "")
    until(lambda: "gravity=3 m/s^2" in page.text("command") and not page.text("problem"))


def test_a_refused_value_is_said_in_the_words_of_the_command(page: Live) -> None:
    before = page.curve("wall")
    page.type("striker.speed", "2 kg")
    words = 'fig4.toml with --set "striker.speed=2 kg": striker.speed: found "2 kg"; allowed: a speed above zero'
    until(lambda: words in page.text("problem"))
    assert page.curve("wall") == before
    page.type("striker.speed", "2 m/s")
    until(lambda: not page.text("problem"))


def test_a_page_that_is_loaded_again_has_its_settings(page: Live) -> None:
    page.turn("striker.speed", "1.3 m/s")
    until(lambda: "striker.speed" in page.driver.current_url)
    page.driver.refresh()
    until(lambda: page.ask("window.Bokeh !== undefined") and page.text("command"))
    assert page.value("striker.speed") == "1.3 m/s"
    page.press("reset")
    until(lambda: page.text("command") == "beads run fig4 --engine reference")
    until(lambda: page.driver.current_url.endswith("?set="))


def test_curves_are_kept_and_hidden(page: Live) -> None:
    before = page.curve("wall")
    page.press("keep")
    page.turn("striker.speed", "1 m/s")
    until(lambda: page.curve("wall", "kept 1") == before)
    assert page.curve("wall")[1] != before[1]
    page.press("keep")
    kept = 'model("forces").renderers.filter((each) => each.name?.startsWith("wall kept"))'
    dashes = f"{kept}.map((each) => each.glyph.line_dash.value)"
    until(lambda: len(page.ask(dashes)) == 2)
    assert len({*map(str, page.ask(dashes))}) == 2
    page.press("gauges", Keys.SPACE)
    until(lambda: not page.ask('model("forces").renderers[1].visible'))
    page.press("gauges", Keys.SPACE)
    until(lambda: page.ask('model("forces").renderers[1].visible'))
    page.press("drop")
    until(lambda: page.curve("wall", "kept 1") == ([], []))


def test_a_kept_scene_runs_and_gives_the_same_curve(page: Live, folder: Path) -> None:
    page.turn("chain.precompression", "1 N")
    page.turn("striker.speed", "1.25 m/s")
    devtools(page.driver, "Browser.setDownloadBehavior", behavior="allow", downloadPath=str(folder))
    files = {name: folder / f"fig4-{name}" for name in ("scene.toml", "forces.csv", "forces.svg")}
    for name, path in files.items():
        page.press(name)
        until(path.exists)
    assert_as_run(page, folder, str(files["scene.toml"]), "reference", {})
    original = (paths.SCENES / "fig4.toml").read_text().splitlines()
    changed = [line for line in files["scene.toml"].read_text().splitlines() if line not in original]
    assert changed == ['precompression = "1 N"', 'speed = "1.25 m/s"']
    forces = np.genfromtxt(files["forces.csv"], delimiter=",", names=True)
    assert forces["wall_N"].tolist() == page.curve("wall")[1]
    drawn = ElementTree.parse(files["forces.svg"])
    assert {"force (N)", "bead_9", "bead_5", "wall"} <= {
        each.text for each in drawn.iter("{http://www.w3.org/2000/svg}text")
    }


def chi_square(page: Live) -> float:
    """Chi-square once it is known."""
    text = until(lambda: page.text("overlay") if "readings" in page.text("overlay") else "")
    return float(text.split()[1])


def test_measured_traces_a_gain_and_chi_square(measured: Live, folder: Path) -> None:
    page = measured
    readings, first = page.curve("wall", "measured"), chi_square(page)
    page.turn("measured.1.gain", "11 N/V")
    until(lambda: page.curve("wall", "measured") != readings)
    case = build_case(read_scene("example-measured", ("measured.1.gain=11 N/V",)))
    motion = exact(case)
    aligned, *_ = lay_over(*entries_of(case.scene, None, ""), motion)
    (wall,) = (each for each in aligned if each.channel.gauge == "wall")
    assert page.curve("wall", "measured")[1] == (wall.force_N + motion.signals["wall"][0]).tolist()
    page.press("reset")
    page.turn("measured.0.trigger", "30 us")
    until(lambda: page.curve("wall", "measured")[0][-1] > readings[0][-1] + 5)
    page.press("reset")
    until(lambda: page.text("command") == "beads run example-measured --engine reference")
    page.ask('model("free").value = ["materials.ptfe.youngs_modulus"]')
    page.press("fit")
    until(lambda: "degrees of freedom" in page.text("fit_said"))
    page.press("take")
    until(lambda: "measured.1.gain" in page.text("command"))
    until(lambda: chi_square(page) < first / 10)
    stated = pd.read_csv(folder / "results" / "fit-example-measured" / "laws.csv")["chi_square"].sum()
    assert chi_square(page) == pytest.approx(stated, rel=0.02)


@pytest.mark.parametrize("code", installed(codes()))
def test_a_run_on_a_code_draws_its_points(page: Live, code: str) -> None:
    page.turn("striker.speed", "1.75 m/s")
    page.press("code", code)
    until(lambda: page.value("code") == code)
    page.press("run")
    until(lambda: f"\n{code}: pass" in page.text("run_said"))
    assert "error budget" in page.text("run_said")
    time_us, force_N = page.curve("wall", code)
    exact = np.interp(time_us, *page.curve("wall"))
    assert len(force_N) >= 100
    assert np.abs(np.array(force_N) - exact).max() < 1e-3 * max(force_N)


def test_errors_beads_and_the_time(page: Live) -> None:
    until(lambda: "e-" in page.text("table").split("wall_peak_N")[1][:60])
    page.press("time", Keys.ARROW_RIGHT * 50)
    until(lambda: page.value("time") == 100)
    assert max(page.ask('[...model("beads").renderers[1].data_source.data.force]')) > 0
    page.press("play")
    until(lambda: page.value("time") > 120)
    page.press("play")


def test_a_second_browser_has_its_own_knobs(page: Live, addresses: dict[str, str]) -> None:
    page.turn("striker.speed", "1.1 m/s")
    window = page.driver.current_window_handle
    page.driver.switch_to.new_window("tab")
    assert Live(page.driver, addresses[SCENE]).value("striker.speed") == "2 m/s"
    page.driver.close()
    page.driver.switch_to.window(window)
    assert page.value("striker.speed") == "1.1 m/s"


def test_a_name_that_was_bound_to_this_machine_is_refused(addresses: dict[str, str]) -> None:
    address, port = addresses[SCENE], addresses[SCENE].split(":")[2].split("/")[0]
    names = (f"localhost:{port}", "localhost:1", f"evil.example:{port}")
    assert [status_of(address, Host=name) for name in names] == [200, 200, 403]


def test_connections_of_other_origins_are_refused(addresses: dict[str, str]) -> None:
    async def connect(origin: str) -> str:
        request = HTTPRequest(f"{addresses[SCENE]}ws".replace("http", "ws", 1), headers={"Origin": origin})
        try:
            (await websocket_connect(request, subprotocols=["bokeh", "no token"])).close()
        except HTTPClientError as error:
            return str(error)
        return "connected"

    origins = addresses[SCENE].rsplit("/", 2)[0], "http://evil.example", "null"
    refused = "HTTP 403: Forbidden"
    assert [asyncio.run(connect(origin)) for origin in origins] == ["connected", refused, refused]
    for page in (addresses[SCENE], f"{addresses[SCENE]}autoload.js?bokeh-autoload-element=1"):
        assert [status_of(page, Origin=origin) for origin in origins] == [200, 403, 403]


def test_titles_and_values_are_shown_as_text(driver: Chrome, tmp_path: Path) -> None:
    tag = "<img src=x onerror=window.ran=1></title></script><script>window.ran=1</script>"
    lines = (paths.SCENES / "fig4.toml").read_text().splitlines()
    (title,) = (line for line in lines if line.startswith("title"))
    scene = tmp_path / "marked.toml"
    scene.write_text("\n".join(lines).replace(title, f'title = "{tag}"'))
    with served(scene) as (address, _):
        page = Live(driver, address)
        page.type("striker.speed", tag)
        until(lambda: tag[:30] in page.text("problem"))
        assert page.ask('document.querySelector("h1").textContent') == tag == driver.title
        assert page.ask("window.ran === undefined")
        driver.get("about:blank")


def test_two_hundred_requests_a_second_leave_it_answering(driver: Chrome) -> None:
    with served(SCENE) as (address, _), ThreadPoolExecutor(20) as pool:
        page = Live(driver, address)

        over = Event()

        def flood() -> set[int]:
            sent = []
            while not over.wait(1 / 200):
                sent.append(pool.submit(status_of, address))
            return {each.result() for each in sent}

        flooded = pool.submit(flood)
        for text in ("1.6 m/s", "1.7 m/s"):
            page.turn("striker.speed", text)
        over.set()
        assert flooded.result() == {200, 503}
        driver.get("about:blank")  # before the server ends, which the console would tell


def test_work_ends_with_a_page_that_is_left(driver: Chrome) -> None:
    with served(SCENE) as (address, process):
        Live(driver, address)
        server = psutil.Process(process.pid)

        def working() -> int:
            return sum(each.status() != psutil.STATUS_ZOMBIE for each in server.children(recursive=True))

        assert working() >= 3
        driver.get("about:blank")
        until(lambda: working() <= 2)  # of which workers are forked


@pytest.mark.parametrize("width_px", [1280, 390])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_fits_wide_and_narrow_light_and_dark(measured: Live, width_px: int, scheme: str) -> None:
    page, driver = measured, measured.driver
    said(driver), requests(driver)
    view(driver, width_px, scheme)
    driver.refresh()
    until(lambda: "readings" in page.text("overlay"))
    assert page.ask("document.documentElement.scrollWidth <= innerWidth")
    keep_screenshot(driver, SCREENSHOTS / f"live-{width_px}-{scheme}.png")
    brightness = np.asarray(Image.open(SCREENSHOTS / f"live-{width_px}-{scheme}.png").convert("L")).mean()
    assert brightness > 200 if scheme == "light" else brightness < 80
    assert said(driver) == []
    loaded = {address.split("/")[2].split(":")[0] for address in requests(driver) if not address.startswith("data:")}
    assert loaded == {"127.0.0.1"}
