"""XML as GDAL reads it: bytes of UTF-8 whatever the declaration says, names alike in small and capital letters."""

from __future__ import annotations

import re
from collections.abc import Iterator
from xml.etree.ElementTree import Element

from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import ParseError, fromstring

_DECLARATION = re.compile(r"^\s*<\?xml[^>]*\?>")


def root_of(content: bytes) -> Element:
    """The root of a document. Raises `ValueError` for what is no XML, or has definitions of its own.

    The declaration is left out: by the encoding that it names, other text would be found here than GDAL finds.
    """
    text = content.decode("utf-8-sig", errors="replace")
    try:
        return fromstring(_DECLARATION.sub("", text), forbid_dtd=True)
    except (ParseError, DefusedXmlException) as error:
        raise ValueError(str(error)) from error


def entries(element: Element) -> Iterator[tuple[str, str]]:
    """(name in small letters, text) of an element's attributes and children, which GDAL takes for the same."""
    for name, value in element.attrib.items():
        yield name.lower(), value
    for child in element:
        yield str(child.tag).lower(), child.text or ""


def entry(element: Element, name: str) -> str:
    """The first of an element's entries of a name; empty where there is none."""
    return next((text.strip() for key, text in entries(element) if key == name), "")
