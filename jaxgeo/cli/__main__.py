"""`python -m jaxgeo.cli` is the command `jaxgeo`."""

from __future__ import annotations

from jaxgeo.cli import main

main()
