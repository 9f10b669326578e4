"""All terms by name: the standard ones, which every problem has, and those of users.

A term of your own is one ``Term`` and one call of ``register_term``. A problem has it if
``SynthesisOptions(terms=("name",))`` names it: options are plain data, which go into files of jobs,
to other processes, and into the key of a built problem.
"""

from __future__ import annotations

from planner.errors import NotFoundError, TaskError, shown
from planner.synthesis.objectives import OBJECTIVES
from planner.synthesis.terms.clearance import OBJECT, OBSTACLE, TABLE
from planner.synthesis.terms.effort import EFFORT
from planner.synthesis.terms.fingers import FINGERS
from planner.synthesis.terms.link_distance import LINKS
from planner.synthesis.terms.resistance import RESISTANCE
from planner.synthesis.terms.standard import (
    ALONG,
    ARM,
    BALANCE,
    CENTER,
    CONE,
    COUPLING,
    EDGE,
    FACING,
    FORCES,
    LEVEL,
    POSTURE,
    PRESS,
    STOP,
    SURFACE,
    TOUCH,
)
from planner.synthesis.terms.term import Role, Term

_STANDARD: tuple[Term, ...] = (
    TOUCH,
    SURFACE,
    BALANCE,
    LEVEL,
    COUPLING,
    ARM,
    FACING,
    ALONG,
    CONE,
    PRESS,
    STOP,
    EFFORT,
    OBJECT,
    TABLE,
    OBSTACLE,
    FINGERS,
    LINKS,
    FORCES,
    POSTURE,
    CENTER,
    EDGE,
    RESISTANCE,
)

TERMS: dict[str, Term] = {term.name: term for term in _STANDARD}
"""All terms by name."""

STANDARD: tuple[str, ...] = tuple(TERMS)
"""Names of the terms that every problem has, in the order of their rows within a role."""


def register_term(term: Term) -> Term:
    """Register a term under its name.

    Raises:
        TaskError: The name is taken or no identifier, there are no rows, or the weight is not > 0.
    """
    if term.name in TERMS or term.name in OBJECTIVES:
        raise TaskError(f"the name {term.name!r} is taken; give the term another one")
    if not term.name.isidentifier():
        raise TaskError(f"the name of the term is {term.name!r}; give one word of letters")
    if (term.write is None) == (term.clearance is None):
        raise TaskError(
            f"term {term.name!r} has no rows, or two kinds of them; give it write=, a function of "
            "GraspSymbols, or clearance="
        )
    if term.clearance is not None and term.role is not Role.INEQUALITY:
        raise TaskError(
            f"term {term.name!r} has clearances and the role {term.role.name}; give it "
            "role=Role.INEQUALITY"
        )
    if term.clearance is not None and term.margin != 0:
        raise TaskError(
            f"term {term.name!r} has clearances and the margin {term.margin}; put it into what its "
            "least= takes off"
        )
    if not (term.weight > 0 and term.margin >= 0):
        raise TaskError(
            f"term {term.name!r} has weight {term.weight} and margin {term.margin}; "
            "give a weight > 0 and a margin >= 0"
        )
    TERMS[term.name] = term
    return term


def checked_terms(names: object) -> tuple[str, ...]:
    """Names of terms beside the standard ones, after a check.

    Raises:
        TaskError: Not a sequence of names, a name twice, or that of a standard term.
        NotFoundError: A term that is not registered.
    """
    if isinstance(names, str) or not isinstance(names, list | tuple):
        raise TaskError(
            f"terms are {shown(names)}; give a tuple of names, for example ('my_term',)"
        )
    for name in names:
        if name not in TERMS:
            hint = "Register it with planner.synthesis.register_term, in every process."
            raise NotFoundError("term", str(name), [n for n in TERMS if n not in STANDARD], hint)
        if name in STANDARD:
            raise TaskError(f"every problem has the term {shown(name)}; leave it out of terms")
    if len(set(names)) < len(names):
        raise TaskError(f"terms {shown(names)} name one twice; give each name once")
    return tuple(names)
