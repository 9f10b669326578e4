"""The README's script runs, and prints what the README says it prints."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

README = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")
NUMBER = re.compile(r"-?\d+\.?\d*")


@pytest.mark.slow
def test_script_prints_what_the_readme_says() -> None:
    script = README.split("```python\n")[1].split("```")[0]
    said = README.split("```text\n")[1].split("```")[0].splitlines()
    # kernels of another processor round otherwise, and the same seed may find another grasp
    kernels = re.search(r"`(OPENBLAS_CORETYPE)=(\w+)`", README)
    assert kernels is not None
    run = subprocess.run(
        [sys.executable, "-c", script],
        env=os.environ | {kernels[1]: kernels[2]},
        capture_output=True,
        text=True,
        check=True,
    )
    lines = run.stdout.splitlines()
    assert len(lines) == len(said)
    for line, expected in zip(lines, said, strict=True):
        # words to the letter; numbers to their last digits
        assert NUMBER.sub("#", line).split() == NUMBER.sub("#", expected).split()
        for value, told in zip(NUMBER.findall(line), NUMBER.findall(expected), strict=True):
            last_digit = 10.0 ** -len(told.partition(".")[2])
            assert float(value) == pytest.approx(float(told), abs=2.1 * last_digit)


def test_pictures_are_there() -> None:
    pictures = re.findall(r"!\[[^]]*\]\(([^)]*)\)", README)
    assert pictures
    for picture in pictures:
        assert (Path(__file__).parent.parent / picture).is_file()


def test_every_hand_is_named_in_the_readme() -> None:
    from planner.hands.catalog import hand_names

    for name in hand_names():
        assert f"`{name}`" in README


def test_the_command_table_names_every_command() -> None:
    from sim.cli.listing import GROUPS, RENAMED

    for group in GROUPS.values():
        for listed in group:
            old = [name for name, new in RENAMED.items() if " ".join(new.begin) == listed.name]
            assert any(f"opposable {name}" in README for name in (listed.name, *old)), listed.name
