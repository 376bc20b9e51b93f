"""Operators of hysteresis, the oscillator, and what a loop has beside its operator."""

from ._declaration import Declaration, Group


class _Play(Group):
    thresholds = Declaration(0.0, unit="input", lower=0, doc="half-width of the backlash")


class _Stop(Group):
    thresholds = Declaration(
        1.0, unit="input", lower=0, doc="input at which the element begins to slide"
    )


class _PrandtlIshlinskii(Group):
    elastic = Declaration(
        1.0, unit="output/input", lower=0, frozen=False, doc="weight of the input itself"
    )
    weights = Declaration(
        0.1, unit="output/input", lower=0, frozen=False, doc="weights of the plays or stops"
    )
    thresholds = Declaration(1.0, unit="input", lower=0, doc="thresholds of the plays or stops")


class _DeadZones(Group):
    slope = Declaration(
        1.0, unit="output/input", lower=0, frozen=False, doc="slope between the dead zones"
    )
    upper_thresholds = Declaration(1.0, unit="input", lower=0, doc="dead zones above 0")
    upper_slopes = Declaration(
        1.0, unit="output/input", lower=0, frozen=False, doc="slope beyond each dead zone above 0"
    )
    lower_thresholds = Declaration(
        1.0, unit="input", lower=0, doc="dead zones below 0, as distances from it"
    )
    lower_slopes = Declaration(
        1.0, unit="output/input", lower=0, frozen=False, doc="slope beyond each dead zone below 0"
    )


class _ModifiedPrandtlIshlinskii(Group):
    weights = Declaration(
        0.1, unit="", lower=0, frozen=False, doc="weights of the plays, relative to the input"
    )
    thresholds = Declaration(1.0, unit="input", lower=0, doc="thresholds of the plays")


class _Preisach(Group):
    slope = Declaration(0.5, unit="output/input", frozen=False, doc="reversible part of the output")
    saturation = Declaration(
        0.5, unit="output", lower=0, frozen=False, doc="output of all relays up"
    )
    coercivity = Declaration(
        0.2, unit="input", lower=0, frozen=False, doc="median half-width of the relays"
    )
    coercivity_spread = Declaration(
        0.7, unit="", lower=0.05, upper=5, frozen=False, doc="spread of the logarithm of it"
    )
    bias = Declaration(0.0, unit="input", doc="mean centre of the relays")
    interaction = Declaration(
        0.3, unit="input", lower=0, frozen=False, doc="standard deviation of the centres"
    )


class _BoucWen(Group):
    elastic = Declaration(
        0.5, unit="output/input", lower=0, frozen=False, doc="weight of the input itself"
    )
    alpha = Declaration(
        0.5, unit="output/input", lower=0, frozen=False, doc="slope of the hysteretic part at 0"
    )
    beta = Declaration(
        1.0, unit="1/input", lower=0, doc="scale of gamma and delta; only their products count"
    )
    gamma = Declaration(1.0, unit="", lower=0, frozen=False, doc="width of the loop")
    delta = Declaration(0.1, unit="", frozen=False, doc="shape of the loop")
    nu = Declaration(1.0, unit="", lower=0.5, upper=20, doc="sharpness of the knee")


class _Branches(Group):
    travel = Declaration(1.0, unit="output", lower=0, doc="travel from one branch to the other")


class _BoucWenOscillator(Group):
    mass = Declaration(2.0, unit="kg", lower=0, frozen=False, doc="moving mass")
    damping = Declaration(10.0, unit="N s/m", lower=0, frozen=False, doc="viscous damping")
    stiffness = Declaration(
        5e4, unit="N/m", lower=0, frozen=False, doc="stiffness beside the hysteretic element"
    )
    alpha = Declaration(
        5e4, unit="N/m", lower=0, frozen=False, doc="stiffness of the hysteretic element at rest"
    )
    beta = Declaration(
        1e3, unit="1/m", lower=0, doc="scale of gamma and delta; only their products count"
    )
    gamma = Declaration(0.8, unit="", lower=0, frozen=False, doc="width of the loop")
    delta = Declaration(-1.1, unit="", frozen=False, doc="shape of the loop")
    nu = Declaration(1.0, unit="", lower=0.5, upper=20, doc="sharpness of the knee")


class _Loop(Group):
    offset = Declaration(0.0, unit="output", frozen=False, doc="added to the output")
    previous_extremes = Declaration(
        0.0, unit="input", doc="turning points of the input before the run, the latest last"
    )


PLAY = _Play("")
STOP = _Stop("")
PRANDTL_ISHLINSKII = _PrandtlIshlinskii("")
DEAD_ZONES = _DeadZones("dead_zones")
MODIFIED_PRANDTL_ISHLINSKII = _ModifiedPrandtlIshlinskii("")
PREISACH = _Preisach("")
BOUC_WEN = _BoucWen("")
BRANCH_COMPENSATOR = _Branches("")
BOUC_WEN_OSCILLATOR = _BoucWenOscillator("")
LOOP = _Loop("")
