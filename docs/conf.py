"""Settings of the documentation site, which `make docs` builds with Sphinx.

Nothing is downloaded while it builds: fonts, styles and scripts come with the installed packages.
"""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE / "extensions"))

from packit_sim.core.version import DOCUMENTATION, __version__  # noqa: E402

project = "PackIt-Sim"
author = "PackIt-Sim contributors"
copyright = f"2026, {author}"
release = version = __version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
    "command_pages",
    "public_names",
    "root_pages",
    "thumbnails",
]
exclude_patterns = ["examples", "static", "templates"]
templates_path = ["templates"]
root_doc = "index"
default_role = "py:obj"
nitpicky = True
nitpick_ignore_regex = [
    ("py:.*", r"(?!packit_sim\b|packit_agents\b).*"),
    ("py:.*", r"packit_sim\..*\._\w+"),
    ("py:obj", r"packit_sim\.(\w+_policies|searches|commands|shape_sources)"),
    (
        "py:.*",
        r"packit_sim\.(box\.(BaseBox|Disturbance)|core\.typed_json\.JsonRecord|engine\..*"
        r"|game\.envs\.(pictures\.Pictured|specs\.WritableSpec)"
        r"|game\.evaluation\.executed\.Executed"
        r"|geometry\.(deviation\.Surface|items\.(AtPose|ItemT|PosedItem)|parts\.Parts|voxels\.Voxels)"
        r"|libraries\.sources\.Source"
        r"|parts\.nesting\.balance\.Balance"
        r"|parts\.packings\.(checked_items\.CheckedItem|containers\.(Container|Measured))"
        r"|parts\.reading\.(file_copies\.FileCopy|limits\.Limits \| .*|powder\.Powder)"
        r"|physics\.(convex\.pieces\.Piece|settling\.FittedItem)|robot\.trajectory\.Trajectory)",
    ),
]
"""Names that have no page: those of other libraries, whose pages are not downloaded, and a few
internal classes that signatures name, and groups of entry points."""

html_theme = "furo"
html_title = "PackIt-Sim"
html_baseurl = DOCUMENTATION + "/"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_show_sourcelink = False

myst_enable_extensions = ["attrs_block", "colon_fence", "deflist", "html_image"]
myst_heading_anchors = 4

autosummary_generate = True
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_type_aliases = {
    name: name for name in ("Mask", "Triple", "Observation", "Floats", "Ints", "RGBImage")
}
autoclass_content = "class"
python_use_unqualified_type_names = True
napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False
napoleon_preprocess_types = False

copybutton_prompt_text = r"\$ |>>> |\.\.\. "
copybutton_prompt_is_regexp = True
copybutton_only_copy_prompt_lines = True
copybutton_line_continuation_character = "\\"

sphinx_gallery_conf = {
    "examples_dirs": "examples",
    "gallery_dirs": "gallery",
    "filename_pattern": r"/plot_",
    "image_scrapers": ("saved_pictures.saved_pictures",),
    "reset_modules": (),
    "abort_on_example_error": True,
    "download_all_examples": False,
    "show_memory": False,
    "show_signature": False,
    "write_computation_times": False,
    "min_reported_time": 60,
    "doc_module": ("packit_sim",),
    "backreferences_dir": "gallery/backreferences",
    "remove_config_comments": True,
}
