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
    from sim.carrier import Timeline
    from sim.contacts import contacts_from_mujoco
    from sim.controllers import Controller, GraspController, ObjectImpedance, Observation
    from sim.manipulation import ManipulationReport, ManipulationTimeline, manipulate
    from sim.physics import PhysicsOptions
    from sim.protocols import ProtocolReport, run_protocol
    from sim.reality import Reality
    from sim.report import TrialReport
    from sim.scene import Scene
    from sim.simulation import Simulation
    from sim.trial import Trial, TrialOptions, simulate

__all__ = [
    "Controller",
    "GraspController",
    "ManipulationReport",
    "ManipulationTimeline",
    "ObjectImpedance",
    "Observation",
    "PhysicsOptions",
    "ProtocolReport",
    "Reality",
    "Scene",
    "Simulation",
    "Timeline",
    "Trial",
    "TrialOptions",
    "TrialReport",
    "contacts_from_mujoco",
    "manipulate",
    "run_protocol",
    "simulate",
]

_HOMES = {
    "Controller": "sim.controllers",
    "GraspController": "sim.controllers",
    "ManipulationReport": "sim.manipulation",
    "ManipulationTimeline": "sim.manipulation",
    "ObjectImpedance": "sim.controllers",
    "Observation": "sim.controllers",
    "PhysicsOptions": "sim.physics",
    "ProtocolReport": "sim.protocols",
    "Reality": "sim.reality",
    "Scene": "sim.scene",
    "Simulation": "sim.simulation",
    "Timeline": "sim.carrier",
    "Trial": "sim.trial",
    "TrialOptions": "sim.trial",
    "TrialReport": "sim.report",
    "contacts_from_mujoco": "sim.contacts",
    "manipulate": "sim.manipulation",
    "run_protocol": "sim.protocols",
    "simulate": "sim.trial",
}
"""Public name -> the module that defines it."""

__getattr__, __dir__ = lazy_names(__name__, _HOMES)

register_page(
    "ManipulationReport",
    "sim.manipulation.page:page_of_report",
    "sim.report_file:write_report_of",
)
register_page("TrialReport", "sim.pages:page_of_report", "sim.report_file:write_report_of")
register_page("ManipulationReportFile", "sim.manipulation.page:manipulation_page")
register_page("ReportFile", "sim.pages:trial_page")
register_notebook("ManipulationReport", "sim.looking.notebook:manipulation_html")
register_notebook("TrialReport", "sim.looking.notebook:trial_html")
