"""The one door to MuJoCo in ``planner``: compiled models become Pinocchio and coal models here."""

from planner.bridge.actuation import actuation_from_mujoco
from planner.bridge.geometry import LinkGeometry, hand_geometries
from planner.bridge.load import compile_spec, load_spec
from planner.bridge.mirror import mirror_spec
from planner.bridge.pinocchio_model import pinocchio_from_mujoco

__all__ = [
    "LinkGeometry",
    "actuation_from_mujoco",
    "compile_spec",
    "hand_geometries",
    "load_spec",
    "mirror_spec",
    "pinocchio_from_mujoco",
]
