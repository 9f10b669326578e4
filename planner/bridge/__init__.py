"""The one door to MuJoCo in ``planner``: compiled models become Pinocchio and coal models here.

MuJoCo's warnings go to the logger ``planner.bridge`` at level DEBUG, not to a file MUJOCO_LOG.TXT
in the current folder: numbers that diverge are read from ``data.warning``. MuJoCo has one handler
of warnings per process. A handler that a user sets after this import, or
``mujoco.set_mju_user_warning(None)`` for MuJoCo's own, stays.
"""

import logging
from typing import TYPE_CHECKING

import mujoco

from planner.bridge.actuation import actuation_from_mujoco
from planner.bridge.geometry import LinkGeometry, LinkSurface, hand_geometries, link_surfaces
from planner.bridge.load import compile_spec, load_spec
from planner.bridge.pinocchio_model import couplings_from_mujoco, pinocchio_from_mujoco
from planner.bridge.prepare import add_described_parts, isolate_base, name_parts, prepare_spec
from planner.system.package import lazy_names

if TYPE_CHECKING:
    from planner.bridge.edit import mirror_spec, motorise_spec
    from planner.bridge.structure import spec_from_model

__all__ = [
    "LinkGeometry",
    "LinkSurface",
    "actuation_from_mujoco",
    "add_described_parts",
    "compile_spec",
    "couplings_from_mujoco",
    "hand_geometries",
    "isolate_base",
    "link_surfaces",
    "load_spec",
    "mirror_spec",
    "motorise_spec",
    "name_parts",
    "pinocchio_from_mujoco",
    "prepare_spec",
    "spec_from_model",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "mirror_spec": "planner.bridge.edit",
        "motorise_spec": "planner.bridge.edit",
        "spec_from_model": "planner.bridge.structure",
    },
)

_logger = logging.getLogger("planner.bridge")

mujoco.set_mju_user_warning(lambda message: _logger.debug("MuJoCo: %s", message))
