"""Failures as values, and faults of a file in one sentence."""

from __future__ import annotations

import math
import pickle

import pytest
from pydantic import ValidationError

from planner.failure import Failure
from planner.schema import MOST_FAULTS, StrictData, faults_of


def test_a_failure_reads_as_its_sentence_and_keeps_its_numbers() -> None:
    numbers = {"margin": 0.03}
    why = Failure(kind="closure_margin", text="closure has a margin of 0.03", numbers=numbers)
    numbers["margin"] = 1.0
    assert str(why) == "closure has a margin of 0.03"
    assert dict(why.numbers) == {"margin": 0.03}
    there = pickle.loads(pickle.dumps(why))  # as it comes from a worker
    assert there == why
    assert dict(there.numbers) == {"margin": 0.03}
    assert str(why.at("at 50 % of the path")) == f"at 50 % of the path: {why}"
    with pytest.raises(TypeError):
        why.numbers["margin"] = 2.0  # type: ignore[index]
    with pytest.raises(AttributeError):
        why.kind = "other"  # type: ignore[misc]


class Row(StrictData):
    mass: float
    sizes: tuple[float, ...] = ()


class NamedRow(Row):
    name: str


class Rows(StrictData):
    rows: tuple[NamedRow, ...]


@pytest.mark.parametrize("mass", [math.nan, math.inf, -math.inf])
def test_data_of_a_file_is_finite(mass: float) -> None:
    assert Row(mass=1.0).mass == 1.0
    with pytest.raises(ValidationError) as caught:
        Row(mass=mass)
    assert faults_of(caught.value).startswith(f"mass is {mass}; ")


def test_faults_are_told_with_their_place_and_the_first_of_them_alone() -> None:
    with pytest.raises(ValidationError) as caught:
        Row.model_validate({"mass": 1.0, "sizes": [1.0, "x"], "colour": 3})
    told = faults_of(caught.value)
    assert told.startswith("sizes.1 is 'x'; ") and "; colour is no field" in told
    parts = {"rows": [{"name": "thumb", "mass": "x"}]}
    with pytest.raises(ValidationError) as caught:
        Rows.model_validate(parts)
    assert faults_of(caught.value, parts).startswith("rows[thumb].mass is 'x'; ")
    assert faults_of(caught.value).startswith("rows.0.mass is 'x'; ")
    with pytest.raises(ValidationError) as caught:
        Row.model_validate({f"unknown_{k}": k for k in range(20)})
    told = faults_of(caught.value)
    assert told.count(" is no field") + told.count(" is missing") == MOST_FAULTS
