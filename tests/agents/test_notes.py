"""A manager's notes: what they hold, and that they follow from its own observations and actions."""

import numpy as np
import pytest

from chemlab import load_scenario
from chemlab.agents.episodes import play_laboratory
from chemlab.agents.notes import Notes, notes_shape, remembered_instruments
from chemlab.agents.policies import make_policies
from chemlab.config.scenario import MANAGER_AGENT
from chemlab.envs.players import Policy
from chemlab.kernels.arrays import IntArray, MaskArray, ObservationArray
from chemlab.lab.engine import Laboratories
from chemlab.roles.bench import channel_slices
from chemlab.roles.manager_actions import DISCARD, FIRST, KIND, SECOND, START, SUBMIT


class _Noting:
    """The scripted manager, beside which notes are taken."""

    def __init__(self, policy: Policy, labs: Laboratories) -> None:
        self.policy, self.notes, self.turns = policy, Notes(labs), list[tuple[int, ObservationArray, int]]()
        self.size = labs.observation_sizes[0]

    def act(self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray) -> IntArray:
        shown = self.notes.shown(observation, mask, step, members)
        assert np.array_equal(shown[:, : self.size], observation)
        again = self.notes.shown(observation, mask, step, members)
        assert np.array_equal(again, shown), "to look again changes nothing"
        actions = np.asarray(self.policy.act(observation, mask, step, members))
        self.notes.played(actions, members)
        self.turns += zip(members.tolist(), shown, actions.tolist(), strict=True)
        return actions


def noted(name: str) -> tuple[Laboratories, list[list[tuple[ObservationArray, int]]]]:
    """Observations with notes, and the scripted manager's actions, of each of three episodes."""
    labs = Laboratories(load_scenario(name), 3)
    policies = make_policies("scripted", labs, 0)
    policies[MANAGER_AGENT] = noting = _Noting(policies[MANAGER_AGENT], labs)
    play_laboratory(labs, policies, labs.scenario.lab_goals[0], 0)
    return labs, [[turn[1:] for turn in noting.turns if turn[0] == member] for member in range(3)]


@pytest.mark.parametrize("name", ["failing", "relay", "crude"])
def test_notes_hold_what_the_manager_has_done_and_read(name: str) -> None:
    labs, episodes = noted(name)
    workplace = labs.manager.workplace
    slots, of_slot, _, _ = notes_shape(workplace)
    parts, kinds = channel_slices(workplace.channels), list(labs.scenario.benches)
    agents = labs.scenario.bench_agents()
    for turns in episodes:
        runs, last, kept = np.zeros((slots, len(kinds))), [np.zeros(0)] * slots, 0
        for seen, action in turns:
            notes = seen[labs.observation_sizes[0] :][: slots * of_slot].reshape(slots, of_slot)
            for slot in range(slots):
                for channel in remembered_instruments(workplace):
                    own = channel.name.replace("slot_0", f"slot_{slot}")
                    if seen[parts[f"{own}_age"]][0] < 1.0:
                        last[slot] = seen[parts[own]]
                        assert notes[slot, channel.size + 1] == 0.0, "nothing was done since it was read"
                    elif len(last[slot]):
                        kept += 1
                    if len(last[slot]):
                        assert np.array_equal(notes[slot, : channel.size], last[slot])
            assert np.allclose(notes[:, -len(kinds) :], 0.1 * runs)
            row = labs.actions.table[action]
            if row[KIND] == START:
                runs[row[SECOND], kinds.index(agents[row[FIRST]].rpartition("_")[0])] += 1
            if row[KIND] in (SUBMIT, DISCARD):
                runs[row[FIRST]], last[row[FIRST]] = 0.0, np.zeros(0)
        assert runs.any() or len(turns) > 1
    assert kept, "readings outlast the vessel's stay on the shelf"
