"""Additional parameters of self-calibration: their formulas in mm, what they are orthogonal to, and their folds."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.lenses import correct, distort, in_field, pixels, rays, undistort

from jaxgeo.sensor import Bauer, BrownConrady, BrownPhysical, Ebner, FrameCamera, NoDistortion
from jaxgeo.status import Status

C, B, R0 = 55.5019, 26.85, 21.7  # mm: focal length, half of the longer side, radius at which Bauer's term vanishes
IMAGE = {"focal_px": C / 5.2e-3, "width": 10328, "height": 7760}
CLASSICAL = [Bauer, Ebner, BrownPhysical]
LENSES = pytest.mark.parametrize("kind", CLASSICAL)


def bauer_mm(a, x, y):
    a1, a2, a3 = a
    r2 = x**2 + y**2
    return a1 * x * (r2 - R0**2) - a3 * x, a1 * y * (r2 - R0**2) + a2 * x + a3 * y


def ebner_mm(b, x, y, base=B):
    b = [None, *b]
    k = 2.0 * base**2 / 3.0
    both = (x**2 - k) * (y**2 - k)
    dx = b[1] * x + b[2] * y - 2 * b[3] * (x**2 - k) + b[4] * x * y + b[5] * (y**2 - k)
    dx = dx + b[7] * x * (y**2 - k) + b[9] * y * (x**2 - k) + b[11] * both
    dy = -b[1] * y + b[2] * x + b[3] * x * y - 2 * b[4] * (y**2 - k) + b[6] * (x**2 - k)
    dy = dy + b[8] * y * (x**2 - k) + b[10] * x * (y**2 - k) + b[12] * both
    return dx, dy


def brown_mm(a, x, y):
    a = [None, *a]
    r2 = x**2 + y**2
    P = a[13] * (x**2 - y**2) + a[14] * x**2 * y**2 + a[15] * (x**4 - y**4)
    Q = a[16] * r2 + a[17] * r2**2 + a[18] * r2**3
    dx = a[1] * x + a[2] * y + a[3] * x * y + a[4] * y**2 + a[5] * x**2 * y + a[6] * x * y**2 + a[7] * x**2 * y**2
    dx = dx + x / C * P + x * Q + a[19] + a[21] * x / C
    dy = a[8] * x * y + a[9] * x**2 + a[10] * x**2 * y + a[11] * x * y**2 + a[12] * x**2 * y**2
    dy = dy + y / C * P + y * Q + a[20] + a[21] * y / C
    return dx, dy


FORMULAS = {Bauer: bauer_mm, Ebner: ebner_mm, BrownPhysical: brown_mm}


def coefficients_mm(kind) -> np.ndarray:
    """Coefficients in mm, each of which moves the edge of the image by up to some 0.2 mm."""
    units = np.array([correction_mm(kind, np.eye(len(kind.names))[k]) for k in range(len(kind.names))])
    return np.random.default_rng(4).uniform(-0.2, 0.2, len(units)) / units


def correction_mm(kind, coefficients) -> float:
    x, y = places_mm().T
    return float(np.max(np.abs(FORMULAS[kind](coefficients, x, y))))


def places_mm() -> np.ndarray:
    return np.random.default_rng(2).uniform([-B, -20.2], [B, 20.2], (200, 2))


def lens_of(kind, coefficients, unit: float = 1.0, half_side: float = B, y_up: bool = False):
    """Lens of coefficients in some unit of length, of which `unit` are a mm."""
    r0 = {"r0": R0 * unit} if kind is Bauer else {}
    return kind.from_image_plane(coefficients, focal_length=C * unit, half_side=half_side * unit, y_up=y_up, **r0)


def random_lens(kind, size: float = 0.02):
    values = np.random.default_rng(8).normal(size=len(kind.names))
    return kind.for_image(**IMAGE).with_coefficients(size / np.abs(values).sum() * values)


@LENSES
def test_it_is_the_formula_in_millimetres(kind):
    coefficients, places = coefficients_mm(kind), places_mm()
    ideal = C * np.asarray(correct(lens_of(kind, coefficients), places / C))
    expected = places + np.stack(FORMULAS[kind](coefficients, *places.T), axis=1)
    assert np.abs(expected - places).max() > 0.05  # mm
    np.testing.assert_allclose(ideal, expected, rtol=0, atol=1e-13)  # mm


@LENSES
def test_the_unit_of_length_and_the_scale_do_not_matter(kind):
    coefficients, places = coefficients_mm(kind), places_mm() / C
    in_mm = lens_of(kind, coefficients)
    np.testing.assert_allclose(in_mm.in_image_plane(focal_length=C), coefficients, rtol=1e-13)
    in_m = lens_of(kind, in_mm.in_image_plane(focal_length=1e-3 * C), unit=1e-3)
    np.testing.assert_allclose(correct(in_m, places), correct(in_mm, places), rtol=0, atol=1e-15)
    if kind is not Ebner:  # whose base is a part of the formula
        other = lens_of(kind, coefficients, half_side=10.0)
        np.testing.assert_allclose(correct(other, places), correct(in_mm, places), rtol=0, atol=1e-15)


@LENSES
def test_an_upward_y_axis_is_the_mirror_image(kind):
    coefficients, places = coefficients_mm(kind), places_mm()
    down, up = lens_of(kind, coefficients), lens_of(kind, coefficients, y_up=True)
    mirror = np.array([1.0, -1.0])
    seen_in_the_mirror = mirror * np.asarray(correct(down, mirror * places / C))
    np.testing.assert_allclose(correct(up, places / C), seen_in_the_mirror, rtol=0, atol=1e-15)
    np.testing.assert_allclose(up.in_image_plane(focal_length=C, y_up=True), coefficients, rtol=1e-13)


def columns(terms) -> np.ndarray:
    """One column a term: its (dx, dy) on the 3 x 3 grid with distances 1, one after the other."""
    x, y = (jnp.asarray(part.ravel()) for part in np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]))
    return np.stack([np.concatenate(np.broadcast_arrays(*term(x, y), x)[:2]) for term in terms], axis=1)


def ebner_columns() -> np.ndarray:
    lens = Ebner.zero(scale=1.0)
    return columns([lens.with_coefficients(row).polynomial for row in np.eye(12)])


def test_ebners_parameters_are_orthogonal_on_the_grid():
    gram = ebner_columns().T @ ebner_columns()
    np.testing.assert_allclose(gram, np.diag(np.diag(gram)), rtol=0, atol=1e-14)
    assert np.all(np.diag(gram) > 0.4)


def test_ebners_parameters_are_orthogonal_to_the_exterior_orientation():
    """And with it they are all that nine points can tell: 18 coordinates."""
    orientation = columns(
        [
            lambda x, y: (1.0, 0.0),
            lambda x, y: (0.0, 1.0),
            lambda x, y: (-y, x),
            lambda x, y: (x, y),
            lambda x, y: (x * x, x * y),
            lambda x, y: (x * y, y * y),
        ]
    )
    np.testing.assert_allclose(ebner_columns().T @ orientation, 0.0, rtol=0, atol=1e-14)
    assert np.linalg.matrix_rank(np.hstack([ebner_columns(), orientation])) == 18


def test_another_base_spans_the_same_corrections_apart_from_the_exterior_orientation():
    x, y = places_mm().T / B
    zero = 0.0 * x
    orientation = [(1 + zero, zero), (zero, 1 + zero), (-y, x), (x, y), (x * x, x * y), (x * y, y * y)]
    spans = [
        np.array([np.concatenate(d) for d in [*(ebner_mm(row, x, y, base) for row in np.eye(12)), *orientation]])
        for base in (1.0, 0.75)
    ]
    assert np.linalg.matrix_rank(spans[0]) == np.linalg.matrix_rank(np.vstack(spans)) == 18


@pytest.mark.parametrize("width, height", [(1000, 1000), (10328, 7760), (600, 2400)])
def test_bauers_radial_term_is_balanced_over_the_image(width, height):
    """Orthogonal to a change of the focal length, on the middle points of 400 x 400 fields of the image."""
    lens = Bauer.for_image(focal_px=(900.0, 900.0), width=width, height=height)
    places = (np.arange(400) + 0.5) / 200.0 - 1.0
    x, y = jnp.meshgrid(places * width / max(width, height), places * height / max(width, height))
    dx, dy = lens.with_coefficients([1.0, 0.0, 0.0]).polynomial(x, y)
    assert abs(jnp.mean(dx * x + dy * y)) < 1e-5
    assert jnp.mean(dx**2 + dy**2) > 1e-3
    if width == height:
        np.testing.assert_allclose(lens.r0, Bauer.zero(scale=1.0).r0, rtol=1e-15)
    on_the_circle = np.asarray(lens.r0 * lens.scale) * np.array([[0.6, -0.8]])
    bent = correct(lens.with_coefficients([0.01, 0.0, 0.0]), on_the_circle)
    np.testing.assert_allclose(bent, on_the_circle, rtol=0, atol=1e-16)


def test_the_interior_orientation_in_browns_parameters():
    assert BrownPhysical.interior == ("a19", "a20", "a21")
    assert Ebner.interior == Bauer.interior == BrownConrady.interior == ()
    coefficients = np.zeros(21)
    coefficients[18:] = [0.03, -0.02, 0.11]  # mm
    places = places_mm()
    ideal = correct(lens_of(BrownPhysical, coefficients), places / C)
    np.testing.assert_allclose(C * ideal, places * (1.0 + 0.11 / C) + [0.03, -0.02], rtol=0, atol=1e-14)


ALL = {
    "none": NoDistortion(),
    "Brown-Conrady": BrownConrady(-0.1, 0.02, 1e-3, -2e-3, 0.01, 1e-3, 2e-3, 3e-3),
    **{kind.__name__: random_lens(kind) for kind in CLASSICAL},
}


@jax.jit
def slopes_by_coefficients(lens, vector, places):
    return jax.vmap(jax.jacrev(lambda vector, place: lens.with_coefficients(vector).distort(place)), (None, 0))(
        vector, places
    )


@pytest.mark.costly
@pytest.mark.parametrize("name", ALL)
def test_coefficients_come_and_go_as_a_vector(name):
    lens = ALL[name]
    vector = lens.coefficients()
    assert vector.shape == (len(lens.names),)
    other = lens.with_coefficients(2.0 * vector)
    assert type(other) is type(lens)
    np.testing.assert_array_equal(other.coefficients(), 2.0 * vector)

    slopes = slopes_by_coefficients(lens, vector, places_mm()[:3] / C)
    assert slopes.shape == (3, 2, len(lens.names))
    assert np.all(np.any(np.asarray(slopes) != 0.0, axis=(0, 1)))
    if not lens.names:
        return
    batch = jax.vmap(lens.with_coefficients)(jnp.stack([vector, 3.0 * vector]))
    np.testing.assert_array_equal(jax.vmap(lambda lens: lens.coefficients())(batch)[1], 3.0 * vector)


def test_names_are_in_the_literatures_order():
    assert Bauer.names == ("a1", "a2", "a3")
    assert (Ebner.names[0], Ebner.names[11], len(Ebner.names)) == ("b1", "b12", 12)
    assert (BrownPhysical.names[0], BrownPhysical.names[20], len(BrownPhysical.names)) == ("a1", "a21", 21)
    lens = ALL["Brown-Conrady"]
    assert all(getattr(lens, name) == value for name, value in zip(lens.names, lens.coefficients(), strict=True))


@pytest.mark.costly
@LENSES
def test_a_frame_camera_with_it_undoes_itself(kind):
    camera = FrameCamera.from_pixels(**IMAGE, distortion=random_lens(kind))
    uv = np.random.default_rng(3).uniform([-0.5, -0.5], [10327.5, 7759.5], (300, 2))
    directions, status = rays(camera, uv)
    assert np.all(status == Status.hit)
    plain, _ = rays(FrameCamera.from_pixels(**IMAGE), uv)
    assert np.abs(plain - directions).max() > 1e-3
    back, status = pixels(camera, 500.0 * directions)
    assert np.all(status == Status.hit)
    np.testing.assert_allclose(back, uv, rtol=0, atol=1e-9)


@LENSES
def test_a_lens_for_an_image_starts_without_correction(kind):
    lens = kind.for_image(focal_px=(1000.0, 500.0), width=800, height=600)
    np.testing.assert_allclose(lens.scale, 0.6, rtol=1e-15)  # half of 600 rows over 500
    places = places_mm() / C
    np.testing.assert_allclose(distort(lens, places), places, rtol=0, atol=1e-15)


# u - u^3 / 3, with u in units of half the side, turns at u = 1, where it is 2 / 3.
FOLDING = BrownPhysical.zero(scale=0.5).with_coefficients([0.0] * 15 + [-1.0 / 3.0] + [0.0] * 5)


def test_beyond_the_fold_is_outside_the_field():
    direction = 0.5 * np.array([0.6, -0.8])
    measured = np.array([0.1, 0.5, 0.9, 1.01, 1.5, 1.8, 3.0, 1e3, 1e9, 1e200])
    ideal, status = undistort(FOLDING, measured[:, None] * direction)
    assert np.array_equal(status == Status.hit, measured < 1.0)
    assert np.all(np.asarray(status)[measured > 1.0] == Status.outside_distortion_field)
    assert np.all(np.asarray(ideal)[measured > 1.0] == 0.0)
    reached = np.array([0.2, 0.6, 0.66, 0.667, 0.9, 5.0, 1e3, 1e9, 1e200])
    assert np.array_equal(in_field(FOLDING, reached[:, None] * direction), reached < 2.0 / 3.0)


@pytest.mark.slow
def test_a_camera_says_so_and_its_gradients_stay_finite():
    camera = FrameCamera.from_pixels(focal_px=1000.0, width=2001, height=2001, distortion=FOLDING)
    uv = np.array([[1000.0, 1200.0], [1000.0, 1900.0], [1e9, 0.0], [np.nan, 0.0]])
    points = np.array([[0.1, 0.1, 1.0], [0.5, 0.0, 1.0], [1e9, 0.0, 1.0], [np.nan, 0.0, 1.0]])
    expected = [Status.hit, Status.outside_distortion_field, Status.outside_image, Status.invalid_input]
    assert list(np.asarray(rays(camera, uv)[1])) == expected
    assert list(np.asarray(pixels(camera, points)[1])) == expected

    def masked_mean(camera, vectors, outward):
        values, status = jax.vmap(camera.project if outward else camera.ray)(vectors)
        return jnp.mean(jnp.where((status == Status.hit)[:, None], values, 0.0) ** 2)

    for vectors, outward in ((points, True), (uv, False)):
        gradients = jax.jit(jax.grad(masked_mean, argnums=(0, 1)), static_argnums=2)(camera, vectors, outward)
        assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(gradients))


def test_a_lens_turned_inside_out_has_no_field():
    lens = Ebner.zero(scale=0.5).with_coefficients([-2.0] + [0.0] * 11)  # (x, y) -> (-x, 3 y)
    points = np.array([[0.0, 0.0], [0.1, 0.2]])
    assert not np.any(in_field(lens, points))
    assert np.all(undistort(lens, points)[1] == Status.outside_distortion_field)


@pytest.mark.costly
def test_distorting_is_exact_for_corrections_of_a_tenth_of_the_image():
    """Points where the formula folds, or shrinks areas to less than a fifth, are left out."""
    rng = np.random.default_rng(6)
    places = jnp.asarray(rng.uniform([-1.0, -0.75], [1.0, 0.75], (200, 2)))

    @jax.jit
    @jax.vmap
    def there_and_back(values):
        unit = BrownPhysical(values, 1.0)
        largest = jnp.max(jnp.abs(jax.vmap(unit.correct)(places) - places))
        lens = BrownPhysical(0.1 * values / largest, 1.0)
        determinant = jnp.linalg.det(jax.vmap(lens.jacobian)(places))
        ideal = jax.vmap(lens.correct)(places)
        return determinant > 0.2, jax.vmap(lens.distort)(ideal), jax.vmap(lens.undistort)(places)[1]

    sound, back, status = map(np.asarray, there_and_back(rng.normal(size=(50, 21))))
    assert sound.mean() > 0.98
    assert np.all(status[sound] == Status.hit)
    np.testing.assert_allclose(back[sound], np.broadcast_to(places, back.shape)[sound], rtol=0, atol=1e-14)


MISTAKES = {
    "too few": (lambda: Bauer.from_coefficients([1.0, 2.0], scale=0.5), r"Bauer has 3 coefficients, a1 a2 a3; got an"),
    "one number": (lambda: Ebner.from_coefficients(1.0, scale=0.5), r"Ebner has 12 coefficients.*shape \(\)"),
    "not finite": (lambda: Bauer.from_coefficients([0.0, np.nan, 0.0], scale=0.5), r"coefficients must be finite"),
    "no scale": (lambda: Ebner.zero(scale=0.0), r"scale must be positive and finite; got 0\.0: it is the tangent"),
    "infinite scale": (lambda: Ebner.zero(scale=np.inf), r"scale must be positive and finite; got inf"),
    "focal length": (
        lambda: Ebner.for_image(focal_px=-1.0, width=3, height=4),
        r"focal_px must be positive.*got -1\.0",
    ),
    "width": (
        lambda: Bauer.for_image(focal_px=9.0, width=0, height=4),
        r"width must be positive and finite; got 0: it",
    ),
    "half side": (lambda: Bauer.from_image_plane(np.zeros(3), focal_length=50.0, half_side=-3.0), r"half_side must be"),
    "r0": (
        lambda: Bauer.from_image_plane(np.zeros(3), focal_length=50.0, half_side=3.0, r0=0.0),
        r"r0 must be positive",
    ),
    "too many": (
        lambda: BrownConrady().with_coefficients(np.zeros(9)),
        r"BrownConrady has 8 coefficients, k1 k2 p1 p2",
    ),
    "for none": (lambda: NoDistortion().with_coefficients([1.0]), r"NoDistortion has 0 coefficients, none at all; got"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_named(name):
    make, message = MISTAKES[name]
    with pytest.raises(ValueError, match=message):
        make()


def test_single_precision_is_refused():
    with pytest.raises(TypeError, match="float32"):
        Bauer.from_coefficients(np.zeros(3, np.float32), scale=0.5)
