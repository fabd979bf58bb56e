"""Formulas as MathML, made when the site is built: browsers draw it themselves, so that nothing has to be loaded."""

from __future__ import annotations

import html
import re
from typing import Any

from latex2mathml.converter import convert
from mkdocs.exceptions import PluginError

BARE = re.compile(r"\\(mathbf|mathrm|boldsymbol|bar|hat)\s*(\\[A-Za-z]+|(?<=\s)[A-Za-z])(?![A-Za-z])")  # without braces
UPPER_GREEK = re.compile("<mi>(?=&#x0*(39[1-9A-F]|3A[0-9]);</mi>)")
FORMULA = re.compile(r'<(span|div) class="arithmatex">(?:\\\(|\\\[)(.*?)(?:\\\)|\\\])</\1>', re.DOTALL)


def on_page_content(content: str, *, page: Any, **_: Any) -> str:
    """Put MathML in place of what `pymdownx.arithmatex` has marked as a formula."""

    def drawn(found: re.Match[str]) -> str:
        tag, latex = found[1], html.unescape(found[2]).strip()
        try:
            return f'<{tag} class="formula">{mathml(latex, is_block=tag == "div")}</{tag}>'
        except Exception as error:
            raise PluginError(f"{page.file.src_uri}: no formula can be made of {latex!r}: {error}") from error

    return FORMULA.sub(drawn, content)


def mathml(latex: str, *, is_block: bool) -> str:
    """One formula as MathML. Raises `ValueError` for commands that are not known."""
    latex = BARE.sub(r"\\\1{\2}", latex)  # the converter takes only what is in braces
    made = convert(latex, display="block" if is_block else "inline")
    made = UPPER_GREEK.sub('<mi mathvariant="normal">', made)
    unknown = re.search(r"\\[A-Za-z]+", html.unescape(made))
    if unknown:
        raise ValueError(f"{unknown[0]} is not known")
    return made
