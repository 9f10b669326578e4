"""Plans, rather than a batch, as a folder that DexGraspBench evaluates; see the package.

The folder is that of ``export_dexgraspbench``, with the grasps of an object numbered in the order
in which they are given.
"""

from __future__ import annotations

import os
import secrets
import shutil
from collections import defaultdict
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from planner.batch.recipe import label_of
from planner.batch.rows import found_row
from planner.errors import FileFormatError, TaskError
from planner.exchange.dexgraspbench.export import grasp_dict
from planner.exchange.dexgraspbench.hand_file import T_model_base, file_name, write_hand
from planner.exchange.dexgraspbench.object_files import write_object
from planner.exchange.dexgraspbench.squeeze import Squeeze, plan_squeeze, without_servos
from planner.exchange.formats import Writing
from planner.hands.hand import Hand
from planner.plan import GraspPlan


def write_dexgraspbench(
    plans: Sequence[GraspPlan], folder: Path, writing: Writing
) -> tuple[Path, ...]:
    """Write plans of one hand, with their objects and the hand.

    Args:
        plans: At least one.
        folder: Made here; it must not exist, or be empty.
        writing: Not heeded: the benchmark has names of its own.

    Returns:
        The files of the grasps.

    Raises:
        TaskError: Several hands, a hand on an arm or without position servos, two objects of one
            name, or a grasp that cannot press without gravity.
        ModelError: The MuJoCo that the benchmark pins cannot read such a hand.
        FileFormatError: The folder holds something, or cannot be written.
    """
    hand = _one_hand(plans)
    grouped = _by_object(plans)
    squeezes = [_squeeze(i, plan) for i, plan in enumerate(plans)]
    folder = folder.resolve()
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise FileFormatError(f"{folder} exists and is no empty folder; name another one")
    part = folder.with_name(f".{secrets.token_hex(8)}.part")
    digits = len(str(max(map(len, grouped.values())) - 1))
    written = []
    try:
        part.mkdir()
        name = write_hand(hand, part / "hand", moved_to=folder / "hand")
        T_base_model = T_model_base(hand).inverse()
        for label, numbers in grouped.items():
            write_object(plans[numbers[0]].task, part / "object" / label)
            target = part / "graspdata" / name / label
            target.mkdir(parents=True)
            for k, number in enumerate(numbers):
                plan = plans[number]
                row = found_row(number, label, k, plan, [])
                place = folder / "object" / label
                data: Any = grasp_dict(plan.task, row, place, squeezes[number], T_base_model)
                file = target / f"{k:0{digits}}.npy"
                np.save(file, data, allow_pickle=True)
                written.append(folder / file.relative_to(part))
        with suppress(OSError):
            folder.rmdir()  # an empty one
        os.replace(part, folder)
    except OSError as error:
        raise FileFormatError(f"cannot write {folder}: {error.strerror or error}") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return tuple(written)


def _one_hand(plans: Sequence[GraspPlan]) -> Hand:
    """The hand of all plans, if the benchmark can have it."""
    hand = plans[0].task.hand
    others = {plan.task.hand.name for plan in plans if plan.task.hand.digest != hand.digest}
    if others:
        raise TaskError(
            f"the plans are for more than one hand, {hand.name} and {', '.join(sorted(others))}; "
            "write a folder for each"
        )
    if hand.arm is not None:
        raise TaskError(
            f"{hand.name} is on an arm, and DexGraspBench takes hands alone; plan with the hand "
            "without its arm"
        )
    if reason := without_servos(hand):
        raise TaskError(
            f"{reason}; DexGraspBench commands postures: plan with a hand that has position servos"
        )
    return hand


def _by_object(plans: Sequence[GraspPlan]) -> dict[str, list[int]]:
    """Numbers of the plans by the name of their object's folder."""
    grouped: dict[str, list[int]] = defaultdict(list)
    for i, plan in enumerate(plans):
        grouped[file_name(label_of(plan.task))].append(i)
    for label, numbers in grouped.items():
        specs = {plans[i].task.object.shape.spec for i in numbers}
        if len(specs) > 1:
            raise TaskError(
                f"the objects {' and '.join(sorted(specs))} would both be exported as {label!r}; "
                "write a folder for each, or give one of them another name"
            )
    return dict(grouped)


def _squeeze(number: int, plan: GraspPlan) -> Squeeze:
    found = plan_squeeze(plan.task, plan.contacts, plan.T_world_base, plan.q)
    if found.reason:
        raise TaskError(
            f"plan {number} cannot press without gravity: {found.reason}; leave it out, or plan "
            "with a smaller grip"
        )
    return found
