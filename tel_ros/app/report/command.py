"""``tel report``."""

from __future__ import annotations

import json
from pathlib import Path

import click

from tel_ros.core.errors import TelError

FIGURE_FORMATS = ("png", "svg", "pdf")


def _formats(context: click.Context, option: click.Parameter, value: str) -> tuple[str, ...]:
    formats = tuple(dict.fromkeys(part.strip().lower() for part in value.split(",")))
    if unknown := [each for each in formats if each not in FIGURE_FORMATS]:
        expected = f"expected formats of {', '.join(FIGURE_FORMATS)}"
        raise click.BadParameter(f"{unknown[0]!r} in {value!r}; {expected}", context, option)
    return formats


@click.command()
@click.argument("runs", metavar="RUN…", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--figures",
    "formats",
    metavar="FORMATS",
    callback=_formats,
    default="png",
    show_default=True,
    help="File formats of the figures, e.g. pdf,svg,png; files in other formats are removed.",
)
@click.option(
    "--out",
    metavar="FOLDER",
    type=click.Path(path_type=Path),
    help="Folder for the report on several runs; that on one run goes into the folder of the run.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the path of the report as JSON on stdout.")
def report(runs: tuple[Path, ...], formats: tuple[str, ...], out: Path | None, as_json: bool) -> None:
    """Make the report of the practice run in folder RUN from its bags.

    With several runs, make one report that sets them side by side: errors, the last movements, and where the
    configurations differ. The page needs no other file; the figures are also written to the folder figures/.
    """
    if len(runs) == 1 and out is not None:
        raise TelError(f"--out is {out}; expected only with several runs, that of one is in its folder")
    if len(runs) > 1 and out is None:
        raise TelError("--out is not given; expected a folder for the report on several runs")
    # Imported late: plotting takes a second to import.
    from tel_ros.app.report.run import write_report
    from tel_ros.app.report.runs import write_runs_report

    file = write_report(runs[0], formats) if out is None else write_runs_report(runs, out, formats)
    click.echo(json.dumps({"report": str(file)}) if as_json else file)
