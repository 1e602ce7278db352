"""The simulated shells: their physics, their look in numbers, their label, their bad input."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from raden_torch.errors import InputError
from raden_torch.measurement import native_csv
from raden_torch.optics import SPECIMENS, simulate_specimen
from raden_torch.optics.lacquered import slope_density
from raden_torch.optics.nacre import mean_reflectance
from raden_torch.optics.shell import BANDS_NM, brdf_per_sr, film_reflectance
from raden_torch.optics.specimens import directions

NAMES = tuple(SPECIMENS)
FEW = {name: replace(shell, stacks=60) for name, shell in SPECIMENS.items()}
"""The shells of fewer random stacks: as good for a law, in a fifth of the time."""


@pytest.fixture(scope="module")
def yakogai():
    return simulate_specimen("yakogai")


@pytest.fixture
def few_stacks(monkeypatch):
    for name, shell in FEW.items():
        monkeypatch.setitem(SPECIMENS, name, shell)


def values(name, *geometries_deg):
    return simulate_specimen(name, geometries_deg=geometries_deg).values


def on_the_hemisphere(theta_deg, phi_deg):
    theta, phi = np.radians(theta_deg), np.radians(phi_deg)
    x, y = np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi)
    return np.stack(np.broadcast_arrays(x, y, np.cos(theta)), axis=-1)


# -- physics -----------------------------------------------------------------------------------


@settings(max_examples=100, deadline=None)
@given(
    name=st.sampled_from(NAMES),
    thetas=st.tuples(st.floats(0, 90), st.floats(0, 90)),
    phis=st.tuples(st.floats(0, 360), st.floats(0, 360)),
)
def test_reciprocal_and_not_negative(name, thetas, phis):
    light, view = (on_the_hemisphere(t, p)[None] for t, p in zip(thetas, phis, strict=True))
    there = brdf_per_sr(FEW[name], light, view)
    back = brdf_per_sr(FEW[name], view, light)
    assert np.isfinite(there).all()
    assert (there >= 0).all()
    np.testing.assert_allclose(there, back, rtol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_reflects_no_more_than_arrives(name):
    """Directional-hemispherical reflectance by the midpoint rule, in every band."""
    theta, phi = np.meshgrid(np.arange(0.75, 90, 1.5), np.arange(1.5, 360, 3.0), indexing="ij")
    view = on_the_hemisphere(theta.ravel(), phi.ravel())
    solid_angle = np.sin(np.radians(theta.ravel())) * np.radians(1.5) * np.radians(3.0)
    for incidence in (0, 30, 60, 80, 89):
        for azimuth in (0, 90):
            light = np.broadcast_to(on_the_hemisphere(incidence, azimuth), view.shape)
            brdf = brdf_per_sr(FEW[name], light, view)
            reflected = (solid_angle * view[:, 2]) @ brdf
            assert reflected.max() < 0.7  # the coat's own mirror image is left out
            assert reflected.min() > 0


@pytest.mark.parametrize("name", NAMES)
def test_populations_cover_the_surface_once(name):
    facets = SPECIMENS[name].facets
    slope = np.linspace(-3, 3, 601)
    density = slope_density(facets, slope[:, None], slope[None, :])
    shares = sum(population.share for population in facets)
    assert density.sum() * 0.01**2 == pytest.approx(shares, abs=1e-6)
    assert shares <= 1 + 1e-12


@settings(max_examples=40, deadline=None)
@given(a=st.floats(0, 90), r=st.floats(-90, 90), t=st.floats(-90, 90))
def test_equivalent_geometries_are_equal(a, r, t):
    once, turned = values("yakogai", (0, r, t), (0, -r, -t))
    np.testing.assert_allclose(once, turned, rtol=1e-10, atol=1e-10)
    swapped = (r, a, -t) if r >= 0 else (-r, -a, t)
    there, back = values("yakogai", (a, r, t), swapped)
    np.testing.assert_allclose(there, back, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("tablet_nm", [450.0, 490.0])
def test_films_scale(tablet_nm):
    """The table of one thickness serves for another, as a stack of that thickness confirms."""
    shell = SPECIMENS["yakogai"]
    scale = tablet_nm / shell.stack.tablet_nm
    stack = replace(shell.stack, tablet_nm=tablet_nm, organic_nm=25 * scale)
    q_squared = np.array([0.0, 0.33, 0.77])
    direct = mean_reflectance(stack, BANDS_NM, q_squared, ambient_n=shell.coat_n, stacks=300)
    scaled = film_reflectance(shell, q_squared, np.full(3, tablet_nm))
    assert abs(scaled - direct).max() < 0.08  # the bands of 300 random stacks still have noise
    assert np.sqrt(np.mean((scaled - direct) ** 2)) < 0.012


# -- what it looks like ------------------------------------------------------------------------


def test_grid_is_the_instrument_s(yakogai):
    grid = yakogai.grid()
    assert grid.values.shape == (15, 29, 29, 3)
    assert [(axis[0], axis[-1]) for axis in grid.axes_deg] == [(0, 70), (-70, 70), (-70, 70)]
    assert grid.measured.all()
    assert (yakogai.values > 0).all()


def test_two_peaks_along_the_tilt(yakogai):
    grid = yakogai.grid()
    ridge = grid.values[4, 18, :, 1]  # incidence 20, receiving 20
    inner = np.arange(1, len(ridge) - 1)
    peaks = inner[(ridge[inner] > ridge[inner - 1]) & (ridge[inner] > ridge[inner + 1])]
    bright = grid.tilt_deg[peaks[ridge[peaks] > ridge.max() / 2]]
    assert len(bright) == 2
    assert bright[0] == -bright[1]
    assert 10 <= bright[1] <= 15
    assert ridge[14] < 0.6 * ridge.max()  # the valley at tilt 0
    body = np.median(grid.values[4, :, :, 1])
    assert 10 < body < 40
    assert ridge.max() > 4 * body


def test_mirror_ridge_follows_the_incidence(yakogai):
    grid = yakogai.grid()
    along = grid.values[:, :, 16, 1]  # tilt 10
    found = grid.receiving_deg[along[:11].argmax(axis=1)]
    np.testing.assert_allclose(found, grid.incidence_deg[:11], atol=5)


def test_grid_samples_the_lobes():
    """Between the nodes of 5 degrees the peak is not much higher than on them."""
    fine = simulate_specimen(step_deg=2.5).grid().values[..., 1]
    assert fine.max() < 1.15 * fine[::2, ::2, ::2].max()


@pytest.mark.parametrize(
    ("name", "tilt"),
    [("yakogai", 10), ("abalone", 15), ("akoya", 0), ("awabi", 10), ("mexican", 10)],
)
@pytest.mark.usefixtures("few_stacks")
def test_colour_travels_along_the_mirror(name, tilt):
    angles = np.arange(0, 71, 5)
    xyz = values(name, *((a, a, tilt) for a in angles))
    chromaticity = xyz[:, :2] / xyz.sum(axis=1, keepdims=True)
    path = np.linalg.norm(np.diff(chromaticity, axis=0), axis=1).sum()
    assert path > 0.12
    assert np.linalg.norm(np.diff(chromaticity, axis=0), axis=1).max() < 0.1  # no sudden jump


def test_yakogai_goes_from_pink_to_green():
    measured = simulate_specimen("yakogai", geometries_deg=[(0, 0, 10), (50, 50, 15)])
    pink, green = measured.as_rgb().values
    assert pink[0] > 1.2 * pink[1]
    assert pink[2] > 1.1 * pink[1]
    assert green[1] > 1.5 * green[0]


HUES_DEG = {"yellow": (40, 105), "green": (105, 190), "blue": (190, 300), "pink": (300, 345)}


@pytest.mark.parametrize(
    ("name", "scale", "seen", "unseen"),
    [
        # the descriptions are quoted in docs/shells.md
        ("yakogai", 1.0, {"green": 0.3, "pink": 0.1}, {"yellow": 0.05, "blue": 0.1}),
        ("awabi", 1.0, {"green": 0.15, "blue": 0.2, "pink": 0.2}, {"yellow": 0.05}),
        ("mexican", 1.0, {"green": 0.4, "blue": 0.25}, {"yellow": 0.05}),
        ("mexican", 1.2, {"green": 0.25, "pink": 0.1}, {"blue": 0.05}),
    ],
)
def test_hues_are_those_of_descriptions(name, scale, seen, unseen):
    """Shares of the mirror geometries to 60°, tilted to 25°, that have a hue of CIELAB.

    A hue counts where the chroma is above 20; the brightest geometry is the white.
    """
    angles = [(a, a, t) for a in range(0, 61, 5) for t in range(0, 26, 5)]
    xyz = simulate_specimen(name, geometries_deg=angles, tablet_scale=scale).values
    x, y, z = np.cbrt(xyz / np.array([0.95047, 1.0, 1.08883]) / xyz[:, 1].max()).T
    a, b = 500 * (x - y), 200 * (y - z)
    hue, coloured = np.degrees(np.arctan2(b, a)) % 360, np.hypot(a, b) > 20

    def share(which):
        low, high = HUES_DEG[which]
        return np.mean(coloured & (hue >= low) & (hue < high))

    for which, least in seen.items():
        assert share(which) > least, which
    for which, most in unseen.items():
        assert share(which) < most, which


@pytest.mark.usefixtures("few_stacks")
def test_abalones_are_more_vivid_than_pearl_oyster():
    """Mean chroma |u'v' − white| over the mirror geometries."""

    def chroma(name):
        angles = [(a, a, t) for a in range(0, 61, 10) for t in range(0, 26, 5)]
        xyz = values(name, *angles)
        bottom = xyz @ [1, 15, 3]
        u, v = 4 * xyz[:, 0] / bottom, 9 * xyz[:, 1] / bottom
        return np.hypot(u - 0.1978, v - 0.4683).mean()

    dull = max(chroma("akoya"), chroma("yakogai"))
    for name in ("abalone", "awabi", "mexican"):
        assert chroma(name) > 1.2 * dull, name


@pytest.mark.usefixtures("few_stacks")
def test_thicker_tablets_shift_the_peaks_in_proportion():
    """Tablets and sheets of optical thickness n d: the order's wavelength follows their sum."""
    geometry = [(8.0, 8.0, 10.0)]

    def peak(scale):
        spectrum = simulate_specimen(
            "mexican", geometries_deg=geometry, spectral=True, tablet_scale=scale
        ).values[0]
        return BANDS_NM[spectrum.argmax()]

    # n of aragonite near 1.69 and of the sheets 1.50; the planes' slope leaves 280 nm of tablet
    low, high = 1.69 * 280 + 1.50 * 25, 1.69 * 280 * 1.12 + 1.50 * 25
    assert peak(1.12) / peak(1.0) == pytest.approx(high / low, abs=0.02)
    measured = simulate_specimen("mexican", geometries_deg=geometry, tablet_scale=1.12)
    assert ("tablets", "1.12 times as thick") in measured.metadata.other


# -- how it is asked for -----------------------------------------------------------------------


def test_directions_are_the_inverse_of_the_geometry():
    torch = pytest.importorskip("torch")
    from raden_torch.geometry import raden_angles

    rng = np.random.default_rng(3)
    angles = rng.uniform((0.05, -1.4, -1.4), (1.4, 1.4, 1.4), (200, 3))
    light, view = (torch.tensor(d.T[:, None, :].copy()) for d in directions(angles))
    normal = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).reshape(3, 1, 1)
    found = torch.cat(raden_angles(normal, light, view), dim=-3)[:, 0].T.numpy()
    apart = abs(angles[:, 0] + angles[:, 1]) > 0.02
    np.testing.assert_allclose(found[apart], angles[apart], atol=1e-9)


def test_scattered_readings_are_the_grid_s(yakogai):
    rows = [0, 777, 5000, 12614]
    angles = np.stack([yakogai.incidence_deg, yakogai.receiving_deg, yakogai.tilt_deg], axis=1)
    scattered = simulate_specimen("yakogai", geometries_deg=angles[rows])
    np.testing.assert_allclose(scattered.values, yakogai.values[rows], rtol=1e-12)


def test_spectral_bands_make_the_same_colour(yakogai):
    spectral = simulate_specimen("yakogai", step_deg=35, spectral=True)
    assert spectral.channels[0] == "380nm"
    assert spectral.channels[-1] == "780nm"
    angles = np.stack([spectral.incidence_deg, spectral.receiving_deg, spectral.tilt_deg], axis=1)
    xyz = simulate_specimen("yakogai", geometries_deg=angles).values
    np.testing.assert_allclose(spectral.as_xyz().values, xyz, rtol=1e-10)


def test_same_seed_same_readings(yakogai):
    one, again, other = (
        simulate_specimen("yakogai", noise=0.02, seed=seed, step_deg=14) for seed in (5, 5, 6)
    )
    assert one == again
    assert not np.array_equal(one.values, other.values)
    assert simulate_specimen("yakogai", seed=9) == yakogai  # the shell is the same


def test_noise_has_the_size_asked_for(yakogai):
    noisy = simulate_specimen("yakogai", noise=0.03, seed=1)
    deviation = (noisy.values - yakogai.values) / noisy.std
    np.testing.assert_allclose(noisy.std, 0.03 * np.maximum(yakogai.values, 1), rtol=1e-12)
    assert abs(deviation.mean()) < 0.02
    assert deviation.std() == pytest.approx(1, abs=0.02)
    assert yakogai.std is None


@pytest.mark.usefixtures("few_stacks")
@pytest.mark.parametrize("name", NAMES)
def test_says_that_it_is_simulated(name, tmp_path):
    shell = simulate_specimen(name, noise=0.01, step_deg=35)
    assert shell.metadata.simulated
    assert shell.metadata.instrument.startswith("simulated")
    assert "plausible" in shell.metadata.notes[0]
    assert (shell.metadata.white, shell.metadata.observer) == ("D65", "CIE 1931 2 deg")
    shell.save(tmp_path / "shell.csv")
    assert native_csv.read(tmp_path / "shell.csv") == shell


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"name": "oyster"}, "specimen: expected one of yakogai, .*mexican, got 'oyster'"),
        ({"name": ["yakogai"]}, "got \\['yakogai'\\]"),
        ({"noise": -0.1}, "noise: expected a number in 0…1, got -0.1"),
        ({"noise": float("nan")}, "noise: .*got nan"),
        ({"noise": "much"}, "noise: .*got 'much'"),
        ({"tablet_scale": 2}, "tablet_scale: expected a number in 0.7…1.4, got 2"),
        ({"seed": -1}, "seed: .*got -1"),
        ({"seed": 1.5}, "seed: .*got 1.5"),
        ({"step_deg": 0}, "step_deg: .*got 0$"),
        ({"step_deg": float("inf")}, "step_deg: .*got inf"),
        ({"step_deg": 9}, "step_deg: expected a whole number of steps to 70, got 9"),
        ({"geometries_deg": [1, 2, 3]}, r"geometries_deg: expected shape \[M, 3\], got \[3\]"),
        ({"geometries_deg": []}, "shape"),
        ({"geometries_deg": [("a", "b", "c")]}, "got values that are not numbers"),
        ({"geometries_deg": [(0, 0, 0), (95, 0, 0)]}, r"row 2: .*got \[95.0, 0.0, 0.0\]"),
        ({"geometries_deg": [(0, float("nan"), 0)]}, r"row 1: .*got \[0.0, nan, 0.0\]"),
    ],
)
def test_bad_input_is_one_line(arguments, message):
    with pytest.raises(InputError, match=message) as error:
        simulate_specimen(**arguments)
    assert "\n" not in str(error.value)


def test_needs_no_torch():
    code = (
        "import sys; from raden_torch.optics import simulate_specimen; "
        "assert not {'torch', 'colour'} & set(sys.modules), 'heavy imports'"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
