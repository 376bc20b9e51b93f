"""Short loops of a play in parallel with a spring: quick to fit, also in a separate process."""

import itertools

import numpy as np

DEFINITION = """
model = "hysteresis"
[hysteresis]
operator = "prandtl_ishlinskii"
thresholds = [0.2]
[fit]
data = ["loops.csv"]
validation = ["other.csv"]
free = ["elastic", "weights[0]"]
loss = "soft_l1"
[fit.start]
"weights[0]" = 0.3
[fit.fix]
offset = 0.1
"""


def write_loops(path, turns, seed):
    """Write a play of threshold 0.2 and a spring: 0.5 u + 0.8 play(u) + 0.1, with noise."""
    inputs = np.concatenate([np.linspace(a, b, 12)[1:] for a, b in itertools.pairwise(turns)])
    play, outputs = 0.0, []
    for value in inputs:
        play = min(max(play, value - 0.2), value + 0.2)
        outputs.append(0.5 * value + 0.8 * play + 0.1)
    noise = 0.005 * np.random.default_rng(seed).normal(size=len(inputs))
    rows = [f"{a:.9g},{b:.9g}" for a, b in zip(inputs, np.asarray(outputs) + noise, strict=True)]
    path.write_text("\n".join(["input,output", *rows]) + "\n")


def write_task(folder):
    """Write `loops_fit.toml` with its two runs, and return its path."""
    write_loops(folder / "loops.csv", (0, 1, -0.8, 0.7, -0.4, 0.5), seed=4)
    write_loops(folder / "other.csv", (0, -0.9, 0.9, -0.2, 0.6), seed=5)
    (folder / "loops_fit.toml").write_text(DEFINITION)
    return folder / "loops_fit.toml"
