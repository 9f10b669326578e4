"""``LocalServer``: pages on 127.0.0.1, for this machine alone and whoever forwards its port.

It serves what a ``Site`` makes, never files: no address reaches the disk. Requests under another
name than this machine's are refused, so that no page of the web can read along (DNS rebinding).

``show``: brings a page or a site to a browser, or says where a browser finds it.
"""

from __future__ import annotations

import errno
import getpass
import socket
import webbrowser
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, Protocol, TypeAlias
from urllib.parse import parse_qsl, unquote, urlsplit

from planner.errors import FileFormatError, PlannerError, TaskError
from planner.files.disk import whole_file
from planner.pages.blocks import Sentence
from planner.pages.page import Page, has_browser, page_html, temporary_page

HOST = "127.0.0.1"
"""Where it listens."""

DEFAULT_PORT = 8765
"""Port if none is asked for and it is free; else any free one."""

OWN_NAMES = (HOST, "localhost")
"""Names under which a browser may ask, on any port: ssh may forward another one."""


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What is sent for an address.

    Attributes:
        body: The bytes.
        kind: Their media type.
    """

    body: bytes
    kind: str = "text/html; charset=utf-8"


class Site(Protocol):
    """Pages and data by their address."""

    def answer(self, path: str, query: Mapping[str, str]) -> Answer | None:
        """What an address such as "/" or "/grasp/12" has to show; None for nothing.

        Called from several threads at once.

        Raises:
            PlannerError: It cannot be shown; the message is sent instead.
        """


class LocalServer:
    """A site on a port of this machine."""

    def __init__(self, site: Site, port: int | None = None) -> None:
        """Begin to listen.

        Args:
            site: What to serve.
            port: 0 for any free one; None for ``DEFAULT_PORT``, or a free one if that is in use.

        Raises:
            TaskError: The port is in use or not allowed.
        """
        handler = type("SiteHandler", (_Handler,), {"site": site})
        try:
            self._server = _Server((HOST, DEFAULT_PORT if port is None else port), handler)
        except OSError as error:
            if port is None and error.errno == errno.EADDRINUSE:
                self._server = _Server((HOST, 0), handler)
                return
            raise TaskError(
                f"cannot listen on port {port} of {HOST}: {error.strerror}; give another --port, "
                "or --port 0 for any free one"
            ) from error

    @property
    def port(self) -> int:
        """Where it listens."""
        return int(self._server.server_address[1])

    @property
    def address(self) -> str:
        """Of the first page."""
        return f"http://{HOST}:{self.port}/"

    def run(self) -> None:
        """Serve until Ctrl-C, or until ``stop`` is called from another thread."""
        self._server.serve_forever(poll_interval=0.2)

    def stop(self) -> None:
        """End ``run``; to be called from another thread."""
        self._server.shutdown()

    def close(self) -> None:
        """Free the port."""
        self._server.server_close()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    allow_reuse_address = True

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Nothing: a browser that closes a connection early is no fault."""


class _Handler(BaseHTTPRequestHandler):
    site: Site
    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:
        """Answer from the site."""
        if not self._asks_for_this_machine():
            self._send(HTTPStatus.FORBIDDEN, _text("this server is for this machine alone"))
            return
        address = urlsplit(self.path)
        try:
            found = self.site.answer(unquote(address.path), dict(parse_qsl(address.query)))
        except PlannerError as error:
            self._send(HTTPStatus.UNPROCESSABLE_ENTITY, _text(str(error)))
            return
        if found is None:
            self._send(HTTPStatus.NOT_FOUND, _text(f"nothing is at {address.path}"))
        else:
            self._send(HTTPStatus.OK, found)

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing: the terminal is for the person."""

    def _asks_for_this_machine(self) -> bool:
        name = self.headers.get("Host", "").rpartition(":")
        return (name[0] if name[1] else name[2]) in OWN_NAMES

    def _send(self, status: HTTPStatus, answer: Answer) -> None:
        self.send_response(status)
        self.send_header("Content-Type", answer.kind)
        self.send_header("Content-Length", str(len(answer.body)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.end_headers()
        self.wfile.write(answer.body)


def _text(sentence: str) -> Answer:
    return Answer(body=sentence.encode(), kind="text/plain; charset=utf-8")


@dataclass(frozen=True, kw_only=True)
class WrittenPage:
    """A page that is a file already.

    Attributes:
        path: The file.
        html: Its content.
    """

    path: Path
    html: str


Shown: TypeAlias = Page | WrittenPage | Site
"""One page, which can be written into a file, or a site, which needs a server."""


@dataclass(frozen=True, kw_only=True)
class Opening:
    """Where something is to be seen.

    Attributes:
        out: Write the page into this file and do nothing else; None to show it.
        port: Serve on this port, 0 for any free one; None for a server only where one is needed.
        open: Whether to open the browser.
    """

    out: Path | None = None
    port: int | None = None
    open: bool = True


def show(shown: Shown, opening: Opening, say: Callable[[str], None]) -> None:
    """Write a page, open it, or serve it until Ctrl-C.

    A page goes into a temporary file that the browser opens. Without a browser on this machine, or
    where a port is asked for, a server shows it instead; a site always needs one.

    Args:
        shown: What there is to see.
        opening: Where.
        say: Prints a line for the person.

    Raises:
        FileFormatError: A site is to be written into a file, or the file cannot be written.
        TaskError: The port is in use.
    """
    if opening.out is not None:
        if not isinstance(shown, Page | WrittenPage):
            raise FileFormatError(
                f"cannot write {opening.out}: a dataset is shown by a local server, which makes "
                "its pages as they are asked for; leave --out away, or take one grasp out of it "
                "with opposable batch --extract"
            )
        with whole_file(opening.out) as stream:
            stream.write(_html(shown).encode())
        say(f"wrote {opening.out}")
        return
    browser = opening.open and has_browser()
    if isinstance(shown, Page | WrittenPage) and browser and opening.port is None:
        file = shown.path if isinstance(shown, WrittenPage) else temporary_page(shown)
        webbrowser.open(file.resolve().as_uri())
        say(f"opened {file} in the browser")
        return
    site = _OnePage(_html(shown)) if isinstance(shown, Page | WrittenPage) else shown
    _serve(site, opening.port, browser, say)


def warnings_of(shown: Shown) -> tuple[str, ...]:
    """What a page warns of: what is missing in it, or simplified."""
    if not isinstance(shown, Page):
        return ()
    sentences = [block for block in shown.summary if isinstance(block, Sentence)]
    return tuple(s.text for s in sentences if s.kind == "warning")


def _html(page: Page | WrittenPage) -> str:
    return page.html if isinstance(page, WrittenPage) else page_html(page)


def _serve(site: Site, port: int | None, browser: bool, say: Callable[[str], None]) -> None:
    server = LocalServer(site, port)
    try:
        say(f"open {server.address} in a browser; Ctrl-C ends")
        if browser:
            webbrowser.open(server.address)
        else:
            name = f"{getpass.getuser()}@{socket.gethostname()}"
            say(
                "from another machine, forward the port first: "
                f"ssh -N -L {server.port}:127.0.0.1:{server.port} {name}"
            )
        server.run()
    except KeyboardInterrupt:
        say("stopped")  # Ctrl-C is how a server is meant to end
    finally:
        server.close()


class _OnePage:
    """A site of one page."""

    def __init__(self, html: str) -> None:
        self._html = html.encode()

    def answer(self, path: str, query: Mapping[str, str]) -> Answer | None:
        """The page at "/"."""
        return Answer(body=self._html) if path == "/" else None
