"""``bench touch``: what senses of touch know of contacts and slips, beside the truth.

A job is one part: ``arrays`` presses on arrays alone, ``engines`` compares ways to simulate taxels,
``turns`` watches objects that are turned in the hand, ``slips`` provokes slips.
"""

from __future__ import annotations

from benchmarks.touch.jobs import PARTS, run_touch
from benchmarks.touch.tables import touch_tables

__all__ = ["PARTS", "run_touch", "touch_tables"]
