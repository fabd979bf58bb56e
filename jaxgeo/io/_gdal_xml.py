"""XML as parsed by GDAL: UTF-8 regardless of the declaration, case-insensitive names."""

from __future__ import annotations

import re
from collections.abc import Iterator
from xml.etree.ElementTree import Element

from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import ParseError, fromstring

_DECLARATION = re.compile(r"^\s*<\?xml[^>]*\?>")


def root_of(content: bytes) -> Element:
    """The root of a document. Raises `ValueError` for invalid XML, or with entity definitions.

    The declaration is removed: with its encoding, this parser could see other text than GDAL does.
    """
    text = content.decode("utf-8-sig", errors="replace")
    try:
        return fromstring(_DECLARATION.sub("", text), forbid_dtd=True)
    except (ParseError, DefusedXmlException) as error:
        raise ValueError(str(error)) from error


def entries(element: Element) -> Iterator[tuple[str, str]]:
    """(name in lower case, text) of an element's attributes and children, which GDAL treats alike."""
    for name, value in element.attrib.items():
        yield name.lower(), value
    for child in element:
        yield str(child.tag).lower(), child.text or ""


def entry(element: Element, name: str) -> str:
    """The first of an element's entries of a name; empty if there is none."""
    return next((text.strip() for key, text in entries(element) if key == name), "")
