"""The documentation site, built by Sphinx from the repository's own pages (decision 44).

The source folder is the repository, so that a link leads to the same file here and on a code host.
`make docs` builds it, `toc.yml` is its navigation.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import raden_torch

HERE = Path(__file__).parent
PROJECT = HERE.parents[1]

project = "raden_torch"
version = release = raden_torch.__version__
author = "The raden_torch authors"
copyright = author
extensions = [
    "myst_nb",
    "sphinx_external_toc",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "cyclopts.ext.sphinx",
]
include_patterns = [
    "docs/*.md",
    "docs/decisions/*.md",
    "docs/site/*.rst",
    "notebooks/*.ipynb",
    "examples/README.md",
    "examples/**/README.md",
    "README*.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
]
# folders that need not be searched
exclude_patterns = [".*", "build", "demo", "kernel", "raden_torch", "runtimes", "tests"]
exclude_patterns += ["**/node_modules"]

external_toc_path = str(HERE / "toc.yml")
myst_heading_anchors = 3
suppress_warnings = ["myst.header"]  # a heading may skip a level; code hosts show it as well

# notebooks run when `make docs` says so, and keep their outputs in build/
nb_execution_mode = os.environ.get("RADEN_TORCH_DOCS_NOTEBOOKS", "off")
nb_execution_cache_path = str(PROJECT / "build" / "notebooks")
nb_execution_in_temp = True  # notebooks write files
nb_execution_timeout = 900
nb_execution_raise_on_error = True
nb_merge_streams = True
nb_ipywidgets_js: dict[str, Any] = {}  # sliders move in Jupyter; here their scripts need a CDN

autodoc_typehints = "signature"
autodoc_member_order = "bysource"
napoleon_attr_annotations = False
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 80
default_role = "code"  # docstrings quote code as Markdown does

html_theme = "furo"
html_title = f"raden_torch {release}"
html_static_path = ["static"]
html_css_files = ["raden.css"]
html_extra_path = ["index.html"]
html_copy_source = html_show_sourcelink = False
html_show_copyright = html_show_sphinx = False
templates_path: list[str] = []


def docstring_as_rst(
    app: object, what: str, name: str, obj: object, options: object, lines: list[str]
) -> None:
    """Docstrings here are prose with `code`; a bar, a star or an underscore in it means itself."""
    for number, line in enumerate(lines):
        if not line.lstrip().startswith((">>>", "...")):
            parts = re.split(r"(`[^`]*`)", line)
            parts[::2] = [re.sub(r"([|*]|_\b)", r"\\\1", part) for part in parts[::2]]
            lines[number] = "".join(parts)


def array_types_by_name(
    app: object, what: str, name: str, obj: object, options: object, signature: str, returns: str
) -> tuple[str | None, str | None]:
    """An array is `ndarray` in a signature; its docstring says what it holds."""
    shape = r"tuple\[~typing\.Any, \.\.\.\]"
    array = re.compile(rf"~numpy\.ndarray\[{shape}, ~numpy\.dtype\[[~\w.]+\]\]")
    short = [part and array.sub("ndarray", part) for part in (signature, returns)]
    # what is no Python would be cut at its commas
    return short[0] and short[0].replace("<factory>", "..."), short[1]


def setup(app: Any) -> None:
    app.connect("autodoc-process-signature", array_types_by_name)
    app.connect("autodoc-process-docstring", docstring_as_rst, priority=400)  # before napoleon
