"""What a person sees of ``bench synthesis``: speed, CPU by stage, quality and diversity."""

from __future__ import annotations

from rich.table import Table

from benchmarks.baseline import BASELINE_EPSILON, BASELINE_RATE
from sim.tables import Row, number, percent, table_of


def synthesis_tables(result: Row) -> list[Table | str]:
    """All tables, what could not be tried, and the comparison with the baseline."""
    refused = [f"{c['object']}: {c['error']}" for c in result["cells"] if c["error"]]
    tables = _speed(result), _stages(result), _quality(result)
    shown: list[Table | str] = [*tables, *refused]
    if against := result["baseline"]:
        shown.append(
            f"against FRoGGeR (corrected): {number(against['rate_ratio'], 1)} times its "
            f"{BASELINE_RATE} per CPU second; epsilon ratio median "
            f"{number(against['epsilon_ratio_median'], 2)}, least "
            f"{number(against['epsilon_ratio_least'], 2)}"
        )
    return shown


def _speed(result: Row) -> Table:
    table = table_of(
        "found grasps per CPU second (all attempts count), also without the way in; CPU s per "
        "request; preparing once; first grasp of a new process with an empty cache (last row: "
        "median)",
        ("hand", "object"),
        (
            "found",
            "tries",
            "found/s",
            "no way in",
            "<= 1 s",
            "median",
            "p90",
            "prepare s",
            "first grasp s",
        ),
    )
    for cell in result["cells"]:
        if not cell["requested"]:
            table.add_row(cell["hand"], cell["object"], "not tried")
        else:
            table.add_row(cell["hand"], cell["object"], *_speed_row(cell))
    table.add_section()
    table.add_row("all", "", *_speed_row(result["total"]))
    return table


def _speed_row(cell: Row) -> list[str]:
    return [
        f"{cell['found']}/{cell['requested']}",
        number(cell["attempts_per_found"], 2),
        number(cell["found_per_cpu_s"], 2),
        number(cell["found_per_cpu_s_without_approach"], 2),
        percent(cell["within_1s"] or 0.0, float(cell["within_1s"] is not None), 0),
        number(cell["cpu_s_per_found"]["median"], 3),
        number(cell["cpu_s_per_found"]["p90"], 3),
        number(cell["prepare_cpu_s"], 2),
        number(cell.get("first_grasp_cpu_s"), 2),  # not in older files
    ]


def _stages(result: Row) -> Table:
    names = tuple(result["total"]["stages_cpu_s"])
    table = table_of("CPU by stage, ms per found grasp", ("hand", "object"), (*names, "all"))
    rows = [(c["hand"], c["object"], c) for c in result["cells"] if c["found"]]
    for k, (hand, item, cell) in enumerate([*rows, ("all", "", result["total"])]):
        if k == len(rows):
            table.add_section()
        if not cell["found"]:
            continue
        spent = [cell["stages_cpu_s"].get(name) for name in names]
        table.add_row(
            hand, item, *(number(s, 1, 1e3 / cell["found"]) for s in (*spent, cell["cpu_s"]))
        )
    return table


def _quality(result: Row) -> Table:
    against = result["baseline"] is not None
    table = table_of(
        "epsilon: ours and in FRoGGeR's definition; clearance mm; diversity: grasps, then as many "
        "random starts",
        ("hand", "object"),
        (
            "epsilon",
            "p10",
            "frogger",
            "p10",
            *(("ratio",) if against else ()),
            "clear",
            "distinct",
            "directions",
            "surface %",
            "posture rad",
        ),
    )
    for cell in result["cells"]:
        if not cell["found"]:
            continue
        theirs = BASELINE_EPSILON.get(cell["object"])
        frogger = cell["epsilon_frogger"]
        table.add_row(
            cell["hand"],
            cell["object"],
            number(cell["epsilon"]["median"], 3),
            number(cell["epsilon"]["p10"], 3),
            number(frogger["median"], 3),
            number(frogger["p10"], 3),
            *((number(frogger["median"] / theirs if theirs else None, 2),) if against else ()),
            number(cell["clearance_mm"]["median"], 1),
            *_diversity_cells(cell["diversity"], cell["diversity_of_random_starts"]),
        )
    return table


def _diversity_cells(ours: Row | None, starts: Row | None) -> list[str]:
    if ours is None or starts is None:
        return ["-"] * 4
    return [
        f"{ours['n_distinct']} / {starts['n_distinct']}",
        f"{ours['approach_entropy']:.2f} / {starts['approach_entropy']:.2f}",
        f"{100 * ours['surface_share']:.0f} / {100 * starts['surface_share']:.0f}",
        f"{number(ours['posture_width_rad'], 2)} / {number(starts['posture_width_rad'], 2)}",
    ]
