"""How Sphinx makes the site of these pages: `make docs`.

The pages are Markdown, and are read in the repository as well as on the site. What is made at
each build (the reference of Python's names, notebooks, pages from outside `docs`) is the business
of `docs.machinery.site`.
"""

import sys
import tomllib
from pathlib import Path

DOCS = Path(__file__).resolve().parent
sys.path.insert(0, str(DOCS.parent))

PROJECT = tomllib.loads((DOCS.parent / "pyproject.toml").read_text(encoding="utf-8"))["project"]

project = "giajax"
author = "the authors of giajax"
release = PROJECT["version"]
language = "en_GB"

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "docs.machinery.docstrings",
    "docs.machinery.site",
]
exclude_patterns = ["machinery", "_build"]

# What a key must be is quoted as a file has it, and options begin with two hyphens.
smartquotes = False
# Headings of pages are targets of links, as they are in the repository.
myst_heading_anchors = 4
# `name` in a docstring is code, as it is in Markdown.
default_role = "literal"
highlight_language = "none"

autosummary_generate = False
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
python_maximum_signature_line_length = 88
python_display_short_literal_types = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
toc_object_entries = False
# Types of other packages are no links: a build asks no other site.
# What giajax exports is linked (`docs.machinery.site`), what is private in it is not.
nitpick_ignore_regex = [("py:.*", r"(?!giajax\.).*"), ("py:.*", r"giajax\.(.*\.)?_.*")]

# The pages use nothing of the theme's own: another one is another name here.
html_theme = "furo"
html_title = "giajax"
html_show_sourcelink = False
html_show_sphinx = False
html_copy_source = False
project_copyright = "the authors of giajax; MIT licence"
