"""The report page in headless Chromium: ``make test-page``, with screenshots in ``results/page``."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import pytest
from selenium.webdriver import Chrome

from drivers.base import paths
from drivers.base.files import sealed_file
from drivers.chain.trace import until
from drivers.engines import engine_names
from validation.accuracy.budget import first_departure
from validation.chapters import write_table
from validation.checks import FAIL, Check
from validation.compare.comparison import ComparedScene
from validation.report.write_report import write_report
from validation.tests.helpers.browser import (
    PRINTED_HIGH_PX,
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
from validation.tests.helpers.commands import beads
from validation.tests.helpers.runs import blown_up, checks_of, finished, run_and_compare
from validation.tests.helpers.scenes import BASE, STRIKER, WALL, case_of
from validation.tests.validation.claims.published import published_checks

pytestmark = pytest.mark.page

WIDTHS_PX = (1280, 390)
SCHEMES = ("light", "dark")
MIN_CONTRAST = 4.5  # of text, WCAG 2.2, 1.4.3
HOSTILE = """</script><img src=x onerror="throw 1"><script>throw 2</script>' & \\" {{ 3 }}"""
MAX_PRINTED_PAGES = 15
SCREENSHOTS = paths.RESULTS / "page"


@dataclass(frozen=True)
class Shown:
    """A page in the browser, with its scenes if the test made it."""

    driver: Chrome
    name: str
    file: Path
    scenes: list[ComparedScene]

    def load(self) -> None:
        """Open the page again, folded, in light colours."""
        view(self.driver, WIDTHS_PX[0])
        self.driver.get(self.file.as_uri())


@pytest.fixture(scope="module")
def driver() -> Iterator[Chrome]:
    need_browser()
    with browser() as driver:
        yield driver


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory, shared_runs: Path) -> list[ComparedScene]:
    """Fig. 4 on all installed engines; and a small scene with hostile texts and a failed engine."""
    text = BASE.format(count=5, chain="sensors = [{from_wall = 4}, {from_wall = 2}]", striker=STRIKER, wall=WALL,
                       duration="0.3 ms", step="0.1 us")  # fmt: skip
    file = tmp_path_factory.mktemp("scene") / "small.toml"
    file.write_text(f"title = '''{HOSTILE}'''\n{text}")
    case = case_of(file)
    runs = {engine: finished(case, engine, shared_runs) for engine in ("verlet", "reference")}
    absent = {"liggghts": "not installed", "yade": f"failed: exit code 1: {HOSTILE}"}
    half = until(blown_up(runs["verlet"].trace, 200), 290)
    departures = {"yade": first_departure(case, "yade", half)}
    small = ComparedScene(case, runs, absent, checks_of(case, runs, absent), departures, {}, {"yade": half})
    return [run_and_compare("fig4", runs=shared_runs), small]


def write_published(results: Path) -> None:
    """Write the table of published numbers, all hit but one, with a hostile text."""
    *checks, last = published_checks(tuple(engine_names()))
    failed = replace(last, verdict=FAIL, value=2 * last.limit, where=f"found 2, expected 1: {HOSTILE}")
    write_table(results / "claims.csv", Check, [*checks, failed])


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, scenes: list[ComparedScene], shared_runs: Path) -> Path:
    """Page of these scenes, figures and published numbers, without the other studies."""
    results = tmp_path_factory.mktemp("page")
    for figure in ("fig1", "fig4", "table1"):
        drawn = beads("figures", figure, "--runs", shared_runs, "--results", results)
        assert drawn.returncode == 0, drawn.stderr
    write_published(results)
    write_report(scenes, results / "report.html")
    return results / "report.html"


@pytest.fixture(scope="module", params=["made", "results"])
def shown(request: pytest.FixtureRequest, driver: Chrome) -> Shown:
    """The page of the scenes above, and the page written by ``make report`` if it exists."""
    if request.param == "results":
        file = paths.RESULTS / "report.html"
        if not file.exists():
            pytest.skip("make report has not been run")
        return Shown(driver, request.param, file, [])
    return Shown(driver, request.param, request.getfixturevalue("made"), request.getfixturevalue("scenes"))


@pytest.fixture
def page(shown: Shown) -> Shown:
    """The page, newly opened."""
    shown.load()
    return shown


def test_the_console_is_empty_and_nothing_is_loaded(shown: Shown) -> None:
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


def test_a_hostile_figure_stays_in_its_picture(driver: Chrome, tmp_path: Path) -> None:
    """The browser shows the figure, runs none of its scripts, and loads none of its addresses."""
    hostile = """<?xml version="1.0"?><?xml-stylesheet href="http://localhost:9/a.css"?>
        <svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" width="90pt" height="90pt"
            onload="throw 1"><script>throw 2</script><script href="http://localhost:9/a.js"/>
        <style>@import "http://localhost:9/b.css"; * { fill: url(http://localhost:9/c.svg#a) }</style>
        <image xlink:href="http://localhost:9/d.png"/><a xlink:href="javascript:throw 3"><path d="M0 0h90v90z"/></a>
        <foreignObject><img xmlns="http://www.w3.org/1999/xhtml" src="x" onerror="throw 4"/></foreignObject></svg>"""
    with sealed_file(tmp_path / "fig4.svg") as draft:
        draft.write_text(hostile)
    write_report([], tmp_path / "report.html")
    said(driver), requests(driver)
    driver.get((tmp_path / "report.html").as_uri())
    ask(driver, "touchAll")
    picture = driver.find_element("css selector", "#figures img")
    assert picture.get_property("naturalWidth") == 120
    picture.click()
    assert said(driver) == []
    assert [address for address in requests(driver) if not address.startswith(("data:", "file:"))] == []


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("width_px", WIDTHS_PX)
def test_the_page_scrolls_one_way_only(page: Shown, width_px: int, scheme: str) -> None:
    view(page.driver, width_px, scheme)
    keep_screenshot(page.driver, SCREENSHOTS / f"{page.name}-{width_px}-{scheme}-first.png", whole=False)
    keep_screenshot(page.driver, SCREENSHOTS / f"{page.name}-{width_px}-{scheme}.png", whole=True)
    assert ask(page.driver, "tooWide", width_px) == []
    ask(page.driver, "openAll")
    assert ask(page.driver, "tooWide", width_px) == []
    assert ask(page.driver, "scrolling", "nav ul, pre") == []
    assert [box for box in ask(page.driver, "cutOff") if box.startswith(("<td", "<th"))] == []
    ask(page.driver, "unpackPictures")
    assert ask(page.driver, "torn") == []
    assert ask(page.driver, "colliding") == []


def test_the_first_screen_has_the_answer(page: Shown) -> None:
    """Links in one line; failures first, then the lines on statements, codes and misfits."""
    for width_px in WIDTHS_PX:
        view(page.driver, width_px)
        lines = page.driver.execute_script(
            "return new Set([...document.querySelectorAll('nav a')].map((a) => a.offsetTop)).size"
        )
        assert lines == 1
    view(page.driver, WIDTHS_PX[0])
    assert len(page.driver.find_elements("css selector", ".lead dd")) == (2 if page.name == "made" else 3)
    assert ask(page.driver, "belowTheFold", "nav, h1, .failures, .lead dd") == []
    order = page.driver.execute_script(
        "return [...document.querySelectorAll('h1, .failures, .lead')].map((each) => each.getBoundingClientRect().top)"
    )
    assert order == sorted(order)
    assert len(order) == (3 if page.name == "made" else len(order))


@pytest.mark.parametrize("width_px", WIDTHS_PX)
def test_the_contents_stay_in_view(page: Shown, width_px: int) -> None:
    view(page.driver, width_px)
    page.driver.execute_script("document.querySelector('main').lastElementChild.scrollIntoView()")
    assert ask(page.driver, "belowTheFold", "nav") == []
    assert page.driver.execute_script("return document.querySelector('nav').getBoundingClientRect().top") == 0
    assert len(page.driver.find_elements("css selector", "nav a")) == 1 + len(  # the answer, and
        page.driver.find_elements("css selector", "main > section")
    )


@pytest.mark.parametrize("scheme", SCHEMES)
def test_every_text_can_be_read(page: Shown, scheme: str) -> None:
    view(page.driver, WIDTHS_PX[0], scheme)
    ask(page.driver, "openAll")
    ask(page.driver, "unpackPictures")
    found = ask(page.driver, "contrasts")
    assert len(found) > 10
    assert [kind for kind in found if kind[1] < MIN_CONTRAST] == []


def test_the_schemes_differ(page: Shown) -> None:
    colours = []
    for scheme in SCHEMES:
        view(page.driver, WIDTHS_PX[0], scheme)
        colours.append(sum(ask(page.driver, "pageColour")))
    assert colours[0] > 3 * 200
    assert colours[1] < 3 * 80


def test_the_page_is_in_order(page: Shown) -> None:
    assert ask(page.driver, "brokenLinks") == []
    assert ask(page.driver, "repeatedIds") == []
    assert ask(page.driver, "aboutItself") == []
    headings = ask(page.driver, "headings")
    assert [level for level, _ in headings].count(1) == 1
    assert headings[0][0] == 1
    assert [(above, below) for above, below in pairwise(headings) if below[0] > above[0] + 1] == []
    assert all(words for _, words in headings)
    ask(page.driver, "openAll")
    assert page.driver.find_elements("css selector", "svg, img")
    assert nameless_pictures(page.driver) == []


def test_the_print_is_short_and_complete(page: Shown) -> None:
    """Folded parts are not printed; everything else is, on a few pages."""
    printed = keep_print(page.driver, SCREENSHOTS / f"{page.name}.pdf")
    assert 1 <= printed.count(b"/Type /Page\n") <= MAX_PRINTED_PAGES
    view(page.driver, PRINTED_PX, "dark", "print")
    assert ask(page.driver, "pageColour") == [255, 255, 255]
    assert ask(page.driver, "tooWide", PRINTED_PX) == []
    assert ask(page.driver, "cutOff") == []
    assert ask(page.driver, "torn") == []
    assert ask(page.driver, "breakable", "figure, tr") == []
    assert ask(page.driver, "tallerThan", PRINTED_HIGH_PX) == []
    unfolded = "main :is(p, table, figure, pre, li):not(details:not([open]) *)"
    assert ask(page.driver, "hidden", unfolded) == []
    assert [kind for kind in ask(page.driver, "contrasts") if kind[1] < MIN_CONTRAST] == []


def test_it_reads_without_scripts(page: Shown) -> None:
    with_scripts = ask(page.driver, "text")
    try:
        allow_scripts(page.driver, allowed=False)
        page.load()
        unfolded = "section, section > :is(h2, p:not(.paper-only), table, figure), .failures, .lead"
        assert ask(page.driver, "hidden", unfolded) == []
        assert ask(page.driver, "text") == with_scripts
        keep_screenshot(page.driver, SCREENSHOTS / f"{page.name}-without-scripts.png", whole=True)
    finally:
        allow_scripts(page.driver, allowed=True)


def test_the_checks_find_faults(driver: Chrome, tmp_path: Path) -> None:
    """Each check finds its fault in a page that has all of them."""
    file = tmp_path / "faults.html"
    file.write_text((Path(__file__).parent / "faults.html").read_text())
    said(driver), requests(driver)
    view(driver, 390)
    driver.get(file.as_uri())
    assert any("SEVERE" in line for line in said(driver))
    assert any(address.startswith("http://localhost:9/") for address in requests(driver))
    assert len(ask(driver, "tooWide", 390)) > 1
    assert ask(driver, "cutOff") == ["<pre> longer-than-its-box"]
    assert ask(driver, "scrolling", "nav") == ["<pre> longer-than-its-box"]
    assert ask(driver, "brokenLinks") == ["#nowhere", "other.html"]
    assert ask(driver, "repeatedIds") == ["twice"]
    assert ask(driver, "headings") == [[1, "One"], [3, "Three"]]
    assert ask(driver, "aboutItself") == ["no language", "no title"]
    assert ask(driver, "hidden", "section") == ["<section> hidden-section"]
    assert ask(driver, "breakable", "figure") == ["<figure> breaks"]
    assert sorted(round(value, 1) for _, value, _ in ask(driver, "contrasts") if value < MIN_CONTRAST) == [1.9, 3.3]
    assert len(nameless_pictures(driver)) == 2
    assert ask(driver, "colliding") == ["one on other"]
    assert set(ask(driver, "torn")) == {"torn"}
    assert ask(driver, "tallerThan", PRINTED_HIGH_PX) == ["<tr> torn"]
