"""MuJoCo without its log, a file MUJOCO_LOG.TXT in the current folder that each warning goes to.

What matters of a warning is read elsewhere: numbers that diverge from ``data.warning``, what a
model lost from the model. The texts go to the logger ``planner.bridge`` at level DEBUG.

MuJoCo has one handler of warnings per process. Importing this module sets it; a handler that a user
sets later, or ``mujoco.set_mju_user_warning(None)`` for MuJoCo's own, stays.
"""

from __future__ import annotations

import logging

import mujoco

_logger = logging.getLogger("planner.bridge")

mujoco.set_mju_user_warning(lambda message: _logger.debug("MuJoCo: %s", message))
