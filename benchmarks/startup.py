"""Time of `giajax --help` divided by the time of `import typer, rich`; the limit is 1.5.

The two commands run as separate processes in turns. The reported time is the least processor time,
which depends less on the load of the machine than wall time.

    python -m benchmarks.startup [--quick]
"""

import os
import subprocess
import sys

MOST = 1.5
_TWO = {
    "import typer, rich": "import typer, rich",
    "giajax --help": "from giajax.cli import main; main(['--help'])",
}


def seconds_of(code: str) -> float:
    """Return the processor time of a process that runs this Python code, s."""
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{code!r} ended with exit status {process.returncode}")
    return usage.ru_utime + usage.ru_stime


def main() -> int:
    """Measure and print; return exit status 1 if the ratio exceeds the limit."""
    rounds = 3 if "--quick" in sys.argv[1:] else 15
    for code in _TWO.values():
        seconds_of(code)  # fills the bytecode and disk caches
    taken: dict[str, list[float]] = {name: [] for name in _TWO}
    for _ in range(rounds):
        for name, code in _TWO.items():
            taken[name].append(seconds_of(code))
    least = {name: min(values) for name, values in taken.items()}
    for name, value in least.items():
        print(f"{name:20} {1e3 * value:6.0f} ms")
    ratio = least["giajax --help"] / least["import typer, rich"]
    print(f"{'ratio':20} {ratio:6.2f}, at most {MOST}")
    return int(ratio > MOST)


if __name__ == "__main__":
    sys.exit(main())
