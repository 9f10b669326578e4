"""What our verdict says of grasps that somebody else made, stage by stage.

``audit_grasps`` judges grasps that a reader of ``planner.exchange`` gives, ``audit_plans`` plans of
ours, both by ``planner.verification`` and with its tolerances, so that both stand in one table.
``audit_file`` reads and judges, and says where a file was read in another unit, order or hand.
"""

from planner.audit.grasp_file import GraspFile
from planner.audit.readings import right_task
from planner.audit.report import AuditReport, joined_reports
from planner.audit.rows import STAGES, AuditRow, StageResult
from planner.audit.run import audit_file, audit_grasps, audit_plans
from planner.audit.scaled import scaled_object
from planner.audit.sources import given_of_batch, given_of_plans

__all__ = [
    "STAGES",
    "AuditReport",
    "AuditRow",
    "GraspFile",
    "StageResult",
    "audit_file",
    "audit_grasps",
    "audit_plans",
    "given_of_batch",
    "given_of_plans",
    "joined_reports",
    "right_task",
    "scaled_object",
]
