"""Measurements of the project, behind the commands of ``python -m benchmarks``.

They stand in the checkout and not in the wheel: their readers are the project's own, and they need
its version of everything. Nothing that ships imports them.

A ``run_...`` takes the ``hands`` by name or path, the ``objects`` (``bench_objects``), and the
``runner``, who works; where there is a ``file``, it keeps the rows and an interrupted measurement
goes on with it. What comes back is plain data: the rows or their summary, and what they were made
with. Errors are ``PlannerError`` for a hand or object that was named and cannot be used (an object
out of a folder gets a row that says so), and ``FileFormatError`` for a file of something else.

A measurement is a function from a job to a row of plain data (``run``), and a summary of the rows:
what a table shows (``sim.tables``).
"""
