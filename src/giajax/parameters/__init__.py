"""A parameter declares itself at its field; everything else is read from that declaration.

`parameter(...)` makes a field of an Equinox module that carries its default, unit, bounds and
meaning. `declared(model)` walks a model and lists its parameters by dotted path;
`get` and `replace` read and write them. Tables, help texts and reports are made from here.
"""

from ..quantities import Declaration as Declaration
from ._field import (
    declaration as declaration,
    held as held,
    inline as inline,
    parameter as parameter,
)
from ._find import elements as elements, find as find, get as get
from ._replace import (
    check_count as check_count,
    check_within_bounds as check_within_bounds,
    is_concrete as is_concrete,
    replace as replace,
    switched_on as switched_on,
)
from ._walk import (
    Parameter as Parameter,
    checked as checked,
    declared as declared,
    default_free as default_free,
    left_out as left_out,
)
