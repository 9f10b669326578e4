"""DexGraspBench itself, in the versions that it pins, run on exports of our batches."""

from benchmarks.dexgraspbench.checkout import COMMIT, HANDS, Installed, install
from benchmarks.dexgraspbench.evaluate import SETTINGS, dexgraspbench_table, run_dexgraspbench

__all__ = [
    "COMMIT",
    "HANDS",
    "SETTINGS",
    "Installed",
    "dexgraspbench_table",
    "install",
    "run_dexgraspbench",
]
