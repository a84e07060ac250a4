"""The command ``beads explore``: a local server of live pages, below an address that nobody can guess."""

import gc
import getpass
import logging
import secrets
import socket
import webbrowser
from contextlib import suppress
from html import escape
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from bokeh.application import Application
from bokeh.application.handlers import FunctionHandler
from bokeh.document import Document
from bokeh.models.widgets import Div
from bokeh.server.server import Server
from tornado.httputil import HTTPServerRequest
from tornado.web import ErrorHandler, HTTPError

from drivers.base.errors import InputError
from drivers.chain.case import build_case
from drivers.run.execute import get_ready
from drivers.scene.read_scene import read_scene
from validation.commands.key_commands import key_tables
from validation.explore.knobs import knobs_of
from validation.explore.page import Page
from validation.explore.views import Question, view_of

HOST = "127.0.0.1"
OTHER_HOSTS = r"(?!(127\.0\.0\.1|localhost)$).*$"  # in requests: names that a page elsewhere has bound to this machine
MAX_PAGES = 8  # at a time, each with up to three worker processes
LIFETIME_MS = 5_000  # of a page that no browser is connected to


def explore(
    scene: str, settings: tuple[str, ...], knobs: tuple[str, ...], quiet: bool, runs: Path, results: Path
) -> None:
    """Turn the values of a scene and watch the forces, in a browser.

    The page is served on this machine alone, at an address that is printed.

    Examples:
      beads explore fig4
      beads explore shot.toml --knob striker.speed=0.1..5
    """
    knobs_of(build_case(read_scene(scene, settings)), knobs)  # which may be wrong
    get_ready(view_of)
    logging.disable(logging.WARNING)
    pages, keys = set[Page](), [key for key, *_ in key_tables()["scene"]]

    def end(page: Page) -> None:
        pages.remove(page)
        page.close()

    def open_page(document: Document) -> None:
        try:
            page = Page(document, Question(scene, settings, knobs), keys, runs, results)
        except InputError as error:  # or the file has changed
            document.add_root(Div(text=escape(str(error))))
        else:
            pages.add(page)
            document.on_session_destroyed(lambda _: end(page))

    def refuse(request: HTTPServerRequest) -> dict[str, Any]:
        """Refuse pages of other origins, and those beyond the limit before they cost time, as in a flood."""
        if urlsplit(request.headers.get("Origin", f"//{request.host}")).netloc != request.host:
            raise HTTPError(403)
        if len(pages) >= MAX_PAGES:
            raise HTTPError(503, reason=f"{MAX_PAGES} pages are open; close some, then load this one again")
        return {}

    handler = FunctionHandler(open_page)
    handler.process_request = refuse
    server = Server(
        {"/": Application(handler)},
        address=HOST,
        port=0,
        ico_path="none",
        prefix=secrets.token_urlsafe(24),
        unused_session_lifetime_milliseconds=LIFETIME_MS,
        check_unused_sessions_milliseconds=LIFETIME_MS // 5,
    )
    server._tornado.add_handlers(OTHER_HOSTS, [(".*", ErrorHandler, {"status_code": 403})])
    gc.freeze()  # what is loaded already, so that collections while a page rests take no time (130 ms without)
    address = f"http://{HOST}:{server.port}{server.prefix}/"
    print(address)
    print(f"from another machine: ssh -L {server.port}:{HOST}:{server.port} {getpass.getuser()}@{socket.gethostname()}")
    print("Ctrl-C ends it", flush=True)
    if not quiet:
        webbrowser.open(address)
    try:
        server.start()
        with suppress(KeyboardInterrupt):
            server.io_loop.start()
    finally:
        for page in pages:
            page.close()
