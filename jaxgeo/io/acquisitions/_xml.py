"""XML files of other programs, without definitions of their own."""

from __future__ import annotations

import os
import re
import xml.etree.ElementTree as ET

import numpy as np

from jaxgeo._text_numbers import numbers_in, words_of
from jaxgeo.io._text import read_text
from jaxgeo.io.errors import TableError


def root_of(path: str | os.PathLike[str], what: str) -> ET.Element:
    """The root element. Raises `TableError` for a DOCTYPE and for text that is no XML, `FileNotFoundError`."""
    text = read_text(path, what)
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise TableError(f"{path}: XML with definitions of its own (DOCTYPE) is not read.")
    try:
        return ET.fromstring(re.sub(r"^\s*<\?\s*xml[^>]*\?>", "", text))
    except ET.ParseError as error:
        raise TableError(f"{path}: not an XML file, or cut off: {error}.") from error


def numbers_of(where: str, element: ET.Element | None, count: int) -> np.ndarray:
    """The numbers in an element. Raises `TableError` unless there are `count`."""
    text = "" if element is None or element.text is None else element.text
    found = numbers_in(words_of(text))
    if found is None or len(found) != count:
        raise TableError(f"{where}: expected {count} numbers; got {text.strip()[:60]!r}.")
    return np.array(found)
