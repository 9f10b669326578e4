"""``Failure``: why something was not found, as a value: a kind to count, a sentence, numbers.

Whoever cannot give a result returns one; an exception is for what the caller did wrong. Statistics
count kinds, people read the sentence, and nobody parses it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

__all__ = ["Failure"]


@dataclass(frozen=True, kw_only=True)
class Failure:
    """Why there is no result.

    Attributes:
        kind: A short stable name of the cause, ``lower_case``; two failures of one kind have the
            same cause with other numbers.
        text: One sentence for people, with numbers and units.
        numbers: The numbers of the text by name, SI units; read-only.
    """

    kind: str
    text: str
    numbers: Mapping[str, float] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        """Keep a copy of the numbers that nobody changes."""
        object.__setattr__(self, "numbers", MappingProxyType(dict(self.numbers)))

    def __str__(self) -> str:
        """The sentence."""
        return self.text

    def at(self, where: str) -> Failure:
        """The same failure, its text preceded by where it occurred."""
        return replace(self, text=f"{where}: {self.text}")

    def __reduce__(self) -> tuple[Any, ...]:
        """How it is sent to another process: a read-only mapping cannot be pickled."""
        return _failure, (self.kind, self.text, dict(self.numbers))


def _failure(kind: str, text: str, numbers: dict[str, float]) -> Failure:
    return Failure(kind=kind, text=text, numbers=numbers)
