"""One session, one precision: float64, strict promotion, every warning an error."""

import gc
import os
from pathlib import Path

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
