"""A proposal: a description, a reason for each guess, and open questions for a person."""

from __future__ import annotations

from dataclasses import dataclass, field

from planner.description import HandDescription


@dataclass(frozen=True, kw_only=True)
class Reason:
    """The reason for a line of a description.

    Attributes:
        key: The line: "palm_body", "fingers.index.pad", "postures.pinch".
        value: The choice, in words.
        why: The evidence in the model, and evidence that would change it.
    """

    key: str
    value: str
    why: str


@dataclass(frozen=True, kw_only=True)
class Proposal:
    """A hand description proposed from the structure of a model.

    Attributes:
        description: The description; valid, and as complete as the model allows.
        reasons: One for every guess, in the order of the description.
        open_questions: What the structure leaves open or contradicts, each with a remedy.
    """

    description: HandDescription
    reasons: tuple[Reason, ...]
    open_questions: tuple[str, ...]


@dataclass(frozen=True)
class Notes:
    """Notes taken while a proposal is made.

    Attributes:
        reasons: One per line of the description.
        questions: Open questions.
    """

    reasons: list[Reason] = field(default_factory=list)
    questions: list[str] = field(default_factory=list)

    def because(self, key: str, value: str, why: str) -> None:
        """Note a reason."""
        self.reasons.append(Reason(key=key, value=value, why=why))

    def ask(self, question: str) -> None:
        """Note an open question."""
        self.questions.append(question)
