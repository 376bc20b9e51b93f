"""What a person sees of a model: bodies and threads over time, for pictures, viewers, animations.

Numbers only, so that whatever draws needs neither JAX nor the model.
"""

import dataclasses

import numpy as np

from .._errors import InputError
from .._typing import Bool, Float


@dataclasses.dataclass(frozen=True)
class Line:
    """A polyline that moves: the axis of a round body, or a thread.

    Attributes:
        name: what it is (`link`, `muscle`); lines of one name look alike.
        points: m, shape (sample, point, 3).
        radii: of the round body about it at each point, m, shape (point,); 0 for a thread.
        loose: where a thread hangs slack, shape (sample,); None where it never does.
        pressure: inside, above the surroundings, Pa, shape (sample,); None where it has none.
    """

    name: str
    points: Float[np.ndarray, "sample point 3"]
    radii: Float[np.ndarray, " point"]
    loose: Bool[np.ndarray, " sample"] | None = None
    pressure: Float[np.ndarray, " sample"] | None = None

    def __post_init__(self) -> None:
        if self.points.shape[1:] != (len(self.radii), 3):
            raise InputError(
                f"the line '{self.name}' has points of shape {self.points.shape} and "
                f"{len(self.radii)} radii: give a radius to each point"
            )


@dataclasses.dataclass(frozen=True)
class Arrows:
    """Vectors that act somewhere: forces of the air, or of what is touched.

    Attributes:
        name: what they are (`air`, `contact`).
        unit: of their length (`N`).
        origins: where they act, m, shape (sample, arrow, 3).
        vectors: shape (sample, arrow, 3).
    """

    name: str
    unit: str
    origins: Float[np.ndarray, "sample arrow 3"]
    vectors: Float[np.ndarray, "sample arrow 3"]

    def __post_init__(self) -> None:
        if self.origins.shape != self.vectors.shape:
            raise InputError(
                f"the arrows '{self.name}' have origins of shape {self.origins.shape} and vectors "
                f"of shape {self.vectors.shape}: give an origin to each vector"
            )


@dataclasses.dataclass(frozen=True)
class Block:
    """A solid box that stays where it is.

    Attributes:
        name: of the obstacle that it is a part of.
        centre: m, shape (3,).
        size: along its own axes, m, shape (3,).
        axes: unit vectors along its sizes, as columns, shape (3, 3).
    """

    name: str
    centre: Float[np.ndarray, "3"]
    size: Float[np.ndarray, "3"]
    axes: Float[np.ndarray, "3 3"]


@dataclasses.dataclass(frozen=True)
class Scene:
    """Everything that is seen of a model, in one frame: x ahead, y to the left, z upwards.

    Attributes:
        lines: bodies and threads.
        markers: points by name, m, each of shape (sample, 3); NaN where there is none.
        times: of the samples, s, shape (sample,); None where they are not in time.
        arrows: forces.
        blocks: what stands around.
    """

    lines: tuple[Line, ...]
    markers: dict[str, Float[np.ndarray, "sample 3"]]
    times: Float[np.ndarray, " sample"] | None = None
    arrows: tuple[Arrows, ...] = ()
    blocks: tuple[Block, ...] = ()

    def __post_init__(self) -> None:
        lengths = {len(line.points) for line in self.lines}
        lengths |= {len(points) for points in self.markers.values()}
        lengths |= {len(arrows.origins) for arrows in self.arrows}
        if self.times is not None:
            lengths.add(len(self.times))
        if len(lengths) != 1:
            raise InputError(
                f"the parts of a scene have {sorted(lengths)} samples: give all of them as many"
            )

    @property
    def samples(self) -> int:
        """Number of samples."""
        parts = [*(line.points for line in self.lines), *self.markers.values()]
        return len(parts[0])

    def extent(self) -> Float[np.ndarray, "2 3"]:
        """Least and greatest coordinates of all bodies and markers over all samples, m."""
        corners = [points.reshape(-1, 3) for points in self.markers.values()]
        for line in self.lines:
            reach = line.radii[:, None]
            corners += [(line.points + sign * reach).reshape(-1, 3) for sign in (-1, 1)]
        everything = np.concatenate(corners)
        return np.stack([np.nanmin(everything, axis=0), np.nanmax(everything, axis=0)])
