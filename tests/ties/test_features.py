"""Tie points by keypoints: SIFT and ORB of OpenCV, and a class of one's own, against the poses that rendered them."""

from __future__ import annotations

import pathlib
from dataclasses import dataclass

import numpy as np
import pytest
import scipy
from support.drone_strip import Strip, ground, strip
from support.misleading_scenes import periodic, plain, shown, squared_errors
from support.unlike_images import off_true_rays

from jaxgeo.ties import (
    AbstractFeatures,
    ImageKeypoints,
    KeptMatches,
    Keypoints,
    Matching,
    OrbFeatures,
    Pictures,
    SiftFeatures,
    Ties,
    correct,
    find_ties,
)
from jaxgeo.ties.feature_matching import _on_planes
from jaxgeo.ties.features import TILE, unit_vectors
from jaxgeo.ties.ground import planes_at
from jaxgeo.ties.pair_geometry import geometry_of

HOW = Matching(sigma_height=2.0)


@dataclass(frozen=True)
class Blobs(AbstractFeatures):
    """Extrema of a Laplacian of Gaussian to a part of a pixel, with the smoothed grey values around them. It has no
    rotation: for images that are turned by a few degrees."""

    width: float = 2.0
    half: int = 8

    def find(self, grey: np.ndarray, known: np.ndarray) -> Keypoints:
        values = scipy.ndimage.gaussian_laplace(grey.astype(float), self.width)
        size = np.abs(values)
        size[: self.half + 1], size[-self.half - 1 :] = 0.0, 0.0
        size[:, : self.half + 1], size[:, -self.half - 1 :] = 0.0, 0.0
        rows, cols = np.nonzero((size == scipy.ndimage.maximum_filter(size, 5)) & (size > 0.0) & known)
        smooth = scipy.ndimage.gaussian_filter(grey.astype(float), self.width)
        steps = np.arange(-self.half, self.half + 1, 2)
        around = smooth[(rows[:, None] + steps)[:, :, None], (cols[:, None] + steps)[:, None, :]]
        centre = size[rows, cols]
        offset = []
        for down, across in ((0, 1), (1, 0)):  # the top of a parabola, column first
            before, after = size[rows - down, cols - across], size[rows + down, cols + across]
            offset.append(0.5 * (before - after) / np.minimum(before - 2.0 * centre + after, -1e-12))
        uv = np.stack([cols, rows], axis=1) + np.clip(np.stack(offset, axis=1), -0.5, 0.5)
        return Keypoints(uv, around.reshape(len(rows), -1), centre)


def of_opencv(features: type) -> AbstractFeatures:
    pytest.importorskip("cv2", reason="needs the extra: pip install 'jaxgeo[features]'")
    return features()


def tied(here: Strip, features: AbstractFeatures, points: int = 96, **options) -> Ties:
    return find_ties(here.views, ground(1.0), here.pictures, HOW, points=points, features=features, **options)


@pytest.fixture(scope="module")
def here() -> Strip:
    return shown(strip(seed=1), plain, 1)


def check_errors_as_stated(here: Strip, ties: Ties, least: int, worst_px: float) -> None:
    """Errors of the matches are as stated, and so are those of the poses."""
    assert ties.observations is not None
    off, variance = off_true_rays(here, ties.observations)
    assert len(off) > least
    assert np.sqrt(np.mean(off**2)) < worst_px
    assert 0.5 < np.mean(off**2 / variance) < 1.6  # the sigma of each of five pairs is known to a tenth
    found = correct(here.views, ties)
    each, together = squared_errors(here, found)
    assert max(each) < scipy.stats.chi2.ppf(0.999, 6)
    assert together < scipy.stats.chi2.ppf(0.999, 6 * len(each))


@pytest.mark.costly
def test_keypoints_of_a_class_of_one_s_own_are_tied(here: Strip) -> None:
    ties = tied(here, Blobs())
    assert ties.unconnected == ["image 4"]
    check_errors_as_stated(here, ties, 60, 0.4)


@pytest.mark.costly
def test_sift_is_tied(here: Strip) -> None:
    ties = tied(here, of_opencv(SiftFeatures))
    assert ties.unconnected == ["image 4"]
    check_errors_as_stated(here, ties, 100, 0.15)


@pytest.mark.costly
def test_orb_is_tied(here: Strip) -> None:
    ties = tied(here, of_opencv(OrbFeatures))
    assert len(ties.parts[0]) > 1
    check_errors_as_stated(here, ties, 50, 0.9)


@pytest.mark.costly
@pytest.mark.parametrize("features", [Blobs, SiftFeatures])
def test_a_repeated_texture_is_not_tied(features: type) -> None:
    features = Blobs() if features is Blobs else of_opencv(features)
    assert tied(shown(strip(), periodic), features).observations is None


@pytest.mark.costly
def test_few_points_have_no_sigma_and_are_not_tied(here: Strip) -> None:
    """Twelve points, of which half show in the other image: fewer residuals than three beyond the poses' own."""
    ties = tied(here, Blobs(), points=12)
    assert all(one.tied == 0 or one.tied > 8 for one in ties.pairs)


@pytest.mark.costly
def test_kept_matches_are_read_again_for_the_same_features(here: Strip, tmp_path: pathlib.Path) -> None:
    reused, found = [], []
    for features in (Blobs(), Blobs(), Blobs(width=1.8)):
        kept = KeptMatches(tmp_path, lambda row: f"image {row}")
        found.append(tied(here, features, kept=kept).observations)
        reused.append(kept.reused)
    assert reused[0] == reused[2] == 0 < reused[1]
    assert found[0] is not None
    assert found[1] is not None
    np.testing.assert_array_equal(found[0].uv, found[1].uv)


class Unnamed(Blobs):
    __repr__ = object.__repr__


@pytest.mark.costly
def test_features_without_a_name_of_their_settings_are_not_kept(here: Strip, tmp_path: pathlib.Path) -> None:
    kept = KeptMatches(tmp_path / "kept", lambda row: f"image {row}")
    assert tied(here, Unnamed(), kept=kept).observations is not None
    assert not kept.folder.exists()


@pytest.mark.parametrize("features, off_px", [(SiftFeatures, 0.1), (OrbFeatures, 1.0)])
def test_keypoints_are_counted_from_the_centre_of_the_first_pixel(features: type, off_px: float) -> None:
    """An image turned by 180 degrees has them at the opposite pixels: an origin that is off would show twice."""
    rng = np.random.default_rng(2)
    grey = scipy.ndimage.gaussian_filter(rng.normal(size=(301, 344)), 3.0).astype(np.float32)
    found = of_opencv(features)
    first, second = (
        found.find(np.ascontiguousarray(one), np.ones(one.shape, bool)) for one in (grey, grey[::-1, ::-1])
    )
    scores = unit_vectors(first.descriptors) @ unit_vectors(second.descriptors).T
    best = np.argmax(scores, axis=1)
    sure = scores[np.arange(len(best)), best] > 0.9
    off = (first.uv + second.uv[best] - (343.0, 300.0))[sure]
    off = off[np.all(np.abs(off) < 4.0, axis=1)]
    assert len(off) > 100
    assert np.all(np.abs(np.mean(off, axis=0)) < 0.15)
    assert np.median(np.abs(off)) < off_px


def test_pixels_are_carried_to_the_planes_and_no_further(here: Strip) -> None:
    """Places on the ground that project to the pixels; none above the horizon of a plane."""
    views = here.views
    uv = np.array([[30.0, 40.0], [128.0, 96.0], [200.0, 150.0]])
    geometry = geometry_of(views, (0, 1), planes_at(views, 0, uv, ground(), 32.0))
    target = np.array([[90.0, 20.0], [100.0, 180.0], [250.0, 3.0]])[: len(geometry.rows)]
    shift = _on_planes(views, 1, geometry, target, np.zeros(target.shape))
    there = geometry.origin + np.einsum("na,nax->nx", shift, geometry.axes)
    camera = views.camera_of(1)
    away = (there - views.centre[1]) @ views.R_frame_from_camera[1]
    found = np.asarray(camera.principal_px) + np.asarray(camera.focal_px) * away[:, :2] / away[:, 2:]
    np.testing.assert_allclose(found, target, atol=1e-6)
    beyond = _on_planes(views, 1, geometry, target + np.array([0.0, 1e5]), np.zeros(target.shape))
    assert np.all(np.isnan(beyond))


def test_unknown_pixels_have_no_keypoints() -> None:
    rng = np.random.default_rng(2)
    grey = scipy.ndimage.gaussian_filter(rng.normal(size=(200, 300)), 2.0)
    known = np.ones(grey.shape, bool)
    known[:, 150:] = False
    keypoints = ImageKeypoints(Pictures(lambda row: (grey, known)), Blobs(), 40).of(0)
    assert len(keypoints.uv) > 20
    assert np.max(keypoints.uv[:, 0]) < 150.0


def test_tiles_have_each_keypoint_once_and_at_its_pixel() -> None:
    rng = np.random.default_rng(3)
    grey = scipy.ndimage.gaussian_filter(rng.normal(size=(300, TILE + 400)), 2.0)
    whole = Blobs().find(grey.astype(np.float32), np.ones(grey.shape, bool))
    found = ImageKeypoints(Pictures(lambda row: (grey, None)), Blobs(), 400).of(0)
    assert len(found.uv) == len(whole.uv)
    order, other = (np.lexsort(np.round(one.uv, 3).T) for one in (found, whole))
    np.testing.assert_allclose(found.uv[order], whole.uv[other], atol=1e-3)


def test_descriptors_of_bits_are_compared_bit_by_bit() -> None:
    rng = np.random.default_rng(4)
    bits = rng.integers(0, 256, (2, 32), dtype=np.uint8)
    one, other = unit_vectors(bits)
    differing = np.count_nonzero(np.unpackbits(bits[0]) != np.unpackbits(bits[1]))
    assert one @ other == pytest.approx(1.0 - 2.0 * differing / 256, abs=1e-6)
    numbers = rng.normal(size=(2, 40))
    one, other = unit_vectors(numbers)
    assert one @ other == pytest.approx(np.corrcoef(numbers)[0, 1], abs=1e-6)


@dataclass(frozen=True)
class Wrong(AbstractFeatures):
    answer: object

    def find(self, grey: np.ndarray, known: np.ndarray) -> Keypoints:
        return self.answer  # pyright: ignore[reportReturnType]


@pytest.mark.parametrize(
    "answer, words",
    [
        ((np.zeros((2, 2)), np.zeros((2, 3))), "must return jaxgeo.ties.Keypoints; got tuple"),
        (Keypoints(np.zeros((2, 2)), np.zeros((3, 3)), np.zeros(2)), r"got \(2, 2\), \(3, 3\) and \(2,\)"),
        (Keypoints(np.full((1, 2), 70.0), np.zeros((1, 3)), np.zeros(1)), r"\[70\.0, 70\.0\] .* outside .* 64 x 48 px"),
        (Keypoints(np.full((1, 2), np.nan), np.zeros((1, 3)), np.zeros(1)), "outside"),
        (Keypoints(np.zeros((1, 2)), np.full((1, 3), np.nan), np.zeros(1)), "not numbers"),
    ],
)
def test_what_are_no_keypoints_is_refused(answer, words: str) -> None:
    keypoints = ImageKeypoints(Pictures(lambda row: (np.zeros((48, 64)), None)), Wrong(answer), 10)
    with pytest.raises(ValueError, match=words):
        keypoints.of(0)


def test_features_and_a_measure_of_areas_are_refused_together() -> None:
    how = Matching(measure="orientation")
    with pytest.raises(ValueError, match="give one of the two"):
        find_ties(strip().views, ground(), strip().pictures, how, features=Blobs())
    with pytest.raises(TypeError, match="features"):
        find_ties(strip().views, ground(), strip().pictures, features="sift")  # pyright: ignore[reportArgumentType]
