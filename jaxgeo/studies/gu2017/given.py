"""Input of a user-supplied image, with its map and navigation."""

from __future__ import annotations

import pathlib

import numpy as np

from jaxgeo.io.images import check_size, read_image
from jaxgeo.io.orthoimages import read_orthoimage
from jaxgeo.io.reach import HERE, Reach
from jaxgeo.io.scene import SceneError, read_scene
from jaxgeo.register import TieErrors
from jaxgeo.studies.gu2017.scene import LEAST_MATCH, SIGMA_TERRAIN, Imaged, navigation
from jaxgeo.terrain import AbstractTerrain


def read(
    image: pathlib.Path,
    reference: pathlib.Path,
    scene: pathlib.Path,
    terrain: AbstractTerrain,
    sigmas: tuple[float, float],
    reach: Reach = HERE,
) -> Imaged:
    """Read an image file, the orthoimage of its ground and its scene file; `sigmas` in m and deg are the navigation's,
    `reach` is what the reading of the two rasters may touch.

    The orthoimage is assumed accurate to one of its cells, the terrain to `SIGMA_TERRAIN`. Raises `SceneError` for a
    scene without a pose, `ImageError` for invalid images or images of another size.
    """
    described = read_scene(scene)
    if described.shot is None:
        raise SceneError(f"{scene}: [pose] is missing; a registration needs it.")
    values, known = read_image(image, allow_remote=reach.remote, allow_outside=reach.outside)
    check_size(str(image), values.shape, described.sensor.camera)
    grey = np.asarray(values, float).mean(axis=0)
    ortho = read_orthoimage(reference, allow_remote=reach.remote, allow_outside=reach.outside)
    errors = TieErrors(registration=LEAST_MATCH, terrain=SIGMA_TERRAIN, shift=ortho.ground_sampling)
    return Imaged(described.sensor, described.shot, grey, known, ortho, terrain, navigation(*sigmas), errors)
