"""Settings of Sphinx for the site; docs/site/build.py writes the pages that it reads."""

import loopcal

project = "loopcal"
author = "loopcal developers"
release = loopcal.__version__
html_title = f"loopcal {release}"
extensions = ["myst_parser", "sphinx.ext.autodoc"]
myst_heading_anchors = 4
suppress_warnings = ["misc.highlighting_failure"]  # console sessions and readings are no programs
autodoc_typehints = "description"
autodoc_typehints_format = "short"
html_theme = "furo"
html_show_sourcelink = False
html_copy_source = False
html_js_files = ["versions.js"]  # build.py writes it, versions.py writes it anew
templates_path = ["templates"]
html_sidebars = {
    "**": [
        *(
            "sidebar/brand.html",
            "versions.html",
            "sidebar/search.html",
            "sidebar/scroll-start.html",
        ),
        *("sidebar/navigation.html", "sidebar/scroll-end.html"),
    ]
}
