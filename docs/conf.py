"""Settings of Sphinx for the documentation site: ``make docs`` writes it into build/docs.

The pages are the Markdown files of the whole tree, where they stand. What is generated from the code
(``tools.reference_pages``) goes into docs/reference before they are read.
"""

import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from hil import __version__  # noqa: E402
from tools import reference_pages  # noqa: E402

project = "mecanum-hil"
version = release = __version__
root_doc = "docs/index"
include_patterns = ["docs/**", "*.md", "tests/**/*.md", "hil/**/*.md", "firmware_protocol/*.md", "plant_fmu/*.md"]
include_patterns += ["firmware_protocol/port/*.md", "plant_fmu/*/*.md"]
exclude_patterns = ["docs/examples/runs"]
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton"]
html_theme = "furo"
html_title = "mecanum-hil"
html_show_sourcelink = False

nb_execution_mode = "off"  # the tests run the notebook
myst_enable_extensions = []  # no formulas in TeX: a page would fetch what draws them from elsewhere
myst_heading_anchors = 4
copybutton_prompt_text = "$ "
napoleon_use_ivar = True  # else attributes are described twice
autodoc_typehints = "description"
autodoc_member_order = "bysource"
highlight_language = "text"


def setup(app: Any) -> None:
    """Write the generated pages before Sphinx looks for pages."""
    app.connect("config-inited", lambda _app, _config: reference_pages.write(ROOT / "docs" / "reference"))
