"""A page in headless Chromium, driven through Debian's ``chromium`` and ``chromium-driver``."""

import base64
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from selenium.webdriver import Chrome, ChromeOptions, ChromeService

PAGE_SCRIPT = (Path(__file__).parent / "page.js").read_text()
MAX_SCREENSHOT_PX = 16_000  # larger screenshots are blank
A4_IN = {"paperWidth": 8.27, "paperHeight": 11.69}
PRINTED_PX, PRINTED_HIGH_PX = 718, 1047  # A4 without margins of 1 cm, at 96 pixels per inch


def need_browser() -> None:
    """Skip a test without a browser; fail it in CI."""
    missing = [name for name in ("chromium", "chromedriver") if shutil.which(name) is None]
    if missing:
        if os.environ.get("CI"):
            pytest.fail(f"{' and '.join(missing)} not installed, but required in CI")
        pytest.skip(f"{' and '.join(missing)} not installed")


@contextmanager
def browser() -> Iterator[Chrome]:
    """Browser that logs its console and its requests.

    Both paths are given, so that selenium searches and downloads nothing.
    """
    options = ChromeOptions()
    options.binary_location = shutil.which("chromium") or ""
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    for argument in ("--headless=new", "--disable-dev-shm-usage", "--disable-gpu", "--force-color-profile=srgb"):
        options.add_argument(argument)
    if os.geteuid() == 0:
        options.add_argument("--no-sandbox")  # root cannot use a sandbox
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("no_proxy", "*")  # the driver listens on loopback
        driver = Chrome(options=options, service=ChromeService(executable_path=shutil.which("chromedriver")))
        try:
            driver.set_page_load_timeout(60)
            yield driver
        finally:
            driver.quit()


def devtools(driver: Chrome, command: str, **parameters: Any) -> dict[str, Any]:
    """Send a command of the DevTools protocol and return its answer."""
    answer: dict[str, Any] = driver.execute_cdp_cmd(command, parameters)
    return answer


def view(driver: Chrome, width_px: int, scheme: str = "light", media: str = "") -> None:
    """Show the page at a width, in a colour scheme, and as on paper with ``media="print"``."""
    height_px = 800 if width_px > 500 else 844
    devtools(driver, "Emulation.setDeviceMetricsOverride", width=width_px, height=height_px, deviceScaleFactor=1,
             mobile=False)  # fmt: skip
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    devtools(driver, "Emulation.setEmulatedMedia", media=media, features=features)


def ask(driver: Chrome, question: str, *arguments: Any) -> Any:
    """Answer of a function in ``page.js`` on the current page."""
    names = ", ".join(f"arguments[{i}]" for i in range(len(arguments)))
    return driver.execute_script(f"{PAGE_SCRIPT}\nreturn {question}({names});", *arguments)


def said(driver: Chrome) -> list[str]:
    """Warnings and errors on the console since the last call."""
    return [f"{entry['level']}: {entry['message']}" for entry in driver.get_log("browser")
            if entry["level"] not in ("INFO", "DEBUG")]  # fmt: skip


def requests(driver: Chrome) -> list[str]:
    """Addresses requested since the last call."""
    events = [json.loads(entry["message"])["message"] for entry in driver.get_log("performance")]
    asked = [event["params"] for event in events if event["method"] == "Network.requestWillBeSent"]
    return [each["request"]["url"] for each in asked]


def keep_screenshot(driver: Chrome, file: Path) -> None:
    """Write a screenshot of the page, up to the largest possible height."""
    size = devtools(driver, "Page.getLayoutMetrics")["cssContentSize"]
    clip = {"x": 0, "y": 0, "width": size["width"], "height": min(size["height"], MAX_SCREENSHOT_PX), "scale": 1}
    shot = devtools(driver, "Page.captureScreenshot", format="png", captureBeyondViewport=True, clip=clip)
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(base64.b64decode(shot["data"]))


def keep_print(driver: Chrome, file: Path) -> bytes:
    """Write the page printed on A4 as PDF, and return its bytes."""
    printed = devtools(driver, "Page.printToPDF", printBackground=True, **A4_IN)
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(base64.b64decode(printed["data"]))
    return file.read_bytes()
