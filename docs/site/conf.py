"""Sphinx for the documentation: `make docs`. What pages take from README.md and from the package is in `pages.py`."""

import importlib.util
import os
import sys
from pathlib import Path

SITE = Path(__file__).parent
sys.path[:0] = [str(SITE), str(SITE.parent.parent)]

import pages  # noqa: E402
from docutils import nodes  # noqa: E402

import jaxmps  # noqa: E402

os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

project = "jaxmps"
author = "The jaxmps authors"
project_copyright = author
version = release = jaxmps.__version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.mathjax"]
exclude_patterns = ["_build"]
# Formulas need no network: the package has MathJax, of which this one file draws everything, letters too.
mathjax = importlib.util.find_spec("sphinx-mathjax-offline")
assert mathjax is not None and mathjax.origin is not None
mathjax_path = "tex-svg.js"
html_theme = "furo"
html_title = f"jaxmps {release}"
html_static_path = ["_static", str(Path(mathjax.origin).parent / "static" / "mathjax" / mathjax_path)]
html_css_files = ["text.css"]
html_show_sphinx = False
smartquotes = False  # quotation marks stand in code and in messages

myst_enable_extensions = ["dollarmath", "amsmath"]
myst_heading_anchors = 4
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 600  # s, for a cell
nb_execution_in_temp = True
nb_output_stderr = "remove"  # warnings name places on the machine that builds

default_role = "py:obj"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_typehints_format = "short"
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 100


def fill(app, name, source):
    """Fills in a page; notebooks become small."""
    folder, _, stem = name.rpartition("/")
    source[0] = pages.notebook(stem, source[0]) if folder == "notebooks" else pages.filled(source[0])


def tidy(app, tree):
    """Leaves out what a bar of progress leaves behind when it has gone: an empty block."""
    for block in list(tree.findall(nodes.literal_block)):
        if not block.astext().strip():
            block.parent.remove(block)


def setup(app):
    """Pages are filled in as they are read, and docstrings, which are plain text, are put into the form of Sphinx."""
    app.connect("source-read", fill)
    app.connect("doctree-read", tidy)
    app.connect("autodoc-process-docstring", lambda app, kind, name, what, options, lines: pages.marked_up(lines))
    app.connect("autodoc-process-signature", lambda app, *about: pages.shortened(*about[-2:]))
    app.connect("autodoc-skip-member", lambda app, kind, name, member, skip, options: skip or pages.is_foreign(member))
    return {"parallel_read_safe": True}
