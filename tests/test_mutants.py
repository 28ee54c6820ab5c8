"""Mutants of the sources: each changes one line and stays Python, the choice is repeatable, faults are found."""

import ast
import json
from pathlib import Path

import pytest

from studies.tools import mutants
from studies.tools.mutants import Mutant, choose

LAB = ("chemlab/lab",)
CODE = '''"""1 + 1 in a docstring is no code."""
LIMIT: float = 2.0


def double(value: float = 1.0) -> float:
    """Return 2 * value."""
    return value * LIMIT if value < 3 and not value == 4 else 0.0
'''


def test_a_mutant_changes_an_operator_a_number_or_a_condition(tmp_path: Path) -> None:
    (tmp_path / "code.py").write_text(CODE)
    found = {mutant.after.strip() for mutant in mutants.mutants(tmp_path / "code.py", tmp_path)}
    rest = "value * LIMIT if value < 3 and not value == 4 else 0.0"
    assert found == {
        "LIMIT: float = 3.0",
        *(
            "return " + rest.replace(before, after)
            for before, after in [
                ("value * LIMIT", "(value / LIMIT)"),
                ("value < 3 and not value == 4", "(value < 3 or not value == 4)"),
                ("value < 3", "(value <= 3)"),
                ("3", "4"),
                ("not value == 4", "(value == 4)"),
                ("value == 4", "(value != 4)"),
                ("== 4", "== 5"),
                ("0.0", "0.5"),
            ]
        ),
    }


@pytest.mark.slow
def test_a_choice_is_repeatable_and_every_chosen_mutant_is_one_line_of_python(tmp_path: Path) -> None:
    chosen = choose(40, 1, LAB)
    assert chosen == choose(40, 1, LAB) != choose(40, 2, LAB)
    assert len({(mutant.path, mutant.line) for mutant in chosen}) == 40
    for mutant in chosen:
        copy = tmp_path / mutant.path
        copy.parent.mkdir(parents=True, exist_ok=True)
        source = (mutants.ROOT / mutant.path).read_text(encoding="utf-8")
        copy.write_text(source, encoding="utf-8")
        mutant.apply(tmp_path)
        changed = copy.read_text(encoding="utf-8")
        ast.parse(changed)
        pairs = zip(source.splitlines(), changed.splitlines(), strict=True)
        assert [n for n, (old, new) in enumerate(pairs, 1) if old != new] == [mutant.line]


@pytest.mark.slow
def test_tests_kill_a_fault_that_they_cover_and_results_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def copy(to: Path, tests_of: str | None) -> None:
        assert tests_of is None
        (to / "code.py").write_text(CODE)
        (to / "test_code.py").write_text("import code_here\n\ndef test_it():\n    assert code_here.double(1) == 2\n")
        (to / "code_here.py").write_text(CODE)

    covered = Mutant("code_here.py", 2, "LIMIT: float = 2.0", "LIMIT: float = 3.0")
    last = CODE.splitlines()[-1]
    missed = Mutant("code_here.py", len(CODE.splitlines()), last, last.replace("0.0", "0.5"))
    monkeypatch.setattr(mutants, "_copy", copy)
    monkeypatch.setattr(mutants, "choose", lambda *_: [covered, missed])
    command = ["test_code.py", "--results", str(tmp_path / "results.jsonl"), "--json"]
    summary = {"mutants": 2, "killed": 1, "survived": [str(missed)]}
    assert mutants.main(command) == 0
    assert json.loads(capsys.readouterr().out) == summary
    monkeypatch.setattr(mutants, "_run", lambda *_: pytest.fail("what is known is not run again"))
    assert mutants.main(command) == 0
    assert json.loads(capsys.readouterr().out) == summary
