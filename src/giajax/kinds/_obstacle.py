"""The section of an obstacle."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from ._section import Name, Positive, Section, Vector, key

_TWO = Annotated[list[Positive], Field(min_length=2, max_length=2)]
_THREE = Annotated[list[Positive], Field(min_length=3, max_length=3)]
_FOUR = Annotated[list[Positive], Field(min_length=4, max_length=4)]

# The keys that each shape has beside its name and its centre; those that it needs come first.
SHAPES = {
    "box": (("size_m",), ("rotation_deg",)),
    "plane": (("normal",), ()),
    "wall": (("opening_m", "margins_m", "thickness_m"), ("rotation_deg",)),
}


class Obstacle(Section):
    """An entry of `[[arm.obstacles]]`: something rigid that links may touch."""

    shape: Literal["box", "plane", "wall"] = key(
        '"box", "plane" or "wall"', "a box, a half space, or a wall with an opening", default=...
    )
    name: Name = key("a name", "what results call it", default=...)
    centre_m: Vector = key(
        "a list of three numbers",
        "centre of a box or of an opening, or a point of a plane",
        default=...,
    )
    size_m: _THREE | None = key("three positive numbers", "size of a box along x, y and z")
    normal: Vector | None = key("a list of three numbers", "of a plane, away from its solid side")
    opening_m: _TWO | None = key("two positive numbers", "width and height of an opening")
    margins_m: _FOUR | None = key(
        "four positive numbers", "wall to the right of, below, to the left of and above an opening"
    )
    thickness_m: Positive | None = key("a positive number", "thickness of a wall")
    rotation_deg: Vector | None = key(
        "a list of three numbers", "turn against the base frame, as a rotation vector"
    )

    @model_validator(mode="after")
    def _keys_are_those_of_its_shape(self) -> "Obstacle":
        needed, allowed = SHAPES[self.shape]
        for name in needed:
            if getattr(self, name) is None:
                raise ValueError(f"the {self.shape} '{self.name}' has no {name}: add it")
        every = {name for keys in SHAPES.values() for part in keys for name in part}
        for name in sorted(every - {*needed, *allowed}):
            if getattr(self, name) is not None:
                raise ValueError(
                    f"the {self.shape} '{self.name}' has {name}, which is of another shape: "
                    "remove it"
                )
        if self.normal == [0.0, 0.0, 0.0]:
            raise ValueError(f"the normal of '{self.name}' has no direction: correct it")
        return self


def check_names(obstacles: list[Obstacle]) -> None:
    """Raise `ValueError` for two obstacles of a name."""
    names = [obstacle.name for obstacle in obstacles]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise ValueError(f"has two called '{twice}': give each its own name")
