"""The report page in headless Chromium: ``make test-page``, with screenshots in ``results/page``."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import pytest
from selenium.webdriver import Chrome

from drivers.base import paths
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
from validation.tests.helpers.runs import blown_up, checks_of, run_and_compare
from validation.tests.validation.claims.published import published_checks
from validation.tests.validation.report.test_report import write_table_1

pytestmark = pytest.mark.page

WIDTHS_PX = (1280, 390)
SCHEMES = ("light", "dark")
MIN_CONTRAST = 4.5  # of text, WCAG 2.2, 1.4.3
HOSTILE = """</script><img src=x onerror="throw 1"><script>throw 2</script>' & \\" {{ 3 }}"""
MAX_PRINTED_PAGES = 15
SCREENSHOTS = paths.RESULTS / "page"


@dataclass(frozen=True)
class Shown:
    """A page in the browser."""

    driver: Chrome
    name: str
    file: Path

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
def made(tmp_path_factory: pytest.TempPathFactory, compared: ComparedScene, shared_runs: Path) -> Path:
    """Page of Fig. 4, of a scene with hostile texts and a failed engine, of Table 1, and of a number that is missed."""
    results = tmp_path_factory.mktemp("page")
    drawn = beads("figures", "fig4", "--runs", shared_runs, "--results", results)
    assert drawn.returncode == 0, drawn.stderr
    write_table_1(results)
    *checks, last = published_checks(tuple(engine_names()))
    failed = replace(last, verdict=FAIL, value=2 * last.limit, where=f"found 2, expected 1: {HOSTILE}")
    write_table(results / "claims.csv", Check, [*checks, failed])
    case = replace(compared.case, scene=compared.case.scene.model_copy(update={"title": HOSTILE}))
    absent = {"liggghts": "not installed", "yade": f"failed: exit code 1: {HOSTILE}"}
    half = until(blown_up(compared.runs["verlet"].trace, 200), 290)
    departures = {"yade": first_departure(case, "yade", half)}
    checks = checks_of(case, compared.runs, absent)
    small = ComparedScene(case, compared.runs, absent, checks, departures, {}, {"yade": half})
    write_report([run_and_compare("fig4", runs=shared_runs), small], results / "report.html")
    return results / "report.html"


@pytest.fixture(scope="module", params=["made", "results"])
def shown(request: pytest.FixtureRequest, driver: Chrome) -> Shown:
    """The page of the scenes above, and the page written by ``make report`` if it exists."""
    file = paths.RESULTS / "report.html" if request.param == "results" else request.getfixturevalue("made")
    if not file.exists():
        pytest.skip("make report has not been run")
    return Shown(driver, request.param, file)


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


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("width_px", WIDTHS_PX)
def test_the_page_scrolls_one_way_only_and_can_be_read(page: Shown, width_px: int, scheme: str) -> None:
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
    contrasts = ask(page.driver, "contrasts")
    assert len(contrasts) > 10
    assert [kind for kind in contrasts if kind[1] < MIN_CONTRAST] == []


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
    assert ask(driver, "scrolling", "nav") == ask(driver, "cutOff") == ["<pre> longer-than-its-box"]
    assert ask(driver, "brokenLinks") == ["#nowhere", "other.html"]
    assert ask(driver, "hidden", "section") == ["<section> hidden-section"]
    assert sorted(round(value, 1) for _, value, _ in ask(driver, "contrasts") if value < MIN_CONTRAST) == [1.9, 3.3]
    assert len(nameless_pictures(driver)) == 2
    assert ask(driver, "colliding") == ["one on other"]
    assert set(ask(driver, "torn")) == {"torn"}
