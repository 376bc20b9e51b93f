"""Every quantity that a model of giajax has a parameter for, declared once. Imports no JAX.

A declaration says path, unit, default, bounds, meaning and source of a parameter, and the key of
the files that state it. The field of the model, the keys of its section, their checks, templates,
tables and conversions are made from it: a parameter is its declaration here, and the file that
computes with it.
"""

from ._air import AIR as AIR, BUOYANCY as BUOYANCY
from ._cameras import LANDMARK as LANDMARK, PINHOLE as PINHOLE
from ._contact import CONTACT as CONTACT
from ._declaration import Declaration as Declaration, Group as Group, Key as Key
from ._expression import Expression as Expression
from ._filling import GAS as GAS, PORTS as PORTS, SKIN as SKIN, SUPPLY as SUPPLY
from ._hysteresis import (
    BOUC_WEN as BOUC_WEN,
    BOUC_WEN_OSCILLATOR as BOUC_WEN_OSCILLATOR,
    BRANCH_COMPENSATOR as BRANCH_COMPENSATOR,
    DEAD_ZONES as DEAD_ZONES,
    LOOP as LOOP,
    MODIFIED_PRANDTL_ISHLINSKII as MODIFIED_PRANDTL_ISHLINSKII,
    PLAY as PLAY,
    PRANDTL_ISHLINSKII as PRANDTL_ISHLINSKII,
    PREISACH as PREISACH,
    STOP as STOP,
)
from ._joints import (
    INITIAL as INITIAL,
    JOINT_MEMORY as JOINT_MEMORY,
    JOINT_STOPS as JOINT_STOPS,
    JOINTS as JOINTS,
)
from ._links import BASE as BASE, LINKS as LINKS, POINT_MASSES as POINT_MASSES
from ._muscle import (
    AT_REST as AT_REST,
    BRAIDED as BRAIDED,
    EMPIRICAL as EMPIRICAL,
    FRICTION as FRICTION,
    PISTON as PISTON,
)
from ._pneumatic_joint import (
    ALPHA as ALPHA,
    BETA as BETA,
    DRIVE as DRIVE,
    GEOMETRY as GEOMETRY,
    LOAD as LOAD,
)
from ._prior import Prior as Prior
from ._sensors import CAMERA as CAMERA, ENCODER as ENCODER, MARKER as MARKER
from ._units import (
    QUANTITIES as QUANTITIES,
    QUANTITY_OF_SUFFIX as QUANTITY_OF_SUFFIX,
    Quantity as Quantity,
    key_factor as key_factor,
    si_factor as si_factor,
)
