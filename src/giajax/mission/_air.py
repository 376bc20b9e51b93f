"""The air of a mission: a mean flow and gusts along the arm, of a speed."""

import jax.numpy as jnp
import numpy as np

from .._typing import Float
from ..arm import Arm, link_centres
from ..kinds import MissionSection
from ..synthetic import gusts

# Between two rows of the gusts, s; the wind is linear between them.
_INTERVAL = 1.0


def air(
    section: MissionSection, arm: Arm, times: Float[np.ndarray, " row"], seed: list[int]
) -> Float[np.ndarray, "row width"]:
    """Velocity of the air at each link, m/s, shape (row, 3 link).

    A level mean flow in a direction that is drawn, and about it gusts that are coherent along the
    arm where it is straight, so strong that the root mean square of the velocity is the speed.

    Arguments:
        section: the `[mission]`.
        arm: the arm.
        times: s.
        seed: of the random numbers.
    """
    wind, width = section.wind, 3 * arm.count
    if wind.speed_m_per_s == 0:
        return np.zeros((len(times), width))
    random = np.random.default_rng(seed)
    turn = random.uniform(0, 2 * np.pi)
    mean = wind.mean * wind.speed_m_per_s
    if wind.mean == 1:
        steady = mean * np.array([np.cos(turn), np.sin(turn), 0.0])
        return np.tile(steady, (len(times), arm.count))
    drive = gusts(
        [mean * np.cos(turn), mean * np.sin(turn), 0.0],
        intensity=np.sqrt((1 / wind.mean**2 - 1) / 3),
        length_scale=wind.length_scale_m,
        duration=times[-1] + _INTERVAL,
        interval=_INTERVAL,
        seed=int(random.integers(2**31)),
        places=np.asarray(link_centres(arm, jnp.zeros(arm.count))),
    )
    values = drive.at(times)
    names = [f"link{link:02d}_wind_{axis}" for link in range(1, arm.count + 1) for axis in "xyz"]
    return np.stack([values[name] for name in names], axis=1)
