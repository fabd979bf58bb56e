"""How often the searches of the literature find the first hit over rough mountains, and what they ask of the DEM."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from support.fractal import TangentTerrain, walk_every_cell
from support.fractal import fractal_posts as reference_posts

from jaxgeo.studies.scenes import CENTRE, Scene, fractal_posts, make_scene, rms_slope_of
from jaxgeo.studies.terrain_searches import (
    FIRST_HIT,
    PRINTED_MS,
    SEARCHES,
    Row,
    located,
    printed_table,
    searches_table,
    study,
)
from jaxgeo.terrain import Outcome

MOUNTAIN = {"rms_slope": math.radians(22.0), "depression": math.radians(11.2)}
VERY_STEEP = {"rms_slope": math.radians(47.0), "depression": math.radians(11.2)}
CHEAP = ["photogrammetric", "improved, secant", "segmented", "fast", "fast, Zmax of the DEM", "first hit"]


def rows_of(scene: Scene, names: list[str]) -> dict[str, Row]:
    return {row.search: row for row in study(scene, {name: SEARCHES[name] for name in names}, repeats=0)}


def found_first(rows: dict[str, Row], name: str) -> float:
    return rows[name].share(Outcome.first_hit)


def test_posts_have_the_stated_slope_and_the_formula_of_the_reference() -> None:
    posts = fractal_posts(65, spacing=30.0, rms_slope=math.radians(22.0), seed=3)
    assert rms_slope_of(posts, 30.0) == pytest.approx(math.radians(22.0), abs=1e-12, rel=0)
    reference = reference_posts(65, spacing=30.0, relief=float(posts.max()), exponent=3.39, seed=3)
    np.testing.assert_allclose(posts, reference, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_outcome_shares_over_mountains() -> None:
    """256 rays, so one standard deviation of a share is up to 3 points."""
    rows = rows_of(make_scene("mountain", rays=256, size=1001, **MOUNTAIN), CHEAP)
    assert 0.58 < rows["photogrammetric"].share(Outcome.cycled) < 0.82
    assert 0.80 < found_first(rows, "improved, secant") < 0.95
    assert 0.80 < found_first(rows, "segmented") < 0.95
    assert 0.93 < found_first(rows, "fast") < 1.0
    assert 0.96 < found_first(rows, "fast, Zmax of the DEM") <= 1.0
    assert found_first(rows, "first hit") == 1.0
    assert 0.5 < rows["fast"].evaluations / rows["segmented"].evaluations < 0.8
    assert 20.0 < rows["first hit"].evaluations < 45.0


@pytest.mark.slow
def test_outcome_shares_over_mountains_with_many_rays() -> None:
    rows = rows_of(make_scene("mountain", rays=4000, **MOUNTAIN), [*CHEAP, "improved, as printed"])
    assert 0.62 < rows["photogrammetric"].share(Outcome.cycled) < 0.80  # two in three and some
    for name in ("improved, secant", "improved, as printed", "segmented"):
        assert found_first(rows, name) == pytest.approx(0.88, abs=0.035), name
    assert found_first(rows, "fast, Zmax of the DEM") == pytest.approx(0.99, abs=0.01)
    for name in ("fast", "fast, Zmax of the DEM"):
        assert -0.45 < rows[name].evaluations / rows["segmented"].evaluations - 1.0 < -0.30, name


@pytest.mark.slow
def test_outcome_shares_over_very_steep_terrain() -> None:
    rows = rows_of(make_scene("very steep", rays=4000, **VERY_STEEP), ["fast", "fast, Zmax of the DEM"])
    for name in rows:
        assert found_first(rows, name) == pytest.approx(0.82, abs=0.05), name
        assert rows[name].share(Outcome.farther_hit) > 0.1, name
    assert rows["fast, Zmax of the DEM"].share(Outcome.failed) == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("kind", [MOUNTAIN, VERY_STEEP], ids=["mountain", "very steep"])
def test_the_first_hit_beside_them_is_always_right(kind: dict[str, float]) -> None:
    """Against a walk over every cell under the ray."""
    scene = make_scene("any", rays=300, **kind)
    terrain = TangentTerrain(np.asarray(scene.dem.posts), float(CENTRE.lat), float(CENTRE.lon), 30.0)
    origin, direction = np.asarray(scene.rays.origin), np.asarray(scene.rays.direction)
    distance, _ = located(scene.rays, scene.dem, FIRST_HIT)
    for o, d, found in zip(origin, direction, np.asarray(distance), strict=True):
        walked = walk_every_cell(terrain, o, d, 0.0, found + 3000.0)
        assert abs(walked.distance - found) < 1e-3 or walked.closest < 1e-6


def test_tables_have_all_rows() -> None:
    row = Row("", "", 12.5, 9.0, 201, (0.9, 0.1, 0.0, 0.0, 0.0, 0.0), 3552.0, 26.2)
    names = ["exhaustive, first", "improved, secant", "segmented", "fast"]
    rows = [dataclasses.replace(row, scene=scene, search=name) for scene in PRINTED_MS for name in names]
    table = searches_table(rows).splitlines()
    assert len(table) == 2 + 12
    assert table[2].split() == "plain exhaustive, first 12.5 9 201 90.0 10.0 0.0 0.0 0.0 0.0 3552 26.2".split()
    printed = printed_table(rows).splitlines()
    assert len(printed) == 2 + 12
    assert printed[10].split()[:4] == ["mountain", "exhaustive", "1249840", "62.16"]
