"""Export of a batch to the files that DexGraspBench evaluates.

Read from https://github.com/JYChen18/DexGraspBench at commit 1e7a5a6 (2025-06-05): ``src/task/
eval_func/base.py`` for the keys of a grasp and of an object's ``simplified.json``, ``src/util/
hand_util.py`` for the order of qpos and for how qpos becomes ctrl, ``config/hand`` for the keys of
a hand. ``python -m benchmarks dexgraspbench`` runs that evaluation on an export.
"""

from planner.exchange.dexgraspbench.export import (
    Exported,
    Squeeze,
    export_dexgraspbench,
    grasp_dict,
    plan_squeeze,
)
from planner.exchange.dexgraspbench.models import benchmark_pieces, export_name

__all__ = [
    "Exported",
    "Squeeze",
    "benchmark_pieces",
    "export_dexgraspbench",
    "export_name",
    "grasp_dict",
    "plan_squeeze",
]
