"""What is seen, in words."""

import numpy as np

from ._show import Show

_FORCES = {"air": "largest drag on a link", "contact": "largest force of a contact"}


def words(show: Show, sample: int, colour: str) -> str:
    """What a show has at a sample, as Markdown.

    Arguments:
        show: the show.
        sample: the sample.
        colour: of its bodies.
    """
    said = [f"**{show.name}** ({colour})"]
    if show.scene.times is not None and show.samples > 1:
        said.append(f"time {show.clock[sample]:.2f} s")
    if (tip := show.scene.markers.get("tip")) is not None and np.all(np.isfinite(tip[sample])):
        said.append("tip at " + ", ".join(f"{part:.3f}" for part in tip[sample]) + " m")
    if (off := show.marker_error(sample)) is not None:
        said.append(f"recorded markers off by {_length(off)} (RMS)")
    for arrows in show.scene.arrows:
        force = float(np.max(np.linalg.norm(arrows.vectors[sample], axis=-1), initial=0.0))
        if np.any(arrows.vectors):
            said.append(f"{_FORCES.get(arrows.name, arrows.name)} {force:.3g} {arrows.unit}")
    pressures = [line.pressure[sample] for line in show.scene.lines if line.pressure is not None]
    if pressures:
        said.append(f"pressures up to {max(pressures) / 1e5:.2f} bar")
    return "  \n".join([*said, *(f"*{note}*" for note in show.notes)])


def _length(metres: float) -> str:
    return f"{metres:.2f} m" if metres >= 1 else f"{1e3 * metres:.1f} mm"
