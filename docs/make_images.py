"""Make the pictures of README and documentation: ``python docs/make_images.py``.

They show one scripted episode of wurtz_dodecane (seed 0), drawn by ``render()``: a still from its middle and an
animation of the whole episode. Needs the extra ``plot``.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from chemlab import raw_env
from chemlab.agents.episodes import Turn, play_episode
from chemlab.agents.policies import make_policies

FRAMES, WIDTH, HEIGHT = 40, 640, 360
Frame = npt.NDArray[np.uint8]


def record(scenario: str, seed: int) -> tuple[list[Frame], list[Turn]]:
    """Return the picture after every turn of a scripted episode, and the turns."""
    env = raw_env(scenario, render_mode="rgb_array")
    frames: list[Frame] = []
    turns: list[Turn] = []

    def watch(turn: Turn) -> None:
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
    for file in sorted(arguments.out.iterdir()):
        print(f"{file}: {file.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
