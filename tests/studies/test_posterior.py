"""Posterior draws: compared with closed forms, another sampler, and differences."""

import dataclasses
import importlib.util
import sys
import threading
from types import SimpleNamespace

import equinox as eqx
import numpy as np
import pytest

import giajax
from giajax import InputError, Prior
from giajax.fitting import check_proper, density_of, energy_at
from giajax.recordings import unique_names
from giajax.report import draws_file, posterior_files, trace_figure
from giajax.studies import (
    Fitted,
    as_arviz,
    check_posterior,
    mixing,
    optimum_of,
    posterior,
)
from giajax.studies._posterior import bands, doubts
from toy_model import TRUTH, Decay, run

# The bound is near the optimum of 0.699, so a density without a bound would differ.
BOUNDS = {"decay": (0.7005, 9.0)}
NOISE = 0.01
# The standard error of a variance is then 3 %, a quarter of the tolerance of the tests.
DRAWS = 2000


def flat(found):
    return found.samples.reshape(-1, found.samples.shape[-1])


@pytest.fixture(scope="module")
def line():
    """Return a fit whose free parameters are linear, so the posterior is normal."""
    recorded = run(seed=4)
    free = ["amplitude", "offset"]
    start = {"decay": TRUTH["decay"]}
    return giajax.fit(Decay(), recorded, free=free, fix=start, noise_model="white"), recorded


@pytest.fixture(scope="module")
def drawn(line):
    return posterior(*line, chains=3, draws=DRAWS, warmup=100)


@pytest.fixture(scope="module")
def bent():
    """Return a fit with a bound that cuts the posterior, a prior, and no data for `idle`."""
    recorded = run(seed=0)
    priors = {"amplitude": Prior(2.01, deviation=0.004), "idle": Prior(3.0, factor=2)}
    settings = {"bounds": BOUNDS, "priors": priors, "noise_model": "white"}
    free = ["amplitude", "decay", "idle"]
    start = {"decay": 0.9}
    fix = {"offset": TRUTH["offset"]}
    return giajax.fit(Decay(), recorded, free=free, start=start, fix=fix, **settings), recorded


def test_of_a_linear_model_it_is_the_normal_distribution_of_least_squares(line, drawn):
    recorded = line[1]
    columns = np.stack([np.exp(-0.7 * recorded.times), np.ones(len(recorded.times))], 1)
    heights = recorded.observations["tip_z"]
    best, squares, *_ = np.linalg.lstsq(columns, heights, rcond=None)
    # The noise is that of the standard errors: the stated one, unless the residuals exceed it.
    scale = max(1.0, squares[0] / NOISE**2 / (len(heights) - 2))
    covariance = np.linalg.inv(columns.T @ columns) * NOISE**2 * scale
    errors = np.sqrt(np.diag(covariance))
    draws = flat(drawn)
    known = [one.ess_bulk for one in drawn.summary.parameters.values()]
    assert min(known) > 1000
    assert drawn.summary.warnings == ()
    off = (draws.mean(axis=0) - best) / errors
    assert np.all(np.abs(off) < 4 / np.sqrt(min(known)))
    np.testing.assert_allclose(np.cov(draws.T), covariance, rtol=0.12)
    for one in drawn.summary.parameters.values():
        np.testing.assert_allclose(one.interval, one.linear, atol=0.15 * one.deviation)


def test_each_channel_has_a_band_that_holds_what_was_recorded(line, drawn):
    _, recorded = line
    (by_channel,) = drawn.bands
    band = by_channel["tip_z"]
    spread = np.exp(-0.7 * recorded.times)[None] * flat(drawn)[:, :1] + flat(drawn)[:, 1:]
    np.testing.assert_allclose(band.high - band.low, 3.92 * spread.std(axis=0), rtol=0.25)
    low, high = band.with_noise()
    np.testing.assert_allclose(high - low, 3.92 * NOISE, rtol=0.1)
    assert 0.85 < band.within <= 1


def test_a_band_has_the_noise_that_residuals_show(line):
    """The residuals exceed the stated noise, as in the standard errors."""
    result, recorded = line
    optimum = optimum_of(result, [recorded])
    wide = SimpleNamespace(at=optimum.at, statistics=SimpleNamespace(scale=9.0))
    (by_channel,) = bands(result, [recorded], wide, optimum.values[None])
    band = by_channel["tip_z"]
    low, high = band.with_noise()
    np.testing.assert_allclose(high - low, 2 * 1.96 * 3 * NOISE, rtol=1e-3)
    assert band.within == 1


def test_runs_of_one_name_are_told_apart_or_refused(line, drawn, monkeypatch):
    same = SimpleNamespace(labels=("tip of 'run'", "tip of 'run'"))
    monkeypatch.setattr(Fitted, "optimum", lambda fitted: same)
    with pytest.raises(
        InputError, match=r"two runs have the same name.* tip of 'run' .* rename one"
    ):
        posterior(*line)
    assert drawn.summary.within == {"run4": {"tip_z": drawn.bands[0]["tip_z"].within}}
    assert unique_names([line[1], line[1]]) == ["run4", "run4_2"]


def test_chains_that_never_moved_are_the_worst(drawn):
    known = dict(drawn.summary.parameters)
    known["offset"] = dataclasses.replace(known["offset"], r_hat=None, ess_bulk=None, ess_tail=None)
    (sentence,) = doubts(known, 0, drawn.samples, [], 3)
    assert sentence.startswith(
        "the chains are stuck, because all draws of offset within a chain are equal"
    )


def test_the_gradient_is_that_of_differences(bent):
    """Noise, priors and the map of the bound together; the programs of the fit agree."""
    optimum = optimum_of(bent[0], [bent[1]])
    density = density_of(optimum)
    at = eqx.filter_jit(density.at)
    z = np.array([0.4, -1.3, 0.7])
    energy, gradient = at(z)
    again = energy_at(density, optimum, z)
    np.testing.assert_allclose(again[0], energy, rtol=1e-9)
    np.testing.assert_allclose(again[1], gradient, rtol=1e-9)
    for index, step in enumerate(1e-5 * np.eye(3)):
        difference = (at(z + step)[0] - at(z - step)[0]) / 2e-5
        np.testing.assert_allclose(gradient[index], difference, rtol=1e-6)


@pytest.fixture(scope="module")
def cut(bent):
    return posterior(*bent, chains=2, draws=1400, warmup=160)


def test_where_data_say_nothing_it_is_the_prior(cut):
    """The prior of a factor is log-normal, with its median at its value."""
    known = cut.summary.parameters["idle"]
    # Chains depend on the processor: with the same seed, the result may be 340 or above 600.
    assert min(known.ess_bulk, known.ess_tail) > 200
    ends = np.percentile(cut.draws_of("idle"), (16, 50, 84))
    np.testing.assert_allclose(np.log2(ends / 3), [-1, 0, 1], atol=0.3)


def test_another_sampler_finds_the_same_posterior_at_a_bound(bent, cut):
    """The affine-invariant ensemble sampler of emcee, with a density that is written here."""
    import emcee

    _, recorded = bent
    times, heights = recorded.times, recorded.observations["tip_z"]
    scale = cut.summary.scale

    def log_density(values):
        amplitude, decay = values
        if not 0.7005 < decay < 9:
            return -np.inf
        off = (amplitude * np.exp(-decay * times) + 0.3 - heights) / NOISE
        return -np.sum(off**2) / 2 / scale - ((amplitude - 2.01) / 0.004) ** 2 / 2

    rng = np.random.default_rng(1)
    begun = np.column_stack([rng.normal(2.0, 0.003, 12), rng.uniform(0.7006, 0.704, 12)])
    sampler = emcee.EnsembleSampler(12, 2, log_density)
    sampler.random_state = np.random.RandomState(1).get_state()
    sampler.run_mcmc(begun, 4500)
    other = sampler.get_chain(discard=500, flat=True)
    quantiles = (5, 25, 50, 75, 95)
    ours, theirs = (np.percentile(each, quantiles, axis=0) for each in (flat(cut)[:, :2], other))
    np.testing.assert_allclose((ours - theirs) / other.std(axis=0), 0, atol=0.16)
    # Unlike the linear interval, the density is one-sided.
    decay = cut.summary.parameters["decay"]
    assert decay.interval[0] > 0.7005
    assert (decay.interval[1] - decay.mean) > 1.4 * (decay.mean - decay.interval[0])


def test_after_a_stop_it_goes_on(line, tmp_path, monkeypatch):
    monkeypatch.setenv("GIAJAX_CORES", "1")  # the chains run in sequence
    done, draws = [], 200

    def stop(transitions, total):
        done.append(transitions)
        if transitions > draws + 200:
            raise KeyboardInterrupt

    settings = {"chains": 3, "draws": draws, "warmup": 100}
    plain = posterior(*line, **settings)
    settings["folder"] = tmp_path
    first = posterior(*line, **settings, progress=stop)
    assert first.samples.shape == (1, draws, 2)
    assert "2 of 3 chains were not sampled" in first.summary.warnings[0]
    assert len(list(tmp_path.iterdir())) == 1
    again = posterior(*line, **settings, progress=lambda *each: done.append(each))
    assert len(list(tmp_path.iterdir())) == 3
    # The file of the first chain is used, and the result is that of an uninterrupted run.
    assert done[-1] == (3 * (draws + 100), 3 * (draws + 100))
    # Progress is reported every twenty transitions, for two chains.
    assert sum(isinstance(each, tuple) for each in done) < 2.5 * (draws + 100) / 20
    np.testing.assert_array_equal(again.samples, plain.samples)
    with pytest.raises(KeyboardInterrupt):
        posterior(*line, chains=1, draws=draws, warmup=100, seed=1, progress=stop_at_once)


def stop_at_once(transitions, total):
    raise KeyboardInterrupt


@pytest.mark.parametrize("cores", ["1", "3"])
def test_chains_are_shared_out_among_cores(line, drawn, monkeypatch, cores):
    """This does not change the draws, and the progress covers all chains."""
    monkeypatch.setenv("GIAJAX_CORES", cores)
    said, together = [], set()

    def heard(transitions, total):
        said.append((transitions, total))
        together.add(threading.get_ident())

    again = posterior(*line, chains=3, draws=DRAWS, warmup=100, progress=heard)
    np.testing.assert_array_equal(again.samples, drawn.samples)
    whole = 3 * (DRAWS + 100)
    assert said[-1] == (whole, whole)
    assert said == sorted(said)
    # The threads that draw, and the one that receives their progress.
    assert len(together) == 1 + int(cores)


def test_arviz_reads_the_draws_back(line, drawn, tmp_path):
    arviz = pytest.importorskip("arviz")
    files = posterior_files(drawn, line[0], [line[1]])
    (tmp_path / "draws.nc").write_bytes(files["posterior.nc"])
    back = arviz.from_netcdf(str(tmp_path / "draws.nc"))
    np.testing.assert_array_equal(back["posterior"]["offset"].values, drawn.samples[..., 1])
    assert back["sample_stats"]["diverging"].values.shape == (3, DRAWS)
    assert files["posterior_bands.csv"].decode().count("\n") == 61


def test_traces_show_each_chain_and_its_ranks(line, drawn):
    """Each rank occurs once, and each axis has its unit."""
    figure = trace_figure(drawn, line[0])
    labels = list(drawn.summary.parameters)
    assert len(figure.axes) == 2 * len(labels)
    for label, trace, ranks in zip(labels, figure.axes[::2], figure.axes[1::2], strict=True):
        np.testing.assert_array_equal(
            [each.get_ydata() for each in trace.lines], drawn.draws_of(label)
        )
        # The outline of the bars has two corners at each height.
        heights = [each.get_xy()[1:-1:2, 1] for each in ranks.patches]
        assert [each.sum() for each in heights] == [DRAWS] * 3
        np.testing.assert_allclose(np.sum(heights, axis=0), 3 * DRAWS / 20, atol=1)
        assert trace.get_ylabel() == f"{label}, m"


def test_the_next_arviz_takes_the_draws_too(drawn):
    """ArviZ 1 builds its data with `arviz_base`."""
    base = pytest.importorskip("arviz_base")
    tree = as_arviz({"offset": drawn.draws_of("offset")}, {"lp": -drawn.energy}, base)
    assert type(tree).__name__ == "DataTree"
    np.testing.assert_array_equal(tree["posterior"]["offset"].values, drawn.samples[..., 1])


def test_without_arviz_the_draws_are_numpys(drawn, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "arviz", None)
    with pytest.raises(
        InputError, match=r"the draws requires ArviZ, which is not installed.*\[posterior\]"
    ):
        drawn.to_arviz()
    name, content = draws_file(drawn)
    (tmp_path / name).write_bytes(content)
    back = np.load(tmp_path / "posterior.npz")
    assert list(back["parameters"]) == ["amplitude", "offset"]
    np.testing.assert_array_equal(back["samples"], drawn.samples)


@pytest.mark.quick
def test_without_numpyro_one_sentence_says_what_to_do(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"requires NumPyro.*pip install .*\[posterior\]"):
        check_posterior()


@pytest.mark.quick
@pytest.mark.parametrize("rho", [0.0, 0.8, -0.4])
def test_effective_draws_of_an_autoregression_are_as_many_as_they_are(rho):
    """(1 - rho) / (1 + rho) of all draws; R-hat detects a chain with another mean."""
    rng = np.random.default_rng(7)
    draws = np.zeros((4, 5000))
    for at in range(1, 5000):
        draws[:, at] = rho * draws[:, at - 1] + rng.normal(size=4)
    known = mixing(draws)
    assert known.ess_bulk == pytest.approx(20_000 * (1 - rho) / (1 + rho), rel=0.1)
    assert known.r_hat < 1.005
    draws[0] += draws.std()
    assert mixing(draws).r_hat > 1.05
    assert mixing(draws).ess_bulk < 50


@pytest.mark.quick
def test_mixing_is_as_arviz_has_it():
    arviz = pytest.importorskip("arviz")
    if not arviz.__version__.startswith("0."):
        pytest.skip("ArviZ 1 takes no plain arrays")
    draws = np.random.default_rng(0).standard_t(3, size=(4, 400)).cumsum(axis=1) * 0.02
    draws += np.random.default_rng(1).normal(size=(4, 400))
    known = mixing(draws)
    assert known.r_hat == pytest.approx(float(arviz.rhat(draws)), rel=1e-6)
    assert known.ess_bulk == pytest.approx(float(arviz.ess(draws)), rel=0.03)
    assert known.ess_tail == pytest.approx(float(arviz.ess(draws, method="tail")), rel=0.03)


@pytest.mark.quick
def test_what_nothing_limits_has_no_posterior():
    """An initial value has no lower bound; a share has bounds."""
    known = SimpleNamespace(
        labels=("mass", "start", "share"), standard_errors={0: 0.1}, alive=np.arange(3)
    )
    lower, upper = np.array([0.0, 0.0, 0.0]), np.array([np.inf, np.inf, 1.0])
    with pytest.raises(InputError, match="neither the data nor two bounds limit start: fix each"):
        check_proper(known, lower, upper)
    check_proper(known, lower, np.array([np.inf, 5.0, 1.0]))
