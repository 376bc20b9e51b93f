from . import (
    arm as arm,
    hysteresis as hysteresis,
    inflation as inflation,
    joint as joint,
    obstacles as obstacles,
    unrolling as unrolling,
)
