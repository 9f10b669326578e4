"""Why Pinocchio's own reader differs: known causes, each seen in the file AND in the numbers.

``causes.toml`` lists the known mistakes of one version of that reader. A cause is named only if the
file has the feature at the very part that differs and the reader's value is the one that this
mistake produces. Anything else stays without a cause ("cause unknown").
"""

from __future__ import annotations

import tomllib
from dataclasses import replace
from functools import cache
from importlib.resources import files
from typing import Any

from sim.crosscheck.cause_context import Context
from sim.crosscheck.evidence import EVIDENCE
from sim.crosscheck.evidence_masses import EVIDENCE_OF_MASSES
from sim.crosscheck.mjcf_text import MjcfText
from sim.crosscheck.quantities import Difference
from sim.crosscheck.reader import is_urdf
from sim.crosscheck.report import Column
from sim.crosscheck.sources import Source


@cache
def _known() -> tuple[dict[str, Any], ...]:
    """The table of causes."""
    text = files("sim.crosscheck").joinpath("causes.toml").read_text(encoding="utf-8")
    return tuple(tomllib.loads(text)["cause"])


def explain(column: Column, context: Context) -> Column:
    """The column with a cause at each fault where one is known.

    Poses, forces and accelerations differ as a consequence of these faults, and get no cause.
    """
    faults = set(column.faults)
    explained = (_explain(d, context) if d in faults else d for d in column.differences)
    return replace(column, differences=tuple(explained))


def _explain(difference: Difference, context: Context) -> Difference:
    seen_by = {**EVIDENCE, **EVIDENCE_OF_MASSES}
    for cause in _known():
        if difference.quantity in cause["quantities"]:
            seen = seen_by[cause["evidence"]](difference, context)
            if seen:
                reasons = (cause["reason"][name].format(**f) for name, f in seen.items())
                return replace(difference, cause=cause["key"], reason="; ".join(reasons))
    return difference


def explain_failure(source: Source, failure: str) -> str:
    """Why the reader gave no model, with the cause where it is known."""
    cause = "cause unknown"
    if source.path is not None and not is_urdf(source.path):
        text = MjcfText(source.path)
        world = text.root.find("worldbody")
        if "No such node (body)" in failure and world is not None:
            if world.find("body") is None and world.find("frame") is not None:
                cause = "a <frame> right below <worldbody> is not read"
            elif world.find("body") is None and text.includes:
                cause = "<include> is not followed, and the bodies stand in another file"
        elif text.includes:
            cause = "<include> is not followed: what it brings is missing here"
    return f"{failure} ({cause})"
