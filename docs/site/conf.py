"""Sphinx for the documentation: `make docs`. What pages take from README.md and from the package is in `pages.py`."""

import sys
from pathlib import Path

SITE = Path(__file__).parent
sys.path[:0] = [str(SITE), str(SITE.parent.parent)]

import pages  # noqa: E402

import jaxmps  # noqa: E402

project = "jaxmps"
author = "The jaxmps authors"
project_copyright = author
version = release = jaxmps.__version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.mathjax"]
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = f"jaxmps {release}"
html_static_path = ["_static"]
html_css_files = ["text.css"]
html_show_sphinx = False
smartquotes = False  # quotation marks stand in code and in messages

myst_enable_extensions = ["dollarmath", "amsmath"]
myst_heading_anchors = 4
nb_execution_mode = "off"  # the tests execute the notebooks

default_role = "py:obj"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_typehints_format = "short"
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 100


def setup(app):
    """Pages are filled in as they are read, and docstrings, which are plain text, are put into the form of Sphinx."""
    app.connect("source-read", lambda app, name, source: source.__setitem__(0, pages.filled(source[0])))
    app.connect("autodoc-process-docstring", lambda app, kind, name, what, options, lines: pages.marked_up(lines))
    app.connect("autodoc-process-signature", lambda app, *about: pages.shortened(*about[-2:]))
    app.connect("autodoc-skip-member", lambda app, kind, name, member, skip, options: skip or pages.is_foreign(member))
    return {"parallel_read_safe": True}
