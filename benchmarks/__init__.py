"""What measures: one runner, one summary, and one module per measurement; nothing here is shipped.

A measurement is a module with

    Options          a dataclass whose fields are the options of its command
    cases(options)   the cases, as plain data and frozen dataclasses
    measure(case)    the numbers of one case
    tables(result)   what a person sees, made with ``benchmarks.summary``

``python -m benchmarks NAME`` runs it (``benchmarks.bench``). What a case draws follows from the
case alone, so that a row depends neither on the others nor on who makes it.
"""
