"""Entry point of `python -m jaxgeo`, the same as the command `jaxgeo`."""

from jaxgeo.cli import main

main()
