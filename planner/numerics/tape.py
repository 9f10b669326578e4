"""CasADi functions on arrays: as instructions for kernels, or into the same buffers every time.

CasADi's virtual machine decides at every instruction what it is. A tape is the same instructions in
another order: by depth, and within a depth by kind. Runs of one kind are plain loops, and results
are the virtual machine's to the last bit. ``run_tape`` evaluates one set of arguments,
``run_on_lanes`` many of them side by side.

The work array holds arguments, then constants, then one result per instruction.

``BufferedFunction``: a CasADi function that reads and writes the same NumPy arrays every time.

Calling a function with matrices copies every number into CasADi's own and back, entry by entry;
for a Jacobian of a thousand entries that takes longer than evaluating it.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from planner.numerics.kernels import loops_of_kernels
from planner.spatial import FloatArray, IntArray


class Program(NamedTuple):
    """The instructions, for kernels.

    Attributes:
        kinds: Of each run of instructions what they do (g,).
        ends: Where each run ends (g,); it starts where the one before ends.
        left: First operand of each instruction (k,): its place in the work array.
        right: Second operand (k,); the first again where there is one.
        first: Place of the first result.
    """

    kinds: IntArray
    ends: IntArray
    left: NDArray[np.uint32]
    right: NDArray[np.uint32]
    first: int


class Tape(NamedTuple):
    """A function as arrays.

    Attributes:
        program: The instructions.
        work: What the work array begins with: zeros for the arguments, the constants (w,).
        arguments: Where each argument begins.
        results: Of each result where its entries are, by columns without structural zeros.
    """

    program: Program
    work: FloatArray
    arguments: tuple[int, ...]
    results: tuple[IntArray, ...]


_KINDS: tuple[int, ...] = (
    ca.OP_ADD,
    ca.OP_SUB,
    ca.OP_MUL,
    ca.OP_DIV,
    ca.OP_NEG,
    ca.OP_SQ,
    ca.OP_TWICE,
    ca.OP_INV,
    ca.OP_SQRT,
    ca.OP_SIN,
    ca.OP_COS,
    ca.OP_EXP,
    ca.OP_LOG,
    ca.OP_FMIN,
    ca.OP_FMAX,
    ca.OP_FABS,
    ca.OP_SIGN,
    ca.OP_LT,
    ca.OP_LE,
    ca.OP_EQ,
    ca.OP_NE,
    ca.OP_NOT,
    ca.OP_AND,
    ca.OP_OR,
    ca.OP_IF_ELSE_ZERO,
    ca.OP_POW,
    ca.OP_CONSTPOW,
    ca.OP_TAN,
    ca.OP_ATAN2,
    ca.OP_ASIN,
    ca.OP_ACOS,
    ca.OP_ATAN,
    ca.OP_TANH,
)
"""Instructions that kernels know; the number of each kind is its place here."""


def tape_of(function: Any) -> Tape | None:
    """A CasADi function of SX as a tape; None where it holds an instruction kernels do not know."""
    sizes = [function.nnz_in(i) for i in range(function.n_in())]
    begins = [0, *np.cumsum(sizes).tolist()]
    results = [np.zeros(function.nnz_out(i), dtype=np.int64) for i in range(function.n_out())]
    depth, value_of = [0] * begins[-1], {}  # of values; the value that a register holds
    constants: dict[float, int] = {}
    lines: list[tuple[int, int, int, int, int]] = []  # depth, kind, operands, value
    kind_of = {op: kind for kind, op in enumerate(_KINDS)}
    for k in range(function.n_instructions()):
        op = function.instruction_id(k)
        into = function.instruction_output(k)
        if op == ca.OP_CONST:
            number = function.instruction_constant(k)
            if number not in constants:
                constants[number] = len(depth)
                depth.append(0)
            value_of[into[0]] = constants[number]
            continue
        of = function.instruction_input(k)
        if op == ca.OP_INPUT:
            value_of[into[0]] = begins[of[0]] + of[1]
        elif op == ca.OP_OUTPUT:
            results[into[0]][into[1]] = value_of[of[0]]
        elif op in kind_of:
            left = value_of[of[0]]
            right = value_of[of[1]] if len(of) > 1 else left
            lines.append((max(depth[left], depth[right]) + 1, kind_of[op], left, right, len(depth)))
            value_of[into[0]] = len(depth)
            depth.append(lines[-1][0])
        else:
            return None
    return _laid_out(begins, constants, sorted(lines), len(depth), results)


def _laid_out(
    begins: Sequence[int],
    constants: dict[float, int],
    lines: list[tuple[int, int, int, int, int]],
    n_values: int,
    results: list[IntArray],
) -> Tape:
    """Values renumbered in the order in which they are computed."""
    table = np.array(lines, dtype=np.int64).reshape(-1, 5)
    n_in, first = begins[-1], begins[-1] + len(constants)
    place = np.zeros(n_values, dtype=np.int64)
    place[:n_in] = np.arange(n_in)
    place[list(constants.values())] = n_in + np.arange(len(constants))
    place[table[:, 4]] = first + np.arange(len(table))
    work = np.zeros(first + len(table))
    work[n_in:first] = list(constants)
    last = np.ones(len(table), dtype=bool)
    last[:-1] = (np.diff(table[:, 0]) != 0) | (np.diff(table[:, 1]) != 0)
    ends = np.flatnonzero(last)
    program = Program(
        kinds=table[ends, 1],
        ends=ends + 1,
        left=place[table[:, 2]].astype(np.uint32),
        right=place[table[:, 3]].astype(np.uint32),
        first=first,
    )
    return Tape(
        program=program,
        work=work,
        arguments=tuple(begins[:-1]),
        results=tuple(place[r] for r in results),
    )


@loops_of_kernels
def run_tape(program: Program, work: FloatArray) -> None:
    """Compute all results from the arguments in the work array (w,)."""
    left, right, first = program.left, program.right, program.first
    start = 0
    for g in range(len(program.kinds)):
        kind, end = program.kinds[g], program.ends[g]
        out = work[first + start : first + end]
        a, b = left[start:end], right[start:end]
        if kind == 0:
            for k in range(len(out)):
                out[k] = work[a[k]] + work[b[k]]
        elif kind == 1:
            for k in range(len(out)):
                out[k] = work[a[k]] - work[b[k]]
        elif kind == 2:
            for k in range(len(out)):
                out[k] = work[a[k]] * work[b[k]]
        else:
            for k in range(len(out)):
                out[k] = compute(kind, work[a[k]], work[b[k]])
        start = end


class Programs(NamedTuple):
    """The instructions of several tapes one behind the other, for kernels.

    Attributes:
        kinds, ends, left, right: As of ``Program``; ``ends`` count through all of them.
        runs: Where the runs of each program begin, and the end (p + 1,).
        first: Place of the first result of each (p,).
    """

    kinds: IntArray
    ends: IntArray
    left: NDArray[np.uint32]
    right: NDArray[np.uint32]
    runs: IntArray
    first: IntArray


def programs_of(tapes: Sequence[Tape]) -> Programs:
    """The programs of tapes."""
    programs = [tape.program for tape in tapes]
    begins = np.cumsum([0, *(len(p.left) for p in programs)])[:-1].tolist()
    none = np.zeros(0, dtype=np.int64)
    ends = [p.ends + begin for p, begin in zip(programs, begins, strict=True)]
    return Programs(
        kinds=np.concatenate([none, *(p.kinds for p in programs)]),
        ends=np.concatenate([none, *ends]),
        left=np.concatenate([none, *(p.left for p in programs)]).astype(np.uint32),
        right=np.concatenate([none, *(p.right for p in programs)]).astype(np.uint32),
        runs=np.cumsum([0, *(len(p.kinds) for p in programs)]),
        first=np.array([p.first for p in programs], dtype=np.int64),
    )


@loops_of_kernels
def run_on_lanes(programs: Programs, which: int, work: FloatArray, base: int, n: int) -> None:
    """Compute a program for n sets of arguments side by side.

    The set is entry ``base + place * n + lane`` of the work array, for each place and lane.
    """
    begin = programs.runs[which]
    start = programs.ends[begin - 1] if begin > 0 else 0
    out = base + programs.first[which] * n
    for g in range(begin, programs.runs[which + 1]):
        kind = programs.kinds[g]
        for k in range(start, programs.ends[g]):
            a, b = base + programs.left[k] * n, base + programs.right[k] * n
            if kind == 0:
                for i in range(n):
                    work[out + i] = work[a + i] + work[b + i]
            elif kind == 1:
                for i in range(n):
                    work[out + i] = work[a + i] - work[b + i]
            elif kind == 2:
                for i in range(n):
                    work[out + i] = work[a + i] * work[b + i]
            else:
                for i in range(n):
                    work[out + i] = compute(kind, work[a + i], work[b + i])
            out += n
        start = programs.ends[g]


@loops_of_kernels
def compute(kind: int, a: float, b: float) -> float:
    """What an instruction of a kind, by its place in ``_KINDS``, makes of its operands."""
    if kind == 0:
        return a + b
    if kind == 1:
        return a - b
    if kind == 2:
        return a * b
    if kind == 3:
        return a / b
    if kind == 4:
        return -a
    if kind == 5:
        return a * a
    if kind == 6:
        return 2.0 * a
    if kind == 7:
        return 1.0 / a
    if kind == 8:
        return math.sqrt(a)
    if kind == 9:
        return math.sin(a)
    if kind == 10:
        return math.cos(a)
    if kind == 11:
        return math.exp(a)
    if kind == 12:
        return math.log(a)
    if kind == 13:
        return b if b < a or a != a else a
    if kind == 14:
        return b if b > a or a != a else a
    if kind == 15:
        return abs(a)
    if kind == 16:
        return 1.0 if a > 0.0 else (-1.0 if a < 0.0 else a)
    if kind == 17:
        return 1.0 if a < b else 0.0
    if kind == 18:
        return 1.0 if a <= b else 0.0
    if kind == 19:
        return 1.0 if a == b else 0.0
    if kind == 20:
        return 1.0 if a != b else 0.0
    if kind == 21:
        return 1.0 if a == 0.0 else 0.0
    if kind == 22:
        return 1.0 if a != 0.0 and b != 0.0 else 0.0
    if kind == 23:
        return 1.0 if a != 0.0 or b != 0.0 else 0.0
    if kind == 24:
        return b if a != 0.0 else 0.0
    if kind in (25, 26):
        return math.pow(a, b)
    if kind == 27:
        return math.tan(a)
    if kind == 28:
        return math.atan2(a, b)
    if kind == 29:
        return math.asin(a)
    if kind == 30:
        return math.acos(a)
    if kind == 31:
        return math.atan(a)
    return math.tanh(a)


def into_buffers(
    function: Any, arguments: list[FloatArray], results: list[FloatArray]
) -> Callable[[], None]:
    """A call that reads and writes these arrays: nonzeros by columns, as CasADi stores them."""
    buffer, trigger = function.buffer()
    for i, array in enumerate(arguments):
        buffer.set_arg(i, array.data)
    for i, array in enumerate(results):
        buffer.set_res(i, array.data)

    def call(_kept: Any = (function, buffer)) -> None:
        trigger()

    return call


class BufferedFunction:
    """A function of dense matrices, with arguments and results of every thread's own.

    All are transposed: CasADi stores columns, NumPy rows.
    """

    def __init__(self, function: Any) -> None:
        """Keep the function.

        Raises:
            TypeError: An argument or result is sparse.
        """
        sparse = [
            name
            for names, sparsity in (
                (function.name_in(), function.sparsity_in),
                (function.name_out(), function.sparsity_out),
            )
            for i, name in enumerate(names)
            if not sparsity(i).is_dense()
        ]
        if sparse:
            raise TypeError(f"{function.name()} has entries that are not stored: {sparse}; densify")
        self._function, self._own = function, threading.local()

    def __call__(self, *arguments: FloatArray | float) -> tuple[FloatArray, ...]:
        """The results at these arguments; the thread's next call overwrites them.

        Args:
            *arguments: Each in the shape of its transpose, or one to spread.
        """
        try:
            room: _Room = self._own.room
        except AttributeError:
            room = self._own.room = _Room(self._function)
        for mine, given in zip(room.arguments, arguments, strict=True):
            mine[...] = given
        room.call()
        return room.results


class _Room:
    """Arguments and results of a function for one thread."""

    def __init__(self, function: Any) -> None:
        self.arguments = [
            np.zeros(function.size_in(i)[::-1], dtype=np.float64) for i in range(function.n_in())
        ]
        self.results: tuple[FloatArray, ...] = tuple(
            np.zeros(function.size_out(i)[::-1], dtype=np.float64) for i in range(function.n_out())
        )
        self.call = into_buffers(function, self.arguments, list(self.results))
