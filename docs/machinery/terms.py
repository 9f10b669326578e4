"""What a violated term means, out of the terms: ``terms`` in a page is the table of all of them."""

from __future__ import annotations

from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from machinery.commands import shown
from planner.motion.terms import MOTION_TERMS
from planner.synthesis.terms.registry import TERMS
from planner.synthesis.terms.term import Term

OF_MOTIONS = {
    "rolling": "tips would have to slide from knot to knot; a smaller angle, an object that is "
    "rounder about the axis",
    "path": "the object would have to leave its path by more than the tolerance; a smaller angle "
    "or shift",
    "load": "an actuator would have to press harder than it can; less mass or grip",
    "bearing": "under the weight tips would slip; more friction, less mass, more fingers",
    "strong": "the weight would take more than 9 N of a finger; another attitude, less mass, more "
    "friction or fingers",
    "reach": "the whole path is out of reach of these contacts; a smaller angle, or regrasps",
}
"""Terms that only motions have -> what it means if nothing satisfies them."""


def meaning(term: Term) -> str:
    """What it means that nothing satisfies a term; costs rank grasps and are never why."""
    if term.role.is_cost:
        return "a cost: never the reason"
    return term.lacking or OF_MOTIONS[term.name]


def rows(terms: list[Term]) -> list[str]:
    """A table of terms in Markdown."""
    lines = ["| term | residual | nothing satisfies it: that is |", "| --- | --- | --- |"]
    lines += [f"| `{t.name}` | {shown(t.meaning)} | {meaning(t)} |" for t in terms]
    return lines


def table() -> str:
    """The terms of a grasp, and below them those that a motion has besides."""
    more = [term for term in MOTION_TERMS if term.name not in TERMS]
    return "\n".join(
        [
            *rows(list(TERMS.values())),
            "",
            "Motions have these at every knot, and more:",
            "",
            *rows(more),
        ]
    )


class Terms(SphinxDirective):
    """``terms``: the table."""

    def run(self) -> list[nodes.Node]:
        """Write it in Markdown and parse that."""
        return self.parse_text_to_nodes(table())


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive."""
    app.add_directive("terms", Terms)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
