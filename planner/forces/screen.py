"""Forces and torques as tables for a terminal: what ``print`` shows of answers and of loops."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planner.spatial import FloatArray

MOST_LINES = 14
"""Lines of a table; the rest are counted."""

CARRIES = 1e-9
"""Force of a stop (N, N m) from which on it is named."""


def at_most(lines: Sequence[str], most: int = MOST_LINES) -> list[str]:
    """The first lines, and how many others there are."""
    if len(lines) <= most:
        return list(lines)
    return [*lines[: most - 1], f"  ... and {len(lines) - most + 1} more"]


def wrench_text(wrench: FloatArray) -> str:
    """A wrench (6,) with units."""
    force, torque = (", ".join(f"{v:.3g}" for v in w + 0.0) for w in (wrench[:3], wrench[3:]))
    return f"force ({force}) N, torque ({torque}) N m"


def force_table(
    names: Sequence[str], forces: FloatArray, used: FloatArray | None = None
) -> list[str]:
    """One line per contact.

    Args:
        names: n names.
        forces: (n, 4), f_n, f_t1, f_t2 (N) and tau_n (N m).
        used: (n,), share of the friction cone in use (-), where it is known.
    """
    width = max(len(name) for name in ("contact", *names)) + 2
    head = (
        f"  {'contact':{width}}{'f_n (N)':>9}{'f_t1 (N)':>10}{'f_t2 (N)':>10}{'tau_n (mN m)':>14}"
    )
    rows = [
        f"  {name:{width}}{f[0]:9.3f}{f[1]:10.3f}{f[2]:10.3f}{1e3 * f[3]:14.2f}"
        for name, f in zip(names, forces, strict=True)
    ]
    if used is not None:
        head += f"{'friction used':>16}"
        rows = [f"{row}{100 * share:14.0f} %" for row, share in zip(rows, used, strict=True)]
    return [head, *at_most(rows)]


def torque_table(
    names: Sequence[str],
    forces: FloatArray,
    limits: FloatArray,
    stop_names: Sequence[str],
    stop_forces: FloatArray,
) -> list[str]:
    """Actuators with their limits, those nearest to one first, and the stops that carry.

    Args:
        names: nu actuators.
        forces: (nu,), N m (N for slides).
        limits: (nu, 2), least and greatest; may be infinite.
        stop_names: ns stops.
        stop_forces: (ns,), N m.
    """
    ends = np.where(forces >= 0.0, limits[:, 1], limits[:, 0])
    share = np.divide(forces, ends, out=np.full(len(forces), np.inf), where=ends != 0.0)
    share = np.where(forces == 0.0, 0.0, share)
    rows = [
        f"  {names[i]:16}{forces[i]:10.4f}{limits[i, 0]:10.4g}{limits[i, 1]:10.4g}"
        f"{100 * share[i]:8.0f} %"
        for i in np.argsort(-share, kind="stable").tolist()
    ]
    head = f"  {'actuator':16}{'N m':>10}{'least':>10}{'greatest':>10}{'used':>10}"
    carried = [
        f"{stop_names[i]} {stop_forces[i]:.4f}"
        for i in np.flatnonzero(stop_forces > CARRIES).tolist()
    ]
    stops = [f"  stops that carry (N m): {', '.join(at_most(carried))}"] if carried else []
    return [head, *at_most(rows), *stops]
