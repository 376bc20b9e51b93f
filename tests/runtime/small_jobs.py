"""Functions for tasks: they are quick, and every process finds them by name."""

import os
import signal
import time
from pathlib import Path

import numpy as np

from giajax import InputError
from giajax.runtime.process import is_stopped


def double(number):
    return 2 * number


def refuses(number):
    if number % 2:
        raise InputError(f"{number} is odd: give an even number")
    return number


def divides(number):
    return 1 / number


def draws(seed, number):
    return [seed, number]


def notes(number, folder):
    """Leave a file for each call, and return the process that made it."""
    with (Path(folder) / f"{number}.calls").open("a") as file:
        file.write("x")
    return os.getpid()


def dies_at(number, bad, folder):
    """End the process at the bad number, like a system without memory; record the others."""
    if number == bad:
        os._exit(9)
    notes(number, folder)
    return number


def waits_for_a_stop(number):
    while number and not is_stopped():
        time.sleep(0.01)
    return number


def settings():
    """Return the settings of the computations of a worker."""
    import jax

    return {
        "wide": bool(jax.config.jax_enable_x64),
        "cores": os.environ.get("GIAJAX_CORES"),
        "cache": str(jax.config.jax_compilation_cache_dir),
        "minds_ctrl_c": signal.getsignal(signal.SIGINT) is not signal.SIG_IGN,
    }


def mixed():
    return {1: (np.arange(2), np.float32(0.5)), "path": Path("a"), "nan": float("nan")}


def interrupts(number, at):
    if number == at:
        raise KeyboardInterrupt
    return number


def sleeps(seconds):
    time.sleep(seconds)
    return seconds
