"""One session, one precision: float64, strict promotion, every warning an error."""

import gc
import os
from importlib.metadata import version
from pathlib import Path

# Programs that the tests compile by themselves get the options that `giajax.program` sets: half
# of the time of compiling. XLA ends the process at a name that it does not know, and names change
# with its versions.
if version("jaxlib").startswith("0.10."):
    from giajax._program import CPU_OPTIONS

    flags = [
        f"--{name}={str(value).lower() if isinstance(value, bool) else value}"
        for name, value in CPU_OPTIONS.items()
    ]
    os.environ.setdefault("XLA_FLAGS", " ".join(flags))

import jax
import pytest
from jaxtyping import install_import_hook

ROOT = Path(__file__).resolve().parents[1]

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")
# Compiling is most of the time of these tests: keep what was compiled for the next session.
CACHE = os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(ROOT / ".jax_cache"))
jax.config.update("jax_compilation_cache_dir", CACHE)
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)

with install_import_hook("giajax", "beartype.beartype"):
    import giajax  # noqa: F401

# Every compiled program maps memory, and a process may have 65,530 maps: beyond them the compiler
# dies, after a thousand tests.
MAPS = Path("/proc/self/maps")
MOST_MAPS = 8_000


@pytest.fixture(autouse=True, scope="module")
def few_programs_at_a_time():
    """Forget the compiled programs of a long session, which the cache on disk keeps."""
    yield
    if MAPS.exists() and MAPS.read_bytes().count(b"\n") > MOST_MAPS:
        jax.clear_caches()
        gc.collect()
