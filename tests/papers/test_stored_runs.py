"""Tables of runs: what is read is what was written."""

from pathlib import Path

import numpy as np
from helpers import refused
from run_files import write_run

from studies.paper.tables import read_runs, read_table, write_runs, write_table


def test_tables_have_what_the_folders_have(tmp_path: Path) -> None:
    """Every number of finished runs, of curves to 5 decimals; a rollout without an end of an episode is no point."""
    runs, tables = tmp_path / "runs", tmp_path / "tables"
    write_run(runs / "x", "lab", "rxn", {"a": 0.4, "b": 0.4 + 0.1 / 3.0}, evaluations={500: 0.1, 1000: 0.4})
    write_run(runs / "y", "lab", "rxn", {"a": 0.9, "b": 0.9}, label="ppo", envs=99, curriculum=["64: submit=0.5"])
    write_run(runs / "z", "lab", "rxn", {"a": 0.9, "b": 0.9}, label="ppo", finished=False)
    write_run(runs / "w", "lab", "rxn", {"a": 1.0 / 3.0}, curve=[(10, 2.0 / 3.0, None), (20, 2.0 / 3.0, 0.0)])
    write_runs(tables, read_runs(runs))
    again = {run.name: run for run in read_runs(tables)}
    for run in read_runs(runs):
        if run.result is None:
            assert run.name not in again
            continue
        found = again[run.name]
        assert found.result == run.result
        assert found.config == {key: value for key, value in run.config.items() if value is not None}
        assert found.evaluations == run.evaluations
        np.testing.assert_allclose(found.curve, run.curve, atol=5e-6)
        assert found.folder is None
    assert again["w"].curve.tolist() == [[20.0, 0.66667, 0.0]]
    before = {path.name: path.read_bytes() for path in tables.iterdir()}
    write_runs(tables, again.values())
    assert {path.name: path.read_bytes() for path in tables.iterdir()} == before


def test_what_is_no_table_is_named(tmp_path: Path) -> None:
    refused("no such folder of results", read_runs, tmp_path / "nothing")
    tables = tmp_path / "tables"
    write_run(tmp_path / "runs", "lab", "rxn", {"a": 0.4})
    write_runs(tables, read_runs(tmp_path / "runs"))
    (tables / "curves.csv.gz").write_bytes(b"run,step,mean,std\n")
    refused(r"curves\.csv\.gz: not a table", read_runs, tables)
    path = tmp_path / "any.csv"
    write_table(path, ("a", "b"), [{"a": 1, "b": "x, y"}, {"a": 2, "b": ""}])
    assert read_table(path, ("a", "b")) == [{"a": "1", "b": "x, y"}, {"a": "2", "b": ""}]
    refused(r"has the columns a, b; needs a, c", read_table, path, ("a", "c"))
    assert read_table(tmp_path / "none.csv", ("a",)) == []
