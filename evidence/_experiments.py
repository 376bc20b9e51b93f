"""Three short experiments with known parameters, for repeated recordings and fits."""

import itertools
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from ._draw import correlated_noise, correlation_time

if TYPE_CHECKING:
    from giajax import AbstractModel, Definition, Run

Stated = Literal["nothing", "size", "all"]
"""Statement of a sidecar on the noise: nothing, its standard deviation, or its memory, too."""


class Experiment(NamedTuple):
    """A model, its noise-free run, and the noise that is added.

    Attributes:
        model: model to fit.
        clean: run simulated with the true parameters; its definition states the noise of a cell.
        values: true value and start value of each fitted parameter, by path.
        noise: quantity and unit of the noise, as in `[noise]`.
    """

    model: "AbstractModel"
    clean: "Run"
    values: Mapping[str, tuple[float, float]]
    noise: tuple[str, str]

    @property
    def truth(self) -> dict[str, float]:
        return {path: true for path, (true, _) in self.values.items()}

    @property
    def start(self) -> dict[str, float]:
        return {path: first for path, (_, first) in self.values.items()}

    @property
    def times(self) -> np.ndarray:
        """Times of the samples, which are evenly spaced, s."""
        assert self.clean.times is not None
        return self.clean.times

    def time_of(self, rho: float) -> float:
        """Return the correlation time, s, of noise with this correlation from sample to sample."""
        return correlation_time(rho, float(self.times[1] - self.times[0]))

    def stating(self, stated: Stated, rho: float) -> "Definition":
        """Return the sidecar of a recording with this correlation from sample to sample."""
        import giajax

        sections = self.clean.definition.contents()
        quantity, unit = self.noise
        section: dict[str, Any] = {}
        if stated != "nothing":
            section = sections["noise"]
        if stated == "all" and rho:
            size = f"{quantity}_{unit}"
            section = {
                **section,
                f"{quantity}_correlated_{unit}": section[size],
                f"{quantity}_correlation_s": self.time_of(rho),
            }
        return giajax.Definition.parse({**sections, "noise": section}, "an experiment")

    def recorded(self, definition: "Definition", rho: float, rng: np.random.Generator) -> "Run":
        """Return a recording with noise of this correlation from sample to sample.

        Arguments:
            definition: sidecar of the recording.
            rho: correlation of the noise from sample to sample, 0 if it is white.
            rng: random number generator of the noise.
        """
        import giajax

        clean, time_s = self.clean, self.time_of(rho)
        noisy = {
            name: row + clean.noise(name) * correlated_noise(self.times, time_s, rng)
            for name, row in clean.observations.items()
        }
        return giajax.Run.from_arrays(
            clean.times, {**clean.commands, **noisy}, definition=definition
        )


def _made(
    build: Any,
    times: np.ndarray,
    inputs: Mapping[str, Any],
    channels: list[str],
    noise: tuple[str, str, float],
    values: Mapping[str, tuple[float, float]],
) -> Experiment:
    """Make an experiment from the function that builds its model with given values."""
    import giajax

    quantity, unit, size = noise
    truth = {path: true for path, (true, _) in values.items()}
    run = giajax.synthesise(build(truth), times, inputs, channels)
    stated = giajax.Definition.parse({"noise": {f"{quantity}_{unit}": size}}, "noise")
    clean = giajax.Run.from_arrays(times, run.values, definition=run.definition.merged_with(stated))
    return Experiment(build({}), clean, values, (quantity, unit))


def short_arm() -> Experiment:
    """Return an arm of three links, the first two joints driven, with 2 mm position noise."""
    import giajax

    def build(values: Mapping[str, float]) -> Any:
        return giajax.ArmModel(giajax.replace(giajax.takeichi_20m(3), values))

    times = np.linspace(0.0, 4.0, 401)
    ramp = np.clip(times / 0.5, 0, 1)
    return _made(
        build,
        times,
        {"joint01_command": 0.6 * ramp, "joint02_command": -0.5 * ramp},
        ["link03_y", "link03_z"],
        ("position", "m", 0.002),
        {
            "air.drag_coefficient": (1.1, 0.9),
            "joints.pitch_stiffness": (2.5, 3.0),
            "joints.yaw_stiffness": (4.0, 5.0),
            "joints.damping": (0.1, 0.07),
        },
    )


def play_operator() -> Experiment:
    """Return nested loops of a Prandtl-Ishlinskii operator of two plays, noise 0.3 degrees."""
    import giajax

    section = {"operator": "prandtl_ishlinskii", "thresholds": [0.2, 0.5]}
    definition = {"hysteresis": {**section, "input_range": [-1.0, 1.0]}}

    def build(values: Mapping[str, float]) -> Any:
        return giajax.build_model("hysteresis", definition, values)

    turns = np.deg2rad([0, 55, -55, 40, -30, 50, -10, 20, -45, 0])
    ways = [np.linspace(a, b, 46)[1:] for a, b in itertools.pairwise(turns)]
    command = np.concatenate([[0.0], *ways])
    return _made(
        build,
        0.1 * np.arange(len(command)),
        {"command": command},
        ["angle"],
        ("angle", "deg", 0.3),
        {
            "elastic": (0.52, 0.9),
            "weights[0]": (0.19, 0.1),
            "weights[1]": (0.25, 0.1),
            "offset": (0.03, 0.06),
        },
    )


def muscle_stand() -> Experiment:
    """Return a braided muscle extended and contracted at four pressures, force noise 0.3 N."""
    import giajax

    section = {"law": "braided", "friction": "coulomb"}

    def build(values: Mapping[str, float]) -> Any:
        return giajax.build_model("muscle", {"muscle": section}, values)

    there, back = np.linspace(0, 0.15, 51)[1:], np.linspace(0.15, 0, 51)[1:]
    inputs = {
        "pressure": np.repeat([100e3, 150e3, 200e3, 300e3], 100),
        "contraction": np.tile(np.concatenate([there, back]), 4),
        "phase": np.tile(np.repeat(["fill", "exhaust"], 50), 4),
    }
    return _made(
        build,
        0.1 * np.arange(400),
        inputs,
        ["force"],
        ("force", "N", 0.3),
        {
            "muscle.effectiveness": (0.85, 0.5),
            "muscle.end_correction": (1.7, 1.1),
            "muscle.dead_band": (25e3, 5e3),
            "friction.half_width[0]": (0.9, 0.3),
        },
    )


EXPERIMENTS = {
    "an arm of 3 links": short_arm,
    "plays of a joint": play_operator,
    "a muscle": muscle_stand,
}
