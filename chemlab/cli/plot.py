"""The command plot: pages and pictures of training runs and records."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from ..config.files import check_folder
from .common import TrustOption, app, check_result, readable_errors
from .screen import counting, out, plain

__all__: list[str] = []

plot = typer.Typer(help="Draw training runs and records (needs the extra `plot`).", no_args_is_help=True)
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


@plot.command()
def runs(
    results: Annotated[
        Path, typer.Argument(help="Folder with training runs, as `chemlab sweep` leaves it, or with tables of them.")
    ],
    output: Annotated[Path, typer.Option("--out", "-o", help="Where pages and figures go.")] = Path("figures"),
    collect: Annotated[
        Path | None,
        typer.Option(
            help="First make tables of the runs in this folder, and play the managers among them and what they are "
            "compared with; pages are made from the tables. What they have of other runs stays."
        ),
    ] = None,
    file_format: Annotated[
        list[str] | None, typer.Option("--format", help="png, svg or pdf; repeat the option. Default: png.")
    ] = None,
    trust: TrustOption = False,
) -> None:
    """Make pages of training runs: what each algorithm came to, with intervals, and learning curves.

    Managers of laboratories have a page of their own (laboratory.md), beside managers that learned nothing. Needs
    nothing but runs' small files or tables (and the extra `plot`); --collect also needs the runs' checkpoints.
    """
    with readable_errors():
        from ..agents.evaluate.laboratory import collect as collect_tables
        from ..agents.evaluate.laboratory import collect_count, write_laboratory
        from ..agents.evaluate.page import write_page
        from ..render.figure import FORMATS

        formats = file_format or ["png"]
        if unknown := [name for name in formats if name not in FORMATS]:
            raise ValueError(f"--format: known: {', '.join(FORMATS)}; given {', '.join(unknown)}")
        total = collect_count(results)
        left_out = []
        for folder in (output, *([collect] if collect is not None else [])):
            check_folder(folder)
        if collect is not None:
            with counting() as progress:
                task = progress.add_task("managers", total=total)
                left_out += collect_tables(results, collect, watch=lambda _: progress.advance(task))
        page, others = write_page(collect or results, output, formats)
        laboratory = write_laboratory(collect or results, output, formats)
        left_out += [*others, *(laboratory.left_out if laboratory is not None else ())]
    for line in left_out:
        out.print(f"[yellow]left out[/yellow] {plain(line)}")
    for written in (page, laboratory and laboratory.page):
        if written is not None:
            out.print(f"wrote {plain(written)}")
    if page is None and laboratory is None:
        out.print(f"{plain(results)}: has no training runs")
