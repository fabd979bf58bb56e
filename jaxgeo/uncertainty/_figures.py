"""Numbers in sentences."""

from __future__ import annotations

from typing import Any


def figure(value: Any, digits: int = 3, sign: str = "") -> str:
    """A number with some significant digits, in full where it is large: 12000, not 1.2e+04. `sign` "+" writes both."""
    text = f"{float(value):{sign}.{digits}g}"
    return f"{float(text):{sign}.0f}" if "e+" in text else text
