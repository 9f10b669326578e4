"""Hand descriptions proposed from a model's structure, and checks of descriptions."""

from __future__ import annotations

from typing import TYPE_CHECKING

from planner.system.lazy_names import lazy_names

if TYPE_CHECKING:
    from planner.describe.cached import proposed_description
    from planner.describe.check import check_hand
    from planner.describe.propose import propose
    from planner.describe.reasons import Proposal, Reason
    from planner.describe.report import CheckReport, Finding
    from planner.describe.write import description_text, write_description, write_proposal

__all__ = [
    "CheckReport",
    "Finding",
    "Proposal",
    "Reason",
    "check_hand",
    "description_text",
    "propose",
    "proposed_description",
    "write_description",
    "write_proposal",
]

_HOMES = {
    "CheckReport": "planner.describe.report",
    "Finding": "planner.describe.report",
    "Proposal": "planner.describe.reasons",
    "Reason": "planner.describe.reasons",
    "check_hand": "planner.describe.check",
    "description_text": "planner.describe.write",
    "propose": "planner.describe.propose",
    "proposed_description": "planner.describe.cached",
    "write_description": "planner.describe.write",
    "write_proposal": "planner.describe.write",
}
"""Public name -> the module that defines it, which is loaded when the name is asked for."""

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
