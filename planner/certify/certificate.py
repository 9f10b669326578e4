"""``Certificate``: what is proven of a grasp, what was only found, and the time it took."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from planner.certify.breaking import Breaking
from planner.certify.tolerance import Tolerance
from planner.quality import Interval
from planner.spatial import FloatArray

__all__ = ["SCHEMA_VERSION", "Certificate"]

SCHEMA_VERSION = 1
"""Version of ``Certificate.as_dict``."""

BEST_CONTROL = (
    "  of the planned posture under the best control that its actuators allow, load added slowly;\n"
    "  what a controller bears of it: opposable bench control --parts promise"
)
"""What breaking loads are proven for, said where they are printed."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Certificate:
    """Proven bounds of a grasp's quality and of what it withstands.

    Attributes:
        closed: Whether the grasp is closed. Without closure there are no tolerances.
        reason: The decision in words.
        length: Torque is divided by it before it is mixed with force, m.
        epsilon: Bounds of epsilon of the true cones, normal forces of sum 1 (-).
        epsilon_linf: The same with each normal force in [0, 1].
        breaking: Smallest disturbing force, torque and wrench, for the planned posture and the best
            control; empty where no hand is known.
        tolerances: Errors that closure tolerates.
        rotation: (3, 3), world from object.
        cpu_s: CPU time that the certificate took, s, with its samples.
    """

    closed: bool
    reason: str
    length: float
    epsilon: Interval
    epsilon_linf: Interval
    breaking: tuple[Breaking, ...]
    tolerances: tuple[Tolerance, ...]
    rotation: FloatArray
    cpu_s: float

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON; None for what is infinite or unknown."""
        broken = {}
        for b in self.breaking:
            seen = b.in_frame(self.rotation)
            known = np.isfinite(seen).all()
            broken[b.kind] = {
                **b.as_dict(),
                "wrench_object_N_Nm": seen.tolist() if known else None,
            }
        return {
            "schema_version": SCHEMA_VERSION,
            "closed": self.closed,
            "reason": self.reason,
            "length_m": self.length,
            "epsilon_l1": [self.epsilon.lower, self.epsilon.upper],
            "epsilon_linf": [self.epsilon_linf.lower, self.epsilon_linf.upper],
            "smallest_breaking": broken,
            "tolerances": [t.as_dict() for t in self.tolerances],
            "cpu_s": self.cpu_s,
        }

    def __str__(self) -> str:
        """A small table: proven from, proven to or found, unit, and where it acts."""
        lines = [
            self.reason,
            f"torque divided by {1e3 * self.length:.1f} mm; {self.cpu_s:.1f} s of CPU",
            f"{'':24}{'at least':>10}{'at most':>10}",
            _row("epsilon, L1", self.epsilon.lower, self.epsilon.upper, ""),
            _row("epsilon, L-infinity", self.epsilon_linf.lower, self.epsilon_linf.upper, ""),
        ]
        for b in self.breaking:
            where = "no limit found"
            if np.isfinite(b.wrench).all():
                part = slice(3, 6) if b.kind == "torque" else slice(0, 3)
                where = "along " + " and in the object ".join(
                    _direction(w[part]) for w in (b.wrench, b.in_frame(self.rotation))
                )
                if b.kind == "wrench":
                    where = f"force {_vector(b.wrench[:3])} N, torque {_vector(b.wrench[3:])} N m"
            lines.append(
                _row(f"breaking {b.kind}", b.bounds.lower, b.bounds.upper, f"{b.unit:4} {where}")
            )
        if self.breaking:
            lines.append(BEST_CONTROL)
        if self.tolerances:
            lines.append(f"{'closure tolerates':24}{'promised':>10}{'broken at':>10}")
        for t in self.tolerances:
            tail = t.unit
            if t.samples:
                tail += f"  {t.lost} of {t.samples} samples lost closure"
            if t.note:
                tail += f"  no promise: {t.note}"
            lines.append(_row(f"  {t.kind}", t.promised, t.broken_at, tail))
        return "\n".join(lines)


def _row(name: str, low: float | None, high: float | None, tail: str) -> str:
    ends = "".join(f"{'-' if x is None else f'{x:.4g}':>10}" for x in (low, high))
    return f"{name:24}{ends} {tail}".rstrip()


def _direction(v: FloatArray) -> str:
    size = np.linalg.norm(v)
    return _vector(v / size) if size > 0 else "nothing"


def _vector(v: FloatArray) -> str:
    return "(" + ", ".join(f"{x:.3g}" for x in np.round(v, 4) + 0.0) + ")"
