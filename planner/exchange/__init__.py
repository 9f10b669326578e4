"""Files of other tools: read and written, a module or folder for each; ``audit`` judges grasps."""

from planner.exchange.export import Export, export_plans, plans_of
from planner.exchange.formats import (
    GraspFormat,
    ImportedGrasp,
    ImportedGrasps,
    Reading,
    Writing,
    register_format,
)

__all__ = [
    "Export",
    "GraspFormat",
    "ImportedGrasp",
    "ImportedGrasps",
    "Reading",
    "Writing",
    "export_plans",
    "plans_of",
    "register_format",
]
