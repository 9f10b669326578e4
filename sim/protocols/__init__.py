"""Protocols: named tests of a plan in simulation, each of many trials.

``dexgraspbench``  DexGraspBench's test, so that figures can be compared with its users'
``forces``         gravity from six sides, then forces and torques that grow until it is lost
``shake``          the gantry shaken in six degrees of freedom
``robust``         another mass, friction and object pose than planned
``errors``        sensors, drives and object off, drawn anew (``sim.sensing.errors``)
``pushes``         held for a minute under random pushes
``drake``          the exported scene held and pushed in another engine, if that is installed

``run_protocol(plan, "forces")`` runs one; ``opposable test PLAN --protocol forces`` does on the
command line.
"""

from __future__ import annotations

from sim.protocols.disturbance import Settings
from sim.protocols.drake import hold_in_drake
from sim.protocols.outcome import Outcome
from sim.protocols.report import ProtocolReport, protocol_table, write_csv
from sim.protocols.run import PROTOCOLS, Protocol, in_all, run_protocol, trials_of, unsuitable

__all__ = [
    "PROTOCOLS",
    "Outcome",
    "Protocol",
    "ProtocolReport",
    "Settings",
    "hold_in_drake",
    "in_all",
    "protocol_table",
    "run_protocol",
    "trials_of",
    "unsuitable",
    "write_csv",
]
