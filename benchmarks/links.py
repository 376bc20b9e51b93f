"""Time of one evaluation of the accelerations for up to 160 links; the limit is 110 us.

If another checkout is given, the two checkouts take turns, each in separate processes, and the
least times are compared. The limit was set when d753237 took 243 us. Relative to that version, the
limit for 160 links is therefore 110 / 243, which does not depend on the machine or its load. The
exit status is 1 if the limit is exceeded.

    python -m benchmarks.links [--quick] [--beside CHECKOUT] [--out FILE]
"""

import functools
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from benchmarks.measuring import (
    RESULTS,
    ROOT,
    checkouts_of,
    command_line,
    fastest,
    source_of,
    store,
)
from giajax.mechanics.arm import Arm, acceleration
from peers.arms import driven_arm, random_states

try:
    from giajax.runtime.programs import program
except ImportError:  # the first versions do not set XLA options
    program: Callable[..., Any] = jax.jit  # type: ignore[no-redef]

MOST_MICROSECONDS, MOST_BESIDE = 110.0, 110 / 243
LONGEST = "160"


def by_links(quick: bool) -> dict[str, float]:
    """Return the time of one evaluation by the number of links, us."""
    counts, times = ((3, 6), 10) if quick else ((20, 40, 80, 160), 500)
    found = {}
    for links in counts:
        arm, _ = driven_arm(links)
        state = {name: value[0] for name, value in random_states(links, 1).items()}
        taken = fastest(functools.partial(_evaluated, arm, state, times), 7)
        found[str(links)] = 1e6 * taken / times
    return found


def _evaluated(arm: Arm, state: dict[str, Any], count: int) -> None:
    """Compute `count` evaluations, each of which depends on the previous one."""
    jax.block_until_ready(_again(arm, state, np.asarray(count)))


@program
def _again(arm: Arm, state: dict[str, Any], count: Any) -> Any:
    def again(_: Any, angles: Any) -> Any:
        return angles + 1e-9 * acceleration(arm, angles, state["rates"], state["command"])

    return jax.lax.fori_loop(0, count, again, state["angles"])


def alone(checkout: Path, quick: bool) -> dict[str, float]:
    """Run `by_links` in a separate process, with the source of a checkout."""
    command = [sys.executable, "-m", "benchmarks.links", "here", *(["--quick"] if quick else [])]
    # Use one BLAS thread, like the command line. Two take twice as long for 160 links.
    environment = source_of(checkout) | {"OPENBLAS_NUM_THREADS": "1"}
    ended = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=environment)
    if ended.returncode:
        raise SystemExit(f"{checkout} ended with {ended.returncode}: {ended.stderr[-500:]}")
    return dict(json.loads(ended.stdout.splitlines()[-1]))


def measure(checkouts: dict[str, Path], quick: bool) -> dict[str, dict[str, float]]:
    """Measure the least time of each checkout by the number of links, us, in turns."""
    turns = [
        {name: alone(path, quick) for name, path in checkouts.items()}
        for _ in range(1 if quick else 3)
    ]
    return {
        name: {links: min(turn[name][links] for turn in turns) for links in turns[0][name]}
        for name in checkouts
    }


def main() -> int:
    """Measure, print and store; return exit status 1 if the limit is exceeded."""
    jax.config.update("jax_enable_x64", True)
    if sys.argv[1:2] == ["here"]:
        print(json.dumps(by_links("--quick" in sys.argv)))
        return 0
    paths = {"beside": "another checkout of giajax"}
    options = command_line(__doc__, RESULTS / "links.json", paths=paths)
    found = measure(checkouts_of(options.beside), options.quick)
    for links, taken in found["here"].items():
        other = found.get("beside", {}).get(links)
        ratio = "" if other is None else f", {taken / other:.2f} of the {other:.1f} of the other"
        print(f"{links} links: {taken:.1f} us{ratio}")
    store(found, options.out)
    if options.quick:
        return 0
    most = MOST_MICROSECONDS if options.beside is None else MOST_BESIDE * found["beside"][LONGEST]
    return int(not found["here"][LONGEST] <= most)


if __name__ == "__main__":
    sys.exit(main())
