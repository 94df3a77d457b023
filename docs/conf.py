"""Sphinx configuration. `make docs` builds the site; a warning is an error."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE / "_extensions"), str(HERE.parent)]

import qcar_env  # noqa: E402 - after the paths

project = "qcar_env"
author = "The qcar_env maintainers"
project_copyright = f"2026, {author}"
version = release = qcar_env.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "docstrings",  # equations in docstrings
    "api_pages",  # one page for each module
    "facts",  # tables that are read off the code
    "mathml",  # equations without a network
    "source_lines",  # an address for each line of the source pages
    "tutorials",  # scripts as pages
]
exclude_patterns = ["_build", "_extensions"]
suppress_warnings = ["ref.python"]  # `h` or `step` in a docstring may mean several attributes

myst_enable_extensions = ["amsmath", "attrs_block", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3

default_role = "py:obj"
autodoc_default_options = {"members": True, "member-order": "bysource"}
autodoc_typehints = "signature"
autodoc_mock_imports: list[str] = []
viewcode_follow_imported_members = False
napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False

html_theme = "furo"
html_title = f"qcar_env {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sphinx = False
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#0072B2", "color-brand-content": "#0072B2"},
    "dark_css_variables": {"color-brand-primary": "#56B4E9", "color-brand-content": "#56B4E9"},
}
