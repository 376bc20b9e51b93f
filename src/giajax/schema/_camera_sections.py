"""The sections of cameras that show pixels, and of the landmarks that they see."""

import re
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

from pydantic import ConfigDict, Field, field_validator, model_validator

from ..runtime.limits import LINKS as MOST_LINKS
from ._declaration import Section, key, with_keys
from ._kind import CAMERA_NAME
from ._quantities_sensors import CAMERA, LANDMARK, PINHOLE

_PLACES = re.compile("room|tip|link([0-9]{2,})")
_MOST_PIXELS = 1_000_000


@with_keys(PINHOLE)
class PinholeSection(Section):
    """`[camera.NAME]`: a camera with a lens, which shows pixels."""

    mount: Annotated[str, Field(pattern=_PLACES.pattern)] | None = key(
        '"room", "tip" or a link such as "link06"',
        "what the camera is fixed to, and moves with",
        preset="room",
    )
    size_px: (
        Annotated[
            list[Annotated[int, Field(ge=1, le=_MOST_PIXELS)]], Field(min_length=2, max_length=2)
        ]
        | None
    ) = key(
        "a list of two whole numbers of pixels",
        "width and height of the picture",
        example=[1920, 1080],
    )

    @field_validator("mount")
    @classmethod
    def _a_place(cls, mount: str | None) -> str | None:
        place = None if mount is None else _PLACES.fullmatch(mount)
        digits = None if place is None else place[1]
        whole = digits is None or (0 < int(digits) <= MOST_LINKS and digits == f"{int(digits):02d}")
        if mount is not None and not (place and whole):
            raise ValueError(
                f'is {mount!r}, but must be "room", "tip" or a link such as "link06": correct it'
            )
        return mount

    @property
    def link(self) -> int | None:
        """The number of the link that it is fixed to, where it is one."""
        return int(self.mount[4:]) if self.mount and self.mount.startswith("link") else None


@with_keys(LANDMARK)
class LandmarkSection(Section):
    """`[landmark.markNN]`: a point of the room that cameras see."""


class _Named(Section):
    """A table of sections by name."""

    model_config: ClassVar[ConfigDict] = ConfigDict(extra="allow", strict=True, frozen=True)


class CamerasSection(_Named):
    """`[camera]`: the cameras that show pixels, by name."""

    entries: ClassVar[type[Section] | None] = PinholeSection
    __pydantic_extra__: dict[str, PinholeSection] = Field(init=False)

    @model_validator(mode="after")
    def _names_are_usable(self) -> "CamerasSection":
        taken = [each.path.rpartition(".")[2] for each in CAMERA]
        for name in self.named():
            if not re.fullmatch(CAMERA_NAME, name, re.ASCII) or name in taken:
                raise ValueError(
                    f"has a camera {name!r}, but a name has letters, digits and _, begins with a "
                    f"letter and is none of {', '.join(taken)}: rename it"
                )
        return self

    def check_mounts(self, links: int | None) -> None:
        """Raise `ValueError` if a camera is on a link beyond `links`, where that is known."""
        for name, camera in self.named().items():
            if links is not None and (camera.link or 0) > links:
                raise ValueError(
                    f"{name}.mount is link {camera.link}, but the arm has {links} links: correct "
                    "the number, or state links in [arm]"
                )


class LandmarksSection(_Named):
    """`[landmark]`: points of the room that cameras see, by name: mark01, mark02, ..."""

    entries: ClassVar[type[Section] | None] = LandmarkSection
    __pydantic_extra__: dict[str, LandmarkSection] = Field(init=False)

    @model_validator(mode="after")
    def _names_are_numbered(self) -> "LandmarksSection":
        for name, mark in self.named().items():
            number = re.fullmatch("mark([0-9]{2,3})", name, re.ASCII)
            if not number or name != f"mark{int(number[1]) or 1:02d}":
                raise ValueError(
                    f"has a landmark {name!r}, but they are called mark01, mark02, and so on: "
                    "rename it"
                )
            if "position_m" not in mark.contents():
                raise ValueError(f"does not say where {name} is: give {name}.position_m")
        return self


def sections_of_cameras(values: Mapping[str, Any]) -> dict[str, Any]:
    """The keys of the quantities of cameras and landmarks, as files have them.

    Arguments:
        values: by path, SI; others than those of cameras and landmarks are left out.

    Returns:
        Section -> name -> key -> value: the inverse of the sections' `values`.
    """
    sections: dict[str, dict[str, Any]] = {}
    for group, of in ((PINHOLE, PinholeSection), (LANDMARK, LandmarkSection)):
        section = next(iter(group)).path.partition(".")[0]
        found: dict[str, dict[str, Any]] = {}
        for path, value in values.items():
            first, *rest = path.split(".")
            if first == section and len(rest) == 2:
                found.setdefault(rest[0], {})[f"{first}.NAME.{rest[1]}"] = value
        if found:
            sections[section] = {name: of.keys_of(parts) for name, parts in found.items()}
    return sections
