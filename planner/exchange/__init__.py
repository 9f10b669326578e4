"""Readers and writers of other tools' files, one module or folder per tool."""

from planner.exchange.export import Export, export_plans, plans_of
from planner.exchange.formats import (
    GivenGrasp,
    GivenGrasps,
    GraspFormat,
    Reading,
    Writing,
    register_format,
)

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
