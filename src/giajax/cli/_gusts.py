"""The option --gusts as a wind. JAX is imported where it is needed only."""

import math
import re
from typing import TYPE_CHECKING, Any

from .._errors import InputError
from ._values import NUMBER

if TYPE_CHECKING:
    from ..arm import Arm
    from ..runs import Definition, Run
    from ..synthetic import Drive

_GUSTS = re.compile(rf"(?P<intensity>{NUMBER}(?:,{NUMBER},{NUMBER})?):(?P<length>{NUMBER})")


def gusts_of(
    text: str,
    definition: "Definition",
    replayed: "Run | None",
    arm: "Arm",
    *,
    coherence: float | None,
    rate: float,
    **sampling: Any,
) -> tuple["Drive", str]:
    """The wind of --gusts about the constant one, and what of its variance is left out.

    With --coherence it is that of each link, in the places of the straight arm. `sampling` is as
    of `giajax.gusts`.
    """
    import jax.numpy as jnp
    import numpy as np

    from ..arm import link_centres
    from ..kinds import WindSection
    from ..synthetic import gusts, gusts_left_out

    parts, length_scale = gust_numbers(text)
    source = definition if replayed is None else replayed.definition
    mean = source.section(WindSection).velocity_m_per_s
    if replayed is not None and replayed.winds:
        raise InputError(f"'{replayed.name}' has recorded a wind: leave --gusts out")
    if mean is None:
        raise InputError(
            "--gusts are about a constant wind, and none is there: give it by --wind X,Y,Z"
        )
    if coherence is not None and not 0 <= coherence < math.inf:
        raise InputError(f"--coherence is {coherence:g}: give a decay of at least 0, such as 12")
    intensity = parts if len(parts) == 3 else parts[0]
    sampling |= {"interval": 1 / rate if rate else 0.0, "length_scale": length_scale}
    if coherence is not None:
        sampling |= {"places": np.asarray(link_centres(arm, jnp.zeros(arm.count)))}
        sampling |= {"decay": coherence}
    wind = gusts(mean, intensity=intensity, **sampling)
    scales = {key: sampling[key] for key in ("length_scale", "interval")}
    along, across = gusts_left_out(math.hypot(*mean), **scales)
    # Of a direction without gusts nothing is left out.
    shares = [f"{along:.1%} along"] * (parts[0] > 0) + [f"{across:.1%} across"] * any(parts[-2:])
    return wind, (
        f"gusts quicker than {4 * scales['interval']:g} s are left out, of the variance: "
        f"{', '.join(shares)} the mean wind"
    )


def gust_numbers(text: str) -> tuple[list[float], float]:
    """Intensity, one number or three, and length scale (m) of --gusts.

    Raises:
        InputError: it is written otherwise.
    """
    match = _GUSTS.fullmatch(text.replace(" ", ""))
    if match is None:
        raise InputError(
            f"--gusts is {text!r}: give the intensity, or three of them, and the length scale in "
            "m, such as 0.3:5 or 0.3,0.2,0.1:5"
        )
    return [float(part) for part in match["intensity"].split(",")], float(match["length"])
