"""The report page in headless Chromium, as its readers see it: ``make test-page``, screenshots in ``results/page``."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import pytest
from selenium.webdriver import Chrome

from drivers import paths
from validation.comparison import compare_case
from validation.report import write_report
from validation.scenes import ComparedScene, run_and_compare
from validation.tests.browser import (
    PRINTED_PX,
    allow_scripts,
    ask,
    browser,
    keep_print,
    keep_screenshot,
    nameless_pictures,
    need_browser,
    requests,
    said,
    view,
)
from validation.tests.conftest import BASE, STRIKER, WALL, case_of, finished

pytestmark = pytest.mark.page

WIDTHS_PX = (1280, 390)
SCHEMES = ("light", "dark")
LEGIBLE = 4.5  # WCAG 2.2, 1.4.3: contrast of text
HOSTILE = """</script><img src=x onerror="throw 1"><script>throw 2</script>' & \\" {{ 3 }}"""
KEPT = paths.RESULTS / "page"


@dataclass(frozen=True)
class Shown:
    """A page in the browser, and the scenes it was made of where the test made it."""

    driver: Chrome
    name: str
    file: Path
    scenes: list[ComparedScene]

    def load(self) -> None:
        """Opens it anew, folded, in light colours."""
        view(self.driver, WIDTHS_PX[0])
        self.driver.get(self.file.as_uri())


@pytest.fixture(scope="module")
def driver() -> Iterator[Chrome]:
    need_browser()
    with browser() as driver:
        yield driver


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory, shared_runs: Path) -> list[ComparedScene]:
    """Fig. 4 on all engines there are; and a small scene in hostile words, of which an engine failed."""
    text = BASE.format(count=5, chain="sensors = [{from_wall = 4}, {from_wall = 2}]", striker=STRIKER, wall=WALL,
                       duration="0.3 ms", step="0.1 us")  # fmt: skip
    file = tmp_path_factory.mktemp("scene") / "small.toml"
    file.write_text(f"title = '''{HOSTILE}'''\n{text}")
    case = case_of(file)
    runs = {engine: finished(case, engine, shared_runs) for engine in ("verlet", "reference")}
    absent = {"liggghts": "not installed", "yade": f"failed: exit code 1: {HOSTILE}"}
    small = ComparedScene(case, runs, absent, compare_case(case, runs, absent))
    return [run_and_compare("fig4", runs=shared_runs), small]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, scenes: list[ComparedScene]) -> Path:
    file = tmp_path_factory.mktemp("page") / "report.html"
    write_report(scenes, file)
    return file


@pytest.fixture(scope="module", params=["made", "results"])
def shown(request: pytest.FixtureRequest, driver: Chrome) -> Shown:
    """The page of the scenes above, and the one that ``make report`` wrote, if it did."""
    if request.param == "results":
        file = paths.RESULTS / "report.html"
        if not file.exists():
            pytest.skip("make report has not been run")
        return Shown(driver, request.param, file, [])
    return Shown(driver, request.param, request.getfixturevalue("made"), request.getfixturevalue("scenes"))


@pytest.fixture
def page(shown: Shown) -> Shown:
    """The page as it opens."""
    shown.load()
    return shown


def test_nothing_is_said_and_nothing_is_asked_for(shown: Shown) -> None:
    said(shown.driver), requests(shown.driver)
    for scheme in SCHEMES:
        view(shown.driver, WIDTHS_PX[0], scheme)
        shown.driver.get(shown.file.as_uri())
        ask(shown.driver, "openAll")
        ask(shown.driver, "touchAll")
    assert said(shown.driver) == []
    asked = requests(shown.driver)
    assert asked.count(shown.file.as_uri()) == len(SCHEMES)
    assert [address for address in asked if not address.startswith("data:") and address != shown.file.as_uri()] == []


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("width_px", WIDTHS_PX)
def test_the_page_scrolls_one_way_only(page: Shown, width_px: int, scheme: str) -> None:
    view(page.driver, width_px, scheme)
    keep_screenshot(page.driver, KEPT / f"{page.name}-{width_px}-{scheme}-first.png", whole=False)
    assert ask(page.driver, "tooWide", width_px) == []
    ask(page.driver, "openAll")
    assert ask(page.driver, "tooWide", width_px) == []
    page.load()
    view(page.driver, width_px, scheme)
    keep_screenshot(page.driver, KEPT / f"{page.name}-{width_px}-{scheme}.png", whole=True)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_every_text_can_be_read(page: Shown, scheme: str) -> None:
    view(page.driver, WIDTHS_PX[0], scheme)
    ask(page.driver, "openAll")
    found = ask(page.driver, "contrasts")
    assert len(found) > 10
    assert [kind for kind in found if kind[1] < LEGIBLE] == []


def test_the_schemes_differ(page: Shown) -> None:
    colours = []
    for scheme in SCHEMES:
        view(page.driver, WIDTHS_PX[0], scheme)
        colours.append(sum(ask(page.driver, "pageColour")))
    assert colours[0] > 3 * 200
    assert colours[1] < 3 * 80


def test_pictures_have_words(page: Shown) -> None:
    ask(page.driver, "openAll")
    assert page.driver.find_elements("css selector", "svg, img")
    assert nameless_pictures(page.driver) == []


def test_the_page_is_in_order(page: Shown) -> None:
    assert ask(page.driver, "brokenLinks") == []
    assert ask(page.driver, "repeatedIds") == []
    assert ask(page.driver, "aboutItself") == []
    headings = ask(page.driver, "headings")
    assert [level for level, _ in headings].count(1) == 1
    assert headings[0][0] == 1
    assert [(above, below) for above, below in pairwise(headings) if below[0] > above[0] + 1] == []
    assert all(words for _, words in headings)


def test_paper_holds_everything(page: Shown) -> None:
    view(page.driver, PRINTED_PX, "dark", "print")
    assert ask(page.driver, "pageColour") == [255, 255, 255]
    assert ask(page.driver, "tooWide", PRINTED_PX) == []
    assert ask(page.driver, "cutOff") == []
    assert ask(page.driver, "breakable", "figure, tr") == []
    assert [kind for kind in ask(page.driver, "contrasts") if kind[1] < LEGIBLE] == []
    view(page.driver, WIDTHS_PX[0])
    assert keep_print(page.driver, KEPT / f"{page.name}.pdf").startswith(b"%PDF")


def test_it_reads_without_scripts(page: Shown) -> None:
    with_scripts = ask(page.driver, "text")
    try:
        allow_scripts(page.driver, allowed=False)
        page.load()
        assert ask(page.driver, "hidden", "section, section > :is(h2, p, table, figure), table.verdicts tr") == []
        assert ask(page.driver, "text") == with_scripts
        keep_screenshot(page.driver, KEPT / f"{page.name}-without-scripts.png", whole=True)
    finally:
        allow_scripts(page.driver, allowed=True)


def test_scripts_can_be_forbidden(driver: Chrome, tmp_path: Path) -> None:
    """Else the test above would compare a page with itself."""
    file = tmp_path / "page.html"
    file.write_text("<!doctype html><title>quiet</title><script>document.title = 'ran'</script>")
    titles = {}
    for allowed in (False, True):
        allow_scripts(driver, allowed=allowed)
        driver.get(file.as_uri())
        titles[allowed] = driver.title
    assert titles == {False: "quiet", True: "ran"}


def test_the_checks_see_what_is_wrong(driver: Chrome, tmp_path: Path) -> None:
    """A page with every fault that is looked for."""
    file = tmp_path / "faults.html"
    file.write_text((Path(__file__).parent / "faults.html").read_text())
    said(driver), requests(driver)
    view(driver, 390)
    driver.get(file.as_uri())
    assert any("SEVERE" in line for line in said(driver))
    assert any(address.startswith("http://localhost:9/") for address in requests(driver))
    assert len(ask(driver, "tooWide", 390)) > 1
    assert ask(driver, "cutOff") == ["<pre> longer-than-its-box"]
    assert ask(driver, "brokenLinks") == ["#nowhere", "other.html"]
    assert ask(driver, "repeatedIds") == ["twice"]
    assert ask(driver, "headings") == [[1, "One"], [3, "Three"]]
    assert ask(driver, "aboutItself") == ["no language", "no title"]
    assert ask(driver, "hidden", "section") == ["<section> hidden-section"]
    assert ask(driver, "breakable", "figure") == ["<figure> breaks"]
    assert sorted(round(value, 1) for _, value, _ in ask(driver, "contrasts") if value < LEGIBLE) == [1.9, 3.3]
    assert len(nameless_pictures(driver)) == 2
