from . import (
    control as control,
    design as design,
    driving as driving,
    experiments as experiments,
    filling as filling,
    joint as joint,
    mission as mission,
    mjcf as mjcf,
    paper as paper,
    synthetic as synthetic,
    viewer as viewer,
    wind as wind,
)
