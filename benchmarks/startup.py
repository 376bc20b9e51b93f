"""What `giajax --help` takes, over `import typer, rich`: at most 1.5 times.

Both are processes of their own that take turns, and the least of each counts: their processor
time, which another program beside them lengthens less than the time on the clock.

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
    """Processor time of a process that runs this Python, in seconds."""
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{code!r} ended with exit status {process.returncode}")
    return usage.ru_utime + usage.ru_stime


def main() -> int:
    """Measure, print, and say by the exit status whether it is fast enough."""
    rounds = 3 if "--quick" in sys.argv[1:] else 15
    for code in _TWO.values():
        seconds_of(code)  # so that both are compiled to bytecode and read from the disk's cache
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
