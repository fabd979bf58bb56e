"""What an adjustment refuses, and that it names the culprit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import equinox as eqx
import numpy as np
import pytest

from jaxgeo import FrameCamera
from jaxgeo.adjust import (
    BehindCamera,
    Block,
    Cartesian,
    DeficientBlock,
    Fixed,
    Free,
    GroundPoints,
    HeightObservations,
    ImagePoints,
    Images,
    Prior,
    Unknowns,
    adjust,
    reliability,
    resect_block,
    resect_image,
)
from jaxgeo.adjust.problem import prepared
from tests.support.scenes import flat, small_dem
from tests.support.simulated_block import (
    CONTROL,
    camera,
    pixels,
    simulated,
    tight,
)

NAMES, UV = ["a", "b"], np.array([[1.0, 2.0], [3.0, 4.0]])


def points(**changes: Any) -> ImagePoints:
    return ImagePoints(**({"image": ["i", "i"], "point": NAMES, "uv": UV, "sigma": 0.5} | changes))


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"uv": np.array([[1.0, 2.0], [np.nan, 4.0]])}, "measurement 1, point b in image i: uv must be finite"),
        ({"sigma": [0.5, 0.0]}, "measurement 1, point b in image i: sigma must be positive and finite, in px; got"),
        ({"sigma": -1.0}, r"point a in image i: sigma must be positive.*\(2 such rows\)"),
        ({"sigma": np.nan}, "sigma must be positive"),
        ({"sigma": np.inf}, "sigma must be positive and finite"),
        ({"sigma": np.ones(3)}, r"sigma must be a number, one for each row, or \(n, 2\), in px; got shape \(3,\)"),
        ({"point": ["a", "a"]}, "point a is measured twice in image i, in rows 0 and 1; keep one of them"),
        ({"uv": np.zeros((3, 2))}, r"got 2 images, 2 points and uv of shape \(3, 2\)"),
    ],
)
def test_image_points(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        points(**changes)


@pytest.mark.parametrize("field", ["image", "point"])
def test_names_are_words(field: str) -> None:
    with pytest.raises(TypeError, match=f"{field} must be a list of names|{field}"):
        points(**{field: np.array([1, 2])})


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"place": np.array([[0.0, 0.0, 0.0], [0.0, np.inf, 0.0]])}, "ground point b: place must be finite, in m"),
        ({"sigma": [0.1, -0.1, 0.1]}, "ground point a: sigma must not be negative or NaN, in m; got"),
        ({"sigma": np.nan}, "ground point a: sigma must not be negative or NaN"),
        ({"sigma": np.ones(2)}, r"sigma must be a number, \(3,\) or \(2, 3\), in m; got shape \(2,\)"),
        ({"name": ["b", "b"]}, r"ground point b is there 2 times, in rows \[0, 1\]; keep one of them"),
        ({"covariance": np.tile(np.diag([1.0, 1.0, -1.0]), (2, 1, 1))}, "ground point a: covariance must be symmetric"),
        (
            {"covariance": np.tile(np.eye(3) + np.eye(3, k=1), (2, 1, 1))},
            "ground point a: covariance must be symmetric",
        ),
        ({"covariance": np.eye(3)}, r"covariance must have the shape \(2, 3, 3\)"),
        ({"place": np.zeros((2, 2))}, r"place must have the shape \(2, 3\), in m"),
    ],
)
def test_ground_points(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        GroundPoints(**({"name": NAMES, "place": np.zeros((2, 3))} | changes))
    known = GroundPoints(NAMES, np.zeros((2, 3)))
    with pytest.raises(ValueError, match="there is no ground point 'c'; known are a, b"):
        known.of(["c"])
    with pytest.raises(ValueError, match="there is no ground point 'c'"):
        known.without(["c"])


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"name": ["a", "a"]}, "image a is there 2 times; names must be unique"),
        ({"centre": np.full((2, 3), np.nan)}, "image a: centre and rotation must be finite"),
        ({"R_frame_from_camera": np.stack([np.eye(3), np.diag([1.0, 1.0, -1.0])])}, "image b: .*must be a rotation"),
        ({"centre": np.zeros((3, 3))}, r"of 2 images, .* got 2, \(3, 3\) and"),
    ],
)
def test_images(changes: dict[str, Any], message: str) -> None:
    given = {
        "name": NAMES,
        "camera": ["c", "c"],
        "centre": np.zeros((2, 3)),
        "R_frame_from_camera": np.stack([np.eye(3)] * 2),
    }
    with pytest.raises(ValueError, match=message):
        Images(**(given | changes))


def some(rows: Any) -> ImagePoints:
    return simulated().observations.of(rows)


def test_an_image_that_there_is_not() -> None:
    seen = simulated().observations
    image = seen.image.copy()
    image[5] = "i99"
    with pytest.raises(ValueError, match=rf"measurement 5, point {seen.point[5]}: there is no image i99 in the block"):
        simulated().block(observations=ImagePoints(image, seen.point, seen.uv, 0.5))


def test_an_image_in_which_nothing_is_measured() -> None:
    with pytest.raises(ValueError, match="nothing is measured in image i03"):
        simulated().block(observations=some(simulated().observations.image != "i03"))


def test_a_point_that_is_seen_once() -> None:
    seen = simulated().observations
    rows = np.flatnonzero(seen.point == "p01")
    keep = np.ones(len(seen), bool)
    keep[rows[1:]] = False
    with pytest.raises(ValueError, match=rf"point p01 is seen once only, in image {seen.image[rows[0]]}, and"):
        simulated().block(observations=some(keep))
    simulated().block(observations=some(keep), control=simulated().control(names=(*CONTROL, "p01")))


def test_nothing_measured() -> None:
    of = simulated()
    none = ImagePoints(np.array([], str), np.array([], str), np.zeros((0, 2)), 0.5)
    with pytest.raises(ValueError, match="nothing is measured"):
        of.block(observations=none)


def test_cameras() -> None:
    of, block = simulated(), simulated().block()
    with pytest.raises(ValueError, match="image i00 is of camera camera, which there is not; known are other"):
        replace(block, cameras={"other": of.sensor.camera})
    plain = FrameCamera.from_pixels(focal_px=4000.0, width=4000, height=3000)
    with pytest.raises(ValueError, match="same kind of lens; got BrownConrady, NoDistortion"):
        replace(block, cameras={"camera": of.sensor.camera, "other": plain})
    with pytest.raises(TypeError, match=r"camera camera must be a jaxgeo FrameCamera|cameras"):
        replace(block, cameras={"camera": 3})
    with pytest.raises((TypeError, ValueError), match="frame"):
        replace(block, frame="utm")


def test_blocks_that_are_not_alike_are_not_joined() -> None:
    of, block = simulated(), simulated().block()
    renamed = replace(
        block,
        images=Images(
            np.char.add("x", block.images.name),
            block.images.camera,
            block.images.centre,
            block.images.R_frame_from_camera,
        ),
        observations=ImagePoints(
            np.char.add("x", block.observations.image), block.observations.point, block.observations.uv, 0.5
        ),
    )
    whole = block.with_block(renamed)
    assert len(whole.images) == 30
    assert len(whole.control) == len(CONTROL)
    with pytest.raises(ValueError, match=r"image i00 is there 2 times|measured twice"):
        block.with_block(block)
    with pytest.raises(ValueError, match="camera camera is not the same in both blocks"):
        block.with_block(replace(renamed, cameras={"camera": camera(focal_px=3999.0)}))
    mount = eqx.tree_at(lambda m: m.lever_body, of.sensor.mount, np.zeros(3))
    nav = replace(renamed.navigation, mounts={"camera": (mount, False)})
    with pytest.raises(ValueError, match="mount camera is not the same in both blocks"):
        block.with_block(replace(renamed, navigation=nav))
    with pytest.raises(ValueError, match="one of the blocks has navigation and the other has none"):
        block.with_block(replace(renamed, navigation=None))
    with pytest.raises(ValueError, match=r"frame=block\.frame"):
        block.with_block(replace(renamed, frame=simulated("fixed", -0.001, -180.0).frame))
    moved = GroundPoints(block.control.name, block.control.place + 1.0, 0.02)
    with pytest.raises(ValueError, match="control: point p00 is at"):
        block.with_block(replace(renamed, control=moved))
    more = GroundPoints(["p07"], of.points.of(["p07"]).place, covariance=[1e-4 * np.eye(3) + 1e-5])
    both = block.with_block(replace(renamed, control=more)).control
    np.testing.assert_allclose(both.covariance[-1], more.covariance[0])
    np.testing.assert_allclose(both.covariance[0], np.eye(3) * 0.02**2)


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"sigma_position": 0.0}, "sigma_position of image 0 must be positive, in m"),
        ({"sigma_position": [0.1, np.nan, 0.1]}, "sigma_position of image 0 must be positive"),
        ({"sigma_attitude": -1.0}, "sigma_attitude of image 0 must be positive, in rad"),
        ({"sigma_attitude": np.ones(2)}, r"sigma_attitude must be a number, \(3,\), \(15, 3\) or covariances"),
        ({"sigma_position": np.tile(-np.eye(3), (15, 1, 1))}, "image 0 must be a symmetric, positive definite matrix"),
    ],
)
def test_weights_of_the_navigation(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        simulated().block(**changes)


@pytest.mark.parametrize(
    "unknowns, message",
    [
        (Unknowns(focal={"other": Free()}), r"Unknowns.focal: there is no 'other'; known are camera"),
        (Unknowns(images={"i99": Fixed()}), r"Unknowns.images: there is no 'i99'"),
        (Unknowns(distortion={"k9": Free()}), r"Unknowns.distortion: there is no 'k9'; known are k1"),
        (Unknowns(boresight={"m": Free()}), r"Unknowns.boresight: there is no 'm'; known are camera"),
        (Unknowns(shift={"west": Free()}), r"Unknowns.shift: there is no 'west'; known are north, south, across"),
        (Unknowns(principal=Prior([1.0, 2.0, 3.0])), r"Unknowns.principal: a prior takes 1 or 2 .* got shape \(3,\)"),
        (Unknowns(images=Prior(1.0)), r"a prior of an orientation is the block's navigation"),
    ],
)
def test_unknowns(unknowns: Unknowns, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        prepared(simulated().block(), unknowns)


@pytest.mark.parametrize("sigma", [0.0, -1.0, np.nan, np.inf, [1.0, 0.0]])
def test_priors(sigma: Any) -> None:
    with pytest.raises(ValueError, match=r"must be positive and finite; got .* Fixed\(\), .* Free\(\)"):
        Prior(sigma)


def test_no_choice() -> None:
    with pytest.raises(TypeError, match=r"Unknowns.focal must be Free\(\), Fixed\(\) or Prior\(sigma\)|focal"):
        prepared(simulated().block(), replace(Unknowns(), focal={"camera": True}))


def test_terrain() -> None:
    of, dem = simulated(), small_dem(flat())
    block = of.block()
    with pytest.raises(ValueError, match="in a Cartesian frame a DEM lies nowhere"):
        prepared(replace(block, frame=Cartesian(), navigation=None), Unknowns(), HeightObservations(dem, 1.0))
    with pytest.raises(ValueError, match="sigma of the terrain's height must be positive, in m"):
        prepared(block, Unknowns(), HeightObservations(dem, 0.0))
    with pytest.raises(ValueError, match="terrain: there is no point 'x1' among those measured"):
        prepared(block, Unknowns(), HeightObservations(dem, 1.0, ("x1",)))
    with pytest.raises(ValueError, match=r"point p\d\d lies over no known ground of the terrain \(\d+ such points\)"):
        prepared(block, Unknowns(), HeightObservations(dem, 1.0))  # it is 480 m wide, the block 900


@pytest.fixture(scope="module")
def words() -> Any:
    """What is said of a block that does not hold its unknowns."""

    def said(block: Block, unknowns: Unknowns | None = None) -> str:
        with pytest.raises(DeficientBlock) as caught:
            adjust(block, unknowns)
        assert caught.value.directions
        return str(caught.value)

    return said


@pytest.mark.costly
def test_no_control_and_no_navigation(words: Any) -> None:
    said = words(replace(simulated().block(), navigation=None, control=None))
    assert "position, orientation and scale of the whole block" in said
    assert "InnerConstraints()" in said


def in_two_parts() -> Block:
    """A block whose last strip has points of its own."""
    block = replace(simulated().block(), navigation=None, control=None)
    seen = block.observations
    own = np.isin(seen.image, block.images.name[10:])
    seen = ImagePoints(seen.image, np.where(own, np.char.add("x", seen.point), seen.point), seen.uv, seen.sigma)
    often = np.unique(seen.point, return_counts=True)
    return replace(block, observations=seen.of(np.isin(seen.point, often[0][often[1] > 1])), points=None)


def test_a_block_tells_its_parts() -> None:
    block = in_two_parts()
    first, last = block.parts()
    assert (first.tolist(), last.tolist()) == (block.images.name[:10].tolist(), block.images.name[10:].tolist())
    assert len(simulated().block().parts()) == 1


@pytest.mark.slow
def test_what_is_not_held_because_no_point_joins_it(words: Any) -> None:
    said = words(in_two_parts())
    assert "No point joins the 2 parts of the block (10 images, image i00 among them; 5 images, image i10" in said


@pytest.mark.slow
def test_control_of_two_points_leaves_a_turn(words: Any) -> None:
    of = simulated()
    block = of.block(control=of.control(names=CONTROL[:2]), sigma_position=np.inf, sigma_attitude=np.inf)
    said = words(block, tight())
    assert said.count("of the whole block") == 1
    assert "turn about" in said


@pytest.mark.slow
def test_positions_without_heights_and_a_free_focal_length(words: Any) -> None:
    of = simulated()
    said = words(of.block(control=None, sigma_position=[0.05, 0.05, np.inf]), tight(focal=Free()))
    assert "shift up" in said


@pytest.mark.costly
def test_shifts_of_all_strips_without_control(words: Any) -> None:
    said = words(simulated().block(control=None), tight(shift=Free()))
    assert "shift" in said
    assert "Fix some of it, or give priors" in said


@pytest.mark.slow
def test_reliability_levels(words: Any) -> None:
    found = adjust(simulated().block())
    for alpha in (0.0, 1.0, -0.1, np.nan):
        with pytest.raises(ValueError, match="alpha must lie between 0 and 1; got"):
            reliability(found, alpha)
    with pytest.raises(ValueError, match="point p99 was measured in no image"):
        found.differences(GroundPoints(["p99"], np.zeros((1, 3))))


def test_resections() -> None:
    of = simulated()
    own = {"i07": "c"}
    seen = of.observations.of(of.observations.image == "i07")
    names = seen.point.tolist()
    with pytest.raises(ValueError, match=r"image i07 sees 3 control points; a resection takes at least 4"):
        resect_block({"c": camera()}, own, seen, of.points.of(names[:3]))
    heights = GroundPoints(names[:5], of.points.of(names[:5]).place, [np.inf, np.inf, 0.1])
    with pytest.raises(ValueError, match=r"image i07 sees 0 control points"):
        resect_block({"c": camera()}, own, seen, heights)
    with pytest.raises(ValueError, match="there is no camera 'c'; known are d"):
        resect_block({"d": camera()}, own, seen, of.points)
    line = np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0], [2.0, 4.0, 6.0], [3.0, 6.0, 9.0]])
    with pytest.raises(ValueError, match="lie in one line"):
        resect_image(camera(), seen.uv[:4], line)


def test_resections_find_any_camera() -> None:
    of, rng = simulated(), np.random.default_rng(2)
    for count in (6, 8, 20):
        for _ in range(5):
            R = np.linalg.qr(rng.normal(size=(3, 3)))[0]
            R = R * np.sign(np.linalg.det(R))
            p_camera = np.stack([*rng.uniform(-0.3, 0.3, (2, count)), np.ones(count)], 1)
            p_camera *= rng.uniform(500.0, 800.0, (count, 1))
            centre = rng.normal(0.0, 1e6, 3)
            places = centre + p_camera @ R.T
            uv = pixels(of.sensor.camera, np.repeat(centre[None], count, 0), np.repeat(R[None], count, 0), places)
            found = resect_image(of.sensor.camera, uv, places)
            np.testing.assert_allclose(found[0], centre, rtol=0.0, atol=1e-3)  # m
            np.testing.assert_allclose(found[1], R, rtol=0.0, atol=1e-6)


@pytest.mark.costly
def test_points_that_come_to_lie_behind_their_cameras() -> None:
    truth = simulated()
    seen = truth.observations
    names, counts = np.unique(seen.point, return_counts=True)
    point = next(name for name in names[counts == 2] if name not in CONTROL)
    rows = np.flatnonzero(seen.point == point)
    images = [list(truth.names).index(name) for name in seen.image[rows]]
    place = truth.points.place[list(truth.points.name).index(point)]
    mirrored = truth.centre[images].sum(axis=0) - place  # its pixels, by the formula, are those of a point up there
    uv = seen.uv.copy()
    uv[rows] = pixels(
        truth.sensor.camera, truth.centre[images], truth.R_frame_from_camera[images], np.stack([mirrored, mirrored])
    )
    with pytest.raises(BehindCamera, match=f"point {point} has come to lie behind image") as caught:
        adjust(replace(truth.block(), observations=replace(seen, uv=uv)), screen=None)
    assert set(caught.value.rows) == set(rows)


@pytest.mark.costly
def test_a_point_whose_rays_are_parallel() -> None:
    of = simulated()
    block = of.block()
    seen, images = block.observations, block.images
    row = int(np.flatnonzero((seen.image == "i00") & ~np.isin(seen.point, block.control.name))[0])
    again = np.append(np.arange(len(images)), 0)  # a second exposure at the first one's place
    twins = Images(
        np.append(images.name, "twin"),
        images.camera[again],
        images.centre[again],
        images.R_frame_from_camera[again],
    )
    keep = (seen.point != seen.point[row]) | (np.arange(len(seen)) == row)
    own = np.flatnonzero(keep)
    more = np.concatenate([own, [row], np.flatnonzero((seen.image == "i00") & keep)[1:6]])
    names = np.concatenate([seen.image[own], np.full(len(more) - len(own), "twin")])
    pairs = np.array([f"{a} {b}" for a, b in zip(names, seen.point[more], strict=True)])
    _, first = np.unique(pairs, return_index=True)
    more, names = more[np.sort(first)], names[np.sort(first)]
    observations = ImagePoints(names, seen.point[more], seen.uv[more], 0.5)
    point = str(seen.point[row])
    block = replace(block, images=twins, observations=observations, navigation=None)
    with pytest.raises(ValueError, match=f"the rays of point {point} are parallel, so that it has no place to start"):
        adjust(block)
    block = replace(block, points=of.points.of(np.setdiff1d(observations.point, block.control.name)))
    with pytest.raises(DeficientBlock, match=f"nothing holds the distance of point {point}: its rays, of images i00, "):
        adjust(block)
