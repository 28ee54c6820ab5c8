"""Command ``plot``: pages and figures of training runs and records."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from ..config.files import check_folder
from .options import ForceOption, TrustOption, app, check_result
from .screen import counting, out, plain

plot = typer.Typer(help="Draw training runs and records (needs the extra `plot`).", no_args_is_help=True)
app.add_typer(plot, name="plot")

RecordArgument = Annotated[Path, typer.Argument(help="A record, finished or not (see `chemlab run --record`).")]
OutputOption = Annotated[
    Path | None,
    typer.Option("--output", "-o", help="Output file, .png, .svg or .pdf (default: FILE-KIND.png beside the file)."),
]


def _save(path: Path, force: bool, draw: Callable[[], Any], *read: Path) -> None:
    """Draw a figure into a file, after a check of its format and of an existing file."""
    from ..render.figure import SETTINGS, check_format, import_matplotlib, save_figure

    check_format(path)
    check_result(path, force, *read)
    with import_matplotlib().rc_context(SETTINGS):
        save_figure(draw(), path)
    out.print(plain(path))


def _beside(record: Path, kind: str) -> Path:
    return record.parent / (f"{record.name.removesuffix('.part').rpartition('.')[0] or record.name}-{kind}.png")


@plot.command()
def curves(
    folders: Annotated[list[Path], typer.Argument(help="Training runs, or folders that contain training runs.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Output file, .png, .svg or .pdf.")] = Path(
        "curves.png"
    ),
    force: ForceOption = False,
) -> None:
    """Draw learning curves of training runs, finished or not, with evaluations and the scripted policy's score."""
    from ..agents.evaluate.curves import draw_curves

    _save(output, force, lambda: draw_curves(folders))


@plot.command()
def timeline(
    record: RecordArgument, output: OutputOption = None, force: ForceOption = False, trust: TrustOption = False
) -> None:
    """Draw a timeline: actions and experiments of every agent, cumulative costs and rewards."""
    from ..record import read_record
    from ..render.charts import draw_timeline

    _save(output or _beside(record, "timeline"), force, lambda: draw_timeline(read_record(record), trust), record)


@plot.command()
def spectra(
    record: RecordArgument, output: OutputOption = None, force: ForceOption = False, trust: TrustOption = False
) -> None:
    """Draw spectra of the vessel before and after each reaction experiment, with the materials' peaks."""
    from ..record import read_record
    from ..render.charts import draw_spectra

    _save(output or _beside(record, "spectra"), force, lambda: draw_spectra(read_record(record), trust), record)


@plot.command()
def moles(
    record: RecordArgument,
    only: Annotated[
        list[str] | None, typer.Option(help="Element or material to draw; repeatable. Default: all.")
    ] = None,
    output: OutputOption = None,
    force: ForceOption = False,
    trust: TrustOption = False,
) -> None:
    """Draw the mole balance from start to product, for each element that reacted and each other material."""
    from ..record import read_record
    from ..render.charts import draw_moles

    picture = output or _beside(record, "moles")
    _save(picture, force, lambda: draw_moles(read_record(record), trust, only or ()), record)


@plot.command()
def runs(
    results: Annotated[
        Path, typer.Argument(help="Folder of training runs made by `chemlab sweep`, or of tables of runs.")
    ],
    output: Annotated[Path, typer.Option("--out", "-o", help="Output folder of pages and figures.")] = Path("figures"),
    collect: Annotated[
        Path | None,
        typer.Option(
            help="First make tables of the runs in this folder and play their managers and the baselines; "
            "pages are made from the tables. Rows of other runs are kept."
        ),
    ] = None,
    file_format: Annotated[
        list[str] | None, typer.Option("--format", help="png, svg or pdf; repeatable. Default: png.")
    ] = None,
    trust: TrustOption = False,
) -> None:
    """Make pages of training runs: results of each algorithm with intervals, and learning curves.

    Managers have a separate page (laboratory.md), which compares them with policies without training. The command
    needs only the runs' small files or tables; --collect also needs the runs' checkpoints.
    """
    from ..agents.evaluate.page import write_page
    from ..agents.evaluate.results import read_runs
    from ..agents.evaluate.trained_managers import collect as collect_tables
    from ..agents.evaluate.trained_managers import collect_count, write_laboratory
    from ..render.figure import FORMATS

    formats = file_format or ["png"]
    if unknown := [name for name in formats if name not in FORMATS]:
        raise ValueError(f"--format: must be one of {', '.join(FORMATS)}; given {', '.join(unknown)}")
    if not read_runs(results):
        raise ValueError(f"{results}: contains no training runs; give a folder of runs, or of tables of runs")
    left_out = []
    for folder in (output, *([collect] if collect is not None else [])):
        check_folder(folder)
    if collect is not None:
        with counting() as progress:
            task = progress.add_task("managers", total=collect_count(results))
            left_out += collect_tables(results, collect, watch=lambda _: progress.advance(task))
    made = [write(collect or results, output, formats) for write in (write_page, write_laboratory)]
    for line in [*left_out, *(line for _, lines in made for line in lines)]:
        out.print(f"[yellow]left out[/yellow] {plain(line)}")
    written = [page for page, _ in made if page is not None]
    for page in written:
        out.print(f"wrote {plain(page)}")
    if not written:
        raise ValueError(f"{results}: no manager has finished training; give another folder of runs")
