"""Eqs 1 to 36 of Li et al. (2020) as printed, in NumPy, compared with this package's functions at the same inputs.

Where the print is wrong, the corrected formula is compared with the function, and with an independent computation if
available.
"""

from jaxgeo.studies.claims import Claim
from jaxgeo.studies.li2020.equations.common import PAPER
from jaxgeo.studies.li2020.equations.earth import earth
from jaxgeo.studies.li2020.equations.gauss_krueger import gauss_krueger
from jaxgeo.studies.li2020.equations.overlap import attitude, overlap
from jaxgeo.studies.li2020.equations.sight import compensation, frames, rays
from jaxgeo.studies.li2020.equations.timing import timing

__all__ = ["PAPER", "equations"]


def equations() -> list[Claim]:
    """A claim for every numbered equation, in order; unnumbered ones follow the equation they come after."""
    return [
        *overlap(),
        *frames(),
        *earth(),
        *gauss_krueger(),
        *rays(),
        *attitude(),
        *compensation(),
        *timing(),
    ]
