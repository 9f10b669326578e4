"""Measurements of ``benchmarks`` in tests: run in this process, without a word."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from rich.console import Console

from benchmarks.bench import run
from sim.runner import Runner


def run_bench(name: str, *, workers: int = 1, **options: Any) -> dict[str, Any]:
    """The result of a measurement by its name."""
    bench = import_module(f"benchmarks.{name}")
    runner = Runner(console=Console(quiet=True), check=lambda: None, workers=workers)
    return run(bench, bench.Options(**options), runner)
