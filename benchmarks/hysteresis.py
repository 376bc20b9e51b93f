"""Play operators: time and memory of the two scans and of a NumPy loop, with and without gradient.

    python -m benchmarks.hysteresis [--samples 100000] [--thresholds 200] [--repeats 3] [--json]

Each method runs in a separate process, because the peak memory is a property of the process.
On a shared machine, compare only the ratios within one call.
"""

import argparse
import json
import resource
import subprocess
import sys

import numpy as np

from benchmarks.measuring import fastest

METHODS = ("scan", "associative", "numpy")


def numpy_loop(inputs: np.ndarray, thresholds: np.ndarray) -> np.ndarray:
    """Evaluate the definition sample by sample, for all thresholds at once."""
    w = np.zeros_like(thresholds)
    rows = np.empty((len(inputs), len(thresholds)))
    for k, u in enumerate(inputs):
        w = np.minimum(np.maximum(w, u - thresholds), u + thresholds)
        rows[k] = w
    return rows


def numpy_gradient(inputs: np.ndarray, thresholds: np.ndarray) -> np.ndarray:
    """Return the derivative of the sum of all plays with respect to the thresholds, by hand."""
    w = np.zeros_like(thresholds)
    slope = np.zeros_like(thresholds)
    total = np.zeros_like(thresholds)
    for u in inputs:
        slope = np.where(w < u - thresholds, -1.0, np.where(w > u + thresholds, 1.0, slope))
        w = np.minimum(np.maximum(w, u - thresholds), u + thresholds)
        total += slope
    return total


def peak_mib() -> float:
    """Return the peak memory of the process so far, MiB."""
    size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return size / (1024 if sys.platform != "darwin" else 1024**2)


def history(samples: int, thresholds: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a random walk and the thresholds, without 0, where a play is not differentiable."""
    walk = np.cumsum(np.random.default_rng(0).normal(scale=0.05, size=samples))
    return walk, np.linspace(0.02, 4.0, thresholds)


def measure(method: str, samples: int, thresholds: int, repeats: int) -> dict[str, object]:
    """Measure the times and the peak memory of one method in this process.

    The sum of the gradient is returned to compare the methods.
    """
    inputs, widths = history(samples, thresholds)
    if method == "numpy":
        before = peak_mib()
        forward = fastest(lambda: numpy_loop(inputs, widths), 1)
        memory_forward = peak_mib() - before
        gradient = fastest(lambda: numpy_gradient(inputs, widths), 1)
        check = float(np.sum(numpy_gradient(inputs, widths)))
    else:
        import jax

        jax.config.update("jax_enable_x64", True)
        import jax.numpy as jnp

        from giajax.mechanics.hysteresis import play

        u, r = jnp.asarray(inputs), jnp.asarray(widths)

        @jax.jit
        def run(u: jax.Array, r: jax.Array) -> jax.Array:
            return play(u, r, method=method)  # type: ignore[arg-type]

        @jax.jit
        def slope(u: jax.Array, r: jax.Array) -> jax.Array:
            return jax.grad(lambda r: jnp.sum(play(u, r, method=method)))(r)  # type: ignore[arg-type]

        jax.block_until_ready(run(u[:10], r[:2]))
        before = peak_mib()
        forward = fastest(lambda: jax.block_until_ready(run(u, r)), repeats)
        memory_forward = peak_mib() - before
        gradient = fastest(lambda: jax.block_until_ready(slope(u, r)), repeats)
        check = float(jnp.sum(slope(u, r)))
    return {
        "method": method,
        "history_s": forward,
        "gradient_s": gradient,
        "history_mib": memory_forward,
        "peak_mib": peak_mib() - before,
        "sum_of_gradient": check,
    }


def main(arguments: list[str]) -> int:
    """Measure each method in a separate process and print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--samples", type=int, default=100_000)
    parser.add_argument("--thresholds", type=int, default=200)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--only", choices=METHODS, help=argparse.SUPPRESS)
    given = parser.parse_args(arguments)
    size = (given.samples, given.thresholds, given.repeats)
    if given.only:
        print(json.dumps(measure(given.only, *size)))
        return 0
    found = []
    for method in METHODS:
        command = [sys.executable, "-m", "benchmarks.hysteresis", "--only", method]
        command += [
            f"--{name}={value}"
            for name, value in zip(("samples", "thresholds", "repeats"), size, strict=True)
        ]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        found.append(json.loads(done.stdout))
    sums = [row["sum_of_gradient"] for row in found]
    if not np.allclose(sums, sums[0], rtol=1e-9):
        print(f"the methods disagree: {sums}", file=sys.stderr)
        return 1
    if given.json:
        print(json.dumps(found, indent=2))
        return 0
    print(f"{given.samples} samples x {given.thresholds} thresholds, float64")
    print("method       history s  gradient s  history MiB  with gradient MiB")
    for row in found:
        print(
            f"{row['method']:<12} {row['history_s']:>9.3g}  {row['gradient_s']:>10.3g}  "
            f"{row['history_mib']:>11.0f}  {row['peak_mib']:>17.0f}"
        )
    scan = found[0]
    for row in found[1:]:
        print(
            f"{row['method']} takes {row['history_s'] / scan['history_s']:.1f} times as long as "
            f"scan, with gradient {row['gradient_s'] / scan['gradient_s']:.1f} times"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
