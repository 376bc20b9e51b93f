"""The section of a body that is fixed to a link."""

from typing import Annotated

from pydantic import Field

from .._limits import LINKS as MOST_LINKS
from ..quantities import POINT_MASSES
from ._keys import with_keys
from ._section import Section, key


@with_keys(POINT_MASSES, required=True)
class PointMass(Section):
    """An entry of `[[arm.point_masses]]`: a small body fixed to a link."""

    link: Annotated[int, Field(ge=1, le=MOST_LINKS)] = key(
        f"a whole number from 1 to {MOST_LINKS}", "link that carries it", default=...
    )
