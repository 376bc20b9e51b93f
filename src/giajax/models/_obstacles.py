"""Obstacles from the TOML vocabulary, and back."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..kinds import Obstacle
from ..obstacles import AbstractObstacle, Box, Plane, WallWithOpening


def obstacles_from(entries: Sequence[Obstacle]) -> tuple[AbstractObstacle, ...]:
    """The obstacles that entries of `[[arm.obstacles]]` state."""
    return tuple(_obstacle(entry) for entry in entries)


def _obstacle(entry: Obstacle) -> AbstractObstacle:
    about: dict[str, Any] = {"centre": entry.centre_m, "name": entry.name}
    sizes: dict[str, Any]
    if entry.shape == "plane":
        sizes = {"normal": entry.normal}
        return Plane(**about, **sizes)
    about["rotation"] = np.deg2rad(entry.rotation_deg or [0.0, 0.0, 0.0])
    if entry.shape == "box":
        sizes = {"size": entry.size_m}
        return Box(**about, **sizes)
    sizes = {
        "opening": entry.opening_m,
        "margins": entry.margins_m,
        "thickness": entry.thickness_m,
    }
    return WallWithOpening(**about, **sizes)


def entries_of(obstacles: Sequence[AbstractObstacle]) -> list[dict[str, Any]]:
    """The entries of `[[arm.obstacles]]` that state obstacles."""
    return [_entry(obstacle) for obstacle in obstacles]


def _entry(obstacle: AbstractObstacle) -> dict[str, Any]:
    def numbers(value: Any) -> Any:
        return np.asarray(value, dtype=float).tolist()

    about: dict[str, Any] = {"name": obstacle.name, "centre_m": numbers(obstacle.centre)}
    if isinstance(obstacle, Plane):
        return {"shape": "plane", **about, "normal": numbers(obstacle.normal)}
    if isinstance(obstacle, Box):
        shape, sizes = "box", {"size_m": numbers(obstacle.size)}
    elif isinstance(obstacle, WallWithOpening):
        shape, sizes = (
            "wall",
            {
                "opening_m": numbers(obstacle.opening),
                "margins_m": numbers(obstacle.margins),
                "thickness_m": numbers(obstacle.thickness),
            },
        )
    else:
        raise TypeError(f"an obstacle of type {type(obstacle).__name__} has no entry in files")
    turn = numbers(np.rad2deg(np.asarray(obstacle.rotation)))
    return {"shape": shape, **about, **sizes, "rotation_deg": turn}
