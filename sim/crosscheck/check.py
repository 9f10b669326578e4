"""``crosscheck`` and ``compare_models``: the library calls behind ``opposable crosscheck``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from planner.bridge import pinocchio_from_mujoco
from planner.errors import TaskError
from sim.crosscheck.causes import Context, explain, explain_failure
from sim.crosscheck.compare import (
    EqualityCheck,
    compare_couplings,
    compare_local,
    compare_observations,
    compare_parts,
    equality_names,
)
from sim.crosscheck.geometry import GeometryCheck, compare_boxes, compare_geometries
from sim.crosscheck.mujoco_side import MujocoSide, layout_of, left_out
from sim.crosscheck.parts import Side, Tally, Tolerances, as_drawn, random_states
from sim.crosscheck.pinocchio_side import match
from sim.crosscheck.reader import (
    ReaderResult,
    Source,
    compiled,
    read_with_pinocchio,
    stated_velocities,
)
from sim.crosscheck.report import Column, CrosscheckReport, column_from

BRIDGE, READER = "bridge", "Pinocchio's reader"
"""Names of the columns of ``crosscheck``."""

PAIRS_PER_CONFIGURATION = 60
"""Pairs of geometries that are compared per configuration; meshes take up to a millisecond each."""


def crosscheck(
    model: Any,
    *,
    seed: int = 0,
    n_configurations: int = 20,
    tolerances: Tolerances | None = None,
    own_reader: bool = True,
    judge_reader: bool = False,
    timeout: float = 60.0,
) -> CrosscheckReport:
    """Check a model in MuJoCo against Pinocchio and coal, at seeded random configurations.

    The columns are Pinocchio as the bridge builds it from the compiled model, with coal for its
    geometries, and what Pinocchio's own reader makes of the same file.

    Args:
        model: Path of an MJCF or URDF file, a hand as for ``load_hand``, ``mujoco.MjSpec`` or
            ``mujoco.MjModel``. Pinocchio's own reader is asked only about a model file.
        seed: Of the configurations.
        n_configurations: How many.
        tolerances: What counts as equal.
        own_reader: Whether to ask Pinocchio's own reader.
        judge_reader: Whether what it gets wrong makes the report not ok.
        timeout: Seconds that Pinocchio's own reader has.

    Raises:
        ModelError: MuJoCo cannot read or compile the model.
        PlannerError: The child process of Pinocchio's own reader cannot start.
        TaskError: A number is out of range.
    """
    source = compiled(model)
    layout = layout_of(source.model)
    reference = MujocoSide(source.model, "MuJoCo", layout)
    bridge = match(pinocchio_from_mujoco(source.model), BRIDGE, layout)
    run = _Run(source, reference, seed, n_configurations, tolerances)
    columns = [run.column(bridge, engines=True)]
    if own_reader and source.path is not None:
        result = read_with_pinocchio(source.path, timeout)
        columns.append(_reader_column(run, result, judged=judge_reader))
    notes = (*source.notes, *(f"not compared: {what}" for what in left_out(source.model)))
    return run.report(source.name, columns, notes)


def compare_models(
    reference: Any,
    other: Any,
    *,
    names: Mapping[str, str] | None = None,
    seed: int = 0,
    n_configurations: int = 20,
    tolerances: Tolerances | None = None,
) -> CrosscheckReport:
    """Compare two models of the same thing, part by part: a URDF with an MJCF, a copy with it.

    Joints, bodies and sites belong together by name. The report's one column names the parts at
    fault (``Column.faults``).

    Args:
        reference: As for ``crosscheck``.
        other: The same, or a ``pinocchio.Model``.
        names: Reference's name -> the other's name, for joints, bodies and sites that are called
            otherwise there.
        seed: Of the configurations.
        n_configurations: How many.
        tolerances: What counts as equal.

    Raises:
        ModelError: MuJoCo cannot read or compile a model.
        TaskError: A number is out of range, or ``names`` names what is not there.
    """
    source = compiled(reference)
    layout = layout_of(source.model)
    here = MujocoSide(source.model, source.name, layout, None, stated_velocities(source))
    notes = list(source.notes)
    there: Side
    if isinstance(other, pin.Model):
        there = match(other, other.name or "pinocchio.Model", layout, names)
        notes.append("not compared: collision geometries (a pinocchio.Model has none)")
    else:
        second = compiled(other)
        notes += second.notes
        speeds = stated_velocities(second)
        there = MujocoSide(second.model, second.name, layout, names, speeds)
    _check_names(names or {}, here, there)
    run = _Run(source, here, seed, n_configurations, tolerances)
    return run.report(there.name, [run.column(there, engines=False)], notes)


class _Run:
    """One reference and its configurations."""

    def __init__(
        self,
        source: Source,
        reference: MujocoSide,
        seed: int,
        count: int,
        tolerances: Tolerances | None,
    ) -> None:
        if seed < 0 or count < 1:
            raise TaskError(
                f"seed is {seed} and n_configurations {count}; give a seed of 0 or more and at "
                "least one configuration"
            )
        self.source, self.reference = source, reference
        self.limits = tolerances or Tolerances()
        self.layout = reference.layout
        self.parts = reference.parts()
        self._seed, self._count = seed, count
        self._mass = float(source.model.body_mass.sum())

    def report(
        self, model: str, columns: Sequence[Column], notes: Sequence[str]
    ) -> CrosscheckReport:
        """What came out for a model, by this name."""
        return CrosscheckReport(
            model=model,
            reference=self.reference.name,
            columns=tuple(columns),
            seed=self._seed,
            n_configurations=self._count,
            tolerances=self.limits,
            notes=tuple(notes),
        )

    def tally(self, side: Side) -> Tally:
        """Everything except distances and equalities."""
        tally, layout = Tally(tolerances=self.limits), self.layout
        compare_parts(tally, layout, self.parts, side.parts())
        drawn = as_drawn(layout)
        compare_local(tally, layout, self.reference.observe(drawn), side.observe(drawn))
        for state in self._states(side):
            here, there = self.reference.observe(state), side.observe(state)
            compare_observations(tally, layout, side.moving, self._mass, state, here, there)
        return tally

    def column(self, side: Side, *, engines: bool) -> Column:
        """Compare a side; with ``engines`` also coal and equalities, which need our own bridge."""
        tally = self.tally(side)
        notes: list[str] = []
        if isinstance(side, MujocoSide):
            compare_couplings(tally, self.reference, side)
            compare_geometries(tally, self.reference, side)
        if engines:
            geometry = GeometryCheck(self.source.model, PAIRS_PER_CONFIGURATION)
            geometry.shuffle(np.random.default_rng(self._seed))
            equalities = EqualityCheck(self.source.model)
            for state in self._states(side):
                there = side.observe(state)
                geometry.run(tally, state, there)
                equalities.run(tally, state, there)
            notes += [f"not compared: {what}" for what in geometry.left_out + equalities.left_out]
        return column_from(side.name, tally, notes=tuple(notes))

    def _states(self, side: Side) -> Any:
        generator = np.random.default_rng(self._seed)
        return random_states(
            self.layout, dict(self.parts.joints), side.moving, generator, self._count
        )


def _reader_column(run: _Run, result: ReaderResult, *, judged: bool) -> Column:
    """What Pinocchio's own reader got, with causes."""
    if result.model is None:
        column = column_from(READER, Tally(tolerances=run.limits), judged=judged)
        return replace(column, failure=explain_failure(run.source, result.failure))
    notes = []
    side = match(result.model, READER, run.layout)
    tally = run.tally(side)
    for name in equality_names(run.source.model):
        tally.add("equality rows", name, np.inf)
    if result.geometry_failure:
        reason = " ".join(result.geometry_failure.rsplit("message:", 1)[-1].split())
        notes.append(f"its geometries could not be read: {reason}")
    else:
        compare_boxes(tally, run.source.model, result)
    column = column_from(READER, tally, judged=judged, notes=tuple(notes))
    return explain(column, Context(run.source, run.reference, side, result))


def _check_names(names: Mapping[str, str], here: Side, there: Side) -> None:
    """See that a map of names is about parts that exist."""
    mine, theirs = here.parts(), there.parts()
    known = {*mine.joints, *mine.bodies, *mine.sites}
    matched = {*theirs.joints, *theirs.bodies, *theirs.sites}
    wrong = [f"{a} = {b}" for a, b in names.items() if a not in known or a not in matched]
    if wrong:
        raise TaskError(
            f"the map of names says {', '.join(wrong)}, and the parts of that name are not in both "
            "models; write REFERENCE = OTHER with names of joints, bodies or sites"
        )
