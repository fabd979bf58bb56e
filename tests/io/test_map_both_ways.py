"""Maps whose way back PROJ takes from a short series: posts lie where the map's own formula has them."""

from __future__ import annotations

import numpy as np
import pyproj
import pytest

from jaxgeo.io.errors import DemError
from jaxgeo.io.gridding import make_grid
from jaxgeo.io.mapping import file_map

MAPS = {
    "LAEA Europe": (3035, 4_321_000.0, 3_600_000.0),
    "LAEA Europe, south-west": (3035, 2_700_000.0, 1_600_000.0),
    "EASE-Grid 2.0": (6933, 1_000_000.0, 4_100_000.0),
    "Albers": (5070, 100_000.0, 2_000_000.0),
    "Lambert": (2154, 700_000.0, 6_600_000.0),
}


@pytest.mark.parametrize("name", MAPS)
def test_posts_lie_where_the_formula_of_the_map_has_them(name: str) -> None:
    code, west, north = MAPS[name]
    crs = pyproj.CRS(code)
    mapping = file_map(name, crs, (25.0, 0.0, west, 0.0, -25.0, north), (2000, 3000))
    rowcol = np.random.default_rng(5).uniform(0.0, 1999.0, (300, 2))
    lon, lat = mapping.lonlat(rowcol[:, 0], rowcol[:, 1])
    formula = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True, allow_ballpark=False)
    x, y = formula.transform(lon, lat)
    np.testing.assert_allclose(x, west + 25.0 * rowcol[:, 1], rtol=0, atol=1e-6)
    np.testing.assert_allclose(y, north - 25.0 * rowcol[:, 0], rtol=0, atol=1e-6)
    np.testing.assert_allclose(np.stack(mapping.rowcol(lon, lat), axis=1), rowcol, rtol=0, atol=1e-6)
    _, error = make_grid(name, mapping)
    assert error.worst < 1e-4


BODIES = {"Moon": 1_737_400.0, "Mars": 3_396_190.0, "Venus": 6_051_800.0}


@pytest.mark.parametrize("assume_wgs84", [True, False])
@pytest.mark.parametrize("body", BODIES)
def test_another_body_is_not_taken_as_the_earth(body: str, assume_wgs84: bool) -> None:
    crs = pyproj.CRS.from_wkt(
        f'GEOGCRS["{body}",DATUM["{body}",ELLIPSOID["{body}",{BODIES[body]},0]],CS[ellipsoidal,2],'
        'AXIS["lat",north],AXIS["lon",east],ANGLEUNIT["degree",0.0174532925199433]]'
    )
    with pytest.raises(DemError, match=rf"'{body}' is of a body with semi-axes of .* which is not the Earth"):
        file_map("dem.tif", crs, (0.1, 0.0, 5.0, 0.0, -0.1, 45.0), (5, 5), assume_wgs84=assume_wgs84)


@pytest.mark.parametrize("ellipsoid", ["clrk66", "bessel", "airy", "evrst30", "sphere"])
def test_older_ellipsoids_and_spheres_of_the_earth_are(ellipsoid: str) -> None:
    crs = pyproj.CRS.from_proj4(f"+proj=longlat +ellps={ellipsoid} +no_defs")
    mapping = file_map("dem.tif", crs, (0.1, 0.0, 5.0, 0.0, -0.1, 45.0), (5, 5), assume_wgs84=True)
    assert "WGS 84 by the caller" in mapping.horizontal
