"""Studies: commands with the same options that compute side by side and write a page with its figures.

A study is a function in a module of the same name in ``tel_lab/studies``::

    @study(seeds=200)
    def random_practice(options: StudyOptions) -> None:
        '''Practise on random arms along random paths.'''

It runs as ``tel study random_practice`` or ``python -m tel_lab random_practice``.
"""

from __future__ import annotations

import functools
import json
import pkgutil
import shlex
import signal
import sys
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
from click.core import ParameterSource

from tel_lab import studies
from tel_lab.tables import filled, write_figure
from tel_lab.workers import Failure, TaskFailedError, WorkersBrokenError, Workforce
from tel_ros.app.command_group import LazyGroup, missing_module
from tel_ros.app.errors import (
    EXIT_BAD_INPUT,
    EXIT_GRAPH_FAILED,
    EXIT_INTERRUPTED,
    EXIT_NOT_COMPLETED,
    end,
)
from tel_ros.core.errors import TelError
from tel_ros.recording.run_folder import write_atomically

if TYPE_CHECKING:
    from matplotlib.figure import Figure

K = TypeVar("K", bound=Hashable)
R = TypeVar("R")

Chapter = tuple[str, list[tuple[str, str, bool]]]
"""A text, and targets: what is wanted, what was found, and whether that is good enough."""
ROOT = Path(__file__).parents[1]
"""Of the checkout."""
DOCS = ROOT / "docs"


def assignments(values: Mapping[str, Any]) -> tuple[str, ...]:
    return tuple(f"{key}={json.dumps(value)}" for key, value in values.items())


@dataclass(frozen=True)
class StudyOptions:
    """What every study is asked for: its options, and the command for the page.

    ``seeds``: how many, from 1; 0 where nothing is random. ``only``: seeds or cases; empty: all of them.
    ``overrides``: as for ``--set``. ``out``: folder of page and figures; None: print only.
    """

    seeds: int = 0
    jobs: int = 1
    quick: bool = False
    only: tuple[str, ...] = ()
    overrides: tuple[str, ...] = ()
    out: Path | None = None
    command: str = ""

    def selected(self, names: Sequence[str]) -> list[str]:
        """Return the cases that were asked for, in their order.

        Raises:
            UsageError: ``--only`` names another one.
        """
        unknown = [name for name in self.only if name not in names]
        if unknown:
            raise click.UsageError(f"--only is {unknown[0]!r}; expected some of: {', '.join(names)}")
        return [name for name in names if not self.only or name in self.only]

    def results(self, function: Callable[..., R], tasks: Mapping[K, tuple[Any, ...]]) -> Iterator[R]:
        """Call a function with each task's arguments, ``jobs`` at a time; yield results in their order.

        Progress goes to stderr.

        Raises:
            TaskFailedError: a task raised.
        """
        done: dict[K, R] = {}
        waiting = list(tasks)
        with closing(Workforce(self.jobs).run(function, tasks)) as results:
            for key, result in results:
                if isinstance(result, Failure):
                    raise TaskFailedError(f"{key}: {result.message}")
                done[key] = result
                print(f"{len(done):3d}/{len(tasks)}  {key}", file=sys.stderr, flush=True)
                while waiting and waiting[0] in done:
                    yield done[waiting.pop(0)]

    def chapters(
        self,
        page: str,
        names: Sequence[str],
        function: Callable[..., Chapter],
        *arguments: Any,
        **values: Any,
    ) -> None:
        """Compute chapters by name, side by side; print each with its judged targets, and write the page."""
        names, sections, met = self.selected(names)[: 1 if self.quick else None], [], list[bool]()
        tasks = {name: (name, *arguments) for name in names}
        for name, (text, targets) in zip(names, self.results(function, tasks), strict=True):
            judged = (f"- **{'met' if t[2] else 'not met'}**: {t[0]}. Found: {t[1]}.\n" for t in targets)
            sections.append(f"## {name}\n\n{text}\n\n{''.join(judged)}")
            click.echo(sections[-1])
            met += [good for *_, good in targets]
        summary = f"{sum(met)} of {len(met)} targets are met."
        click.echo(summary)
        self.write(page, summary=summary, sections=sections, **values)

    def write(
        self,
        page: str,
        figures: Mapping[str, Callable[[], Figure]] | None = None,
        formats: Sequence[str] = ("svg", "png"),
        **values: Any,
    ) -> None:
        """Fill in a page, and draw figures (by name) into ``figures/``; nothing without ``out``."""
        if self.out is None:
            return
        for name, draw in (figures or {}).items():
            write_figure(draw, self.out / "figures" / name, formats)
        self.out.mkdir(parents=True, exist_ok=True)
        write_atomically(self.out / page, filled(page, command=self.command, **values))
        print(f"written to {self.out / page}", file=sys.stderr)


@contextmanager
def ending_in_one_line() -> Iterator[None]:
    """Turn whatever ends a command into one line and its exit code; SIGTERM interrupts like Ctrl-C."""
    # SIGINT as well: where a script has started this in the background, it would be ignored.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    try:
        yield
    except TaskFailedError as error:
        end(str(error), EXIT_NOT_COMPLETED)
    except WorkersBrokenError as error:
        end(str(error), EXIT_GRAPH_FAILED)
    except TelError as error:
        end(str(error), EXIT_BAD_INPUT)
    except ModuleNotFoundError as error:
        end(f"this {missing_module(error)}", EXIT_GRAPH_FAILED)
    except KeyboardInterrupt:
        end("interrupted", EXIT_INTERRUPTED)


def study(*, seeds: int = 0, sets: bool = True) -> Callable[[Callable[..., None]], click.Command]:
    """Return a decorator that makes a command with the options of studies; further click options may follow.

    ``seeds``: the usual number; 0: none. ``sets``: whether keys of the configuration can be changed.
    """

    def decorate(function: Callable[..., None]) -> click.Command:
        @functools.wraps(function)
        def command(*, out: Path | None, quick: bool, **values: Any) -> None:
            own = ("jobs", "only", "seeds", "overrides")
            named = {name: values.pop(name) for name in own if name in values}
            options = StudyOptions(
                quick=quick,
                out=out or (None if quick or named["only"] or not DOCS.is_dir() else DOCS),
                command=_asked(),
                **named,
            )
            with ending_in_one_line():
                function(options, **values)

        own = [
            click.Option(["--jobs"], default=1, show_default=True, help="Tasks at a time."),
            click.Option(["--quick"], is_flag=True, help="Compute less, to see that it works; print only."),
            click.Option(
                ["--only"], metavar="NAME", multiple=True, help="Only this seed or case; print only."
            ),
            click.Option(
                ["--out"],
                type=click.Path(path_type=Path, file_okay=False),
                help="Folder of the page and figures. Default: docs, or none with --quick and --only.",
            ),
        ]
        if sets:
            own.append(
                click.Option(["--set", "overrides"], metavar="KEY=VALUE", multiple=True, help="Change a key.")
            )
        if seeds:
            own.append(click.Option(["--seeds"], default=seeds, show_default=True, help="How many, from 1."))
        made: click.Command = click.command(function.__name__)(command)
        made.params[:0] = own
        return made

    return decorate


def _asked() -> str:
    """Return the command that makes the page, without what decides only where it goes and how fast."""
    context, words = click.get_current_context(), []
    for option in context.command.params:
        if option.name in ("jobs", "out", "quick") or option.name is None:
            continue
        value, source = context.params[option.name], context.get_parameter_source(option.name)
        if option.name == "seeds" or source == ParameterSource.COMMANDLINE:
            for item in value if isinstance(value, tuple) else (value,):
                words.append(f" {option.opts[0]} {shlex.quote(str(item))}")
    return f"tel study {context.command.name}{''.join(words)}"


def _places() -> dict[str, str]:
    return {
        module.name: f"{studies.__name__}.{module.name}:{module.name}"
        for module in pkgutil.iter_modules(studies.__path__)
    }


@click.group("study", cls=LazyGroup, places=_places, context_settings={"help_option_names": ["-h", "--help"]})
def study_command() -> None:
    """Make the tables and figures of the pages in docs."""
