"""What every section of the TOML vocabulary is made of."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

from pydantic import BaseModel, ConfigDict, Field

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Vector = Annotated[list[Finite], Field(min_length=3, max_length=3)]
Name = Annotated[str, Field(min_length=1)]
Count = Annotated[int, Field(ge=1)]


def key(
    must: str, meaning: str, *, preset: Any = None, default: Any = None, example: Any = None
) -> Any:
    """Declare a key once: what it must be (errors), what it means (`giajax init`).

    `preset` is its value where a file does not state it, for the template of a sidecar; `example`
    is what the template shows where there is none.
    """
    extra = {"must": must, "preset": preset, "example": preset if example is None else example}
    return Field(default=default, description=meaning, json_schema_extra=extra)


class Section(BaseModel):
    """A section whose keys are declared by `key`, and that takes no others."""

    # Strict: "0.3" and true are not numbers here. An int where a float is meant is one.
    model_config: ClassVar[ConfigDict] = ConfigDict(extra="forbid", strict=True, frozen=True)

    def given(self) -> dict[str, Any]:
        """The keys that were given, with their values."""
        return self.model_dump(exclude_unset=True)


def flat(table: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Nested tables as one, its keys joined by points."""
    found: dict[str, Any] = {}
    for name, value in table.items():
        if isinstance(value, Mapping):
            found.update(flat(value, f"{before}{name}."))
        else:
            found[f"{before}{name}"] = value
    return found
