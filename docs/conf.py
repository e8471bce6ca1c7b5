"""Sphinx's settings: Markdown pages, equations as MathML, all offline."""

from typing import Any

from docutils.nodes import SkipNode
from latex2mathml.converter import convert
from pygments.lexers.special import TextLexer
from sphinx.application import Sphinx

import percept

project = "percept"
author = "The percept developers"
release = version = percept.__version__

extensions = ["myst_parser"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3

html_theme = "furo"
html_title = f"percept {release}"
html_math_renderer = "mathml"
html_copy_source = False
html_show_copyright = False


def _inline(writer: Any, node: Any) -> None:
    writer.body.append(convert(node.astext()))
    raise SkipNode  # or the source would follow


def _display(writer: Any, node: Any) -> None:
    writer.body.append(f"<p>{convert(node.astext(), display='block')}</p>")
    raise SkipNode


def setup(app: Sphinx) -> None:
    """Write equations as MathML: browsers show it without a script. A CSV is shown as it is."""
    app.add_lexer("csv", TextLexer)
    app.add_html_math_renderer("mathml", (_inline, None), (_display, None))
