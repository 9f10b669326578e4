"""What a proposal is: a description, why each guess was made, and what a person should look at."""

from __future__ import annotations

from dataclasses import dataclass

from planner.description import HandDescription

__all__ = ["Proposal", "Reason"]


@dataclass(frozen=True, kw_only=True)
class Reason:
    """Why a line of a description says what it says.

    Attributes:
        key: The line: "palm_body", "fingers.index.pad", "postures.pinch".
        value: What was chosen, in words.
        why: What in the model led to it, and what would change it.
    """

    key: str
    value: str
    why: str


@dataclass(frozen=True, kw_only=True)
class Proposal:
    """A hand description proposed from the structure of a model.

    Attributes:
        description: The description; valid, and complete as far as the model tells.
        reasons: One for every guess, in the order of the description.
        open_questions: What the structure does not tell or contradicts, each with what to do.
    """

    description: HandDescription
    reasons: tuple[Reason, ...]
    open_questions: tuple[str, ...]
