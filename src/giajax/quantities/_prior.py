"""What is known of a parameter before a fit."""

import dataclasses
import math

from .._errors import InputError


@dataclasses.dataclass(frozen=True)
class Prior:
    """What is known of a parameter before a fit: about where it is, and how surely.

    With a `deviation` the knowledge is normal, with a `factor` log-normal: the logarithm of the
    parameter is normal, and its standard deviation is that of the factor.

    Arguments:
        value: the most probable value; of a log-normal prior the median. SI.
        deviation: standard deviation, SI.
        factor: the value is known to so much, one standard deviation up or down: 1.2 is 20 %.

    Raises:
        InputError: neither or both of the last two, or a number that they may not be.

    Example:
        >>> import giajax
        >>> drag = giajax.Prior(1.1, deviation=0.2)
        >>> mass = giajax.Prior(0.05, factor=1.5)  # one sigma: between 0.033 and 0.075
    """

    value: float
    deviation: float | None = None
    factor: float | None = None

    def __post_init__(self) -> None:
        if not math.isfinite(self.value):
            raise InputError(f"the prior has the value {self.value}: give a finite number")
        if (self.deviation is None) == (self.factor is None):
            raise InputError(
                "the prior must have a deviation, or a factor if it is log-normal: give one of them"
            )
        if self.deviation is not None and not 0 < self.deviation < math.inf:
            raise InputError(
                f"the prior has the deviation {self.deviation:g}: give a positive number"
            )
        if self.factor is not None and not 1 < self.factor < math.inf:
            raise InputError(
                f"the prior has the factor {self.factor:g}: give a number above 1, such as 1.2 "
                "for 20 percent"
            )
        if self.factor is not None and self.value <= 0:
            raise InputError(
                f"the prior has a factor and the value {self.value:g}: give a positive value, or "
                "a deviation"
            )

    @property
    def logarithmic(self) -> bool:
        """Whether the logarithm of the parameter is normal."""
        return self.factor is not None

    @property
    def centre(self) -> float:
        """Mean of the parameter, or of its logarithm."""
        return math.log(self.value) if self.logarithmic else self.value

    @property
    def spread(self) -> float:
        """Standard deviation of the parameter, or of its logarithm."""
        if self.factor is not None:
            return math.log(self.factor)
        assert self.deviation is not None
        return self.deviation

    def contents(self) -> dict[str, float]:
        """What a file says of it."""
        known = dataclasses.asdict(self)
        return {name: value for name, value in known.items() if value is not None}
