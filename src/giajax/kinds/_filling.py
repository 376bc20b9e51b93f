"""The section that says how an arm of balloons is filled."""

from typing import Annotated, Literal

from pydantic import Field

from ..quantities import GAS, PORTS, SKIN, SUPPLY
from ._keys import with_keys
from ._section import Count, Section, key


@with_keys(SUPPLY, PORTS, GAS, SKIN)
class FillingSection(Section):
    """`[filling]`: gas, bags, the ports between them and the supply. `giajax fill` reads it."""

    supply: Literal["flow", "regulator", "bottle"] | None = key(
        '"flow", "regulator" or "bottle"',
        "a flow meter, or a regulator or a bottle behind a restriction",
        preset="flow",
    )
    shared: list[Annotated[list[Count], Field(min_length=2)]] | None = key(
        "a list of lists of link numbers",
        "neighbouring links that are not welded apart, and share their gas",
        example=[[1, 2], [3, 4]],
    )
