"""The one family of errors that Opposable raises for what a user can mend.

Every message says what was given, what is allowed or available, and what to do.
"""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from functools import partial
from typing import Any

__all__ = [
    "ContactError",
    "FileFormatError",
    "HandError",
    "InfeasibleError",
    "ModelError",
    "NoGraspFoundError",
    "NotFoundError",
    "ObjectError",
    "PlannerError",
    "TaskError",
]


MOST_NAMED = 4
"""Names that a message gives as examples of many."""

MOST_LISTED = 20
"""More names than this are not listed where one of them is near the one asked for."""


def few_of(names: Iterable[str]) -> str:
    """Names for a message: all of a few; of many the first, and how many there are."""
    given = list(names)
    if len(given) <= MOST_NAMED:
        return ", ".join(given) or "none"
    return f"{', '.join(given[:MOST_NAMED])}, ... ({len(given)} in all)"


class PlannerError(Exception):
    """Root of the family: catch this to catch every error that Opposable means you to see."""


class NotFoundError(PlannerError):
    """A name or path that does not exist; of a name, says what there is and the nearest."""

    def __init__(
        self,
        what: str,
        given: str,
        available: Iterable[str],
        hint: str = "",
        *,
        is_path: bool = False,
    ) -> None:
        """Compose the message.

        Args:
            what: Kind of thing looked for, for example "hand".
            given: The name that was asked for.
            available: The names that exist.
            hint: What else the user can do, a sentence; of a path, what follows "does not exist;".
            is_path: Whether a path was asked for: no names are listed then.
        """
        self.what = what
        self.given = given
        self.available = tuple(sorted(available))
        self.hint = hint
        self.is_path = is_path
        if is_path:
            super().__init__(f"{given} does not exist; {hint}")
            return
        near = get_close_matches(given, self.available, n=1)
        meant = f" Did you mean {near[0]!r}?" if near else ""
        listed = f" There is: {', '.join(self.available) if self.available else 'none'}."
        if near and len(self.available) > MOST_LISTED:
            listed = ""
        tail = f" {hint}" if hint else ""
        super().__init__(f"no {what} is called {given!r}.{meant}{listed}{tail}")

    def __reduce__(self) -> tuple[Any, ...]:
        """How it is sent to another process: it is made again of what it was made of."""
        again = partial(type(self), is_path=self.is_path)
        return again, (self.what, self.given, self.available, self.hint)


class ModelError(PlannerError):
    """A model file is missing, cannot be read, or is not a usable model."""


class HandError(PlannerError):
    """A hand description does not fit its model, or the hand cannot do what is asked."""


class ObjectError(PlannerError):
    """An object specification is not usable: size, mass, friction or shape."""


class ContactError(PlannerError):
    """Contacts are not usable: shapes, NaN, normals without direction, negative friction."""


class TaskError(PlannerError):
    """A grasp task contradicts itself or asks for what cannot be."""


class FileFormatError(PlannerError):
    """A plan or report file is damaged, of another version, or for another hand."""


class NoGraspFoundError(PlannerError):
    """The budget of a search ended without a grasp.

    Attributes:
        attempts: Every ``planner.search.Attempt`` with its reason.
    """

    def __init__(self, message: str, attempts: tuple[Any, ...]) -> None:
        """Keep the message and the attempts."""
        self.attempts = attempts
        super().__init__(message)

    def __reduce__(self) -> tuple[Any, ...]:
        """How it is sent to another process: it is made again of what it was made of."""
        return type(self), (str(self), self.attempts)


class InfeasibleError(PlannerError):
    """No contact forces exist that do what is asked.

    Attributes:
        wrench: The wrench (6,) [force N; torque N m] that cannot be balanced, where one is known.
    """

    def __init__(self, message: str, wrench: object = None) -> None:
        """Keep the message and the wrench that cannot be resisted."""
        self.wrench = wrench
        super().__init__(message)
