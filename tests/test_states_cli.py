"""``opposable dataset states``."""

from __future__ import annotations

import io
import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from commands import opposable
from rich.console import Console

from sim.cli.dataset import StatesBar, states_table
from sim.datasets.reset_states import StatesProgress
from sim.datasets.reset_states.shards import shard_path

FEW = ("--grasps", "4", "--motions", "0", "--gaits", "0", "--workers", "1")

RUN = "from brief import small_shards; from sim.cli import main\nwith small_shards(): main()"
"""The command line with small shards, run in this folder."""

pytestmark = pytest.mark.usefixtures("small_shards", "plain_searches")


@pytest.mark.slow
def test_states_are_made_in_two_sizes_and_shown_again(tmp_path: Path) -> None:
    words = [
        "dataset",
        "states",
        "allegro_hand",
        "sphere:0.035",
        "-n",
        "5",
        "--scales",
        "1,1.1",
        *FEW,
    ]
    words += ["--gravity=-1,0,0", "--out", str(tmp_path / "cache")]
    code, out, err = opposable(*words)
    assert code == 0, err
    assert "5/5" in out
    assert "check_states.py" in out
    hora = tmp_path / "cache" / "hora" / "sphere-0.035"
    assert sorted(f.name for f in hora.iterdir()) == [
        "public_allegro_grasp_50k_s10.npy",
        "public_allegro_grasp_50k_s11.npy",
    ]
    code, out, _ = opposable(*words, "--json", "--format", "npz")
    assert code == 0
    assert [cell["scale"] for cell in json.loads(out)["cells"]] == [1.0, 1.1]
    fewer = ["2" if word == "5" else word for word in words]
    code, out, _ = opposable(*fewer)
    assert code == 0 and "sphere-0.035-s1 had 5 states before, and keeps them" in out
    for file in hora.iterdir():
        assert len(np.load(file)) == 5
    code, out, _ = opposable(*fewer, "--json")
    assert [(cell["states"], cell["asked"]) for cell in json.loads(out)["cells"]] == [(5, 2)] * 2
    code, _, err = opposable(*words, "--mass", "0.1,0.2")
    assert code == 3
    assert "draws.mass" in err
    (tmp_path / "cache" / "manifest.json").write_text('{"format": "opposable-batch"}')
    code, _, err = opposable(*words)
    assert code == 3 and "holds something else, of the format 'opposable-batch'; choose" in err


def test_an_object_that_cannot_be_held_is_said(tmp_path: Path) -> None:
    code, out, _ = opposable(
        *(
            "dataset",
            "states",
            "allegro_hand",
            "sphere:0.2",
            "-n",
            "5",
            *FEW,
            "--out",
            tmp_path / "cache",
        )
    )
    assert code == 4
    assert "0/5" in out
    assert "too large" in " ".join(out.split())


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("--scales", "1,x"), "--scales"),
        (("--friction", "1"), "--friction '1' has 1 numbers"),
        (("--friction", "2,1"), "the smaller one first"),
        (("--gravity", "down"), "--gravity"),
        (("--format", "isaac"), "isaac_lab"),
        (("--workers", "0"), "workers"),
        (("--grasps", "0"), "no grasps, motions or gaits"),
    ],
)
def test_bad_options_end_before_anything_is_made(
    words: tuple[str, ...], complaint: str, tmp_path: Path
) -> None:
    folder = tmp_path / "cache"
    asked = ("dataset", "states", "allegro_hand", "box", "-n", "5", *FEW, *words)
    code, _, err = opposable(*asked, "--out", folder)
    assert code == 3, err
    assert complaint in err
    assert not folder.exists()


def test_a_format_that_cannot_hold_them_is_an_error_only_if_it_was_named(tmp_path: Path) -> None:
    asked = (
        "dataset",
        "states",
        "allegro_hand",
        "sphere:0.035",
        "-n",
        "2",
        *FEW,
        "--out",
        tmp_path / "cache",
    )
    code, out, _ = opposable(*asked)
    assert code == 0
    assert "no hora of sphere-0.035-s1" in " ".join(out.split())
    code, _, err = opposable(*asked, "--format", "hora")
    assert code == 3
    assert "--gravity=-1,0,0" in err


@pytest.mark.slow
def test_ctrl_c_keeps_what_there_is(tmp_path: Path) -> None:
    words = ["dataset", "states", "allegro_hand", "sphere:0.035", "-n", "100000", *FEW]
    running = subprocess.Popen(
        [sys.executable, "-c", RUN, *words, "--out", str(tmp_path / "cache")],
        cwd=Path(__file__).parent,
        stderr=subprocess.PIPE,
        text=True,
    )
    first = shard_path(tmp_path / "cache" / "sphere-0.035-s1", 0)
    deadline = time.monotonic() + 240.0
    while not first.exists() and running.poll() is None and time.monotonic() < deadline:
        time.sleep(0.05)
    running.send_signal(signal.SIGINT)
    _, err = running.communicate(timeout=600.0)
    assert running.returncode == 130, err
    assert "states are kept; the same command goes on" in " ".join(err.split())
    assert first.exists()


def test_the_bar_counts_and_the_table_names_what_was_lost() -> None:
    screen = Console(file=io.StringIO(), force_terminal=True, width=150)
    now = StatesProgress(
        cell="box-s1", phase="holding", done=60, total=100, before=20, tried=80, elapsed_s=2.0
    )
    with StatesBar(screen) as bar:
        assert bar.kept() == "what was planned is kept"
        bar.told(now)
        assert bar.kept() == "60 states are kept"
    assert "20.0/s, kept 75 %" in screen.file.getvalue()  # type: ignore[attr-defined]
    cell = {
        "name": "box-s1",
        "states": 60,
        "asked": 100,
        "tried": 80,
        "rate_kept": 0.75,
        "lost": {"dropped: far": 15, "near": 5},
        "hold_cpu_s_per_state": 0.02,
    }
    text = io.StringIO()
    Console(file=text, width=150).print(states_table({"hand": "h", "cells": [cell]}))
    assert "15 dropped" in text.getvalue()
    assert "75.0 %" in text.getvalue()
