"""Make the pictures of README and documentation: ``python docs/make_images.py``.

They show one scripted episode of wurtz_dodecane (seed 0), drawn by ``render()``: a still from its middle and an
animation of the whole episode; and the pages of ``chemlab serve``. Needs the extras ``plot`` and ``test``, and
Chromium.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image
from playwright.sync_api import sync_playwright

from chemlab import load_scenario, raw_env
from chemlab.agents.episodes import PlayedTurn, play_episode
from chemlab.agents.live import Live, live_app, live_server
from chemlab.agents.policies import make_policies

FRAMES, WIDTH, HEIGHT = 40, 640, 360
Frame = npt.NDArray[np.uint8]


def record(scenario: str, seed: int) -> tuple[list[Frame], list[PlayedTurn]]:
    """Return the picture after every turn of a scripted episode, and the turns."""
    env = raw_env(scenario, render_mode="rgb_array")
    frames: list[Frame] = []
    turns: list[PlayedTurn] = []

    def watch(turn: PlayedTurn) -> None:
        frame: Any = env.render()
        frames.append(frame)
        turns.append(turn)

    env.reset(seed=seed)
    play_episode(env, make_policies("scripted", env.laboratories, seed), seed, watch=watch)
    return frames, turns


def animation(frames: list[Frame], path: Path) -> None:
    """Write evenly chosen frames as an animated WebP; the first and the last are shown longer."""
    chosen = [frames[round(i)] for i in np.linspace(0, len(frames) - 1, FRAMES)]
    images = [Image.fromarray(frame).resize((WIDTH, HEIGHT), Image.Resampling.LANCZOS) for frame in chosen]
    milliseconds = [1500, *[300] * (FRAMES - 2), 4000]
    images[0].save(path, save_all=True, append_images=images[1:], duration=milliseconds, loop=0, quality=70, method=6)


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
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "images", help="folder of the pictures")
    parser.add_argument("--scenario", default="wurtz_dodecane", help="scenario to play")
    parser.add_argument("--seed", type=int, default=0, help="the episode's seed")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    frames, turns = record(arguments.scenario, arguments.seed)
    # Show a vessel with two layers: the state after the last settling, else the middle of the episode.
    settled = [i for i, turn in enumerate(turns) if turn.meaning.startswith("settle")]
    middle = settled[-1] if settled else len(frames) // 2
    still = Image.fromarray(frames[middle]).quantize(128, dither=Image.Dither.NONE)
    still.save(arguments.out / "laboratory.png", optimize=True)
    animation(frames, arguments.out / "episode.webp")
    live(arguments.out)
    for file in sorted(arguments.out.iterdir()):
        print(f"{file}: {file.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
