"""Sphinx configuration of the documentation site: `make docs`.

The pages are Markdown and can be read in the repository, too. `docs.machinery.site` generates the
other pages at each build: the Python reference, the notebooks, and the pages from outside `docs`.
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

# Quoted values must look as they do in a file, and options begin with two hyphens.
smartquotes = False
# Links can lead to headings, as in the repository.
myst_heading_anchors = 4
# In a docstring, `name` is code, as in Markdown.
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
# Types of other packages are not linked, because a build must not access other sites. Public names
# of giajax are linked (`docs.machinery.site`), private ones are not.
nitpick_ignore_regex = [("py:.*", r"(?!giajax\.).*"), ("py:.*", r"giajax\.(.*\.)?_.*")]

# The pages use no features specific to the theme, so it can be replaced here.
html_theme = "furo"
html_title = "giajax"
html_show_sourcelink = False
html_show_sphinx = False
html_copy_source = False
project_copyright = "the authors of giajax; MIT licence"
