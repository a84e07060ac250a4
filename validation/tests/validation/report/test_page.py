"""The report page in headless Chromium: ``make test-page``, with screenshots in ``results/page``."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import pytest
from selenium.webdriver import Chrome

from drivers.base import paths
from validation.tests.helpers.browser import (
    PRINTED_HIGH_PX,
    PRINTED_PX,
    ask,
    browser,
    keep_print,
    keep_screenshot,
    need_browser,
    requests,
    said,
    view,
)

pytestmark = pytest.mark.page

WIDTHS_PX = (1280, 390)
SCHEMES = ("light", "dark")
MIN_CONTRAST = 4.5  # of text, WCAG 2.2, 1.4.3
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


@pytest.fixture(scope="module", params=["hostile", "results"])
def shown(request: pytest.FixtureRequest, driver: Chrome) -> Shown:
    """The page with hostile texts, and the page written by ``make report`` if it exists."""
    file = (
        paths.RESULTS / "report.html"
        if request.param == "results"
        else request.getfixturevalue("hostile") / "report.html"
    )
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
    keep_screenshot(page.driver, SCREENSHOTS / f"{page.name}-{width_px}-{scheme}.png")
    if width_px == WIDTHS_PX[0]:
        assert ask(page.driver, "belowTheFold", "nav, h1, .failures, .lead dd") == []
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
    assert ask(page.driver, "nameless") == []


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
    assert len(ask(driver, "nameless")) == 2
    assert ask(driver, "colliding") == ["one on other"]
    assert set(ask(driver, "torn")) == {"torn"}
