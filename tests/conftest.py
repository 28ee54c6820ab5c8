"""Settings that all tests share. This file also lets every test import ``helpers``, and ``studies`` in a checkout."""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

# At the end, so that an installed chemlab is found before the checkout's.
sys.path.append(str(Path(__file__).parents[1]))

# Two processes test at once, and networks this small are slower on several threads.
os.environ.setdefault("OMP_NUM_THREADS", "1")

# Derandomized: a failure on one machine is a failure on every machine. HYPOTHESIS_PROFILE=explore looks further.
_COMMON = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}
settings.register_profile("repeatable", derandomize=True, **_COMMON)
settings.register_profile("explore", print_blob=True, **_COMMON)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))

# Seals of what tests train are made with a key of their own; processes that they start have it, too.
_state = tempfile.TemporaryDirectory()
os.environ.setdefault("CHEMLAB_STATE_DIR", _state.name)

_CHROMIUM = shutil.which("chromium")
_FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking"]
_FLAGS += ["--disable-component-update", "--disable-sync"]


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--passed", type=Path, help="a file of tests that passed before: left out, and those of this run added"
    )


def _all_tests(config: pytest.Config) -> bool:
    """Return True if the command names no tests."""
    return config.args_source is config.ArgsSource.TESTPATHS


_WARM = "import sys; from chemlab.cli import main; sys.argv[1:] = ['warm', 'wurtz_dodecane']; main()"
_LAWS = """
from chemlab.physics import backends
for law in {}([*backends.LAWS, *backends.SEPARATE]):
    backends.law_address(law, "real")
"""


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile for all of xdist's processes before they start: each would compile everything itself.

    The laws of the backend ``real`` take longer than all else, so two processes compile them from both ends.
    """
    options = session.config.option
    if hasattr(session.config, "workerinput") or options.collectonly or not _all_tests(session.config):
        return
    if getattr(options, "numprocesses", None) and not os.environ.get("NUMBA_DISABLE_JIT"):

        def start(program: str) -> subprocess.Popen[bytes]:
            # Not in a checkout, whose chemlab would be found before an installed one. What fails here fails in a test.
            return subprocess.Popen([sys.executable, "-c", program], cwd=_state.name, stdout=subprocess.DEVNULL)

        beside = start(_LAWS.format("reversed"))
        for program in (_WARM, _LAWS.format("list")):
            start(program).wait()
        beside.wait()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what has passed; if the command names no tests, mark all cases of a test but the first as slow."""
    cases = Counter[str]()
    for item in items if _all_tests(config) else []:
        cases[test := item.nodeid.partition("[")[0]] += item.get_closest_marker("slow") is None
        if cases[test] > 1:
            item.add_marker("slow")
    file = config.getoption("--passed")
    passed = set(file.read_text("utf-8").splitlines()) if file and file.exists() else set()
    config.hook.pytest_deselected(items=[item for item in items if item.nodeid in passed])
    items[:] = [item for item in items if item.nodeid not in passed]


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Note what has passed (not in a process of xdist's: they send theirs to the first)."""
    file = session.config.getoption("--passed")
    if file and not hasattr(session.config, "workerinput"):
        reports = session.config.pluginmanager.get_plugin("terminalreporter").stats.get("passed", [])
        with file.open("a", encoding="utf-8") as lines:
            lines.writelines(f"{report.nodeid}\n" for report in reports if report.when == "call")


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A headless Chromium with a profile of its own."""
    playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright (extra test)")
    if _CHROMIUM is None:
        pytest.skip("needs chromium on the path")
    with playwright.sync_playwright() as driver:
        context = driver.chromium.launch_persistent_context(
            str(tmp_path_factory.mktemp("profile")), executable_path=_CHROMIUM, headless=True, args=_FLAGS
        )
        yield context
        context.close()


@pytest.fixture
def visitor(browser: Any) -> Iterator[Callable[..., Any]]:
    """Opens pages that must neither complain nor ask for anything from elsewhere."""
    pages, complaints, asked = [], [], []

    def visit(url: str, within: str = "", width: int = 1280) -> Any:
        """A page; ``within`` is how addresses begin that it may ask for: by default its host's, or its own file."""
        within = within or re.match(r"file:[^#]*|\w+://[^/]+", url)[0]  # type: ignore[index]
        page = browser.new_page()
        page.set_default_timeout(60_000)
        page.on("console", lambda message: complaints.append(message.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("request", lambda request: request.url.startswith((within, "data:")) or asked.append(request.url))
        page.set_viewport_size({"width": width, "height": 800})
        page.goto(url)
        pages.append(page)
        return page

    yield visit
    for page in pages:
        page.close()
    assert complaints == []
    assert asked == []


@pytest.fixture
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    """Clones are fitted for a moment, where it does not matter how well they play."""
    from chemlab.agents.train import imitate

    monkeypatch.setattr(imitate, "_UPDATES", 20)
    monkeypatch.setattr(imitate, "_EPOCHS", 1)
