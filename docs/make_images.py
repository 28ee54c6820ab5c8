"""Make the pictures of README and documentation: ``python docs/make_images.py [SCENARIO ...]``.

Of each scenario, the scripted episode with seed 0 as an animation (``_static/scenarios``) and as a replay page
(``_static/replays``, which is not committed; the scenario's page embeds it); and the pages of ``chemlab serve``. Needs
the extras ``plot``, ``live`` and ``test``, and Chromium.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import threading
import time
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

from chemlab import load_scenario, raw_env
from chemlab.agents.episodes import record_episode
from chemlab.agents.live import Live, live_app, live_server
from chemlab.agents.policies import make_policies
from chemlab.config.files import write_bytes, write_text
from chemlab.config.inherit import campaign_names, scenario_names, synthesis_names
from chemlab.record import read_record
from chemlab.render.animation import animation
from chemlab.render.replay_page import replay_page

FRAMES, SIZE = 16, (640, 360)
HERE = Path(__file__).parent
GALLERY, REPLAYS, IMAGES = HERE / "_static" / "scenarios", HERE / "_static" / "replays", HERE / "images"


def episode(name: str) -> None:
    """Record the scripted episode of a scenario; write its animation and its replay page."""
    laboratory = raw_env(name)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{name}.jsonl"
        record_episode(path, laboratory, make_policies("scripted", laboratory.laboratories, 0), 0, "scripted")
        record = read_record(path)
    write_bytes(GALLERY / f"{name}.webp", animation(record, "webp", frames=FRAMES, size=SIZE))
    write_text(REPLAYS / f"{name}.html", replay_page(record))
    if name == "wurtz_dodecane":  # of README
        write_bytes(IMAGES / "episode.webp", animation(record, "webp", frames=40, size=(960, 540)))


def live(folder: Path, port: int = 8766) -> None:
    """Write pictures of a live page in the middle of an episode, and of a seat whose person has the turn."""
    with tempfile.TemporaryDirectory() as records, sync_playwright() as driver:
        lab = Live(load_scenario("relay"), "scripted", 0, "train", Path(records))
        server = live_server(live_app([lab], ["scripted"], paused=True), "127.0.0.1", port)
        thread = threading.Thread(target=server.run)
        thread.start()
        while not server.started:
            time.sleep(0.05)
        for _ in range(60):
            lab.step()
        lab.taken.add(lab.turn)
        browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        for name, path in (("live", "/"), ("seat", f"/lab/0/seat/{lab.turn}")):
            page = browser.new_page(viewport={"width": 1280, "height": 860})
            page.goto(f"http://127.0.0.1:{port}{path}")
            page.get_by_text("turn", exact=False).first.wait_for()
            page.wait_for_timeout(1000)
            page.screenshot(path=folder / f"{name}.png")
        browser.close()
        server.should_exit = True
        thread.join()
    for name in ("live", "seat"):
        path = folder / f"{name}.png"
        Image.open(path).convert("RGB").quantize(128, dither=Image.Dither.NONE).save(path, optimize=True)


def main() -> None:
    """Write the pictures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scenarios", nargs="*", help="scenarios to play; default: all, and the live page")
    names = parser.parse_args().scenarios
    for folder in (GALLERY, REPLAYS):
        folder.mkdir(parents=True, exist_ok=True)
    for name in names or [*scenario_names(), *campaign_names(), *synthesis_names()]:
        episode(name)
        sizes = [(file.stat().st_size / 1000) for file in (GALLERY / f"{name}.webp", REPLAYS / f"{name}.html")]
        print(f"{name}: animation {sizes[0]:.0f} kB, replay {sizes[1]:.0f} kB", flush=True)
    if not names:
        live(IMAGES)


if __name__ == "__main__":
    main()
