"""The hand's part in a force problem: which joints, actuators and stops the contacts load."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from planner.actuation import Actuation
from planner.errors import ContactError
from planner.spatial import FloatArray, IntArray

__all__ = ["HandPart"]


@dataclass(frozen=True, kw_only=True, eq=False)
class HandPart:
    """Joint torques R^T F + S^T lam + passive of the loaded joints.

    Attributes:
        joints: Loaded joints (nt,): moved by a contact, or tied to such a joint by an actuator or
            an active stop.
        actuators: Actuators on those joints (na,).
        stops: Active stops on those joints (ns,).
        drive: (nt, na + ns): [R^T, S^T] of them.
        limits: (na, 2), what the actuators can produce at q, N m.
        passive: (nt,), what springs produce at q, N m.
        column_names: na + ns names.
        row_names: nt names.
    """

    joints: IntArray
    actuators: IntArray
    stops: IntArray
    drive: FloatArray
    limits: FloatArray
    passive: FloatArray
    column_names: tuple[str, ...]
    row_names: tuple[str, ...]

    @classmethod
    def of(
        cls,
        joint_map: FloatArray,
        actuation: Actuation | None,
        q: ArrayLike | None,
        *,
        with_jacobians: bool,
    ) -> HandPart:
        """The part of a hand that contacts with ``joint_map`` (nv, components) load at q.

        Raises:
            ContactError: ``actuation`` without ``q`` or Jacobians, q without ``actuation``, or
                their sizes differ.
        """
        if actuation is None:
            if q is not None:
                raise ContactError("q is given without an actuation; give both or neither")
            none = np.zeros(0, dtype=np.int64)
            return cls(
                joints=none,
                actuators=none,
                stops=none,
                drive=np.zeros((0, 0)),
                limits=np.zeros((0, 2)),
                passive=np.zeros(0),
                column_names=(),
                row_names=(),
            )
        if q is None or not with_jacobians:
            raise ContactError("actuation limits need q (nv,) and jacobians (n, 3 or 6, nv)")
        nv = len(actuation.joint_names)
        at = np.array(q, dtype=np.float64)
        if len(joint_map) != nv or at.shape != (nv,) or not np.isfinite(at).all():
            raise ContactError(
                f"q has shape {at.shape} and the jacobians {len(joint_map)} joints; the actuation "
                f"has {nv} joints: give finite numbers for these, in its order"
            )
        rows = np.vstack([actuation.moment, actuation.stop_rows])
        touching = np.concatenate(
            [np.ones(len(actuation.names), dtype=bool), actuation.active_stops(at)]
        )
        loaded = (joint_map != 0).any(axis=1)
        while True:
            used = touching & (rows[:, loaded] != 0).any(axis=1)
            grown = loaded | (rows[used] != 0).any(axis=0)
            if (grown == loaded).all():
                break
            loaded = grown
        joints = np.flatnonzero(loaded)
        nu = len(actuation.names)
        actuators = np.flatnonzero(used[:nu])
        stops = np.flatnonzero(used[nu:])
        return cls(
            joints=joints,
            actuators=actuators,
            stops=stops,
            drive=np.hstack(
                [
                    actuation.moment[np.ix_(actuators, joints)].T,
                    actuation.stop_rows[np.ix_(stops, joints)].T,
                ]
            ),
            limits=actuation.force_limits(at)[actuators],
            passive=actuation.passive_torque(at)[joints],
            column_names=(
                *(actuation.names[i] for i in actuators),
                *(actuation.stop_names[i] for i in stops),
            ),
            row_names=tuple(f"torque {actuation.joint_names[j]}" for j in joints),
        )
