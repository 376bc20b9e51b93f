"""Questions that take many fits or derivatives of a model."""

from ._compare import compare as compare
from ._multi_start import (
    SAME_END as SAME_END,
    misfit as misfit,
    multi_start as multi_start,
)
