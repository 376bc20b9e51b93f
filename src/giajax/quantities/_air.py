"""The air around an arm, and what floats in it."""

from ._declaration import Declaration, Group, Key
from ._links import LINKS


class _Air(Group):
    density = Declaration(
        1.204,
        unit="kg/m^3",
        lower=0,
        doc="density of the air (20 C, 1 atm)",
        source="eq. (1)",
        key=Key("air_density_kg_per_m3", closed=True),
    )
    drag_coefficient = Declaration(
        1.2,
        unit="",
        lower=0,
        upper=50,
        frozen=False,
        assumed=True,
        doc="drag coefficient C_D of eq. (1), referred to length times diameter",
        source="eq. (1)",
    )
    axial_coefficient = Declaration(
        0.02,
        unit="",
        lower=0,
        upper=50,
        optional=True,
        assumed=True,
        doc="coefficient of the drag along a link, referred to length times diameter (strip drag)",
    )
    added_mass_coefficient = Declaration(
        1.0,
        unit="",
        lower=0,
        upper=10,
        optional=True,
        doc="added mass across a link over the air that it displaces (1 for a long cylinder)",
    )
    wind = Declaration(
        0.0,
        unit="m/s",
        shape=(3,),
        optional=True,
        doc="constant velocity of the air in the base frame, beside the wind of the run",
    )
    viscosity = Declaration(
        1.516e-5, unit="m^2/s", lower=0, doc="kinematic viscosity of the air (20 C, 1 atm)"
    )


class _Buoyancy(Group):
    helium_density = Declaration(
        0.1664, unit="kg/m^3", lower=0, doc="density of the helium (20 C, 1 atm)"
    )
    trim_mass = Declaration(
        0.0, unit="kg", lower=0, per="link", each=True, doc="trim weight of a link"
    )
    trim_position = Declaration(
        LINKS.length.default / 2,
        unit="m",
        per="link",
        each=True,
        assumed=True,
        doc="distance of the trim weight from the link's joint, along the link",
    )
    trim_depth = Declaration(
        0.15,
        unit="m",
        per="link",
        each=True,
        optional=True,
        doc="distance of the trim weight below the link's axis, in the straight arm",
    )
    imbalance = Declaration(
        0.0,
        unit="N",
        per="link",
        each=True,
        optional=True,
        doc="lift that is left over on a link, negative where it is weight",
    )


AIR = _Air("air")
BUOYANCY = _Buoyancy("buoyancy")
