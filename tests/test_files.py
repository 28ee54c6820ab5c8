"""Files are there whole or not at all, whatever happens to the process or the disk."""

import errno
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from helpers import limited, refused

from chemlab.config.datafile import read_toml
from chemlab.config.files import (
    check_apart,
    draft_of,
    locked,
    naming,
    open_regular,
    read_bytes,
    replace_between,
    write_bytes,
    write_text,
    write_texts,
)

WRITER = """
import sys
from pathlib import Path
from chemlab.config.files import write_bytes
path = Path(sys.argv[1])
print("ready", flush=True)
for i in range(10**9):
    write_bytes(path, bytes([i % 251]) * 300_000)
"""
SMALL_DISK = """
import resource, signal, sys
from pathlib import Path
from chemlab.config.files import write_bytes, write_texts
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
path = Path(sys.argv[1])
try:
    if path.is_dir():
        write_texts({path / "first": "a", path / "second": "b" * 5000, path / "third": "c"})
    else:
        write_bytes(path, b"x" * 5000)
except OSError as error:
    print(error)
"""


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "new" / "a.txt"
    for text in ("one", "zwei, größer", "", "kept"):
        write_text(path, text)
        assert path.read_bytes() == text.encode()
    with pytest.raises(UnicodeEncodeError):
        write_text(path, "\ud800")
    with pytest.raises(FileNotFoundError), draft_of(path) as draft:
        draft.with_name("no such file").replace(draft)
    with pytest.raises(FileNotFoundError), draft_of(path):
        pass  # nothing was written, so nothing is replaced
    refused("mark: begin", replace_between, path, "mark", ["x"])
    assert path.read_text() == "kept"
    assert [file.name for file in path.parent.iterdir()] == ["a.txt"]
    path.write_text("a = 1", encoding="utf-8-sig")  # a mark at the beginning of a text is none of it
    assert read_toml(path.rename(path.with_suffix(".toml"))) == {"a": 1}


@pytest.mark.skipif(os.name != "posix", reason="signals and limits of POSIX")
def test_a_killed_writer_leaves_a_whole_file(tmp_path: Path) -> None:
    """Killed at whatever moment; what it leaves besides is swept once nobody can be writing it any more."""
    path = tmp_path / "a.bin"
    for delay in (0.0, 0.003, 0.011, 0.02, 0.031, 0.043):
        with subprocess.Popen([sys.executable, "-c", WRITER, path], stdout=subprocess.PIPE) as writer:
            assert writer.stdout is not None
            writer.stdout.readline()
            while not path.exists():
                time.sleep(0.001)
            time.sleep(delay)
            writer.send_signal(signal.SIGKILL)
        content = path.read_bytes()
        assert len(content) == 300_000
        assert len(set(content)) == 1
    left = [file for file in tmp_path.iterdir() if file != path]
    assert all(file.name.startswith(".draft-") and not file.suffix for file in left)
    mine = tmp_path / ".drafts"
    mine.write_text("of the user's")
    old, young = tmp_path / ".draft-1-abc", tmp_path / ".draft-2-abc"
    for file, age in [(old, 61.0), (young, 5.0), (mine, 1e6)]:
        file.touch()
        os.utime(file, (time.time() - age, time.time() - age))
    write_bytes(path, b"next")
    assert not old.exists()
    assert young.exists()
    assert mine.exists()


@pytest.mark.skipif(os.name != "posix", reason="signals and limits of POSIX")
def test_a_disk_without_room(tmp_path: Path) -> None:
    """The error names the file that was meant; the one that was there stays."""
    path = tmp_path / "a.bin"
    path.write_bytes(b"kept")
    found = subprocess.run([sys.executable, "-c", SMALL_DISK, path], capture_output=True, text=True, check=True)
    assert f"File too large: '{path}'" in found.stdout
    assert path.read_bytes() == b"kept"
    assert list(tmp_path.iterdir()) == [path]


def test_errors_name_the_file_that_something_is_in_the_way_of(tmp_path: Path) -> None:
    folder, file = tmp_path / "folder", tmp_path / "file"
    (folder / "inside").mkdir(parents=True)
    file.write_text("")
    for path, match in ((folder, r"folder'$"), (file / "below", "file"), (tmp_path / ("a" * 300), "name too long")):
        with pytest.raises(OSError, match=match):
            write_text(path, "x")
    assert sorted(item.name for item in tmp_path.iterdir()) == ["file", "folder"]
    # A name as long as the system allows leaves no room for a longer one beside it.
    write_text(tmp_path / ("a" * 255), "x")
    with pytest.raises(OSError, match=r"No space.*file"), naming(file):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    with pytest.raises(OSError, match=r"b\.txt") as caught, naming(file):
        (tmp_path / "none" / "b.txt").read_text()
    assert str(file) not in str(caught.value)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes and devices of POSIX")
@limited(120)
def test_only_regular_files_of_bounded_size_are_read(tmp_path: Path) -> None:
    """Pipes that nobody writes to, endless devices, links to either; files larger than allowed, however they look."""
    small, large, sparse = (tmp_path / name for name in ("small", "large", "sparse"))
    small.write_bytes(b"0123456789")
    large.write_bytes(b"0123456789a")
    with sparse.open("wb") as file:
        file.truncate(10**12)  # a terabyte of nothing takes no room on the disk
    assert read_bytes(small, 10) == b"0123456789"
    os.mkfifo(tmp_path / "pipe")
    for name, target in (("device", "/dev/zero"), ("to_pipe", "pipe"), ("to_folder", "."), ("to_small", "small")):
        (tmp_path / name).symlink_to(target)
    assert read_bytes(tmp_path / "to_small", 10) == b"0123456789"
    for name in ("pipe", "to_pipe", "device", "to_folder"):
        with pytest.raises(OSError, match="is not a regular file") as caught:
            open_regular(tmp_path / name, 10)
        assert caught.value.filename == str(tmp_path / name)
    for path in (large, sparse):
        with pytest.raises(OSError, match="is larger than 10 bytes"):
            read_bytes(path, 10)
    with pytest.raises(FileNotFoundError):
        read_bytes(tmp_path / "none", 10)
    # What the system makes as it is read has no size beforehand.
    if Path("/proc/self/maps").exists():
        assert Path("/proc/self/maps").stat().st_size == 0
        with pytest.raises(OSError, match="is larger than 10 bytes"):
            read_bytes(Path("/proc/self/maps"), 10)


@pytest.mark.skipif(os.name != "posix", reason="signals and limits of POSIX")
def test_files_that_belong_together_are_all_there_or_none(tmp_path: Path) -> None:
    (tmp_path / "third").write_text("kept")
    command = [sys.executable, "-c", SMALL_DISK, tmp_path]
    found = subprocess.run(command, capture_output=True, text=True, check=True)
    assert f"File too large: '{tmp_path / 'second'}'" in found.stdout
    assert [file.name for file in tmp_path.iterdir()] == ["third"]
    assert (tmp_path / "third").read_text() == "kept"
    write_texts({tmp_path / name: f"{name}: größer" for name in ("first", "third")})
    found = {file.name: file.read_text(encoding="utf-8") for file in tmp_path.iterdir()}
    assert found == {"first": "first: größer", "third": "third: größer"}


def test_no_file_is_given_twice(tmp_path: Path) -> None:
    """Under whatever name: another spelling, a link, a file that is not there yet."""
    file, other = tmp_path / "a.toml", tmp_path / "b.toml"
    spelled = tmp_path / "below" / ".." / "a.toml"
    check_apart([file, other], [tmp_path / "c.toml"])
    for twice in (file, spelled):
        refused(r"a\.toml: is given for two outputs", check_apart, [file, twice])
        refused(r"a\.toml: is an input of this command", check_apart, [file], [other, twice])
    file.write_text("x")
    other.symlink_to(file)
    hard = tmp_path / "hard.toml"
    os.link(file, hard)
    for link in (other, hard):
        refused("is an input of this command", check_apart, [link], [file])


def test_a_lock_is_held_by_one(tmp_path: Path) -> None:
    path = tmp_path / "a"
    with path.open("ab") as one, path.open("ab") as other:
        assert locked(one.fileno())
        assert not locked(other.fileno())
    with path.open("ab") as other:
        assert locked(other.fileno())
