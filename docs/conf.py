"""The pages as a site: `sphinx-build -W docs docs/_build/html`; CONTRIBUTING.md has how it is published.

Nothing is fetched, neither while it is made nor while it is read. The gallery uses the demo, which is run
here and kept; notebooks hold their outputs.
"""

import os
import shutil
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(HERE))

import site_parts  # noqa: E402
from sphinx.application import Sphinx  # noqa: E402

import wavefield  # noqa: E402

project = "wavefield"
author = copyright = "the wavefield developers"
version = release = wavefield.__version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.viewcode",
    "numpydoc",
    "myst_nb",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["_build", "by_task.md", "examples", "gallery/*.ipynb"]
templates_path = ["_templates"]
nitpicky = False

html_theme = "pydata_sphinx_theme"
html_title = f"wavefield {version.split('+')[0]}"
html_math_renderer = "mathml"
html_sidebars = {page: [] for page in ("install", "first-experiment", "contributing", "changelog")}
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_theme_options = {
    "show_prev_next": False,
    "navbar_align": "left",
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "use_edit_page_button": False,
    "header_links_before_dropdown": 7,
}

myst_enable_extensions = ["dollarmath", "amsmath", "deflist", "colon_fence"]
myst_heading_anchors = 3
suppress_warnings = ["mystnb.mime_priority"]

autosummary_generate = ["reference.md", "by_task.md"]
autosummary_ignore_module_all = False
autosummary_imported_members = True
autodoc_typehints = "none"
autodoc_member_order = "bysource"
numpydoc_show_class_members = False

nb_execution_mode = "off"  # they hold their outputs: see run_notebooks.py
nb_merge_streams = True

sphinx_gallery_conf = {
    "examples_dirs": "examples",
    "gallery_dirs": "gallery",
    "filename_pattern": r"plot_",
    "image_scrapers": ("site_parts.last_figure",),
    "capture_repr": (),
    "download_all_examples": False,
    "show_memory": False,
    "min_reported_time": 3600,
    "abort_on_example_error": True,
    "remove_config_comments": True,
}


def setup(app: Sphinx) -> None:
    """Read docstrings as they are meant, before numpydoc does."""
    app.connect("autodoc-process-docstring", site_parts.keep_formulas, priority=100)
    app.add_html_math_renderer("mathml", (site_parts.inline_formula, None), (site_parts.block_formula, None))


shutil.rmtree(HERE / "notebooks", ignore_errors=True)
shutil.copytree(ROOT / "notebooks", HERE / "notebooks")
site_parts.demo(HERE / "examples" / "wavefield-demo")
site_parts.write_commands(HERE / "commands")
site_parts.write_reference(HERE / "by_task.md")
