"""Loading time of replay pages of long episodes in a headless Chromium.

Run ``python studies/speed/replay.py`` (``--json`` for machines). Needs Playwright (extra ``test``) and ``chromium``.
Each scenario is played by its random policies; loading ends when the page is completely drawn.
"""

from __future__ import annotations

import argparse
import shutil
import statistics
import tempfile
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright
from report import arguments, report

from chemlab import raw_env
from chemlab.agents.episodes import record_episode
from chemlab.agents.policies import make_policies
from chemlab.config.display import markdown_table
from chemlab.config.inherit import scenario_names
from chemlab.record import read_record
from chemlab.render.replay_page import replay_page

FLAGS = ["--no-sandbox", "--disable-gpu"]


def page_of(name: str, folder: Path) -> Path:
    """Return the page of the longest of ten episodes."""
    env = raw_env(name)
    pages = []
    for seed in range(10):
        path = folder / f"{name}-{seed}.jsonl"
        record_episode(path, env, make_policies("random", env.laboratories, seed), seed)
        pages.append(replay_page(read_record(path)))
    page = folder / f"{name}.html"
    page.write_text(max(pages, key=len), encoding="utf-8")
    return page


def load(browser: Any, page: Path) -> float:
    """Return ms from the request to the end of the load event."""
    tab = browser.new_page()
    tab.goto(page.as_uri())
    tab.wait_for_selector("#slots svg")
    spent = tab.evaluate("performance.timing.loadEventEnd - performance.timing.navigationStart")
    tab.close()
    return float(spent)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--loads", type=int, default=5, help="times each page is loaded")
    given = arguments(parser)
    results = {}
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=shutil.which("chromium"), headless=True, args=FLAGS)
        for name in scenario_names():
            page = page_of(name, Path(folder))
            times = [load(browser, page) for _ in range(given.loads)]
            results[name] = {
                "kilobytes": round(page.stat().st_size / 1000.0),
                "median_ms": statistics.median(times),
                "slowest_ms": max(times),
            }
        browser.close()
    columns = {"": False, "size (kB)": True, "median (ms)": True, "slowest (ms)": True}
    rows = [[name, *(f"{figure:.0f}" for figure in result.values())] for name, result in results.items()]
    report(given, results, {"replay": markdown_table(columns, rows)})


if __name__ == "__main__":
    main()
