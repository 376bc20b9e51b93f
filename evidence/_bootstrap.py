"""Bootstrap: compare the spread of repeated fits of the paper's arm with the standard errors.

The fit `fits/base_step.toml` is repeated by `giajax.bootstrap` with simulated noise of its noise
model. A spread is the standard deviation of the repetitions divided by the standard error of the
fit. Its Monte Carlo error is 1 / sqrt(2 (size - 1)).
"""

from ._record import ROOT
from ._study import Figures, Study

FIT = ROOT / "fits" / "base_step.toml"
# Limit on the differences, in Monte Carlo errors.
FAR = 4.0


def run(size: int, seed: int) -> Figures:
    """Return the figures of `size` repetitions of one fit."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import giajax

    ready = giajax.FitTask.load(FIT).prepare()
    result = ready.run()
    found = giajax.bootstrap(result, ready.runs, size=max(size, 2), seed=seed)
    return {
        "repetitions": found.size,
        "came_back": found.came_back,
        "parameters": {
            path: {
                "spread": round(one.ratio or 0.0, 4),
                "spread_error": round(one.ratio_error or 0.0, 4),
                "bias": round(one.bias or 0.0, 4),
                "bias_error": round(one.bias_error or 0.0, 4),
                "coverage": None if one.coverage is None else round(one.coverage, 4),
            }
            for path, one in found.parameters.items()
        },
    }


def disagreements(stored: Figures, new: Figures) -> list[str]:
    """Return sentences on spreads and biases that differ by more than expected by chance."""
    sentences = []
    if list(stored["parameters"]) != list(new["parameters"]):
        return ["the parameters differ from the stored parameters: run the study again"]
    for path, before in stored["parameters"].items():
        after = new["parameters"][path]
        for key in ("spread", "bias"):
            allowed = FAR * (before[f"{key}_error"] + after[f"{key}_error"])
            if abs(before[key] - after[key]) > allowed:
                sentences.append(f"{path}: the {key} is {after[key]}, and {before[key]} is stored")
    return sentences


def table(figures: Figures) -> list[str]:
    """Return a table with a row for each parameter."""
    rows = [
        "| parameter | standard deviation over standard error | bias over standard error | "
        "coverage |",
        "| --- | --- | --- | --- |",
    ]
    for path, one in figures["parameters"].items():
        rows.append(
            f"| `{path}` | {one['spread']:.3f} +- {one['spread_error']:.3f} | "
            f"{one['bias']:+.3f} +- {one['bias_error']:.3f} | {100 * one['coverage']:.1f} % |"
        )
    rows += ["", f"{figures['came_back']} of {figures['repetitions']} repeated fits gave a result."]
    return rows


BOOTSTRAP = Study(
    name="bootstrap",
    meaning=(
        "The fit of the paper's base step is repeated with new noise (`giajax bootstrap`). The "
        "table lists the standard deviation and the bias of the repeated estimates, both divided "
        "by the standard error of the fit. It also lists the coverage, which is the share of "
        "repetitions whose 95 % interval contains the value that generated their data."
    ),
    size=400,
    seed=1,
    run=run,
    disagreements=disagreements,
    table=table,
)
