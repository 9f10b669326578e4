"""Why Pinocchio's own reader differs: known causes, each seen in the file AND in the numbers.

A cause is named only if the file has the feature at the very part that differs and the reader's
value is the one that this mistake produces. Anything else stays without a cause ("cause unknown").
The mistakes were measured with Pinocchio 4.1.0, each on a file that has nothing else.
"""

from __future__ import annotations

from dataclasses import replace

from sim.crosscheck.cause_context import Context
from sim.crosscheck.causes_masses import MASSES
from sim.crosscheck.causes_structure import STRUCTURE
from sim.crosscheck.causes_values import VALUES
from sim.crosscheck.quantities import Difference
from sim.crosscheck.report import Column

__all__ = ["explain"]


def explain(column: Column, context: Context) -> Column:
    """The column with a cause at each fault where one is known.

    Poses, forces and accelerations differ as a consequence of these faults, and get no cause.
    """
    faults = set(column.faults)
    explained = (_explain(d, context) if d in faults else d for d in column.differences)
    return replace(column, differences=tuple(explained))


def _explain(difference: Difference, context: Context) -> Difference:
    for key, quantities, check in (*STRUCTURE, *VALUES, *MASSES):
        if difference.quantity in quantities:
            reason = check(difference, context)
            if reason:
                return replace(difference, cause=key, reason=reason)
    return difference
