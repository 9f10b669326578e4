"""The one family of errors that Opposable raises for what a user can mend.

Every message says what was given, what is allowed or available, and what to do.
"""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from functools import partial
from reprlib import Repr
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
    "UncertainError",
    "UnreachableError",
]


MOST_NAMED = 4
"""Names that a message gives as examples of many."""

MOST_LISTED = 20
"""More names than this are not listed where one of them is near the one asked for."""

MOST_SHOWN = 60
"""Characters of a value that a message shows."""

MOST_MESSAGE = 10_000
"""Characters of a message: some 120 lines, and a catalogue of hundreds of names."""

MOST_BITS = 4000
"""Bits of an integer that is shown in digits, some 1200 of them."""


def few_of(names: Iterable[str]) -> str:
    """Names for a message: all of a few; of many the first, and how many there are."""
    given = list(names)
    if len(given) <= MOST_NAMED:
        return ", ".join(given) or "none"
    return f"{', '.join(given[:MOST_NAMED])}, ... ({len(given)} in all)"


class _Bounded(Repr):
    """``repr`` that looks at a few items and two levels, whatever there is below.

    Aliases of YAML and references of pickles make values of a kilobyte whose ``repr`` has 10^12
    characters, and ``repr`` of an integer of 4300 digits is an error.
    """

    def __init__(self, most: int) -> None:
        """Show about so many characters."""
        super().__init__()
        self.maxlevel = 2
        self.maxtuple = self.maxlist = self.maxdict = self.maxset = self.maxfrozenset = 8
        self.maxstring = self.maxother = self.maxlong = self.most = most

    def repr1(self, x: Any, level: int) -> str:
        """Bytes, long integers and arrays of objects before ``repr`` sees them."""
        if isinstance(x, int) and x.bit_length() > MOST_BITS:
            return f"an integer of {x.bit_length()} bits"
        if isinstance(x, bytes | bytearray):
            x = x[: self.most]
        if getattr(getattr(x, "dtype", None), "hasobject", False):
            return f"an array of objects of the shape {x.shape}"
        return super().repr1(x, level)


def shown(value: Any, most: int = MOST_SHOWN) -> str:
    """A value as a message shows it: its ``repr`` on one line, of ``most`` characters at most.

    Only the part that is shown is ever written, so that no value makes a message expensive.
    """
    text = " ".join(_Bounded(most).repr(value).split())
    return text if len(text) <= most else f"{text[: most - 3]}..."


class PlannerError(Exception):
    """Root of the family: catch this to catch every error that Opposable means you to see.

    A message is cut in the middle where a name that it repeats makes it longer than 10,000
    characters.
    """

    def __init__(self, message: object = "", *more: object) -> None:
        """Keep the message."""
        text = str(message)
        if len(text) > MOST_MESSAGE:
            half = MOST_MESSAGE // 2
            text = f"{text[:half]} ... {text[-half:]}"
        super().__init__(text, *more)


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
        attempts: Every ``planner.search.grasp.Attempt`` with its reason.
    """

    def __init__(self, message: str, attempts: tuple[Any, ...]) -> None:
        """Keep the message and the attempts."""
        self.attempts = attempts
        super().__init__(message)

    def __reduce__(self) -> tuple[Any, ...]:
        """How it is sent to another process: it is made again of what it was made of."""
        return type(self), (str(self), self.attempts)


class UncertainError(NoGraspFoundError):
    """Too little was seen of an object for any grasp to be promised.

    Attributes:
        attempts: Every ``planner.search.grasp.Attempt`` that was made.
        best: The refused ``planner.search.from_cloud.CloudPlan`` that survives most; None without.
    """

    def __init__(self, message: str, attempts: tuple[Any, ...], best: Any = None) -> None:
        """Keep the message, the attempts and the best plan."""
        self.best = best
        super().__init__(message, attempts)

    def __reduce__(self) -> tuple[Any, ...]:
        """How it is sent to another process: without plans, whose hands hold models of MuJoCo."""
        return type(self), (str(self), tuple(a for a in self.attempts if a.plan is None))


class UnreachableError(NoGraspFoundError):
    """A goal rotation that no sequence of movements reaches.

    Attributes:
        nearest: The nearest rotation (3, 3), world from object, that is reached, or in which the
            object stands where that alone is wrong with the goal; None for none.
        off_deg: How far it is from the goal, degrees; None for none.
    """

    def __init__(self, message: str, nearest: Any = None, off_deg: float | None = None) -> None:
        """Keep the message and the nearest rotation."""
        self.nearest, self.off_deg = nearest, off_deg
        super().__init__(message, ())

    def __reduce__(self) -> tuple[Any, ...]:
        """How it is sent to another process: it is made again of what it was made of."""
        return type(self), (str(self), self.nearest, self.off_deg)


class InfeasibleError(PlannerError):
    """No contact forces exist that do what is asked.

    Attributes:
        wrench: The wrench (6,) [force N; torque N m] that cannot be balanced, where one is known.
    """

    def __init__(self, message: str, wrench: object = None) -> None:
        """Keep the message and the wrench that cannot be resisted."""
        self.wrench = wrench
        super().__init__(message)
