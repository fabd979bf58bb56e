"""Accuracy limits of a standard for 1:500 maps."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Limits:
    """Largest allowed root mean square errors in plan and in height, m, and the standard that sets them.

    Raises `ValueError` if a limit is not positive and finite, or the source is empty.
    """

    plane: float
    height: float
    source: str

    def __post_init__(self) -> None:
        for name, value in (("plane", self.plane), ("height", self.height)):
            if not 0.0 < value < math.inf:
                raise ValueError(f"the limit in {name} must be positive and finite, in m; got {value!r}.")
        if not self.source.strip():
            raise ValueError("limits need their source: the standard, its year and clause.")

    def hold(self, plane: float, height: float) -> bool:
        """Whether errors in plan and in height, m, are within the limits."""
        return plane <= self.plane and height <= self.height


# 0.6 mm on the map, for detail points in flat and hilly ground. The paper names CH/Z 3003-2010 and
# GB/T 23236-2009 and quotes neither; their own limits for densified points can be passed instead.
HILLS_AT_1_500 = Limits(
    plane=0.6e-3 * 500.0,
    height=0.40,
    source="plan 0.6 mm on the map: GB/T 7931-2008, 6.1, for flat and hilly ground; height 0.4 m, of spot heights "
    "there at 1:500: Pan Zhengfeng, Quality control of large-scale digital topographic maps, Wuhan University",
)
