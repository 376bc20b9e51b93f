"""How commands use JAX: as their workers do, too, which know nothing of the command line."""

from .._process import (
    PROGRAMS as PROGRAMS,
    cache_directory as cache_directory,
    compilation_cache as compilation_cache,
    configure as configure,
    own_process as own_process,
)
