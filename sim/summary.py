"""What a person reads after planning and after a trial: tables for the terminal."""

from __future__ import annotations

import numpy as np
from rich.console import Console
from rich.table import Table

from planner.plan import GraspPlan
from sim.report import TrialReport

__all__ = ["print_plan", "print_report"]


def _table(title: str | None, *columns: str) -> Table:
    table = Table(title=title)
    for column in columns:
        table.add_column(column, justify="left" if column == "finger" else "right")
    return table


def print_plan(plan: GraspPlan, console: Console) -> None:
    """Contacts with forces, quality and residuals of a plan."""
    task, record = plan.task, plan.record
    console.print(
        f"[bold]plan[/]: {task.hand.name} grasps {task.object.shape.spec} "
        f"({1e3 * task.object.mass:.0f} g), seed {record.seed}: found at attempt "
        f"{record.attempt + 1} in {record.cpu_s:.2f} s of CPU (building {record.build_s:.2f} s)",
        highlight=False,
    )
    table = _table(
        None, "finger", "contact in object (mm)", "force (N)", "friction used", "pad gap (um)"
    )
    at = plan.contacts_in_object.positions
    used = plan.contacts.friction_utilisation()
    for i, finger in enumerate(task.finger_names):
        table.add_row(
            finger,
            " ".join(f"{1e3 * v:6.1f}" for v in at[i]),
            f"{plan.contacts.forces[i, 0]:.2f}",
            f"{100 * used[i]:.0f} %",
            f"{1e6 * plan.verification.pad_gaps[i]:.2f}",
        )
    console.print(table)
    closure = plan.quality.closure
    console.print(
        f"force closure {'yes' if closure.closed else 'no'}, epsilon {plan.quality.epsilon:.4f}, "
        f"min-weight {closure.normalised_min_weight:.3f} (of 1); nearest other pair: "
        f"{plan.verification.closest[0]}",
        highlight=False,
    )


def print_report(report: TrialReport, console: Console) -> None:
    """The verdict of a trial, and planned against measured contacts."""
    if report.success:
        moved, turned = report.largest_slip
        verdict = (
            f"[bold green]held[/]: the object moved {moved:.2f} mm and {turned:.2f} degrees in the "
            "hand after the squeeze"
        )
    else:
        verdict = f"[bold red]not held, {report.reason}[/]: {report.verdict.detail}"
    console.print(
        f"[bold]trial[/]: {verdict} ({report.simulated_s:.1f} s simulated in "
        f"{report.wall_s:.1f} s)",
        highlight=False,
    )
    physics = report.physics
    console.print(
        f"physics: {physics['name']}; friction gives way by {report.least_creep_mm_s:.2g} mm/s "
        f"however firm the grip, before {physics['noslip_iterations']} noslip iterations",
        highlight=False,
        markup=False,
    )
    if report.remedies:
        console.print("each of these keeps the object from creeping:", highlight=False)
    for remedy in report.remedies:
        console.print(f"  {remedy}", highlight=False, markup=False, soft_wrap=True)
    for event in report.events:
        who = f" {event.finger}" if event.finger else ""
        console.print(
            f"  {event.time:.3f} s: {event.kind}{who}: {event.detail}",
            highlight=False,
            markup=False,
        )
    if report.comparison:
        table = _table(
            "planned and measured contacts while holding",
            "finger",
            "off by (mm)",
            "planned (N)",
            "measured (N)",
            "error",
        )
        for c in report.comparison:
            table.add_row(
                c.finger,
                f"{c.position_error_mm:.2f}",
                f"{c.planned_normal_force:.2f}",
                f"{c.measured_normal_force:.2f}",
                f"{c.force_error_percent:.1f} %",
            )
        console.print(table)
    samples = report.samples
    holding = np.array([phase == "hold" for phase in samples.phase], dtype=bool)
    if holding.any():
        closed = np.asarray(samples.closed)[holding]
        measured = report.quality_measured
        console.print(
            f"force closure of the measured contacts in {closed.sum()} of {holding.sum()} samples "
            "of the hold",
            highlight=False,
        )
        if measured is not None:
            console.print(
                f"epsilon of the true cones: planned {report.quality_planned.epsilon_round}, "
                f"measured {measured.epsilon_round} (both with the plan's friction, mu "
                f"{report.quality_mu:g})",
                highlight=False,
            )
