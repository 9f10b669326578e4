"""The built site: no warning, no dead link, nothing from outside, formulas without scripts."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("sphinx")
pytest.importorskip("furo")
pytest.importorskip("myst_parser")
pytest.importorskip("sphinx_copybutton")
pytest.importorskip("pyarrow")

from browser import browser
from machinery.check import check
from machinery.zoo import SCENES

pytestmark = pytest.mark.documentation

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built as its readers build it, warnings as errors."""
    folder = tmp_path_factory.mktemp("documentation") / "site"
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-E", "docs", str(folder)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.slow
def test_no_link_is_dead_and_nothing_is_loaded_from_outside(site: Path) -> None:
    found = check(site)
    assert found.links > 1000
    assert (found.dead, found.outside, found.malformed) == ([], [], [])


@pytest.mark.slow
@pytest.mark.parametrize("page", ["grasps", "forces", "manipulation"])
def test_a_measurement_is_shown_as_a_table(site: Path, page: str) -> None:
    text = (site / "results" / f"{page}.html").read_text(encoding="utf-8")
    assert "load average" in text
    assert "<table" in text
    assert "list-table" not in text


@pytest.mark.slow
def test_a_browser_without_a_network_shows_every_kind_of_page(site: Path) -> None:
    asked: list[str] = []
    errors: list[str] = []
    with browser() as chromium:
        page = chromium.new_context(offline=True).new_page()
        page.on("request", lambda request: asked.append(request.url))
        page.on("pageerror", lambda error: errors.append(str(error)))
        for path in pages_of(site):
            page.goto(path.as_uri())
            if path.parent.name == SCENES:  # a page of a trial, which has no frame of the site
                assert page.locator("h1").first.is_visible(), path
                continue
            main = page.locator("[role=main]")
            # the page of the search writes its heading when something is looked for
            assert path.name == "search.html" or main.locator("h1").first.is_visible(), path
            assert main.count() == 1, path
    assert errors == []
    assert [url for url in asked if not url.startswith(("file:", "data:", "blob:"))] == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "page"), [("own hand", "Your own hand"), ("Real hand", "On a real hand")]
)
def test_a_search_shows_guides_first_and_those_whose_title_it_is_before_all(
    site: Path, words: str, page: str
) -> None:
    with browser() as chromium:
        found = chromium.new_context(offline=True).new_page()
        found.goto(f"{(site / 'search.html').as_uri()}?q={words}")
        titles = found.locator("#search-results ul.search > li > a")
        titles.nth(5).wait_for()
        first = [titles.nth(k) for k in range(6)]
        assert page in (first[0].inner_text(), first[1].inner_text())
        assert not any("generated/" in (a.get_attribute("href") or "") for a in first)


OWN_KIND = ("index", "search", "genindex", "py-modindex")
"""Pages of the first folder that are like no others."""


def pages_of(site: Path) -> Iterator[Path]:
    """One page of each folder, and all of the first one that are like no others."""
    seen: set[Path] = set()
    for path in sorted(site.rglob("*.html")):
        first = path.parent == site and path.stem in OWN_KIND
        if "_static" not in path.parts and (first or path.parent not in seen):
            seen.add(path.parent)
            yield path


def page_in(folder: Path, body: str, name: str = "index.html") -> None:
    folder.mkdir(exist_ok=True)
    (folder / name).write_text(f"<html><body>{body}</body></html>", encoding="utf-8")


@pytest.mark.parametrize(
    ("body", "kind"),
    [
        ('<a href="nowhere.html">x</a>', "dead"),
        ('<a href="other.html#nothing">x</a>', "dead"),
        ('<a href="../outside.html">x</a>', "dead"),
        ('<img src="picture.png">', "dead"),
        ('<script src="https://cdn.example.org/x.js"></script>', "outside"),
        ('<img src="//example.org/x.png">', "outside"),
        ("<style>@import 'https://fonts.example.org/x.css';</style>", "outside"),
        ('<p style="background: url(https://example.org/x.png)">x</p>', "outside"),
        ('<link rel="stylesheet" href="https://example.org/x.css">', "outside"),
        ('<a href="https://exa mple">x</a>', "malformed"),
    ],
)
def test_a_fault_of_a_site_is_noticed(body: str, kind: str, tmp_path: Path) -> None:
    page_in(tmp_path / "site", body)
    page_in(tmp_path / "site", "<p id='place'>x</p>", "other.html")
    page_in(tmp_path, "", "outside.html")
    found = check(tmp_path / "site")
    faults = {name: len(getattr(found, name)) for name in ("dead", "outside", "malformed")}
    assert faults == {"dead": 0, "outside": 0, "malformed": 0} | {kind: 1}


def test_links_that_lead_somewhere_are_no_fault(tmp_path: Path) -> None:
    page_in(tmp_path, '<a href="other.html#place">x</a> <a href="https://example.org/a">y</a>')
    page_in(tmp_path, "<p id='place'>x</p><a href='index.html'>x</a>", "other.html")
    found = check(tmp_path)
    assert (found.dead, found.outside, found.malformed) == ([], [], [])
    assert found.links == 2
    assert found.external == {"https://example.org/a"}


PAGES = {
    "index": "Site\n====\n\n.. toctree::\n\n   a/index\n   b\n",
    "a/index": "Folder\n======\n\n.. toctree::\n\n   one\n   two\n",
    "a/one": "One\n===\n",
    "a/two": "Two\n===\n",
    "b": "Other\n=====\n",
}


def navigation(folder: Path, extensions: list[str]) -> dict[str, list[tuple[str, bool, bool]]]:
    """Page -> entries of its navigation: name, whether it is or holds the page, whether open."""
    from bs4 import BeautifulSoup

    for name, text in PAGES.items():
        path = folder / f"{name}.rst"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    (folder / "conf.py").write_text(
        f"import sys\nsys.path.insert(0, {str(ROOT / 'docs')!r})\n"
        f"extensions = {extensions}\nhtml_theme = 'furo'\n",
        encoding="utf-8",
    )
    command = [sys.executable, "-m", "sphinx", "-q", "-W", str(folder), str(folder / "site")]
    subprocess.run(command, check=True)
    found = {}
    for name in PAGES:
        text = (folder / "site" / f"{name}.html").read_text(encoding="utf-8")
        items = BeautifulSoup(text, "html.parser").select(".sidebar-tree li")
        found[name] = [
            (
                "".join(link.text for link in item.select(":scope > a")),
                {"current", "current-page"} <= set(item["class"]),
                item.select_one(":scope > input[checked]") is not None,
            )
            for item in items
        ]
        for link in BeautifulSoup(text, "html.parser").select(".sidebar-tree li > a"):
            target = str(link["href"]).partition("#")[0]
            assert not target or (folder / "site" / name).parent.joinpath(target).is_file()
    return found


@pytest.mark.slow
def test_the_navigation_of_a_folder_marks_each_page_as_the_theme_does(tmp_path: Path) -> None:
    ours = navigation(tmp_path / "ours", ["machinery.navigation"])
    assert ours == navigation(tmp_path / "theirs", [])
    assert ours["a/two"] == [
        ("Folder", False, True),
        ("One", False, False),
        ("Two", True, False),
        ("Other", False, False),
    ]


def test_formulas_are_mathml() -> None:
    from docutils import nodes
    from machinery.mathml import mathml

    made = mathml(r"\lVert f_{t,i} \rVert \le \mu f_n", block=True, where=nodes.paragraph())
    assert made.startswith("<math")
    assert "<msub>" in made
    assert "<mi>μ</mi>" in made
