"""One thread for each call of BLAS and LAPACK while threads of giajax's own have the cores.

The matrices of an arm are too small to be shared out. Where two threads try, OpenBLAS lets them
wait for each other: an evaluation of 160 links then takes a hundred times as long.
"""

import contextlib
import functools
import threading
from collections.abc import Iterator
from typing import Any

_lock = threading.Lock()
_users = 0
_limit: Any = None


@contextlib.contextmanager
def one_blas_thread() -> Iterator[None]:
    """BLAS computes in the thread that calls it, until the last of those who ask for it is done."""
    global _users, _limit
    with _lock:
        if not _users:
            _limit = _libraries().limit(limits=1, user_api="blas")
        _users += 1
    try:
        yield
    finally:
        with _lock:
            _users -= 1
            if not _users:
                _limit.restore_original_limits()


@functools.cache
def _libraries() -> Any:
    """The libraries that are loaded, found once."""
    # JAX calls the LAPACK of SciPy, and loads it only with the first program that does.
    import scipy.linalg  # noqa: F401
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
