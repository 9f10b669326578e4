"""Hand descriptions proposed from a model's structure, and checks of descriptions."""

from planner.describe.check import check_hand
from planner.describe.proposal import (
    CheckReport,
    Finding,
    Proposal,
    Reason,
    description_text,
    write_description,
    write_proposal,
)
from planner.describe.propose import propose, proposed_description

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
