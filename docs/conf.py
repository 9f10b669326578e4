"""How the documentation is built: ``sphinx-build -W docs site``, without a network."""

from __future__ import annotations

import gc
import os
import sys
from functools import cache
from pathlib import Path

from sphinx.pycode.parser import Parser
from sphinx.search.en import SearchEnglish

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))
# a dozen plans for examples of formats: compiling loops for them would take longer than they do
os.environ.setdefault("OPPOSABLE_COMPILE", "0")

from planner.system.package import __version__  # noqa: E402

SearchEnglish.stem = cache(SearchEnglish.stem)  # type: ignore[method-assign]  # each word once
Parser.parse_definition = lambda parser: None  # type: ignore[assignment, method-assign]  # for literalinclude
gc.set_threshold(200_000, 50, 1000)  # trees of pages are many objects that stay: 10 % of the time

project = "Opposable"
author = "The Opposable developers"
copyright = author
release = version = __version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "machinery.mathml",
    "machinery.navigation",
    "machinery.api",
    "machinery.docstrings",
    "machinery.commands",
    "machinery.formats",
    "machinery.zoo",
    "machinery.messages",
    "machinery.results",
    "machinery.terms",
]
exclude_patterns = ["machinery"]
root_doc = "index"
nitpicky = True
smartquotes = False  # 5 % of the time, and "--" of an option is no dash
# of other packages, whose documentation cannot be reached without a network
nitpick_ignore_regex = [
    (r"py:.*", r"(numpy|pinocchio|mujoco|casadi|coal|pydantic|qpsolvers|trimesh|PIL)\..*"),
    (r"py:.*", r"(rich|typer)\..*"),
    (r"py:.*", r"(collections|pathlib|signal|types|typing|enum|argparse|logging)\..*"),
]

autodoc_class_signature = "mixed"
autodoc_member_order = "bysource"
autodoc_use_type_comments = False  # there are none; looking for them parses every function again
autodoc_typehints = "none"  # machinery.docstrings adds them, as they are written
napoleon_attr_annotations = False
napoleon_numpy_docstring = False
napoleon_use_ivar = True
python_use_unqualified_type_names = True

myst_enable_extensions = ["attrs_block", "attrs_inline", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3

html_theme = "furo"
html_math_renderer = "mathml"
html_title = f"Opposable {__version__}"
html_static_path = ["static"]
html_css_files = ["own.css"]
html_search_scorer = str(HERE / "static" / "search.js")
html_show_sourcelink = False
html_copy_source = False
html_show_copyright = False
copybutton_prompt_text = "$ "
copybutton_only_copy_prompt_lines = True
