"""The protocols by name: which trials each has, and which hands it is not for."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from types import MappingProxyType
from typing import TypeAlias

from planner.errors import NotFoundError
from planner.task import GraspTask
from sim.protocols.cases import Case
from sim.protocols.dexgraspbench import dexgraspbench_cases, unsuitable_for_dexgraspbench
from sim.protocols.forces import forces_cases
from sim.protocols.robust import robust_cases
from sim.protocols.settings import Settings
from sim.protocols.shake import on_an_arm, shake_cases

__all__ = ["PROTOCOLS", "cases_of", "trials_of", "unsuitable"]

MakeCases: TypeAlias = Callable[[Settings, int], Sequence[Case]]

PROTOCOLS: Mapping[str, MakeCases] = MappingProxyType(
    {
        "dexgraspbench": lambda settings, seed: dexgraspbench_cases(),
        "forces": forces_cases,
        "shake": lambda settings, seed: shake_cases(settings),
        "robust": robust_cases,
    }
)
"""Name -> what makes the trials out of settings and the seed of random directions and errors."""

_UNSUITABLE: Mapping[str, Callable[[GraspTask], str]] = {
    "dexgraspbench": lambda task: unsuitable_for_dexgraspbench(task.hand),
    "shake": lambda task: on_an_arm(task.hand),
}
"""Name -> why the protocol cannot take a task, of those that cannot take every one."""


def cases_of(protocol: str, settings: Settings, seed: int) -> tuple[Case, ...]:
    """The trials of a protocol, in order.

    Raises:
        NotFoundError: There is no such protocol.
    """
    if protocol not in PROTOCOLS:
        raise NotFoundError("protocol", protocol, PROTOCOLS)
    return tuple(PROTOCOLS[protocol](settings, seed))


def unsuitable(protocol: str, task: GraspTask) -> str:
    """Why a protocol cannot take a task; "" if it can."""
    return _UNSUITABLE[protocol](task) if protocol in _UNSUITABLE else ""


def trials_of(
    protocols: Collection[str], only: Collection[str], settings: Settings, seed: int
) -> dict[str, tuple[str, ...]]:
    """Which of some trials each protocol has; protocols that have none are left out.

    Args:
        protocols: Names of protocols.
        only: Names of trials; all trials of all protocols if empty.
        settings: Numbers of the protocols.
        seed: Of random directions and pose errors.

    Raises:
        NotFoundError: There is no such protocol, or none of them has a trial of a name.
    """
    there = {p: tuple(case.name for case in cases_of(p, settings, seed)) for p in protocols}
    known = [name for names in there.values() for name in names]
    for name in only:
        if name not in known:
            raise NotFoundError("trial", name, known)
    if not only:
        return there
    asked = {p: tuple(n for n in names if n in only) for p, names in there.items()}
    return {p: names for p, names in asked.items() if names}
