"""The documentation does what it shows: commands and scripts run, links lead somewhere."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import forks
import pytest
import typer.main
from documents import Block, PageError, blocks, is_run, missing, programs, run_one, same

from sim.cli import app

pytestmark = pytest.mark.documentation

ROOT = Path(__file__).resolve().parent.parent
PAGES = sorted(p for p in (ROOT / "docs").rglob("*.md") if "generated" not in p.parts)
DOCUMENTS = [ROOT / "README.md", *PAGES]
TIME_LIMIT = 900.0
"""Wall time (s) after which a page is taken to hang: 20 s at most on a free machine."""

SHOWN_COMMAND = re.compile(r"^\s*(\$ )?(\S*/)?opposable [a-z]")
"""A line that shows a command of ours, wherever it stands."""

INLINE_COMMAND = re.compile(r"`opposable ([a-z][\w-]*)")


def name_of(page: Path) -> str:
    return str(page.relative_to(ROOT))


def does_something(block: Block) -> bool:
    return not block.note("skip") and (block.language == "python" or bool(block.commands))


RUNNING = [page for page in DOCUMENTS if any(map(does_something, blocks(page)))]


def parsed(words: list[str]) -> dict[str, Any]:
    """Values of a command's parameters as typed; nothing is run.

    Raises an error of the command line's own for what it does not know.
    """
    command: Any = typer.main.get_command(app)
    context = command.context_class(command, info_name="opposable", resilient_parsing=True)
    while hasattr(command, "commands") and words and not words[0].startswith("-"):
        name = words[0]
        assert command.get_command(context, name) is not None, f"there is no command {name!r}"
        _, command, words = command.resolve_command(context, words)  # an old name is the new line
        context = command.context_class(command, parent=context, info_name=name)
    values, left, _ = command.make_parser(context).parse_args(list(words))
    assert not left, f"more arguments than {command.name} takes: {left}"
    for parameter in command.params:
        if parameter.required and "--help" not in words:
            assert values.get(parameter.name) is not None, f"{parameter.name} is missing"
    return dict(values)


@pytest.mark.parametrize("page", DOCUMENTS, ids=name_of)
def test_the_commands_of_a_page_exist_with_all_their_options(page: Path) -> None:
    for block in blocks(page):
        for line, command in block.commands:
            for words in programs(command):
                is_run(words)  # known
                measures = words[:3] == ["python", "-m", "benchmarks"]
                if words[0] == "opposable" or measures:
                    try:
                        parsed(["bench", *words[3:]] if measures else words[1:])
                    except Exception as error:
                        error.add_note(f"{page}:{line}: {command}")
                        raise


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_no_command_stands_where_it_is_not_run(page: Path) -> None:
    """Not in an indented block, nor in one of another language."""
    shown = {
        number
        for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1)
        if SHOWN_COMMAND.match(line)
    }
    run = {
        block.line + k
        for block in blocks(page)
        if block.language in ("console", "bash") or block.note("file")
        for k in range(len(block.text.splitlines()))
    }
    assert shown - run == set()


@pytest.mark.parametrize("page", DOCUMENTS, ids=name_of)
def test_commands_named_in_a_sentence_exist(page: Path) -> None:
    command: Any = typer.main.get_command(app)
    context = command.context_class(command, info_name="opposable")
    for named in INLINE_COMMAND.findall(page.read_text(encoding="utf-8")):
        assert command.get_command(context, named) is not None, named


def test_no_line_is_run_on_two_pages() -> None:
    """Each command is run once over all of them, but for the plan that a page begins with."""
    seen: dict[str, str] = {}
    for page in RUNNING:
        for block in blocks(page):
            if block.note("skip") or block.note("file"):
                continue
            for line, command in block.commands:
                if command.startswith("opposable plan "):
                    continue
                here = f"{name_of(page)}:{line}"
                assert command not in seen, f"{here} runs what {seen[command]} runs: {command}"
                seen[command] = here
    assert len(seen) > 30


@pytest.mark.slow
@pytest.mark.parametrize("page", RUNNING, ids=name_of)
def test_a_page_does_what_it_shows(page: Path, tmp_path: Path) -> None:
    if packages := missing(page):
        pytest.skip(f"not installed: {', '.join(packages)}")
    done = forks.run(run_one, str(page), folder=tmp_path, timeout=TIME_LIMIT)
    assert done.returncode == 0, done.stderr
    print(done.stderr)  # how long each block took


def page_of(folder: Path, text: str) -> Path:
    path = folder / "page.md"
    path.write_text(text, encoding="utf-8")
    return path


def outcome(page: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(ROOT / "tests" / "documents.py"), str(page)],
        cwd=page.parent,
        capture_output=True,
        text=True,
        check=False,
    )


def test_a_page_shares_names_files_and_folder_from_block_to_block(tmp_path: Path) -> None:
    page = page_of(
        tmp_path,
        "<!-- test: file mine.py -->\n```python\nANSWER = 42\n```\n"
        "```python\nfrom mine import ANSWER\nprint('it is', ANSWER / 4)\n```\n"
        "<!-- test: prints -->\n```text\nit is 10.5\n```\n"
        "```python\nopen('a.txt', 'w').write(str(ANSWER))\n```\n"
        "<!-- test: prints -->\n```console\n$ cat a.txt\n42\n```\n"
        "<!-- test: exit 1 -->\n```console\n$ cat nothing.txt\n```\n"
        "<!-- test: skip there is no such thing -->\n```python\nraise ValueError\n```\n",
    )
    done = outcome(page)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("```python\n\nanswer = 1\nassert answer == 2\n```\n", r'page.md", line 4'),
        ("```console\n$ cat nothing.txt\n```\n", r"page.md:2: `cat nothing.txt` ended with 1"),
        (
            "```python\nprint(1.25)\n```\n<!-- test: prints -->\n```text\n1.29\n```\n",
            "1.25 instead of 1.29",
        ),
        ("```console\n$ rm -r x\n```\n", "'rm' is neither run"),
        ("<!-- test: ad -n 1 -->\n```console\n$ ls\n```\n", "'ad' is none of add, copy"),
        ("<!-- test: exit 1 -->\nwords\n", "not above a block"),
        ("```python\n1\n", "this fence has no end"),
    ],
)
def test_a_mistake_in_a_page_is_noticed(text: str, complaint: str, tmp_path: Path) -> None:
    done = outcome(page_of(tmp_path, text))
    assert done.returncode == 1
    assert re.search(complaint, done.stderr), done.stderr


def test_commands_are_read_over_several_lines(tmp_path: Path) -> None:
    page = page_of(
        tmp_path,
        "```console\n$ opposable run \\\n    allegro_hand box\nfound\n$ ls\n```\n"
        "```bash\n# first\nopposable hands\n```\n",
    )
    console, bash = blocks(page)
    assert console.commands == [(2, "opposable run allegro_hand box"), (5, "ls")]
    assert console.output == "found"
    assert bash.commands == [(9, "opposable hands")]


def test_programs_are_found_behind_variables_folders_and_joints_of_the_shell() -> None:
    line = "A=1 .venv/bin/pip install -q . && .venv/bin/opposable run x box | head -n 2"
    assert [words[0] for words in programs(line)] == ["pip", "opposable", "head"]
    assert programs('opposable use x --via "1,2;3|4"; ls') == [
        ["opposable", "use", "x", "--via", "1,2;3|4"],
        ["ls"],
    ]


def test_outputs_are_compared_word_by_word_and_digit_by_digit() -> None:
    assert same("held  at 3.14159 N\n", "held at 3.14 N") is None
    assert same("held at 3.19 N", "held at 3.14 N") is not None
    assert same("lost at 3.14 N", "held at 3.14 N") is not None
    assert same("one\ntwo", "one") is not None


def test_a_wrong_option_or_a_missing_argument_is_noticed() -> None:
    assert parsed(["run", "shadow_hand", "box", "--seed", "3"])["seed"] == "3"
    with pytest.raises(Exception, match="No such option"):
        parsed(["run", "shadow_hand", "box", "--sead", "3"])
    with pytest.raises(AssertionError, match="is missing"):
        parsed(["run", "shadow_hand"])
    with pytest.raises(AssertionError, match="no command 'runn'"):
        parsed(["runn", "shadow_hand"])


def test_an_unknown_program_is_refused() -> None:
    with pytest.raises(PageError, match="neither run"):
        is_run(["rm", "-r"])
