"""chemlab plot: books that balance, and pictures that say what was recorded."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import FEATURED, laboratory, mapping, record_episode, refused
from typer.testing import CliRunner

from chemlab.cli import app
from chemlab.config.loading import load_scenario
from chemlab.record import Recorder, RecordError, read_record
from chemlab.render.mole_balance import PLACES, mole_balance
from chemlab.roles.manager_state import INSTRUMENTS

runner = CliRunner()


@pytest.fixture(scope="module")
def scripted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A record of a scripted episode."""
    return record_episode(tmp_path_factory.mktemp("plot") / "scripted.jsonl")


@pytest.mark.parametrize("name", FEATURED)
def test_the_books_balance(name: str, tmp_path: Path) -> None:
    """Of every group there is as much at each stage as the scenario's stock and vessels hold."""
    scenario = load_scenario(name)
    balance = mole_balance(read_record(record_episode(tmp_path / "one.jsonl", name, "careless")))
    contents = [scenario.stock, *(vessel.contents for vessel in scenario.shelf.vessel)]
    start = np.array([sum(held.get(material, 0.0) for held in contents) for material in balance.materials])
    assert balance.groups
    for group in balance.groups:
        totals = balance.amounts(group).sum(axis=(1, 2))
        # What a world has drawn is not what the file says.
        expected = totals[0] if scenario.world.draws else start @ group.weights
        np.testing.assert_allclose(totals, expected, rtol=1e-9)
    for inventory in balance.inventories:
        assert inventory.amounts.min() > -1e-12


def test_places_agree_with_the_record(scripted: Path) -> None:
    """What was submitted is the record's; what is in stock and waste is what its last hidden amounts say."""
    found = read_record(scripted)
    balance = mole_balance(found)
    last = dict(zip(PLACES, balance.inventories[-1].amounts, strict=True))
    assert found.end is not None
    goal = balance.materials.index("dodecane")
    assert last["submitted"][goal] == pytest.approx(found.end["end"]["submitted_mol"], rel=1e-12)
    order = [found.header["materials"].index(material) for material in balance.materials]
    hidden: dict[str, Any] = dict(found.header["hidden"])
    for turn in found.turns:
        hidden.update(turn["hidden"])
    np.testing.assert_allclose(last["stock"], np.array(hidden["stock"])[order], rtol=1e-12)
    thrown = last["samples"] + last["discarded"] + last["lost"]
    np.testing.assert_allclose(thrown, np.array(hidden["waste"])[order], rtol=1e-9, atol=1e-15)


def test_what_instruments_take_is_a_sample(tmp_path: Path) -> None:
    """Three chromatograms take a thousandth each of what is left: 4 (1 - 0.999^3) mol of ether."""
    env = laboratory("wurtz_dodecane")
    actions = env.laboratories.actions
    from chemlab.record import Play

    with Recorder(tmp_path / "m.jsonl", env.laboratories) as recorder:
        recorder.begin(0)
        decisions = [actions.encode("measure", 0, "gas_chromatograph")] * 3
        for action in [*decisions, actions.encode("discard", 1), actions.encode("submit", 0)]:
            seen, _, _, _, info = env.last()
            assert seen is not None
            env.step(action)
            recorder.turn([Play(0, seen, info["action_mask"], action)])
    balance = mole_balance(read_record(tmp_path / "m.jsonl"))
    (ether,) = balance.groups
    last = dict(zip(PLACES, balance.amounts(ether)[-1].sum(axis=1), strict=True))
    expected = {"samples": 4 * (1 - 0.999**3), "discarded": 4.0, "submitted": 4 * 0.999**3, "stock": 12.0}
    for place, mol in expected.items():
        assert last[place] == pytest.approx(mol, rel=1e-9)
    assert last["vessels"] == pytest.approx(0.0, abs=1e-12)
    assert last["lost"] == 0.0


def test_books_that_do_not_balance_are_refused(scripted: Path) -> None:
    balance = mole_balance(read_record(scripted))
    balance.inventories[2].amounts[1, balance.materials.index("dodecane")] += 1e-6
    refused("off by", balance.check)


pytest.importorskip("matplotlib")


def overlaps(figure: Any, inside: float = 1.0) -> list[tuple[str, str]]:
    """Pairs of upright texts whose boxes overlap by more than ``inside`` pixels."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.text import Text

    FigureCanvasAgg(figure).draw()
    texts = [t for t in figure.findobj(Text) if t.get_text().strip() and t.get_visible() and t.get_rotation() == 0.0]
    boxes = [(t.get_text(), t.get_window_extent()) for t in texts]
    found = []
    for i, (one, a) in enumerate(boxes):
        for other, b in boxes[:i]:
            wide = min(a.x1, b.x1) - max(a.x0, b.x0)
            high = min(a.y1, b.y1) - max(a.y0, b.y0)
            if wide > inside and high > inside:
                found.append((one, other))
    return found


@pytest.mark.parametrize(
    ("name", "policy"), [("wurtz_dodecane", "scripted"), ("wurtz_two_lines", "scripted"), ("fictitious", "careless")]
)
def test_no_text_covers_another(name: str, policy: str, tmp_path: Path) -> None:
    from chemlab.render.charts import draw_moles, draw_timeline

    found = read_record(record_episode(tmp_path / "one.jsonl", name, policy))
    assert overlaps(draw_timeline(found)) == []
    assert overlaps(draw_moles(found)) == []


def test_a_long_title_is_within_its_figure(tmp_path: Path) -> None:
    from chemlab.render.charts import draw_moles, draw_timeline

    scenario = load_scenario(mapping("wurtz_dodecane_direct") | {"title": "Many words " * 20})
    found = read_record(record_episode(tmp_path / "one.jsonl", scenario))
    for figure in (draw_timeline(found), draw_moles(found, only=["Na"])):
        overlaps(figure)  # draws
        title = figure._suptitle.get_window_extent()
        assert 0.0 <= title.x0 < title.x1 <= figure.bbox.width


def test_spectra_are_those_that_were_seen(scripted: Path) -> None:
    """Before: 4 mol ether in its own volume; after: as the bench's agent saw it last. Peaks of what is there alone."""
    from chemlab.physics.chemistry import WAVELENGTHS_NM
    from chemlab.render.charts import draw_spectra

    (axes,) = draw_spectra(read_record(scripted)).axes
    lines = {line.get_label(): np.asarray(line.get_ydata()) for line in axes.get_lines()}
    ether = load_scenario("wurtz_dodecane").materials["diethyl_ether"]
    mol_per_l = 1000.0 * ether.density_kg_l / ether.molar_mass_g_mol
    expected = sum(
        mol_per_l * p.height_l_mol * np.exp(-0.5 * ((WAVELENGTHS_NM - p.center_nm) / p.width_nm) ** 2)
        for p in ether.absorption
    )
    np.testing.assert_allclose(lines["before"], np.clip(expected, 0.0, 1.0), atol=1e-6)
    assert np.abs(lines["after"] - lines["before"]).max() > 0.1
    named = {text.get_text() for text in axes.texts}
    assert {"dodecane", "diethyl_ether"} <= named
    assert "water" not in named


def test_charts_of_repairs_and_of_spectra_that_nobody_sees(tmp_path: Path) -> None:
    from chemlab.render.charts import _timeline, draw_spectra

    found = read_record(record_episode(tmp_path / "one.jsonl", "failing"))
    kinds = {strip.kind for strip in _timeline(found, trust=False).strips["manager_0"]}
    assert kinds == {"start", "wait", "measure", "submit", "calibrate", "repair"}
    with pytest.raises(RecordError, match="has no reaction experiment whose spectrum is observed"):
        draw_spectra(found)


def test_timeline_has_every_decision_and_experiment(scripted: Path) -> None:
    from chemlab.render.charts import _timeline, draw_timeline

    found = read_record(scripted)
    timeline = _timeline(found, trust=False)
    assert found.end is not None
    end = found.end["end"]
    assert len(timeline.decisions) == end["manager_actions"]
    assert timeline.ticks[-1] == end["ticks"]
    assert len(timeline.ticks) - 1 == end["manager_actions"] + end["ticks"]
    assert timeline.strips["manager_0"][-1].stop == len(timeline.ticks) - 1  # submitting was the last thing done
    # One agent acts at a time in this episode, so that nobody's time is anybody else's.
    taken = [unit for strips in timeline.strips.values() for strip in strips for unit in range(strip.start, strip.stop)]
    assert sorted(taken) == list(range(len(found.turns)))
    ended = [(agent, score) for turn in found.turns for agent, score in turn.get("scores", {}).items()]
    assert [(agent, score) for agent, _, _, _, score in timeline.experiments] == ended
    assert dict(zip(found.header["agents"], timeline.rewards[-1], strict=True)) == pytest.approx(end["rewards"])
    assert sum(timeline.costs[-1]) == pytest.approx(sum(end["costs"].values()))
    measured = [unit for unit, words in timeline.decisions if words.startswith("measure")]
    paid = np.diff(np.array(timeline.costs)[:, INSTRUMENTS])
    assert measured
    assert measured == np.flatnonzero(paid).tolist(), "a measurement costs when it is taken"
    texts = "\n".join(text.get_text() for text in draw_timeline(found).texts)
    assert "1  start rxn_0 on slot 0, goal dodecane" in texts


@pytest.mark.parametrize(("kind", "ending"), [("timeline", "png"), ("spectra", "svg"), ("moles", "png")])
def test_pictures_are_written_once(kind: str, ending: str, scripted: Path, tmp_path: Path) -> None:
    path = tmp_path / f"picture.{ending}"
    arguments = ["plot", kind, str(scripted), "-o", str(path)]
    done = runner.invoke(app, arguments)
    assert done.exit_code == 0, done.output
    assert path.read_bytes()[:4] == (b"\x89PNG" if ending == "png" else b"<?xm")
    before = path.stat().st_mtime_ns
    again = runner.invoke(app, arguments)
    assert again.exit_code == 2
    assert "--force" in again.output
    assert path.stat().st_mtime_ns == before
    assert list(tmp_path.iterdir()) == [path]
