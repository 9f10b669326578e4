"""``bench control``: loads that grasps hold under either controller, drift, slip detection.

A job is one part for one grasp (``jobs``); ``parts`` and ``push`` run the protocols, ``promise``
tests certificates, ``slip_trial`` makes known slips, ``tables`` counts.
"""

from __future__ import annotations

from benchmarks.control.jobs import PARTS, grasps_of, run_control
from benchmarks.control.tables import control_tables

__all__ = ["PARTS", "control_tables", "grasps_of", "run_control"]
