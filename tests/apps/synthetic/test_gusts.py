"""Gusts: von Karman's spectrum, the variance, and a wind that is recorded with a run."""

import numpy as np
import pytest
from scipy.special import hyp2f1

from giajax import InputError, gusts
from giajax.apps.synthetic import gust_coherence, gust_spectrum, gusts_left_out
from giajax.simulation import ramps

pytestmark = pytest.mark.quick

WIND = {"speed": 0.2, "deviation": 0.06, "length_scale": 3.0}


@pytest.mark.parametrize("along", [True, False])
def test_the_spectrum_has_the_variance(along):
    frequencies = np.geomspace(1e-6, 1e4, 200_001)
    density = gust_spectrum(frequencies, **WIND, along=along)
    assert np.trapezoid(density, frequencies) == pytest.approx(0.06**2, rel=2e-4)
    # Kolmogorov's inertial range has the slope -5/3.
    slope = np.diff(np.log(density[-2:])) / np.diff(np.log(frequencies[-2:]))
    assert slope == pytest.approx(-5 / 3, abs=1e-4)


def test_the_components_are_those_of_isotropic_turbulence():
    """S_across = (S_along - f dS_along/df) / 2, which requires no other formula."""
    frequencies = np.geomspace(1e-3, 10, 2001)
    along = gust_spectrum(frequencies, **WIND, along=True)
    across = gust_spectrum(frequencies, **WIND, along=False)
    slope = np.gradient(along, frequencies, edge_order=2)
    expected = (along - frequencies * slope) / 2
    np.testing.assert_allclose(across[1:-1], expected[1:-1], rtol=1e-4)


def test_more_lines_are_the_same_turbulence():
    given = {"intensity": 0.2, "length_scale": 1.0, "duration": 300.0, "seed": 3}
    few, many = (columns(gusts([0.5, 0, 0], lines=n, **given)) for n in (400, 1600))
    assert np.std(many, axis=0) == pytest.approx(np.full(3, 0.1), rel=0.2)
    assert np.max(np.abs(many - few)) > 0.05
    with pytest.raises(InputError, match="lines"):
        gusts([0.5, 0, 0], lines=0, **given)


def columns(wind):
    return np.stack([wind.values[f"wind_{axis}"] for axis in "xyz"], axis=1)


def test_a_long_wind_has_mean_and_deviations_along_its_own_axes():
    direction = np.array([0.6, 0.0, 0.8])
    wind = gusts(
        0.5 * direction, intensity=[0.3, 0.2, 0.1], length_scale=1.0, duration=1000.0, seed=2
    )
    velocity = columns(wind)
    np.testing.assert_allclose(velocity.mean(axis=0), 0.5 * direction, atol=0.02)
    level = np.array([0.0, 1.0, 0.0])
    for axis, share in ((direction, 0.3), (level, 0.2), (np.cross(direction, level), 0.1)):
        # The part that rows of 0.1 s do not resolve is missing, here 5 %.
        assert np.std(velocity @ axis) == pytest.approx(0.5 * share, rel=0.15)
    # Compare with a periodogram of 100 s segments, at half and twice a band.
    one = (velocity @ direction - 0.5)[:-1].reshape(10, 1000)
    frequencies = np.fft.rfftfreq(1000, 0.1)
    density = 2 * 0.1 / 1000 * np.mean(np.abs(np.fft.rfft(one, axis=1)) ** 2, axis=0)
    theory = gust_spectrum(frequencies, speed=0.5, deviation=0.15, length_scale=1.0, along=True)
    for low, high in ((0.05, 0.2), (0.2, 0.6), (0.6, 2.0)):
        band = (frequencies >= low) & (frequencies < high)
        assert density[band].mean() == pytest.approx(theory[band].mean(), rel=0.35)


def test_it_is_smooth_enough_for_added_mass():
    """There are no jumps and no waves that the rows do not resolve."""
    wind = gusts([0, 0.2, 0], intensity=0.5, length_scale=0.5, duration=50.0, seed=4)
    signal = ramps(wind.times, columns(wind), tolerance=0.0)
    # A signal of NumPy arrays has the same corners, so no program is compiled.
    values, slopes = np.asarray(signal.values), np.asarray(signal.slopes)
    steps = np.diff(np.asarray(signal.times))[:, None]
    np.testing.assert_allclose(values[:-1] + slopes[:-1] * steps, values[1:], atol=1e-12)
    power = np.abs(np.fft.rfft(np.hanning(501)[:, None] * columns(wind), axis=0)) ** 2
    above = np.fft.rfftfreq(501, 0.1) > 2.6
    assert power[above].sum() < 1e-5 * power.sum()


def test_seeds_and_components():
    wind = {"length_scale": 2.0, "duration": 10.0}
    first = columns(gusts([0, 0.1, 0], intensity=0.5, seed=1, **wind))
    again = columns(gusts([0, 0.1, 0], intensity=0.5, seed=1, **wind))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - columns(gusts([0, 0.1, 0], intensity=0.5, seed=2, **wind))).max() > 0.01
    only = columns(gusts([0, 0.1, 0], intensity=[0.5, 0, 0], seed=1, **wind))
    np.testing.assert_array_equal(only[:, [0, 2]], 0)
    np.testing.assert_allclose(only[:, 1], first[:, 1], atol=1e-15)


@pytest.mark.parametrize(
    ("mean", "changes", "message"),
    [
        ([0, 0, 0], {}, "not all 0"),
        ([0, 0.1], {}, "three numbers"),
        ([0, 0.1, 0], {"intensity": -1}, "intensity of gusts is -1"),
        ([0, 0.1, 0], {"intensity": [0, 0, 0]}, "not all of them 0"),
        ([0, 0.1, 0], {"length_scale": 0}, "length_scale of gusts is 0"),
        ([0, 0.1, 0], {"duration": np.inf}, "duration of gusts is inf"),
    ],
)
def test_what_is_no_wind_is_refused(mean, changes, message):
    numbers = {"intensity": 0.5, "length_scale": 2.0, "duration": 10.0}
    with pytest.raises(InputError, match=message):
        gusts(mean, **{**numbers, **changes})


def test_what_rows_do_not_resolve_is_what_a_wind_lacks():
    """Compare with the hypergeometric integral (along) and with a long wind (across)."""
    along, across = gusts_left_out(0.2, length_scale=0.5, interval=0.1)
    highest = 2.5
    x = (2 * np.pi * 1.339 * 0.5 / 0.2 * highest) ** 2
    below = 4 * 2.5 * highest * hyp2f1(0.5, 5 / 6, 1.5, -x)
    assert along == pytest.approx(1 - below, rel=1e-3)
    wind = gusts(
        [0, 0.2, 0], intensity=[0, 0.5, 0], length_scale=0.5, duration=2000.0, interval=0.1, seed=1
    )
    assert np.var(columns(wind)[:, 0]) / 0.1**2 == pytest.approx(1 - across, abs=0.04)
    assert 0.05 < along < across < 0.3
    # With dense rows, nothing is missing; with rare rows, everything.
    assert max(gusts_left_out(0.2, length_scale=5.0, interval=1e-4)) < 1e-3
    assert min(gusts_left_out(0.2, length_scale=0.001, interval=10.0)) > 0.9


def test_gusts_along_the_arm_are_coherent_over_distances():
    """Over many winds, the covariances are the integrals of spectrum times coherence."""
    places = np.array([[0.0, 0, 0], [0.1, 0, 0], [0.8, 0, 0]])
    scales = {"speed": 0.5, "length_scale": 1.0}
    rows = []
    for seed in range(120):
        wind = gusts(
            [0, 0.5, 0],
            intensity=[0, 0, 0.4],
            length_scale=1.0,
            duration=0.2,
            seed=seed,
            places=places,
        )
        assert len(wind.values) == 9
        rows.append([wind.values[f"link{link:02d}_wind_z"][0] for link in (1, 2, 3)])
    found = np.cov(np.transpose(rows))
    frequencies = np.geomspace(1e-3, 2.5, 400)
    density = gust_spectrum(frequencies, deviation=0.2, along=False, **scales)
    shared = [
        gust_coherence(places, each, along=np.array([0.0, 1, 0]), **scales) for each in frequencies
    ]
    theory = np.trapezoid(density[:, None, None] * shared, frequencies, axis=0)
    # The standard error of a covariance of 120 winds is about 0.13 of the variance.
    np.testing.assert_allclose(found, theory, atol=0.3 * 0.2**2)
    assert theory[0, 0] > 1.5 * theory[0, 1] > 2 * theory[0, 2]
    assert theory[0, 2] < 0.2 * theory[0, 0]


def test_gusts_come_later_along_the_mean_flow():
    """Frozen turbulence without lateral decay: 1 m at 0.5 m/s is 2 s, or twenty rows."""
    places = np.array([[0.0, 0, 0], [0, 1.0, 0]])
    wind = gusts([0, 0.5, 0], intensity=0.4, length_scale=1.0, duration=60.0, seed=3, places=places)
    first, second = (wind.values[f"link{link:02d}_wind_y"] for link in (1, 2))
    np.testing.assert_allclose(second[20:], first[:-20], atol=1e-3)
    assert np.abs(second - first).max() > 0.1
    with pytest.raises(InputError, match=r"the positions for the gusts have the shape \(3,\)"):
        gusts([0, 1, 0], intensity=0.1, length_scale=1, duration=1, places=[0, 0, 0])
    with pytest.raises(InputError, match="the decay coefficient of the gust coherence is -1"):
        gusts([0, 1, 0], intensity=0.1, length_scale=1, duration=1, places=places, decay=-1)
