"""Relief of a few posts, interpolated for display."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

FEW_POSTS = 100  # along a side of the visible part; fewer are interpolated
FINE_POINTS = 320  # along its longer side


class Posts(NamedTuple):
    """Longitudes and latitudes in deg and heights in m (rows, cols) of posts; voids are NaN."""

    lon: np.ndarray
    lat: np.ndarray
    height: np.ndarray


def interpolated(posts: Posts, ax: Axes) -> Posts:
    """The posts, or if the limits of the axes are set and show a few of them, finer points between those.

    By cubic splines: smoother than the terrain that rays meet, for display only.
    """
    from scipy import ndimage  # takes as long to import as all else here

    (west, east), (south, north) = ax.get_xlim(), ax.get_ylim()
    seen = (posts.lon >= west) & (posts.lon <= east) & (posts.lat >= south) & (posts.lat <= north)
    if ax.get_autoscalex_on() or ax.get_autoscaley_on() or not seen.any():
        return posts
    spans = [np.flatnonzero(seen.any(axis=axis)) for axis in (1, 0)]
    if max(span[-1] - span[0] for span in spans) >= FEW_POSTS:
        return posts
    rows, cols = (slice(max(span[0] - 3, 0), span[-1] + 4) for span in spans)
    part = Posts(*(leaf[rows, cols] for leaf in posts))
    finer = max(2, math.ceil(FINE_POINTS / max(part.height.shape)))
    place = np.meshgrid(*(np.arange((n - 1) * finer + 1) / finer for n in part.height.shape), indexing="ij")
    void = np.isnan(part.height)
    filled = part._replace(height=np.where(void, np.nanmean(part.height) if not void.all() else 0.0, part.height))
    lon, lat, height = (
        ndimage.map_coordinates(leaf, place, order=order, mode="mirror")
        for leaf, order in zip(filled, (1, 1, 3), strict=True)
    )
    is_void = ndimage.map_coordinates(void.astype(float), place, order=1) > 0.0
    return Posts(lon, lat, np.where(is_void, np.nan, height))
