"""Page that compares the paper's results with ours: statements, every experiment and algorithm, figures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from chemlab.agents.evaluate import statistics
from chemlab.agents.evaluate.results import cells_table, display_name
from chemlab.agents.evaluate.statistics import number_text
from chemlab.config.display import markdown_table
from chemlab.config.files import write_text

from ..tables import SCORES
from .figures import FIGURES
from .results import EXPERIMENTS, Results
from .statements import Finding, compare_with_paper


def paper_table(results: Results) -> list[str]:
    """Return the lines of a Markdown table of the paper's experiments.

    By algorithm it has the mean over runs of each run's best policy with its interval, the scripted policy first.
    """
    labels = dict.fromkeys(label for key in EXPERIMENTS for label in results.cells[key])
    scripted = [results.scripted_mean(key) for key in EXPERIMENTS]
    rows = [["scripted", *("" if mean is None else number_text(mean) for mean in scripted)]]
    for label in labels:
        cells = [results.cell(key, label) for key in EXPERIMENTS]
        rows.append([display_name(label), *("" if c is None else str(statistics.mean([c.means()])) for c in cells)])
    lines: list[str] = markdown_table({"": False, **{spec.title: True for spec in EXPERIMENTS.values()}}, rows)
    return lines


def write_page(results: Results, folder: Path, lacking: Mapping[str, Sequence[str]]) -> Path:
    """Write ``summary.md`` and return its path.

    Args:
        results: results of the tables.
        folder: output folder.
        lacking: missing results of each figure, as returned by :func:`~studies.paper.chemgymrl.figures.write_figures`.
    """
    page = folder / "summary.md"
    write_text(page, "\n".join(_markdown(results, folder, lacking)).rstrip() + "\n")
    return page


def _verdict(finding: Finding) -> str:
    said = {True: "yes", False: "**no**", None: "-"}[finding.holds]
    return f"{said} ({', '.join(finding.variants)}: yes)" if finding.variants else said


def _markdown(results: Results, folder: Path, lacking: Mapping[str, Sequence[str]]) -> Iterator[str]:
    yield from ("# The paper's results and ours", "", "## What the paper says", "")
    yield (
        "The paper's values are those its text and captions state; none is read off a picture. What an "
        "algorithm is in the paper decides (PPO, not a variant with other settings); variants that agree where it does "
        "not are named. -: no runs, or runs that cannot tell."
    )
    names = ("figure", "experiment", "statement", "paper", "where", "ours", "agrees", "criterion")
    rows = (
        [str(c.figure), EXPERIMENTS[c.experiment].title, c.says, c.paper, c.where, f.ours, _verdict(f), c.criterion]
        for c, f in compare_with_paper(results)
    )
    yield from ("", *markdown_table({name: name == "figure" for name in names}, rows))
    cells = [cell for key in EXPERIMENTS for cell in results.cells[key].values()]
    hours = sum(run.finished.seconds for cell in cells for run in cell.runs) / 3600.0
    yield from ("", "## Every experiment and algorithm", "")
    yield (
        f"Bench score ({SCORES}) of each run's best policy; mean over runs and interquartile mean with 95 % t "
        "intervals over the seeds of training. As in Stable-Baselines3, environment i of a run has the run's seed + i: "
        "neighbouring seeds differ in networks and exploration, and share most of their environments' random numbers. "
        "Last: mean over runs of the last policy instead. P(better): "
        "probability that a run's return for a goal is above the scripted policy's, ties counting one half, mean over "
        "goals. Best after: steps to a run's best policy, median. Minutes are those of a run, on one core that others "
        f"may have shared: {hours:.1f} hours in all."
    )
    yield from ("", *cells_table(cells))
    for key, experiment in EXPERIMENTS.items():
        if missing := results.missing(key):
            yield from ("", f"{experiment.title}: no runs of {', '.join(map(display_name, missing))}.")
    yield from ("", "## Figures", "")
    for spec in FIGURES:
        picture = f"{spec.stem}.png"
        yield f"**The paper's figure {spec.number}.** {spec.caption}"
        yield from (f"Missing: {what}." for what in lacking[spec.stem])
        yield from ("", f"![{spec.stem}]({picture})" if (folder / picture).exists() else "(no picture)", "")
    if results.left_out:
        yield from ("## What is in no figure", "", *(f"- {line}" for line in results.left_out))
