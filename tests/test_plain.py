"""``finite``: whatever numbers go in, strict JSON comes out, and finite ones are not changed."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.arrays import finite, short_names, without_prefix

NUMBERS = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3)
DATA = st.recursive(
    NUMBERS, lambda inner: st.lists(inner) | st.dictionaries(st.text(max_size=3), inner)
)


@settings(max_examples=25)
@given(DATA)
def test_the_outcome_is_strict_json_and_stays_what_it_is(data: Any) -> None:
    once = finite(data)
    assert json.loads(json.dumps(once, allow_nan=False)) == once
    assert finite(once) == once


def test_arrays_and_tuples_are_lists_and_what_is_not_finite_is_none() -> None:
    given_data = {
        "forces": np.array([[1.0, np.nan], [-np.inf, 2.5]]),
        "pair": (1, float("inf")),
        "deep": [{"worst": np.float64("nan"), "count": np.int64(3), "ok": np.True_}],
        "name": "thumb",
    }
    assert finite(given_data) == {
        "forces": [[1.0, None], [None, 2.5]],
        "pair": [1, None],
        "deep": [{"worst": None, "count": 3, "ok": True}],
        "name": "thumb",
    }
    assert type(finite(given_data)["deep"][0]["count"]) is int


@pytest.mark.parametrize("value", [0, -3, 2.5, True, None, "nan"])
def test_the_rest_is_kept(value: object) -> None:
    assert finite(value) is value


def test_names_in_a_table_lose_what_all_begin_with() -> None:
    names = ["orcahand_right_P-AP", "orcahand_right_P-PP", "orcahand_right_T"]
    assert without_prefix(names) == ("orcahand_right_", ("P-AP", "P-PP", "T"))
    # no part of a word goes, and no name is empty
    assert without_prefix(["finger_a", "final_b"]) == ("", ("finger_a", "final_b"))
    assert without_prefix(["a_", "a_b"]) == ("", ("a_", "a_b"))
    assert without_prefix(["left_index_0"]) == ("", ("left_index_0",))
    assert without_prefix([]) == ("", ())


def test_long_names_in_a_table_are_short_and_stay_different() -> None:
    names = ["hand_P-FingerTipAssembly_cd219176_to_P-PP_1d411b9b", "hand_wrist"]
    assert short_names(names) == ("hand_", ("P-FingerT…P_1d411b9b", "wrist"))
    # two that differ in the middle alone keep as much as tells them apart
    alike = [f"{'a' * 12}{i}{'b' * 20}" for i in range(2)]
    _, short = short_names(alike)
    assert short[0] != short[1] and max(len(n) for n in short) < 33
    assert short_names([]) == ("", ())
