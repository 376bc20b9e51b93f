"""Where the markers of a scene were recorded."""

from collections.abc import Mapping

import numpy as np

from ..runs import Run
from ._scene import Scene

# Of the extent: where a recording's axes are those of the scene, they agree better than this.
_ALIGNED = 1e-3


def recorded_markers(
    scene: Scene, run: Run, predicted: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray] | None:
    """Where markers were recorded, in the frame of a scene.

    Of a marker whose coordinates were recorded in part, the others are those of the model.

    Arguments:
        scene: of a model that follows the run.
        run: the recording.
        predicted: what the model predicts for it, SI, by channel.

    Returns:
        Points by the names of the markers, m, of shape (sample, 3), NaN where nothing was
        recorded; None where the axes of the recording are not those of the scene.
    """
    low, high = scene.extent()
    allowed = _ALIGNED * float(np.max(high - low))
    found: dict[str, np.ndarray] = {}
    for name, points in scene.markers.items():
        here = points.copy()
        measured = np.zeros(len(here), bool)
        for axis, letter in enumerate("xyz"):
            channel = f"{name}_{letter}"
            if channel not in run.observations or len(predicted[channel]) != len(here):
                continue
            if np.nanmax(np.abs(predicted[channel] - points[:, axis])) > allowed:
                return None
            cells = run.observations[channel]
            here[:, axis] = cells
            measured |= ~np.isnan(cells)
        if measured.any():
            here[~measured] = np.nan
            found[name] = here
    return found
