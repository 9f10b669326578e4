"""DexGraspBench itself, in the versions that it pins, run on exports of our batches."""

from sim.bench.dexgraspbench.checkout import COMMIT, HANDS, Installed, install
from sim.bench.dexgraspbench.evaluate import (
    SETTINGS,
    run_dexgraspbench,
)
from sim.bench.dexgraspbench.table import dexgraspbench_table

__all__ = [
    "COMMIT",
    "HANDS",
    "SETTINGS",
    "Installed",
    "dexgraspbench_table",
    "install",
    "run_dexgraspbench",
]
