"""Settings of the documentation: `make docs` builds it into out/docs."""

import sys
from pathlib import Path

import nilbs

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_extensions"))

project, author = "nilbs", "The nilbs developers"
version = release = nilbs.__version__
copyright = author
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx_gallery.gen_gallery",
    "command_reference",
]
exclude_patterns = ["images", "study/results", "study/pictures", "_*", "gallery/*.ipynb", "**/*.py.md5"]
nitpicky = True
# Types in docstrings are shapes in words: only names of this package are links.
nitpick_ignore_regex = [("py:.*", r"(?!nilbs\.).*")]
suppress_warnings = ["ref.footnote"]  # a docstring may name a source without a mark in the text

# Pages
html_theme = "furo"
html_title = "nilbs"
html_static_path = ["_static"]
html_css_files = ["nilbs.css"]
html_show_sourcelink = False
html_copy_source = False
templates_path = ["_templates"]
myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3

# Reference
default_role = "literal"
add_module_names = False
autodoc_typehints = "none"  # the docstrings have shapes and units
autodoc_member_order = "bysource"
autosummary_generate = True
autosummary_ignore_module_all = False
autosummary_imported_members = True
napoleon_google_docstring = False
napoleon_use_param = False
napoleon_use_rtype = False
napoleon_custom_sections = [("Attributes", "params_style")]

# Gallery
sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "gallery",
    "filename_pattern": r"/\d\d_",
    "ignore_pattern": r"make_assets|own_baseline",
    "image_scrapers": ("gallery_pictures.written_pictures",),
    "reset_modules": ("gallery_pictures.prepare",),
    "download_all_examples": False,
    "default_thumb_file": str(HERE / "images" / "side-by-side.png"),
    "show_signature": False,
    "show_memory": False,
    "write_computation_times": False,
    "min_reported_time": 1e9,
    "within_subsection_order": "FileNameSortKey",
    "remove_config_comments": True,
    "plot_gallery": True,
}
