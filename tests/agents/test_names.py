"""Former names of policies work for one release, with a notice."""

from __future__ import annotations

import pytest

from chemlab.agents import former_names
from chemlab.agents.former_names import current_name


@pytest.mark.parametrize(
    ("given", "current"),
    [
        ("heuristic", "scripted"),
        ("heuristic@0.1", "scripted@0.1"),
        ("pretrained-alone,manager=direct", "pretrained-isolated,manager=scripted:no-extraction"),
        ("heuristic,rxn_0=hasty@0.2", "scripted,rxn_0=scripted:unsafe@0.2"),
        ("random,manager=forgetful", "random,manager=scripted:memoryless"),
        ("serial", "scripted:fifo"),
        ("runs/heuristic", "runs/heuristic"),
        ("wurtz_dodecane_direct", "wurtz_dodecane_direct"),
        ("plan:hasty", "plan:hasty"),
        ("scripted:unsafe", "scripted:unsafe"),
    ],
)
def test_former_names_are_replaced_in_every_part(given: str, current: str) -> None:
    assert current_name(given) == current


def test_a_notice_names_each_former_name_once(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(former_names, "_noticed", set())
    for _ in range(2):
        current_name("heuristic,manager=hasty")
    told = "policy '{}' is now called '{}'; the old name ends with this release\n"
    expected = told.format("heuristic", "scripted") + told.format("hasty", "scripted:unsafe")
    assert capsys.readouterr() == ("", expected)
