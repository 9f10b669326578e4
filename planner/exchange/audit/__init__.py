"""What our verdict says of grasps that somebody else made, stage by stage.

``audit_grasps`` judges grasps that a reader of ``planner.exchange`` gives, ``audit_plans`` plans of
ours, both by ``planner.verification`` and with its tolerances, so that both stand in one table.
``audit_file`` reads and judges, and says where a file was read in another unit, order or hand.
"""

from planner.exchange.audit.grasp_file import (
    GraspFile,
    batch_as_imported,
    plans_as_imported,
    right_task,
)
from planner.exchange.audit.judge import scaled_object
from planner.exchange.audit.report import STAGES, AuditReport, AuditRow, StageResult, joined_reports
from planner.exchange.audit.run import audit_file, audit_grasps, audit_plans

__all__ = [
    "STAGES",
    "AuditReport",
    "AuditRow",
    "GraspFile",
    "StageResult",
    "audit_file",
    "audit_grasps",
    "audit_plans",
    "batch_as_imported",
    "joined_reports",
    "plans_as_imported",
    "right_task",
    "scaled_object",
]
