"""Sphinx's settings for `make docs`, copied beside the pages. What a warning names stops the build."""

project = "RobotKube"
root_doc = "index"
extensions = ["myst_parser"]
source_suffix = {".md": "markdown"}
myst_heading_anchors = 6
# Headings may skip a level; an excerpt that is no whole document of its language is shown without colours.
suppress_warnings = ["myst.header", "misc.highlighting_failure"]
highlight_language = "none"
smartquotes = False

html_theme = "furo"
html_title = "RobotKube"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
html_show_copyright = False
