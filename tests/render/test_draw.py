"""Pictures are true to their scenes, readable, the same every time, and drawn without a screen."""

import copy
import dataclasses
import itertools
import subprocess
import sys
from collections import Counter
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
import pytest
from helpers import FEATURED, refused
from moments import EVERY_BENCH, crowd, episode, experiment, filled

from chemlab.envs.role_env import RoleEnv
from chemlab.physics.shelf import T_MIX
from chemlab.render import draw as drawing
from chemlab.render.canvas import TextBox
from chemlab.render.draw import GlassBox, draw, paint
from chemlab.render.frames import Viewer
from chemlab.render.scene import Scene, VesselPicture, laboratory_scene


def rgb(color: str) -> tuple[int, ...]:
    return tuple(bytes.fromhex(color[1:]))


def rows_of(pixels: npt.NDArray[np.uint8], glass: GlassBox) -> list[tuple[int, ...]]:
    """The most frequent colour (there are tags, and corners) of each row of a vessel's inside, bottom first."""
    box = glass.box
    inside = pixels[box.top : box.bottom, box.left : box.right]
    return [Counter(map(tuple, row.tolist())).most_common(1)[0][0] for row in inside[::-1]]


def vessels_of(scene: Scene) -> dict[tuple[str, str], VesselPicture]:
    found = {("shelf", slot.vessel.position): slot.vessel for slot in scene.shelf if slot.vessel is not None}
    return found | {(bench.agent, vessel.position): vessel for bench in scene.benches for vessel in bench.vessels}


def check_proportions(scene: Scene, width: int = 960, height: int = 540) -> int:
    """Rows of every layer against its volume, within the pixel by which a boundary is rounded; layers checked."""
    painting = paint(scene, width, height)
    pixels = np.asarray(painting.image)
    vessels = vessels_of(scene)
    assert {(glass.owner, glass.position) for glass in painting.glasses} == set(vessels)
    checked = 0
    for glass in painting.glasses:
        vessel = vessels[glass.owner, glass.position]
        tall = glass.box.bottom - glass.box.top
        assert tall == pytest.approx(vessel.capacity_l * glass.pixels_per_l, abs=0.5 + 1e-9)
        if vessel.mixture:
            continue
        rows = Counter(rows_of(pixels, glass)[2:])  # the lowest two are round corners more than anything else
        reached = 0.0
        for layer in vessel.layers:
            low, reached = reached, reached + layer.volume_l * glass.pixels_per_l
            expected = min(reached, tall) - max(low, 2.0)
            if expected > 2.0:
                assert abs(rows[rgb(layer.color)] - expected) <= 1.0, (glass, layer)
                checked += 1
        air = tall - max(reached, 2.0)
        if air > 2.0:
            assert abs(rows[rgb(drawing.AIR)] - air) <= 1.0
    for owner in {glass.owner for glass in painting.glasses}:
        assert len({glass.pixels_per_l for glass in painting.glasses if glass.owner == owner}) == 1
    return checked


@pytest.mark.parametrize("name", ["failing", "recrystallization", "wurtz_two_lines"])
def test_layers_are_as_high_as_their_volumes(name: str) -> None:
    # A short episode with few pictures.
    least = 3 if name == "recrystallization" else 5
    assert sum(check_proportions(scene) for scene in episode(name)[::2]) >= least


def test_a_stirred_vessel_has_the_mean_colour_up_to_its_fill_level() -> None:
    scene = laboratory_scene(filled({"diethyl_ether": 4.0, "water": 20.0}, clock=T_MIX))
    painting = paint(scene)
    glass, vessel = painting.glasses[0], vessels_of(scene)["shelf", "slot 0"]
    volumes = np.array([layer.volume_l for layer in vessel.layers])
    colors = np.array([rgb(layer.color) for layer in vessel.layers])
    mean = tuple(np.rint(volumes @ colors / volumes.sum()).astype(int).tolist())
    rows = Counter(rows_of(np.asarray(painting.image), glass))
    assert rows[mean] == pytest.approx(vessel.volume_l * glass.pixels_per_l, abs=3.0)


def check_text(texts: Sequence[TextBox], width: int, height: int) -> None:
    for text, box in texts:
        assert 0 <= box.left <= box.right <= width, text
        assert 0 <= box.top <= box.bottom <= height, text
    for (one, a), (two, b) in itertools.combinations(texts, 2):
        apart = a.right <= b.left or b.right <= a.left or a.bottom <= b.top or b.bottom <= a.top
        assert apart, f"{one!r} at {a} overlaps {two!r} at {b}"


@pytest.mark.parametrize("size", [(960, 540), (480, 270), (800, 800)])
@pytest.mark.parametrize("name", FEATURED)
def test_no_text_overlaps_in_a_laboratory(name: str, size: tuple[int, int]) -> None:
    for scene in episode(name):
        check_text(paint(scene, *size).texts, *size)


@pytest.mark.parametrize(("name", "key"), EVERY_BENCH)
def test_no_text_overlaps_on_a_bench(name: str, key: str) -> None:
    for scene in experiment(name, key):
        check_text(paint(scene).texts, 960, 540)


@pytest.mark.parametrize("size", [(960, 540), (640, 480)])
@pytest.mark.parametrize("numbers", [(12, 2, 2, 3), (8, 2, 2, 2), (26, 1, 1, 1), (3, 1, 1, 1), (6, 16, 1, 1)])
def test_no_text_overlaps_in_a_crowd(numbers: tuple[int, int, int, int], size: tuple[int, int]) -> None:
    for scene in crowd(*numbers):
        check_text(paint(scene, *size).texts, *size)


def worst(scene: Scene) -> Scene:
    """A scene in which every name and number is long."""
    long = "4-ethyl-5-methyl-2,2-dimethoxynonadecane hydrate"
    materials = tuple(dataclasses.replace(material, name=f"{material.name} {long}") for material in scene.materials)
    events = (("spill_l", 12.3456), ("relief_valve_mol", 12.3456), ("unheard_of_event", 1e9))
    busy: Any = {"goal": long, "busy": True, "step": 9999, "step_limit": 9999, "events": events}
    benches = tuple(dataclasses.replace(bench, **busy) for bench in scene.benches)
    names = ("manager_actions", "manager_action_limit", "ticks", "tick_limit")
    return dataclasses.replace(
        scene,
        **dict.fromkeys(names, 999_999),  # type: ignore[arg-type]
        turn="distillation_15",
        orders=tuple(dataclasses.replace(order, goal=long, filled=True) for order in scene.orders) * 4,
        result=-12.3456,
        costs=tuple((item, 12.3456) for item, _ in scene.costs),
        safety=tuple((kind, 1234.5678) for kind in drawing.EVENT_WORDS),
        stock=tuple(dataclasses.replace(b, material=f"{b.material} {long}", mol=9999.0) for b in scene.stock) * 3,
        waste_l=1234.5,
        benches=benches,
        materials=materials,
    )


@pytest.mark.parametrize("kind", ["laboratory", "crowd", "bench"])
def test_no_text_overlaps_where_names_and_numbers_are_long(kind: str) -> None:
    scenes = {
        "laboratory": lambda: episode("wurtz_any")[-3],
        "crowd": lambda: crowd(12, 2, 2, 3)[-1],
        "bench": lambda: experiment("fictitious", "rxn")[2],
    }
    check_text(paint(worst(scenes[kind]())).texts, 960, 540)


def test_the_check_of_texts_would_see_an_overlap() -> None:
    texts = paint(episode("wurtz_any")[0]).texts
    moved = texts[0]._replace(box=texts[1].box)
    with pytest.raises(AssertionError, match="overlaps"):
        check_text([texts[1], moved], 960, 540)


def test_a_scene_is_drawn_the_same_every_time() -> None:
    scene = episode("wurtz_dodecane")[5]
    first = draw(scene)
    assert (first.shape, first.dtype) == ((540, 960, 3), np.uint8)
    drawing._background.cache_clear()
    drawing._glass.cache_clear()
    np.testing.assert_array_equal(draw(scene), first)
    first[:] = 0  # an array of its own
    assert draw(scene).any()
    refused(r"480 x 270, .* given 479 x 540", draw, scene, 479, 540)


@pytest.mark.parametrize(("name", "key"), [("relay", "rxn"), ("crude", "ext"), ("crude", "dit"), ("refine", "rxn")])
def test_a_bench_renders_arrays(name: str, key: str) -> None:
    env = gymnasium.make("chemlab/Bench-v1", scenario=name, bench=key, render_mode="rgb_array")
    env.reset(seed=0)
    frame = env.render()
    assert isinstance(frame, np.ndarray)
    assert frame.shape == (540, 960, 3)
    bench = env.unwrapped
    assert isinstance(bench, RoleEnv)
    before = bench.get_state()
    np.testing.assert_array_equal(env.render(), frame)
    for array, kept in zip(bench.get_state(), before, strict=True):
        np.testing.assert_array_equal(array, kept)
    np.testing.assert_array_equal(copy.deepcopy(bench).render(), frame)
    env.close()


def test_pictures_need_pillow_and_neither_a_screen_nor_pygame() -> None:
    """Without Pillow they say what is missing."""
    code = (
        "import os, sys; os.environ.pop('DISPLAY', None); sys.modules['pygame'] = None\n"
        "from chemlab.envs.role_env import RoleEnv\n"
        "assert 'PIL' not in sys.modules, 'imported before it is needed'\n"
        "env = RoleEnv(bench='rxn', render_mode='rgb_array'); env.reset(seed=0); sys.modules['PIL'] = None\n"
        "try:\n    env.render()\nexcept ImportError as error:\n    print(error)\n"
        "del sys.modules['PIL']; print(env.render().shape)\n"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    missing, shape = run.stdout.splitlines() or ["", run.stderr]
    assert ".[plot]" in missing, run.stderr
    assert shape == "(540, 960, 3)"


def test_a_window_shows_the_same_frames_and_closes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    pygame = pytest.importorskip("pygame")
    scene = episode("wurtz_dodecane")[5]
    viewer = Viewer("human", 1000)
    assert viewer.show(scene) is None
    shown = pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)
    np.testing.assert_array_equal(shown, draw(scene))
    assert scene.title in pygame.display.get_caption()[0]
    viewer.close()
    assert not pygame.display.get_init()
    viewer.show(scene)  # opens again
    other = Viewer("human", 1000)
    other.show(scene)
    viewer.close()
    other.show(scene)  # a process has one window
    viewer.show(scene)
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    for _ in range(2):
        viewer.show(scene)  # its user has closed it
        assert not pygame.display.get_init()
    viewer.close()
