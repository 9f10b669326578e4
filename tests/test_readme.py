"""The README names what there is; its script is run with those of the pages (test_docs.py)."""

from __future__ import annotations

import re
from pathlib import Path

README = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")


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
