"""The command plot: pictures of runs and records."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from .common import TrustOption, app, check_result
from .screen import out, plain

__all__: list[str] = []

plot = typer.Typer(help="Draw what people ask of runs and records (needs the extra `plot`).", no_args_is_help=True)
app.add_typer(plot, name="plot")

RecordArgument = Annotated[Path, typer.Argument(help="A record, finished or not (see `chemlab run --record`).")]
OutputOption = Annotated[
    Path | None,
    typer.Option("--output", "-o", help="Where to draw, .png, .svg or .pdf (default: FILE-KIND.png beside the file)."),
]
ForceOption = Annotated[bool, typer.Option("--force", help="Replace the picture if it is there already.")]


def _save(path: Path, force: bool, draw: Callable[[], Any], *read: Path) -> None:
    """Draw into a file; what is in the way or has no such format is found before anything is drawn."""
    from ..render.figure import FORMATS, SETTINGS, import_matplotlib, save_figure

    if path.suffix.removeprefix(".") not in FORMATS:
        raise ValueError(f"{path}: ends with {path.suffix or 'nothing'}; known: {', '.join(FORMATS)}")
    if path.exists() and not force:
        raise ValueError(f"{path}: is already there; give another name with -o, or --force to replace it")
    check_result(path, *read)
    with import_matplotlib().rc_context(SETTINGS):
        save_figure(draw(), path)
    out.print(plain(path))


def _beside(record: Path, kind: str) -> Path:
    return record.parent / (f"{record.name.removesuffix('.part').rpartition('.')[0] or record.name}-{kind}.png")


@plot.command()
def curves(
    folders: Annotated[list[Path], typer.Argument(help="Training runs, or folders with such below them.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Where to draw, .png, .svg or .pdf.")] = Path(
        "curves.png"
    ),
    force: ForceOption = False,
) -> None:
    """Learning curves of training runs, finished or not, with evaluations and the scripted policy's line."""
    from ..agents.evaluate.curves import draw_curves

    _save(output, force, lambda: draw_curves(folders))


@plot.command()
def timeline(
    record: RecordArgument, output: OutputOption = None, force: ForceOption = False, trust: TrustOption = False
) -> None:
    """Who did what when: actions and experiments of every agent, costs and rewards adding up."""
    from ..record import read_record
    from ..render.charts import draw_timeline

    _save(output or _beside(record, "timeline"), force, lambda: draw_timeline(read_record(record), trust), record)


@plot.command()
def spectra(
    record: RecordArgument, output: OutputOption = None, force: ForceOption = False, trust: TrustOption = False
) -> None:
    """Spectra of the vessel before and after each reaction experiment, with the materials' peaks."""
    from ..record import read_record
    from ..render.charts import draw_spectra

    _save(output or _beside(record, "spectra"), force, lambda: draw_spectra(read_record(record), trust), record)


@plot.command()
def moles(
    record: RecordArgument,
    only: Annotated[
        list[str] | None, typer.Option(help="An element or a material to show; repeat the option. Default: all.")
    ] = None,
    output: OutputOption = None,
    force: ForceOption = False,
    trust: TrustOption = False,
) -> None:
    """Where the moles went, from start to product: a balance for each element that reacted and each other material."""
    from ..record import read_record
    from ..render.charts import draw_moles

    picture = output or _beside(record, "moles")
    _save(picture, force, lambda: draw_moles(read_record(record), trust, only or ()), record)
