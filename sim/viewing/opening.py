"""``show``: brings a page or a site to a browser, or says where a browser finds it."""

from __future__ import annotations

import getpass
import socket
import webbrowser
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from planner.errors import FileFormatError
from planner.files.json_csv import whole_file
from planner.pages.blocks import Sentence
from planner.pages.opening import has_browser, temporary_page
from planner.pages.page import Page, page_html
from sim.viewing.kinds import Shown, WrittenPage
from sim.viewing.server import Answer, LocalServer, Site


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
        _write(shown, opening.out)
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


def _write(page: Page | WrittenPage, file: Path) -> None:
    text = _html(page)
    with whole_file(file) as stream:
        stream.write(text.encode())


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
