"""`python -m jaxgeo` is the command `jaxgeo`."""

from jaxgeo.cli import main

main()
