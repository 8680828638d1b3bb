"""The command ``tel sweep``."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.console import Console
from rich.progress import Progress

from tel_lab.study import ending_in_one_line
from tel_lab.sweep.plan import SweepPlan, make_plan
from tel_lab.tables import write_figure
from tel_lab.workers import Executor, WorkersBrokenError, Workforce
from tel_ros.app.config_argument import config_argument, overrides_option
from tel_ros.app.errors import EXIT_GRAPH_FAILED, EXIT_INTERRUPTED, EXIT_NOT_COMPLETED, end

if TYPE_CHECKING:
    from tel_lab.sweep.sweep import Sweep


@click.command()
@config_argument
@click.option(
    "--grid",
    metavar="KEY=V1,V2,…",
    multiple=True,
    help="A key and the values to go through; several grids make all combinations.",
)
@click.option("--seeds", type=int, help="Seeds for each point, from the configured one on. Default: 1.")
@click.option(
    "--plan", "plan_file", type=click.Path(path_type=Path), help="YAML with set, cases, grid, seeds, map."
)
@overrides_option("Another value for all points.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="Folder of the results: a new one, or that of the same sweep. Default: bags/sweep-NAME-HASH.",
)
@click.option("--jobs", type=int, help="Points at once on this machine. Default: one a core.")
@click.option(
    "--address", help="Ray cluster to run on, e.g. auto or ray://HOST:10001. Default: this machine."
)
@click.option(
    "--executor",
    type=click.Choice(["auto", "ray", "processes"]),
    default="auto",
    help="auto: Ray where it is installed, else processes.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the table as JSON, and nothing else, on stdout.")
def sweep(
    config_file: Path,
    grid: tuple[str, ...],
    seeds: int | None,
    plan_file: Path | None,
    overrides: tuple[str, ...],
    out: Path | None,
    jobs: int | None,
    address: str | None,
    executor: Executor,
    as_json: bool,
) -> None:
    """Practise over grids of configurations, without ROS, many runs at once.

    \b
    tel sweep config/paper.yaml --grid sim.inertia_scale=0.5,1,2 --grid practice.goal_duration_s=6,4.5,3
    tel sweep config/paper.yaml --plan config/sweeps/inertia_speed.yaml

    Results are kept as they come: the same command goes on with what is left after an interruption, and tries
    again what failed before its first trial. At the end the folder holds table.csv, table.parquet (where
    pyarrow is installed), and the map that a plan asks for. Seeds differ only where something is random, as
    with sim.position_noise_rad.

    Exit codes: 0 every point has a result, 1 some failed, 2 wrong input (nothing ran), 3 the workers broke
    down, 130 interrupted.
    """  # noqa: D301 - click wants the character, not its name
    with ending_in_one_line():
        plan = make_plan(plan_file, overrides, grid, seeds)
        _sweep(config_file, plan, out, Workforce(jobs, executor, address), as_json)


def _sweep(config_file: Path, plan: SweepPlan, out: Path | None, workforce: Workforce, as_json: bool) -> None:
    # Late: other commands do without the learners, which take seconds to load.
    from tel_lab.sweep.point import FAILED
    from tel_lab.sweep.sweep import Sweep

    work = Sweep(config_file, plan, out)
    try:
        _run(work, workforce)
    except KeyboardInterrupt:
        work.folder.write_table(work.rows())
        done = f"{work.n_done} of {len(work.points)} points are done"
        end(f"interrupted: {done}; the same command goes on ({work.folder.path})", EXIT_INTERRUPTED)
    except WorkersBrokenError as error:
        work.folder.write_table(work.rows())
        end(f"{error}; the same command goes on", EXIT_GRAPH_FAILED)
    rows = work.rows()
    files = work.folder.write_table(rows)
    if plan.map is not None and rows:
        from tel_lab.sweep.verdict_map import map_figure  # late: plotting takes a second to import

        files += write_figure(partial(map_figure, rows, plan.map), work.folder.path / "map", ("png", "svg"))
    click.echo(json.dumps(rows, indent=2) if as_json else "\n".join(map(str, files)))
    failed = [row for row in rows if row["outcome"] == FAILED]
    if failed:
        end(f"{len(failed)} of {len(rows)} points failed, e.g.: {failed[0]['message']}", EXIT_NOT_COMPLETED)


def _run(work: Sweep, workforce: Workforce) -> None:
    console = Console(stderr=True)
    bar = Progress(console=console, transient=True, disable=not console.is_terminal)
    task = bar.add_task("")

    def show(done: int, total: int) -> None:
        text = f"{done}/{total} points on {workforce}"
        bar.update(task, description=text, completed=done, total=total)
        if not console.is_terminal:
            console.print(f"{done}/{total} points", highlight=False)

    with bar:
        work.run(workforce, show)
