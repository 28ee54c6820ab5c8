"""What docs/security.md says was tried: its table is of what is kept, and every test and file it names is there."""

import re

import pytest
from attacks import KEPT, KINDS, PAGE, ROOT, kept, table

pytestmark = pytest.mark.skipif(not PAGE.is_file(), reason="not a checkout")


def test_the_table_is_that_of_what_is_kept() -> None:
    text = PAGE.read_text(encoding="utf-8")
    shown = text.partition("<!-- attacks: begin -->\n")[2].partition("\n<!-- attacks: end -->")[0]
    assert shown.splitlines() == list(table(kept())), f"make it again: python tests/fuzz/attacks.py table ({KEPT})"


def test_what_is_kept_is_the_whole_budget_and_found_nothing() -> None:
    runs = kept()
    assert sum(run["tries"] for run in runs if run["kind"] in ("files", "agents", "records")) >= 20_000
    assert {run["kind"] for run in runs} <= set(KINDS)
    assert [run for run in runs if run["failures"] or any("failed" in told for told in run["outcomes"].values())] == []


def test_every_test_and_file_that_is_named_is_there() -> None:
    text = PAGE.read_text(encoding="utf-8")
    sources = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("test_*.py"))
    named = set(re.findall(r"`(test_\w+)`", text))
    assert len(named) > 30
    assert [name for name in sorted(named) if f"def {name}(" not in sources] == []
    there = {path.name for folder in ("tests", "studies") for path in (ROOT / folder).rglob("*.py")}
    files = set(re.findall(r"\b(?:tests/[\w/]+/)?(\w+\.py)[` ]", text))
    assert {"forgeries.py", "compare_commits.py"} <= files
    assert sorted(files - there) == []
