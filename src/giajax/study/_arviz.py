"""Draws as ArviZ takes them, whose two generations are filled differently."""

import importlib
import warnings
from collections.abc import Mapping
from types import ModuleType
from typing import Any

import numpy as np

from .._errors import InputError

_MISSING = 'ArviZ is not installed, which takes the draws: pip install "giajax[posterior]"'


def as_arviz(
    posterior: Mapping[str, np.ndarray],
    statistics: Mapping[str, np.ndarray],
    package: ModuleType | None = None,
) -> Any:
    """Draws as `InferenceData` of ArviZ 0, or as `DataTree` of ArviZ 1 and of `arviz_base`.

    Arguments:
        posterior: draws by name, each of shape (chain, draw).
        statistics: of the sampler, likewise.
        package: that makes it; the ArviZ that is installed by default.

    Raises:
        InputError: ArviZ is not installed.
    """
    package = _arviz() if package is None else package
    groups = {"posterior": dict(posterior), "sample_stats": dict(statistics)}
    if package.__name__ == "arviz" and package.__version__.startswith("0."):
        return package.from_dict(**groups)
    return package.from_dict(groups)


def _arviz() -> ModuleType:
    try:
        with warnings.catch_warnings():
            # Once a day it announces its next generation.
            warnings.simplefilter("ignore")
            return importlib.import_module("arviz")
    except ImportError:
        raise InputError(_MISSING) from None
