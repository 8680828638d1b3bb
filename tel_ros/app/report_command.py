"""``tel report``."""

from __future__ import annotations

import json
from pathlib import Path

import click

from tel_ros.app.errors import EXIT_BAD_INPUT, end
from tel_ros.app.report_figure import FIGURE_FORMATS
from tel_ros.core.errors import TelError


class FigureFormats(click.ParamType):
    """Formats of figures, with commas between them; each is taken once."""

    name = "formats"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, ...]:
        """Return the formats."""
        formats = tuple(dict.fromkeys(part.strip().lower() for part in str(value).split(",")))
        for each in formats:
            if each not in FIGURE_FORMATS:
                self.fail(
                    f"{each!r} in {value!r}; expected formats of {', '.join(FIGURE_FORMATS)}", param, ctx
                )
        return formats


@click.command()
@click.argument("runs", metavar="RUN…", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--figures",
    "formats",
    metavar="FORMATS",
    type=FigureFormats(),
    default="png",
    show_default=True,
    help="Formats of the files of the figures, e.g. pdf,svg,png; files in other formats are removed.",
)
@click.option(
    "--out",
    metavar="FOLDER",
    type=click.Path(path_type=Path),
    help="Where the report on several runs goes; that on one is in the folder of the run.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the name of the report as JSON on stdout.")
def report(runs: tuple[Path, ...], formats: tuple[str, ...], out: Path | None, as_json: bool) -> None:
    """Make the report of the practice run in folder RUN, from its bags.

    Of several runs, make one report that sets them side by side: errors, the last movements, and where the
    configurations differ. The page needs nothing beside it; the figures are in the folder figures/ as well.
    """
    try:
        file = _write(runs, formats, out)
    except TelError as error:
        end(str(error), EXIT_BAD_INPUT)
    click.echo(json.dumps({"report": str(file)}) if as_json else file)


def _write(runs: tuple[Path, ...], formats: tuple[str, ...], out: Path | None) -> Path:
    # Late: plotting takes a second to import.
    if len(runs) == 1:
        if out is not None:
            raise TelError(f"--out is {out}; expected only with several runs, that of one is in its folder")
        from tel_ros.app.report import write_report

        return write_report(runs[0], formats)
    if out is None:
        raise TelError("--out is not given; expected a folder for the report on several runs")
    from tel_ros.app.runs_report import write_runs_report

    return write_runs_report(runs, out, formats)
