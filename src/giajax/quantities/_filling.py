"""Helium, bags, ports and supply: how an arm of balloons is filled."""

from ._air import BUOYANCY
from ._declaration import Declaration, Group, Key


class _Gas(Group):
    density = Declaration(
        BUOYANCY.helium_density.default,
        unit="kg/m^3",
        lower=0,
        doc="density of the gas at ambient pressure (helium, 20 C, 1 atm)",
        key=Key("gas_density_kg_per_m3"),
    )
    ambient_pressure = Declaration(
        101325.0,
        unit="Pa",
        lower=0,
        doc="absolute pressure of the room",
        key=Key("ambient_pressure_kPa"),
    )
    viscosity = Declaration(
        1.96e-5,
        unit="Pa s",
        lower=0,
        doc="dynamic viscosity of the gas (helium, 20 C)",
        key=Key("gas_viscosity_Pa_s"),
    )
    heat_capacity_ratio = Declaration(
        5 / 3,
        unit="",
        lower=1,
        upper=2,
        doc="ratio of the gas's heat capacities (5/3 of one atom)",
        key=Key("gas_heat_capacity_ratio"),
    )


class _Skin(Group):
    stiffness = Declaration(
        1e4,
        unit="N/m",
        lower=0,
        assumed=True,
        doc="modulus times thickness of the skin (polyethylene of 200 MPa and 50 um)",
        key=Key("skin_stiffness_N_per_m"),
    )
    poisson_ratio = Declaration(
        0.45,
        unit="",
        lower=-1,
        upper=0.5,
        assumed=True,
        doc="Poisson's ratio of the skin",
        key=Key("skin_poisson_ratio"),
    )
    slack = Declaration(
        1e-3,
        unit="",
        lower=0,
        upper=0.1,
        assumed=True,
        doc="share of its volume over which a bag passes from limp to tight",
        key=Key("skin_slack"),
    )


class _Ports(Group):
    diameter = Declaration(
        0.01,
        unit="m",
        lower=0,
        per="port",
        each=True,
        assumed=True,
        doc="diameter of the port between two bags",
        key=Key("port_diameter_mm"),
    )
    length = Declaration(
        0.005,
        unit="m",
        lower=0,
        per="port",
        each=True,
        assumed=True,
        doc="length of the port between two bags",
        key=Key("port_length_mm"),
    )
    discharge_coefficient = Declaration(
        0.61,
        unit="",
        lower=0,
        upper=1,
        assumed=True,
        doc="discharge coefficient of a port (sharp edges)",
        key=Key("port_discharge_coefficient"),
    )


class _Supply(Group):
    flow = Declaration(
        61e-3 / 60,
        unit="m^3/s",
        lower=0,
        doc="flow of a flow meter, as volume at ambient pressure",
        source="IV.B: 1.40 m^3 in 23 min",
        key=Key("supply_flow_l_per_min"),
    )
    pressure = Declaration(
        2e5,
        unit="Pa",
        lower=0,
        assumed=True,
        doc="pressure that a regulator holds, above that of the room",
        key=Key("supply_pressure_bar"),
    )
    bottle_volume = Declaration(
        0.01,
        unit="m^3",
        lower=0,
        assumed=True,
        doc="volume of a bottle",
        key=Key("bottle_volume_l"),
    )
    bottle_pressure = Declaration(
        200e5,
        unit="Pa",
        lower=0,
        assumed=True,
        doc="pressure of a full bottle, above that of the room",
        key=Key("bottle_pressure_bar"),
    )
    nozzle_diameter = Declaration(
        0.001,
        unit="m",
        lower=0,
        assumed=True,
        doc="diameter of the restriction behind a regulator or bottle",
        key=Key("nozzle_diameter_mm"),
    )
    nozzle_length = Declaration(
        0.001,
        unit="m",
        lower=0,
        assumed=True,
        doc="length of that restriction",
        key=Key("nozzle_length_mm"),
    )
    nozzle_coefficient = Declaration(
        0.8,
        unit="",
        lower=0,
        upper=1,
        assumed=True,
        doc="discharge coefficient of that restriction",
        key=Key("nozzle_discharge_coefficient"),
    )


GAS = _Gas("gas")
SKIN = _Skin("skin")
PORTS = _Ports("ports")
SUPPLY = _Supply("supply")
