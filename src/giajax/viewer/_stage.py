"""Scenes in viser: what is drawn once, and what moves."""

from typing import TYPE_CHECKING, Any

import numpy as np

from .._typing import Float
from ._colours import AIR, BODIES, BUILDING, CONTACT, INK, RECORDED, Colour, darker, thread_colours
from ._legend import words
from ._meshes import ball, brick, tube, turns_to
from ._pieces import Scale, cut, joints, segments
from ._show import Show

if TYPE_CHECKING:
    from viser import SceneApi

LAYERS = ("balloons", "muscles", "markers", "recorded", "air", "contact", "surroundings")
"""What can be hidden: a folder of each show's scene."""

# Of the largest extent.
_THREAD, _DOT, _LONGEST_ARROW = 0.002, 0.004, 0.15


class Stage:
    """One show on a page.

    Arguments:
        api: of viser, where it is drawn.
        show: what is drawn.
        scale: of all shows on the page.
        index: which show of the page this is, from 0 on: it has colours of its own.
        offset: where its base is, m, shape (3,).
    """

    def __init__(
        self,
        api: "SceneApi",
        show: Show,
        scale: Scale,
        *,
        index: int = 0,
        offset: Float[np.ndarray, "3"] | None = None,
    ) -> None:
        self.show = show
        self.scale = scale
        self._api = api
        self._root = f"/{index + 1} {show.name.replace('/', '_')}"
        self._name = list(BODIES)[index % len(BODIES)]
        self._colour = BODIES[self._name]
        self._base = api.add_frame(
            self._root, show_axes=False, position=np.zeros(3) if offset is None else offset
        )
        self._layers = {
            layer: api.add_frame(f"{self._root}/{layer}", show_axes=False)
            for layer in self.layers()
        }
        self._handles: dict[str, Any] = {}
        self._surroundings()
        self.draw(0)

    def layers(self) -> list[str]:
        """Names of the layers that have something in them."""
        scene = self.show.scene
        there = {
            "balloons": any(np.any(line.radii > 0) for line in scene.lines),
            "muscles": any(not np.any(line.radii > 0) for line in scene.lines),
            "markers": bool(scene.markers),
            "recorded": bool(self.show.recorded),
            "surroundings": bool(scene.blocks),
        }
        there |= {arrows.name: bool(np.any(arrows.vectors)) for arrows in scene.arrows}
        return [layer for layer in LAYERS if there.get(layer)]

    def visible(self, layer: str, shown: bool) -> None:
        """Show or hide a layer; one that this show does not have is none."""
        if layer in self._layers:
            self._layers[layer].visible = shown

    def words(self, sample: int) -> str:
        """What is seen at a sample, as Markdown."""
        return words(self.show, sample, self._name)

    def place(self, offset: Float[np.ndarray, "3"]) -> None:
        """Put the base of the show elsewhere, m."""
        self._base.position = offset

    def draw(self, sample: int) -> None:
        """Everything that moves, at a sample."""
        scene = self.show.scene
        bodies = segments(scene, sample, bodies=True)
        self._tubes("balloons/links", bodies, self._colour, opacity=0.55)
        centres, radii = joints(scene, sample)
        self._balls("balloons/joints", centres, 0.35 * radii, INK)
        threads = segments(scene, sample, bodies=False)
        threads[2][:] = _THREAD * self.scale.extent
        self._tubes("muscles/threads", threads, thread_colours(scene, sample, self.scale.pressure))
        self._points("markers/points", scene.markers, sample, darker(self._colour))
        self._points("recorded/points", self.show.recorded, sample, RECORDED)
        for arrows in scene.arrows:
            if arrows.name in self._layers:
                colour = CONTACT if arrows.name == "contact" else AIR
                self._arrows(arrows.name, arrows.origins[sample], arrows.vectors[sample], colour)

    def _tubes(self, name: str, pieces: Any, colour: Any, opacity: float | None = None) -> None:
        starts, ends, radii = pieces
        if not len(starts):
            return
        lengths = np.linalg.norm(ends - starts, axis=1)
        moved = {
            "batched_positions": (starts + ends) / 2,
            "batched_wxyzs": turns_to(ends - starts),
            "batched_scales": np.stack([lengths, radii, radii], axis=1),
            "batched_colors": np.asarray(colour, dtype=np.uint8),
        }
        self._batch(name, tube(), moved, opacity)

    def _balls(self, name: str, centres: np.ndarray, radii: np.ndarray, colour: Colour) -> None:
        if not len(centres):
            return
        moved = {
            "batched_positions": centres,
            "batched_wxyzs": np.tile([1.0, 0.0, 0.0, 0.0], (len(centres), 1)),
            "batched_scales": np.stack([radii] * 3, axis=1),
            "batched_colors": np.array(colour, dtype=np.uint8),
        }
        self._batch(name, ball(), moved, None)

    def _points(self, name: str, markers: Any, sample: int, colour: Colour) -> None:
        if not markers:
            return
        points = np.stack([each[sample] for each in markers.values()])
        there = np.all(np.isfinite(points), axis=1)
        # One that is missing is made so small that it is not seen: batches keep their size.
        radii = np.where(there, _DOT * self.scale.extent, 1e-9)
        self._balls(name, np.where(there[:, None], points, 0.0), radii, colour)

    def _batch(self, name: str, mesh: Any, moved: dict[str, Any], opacity: float | None) -> None:
        known = self._handles.get(name)
        if known is None:
            handle = self._api.add_batched_meshes_simple(
                f"{self._root}/{name}", *mesh, lod="off", cast_shadow=False, receive_shadow=False,
                opacity=opacity, **moved,
            )  # fmt: skip
            self._handles[name] = (handle, dict(moved))
            return
        handle, before = known
        for key, value in moved.items():
            # What did not change need not travel.
            if not np.array_equal(before[key], value):
                setattr(handle, key, value)
                before[key] = value

    def _arrows(self, name: str, origins: Any, vectors: Any, colour: Colour) -> None:
        longest = _LONGEST_ARROW * self.scale.extent / (self.scale.force or 1.0)
        # One that is shorter than its head is no arrow.
        seen = np.linalg.norm(longest * vectors, axis=-1) > 2 * _THREAD * self.scale.extent
        points = np.stack([origins, origins + longest * vectors], axis=1)[seen]
        known = self._handles.get(name)
        if known is not None:
            known.visible = bool(np.any(seen))
        if not np.any(seen):
            return
        width = _THREAD * self.scale.extent
        if known is None:
            self._handles[name] = self._api.add_arrows(
                f"{self._root}/{name}/arrows", points, colour,
                shaft_radius=0.7 * width, head_radius=1.8 * width, head_length=4 * width,
            )  # fmt: skip
        else:
            known.points = points.astype(np.float32)

    def _surroundings(self) -> None:
        blocks = self.show.scene.blocks
        if not blocks:
            return
        low, high = self.show.scene.extent()
        for number, block in enumerate(blocks):
            centre, size = cut(block.centre, block.size, block.axes, low, high)
            vertices = brick().vertices * size @ block.axes.T + centre
            self._api.add_mesh_simple(
                f"{self._root}/surroundings/{number + 1} {block.name.replace('/', '_')}",
                vertices, brick().faces, color=BUILDING, flat_shading=True, opacity=0.75,
                cast_shadow=False, receive_shadow=False,
            )  # fmt: skip
