"""Local server of the live page: loopback only, below an address that nobody can guess."""

import gc
import getpass
import logging
import re
import secrets
import socket
import webbrowser
from asyncio import CancelledError, wrap_future
from contextlib import suppress
from html import escape
from pathlib import Path
from typing import Any

from bokeh.document import Document
from bokeh.models.widgets import Div
from bokeh.server.server import Server
from tornado.web import HTTPError, RequestHandler

from drivers.base.errors import InputError
from drivers.chain.case import build_case
from drivers.run.execute import get_ready
from drivers.scene.read_scene import read_scene
from validation.explore.knobs import knobs_of
from validation.explore.page import KEPT, Page
from validation.explore.views import Question, view_of

HOST = "127.0.0.1"
MAX_PAGES = 8  # at a time, each with up to three worker processes
LIFETIME_MS = 5_000  # of a page that no browser is connected to
TYPES = {".toml": "text/plain", ".csv": "text/csv", ".svg": "image/svg+xml"}


class _Keep(RequestHandler):
    """Files of what a page shows."""

    def initialize(self, pages: dict[str, Page]) -> None:
        self.pages = pages

    async def get(self, number: str, name: str) -> None:
        """Send a file of a page by its name."""
        page = self.pages.get(number)
        if page is None:
            raise HTTPError(404)
        try:
            made = await wrap_future(page.kept(name))
        except CancelledError:  # the page was closed
            raise HTTPError(404) from None
        if isinstance(made, Exception):
            raise HTTPError(409, reason="the scene has errors")
        self.set_header("Content-Type", f"{TYPES[Path(name).suffix]}; charset=utf-8")
        self.set_header("Content-Disposition", f'attachment; filename="{page.name}-{name}"')
        self.set_header("X-Content-Type-Options", "nosniff")
        self.finish(made)


def serve(question: Question, ranges: tuple[str, ...], runs: Path, results: Path, *, browser: bool) -> None:
    """Serve the live page of a scene until Ctrl-C.

    Args:
        question: Scene with settings.
        ranges: Options ``--knob``.
        runs: Folder for runs of codes.
        results: Folder for fits.
        browser: True to open the page in the browser of this machine.

    Raises:
        InputError: The scene, a setting or a knob is wrong.
    """
    knobs_of(build_case(read_scene(question.scene, question.settings)), ranges)
    get_ready(view_of)
    for name in ("bokeh", "tornado"):
        logging.getLogger(name).setLevel(logging.ERROR)
    pages: dict[str, Page] = {}

    def open_page(document: Document) -> None:
        if len(pages) >= MAX_PAGES:
            document.add_root(Div(text=f"More than {MAX_PAGES} pages are open; close some, then load this one again."))
            return
        number = secrets.token_hex(16)
        try:
            pages[number] = Page(document, question, ranges, runs, results, f"keep/{number}")
        except InputError as error:  # the file has changed
            document.add_root(Div(text=escape(str(error))))
            return

        def close(_: Any) -> None:
            pages.pop(number).close()

        document.on_session_destroyed(close)

    server = Server(
        {"/": open_page},
        address=HOST,
        port=0,
        ico_path="none",
        prefix=secrets.token_urlsafe(24),
        extra_patterns=[(rf"/keep/([0-9a-f]{{32}})/({'|'.join(map(re.escape, KEPT))})", _Keep, {"pages": pages})],
        unused_session_lifetime_milliseconds=LIFETIME_MS,
        check_unused_sessions_milliseconds=LIFETIME_MS // 5,
    )
    gc.freeze()  # what is loaded already, so that collections while a page rests take no time (130 ms without)
    address = f"http://{HOST}:{server.port}{server.prefix}/"
    print(address)
    print(f"from another machine: ssh -L {server.port}:{HOST}:{server.port} {getpass.getuser()}@{socket.gethostname()}")
    print("Ctrl-C ends it", flush=True)
    if browser:
        webbrowser.open(address)
    try:
        server.start()
        with suppress(KeyboardInterrupt):
            server.io_loop.start()
    finally:
        for page in pages.values():
            page.close()
