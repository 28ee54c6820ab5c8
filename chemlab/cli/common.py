"""What every command shares: the app, its consoles, its options, and errors a user can read."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.markup import escape

from .. import __version__
from ..materials import DataError
from ..scenario import Scenario, load_scenario

if TYPE_CHECKING:
    from ..laboratory.aec import raw_env

__all__ = [
    "EpisodesOption",
    "JsonOption",
    "PolicyOption",
    "ScenarioArgument",
    "SeedOption",
    "app",
    "err",
    "out",
    "prepare",
    "readable_errors",
]

app = typer.Typer(
    help="A multi-agent chemistry laboratory for reinforcement-learning research.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
# Text for people goes where it can be read without spoiling what a program reads from standard output.
out = Console(highlight=False, soft_wrap=True)
err = Console(stderr=True, highlight=False, soft_wrap=True)

ScenarioArgument = Annotated[
    str, typer.Argument(help="A shipped scenario (see `chemlab list`) or a path to a TOML file.")
]
PolicyOption = Annotated[
    str,
    typer.Option(
        help="Who plays: heuristic, hasty, direct, random, pretrained (benches), trained (manager and benches), plan "
        "(a blind manager, see `chemlab plan`), or the path of what training left; exceptions by role or agent after "
        "commas: pretrained,manager=random."
    ),
]
EpisodesOption = Annotated[int, typer.Option(min=1, help="Number of episodes; each has the next seed.")]
SeedOption = Annotated[int, typer.Option(min=0, help="Seed of the first episode.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON on standard output and nothing else.")]


_shown = {"traceback": False}


@contextmanager
def readable_errors() -> Iterator[None]:
    """What the user got wrong is one message and exit code 2, not a traceback."""
    try:
        yield
    except (DataError, ImportError, ValueError) as error:  # an ImportError names the missing extra
        if _shown["traceback"]:
            raise
        err.print(f"[red]error[/red]: {escape(str(error))}", markup=True)
        raise typer.Exit(2) from error


@app.callback(invoke_without_command=True)
def _options(
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
    traceback: Annotated[
        bool, typer.Option("--traceback", help="Where an error is shown, show where it comes from, too.")
    ] = False,
) -> None:
    _shown["traceback"] = traceback
    if version:
        typer.echo(__version__)
        raise typer.Exit


def prepare(scenario: str, quiet: bool) -> tuple[Scenario, raw_env]:
    """Load the scenario, say so, and build its laboratory."""
    spec = load_scenario(scenario)
    if not quiet:
        out.print(f"[bold]{spec.name}[/bold]: {spec.summary}")
    from ..laboratory.aec import raw_env

    return spec, raw_env(spec)
