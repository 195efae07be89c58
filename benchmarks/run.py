"""Measure the package, the engines alone, and other libraries alternately.

`make benchmark` prints the tables, writes them to `docs/data` as CSV, and all values with versions
and machine to `build/benchmarks.json`; `--compare OLD.json` prints the changes. `--quick` is for a
machine with unreliable times: it fails only if a result is not accurate. `--ratios` is for a
machine with other work: it fails if the ratio of our time to the engine's exceeds the recorded
ratio in `docs/data`.
"""

from __future__ import annotations

import os
import re
import sys
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import bare
import click
import growth
import orjson
import published
import ratios
import stages
import whole
from measure import Row, describe_machine, measure_job, processor_name
from rich.console import Console
from rich.table import Table
from tables import write_csv

import pupper_analysis as pa

TABLE = ("job", "ours", "bare engine", "ratio", "goal", "peers", "accuracy reached")
"""Columns of the table of calls."""

FILES = {"where-the-time-of-a-call-goes": "stages", "how-time-grows": "growth"}
"""{name derived from the title of a table: name of its file}, if different."""


def format_time(seconds: float) -> str:
    """Return a time [s] with three digits, in s, ms or µs."""
    for unit, size in (("s", 1.0), ("ms", 1e-3)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds / 1e-6:.3g} µs"


def make_cells(row: Row) -> tuple[str, ...]:
    """Return the row of a job in the table of calls."""
    peers = [f"{who} {format_time(took)} ({how})" for who, (took, how) in row.peers.items()]
    return (
        row.name,
        format_time(row.ours),
        "-" if row.bare is None else f"{row.bare[0]} {format_time(row.bare[1])}",
        "-" if row.ratio is None else f"{row.ratio:.2f}",
        "-" if row.goal is None else f"{row.goal:.2f}",
        ", ".join(peers) or "-",
        row.accuracy,
    )


def make_tables(found: dict[str, Any], rows: list[Row]) -> dict[str, list[tuple[str, ...]]]:
    """Return {title: rows of text}, with the header as first row, of all tables."""
    made: dict[str, list[tuple[str, ...]]] = {
        f"Calls: medians by turns, of {found['variant']}": [TABLE, *map(make_cells, rows)]
    }
    if "start-up" in found:
        made["Start-up"] = [
            ("command", "median"),
            *((name, format_time(took)) for name, took in found["start-up"].items()),
        ]
    if "stages" in found:
        made["Where the time of a call goes"] = [
            ("job", "part", "median"),
            *(
                (job, part, format_time(took))
                for job, parts in found["stages"].items()
                for part, took in parts.items()
            ),
        ]
    if "default run" in found:
        parts = found["default run"]
        made[f"Default run: stages, {len(pa.VARIANTS)} variants"] = [
            ("stage", "time", "share"),
            *((n, format_time(t), f"{t / sum(parts.values()):.0%}") for n, t in parts.items()),
            ("together", format_time(sum(parts.values())), ""),
        ]
    if "published robots" in found:
        made["Published robots"] = list(found["published robots"])
    if "growth" in found:
        made["How time grows"] = [
            ("what", "least", "most", "exponent at the end"),
            *(
                (
                    name,
                    *(f"{count}: {format_time(took)}" for count, took in (points[0], points[-1])),
                    f"{growth.fit_exponent(points):.2f}",
                )
                for name, points in found["growth"].items()
            ),
        ]
    return made


def list_changes(found: dict[str, Any], old: dict[str, Any]) -> list[tuple[str, ...]]:
    """Return a table of the changes since another run, with times and ratios."""
    before = {row["name"]: row for row in old["jobs"]}
    messages: list[tuple[str, ...]] = [
        ("job", "before", "now", "change", "ratio before", "ratio now"),
    ]
    for row in found["jobs"]:
        was = before.get(row["name"])
        if was is None:
            messages.append((row["name"], "-", format_time(row["ours"]), "new", "-", "-"))
            continue
        ratios = [
            f"{one['ours'] / one['bare'][1]:.2f}" if one["bare"] else "-" for one in (was, row)
        ]
        change = f"{row['ours'] / was['ours'] - 1:+.0%}"
        messages.append(
            (row["name"], format_time(was["ours"]), format_time(row["ours"]), change, *ratios)
        )
    now, then = found["setting"], old["setting"]
    for key in sorted(now["versions"].keys() | then["versions"].keys()):
        first, second = then["versions"].get(key, "-"), now["versions"].get(key, "-")
        if first != second:
            messages.append((f"version of {key}", first, second, "", "", ""))
    for key in ("processor", "cores"):
        if now[key] != then[key]:
            messages.append((key, str(then[key]), str(now[key]), "", "", ""))
    return messages


def print_table(title: str, rows: list[tuple[str, ...]]) -> None:
    """Print a table."""
    table = Table(*rows[0], title=title, title_justify="left")
    for row in rows[1:]:
        table.add_row(*row)
    Console(width=None if sys.stdout.isatty() else 160).print(table)


def make_setting_table(found: dict[str, Any]) -> list[tuple[str, str]]:
    """Return date, machine and versions as a table."""
    where = found["setting"]
    return [
        ("what", "value"),
        ("time", where["time"]),
        ("commit", published.find_commit()),
        ("processor", where["processor"]),
        ("cores", str(where["cores"])),
        ("load at the start", f"{where['load'][0]:.1f}"),
        *where["versions"].items(),
    ]


def write_tables(folder: Path, made: dict[str, list[tuple[str, ...]]]) -> None:
    """Write a CSV file for each table, named after its title: ``benchmarks-start-up.csv``."""
    for title, (header, *rows) in made.items():
        name = re.sub(r"[^a-z]+", "-", title.partition(":")[0].lower()).strip("-")
        write_csv(folder / f"benchmarks-{FILES.get(name, name)}.csv", header, rows)


DATA = Path(__file__).parents[1] / "docs/data"
"""Folder of the recorded tables."""


def check_ratios(variant: str) -> bool:
    """Print the measured and recorded ratios; return True if all are permitted."""
    record, here = ratios.read_recorded(DATA), ratios.processor_family(processor_name())
    recorded = ratios.expected_ratios(record, here)
    both = partial(ratios.measure_both, DATA.parents[1], DATA / ratios.FILE, variant)
    found = ratios.compare_ratios(bare.jobs(variant), recorded, ratios.measure_ratio, both)
    where = here if here in record else f"the largest of {', '.join(record)}"
    print_table(
        f"Times of the bare engine: recorded ({where}), now ({here})",
        [
            ("job", "recorded", "now", "at most"),
            *((one.job, *(f"{value:.2f}" for value in one[1:])) for one in found),
        ],
    )
    for one in found:
        if one.recorded > recorded[one.job]:
            click.echo(
                f"note: {one.job}: {recorded[one.job]:.2f} is recorded; the state that recorded it "
                f"takes {one.recorded:.2f} times the bare engine's time on this machine now",
                err=True,
            )
        if not one.is_kept:
            click.echo(
                f"error: {one.job}: {one.now:.2f} times the bare engine's time; {one.recorded:.2f} "
                f"is recorded, and {one.most:.2f} is the most",
                err=True,
            )
    return all(one.is_kept for one in found)


@click.command()
@click.option("--variant", default="v3", show_default=True, help="The robot to measure with.")
@click.option("--repeats", default=15, show_default=True, help="Least number of calls per line.")
@click.option(
    "--quick", is_flag=True, help="A few calls of all that is quick: only accuracy counts."
)
@click.option(
    "--ratios", "only_ratios", is_flag=True, help="Only compare ratios with those in docs/data."
)
@click.option("--json", "json_path", type=click.Path(path_type=Path), help="Write the results.")
@click.option("--compare", type=click.Path(path_type=Path, exists=True), help="An older JSON.")
@click.option("--tables", "folder", type=click.Path(path_type=Path), help="Write CSV files here.")
@click.option("--figure", type=click.Path(path_type=Path), help="Draw how time grows.")
def main(
    variant: str,
    repeats: int,
    quick: bool,
    only_ratios: bool,
    json_path: Path | None,
    compare: Path | None,
    folder: Path | None,
    figure: Path | None,
) -> None:
    """Measure the package, the engines alone, and other libraries."""
    os.environ.setdefault("MUJOCO_GL", "egl")
    if only_ratios:
        sys.exit(not check_ratios(variant))
    found: dict[str, Any] = {"variant": variant, "quick": quick, "setting": describe_machine()}
    rows: list[Row] = []
    jobs = bare.jobs(variant)
    for job in (*jobs, *whole.jobs(variant)):
        if not quick or job.quick:
            click.echo(f"{job.name} ...", err=True)
            rows.append(measure_job(job, 1 if quick else repeats, 0.0 if quick else 1.0))
    found["jobs"] = [asdict(row) for row in rows]
    own: dict[str, float] = {}
    if not quick:
        click.echo("ratios ...", err=True)
        own = ratios.measure_smallest_ratios(jobs, ratios.measure_ratio)
        found["stages"] = stages.measure_stages(variant, 100 * repeats)
        click.echo("start-up, default run, growth ...", err=True)
        found["start-up"] = whole.measure_start_up(3)
        found["default run"] = whole.measure_default_run(pa.VARIANTS)
        found["published robots"] = published.measure_robots()
        found["growth"] = growth.measure_growth(variant, max(growth.COUNTS), 0.5)
        found["growth"] |= growth.measure_robot_growth(0.2)
    made = make_tables(found, rows)
    for title, lines in made.items():
        print_table(title, lines)
    if compare is not None:
        print_table(f"since {compare}", list_changes(found, orjson.loads(compare.read_bytes())))
    if json_path is not None:
        json_path.parent.mkdir(parents=True, exist_ok=True)
        json_path.write_bytes(orjson.dumps(found, option=orjson.OPT_INDENT_2))
    if folder is not None:
        if not quick:
            record = ratios.read_recorded(folder) | {ratios.processor_family(processor_name()): own}
            made["Ratios"] = ratios.make_record_table(record)
        write_tables(folder, {"setting": make_setting_table(found)} | made)
    if figure is not None and "growth" in found:
        growth.draw_growth(found["growth"], figure)
    wrong = [row for row in rows if not row.exact]
    for row in wrong:
        click.echo(f"error: {row.name} is not exact: {row.accuracy}", err=True)
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
