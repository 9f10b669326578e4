"""Measurements of the project, behind the commands of ``opposable bench``.

They stand in the checkout and not in the wheel (``pyproject.toml``): their readers are the
project's own, and they need its version of everything. They stand in ``sim`` and not in a folder of
their own since types, imports and tests are then checked like any other code's.

A measurement is a function from a job to a row of plain data (``run``), and a summary of the rows:
what a table shows (``tables``).
"""
