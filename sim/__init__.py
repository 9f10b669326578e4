"""Opposable's simulation: MuJoCo scenes, controllers, trials, protocols, manipulation, reports.

A script needs little more than this::

    from sim import simulate

    print(simulate(plan).success)

What is public here is loaded when it is first used. The check of models against each other has its
own package, ``sim.crosscheck``.
"""

from typing import TYPE_CHECKING

from planner.showing import register_notebook, register_page
from planner.system.package import lazy_names

if TYPE_CHECKING:
    from sim.contacts import contacts_from_mujoco
    from sim.controllers import Controller, GraspController, ObjectImpedance, Observation
    from sim.foreign import ForeignRun, ForeignScene
    from sim.handover import HandoverTimeline, hand_over
    from sim.manipulation import ManipulationReport, ManipulationTimeline, manipulate
    from sim.palm import PalmReport, PalmSettings, reorient_in_palm
    from sim.protocols import ProtocolReport, run_protocol
    from sim.report import TrialReport
    from sim.scene.build import Scene
    from sim.scene.carrier import Timeline
    from sim.scene.physics import PhysicsOptions
    from sim.sensing.errors import ErrorModel
    from sim.simulation import Simulation
    from sim.tools import FingersTrial, UseTimeline, UseTrial, plan_fingers, plan_tool, use_tool
    from sim.trial import Trial, TrialOptions, simulate

__all__ = [
    "Controller",
    "ErrorModel",
    "FingersTrial",
    "ForeignRun",
    "ForeignScene",
    "GraspController",
    "HandoverTimeline",
    "ManipulationReport",
    "ManipulationTimeline",
    "ObjectImpedance",
    "Observation",
    "PalmReport",
    "PalmSettings",
    "PhysicsOptions",
    "ProtocolReport",
    "Scene",
    "Simulation",
    "Timeline",
    "Trial",
    "TrialOptions",
    "TrialReport",
    "UseTimeline",
    "UseTrial",
    "contacts_from_mujoco",
    "hand_over",
    "manipulate",
    "plan_fingers",
    "plan_tool",
    "reorient_in_palm",
    "run_protocol",
    "simulate",
    "use_tool",
]

_HOMES = {
    "Controller": "sim.controllers",
    "ForeignRun": "sim.foreign",
    "ForeignScene": "sim.foreign",
    "GraspController": "sim.controllers",
    "HandoverTimeline": "sim.handover",
    "ManipulationReport": "sim.manipulation",
    "ManipulationTimeline": "sim.manipulation",
    "ObjectImpedance": "sim.controllers",
    "Observation": "sim.controllers",
    "PhysicsOptions": "sim.scene.physics",
    "PalmReport": "sim.palm",
    "PalmSettings": "sim.palm",
    "ProtocolReport": "sim.protocols",
    "reorient_in_palm": "sim.palm",
    "ErrorModel": "sim.sensing.errors",
    "FingersTrial": "sim.tools",
    "Scene": "sim.scene.build",
    "Simulation": "sim.simulation",
    "Timeline": "sim.scene.carrier",
    "Trial": "sim.trial",
    "TrialOptions": "sim.trial",
    "TrialReport": "sim.report",
    "UseTimeline": "sim.tools",
    "UseTrial": "sim.tools",
    "contacts_from_mujoco": "sim.contacts",
    "hand_over": "sim.handover",
    "manipulate": "sim.manipulation",
    "plan_fingers": "sim.tools",
    "plan_tool": "sim.tools",
    "run_protocol": "sim.protocols",
    "simulate": "sim.trial",
    "use_tool": "sim.tools",
}
"""Public name -> the module that defines it."""

__getattr__, __dir__ = lazy_names(__name__, _HOMES)

register_page(
    "ManipulationReport",
    "sim.manipulation.page:page_of_report",
    "sim.report_file:write_report_of",
)
register_page(
    "TrialReport", "sim.show.trial_page:page_of_report", "sim.report_file:write_report_of"
)
register_page("PalmReport", "sim.palm.report:palm_page", "sim.report_file:write_report_of")
register_page("ManipulationReportFile", "sim.manipulation.page:manipulation_page")
register_page("ReportFile", "sim.show.trial_page:trial_page")
register_notebook("ManipulationReport", "sim.show.notebook:manipulation_html")
register_notebook("TrialReport", "sim.show.notebook:trial_html")
