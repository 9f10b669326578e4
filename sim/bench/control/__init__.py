"""``bench control``: what grasps bear in either loop, how they drift, and slips that are noticed.

One part for one grasp is one job (``jobs``); ``parts`` and ``push`` run the protocols, ``promise``
tests certificates, ``slip_trial`` makes slips that are known, ``tables`` counts.
"""

from __future__ import annotations

from sim.bench.control.jobs import PARTS, grasps_of, run_control
from sim.bench.control.tables import control_tables

__all__ = ["PARTS", "control_tables", "grasps_of", "run_control"]
