"""How a process of giajax's own uses JAX: in 64-bit, with compiled programs kept.

It is one of the command line, or a worker. Without JAX until it is configured.
"""

import os
from pathlib import Path

_MIN_COMPILE_SECONDS = 0.5

PROGRAMS = "programs"
"""Folder of the traced programs that are kept, within that of the compilation cache."""

_own_process = False


def own_process() -> None:
    """Say that this process is the command line's own, and nothing in it changes giajax."""
    global _own_process
    _own_process = True


def is_own_process() -> bool:
    """Whether `own_process` was said."""
    return _own_process


def configure() -> None:
    """Switch on 64-bit numbers, the persistent compilation cache, and programs that are kept.

    To be called before anything is computed. A library must not set either; a process that
    belongs to the command line, or works for another one, may. The cache is what
    `JAX_COMPILATION_CACHE_DIR` says, else `giajax` in the user's cache directory, where that can be
    written.
    """
    # Equinox reads this when it is imported. Its checks call back into Python, and JAX keeps no
    # program that does: the fit would be compiled anew in every process. A failed check becomes
    # a NaN instead, which every caller here looks for.
    os.environ.setdefault("EQX_ON_ERROR", "nan")
    # The matrices of an arm are too small for OpenBLAS to share out: its threads cost half of the
    # speed of one with 160 links. Where several cores compute, `_blas` sees to it.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    import jax

    jax.config.update("jax_enable_x64", True)
    directory, stated = compilation_cache()
    if directory is None:
        return
    # JAX itself may keep what it compiles at an address of a network.
    if _own_process and "://" not in os.environ.get("JAX_COMPILATION_CACHE_DIR", ""):
        from ._kept import keep_programs

        keep_programs(directory / PROGRAMS)
    if stated:
        return
    jax.config.update("jax_compilation_cache_dir", str(directory))
    # JAX's own threshold of a second leaves out most of what a short command compiles.
    if "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS" not in os.environ:
        jax.config.update("jax_persistent_cache_min_compile_time_secs", _MIN_COMPILE_SECONDS)


def compilation_cache() -> tuple[Path | None, bool]:
    """Where compiled programs are kept, if anywhere, and whether the user's environment says so."""
    stated = os.environ.get("JAX_COMPILATION_CACHE_DIR")
    if stated is None:
        return cache_directory(), False
    return (Path(stated) if stated else None), True


def cache_directory() -> Path | None:
    """The user's cache directory of giajax, made where it is missing; None where it cannot be."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    try:
        # A relative XDG_CACHE_HOME is to be ignored, by the XDG specification.
        parent = Path(base) if os.path.isabs(base) else Path.home() / ".cache"
        directory = parent / "giajax"
        directory.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):
        return None
    return directory if os.access(directory, os.W_OK | os.X_OK) else None
