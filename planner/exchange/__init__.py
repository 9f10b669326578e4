"""Readers and writers of other tools' files, one module or folder per tool."""

from planner.exchange.export import Export, export_plans
from planner.exchange.formats import GraspFormat, Reading, Writing, register_format
from planner.exchange.given import GivenGrasp, GivenGrasps
from planner.exchange.sources import plans_of

__all__ = [
    "Export",
    "GivenGrasp",
    "GivenGrasps",
    "GraspFormat",
    "Reading",
    "Writing",
    "export_plans",
    "plans_of",
    "register_format",
]
