"""Fixtures that several test modules share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from planner.catalog import models_dir
from planner.hand import Hand

RIGHT_HANDS = ("allegro_hand", "shadow_hand")


@pytest.fixture(scope="session")
def allegro() -> Hand:
    return Hand.load("allegro_hand")


@pytest.fixture(scope="session")
def shadow() -> Hand:
    return Hand.load("shadow_hand")


@pytest.fixture(scope="session", params=RIGHT_HANDS)
def right_hand(request: pytest.FixtureRequest) -> Hand:
    hand = request.getfixturevalue(
        {"allegro_hand": "allegro", "shadow_hand": "shadow"}[request.param]
    )
    assert isinstance(hand, Hand)
    return hand


@pytest.fixture
def edit_hand(tmp_path: Path) -> Callable[..., Path]:
    """A copy of the Allegro's two files with pieces of text replaced; gives the hand.toml."""
    source = models_dir() / "hands" / "allegro_hand"

    def edit(toml: Mapping[str, str] | None = None, xml: Mapping[str, str] | None = None) -> Path:
        for name, changes in (("hand.toml", toml or {}), ("allegro_hand.xml", xml or {})):
            text = (source / name).read_text(encoding="utf-8")
            for old, new in changes.items():
                assert old in text, f"{old!r} is not in {name}: the test edits nothing"
                text = text.replace(old, new)
            (tmp_path / name).write_text(text, encoding="utf-8")
        return tmp_path / "hand.toml"

    return edit
