"""What is shipped is complete: a wheel with the packages and their data, sources with everything that tests them."""

import importlib.metadata
import importlib.util
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
FOLDERS = ("chemlab", "agents", "scenarios", "tests", "docs", "recipes", "studies")
LITTER = ("__pycache__", "generated", "_build", "*.egg-info", "*.py[cod]", "*.nbi", "*.nbc")


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the sources to build in, without what tools have left there."""
    version = importlib.metadata.version("setuptools") if importlib.util.find_spec("setuptools") else "none"
    if version == "none" or int(version.partition(".")[0]) < 77:
        pytest.skip(f'building needs setuptools 77 or newer, here is {version}: pip install ".[dev]"')
    folder = tmp_path_factory.mktemp("sources")
    for name in FOLDERS:
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns(*LITTER))
    for path in ROOT.iterdir():
        if path.is_file() and not path.name.startswith("."):
            shutil.copy(path, folder)
    return folder


def build(tree: Path, kind: str, place: Path) -> Path:
    """The file that a build backend's hook makes."""
    program = f"import setuptools.build_meta as backend; backend.build_{kind}({str(place)!r})"
    done = subprocess.run([sys.executable, "-c", program], cwd=tree, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stderr
    (made,) = place.iterdir()
    return made


def files_of(tree: Path, *folders: str) -> set[str]:
    return {str(path.relative_to(tree)) for name in folders for path in (tree / name).rglob("*") if path.is_file()}


@pytest.mark.slow
def test_the_wheel_has_the_packages_and_nothing_else(tree: Path, tmp_path: Path) -> None:
    expected = {f"chemlab/{path}" for path in files_of(tree, "agents", "scenarios")} | files_of(tree, "chemlab")
    with zipfile.ZipFile(build(tree, "wheel", tmp_path)) as wheel:
        names = {name for name in wheel.namelist() if ".dist-info/" not in name}
    assert names == expected | {"chemlab_seats.py"}


@pytest.mark.slow
def test_the_sources_have_what_tests_them(tree: Path, tmp_path: Path) -> None:
    with tarfile.open(build(tree, "sdist", tmp_path)) as sources:
        names = {name.partition("/")[2] for name in sources.getnames()}
    expected = files_of(tree, *FOLDERS) | {"README.md", "LICENSE", "CHANGELOG.md", "CONTRIBUTING.md", "CITATION.cff"}
    assert expected - names == set()
    assert not [name for name in names if name.startswith("results")]
