"""The text of an observation: complete, and the same for people and for models."""

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from helpers import FEATURED, laboratory, mapping
from hypothesis import given, settings
from hypothesis import strategies as st

from chemlab.config.loading import load_scenario
from chemlab.lab.engine import Laboratories
from chemlab.lab.text import (
    RoleText,
    Shades,
    blank_channels,
    curve_words,
    describe_laboratory,
    measured_words,
    reading_words,
)
from chemlab.roles.bench import Channel, channel_slices


def live(labs: Laboratories, channels: tuple[Channel, ...]) -> npt.NDArray[np.float32]:
    """An observation in which every channel says something."""
    shades = Shades(labs.scenario)
    parts = []
    for channel in channels:
        if channel.unit == "one-hot":
            parts.append(np.eye(channel.size)[0])
        elif channel.unit == "0 or 1":
            parts.append(np.ones(1))
        elif channel.unit == "grey":
            parts.append(np.full(channel.size, labs.scenario.materials[shades.names[1]].shade))
        else:
            parts.append(np.full(channel.size, 0.5))
    return np.concatenate(parts).astype(np.float32)


def variants(labs: Laboratories, channel: Channel) -> list[npt.NDArray[Any]]:
    """Values of a channel that all differ from each other by more than what is displayed."""
    n = channel.size
    if channel.unit == "one-hot":
        return [*np.eye(n), *([np.zeros(n)] if n > 1 else [])]
    if channel.unit == "0 or 1":
        return [np.zeros(1), np.ones(1)]
    if channel.unit == "grey":
        shades = [labs.scenario.materials[name].shade for name in Shades(labs.scenario).names]
        rows = [np.full(n, shade) for shade in shades]
        for first in (0, 40, 95):  # a layer elsewhere, and a single pixel
            for size in (1, 5):
                rows.append(rows[1].copy())
                rows[-1][first : first + size] = shades[0] if first < 95 else shades[-1]
        return rows if len(shades) > 2 else rows[:-2]
    rows = [np.full(n, level) for level in (0.0, 0.2, 0.45, 0.7, 1.0)]
    # Of a spectrum every seventh value; of what is shorter, all.
    for i in range(0, n, 7 if n > 40 else 1) if n > 1 else ():
        rows.append(np.full(n, 0.3))
        rows[-1][i] = 0.6
    return rows


@pytest.mark.parametrize("name", FEATURED)
def test_observations_that_differ_in_a_channel_differ_in_text(name: str) -> None:
    labs = Laboratories(load_scenario(name))
    for agent in range(len(labs.agents)):
        channels = tuple(labs.roles[agent].channels)
        view, base, slices = RoleText(labs, agent), live(labs, channels), channel_slices(channels)
        blank = blank_channels(labs.benches[agent - 1]) if agent else []
        for channel in [channel for channel in channels if channel.name not in blank]:
            texts = {}
            for values in variants(labs, channel):
                seen = base.copy()
                seen[slices[channel.name]] = values
                text = view.text(seen)
                assert text not in texts, f"{labs.agents[agent]}: {channel.name}: {values} and {texts[text]}: {text}"
                texts[text] = values


@given(st.lists(st.floats(0.0, 1.0), min_size=20, max_size=60))
@settings(max_examples=40)
def test_a_curve_in_words_is_within_its_error(values: list[float]) -> None:
    words = curve_words(Channel("x", len(values), "volts", 0.0, 1.0, "a curve"), np.array(values))
    points = [tuple(map(float, point.split(":"))) for point in words.removeprefix("index:% ").split()]
    places, heights = zip(*points, strict=True)
    again = np.interp(np.arange(len(values)), places, np.array(heights) / 100.0)
    assert np.abs(again - values).max() <= 0.05 + 0.005 + 1e-9


def test_layers_in_words_are_heights() -> None:
    scenario = load_scenario("wurtz_dodecane")
    shade = {name: scenario.materials[name].shade for name in ("water", "diethyl_ether", "air")}
    shades = Shades(scenario)
    layered = np.repeat([shade["water"], shade["diethyl_ether"], shade["air"]], [50, 30, 20])
    assert shades.words(layered) == "water 0-50, diethyl_ether 50-80"
    mixed = np.concatenate([[shade["water"]] * 10, [shade["water"], shade["diethyl_ether"]] * 20, [shade["air"]] * 50])
    assert shades.words(mixed) == "water 0-11, mixed 11-50 (water 19/diethyl_ether 20)"
    assert shades.words(np.full(100, shade["air"])) == "empty"


def test_orders_reports_and_vessels_at_benches_are_told() -> None:
    """Terms of orders, and what became of a vessel that the manager has sent to a bench."""
    env = laboratory("relay")
    labs = env.laboratories
    view = RoleText(labs, 0)
    first = view.text(env.observe("manager_0"))
    assert "not arrived yet" in first
    assert "empty" in first or "slots" in first
    start = labs.actions.encode("start", "rxn_0", 0, "F", "quick")
    env.step(start)
    view.acted(start)
    assert "slot 0: vessel at rxn_0 (before: " in view.text(env.observe("manager_0"))
    assert "reported" not in first
    said = ""
    while labs.state.busy.any():
        env.step(labs.actions.encode("wait") if env.agent_selection == "manager_0" else np.full(3, 0.5))
        later = view.text(env.observe("manager_0"))
        said += later
    assert "vessel at" not in later
    for part in ("reported amount", "price", "ticks left", "amount at least", " steps left"):
        assert part in said


@pytest.mark.parametrize(("noise", "apart"), [(0.01, 1.0), (0.0003, 0.1)])
def test_readings_are_as_exact_as_their_noise(noise: float, apart: float) -> None:
    """To a digit finer than that of the noise, and without digits that do not occur."""
    tables = mapping("unlabelled")
    tables["instruments"]["probe"] = {"kind": "thermometer", "noise": noise}
    labs = Laboratories(load_scenario(tables))
    number = labs.instruments.names.index("probe")
    channel = labs.instruments.channels[number]
    span = channel.high - channel.low
    assert 1.0 <= span / 100.0 < 10.0
    warm = [300.0 + apart * i for i in range(20)]
    words = [measured_words(labs, number, np.array([(one - channel.low) / span], np.float32)) for one in warm]
    assert words == [f"{round(one, 1):g} K" for one in warm]


def test_a_laboratory_is_described_as_its_manager_sees_it() -> None:
    """No goal before its order has arrived, and fill levels as the gauge shows them."""
    demand = {"demand": {"order": [{"arrives": 50}]}, "limits": {"ticks": 200}}
    env = laboratory({"base": "wurtz_any", "shelf": {"gauge": 0.1}, **demand})
    labs = env.laboratories
    vessel, seen = labs.shelf.vessel(0, 0), env.observe("manager_0")[channel_slices(labs.channels)["slot_0_fill"]]
    text = describe_laboratory(labs)
    assert "goal unknown" in text
    assert f"] {seen.item() * vessel.capacity_l:.2f}/{vessel.capacity_l:.2f} L" in text
    assert f"{vessel.volume_l:.2f}/" not in text


def test_a_bench_is_described_as_it_is() -> None:
    """With a jacket and a condenser, without them, and with a jacket alone."""
    tables = mapping("wurtz_real")
    tables["benches"]["rxn"].pop("condenser_w")
    for scenario, jacket, opened in (
        (load_scenario("wurtz_real"), " of the jacket", True),
        (load_scenario("wurtz_dodecane"), "", False),
        (load_scenario(tables), " of the jacket", False),
    ):
        bench = Laboratories(scenario).benches[0]
        meaning = {channel.name: channel.meaning for channel in bench.channels}
        temperature, volume = bench.action_meanings[:2]
        assert temperature.startswith(f"temperature{jacket}: 0 = {bench.options.temperature_k.step:g} K down")
        assert ("no effect" in volume, "no effect" in meaning["volume"]) == (opened, opened)
        pressure = "vapour pressure of the contents (open through a condenser)" if opened else "pressure in the sealed"
        assert meaning["pressure"].startswith(pressure)


def test_readings_of_records_are_complete() -> None:
    env = laboratory("unlabelled")
    labs = env.laboratories
    env.step(labs.actions.encode("measure", 0, "uv_vis"))
    words = reading_words(labs, 0, "uv_vis")
    assert words.startswith("nm:% 200:")
    assert "price 0.02" in words
