"""A user's parts, one of every kind in ``my_laboratory.toml``: they do what they say, and mistakes name them."""

import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from helpers import laboratory, litres

from chemlab.config.datafile import DataError
from chemlab.config.parts import PartError
from chemlab.envs.aec import raw_env
from chemlab.envs.role_env import RoleEnv
from chemlab.lab.engine import Laboratories
from chemlab.lab.text import named_costs, named_events, reading_words
from chemlab.physics.chemistry import AMOUNTS, CLOCK
from chemlab.render.scene import laboratory_scene
from chemlab.roles.bench import channel_slices

HERE = Path(__file__).parent
FILE = HERE / "my_laboratory.toml"
A_TENTH, A_QUARTER, EVERYTHING, DRAIN_10, DRAIN_50, WATER, END = range(7)
"""The extraction bench's actions."""


def copied(folder: Path, old: str = "", new: str = "", parts: str = "") -> Path:
    """The scenario in another folder, with its parts; a text of it replaced, ``parts`` added to ``my_parts.py``."""
    text = FILE.read_text().replace("../bench/", f"{HERE.parent}/bench/")
    assert old in text
    (folder / "my_parts.py").write_text((HERE / "my_parts.py").read_text() + parts)
    path = folder / "my_laboratory.toml"
    path.write_text(text.replace(old, new) if old else text)
    return path


def channel(laboratories: Laboratories, agent: int, name: str, member: int = 0) -> npt.NDArray[np.float32]:
    """What an agent sees in one of its channels."""
    seen = laboratories.observe(agent, np.array([member]))[0]
    return np.asarray(seen[channel_slices(laboratories.roles[agent].channels)[name]])


def test_the_instrument_reads() -> None:
    env = laboratory(FILE, render_mode="ansi")
    labs, shelf = env.laboratories, env.laboratories.shelf
    shelf.fill(0, 0, 1.2, {"water": 20.0, "diethyl_ether": 3.0})
    water, ether = litres(env.scenario, {"water": 20.0}), litres(env.scenario, {"diethyl_ether": 3.0})
    index = (water * 1.3330 + ether * 1.3526) / (water + ether)
    assert channel(labs, 0, "slot_0_refractometer_age")[0] == 1.0
    env.step(labs.actions.encode("measure", 0, "refractometer"))
    assert channel(labs, 0, "slot_0_refractometer")[0] == pytest.approx((index - 1.3) / 0.2, rel=1e-6)
    assert channel(labs, 0, "slot_0_refractometer_age")[0] == 0.0
    assert named_costs(env.infos["manager_0"])["instruments"] == pytest.approx(0.001)
    # Its sample is in the waste can, which the manager's own channel shows.
    assert shelf.waste[0, shelf.layout.index("water")] == pytest.approx(0.2)
    assert channel(labs, 0, "waste_can")[0] == pytest.approx(0.01 * (water + ether) / 5.0, rel=1e-6)
    number = labs.instruments.names.index("refractometer")
    start = labs.instruments.start[number]
    assert labs.instruments.words(number, labs.state.reading[0, 0, start : start + 1]) == f"{index:.3f} n_D"
    # What is drawn and told of it.
    assert "refractometer" in str(env.render())
    assert "refractometer" in repr(laboratory_scene(labs))


def test_the_operation_acts() -> None:
    env = RoleEnv(FILE, bench="ext", goals="dodecane")
    observation, info = env.reset(seed=0)
    assert env.action_meanings[A_QUARTER] == "blow diethyl_ether off EV, 25 %"
    shelf, experiments, spec = env.batch.shelf, env.batch.experiments, env.batch.scenario
    ether, vessel = shelf.layout.index("diethyl_ether"), shelf.vessel(0, 0)
    before = vessel.amounts()
    observation, reward, _, _, info = env.step(A_QUARTER)
    after = vessel.amounts()
    assert after["diethyl_ether"] == pytest.approx(3.0, rel=1e-12)
    assert shelf.waste[0, ether] == pytest.approx(1.0, rel=1e-12)
    # Some salt precipitates; nothing else has left.
    assert after["NaCl"] > before["NaCl"]
    assert after["NaCl"] + after["Na+"] == pytest.approx(before["NaCl"] + before["Na+"], rel=1e-12)
    # The event is counted, weighs 0.5, and costs no reward here; the reward is the bench's own term.
    assert named_events(spec, info) == pytest.approx({"vapour_mol": 1.0})
    assert info["cost"] == pytest.approx(0.5)
    filled = litres(spec, after)
    assert reward == pytest.approx(-0.01 * filled, rel=1e-9)
    grams = sum(mol * spec.materials[name].molar_mass_g_mol for name, mol in after.items())
    sees = channel_slices(env.bench.channels)["hydrometer"]
    assert observation[sees][0] == pytest.approx(grams / 1000.0 / filled / 2.0, rel=1e-6)
    assert sees.stop == len(observation)
    env.step(WATER)
    stirred = vessel.row[CLOCK]
    env.step(A_TENTH)
    assert vessel.row[CLOCK] == pytest.approx(stirred + 0.5)
    assert experiments.events[0, -1] == pytest.approx(0.3)
    _, _, _, _, info = env.step(EVERYTHING)
    assert info["action_mask"].tolist() == [0, 0, 0, 1, 1, 1, 1]
    left = shelf.rows.copy()
    _, reward, _, _, info = env.step(A_TENTH)
    assert info["illegal_action"]
    assert not info["events"].any()
    np.testing.assert_array_equal(shelf.rows[:, AMOUNTS:], left[:, AMOUNTS:])
    assert reward == pytest.approx(-spec.costs.illegal_action - 0.01 * vessel.volume_l, rel=1e-9)


def test_rewards_in_the_laboratory() -> None:
    env = laboratory(FILE)
    labs = env.laboratories
    measure = labs.actions.encode("measure", 1, "refractometer")
    env.step(measure)
    assert env.rewards["manager_0"] == 0.0  # the reading is of this tick
    env.step(labs.actions.encode("start", "ext_0", 0, "dodecane"))
    assert env.rewards["ext_0"] == 0.0  # no action of its own yet
    env.step(labs.actions.encode("wait"))
    assert env.agent_selection == "ext_0"
    env.step(A_TENTH)
    assert env.rewards["ext_0"] == pytest.approx(-0.01 * litres(env.scenario, {"diethyl_ether": 3.6}), rel=1e-9)
    assert named_events(env.scenario, env.infos["ext_0"]) == pytest.approx({"vapour_mol": 0.4})
    env.step(END)
    assert env.agent_selection == "manager_0"
    env.step(measure)  # of slot 1 again: nothing else has been read
    assert env.rewards["manager_0"] == 0.0
    env.step(labs.actions.encode("start", "fil_0", 0, "dodecane"))
    env.step(labs.actions.encode("wait"))
    env.step(1)
    env.step(labs.actions.encode("measure", 0, "balance"))
    assert env.rewards["manager_0"] == pytest.approx(-0.001)  # one reading is a tick old
    assert labs.safety_totals[0, -1] == pytest.approx(0.4)


def test_a_kernel_is_the_same_operation(tmp_path: Path) -> None:
    (tmp_path / "my_kernels.py").write_text((HERE / "my_kernels.py").read_text())
    plain = RoleEnv(FILE, bench="ext")
    compiled = RoleEnv(copied(tmp_path, '"my_parts.py:EVAPORATE"', '"my_kernels.py:EVAPORATE"'), bench="ext")
    for env in (plain, compiled):
        env.reset(seed=3)
    for action in (A_TENTH, WATER, DRAIN_10, A_QUARTER, EVERYTHING, A_TENTH, DRAIN_50):
        one, other = plain.step(action), compiled.step(action)
        np.testing.assert_array_equal(one[0], other[0])
        assert one[1] == other[1]
        np.testing.assert_array_equal(one[4]["events"], other[4]["events"])
        np.testing.assert_array_equal(plain.batch.shelf.rows, compiled.batch.shelf.rows)


def test_another_process_finds_the_files(tmp_path: Path) -> None:
    """One that has never seen the scenario, and runs elsewhere."""
    env = RoleEnv(FILE, bench="fil"), RoleEnv(FILE, bench="ext")
    for each in env:
        each.reset(seed=1)
    (tmp_path / "envs").write_bytes(pickle.dumps(env))
    code = "import pickle; print([float(e.step(0)[1]) for e in pickle.load(open('envs', 'rb'))])"
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == str([float(each.step(0)[1]) for each in env])


MISTAKES = """
from dataclasses import replace as _replace
DARK = _replace(HYDROMETER, see=lambda bench, shelf, experiments, members: np.zeros(len(members)))
KELVIN = _replace(HYDROMETER, see=lambda bench, shelf, experiments, members: np.full((len(members), 1), 298.15))
NAMELESS = _replace(HYDROMETER, channel=lambda bench: "hydrometer")
LAMP = _replace(REFRACTOMETER, read=lambda reading, chem: reading.out.fill(1.5))
BROKEN_LAMP = _replace(REFRACTOMETER, read=lambda reading, chem: reading.out.fill(np.nan))
RENAMED = _replace(REFRACTOMETER, channel=lambda name, analytes: Channel("other", 1, "n_D", 0.0, 1.0, ""))
SILENT = _replace(EVAPORATE, act=lambda turn, chem: None)
WORDY = _replace(EVAPORATE, words="blow {material} off {vesel}")
GREEDY = _replace(EVAPORATE, act=lambda turn, chem: turn.row.__setitem__(AMOUNTS + turn.material, -1.0) or 0.0)
LAWLESS = _replace(EVAPORATE, legal=lambda turn, chem: turn.no_such_field)
UNLUCKY = _replace(EVAPORATE, act=lambda turn, chem: turn.events.fill(np.nan) or 0.0)
LEAKY = _replace(EVAPORATE, act=lambda turn, chem: turn.waste.fill(np.nan) or 0.0)
GIVER = _replace(REFRACTOMETER, read=lambda reading, chem: 0.5)
EATER = _replace(REFRACTOMETER, read=lambda reading, chem: reading.out.fill(0.5) or reading.row.fill(np.nan))
MUTE = _replace(REFRACTOMETER, words=lambda values, channel, analytes: f"{values[1]:.2f}")
HALF = _replace(REFRACTOMETER, channel=lambda name, analytes: Channel(name, 1.5, "n_D", 0.0, 1.0, ""))
def nothing(bench, shelf, experiments, members):
    return np.full(len(members), np.nan)
def scalar(bench, shelf, experiments, members):
    return [[0.0]]
"""


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("my_parts.py:REFRACTOMETER", "no_file.py:REFRACTOMETER", "refractometer.kind: .*no file .*no_file.py"),
        ("my_parts.py:REFRACTOMETER", "my_parts.py:SPECTROMETER", r"no 'SPECTROMETER'; it has (?!.*Turn).*REFRACTO"),
        ("my_parts.py:REFRACTOMETER", "refractometer", "unknown kind 'refractometer'; choose from uv_vis"),
        ("my_parts.py:REFRACTOMETER", "my_parts.py:EVAPORATE", "must be a chemlab.roles.instruments.Instrument"),
        ("my_parts.py:EVAPORATE", "my_parts.py:REFRACTOMETER", "must be a chemlab.roles.operations.Operation"),
        ("my_parts.py:EVAPORATE", "evaporate", "process.0: kind: must be one of drain"),
        ("my_parts.py:HYDROMETER", "my_parts.py:float_hydrometer", "must be a chemlab.roles.bench.Observation"),
        ("my_parts.py:HYDROMETER", "my_parts.py", "ext.observe: cannot load 'my_parts.py' .*no colon"),
        ("my_parts.py:concentrate", "my_parts.py:LOW", "ext.reward: .*must be a .*Callable"),
        (
            'concentrate"',
            'concentrate", "my_parts.py:concentrate"',
            "ext.reward: '.*:concentrate' is named twice",
        ),
        ("my_parts.py:WASTE_CAN", "no_module:CAN", "manager.observe: .*ModuleNotFoundError: .*no_module"),
        ("filtration_bench.py:FiltrationBench", "filtration_bench.py:FiltrationOptions", "subclass of .*Bench"),
        ('HYDROMETER"', 'HYDROMETER", "./my_parts.py:HYDROMETER"', "ext: two .* channels are named 'hydrometer'"),
        ("refractometer =", "uv_vis_age =", "manager: two observation channels are named 'slot_0_uv_vis_age'"),
        ('material = "diethyl_ether"', "", "process.0: material: required by add, my_parts.py:EVAPORATE, and not"),
        ("\nevents = {", "\n# {", r"vapour_mol: unknown safety event; .*declare your own under safety.events"),
    ],
)
def test_what_cannot_be_loaded_is_named(tmp_path: Path, old: str, new: str, says: str) -> None:
    path = copied(tmp_path, old, new)
    with pytest.raises(DataError, match=says) as caught:
        raw_env(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("line", "says"), [("unheard_of", "NameError: .*'unheard_of'"), ("raise SystemExit(0)", "SystemExit: 0")]
)
def test_a_file_that_does_not_run_is_named(tmp_path: Path, line: str, says: str) -> None:
    with pytest.raises(DataError, match=rf"cannot load 'my_parts.py:\w+' \({says}"):
        raw_env(copied(tmp_path, parts=f"\n{line}\n"))


def test_parts_of_a_base_are_found_from_another_folder(tmp_path: Path) -> None:
    """Two files deep: a name is of the folder of the file that says it."""
    below = tmp_path / "below"
    below.mkdir()
    (tmp_path / "first.toml").write_text(f'base = "{FILE}"\nname = "first"\n[costs]\ntick = 0.0\n')
    own = '[manager]\nobserve = ["my_parts.py:WASTE_CAN"]\n'
    (below / "second.toml").write_text(f'base = "../first.toml"\nname = "second"\n{own}')
    with pytest.raises(DataError, match=f"no file {below}/my_parts.py"):
        raw_env(below / "second.toml")
    (below / "my_parts.py").write_text((HERE / "my_parts.py").read_text())
    env, original = raw_env(below / "second.toml"), raw_env(FILE)
    for one in (env, original):
        one.reset(seed=1)
    assert env.possible_agents == original.possible_agents
    for agent in env.possible_agents:
        np.testing.assert_array_equal(env.observe(agent), original.observe(agent))


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("HYDROMETER", "DARK", r"ext.observe: my_parts.py:DARK: see\(\): must have shape \(1, 1\), given shape \(1,\)"),
        ("HYDROMETER", "KELVIN", r"KELVIN: see\(\): must be from 0 to 1: scale it.* given 298.15"),
        ("HYDROMETER", "NAMELESS", r"NAMELESS: channel\(\) must return a Channel"),
        ("EVAPORATE", "SILENT", r"ext.process: my_parts.py:SILENT: act\(\), which must return"),
        ("EVAPORATE", "WORDY", r"process.\d: my_parts.py:WORDY: words may have {vessel}, .* KeyError: 'vesel'"),
        ("EVAPORATE", "GREEDY", r"GREEDY: act\(\) has left amounts that are negative"),
        ("EVAPORATE", "LAWLESS", r"LAWLESS: legal\(\): AttributeError: .*no_such_field"),
        ("EVAPORATE", "UNLUCKY", r"UNLUCKY: act\(\) has left a number in the safety events that is negative or not"),
        ("EVAPORATE", "LEAKY", r"LEAKY: act\(\) has left a number in the waste can"),
        ("REFRACTOMETER", "GIVER", r"GIVER: read\(\): must be from 0 to 1: .* given nan at \[0\]"),
        ("REFRACTOMETER", "EATER", r"EATER: read\(\) has left amounts that are negative or not finite"),
        ("REFRACTOMETER", "MUTE", r"instruments.refractometer: my_parts.py:MUTE: words\(\): IndexError"),
        ("REFRACTOMETER", "HALF", r"HALF: TypeError: a Channel has a name and an integer size, given .* and 1.5"),
        ("concentrate", "nothing", r"ext.reward: my_parts.py:nothing: must be finite; given nan at \[0\]"),
        ("REFRACTOMETER", "LAMP", r"my_parts.py:LAMP: read\(\): must be from 0 to 1: .* given 1.5 at \[0\]"),
        ("REFRACTOMETER", "BROKEN_LAMP", r"BROKEN_LAMP: read\(\): must be from 0 to 1: .* given nan"),
        ("REFRACTOMETER", "RENAMED", "RENAMED: channel.* must return a Channel named 'refractometer'"),
        ("concentrate", "scalar", r"ext.reward: my_parts.py:scalar: must have shape \(1,\), given shape \(1, 1\)"),
    ],
)
def test_what_a_part_does_wrong_is_named(tmp_path: Path, old: str, new: str, says: str) -> None:
    path = copied(tmp_path, f"my_parts.py:{old}", f"my_parts.py:{new}", MISTAKES)

    def play() -> None:
        env = RoleEnv(path, bench="ext")
        env.reset(seed=0)
        env.step(A_TENTH)
        whole = laboratory(path)
        whole.step(whole.laboratories.actions.encode("measure", 0, "refractometer"))
        reading_words(whole.laboratories, 0, "refractometer")

    with pytest.raises(PartError, match=says) as caught:
        play()
    assert str(path) in str(caught.value)
