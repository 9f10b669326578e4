"""Seeded hostile inputs: whatever is given, the answer is an answer or an error with a name.

    python -m tests.fuzz --class all -n 1000 --seed 1 --workers 2
    python -m tests.fuzz --class plans --replay 1:437

A class of inputs is one file in ``tests/fuzz/classes`` with a function ``case(rng, samples)``. It
writes what it needs into the current folder, which is empty, and returns what is to be run: the
arguments of ``opposable`` as a list, or a function. ``samples`` has sound inputs to start from. The
same seed and number give the same case.
"""
