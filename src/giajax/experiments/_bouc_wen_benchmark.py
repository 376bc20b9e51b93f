"""The benchmark of a mass on a spring and damper with a Bouc-Wen element, generated here.

Reference: J. P. Noel, M. Schoukens, "Hysteretic benchmark with a dynamic nonlinearity", Workshop
on Nonlinear System Identification Benchmarks, Brussels 2016.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..models import OscillatorModel
from ..parameters import get
from ..runs import Run
from ..synthetic import synthesise

RATE = 750.0
SAMPLES = 8192
NOISE = 8e-6
_PATHS = ("mass", "damping", "stiffness", "alpha", "beta", "gamma", "delta")


@dataclass(frozen=True)
class BoucWenBenchmark:
    """Runs of the benchmark and what is behind them.

    Attributes:
        multisine: 5 to 150 Hz, 50 N RMS, 8192 samples at 750 Hz, 8e-3 mm RMS of noise.
        sweep: 20 to 50 Hz at 10 Hz a minute, 40 N, without noise.
        truth: parameters and determined products, SI.
    """

    multisine: Run
    sweep: Run
    truth: dict[str, float]


def bouc_wen_benchmark(seed: int = 0) -> BoucWenBenchmark:
    """Generate the benchmark; the phases of the multisine and the noise come from the seed.

    The force of the multisine is one period of a band-limited signal, that of the sweep is
    linear between its rows.
    """
    model = OscillatorModel(interpolation="band_limited").refined(1e-3)
    truth = {path: float(get(model, path)) for path in _PATHS}
    truth |= {name: float(derived.value) for name, derived in model.derived().items()}
    force = multisine(np.random.default_rng(seed))
    # To the digits of a file, so that a run that is read again is the same.
    times = np.round(np.arange(SAMPLES) / RATE, 9)
    recorded = synthesise(
        model,
        times,
        {"input": force},
        ["output"],
        noise={"output": NOISE},
        seed=seed,
        definition={"truth": truth},
        name="bouc_wen_multisine",
    )
    times, force = sweep()
    swept = synthesise(
        OscillatorModel().refined(1e-3),
        times,
        {"input": force},
        ["output"],
        definition={"truth": truth},
        name="bouc_wen_sweep",
    )
    return BoucWenBenchmark(recorded, swept, truth)


def multisine(random: np.random.Generator) -> npt.NDArray[np.float64]:
    """One period of equal amplitudes and random phases, 5 to 150 Hz, 50 N RMS; N."""
    frequencies = np.arange(SAMPLES // 2 + 1) * RATE / SAMPLES
    excited = (frequencies >= 5) & (frequencies <= 150)
    phases = np.exp(2j * np.pi * random.uniform(size=len(frequencies)))
    force = np.fft.irfft(np.where(excited, phases, 0), SAMPLES)
    return np.asarray(50 * force / np.sqrt(np.mean(force**2)))


def sweep() -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Times (s) and force (N) of a sine of 40 N from 20 to 50 Hz, 10 Hz a minute."""
    growth = 10 / 60
    times = np.arange(0, 30 / growth, 1 / RATE)
    return times, 40 * np.sin(2 * np.pi * (20 + growth / 2 * times) * times)


def decibels(rms: float) -> float:
    """An RMS error (m) as the literature on the benchmark states it: 20 log10 of it."""
    return float(20 * np.log10(rms))
