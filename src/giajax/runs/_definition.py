"""The one TOML vocabulary of sidecars, fit definitions and a user's own arm."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

from pydantic import Field, ValidationError, create_model, field_validator

from .._errors import InputError
from .._files import read_bytes
from .._limits import TEXT_BYTES
from .._syntax import check_size, parse_toml
from .._text import one_of
from ..kinds import KINDS, FillingSection, MissionSection, Name, Section, key
from ._complaints import complaint, plain
from ._fit_sections import Figure, Fit, Noise
from ._toml import to_toml

S = TypeVar("S", bound=Section)

_QUOTED = [f'"{name}"' for name in KINDS]

if TYPE_CHECKING:
    KindName = str
else:
    KindName = Literal[*KINDS]


class _Head(Section):
    """The keys at the top of a file."""

    schema_version: Literal[1] = key("1", "version of this vocabulary", default=1)
    model: KindName | None = key(
        one_of(_QUOTED), "which model the run is of", example=next(iter(KINDS))
    )
    origin: str | None = key(
        "text", "where the run comes from", example="who recorded this, with what, when"
    )
    licence: str | None = key("text", "terms under which it may be used", example="CC0-1.0")
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")] | None = key(
        "64 hexadecimal digits", "checksum of the data file"
    )
    free_motion: bool | None = key(
        "true or false", "true: the arm moves without commands", example=True
    )


_CLASSES = {name: section for kind in KINDS.values() for name, section in kind.all_sections.items()}
_NAMES = {section: name for name, section in _CLASSES.items()}

if TYPE_CHECKING:

    class _Sections(_Head):
        """The sections of the kinds of models, as fields."""

else:
    _Sections = create_model(
        "_Sections",
        __base__=_Head,
        **{name: (section, Field(default_factory=section)) for name, section in _CLASSES.items()},
    )


class Definition(_Sections):
    """A sidecar, a fit definition or a user's own arm. Every section and key is optional.

    A section that is not in the file is there with its defaults, so
    `definition.section(ArmSection).links` is always legal; `definition.contents()` has only what
    the file has. Each kind of model brings its sections.
    """

    noise: Noise = Field(default_factory=Noise)
    truth: dict[str, Any] = key(
        "a table", "what the maker of the data knows; never read by a fit", default={}
    )
    fit: Fit = Field(default_factory=Fit)
    filling: FillingSection = Field(default_factory=FillingSection)
    mission: MissionSection | None = key("a table of keys", "what an operator is to reach")
    figures: dict[Name, Figure] = key(
        'a table like [figures."air.drag_coefficient"]', "figures to reach", default={}
    )

    def section(self, of: type[S]) -> S:
        """The section of a class, with its defaults where it is not in the file."""
        section: S = getattr(self, _NAMES[of])
        return section

    @field_validator("sha256", mode="before")
    @classmethod
    def _lower_case(cls, digits: Any) -> Any:
        return digits.lower() if isinstance(digits, str) else digits

    @classmethod
    def parse(cls, data: Mapping[str, Any], source: str = "definition") -> "Definition":
        """The definition that plain data state.

        Arguments:
            data: as `tomllib` reads it; mappings, sequences and arrays will do.
            source: what errors call them.

        Raises:
            InputError: an unknown key (with the nearest known one), or a value that is not what
                its key must be, or data beyond the limits of a file.
        """
        check_size(data, source)
        try:
            return cls.model_validate(upgraded(plain(data)))
        except ValidationError as error:
            raise complaint(cls, error, source) from None

    @classmethod
    def load(cls, path: str | Path) -> "Definition":
        """Read a TOML file.

        Raises:
            InputError: it is missing, not TOML or not legal.
        """
        path = Path(path)
        try:
            text = read_bytes(path, TEXT_BYTES).decode("utf-8-sig")
        except FileNotFoundError:
            raise InputError(f"{path} does not exist: give the path of a TOML file") from None
        except UnicodeDecodeError:
            raise InputError(f"{path} is not text: it must be TOML in UTF-8") from None
        except OSError as error:
            raise InputError(
                f"{path} cannot be read ({error.strerror}): give a TOML file"
            ) from None
        return cls.parse(parse_toml(text, path), str(path))

    def merged_with(self, other: "Definition") -> "Definition":
        """This definition with what `other` gives on top, key by key within each section.

        Raises:
            InputError: the two together contradict themselves.
        """
        merged = self.contents()
        for name, value in other.contents().items():
            # An entry of [figures] says one thing, and is replaced as a whole.
            depth = 1 if name == "figures" else 2
            merged[name] = _merge(merged.get(name), value, depth)
        return Definition.parse(merged, "definitions taken together")

    def to_toml(self) -> str:
        """TOML text of the contents, the version first; `load` reads it back."""
        return to_toml({"schema_version": self.schema_version, **self.contents()})


def upgraded(data: dict[str, Any]) -> dict[str, Any]:
    """Plain data of an older version, which each kind of model knows to read, as of this one."""
    for kind in KINDS.values():
        data = kind.upgraded(data)
    return data


def run_keys(*, model: bool) -> tuple[str, ...]:
    """What a definition may say about a run: data, checksum and fit are not among it.

    Arguments:
        model: whether with what it says of the model of the run.
    """
    sections = [
        name
        for kind in KINDS.values()
        for name in (kind.all_sections if model else kind.run_sections)
    ]
    return (*(("model",) if model else ()), "free_motion", *dict.fromkeys(sections), "noise")


def _merge(below: Any, above: Any, depth: int) -> Any:
    if depth == 0 or not isinstance(below, dict) or not isinstance(above, dict):
        return above
    merged = dict(below)
    for name, value in above.items():
        merged[name] = _merge(merged.get(name), value, depth - 1)
    return merged
