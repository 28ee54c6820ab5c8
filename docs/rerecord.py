"""Convert the committed records to the current format: ``python docs/rerecord.py [FILE ...]``.

The recorded actions are replayed on the simulator. Another processor may change the last digits of a score. A record
whose score changes otherwise is not replaced, and the command exits with 1: its policies have to play the episode again
(``docs/baselines.py --play``).
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

from chemlab.record import FORMAT, Recorder, RecordError, Replay, read_record
from chemlab.record.format import Header

__all__ = ["RECORDS", "record_again"]

RECORDS = Path(__file__).parent / "results" / "records"


def record_again(path: Path, trust: bool = False, changed: bool = False) -> str:
    """Replace a record by one of the same actions; return the reason if it is not replaced, or an empty string.

    ``changed`` allows another score, for policies whose actions do not depend on observations.
    """
    record = read_record(path)
    if record.end is None or record.broken is not None:
        return "is truncated"
    # Fields that the present format has no more are dropped.
    record.header = {key: value for key, value in record.header.items() if key in Header.model_fields}
    record.header["format"] = FORMAT
    header = record.checked_header()
    draft = path.with_name(f"{path.name}.again")
    try:
        replay = Replay(record, trust)
        with Recorder(draft, replay.laboratories, 0, header.policies, header.rounds, force=True) as recorder:
            recorder.begin(header.seed, header.options)
            for turn in record.turns:
                recorder.turn(replay.play(turn))
        again = read_record(draft)
        was, now = (float(one["end"]["score"]) if one else math.nan for one in (record.end, again.end))
        if not changed and not math.isclose(was, now, rel_tol=1e-9, abs_tol=1e-9):
            return f"has the score {was!r}, but its actions now give {now!r}"
        draft.replace(path)
    except (RecordError, ValueError) as error:
        return str(error)
    finally:
        draft.unlink(missing_ok=True)
        draft.with_name(f"{draft.name}.part").unlink(missing_ok=True)
    return ""


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="*", type=Path, metavar="FILE", help="records (default: all that are committed)")
    failed = False
    for file in parser.parse_args().files or sorted(RECORDS.rglob("*.jsonl")):
        problem = record_again(file)
        failed = failed or bool(problem)
        print(f"{file}: {problem or 'recorded again'}", flush=True)
    sys.exit(failed)
