"""One session, one precision: float64, strict promotion, every warning an error."""

import os
from pathlib import Path

import jax
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
