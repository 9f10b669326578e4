"""``ProtocolReport``: the outcomes of one protocol for one plan, as table, JSON and CSV."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console, ConsoleOptions, RenderResult
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from planner.arrays import finite
from planner.errors import FileFormatError
from planner.system.package import written_by
from sim.protocols.outcome import Outcome
from sim.screen import Report, error_lines, number, percent
from sim.sensing.errors import drawn_text
from sim.tables import table

PROTOCOL_VERSION = 2
"""Version of the JSON form; version 1 called the loads borne and broke, and one protocol fc."""

ALLOWED = "what the certificate allows any control in the planned posture"
NEARBY = "of every posture near the planned one"

ASKED = ("protocol", "plan", "hand", "object", "mass_kg", "controller", "seed")
MADE_WITH = ("epsilon_planned", "grip_N", "physics", "settings", "wall_s")
"""Attributes of a report with which its plain data begin and end."""

MOST_FAILED = 3
"""Trials that were not held on the screen; the table has all of them."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ProtocolReport(Report):
    """What became of all trials.

    Attributes:
        protocol: Its name.
        plan: What the plan was called.
        hand: Name of the hand.
        object: Specification of the object's shape.
        mass_kg: Its planned mass.
        controller: Name of the controller.
        seed: Seed of directions and errors.
        physics: How MuJoCo computed, in words and numbers.
        settings: Numbers of the protocol.
        epsilon_planned: L1 epsilon of the planned contacts (-).
        grip_N: Planned normal force of each finger.
        asked: How many trials there are.
        outcomes: Those that were finished, by number.
        wall_s: Time it took.
    """

    protocol: str
    plan: str
    hand: str
    object: str
    mass_kg: float
    controller: str
    seed: int
    physics: Mapping[str, Any]
    settings: Mapping[str, Any]
    epsilon_planned: float
    grip_N: tuple[float, ...]
    asked: int
    outcomes: tuple[Outcome, ...]
    wall_s: float

    @property
    def complete(self) -> bool:
        """Whether every trial was finished."""
        return len(self.outcomes) == self.asked

    @property
    def fixed(self) -> tuple[Outcome, ...]:
        """Trials that are held or not; in the others a load grows, or they could not be run."""
        return tuple(o for o in self.outcomes if not o.grows and o.reason != "not run")

    @property
    def loaded(self) -> tuple[Outcome, ...]:
        """Trials in which a load grows."""
        return tuple(o for o in self.outcomes if o.grows)

    @property
    def success(self) -> bool:
        """Whether the grasp held in every trial without a growing load and bore loads in the rest.

        All trials must have been finished; to bear a load is to come to rest under the first one.
        """
        return self.complete and not self.failed

    @property
    def failed(self) -> tuple[Outcome, ...]:
        """Trials in which the object was not held, or came to rest under no load."""
        return tuple(
            o for o in self.outcomes if not (o.largest_load_held > 0 if o.grows else o.held)
        )

    @property
    def reasons(self) -> dict[str, int]:
        """How often each reason ended a trial, most frequent first."""
        return dict(Counter(o.reason for o in self.outcomes if o.reason).most_common())

    def breaking(self, unit: str) -> tuple[float, float]:
        """Median and least of the largest loads held, over directions with a unit ("N", "N m")."""
        held = [o.largest_load_held for o in self.loaded if o.unit == unit]
        if not held:
            return float("nan"), float("nan")
        return float(np.median(held)), float(np.min(held))

    @property
    def share_of_bound(self) -> float:
        """Median over directions of the load held over the proven bound; NaN without loads."""
        shares = [
            o.largest_load_held / o.bound
            for o in self.loaded
            if np.isfinite(o.bound) and o.bound > 0
        ]
        return float(np.median(shares)) if shares else float("nan")

    @property
    def contradictions(self) -> tuple[str, ...]:
        """Directions in which more was held than is proven of every posture near the plan's."""
        return tuple(o.name for o in self.loaded if o.contradicts)

    def summary(self) -> dict[str, Any]:
        """The report without its trials, plain data."""
        (force, least_force), (torque, least_torque) = (self.breaking(u) for u in ("N", "N m"))
        drift = [o.drift[0] for o in self.fixed if o.held and np.isfinite(o.drift[0])]
        data = {
            **{name: getattr(self, name) for name in ASKED},
            "success": self.success,
            "complete": self.complete,
            "asked": self.asked,
            "finished": len(self.outcomes),
            "held": sum(o.held for o in self.fixed),
            "of": len(self.fixed),
            "not_run": sum(o.reason == "not run" for o in self.outcomes),
            "held_by_another_grasp": sum(bool(o.other_grasp) for o in self.fixed),
            "reasons": self.reasons,
            "median_load_held_N": force,
            "least_load_held_N": least_force,
            "median_load_held_Nm": torque,
            "least_load_held_Nm": least_torque,
            "median_share_of_bound": self.share_of_bound,
            "contradictions": list(self.contradictions),
            "largest_drift_mm": max(drift, default=float("nan")),
            **{name: getattr(self, name) for name in MADE_WITH},
        }
        return dict(finite(data))

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """What it comes to; ``protocol_table`` has a row for every trial."""
        p, s = self.physics, self.summary()
        held = "[bold green]held[/]" if self.success else "[bold red]not held[/]"
        if not self.complete:
            held += f", {len(self.outcomes)} of {self.asked} trials finished"
        yield Text.from_markup(
            f"[bold]{self.protocol}[/]: {held}: {escape(self.hand)}, {escape(self.object)}, "
            f"control {self.controller}"
        )
        if "engine" in p:
            yield Text(
                f"physics: {p['engine']} ({p['timestep_s']:g} s, {p['contacts']}, servos "
                f"{p['servos']}, friction {p['friction']:g})"
            )
        else:
            yield Text(
                f"physics: {p['name']} ({p['timestep_s']:g} s, {p['integrator']}, {p['solver']}, "
                f"{p['cone']} cones, impratio {p['impratio']:g}, noslip {p['noslip_iterations']}, "
                f"friction {p['friction']:g} and {p['torsional_friction_m']:g} m)"
            )
        yield from (Text(line) for line in self._error_lines())
        if s["of"]:
            other = s["held_by_another_grasp"]
            note = f", {other} of them by another grasp than was planned" if other else ""
            yield Text(f"held in {s['held']} of {s['of']}{note}")
        for o in self.failed[:MOST_FAILED]:
            why = "" if o.fault is None else f": {o.reason}, {o.fault.detail}"
            drawn = drawn_text([o.conditions])
            yield Text(f"not held: {o.name}{why}{drawn and f' (drawn: {drawn})'}")
        if len(self.failed) > MOST_FAILED:
            yield Text(f"and {len(self.failed) - MOST_FAILED} more")
        for reason, count in s["reasons"].items():
            yield Text(f"ended by {reason}: {count}")
        for unit, key in (("N", "N"), ("N m", "Nm")):
            if s[f"median_load_held_{key}"] is not None:
                median, least = s[f"median_load_held_{key}"], s[f"least_load_held_{key}"]
                yield Text(f"load held: median {median:.3g} {unit}, least {least:.3g} {unit}")
        if s["median_share_of_bound"] is not None:
            yield Text(f"that is {percent(s['median_share_of_bound'])} of {ALLOWED}, in the median")
        for name in s["contradictions"]:
            yield Text.from_markup(
                f"[bold red]contradiction:[/] {escape(name)}: more than is proven {NEARBY}"
            )

    def _error_lines(self) -> list[str]:
        """Which errors there were, and what was drawn of them in all trials; none of exact ones."""
        estimator = self.settings.get("estimator", "none")
        if "error_model" not in self.settings:
            return [] if estimator == "none" else [f"estimator: {estimator}"]
        told = {**self.settings["error_model"], "estimator": estimator}
        drawn = drawn_text(o.conditions for o in self.outcomes)
        return error_lines(told | ({"drawn_in_words": drawn} if drawn else {}))

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain data; what is not a finite number becomes None."""
        return {
            "format": "opposable-protocol",
            "version": PROTOCOL_VERSION,
            "written_by": written_by(),
            **self.summary(),
            "trials": [o.to_dict() for o in self.outcomes],
        }


def _held(outcome: Outcome) -> str:
    """One word for the table."""
    return "no" if not outcome.held else "elsewhere" if outcome.other_grasp else "yes"


def protocol_table(report: ProtocolReport) -> Table:
    """One row per trial."""
    loaded = bool(report.loaded)
    columns = ["trial", "held"]
    if loaded:
        columns += ["load held", "failed at", "bound", "share", "near"]
    columns += ["drift mm", "deg", "closed", "friction", "at s", "reason"]
    made = table(
        f"{report.protocol}: {report.hand}, {report.object}, control {report.controller}",
        columns,
        left=("trial", "reason"),
    )
    for column in made.columns[:-1]:
        column.no_wrap = True
    for o in report.outcomes:
        cells = [o.name, "" if o.grows else _held(o)]
        if loaded:
            cells += [
                number(o.largest_load_held, 3, o.unit),
                number(o.failure_load, 3),
                number(o.bound, 3),
                percent(o.largest_load_held / o.bound if o.bound > 0 else float("nan")),
                number(o.bound_near, 3),
            ]
        cells += [
            number(o.drift[0], 2),
            number(o.drift[1], 2),
            percent(o.share_closed),
            percent(o.largest_utilisation),
            "" if o.fault is None else f"{o.fault.time:.2f}",
            o.reason or o.other_grasp,
        ]
        made.add_row(*cells)
    return made


def write_csv(reports: Iterable[ProtocolReport], path: Path) -> None:
    """One line per trial of all reports.

    Raises:
        FileFormatError: The file cannot be written.
    """
    rows = [
        {"plan": r.plan, "protocol": r.protocol, "controller": r.controller, **o.to_row()}
        for r in reports
        for o in r.outcomes
    ]
    names = list(dict.fromkeys(name for row in rows for name in row))
    try:
        with path.open("w", encoding="utf-8", newline="") as stream:
            writer = csv.DictWriter(stream, names)
            writer.writeheader()
            writer.writerows(rows)
    except OSError as error:
        raise FileFormatError(f"cannot write {path}: {error.strerror}") from error
