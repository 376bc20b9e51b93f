"""The declaration of a quantity, once: for the model that computes with it and for files."""

import dataclasses
from collections.abc import Iterator

import numpy as np

from ._units import key_factor


@dataclasses.dataclass(frozen=True)
class Key:
    """How a file states a quantity.

    Attributes:
        name: of the key; it ends in its unit, which need not be the SI unit.
        lower, upper: what a file may state, SI, where that is less than the model computes with.
        closed: whether the value may be the bound itself, as an axial inertia may be zero.
        example: a value, in the key's unit, that shows more than the default does.
        remark: added to the sentence of what the value must be.
        place: of the quantity in the list of numbers, where several share the key: x, then y.
        meaning: of a key that several quantities share.
    """

    name: str
    _: dataclasses.KW_ONLY
    lower: float | None = None
    upper: float | None = None
    closed: bool = False
    example: float | list[float] | None = None
    remark: str = ""
    place: int | None = None
    meaning: str = ""


@dataclasses.dataclass(frozen=True)
class Declaration:
    """What a parameter says of itself.

    Attributes:
        default: the value of the preset `takeichi_20m` (each element, where it is an array), SI.
        unit: SI unit, in the spelling of the file formats; "" for a pure number.
        doc: one line of meaning.
        lower, upper: bounds, SI; a fit starts strictly between them, and may end on one.
        frozen: held at its value in a fit unless it is asked for by its path.
        assumed: the paper gives no number; this one is a guess that a fit should replace.
        optional: may be None, which leaves out its part of the model and the cost of it; its
            default is then the value that it is switched on with.
        neutral: of an optional one, the value with which its part changes nothing: the model
            then predicts what it does where the part is left out.
        shape: of a parameter that is an array of fixed shape, such as a vector.
        per: what an element of it belongs to: "link", "joint", "body"; "" where it belongs to
            the whole model.
        each: whether it may be one number for all links or joints, as well as an array with one
            for each; without it, a parameter per link is always an array.
        any_number: whether a model may have any number of its elements, with no count of its own.
        has_states: of an optional one, whether its part adds states to the motion; suspects are
            not asked for with those, and one of the model's `variants` has it.
        source: where the default is from, or the equation that the parameter stands in.
        key: how files state it; None: by its path alone.
        path: in a model, such as `links.mass`; "" for a parameter that is in no group.
    """

    default: float
    _: dataclasses.KW_ONLY
    unit: str
    doc: str
    lower: float = -np.inf
    upper: float = np.inf
    frozen: bool = True
    assumed: bool = False
    optional: bool = False
    neutral: float = 0.0
    shape: tuple[int, ...] = ()
    per: str = ""
    each: bool = False
    any_number: bool = False
    has_states: bool = False
    source: str = ""
    key: Key | None = None
    path: str = ""

    @property
    def meaning(self) -> str:
        """`doc`, and whether there may be several numbers."""
        several = f" (one number, or one per {self.per})" if self.each and self.per else ""
        return self.doc + several

    @property
    def factor(self) -> float:
        """How many SI units one unit of the key's value is; 1 without a key."""
        return 1.0 if self.key is None else key_factor(self.key.name, self.unit)


class Group:
    """The quantities of one module of a model, as class attributes of a subclass.

    Arguments:
        at: path of the module, such as `links`; "" for that of the model itself.

    The attributes of an instance know their paths; iterating over it gives them in their order.
    """

    def __init__(self, at: str) -> None:
        self._names = [name for name, d in vars(type(self)).items() if isinstance(d, Declaration)]
        for name in self._names:
            path = f"{at}.{name}" if at else name
            setattr(self, name, dataclasses.replace(getattr(type(self), name), path=path))

    def __iter__(self) -> Iterator[Declaration]:
        return (getattr(self, name) for name in self._names)
