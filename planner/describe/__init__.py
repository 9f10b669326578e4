"""Hand descriptions from a model's structure, and what is to be said of a description."""

from planner.describe.proposal import Proposal, Reason
from planner.describe.propose import propose
from planner.describe.write import description_text, write_description, write_proposal

__all__ = [
    "Proposal",
    "Reason",
    "description_text",
    "propose",
    "write_description",
    "write_proposal",
]
