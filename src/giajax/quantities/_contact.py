"""How inflated links press against what stands around them."""

import numpy as np

from ._declaration import Declaration, Group, Key


class _Contact(Group):
    pressure = Declaration(
        1000.0,
        unit="Pa",
        lower=0,
        per="link",
        each=True,
        assumed=True,
        doc="gauge pressure in a link, which presses where it is flattened",
        key=Key("contact_pressure_kPa"),
    )
    shape_factor = Declaration(
        np.pi,
        unit="",
        lower=0,
        doc="force of a flattened link over pressure, length and penetration: pi between two "
        "plates, 4 pi / 3 at one wall against the weight of the skin",
        key=Key("contact_shape_factor"),
    )
    damping = Declaration(
        0.5,
        unit="s/m",
        lower=0,
        assumed=True,
        doc="by how much a contact presses harder while it closes, over the closing speed",
        key=Key("contact_damping_s_per_m", closed=True),
    )
    friction = Declaration(
        0.3,
        unit="",
        lower=0,
        assumed=True,
        optional=True,
        has_states=True,
        doc="coefficient of friction between links and obstacles",
        key=Key("contact_friction"),
    )
    friction_stiffness = Declaration(
        300.0,
        unit="N/m",
        lower=0,
        assumed=True,
        doc="stiffness of a link's skin along a surface that it sticks to",
        key=Key("contact_friction_stiffness_N_per_m"),
    )


CONTACT = _Contact("contact")
