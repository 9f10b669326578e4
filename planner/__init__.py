"""Opposable's planner: hands, objects, contacts, grasp quality, contact forces, grasp synthesis.

A script needs little more than this::

    from planner import GraspTask, plan_grasp

    plan = plan_grasp(GraspTask.create("shadow_hand", "box"), seed=0)

What is public here is loaded when it is first used: contacts, quality and forces work without
loading MuJoCo, Pinocchio, coal or CasADi.
"""

from typing import TYPE_CHECKING

from planner.showing import register_notebook, register_page
from planner.system.package import __version__, lazy_names

if TYPE_CHECKING:
    from planner.batch import GraspSet, plan_grasps, plan_several, refine_grasps
    from planner.clouds import PointCloud
    from planner.contacts import Contact, ContactSet
    from planner.errors import NoGraspFoundError, PlannerError
    from planner.files import read_plan, write_plan
    from planner.forces import distribute_forces
    from planner.hand_loading import hand_from_model, hand_from_spec, load_hand
    from planner.hands.hand import Hand
    from planner.kinematics import HandState
    from planner.motion import (
        GaitPlan,
        ManipulationPlan,
        MotionPlan,
        MovementPlan,
        manipulation_task,
        plan_gait,
        plan_handover,
        plan_manipulation,
        plan_motion,
        plan_reorientation,
    )
    from planner.numerics.kernels import compiled_searches
    from planner.objects import GraspObject, NeededWrench, parse_object
    from planner.plan import GraspPlan
    from planner.quality import analyse, force_closure
    from planner.search.from_cloud import CloudPlan, plan_from_cloud
    from planner.search.grasp import attempts, plan_grasp, plans
    from planner.search.refine import refine_grasp
    from planner.spatial import SE3
    from planner.synthesis.symbols import SymbolicHand
    from planner.task import GraspTask, Obstacle
    from planner.tools import Tool, load_tool, plan_use, use_task

__all__ = [
    "SE3",
    "CloudPlan",
    "Contact",
    "ContactSet",
    "GaitPlan",
    "GraspObject",
    "GraspPlan",
    "GraspSet",
    "GraspTask",
    "Hand",
    "HandState",
    "ManipulationPlan",
    "MotionPlan",
    "MovementPlan",
    "NeededWrench",
    "NoGraspFoundError",
    "Obstacle",
    "PlannerError",
    "PointCloud",
    "SymbolicHand",
    "Tool",
    "__version__",
    "analyse",
    "attempts",
    "compiled_searches",
    "distribute_forces",
    "force_closure",
    "hand_from_model",
    "hand_from_spec",
    "load_hand",
    "load_tool",
    "manipulation_task",
    "parse_object",
    "plan_from_cloud",
    "plan_gait",
    "plan_grasp",
    "plan_grasps",
    "plan_handover",
    "plan_manipulation",
    "plan_motion",
    "plan_reorientation",
    "plan_several",
    "plan_use",
    "plans",
    "read_plan",
    "refine_grasp",
    "refine_grasps",
    "use_task",
    "write_plan",
]

_HOMES = {
    "CloudPlan": "planner.search.from_cloud",
    "Contact": "planner.contacts",
    "ContactSet": "planner.contacts",
    "GaitPlan": "planner.motion",
    "GraspObject": "planner.objects",
    "GraspPlan": "planner.plan",
    "GraspSet": "planner.batch",
    "GraspTask": "planner.task",
    "Hand": "planner.hands.hand",
    "hand_from_model": "planner.hand_loading",
    "hand_from_spec": "planner.hand_loading",
    "load_hand": "planner.hand_loading",
    "HandState": "planner.kinematics",
    "ManipulationPlan": "planner.motion",
    "MotionPlan": "planner.motion",
    "MovementPlan": "planner.motion",
    "NeededWrench": "planner.objects",
    "NoGraspFoundError": "planner.errors",
    "Obstacle": "planner.task",
    "PlannerError": "planner.errors",
    "PointCloud": "planner.clouds",
    "SE3": "planner.spatial",
    "SymbolicHand": "planner.synthesis.symbols",
    "Tool": "planner.tools",
    "analyse": "planner.quality",
    "attempts": "planner.search.grasp",
    "compiled_searches": "planner.numerics.kernels",
    "distribute_forces": "planner.forces",
    "force_closure": "planner.quality",
    "load_tool": "planner.tools",
    "manipulation_task": "planner.motion",
    "parse_object": "planner.objects",
    "plan_from_cloud": "planner.search.from_cloud",
    "plan_gait": "planner.motion",
    "plan_grasp": "planner.search.grasp",
    "plan_grasps": "planner.batch",
    "plan_handover": "planner.motion",
    "plan_manipulation": "planner.motion",
    "plan_motion": "planner.motion",
    "plan_reorientation": "planner.motion",
    "plan_several": "planner.batch",
    "plan_use": "planner.tools",
    "plans": "planner.search.grasp",
    "read_plan": "planner.files",
    "refine_grasp": "planner.search.refine",
    "refine_grasps": "planner.batch",
    "use_task": "planner.tools",
    "write_plan": "planner.files",
}
"""Public name -> the module that defines it."""

__getattr__, __dir__ = lazy_names(__name__, _HOMES)

register_page("GraspPlan", "planner.pages.plan_page:plan_page", "planner.files.plans:write_plan")
for _kind in ("MovementPlan", "ManipulationPlan"):
    register_page(
        _kind, "planner.pages.motion_page:motion_page", "planner.files.movements:write_movement"
    )
    register_notebook(_kind, "planner.pages.notebook:motion_html")
register_notebook("ContactSet", "planner.pages.notebook:contacts_html")
register_notebook("GraspPlan", "planner.pages.notebook:plan_html")
register_notebook("GraspSet", "planner.pages.notebook:dataset_html")
register_notebook("Hand", "planner.pages.notebook:hand_html")
