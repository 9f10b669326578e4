"""Mathematics as MathML, made by docutils at build time: browsers show it without any script."""

from __future__ import annotations

from html import escape
from typing import Any

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.writers.html5 import HTML5Translator

logger = logging.getLogger(__name__)


def mathml(source: str, *, block: bool, where: nodes.Element) -> str:
    """One formula as MathML; what cannot be converted is a warning and shown as it is written."""
    try:
        return str(tex2mathml(source, as_block=block))
    except (MathError, SyntaxError) as error:
        logger.warning("cannot convert the formula %r: %s", source, error, location=where)
        return f"<code>{escape(source)}</code>"


def visit_inline(self: HTML5Translator, node: nodes.Element) -> None:
    """A formula in a line."""
    self.body.append(mathml(node.astext(), block=False, where=node))
    raise nodes.SkipNode


def visit_block(self: HTML5Translator, node: nodes.Element) -> None:
    """A formula of its own, with its number where it has one."""
    number = f'<span class="eqno">({node["number"]})</span>' if node.get("number") else ""
    target = f' id="{node["ids"][0]}"' if node["ids"] else ""
    formula = mathml(node.astext(), block=True, where=node)
    self.body.append(f'<div class="math"{target}>{number}{formula}</div>\n')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the renderer under the name ``mathml``."""
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
