"""Sphinx settings: ``python -m sphinx -W -b html docs docs/_build`` builds the pages; warnings are errors."""

from __future__ import annotations

import os
import sys
from pathlib import Path

# Document and call kernels as plain functions, so that building pages compiles nothing.
os.environ["NUMBA_DISABLE_JIT"] = "1"
sys.path.insert(0, str(Path(__file__).parent))

from generate import setup_pages
from sphinx.application import Sphinx

from chemlab import __version__

project = "chemlab"
author = "The chemlab developers"
copyright = author
release = version = __version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "mathml"]
exclude_patterns = ["_build", "generated/gallery.md"]  # the gallery is included in the home page
myst_enable_extensions = ["dollarmath", "amsmath", "deflist", "colon_fence"]
myst_heading_anchors = 3

html_math_renderer = "mathml"
html_theme = "furo"
html_title = "chemlab"
html_static_path = ["_static"]
html_css_files = ["chemlab.css"]
html_show_sphinx = False
html_copy_source = False
html_domain_indices = False

# Docstrings: Google style, in which `this` is code.
default_role = "code"
napoleon_use_ivar = True
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_class_signature = "mixed"
autodoc_default_options = {
    "members": True,
    "show-inheritance": True,
    "exclude-members": "model_config, model_post_init",
}
autodoc_type_aliases = {name: name for name in ("FloatArray", "IntArray", "BoolArray", "StreamArray", "Background")}
# Optional, large packages: the pages need only their names.
autodoc_mock_imports = [
    "stable_baselines3",
    "sb3_contrib",
    "torch",
    "tensorboard",
    "matplotlib",
    "PIL",
    "pygame",
    "ray",
    "torchrl",
    "tensordict",
    "benchmarl",
    "anyio",
    "inspect_ai",
    "mcp",
    "mcp_types",
    "openenv",
    "starlette",
    "uvicorn",
    "verifiers",
]

# Broken references to this project are errors; indexes of other projects would need network access.
nitpicky = True
nitpick_ignore_regex = [
    (r"py:.*", r"(?!chemlab\.).*"),
    # Private modules without a page.
    (
        r"py:(class|obj)",
        r"chemlab\..*\.(_\w+|A|B|F|M|T|Arguments|Declared|Header|Environment|Drawn|Chemistry\w+Fields)",
    ),
    (r"py:class", r"chemlab\.agents\.executors\.(J|Value)"),  # type variables
]
suppress_warnings = ["ref.python"]  # Sphinx takes names in a list of attributes for references


def whole_sentence(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Keep Napoleon from parsing the words before a colon in an attribute's first line as its type.

    Napoleon looks for a type only in the first line, which becomes an empty comment.
    """
    if what in ("attribute", "property", "data"):
        lines[:0] = ["..", ""]


def setup(app: Sphinx) -> None:
    """Generate pages from the code, and preprocess attribute docstrings before Napoleon."""
    setup_pages(app)
    app.connect("autodoc-process-docstring", whole_sentence, priority=400)
