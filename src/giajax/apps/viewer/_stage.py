"""Drawing of scenes in viser: static surroundings and moving parts."""

import contextlib
import io
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...models import Block, Scene
from ...runtime.arrays import Float, Int
from ...runtime.text import InputError, install_command
from ._gate import PrivateSocket
from ._show import Show, words

if TYPE_CHECKING:
    from viser import SceneApi, ViserServer

# The viser server runs behind the gate, prints nothing, and requires the extra `view`.

_STARTING = threading.Lock()  # the start of a server replaces a function of the whole process


def check_viser() -> None:
    """Raise an `InputError` if viser is not installed."""
    try:
        import viser  # noqa: F401
    except ImportError:
        raise InputError(
            f"the viewer needs viser, which is not installed: {install_command('view')}"
        ) from None


class Backend:
    """Server of one page, on a Unix socket that only this account can reach."""

    def __init__(self) -> None:
        check_viser()
        import viser

        # The page to serve instead of the viser page, as soon as it is set.
        self.page: Callable[[], bytes] | None = None
        self._place = PrivateSocket()
        self.socket = self._place.path
        try:
            # Viser would print its own address, which is not the address of the page.
            with (
                contextlib.redirect_stdout(io.StringIO()),
                _listening_at(self.socket, lambda: self.page and self.page()),
            ):
                self.server: ViserServer = viser.ViserServer(
                    host="127.0.0.1", port=0, label="giajax", verbose=False
                )
            if not self.socket.exists():
                self.close()
                raise InputError(
                    f"viser {viser.__version__} opens a port that other accounts can reach: "
                    "pip install 'viser==1.1.1'"
                )
        except BaseException:
            self._place.close()
            raise
        self.server.scene.set_up_direction("+z")

    def close(self) -> None:
        """Stop the server; suppress the message that viser prints."""
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()
        self._place.close()


@contextlib.contextmanager
def _listening_at(path: Path, page: Callable[[], bytes | None]) -> Iterator[None]:
    """Make viser listen at a path, and serve the given page, if any, in place of its own.

    Viser accepts only a host and a port, and does not authenticate connections. Its function that
    opens the port is therefore replaced while the server starts. The caller checks afterwards that
    the replacement took effect.
    """
    from websockets.asyncio import server

    with _STARTING:
        usual = server.serve

        def at_path(handler: Any, host: Any = None, port: Any = None, **options: Any) -> Any:
            files: Any = options.get("process_request")

            def answer(connection: Any, request: Any) -> Any:
                answered = files(connection, request)
                # A request without an answer is upgraded to a WebSocket.
                if answered is None or request.path.partition("?")[0] != "/":
                    return answered
                if (own := page()) is None:
                    return answered
                for name in ("Content-Length", "Content-Encoding"):
                    del answered.headers[name]
                answered.headers["Content-Length"] = str(len(own))
                answered.body = own
                return answered

            if files is not None:
                options["process_request"] = answer
            return usual(handler, unix=True, path=str(path), **options)

        server.serve = at_path  # type: ignore[assignment, misc]
        try:
            yield
        finally:
            server.serve = usual  # type: ignore[misc]


# Colours of the parts, from a palette for readers with colour vision deficiency.

Colour = tuple[int, int, int]

INK: Colour = (40, 40, 40)
RECORDED: Colour = (213, 94, 0)
AIR: Colour = (0, 158, 115)
CONTACT: Colour = (204, 51, 17)
BUILDING: Colour = (176, 168, 158)
BODIES: dict[str, Colour] = {
    "blue": (86, 140, 190),
    "orange": (222, 150, 60),
    "green": (110, 165, 95),
    "purple": (165, 110, 175),
}
"""Colours of the balloons; each show takes the next one."""

# Colours of an empty muscle and of the highest pressure. A scale from blue over white to red would
# be invisible on the page in its middle.
EMPTY: Colour = (70, 90, 160)
FULL: Colour = (215, 48, 39)


def marker_colour(body: Colour) -> Colour:
    """Return the colour of simulated markers: darker than their bodies, to remain visible."""
    red, green, blue = (int(0.45 * part) for part in body)
    return red, green, blue


def thread_colours(scene: Scene, sample: int, highest: float) -> Int[np.ndarray, "piece 3"]:
    """Return the colour of each piece of each thread by its pressure relative to `highest`, Pa."""
    colours = []
    for line in scene.lines:
        if np.any(line.radii > 0):
            continue
        colour = np.array(INK, dtype=float)
        if line.pressure is not None and highest > 0:
            share = np.clip(line.pressure[sample] / highest, 0, 1)
            colour = (1 - share) * np.array(EMPTY) + share * np.array(FULL)
        colours += [colour] * (line.points.shape[1] - 1)
    return np.array(colours).reshape(-1, 3).astype(np.uint8)


_ROUND = 24
_SEAMS, _SEAM = 6, 0.94  # number of seams along a balloon, and their distance from its axis, radii


class Mesh(NamedTuple):
    """Vertices, and faces as vertex indices, counterclockwise as seen from outside."""

    vertices: Float[np.ndarray, "vertex 3"]
    faces: Int[np.ndarray, "face 3"]


def tube() -> Mesh:
    """Return a balloon about the x axis, from -1/2 to 1/2, with radius 1.

    The radius is smaller at the ends and at the seams between the strips of film.
    """
    outline = [(-0.5, 0.0), (-0.5, 0.7), (-0.47, 1.0), (0.47, 1.0), (0.5, 0.7), (0.5, 0.0)]
    return _turned(outline, np.where(np.arange(_ROUND) % (_ROUND // _SEAMS), 1.0, _SEAM))


def ball() -> Mesh:
    """Return a sphere of radius 1."""
    places = np.linspace(-np.pi / 2, np.pi / 2, _ROUND // 2)
    return _turned([(float(np.sin(place)), float(np.cos(place))) for place in places])


def brick() -> Mesh:
    """Return a box from -1/2 to 1/2 along each axis, with four separate vertices per face."""
    corners: list[np.ndarray] = []
    faces: list[tuple[int, int, int]] = []
    for axis in range(3):
        for side in (-1.0, 1.0):
            across = np.roll(np.eye(3), axis, axis=1)
            ahead, right, up = across[0] * side, across[1] * side, across[2]
            first = len(corners)
            corners += [
                (ahead + a * right + b * up) / 2 for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))
            ]
            faces += [(first, first + 1, first + 2), (first, first + 2, first + 3)]
    return Mesh(np.array(corners), np.array(faces))


def edges(bricks: Sequence[Float[np.ndarray, "24 3"]]) -> Float[np.ndarray, "edge 2 3"]:
    """Return the edges of a body that is assembled from bricks, without those inside its faces.

    Arguments:
        bricks: vertices of each brick in the order of `brick`; bricks touch at whole faces.
    """
    first = 4 * np.arange(6)[:, None]
    corners = np.concatenate([first + np.array([k, (k + 1) % 4]) for k in range(4)])
    found = np.concatenate([vertices[corners] for vertices in bricks])
    known = np.concatenate([found.sum(axis=1), np.abs(found[:, 0] - found[:, 1])], axis=1)
    # A brick has each edge in two faces. Two bricks with a common edge continue a flat face there.
    places, counts = np.unique(known.round(5), axis=0, return_index=True, return_counts=True)[1:]
    return found[places[counts // 2 % 2 == 1]]


def _turned(outline: list[tuple[float, float]], around: Any = 1.0) -> Mesh:
    """Return a body of revolution about x from pairs of x and radius.

    `around` is a factor of the radius for each angle around the axis.
    """
    turns = 2 * np.pi * np.arange(_ROUND) / _ROUND
    across = np.stack([np.cos(turns), np.sin(turns)], axis=1) * np.reshape(around, (-1, 1))
    rings = [np.insert(radius * across, 0, x, axis=1) for x, radius in outline]
    here = np.arange(_ROUND)
    after = np.roll(here, -1)
    faces = []
    for index in range(len(outline) - 1):
        near, far = index * _ROUND, (index + 1) * _ROUND
        faces.append(np.stack([near + here, far + after, far + here], axis=1))
        faces.append(np.stack([near + here, near + after, far + after], axis=1))
    return Mesh(np.concatenate(rings), np.concatenate(faces))


def turns_to(directions: Float[np.ndarray, "row 3"]) -> Float[np.ndarray, "row 4"]:
    """Return unit quaternions (w, x, y, z) of the shortest rotations from the x axis to directions.

    Directions can have any length. A direction of length 0 gives the identity.
    """
    lengths = np.linalg.norm(directions, axis=1, keepdims=True)
    ahead = np.where(lengths > 0, directions / np.where(lengths > 0, lengths, 1), [1.0, 0.0, 0.0])
    x, y, z = ahead.T
    turns = np.stack([1 + x, np.zeros_like(x), -z, y], axis=1)
    # The rotation to -x is not unique: rotate half a turn about z.
    turns[np.linalg.norm(turns, axis=1) < 1e-8] = [0.0, 0.0, 0.0, 1.0]
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    return turns


# Drawn part of an endless box beyond the scene, and its drawn thickness below the scene, in extents
# of the scene.
_GROUND, _PLATE = 0.6, 0.02

_ENDLESS = 5.0  # size in extents of the scene above which a box counts as endless


class Scale(NamedTuple):
    """Scales that all shows of a page have in common.

    Attributes:
        extent: largest extent of the moving parts, m.
        force: force that the longest arrow represents, N.
        pressure: pressure at the end of the colour scale of the muscles, Pa.
    """

    extent: float
    force: float
    pressure: float


def scale_of(shows: Sequence[Show]) -> Scale:
    """Return the common scales of some shows."""
    low, high = bounds(shows)
    arrows = [arrows for show in shows for arrows in show.scene.arrows]
    force = max((_largest(np.linalg.norm(each.vectors, axis=-1)) for each in arrows), default=0.0)
    lines = [line for show in shows for line in show.scene.lines if line.pressure is not None]
    pressure = max((_largest(line.pressure) for line in lines), default=0.0)
    return Scale(float(np.max(high - low)) or 1.0, force, pressure)


def _largest(values: Any) -> float:
    return float(np.nanmax(values, initial=0.0))


def bounds(shows: Sequence[Show]) -> Float[np.ndarray, "2 3"]:
    """Return the least and greatest coordinates of the moving parts of some shows, m."""
    extents = np.stack([show.scene.extent() for show in shows])
    return np.stack([extents[:, 0].min(axis=0), extents[:, 1].max(axis=0)])


def cut(centre: Any, size: Any, axes: Any, low: Any, high: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the centre and size of the part of a box that is near a scene, m.

    An axis is cut only if the box is far larger than the scene along it.

    Arguments:
        centre, size, axes: attributes of the box, as in `Block`.
        low, high: least and greatest coordinates of the scene, m.
    """
    extent = float(np.max(high - low))
    middle = axes.T @ ((low + high) / 2 - centre)
    reach = np.abs(axes.T) @ ((high - low) / 2)
    # A thin plate suffices for ground below the scene.
    above = np.abs(middle) > size / 2
    room = np.where(above, _PLATE, _GROUND) * extent
    near = np.where(above, np.sign(middle) * size / 2, middle - reach)
    far = np.where(above, near, middle + reach)
    endless = size > _ENDLESS * extent
    least = np.where(endless, np.maximum(-size / 2, near - room), -size / 2)
    most = np.where(endless, np.minimum(size / 2, far + room), size / 2)
    return centre + axes @ ((least + most) / 2), most - least


def ends(block: Block, extent: float) -> Float[np.ndarray, "2 3"] | None:
    """Return the least and greatest coordinates of a box, m, or None if it is endless."""
    if np.any(block.size > _ENDLESS * extent):
        return None
    reach = np.abs(block.axes) @ block.size / 2
    return np.stack([block.centre - reach, block.centre + reach])


def segments(scene: Scene, sample: int, *, bodies: bool) -> tuple[np.ndarray, ...]:
    """Return the starts, ends and radii of the pieces of bodies, or of threads."""
    none = np.zeros((0, 3), np.float32)
    pieces = [(none, none, none[:, 0])]
    for line in scene.lines:
        if bool(np.any(line.radii > 0)) is bodies:
            points, radii = line.points[sample], (line.radii[1:] + line.radii[:-1]) / 2
            if line.swelling is not None:
                radii = line.swelling[sample] * radii
            pieces.append((points[:-1], points[1:], radii))
    return tuple(map(np.concatenate, zip(*pieces, strict=True)))


def joints(scene: Scene, sample: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the positions of the joints of an arm, m, and the radii of its links there, m."""
    links = [line for line in scene.lines if line.name == "link"]
    points = np.array([line.points[sample, 0] for line in links]).reshape(-1, 3)
    return points, np.array([line.radii[0] for line in links])


LAYERS = {
    "balloons": "balloons",
    "muscles": "muscles, coloured by pressure",
    "markers": "simulated markers",
    "recorded": "recorded markers",
    "bands": "95 % regions of the ends of links",
    "air": "air drag",
    "contact": "contact forces",
    "surroundings": "surroundings",
}
"""Layers that can be hidden: folder in the scene of each show -> label."""

_BATCHED = ("batched_positions", "batched_wxyzs", "batched_scales", "batched_colors")

_THREAD, _DOT, _LONGEST_ARROW = 0.002, 0.004, 0.15  # sizes as fractions of the largest extent


class Stage:
    """One show on a page, with its base at an offset, m.

    The index of the show on the page, from 0, determines its colours.
    """

    def __init__(
        self, api: "SceneApi", show: Show, scale: Scale, index: int, offset: Float[np.ndarray, "3"]
    ) -> None:
        self.show = show
        self.scale = scale
        self.offset = offset
        self._api = api
        self._root = f"/{index + 1} {show.name.replace('/', '_')}"
        self._name = list(BODIES)[index % len(BODIES)]
        self.colour = BODIES[self._name]
        self._base = api.add_frame(self._root, show_axes=False, position=offset)
        self._layers = {
            layer: api.add_frame(f"{self._root}/{layer}", show_axes=False)
            for layer in self.layers()
        }
        self._handles: dict[str, Any] = {}
        self._surroundings()
        self.draw(0)

    def layers(self) -> list[str]:
        """Return the names of the layers that are not empty."""
        scene = self.show.scene
        there = {
            "balloons": any(np.any(line.radii > 0) for line in scene.lines),
            "muscles": any(not np.any(line.radii > 0) for line in scene.lines),
            "markers": bool(scene.markers),
            "recorded": bool(self.show.recorded),
            "bands": self.show.bands is not None,
            "surroundings": bool(scene.blocks),
        }
        there |= {arrows.name: bool(np.any(arrows.vectors)) for arrows in scene.arrows}
        return [layer for layer in LAYERS if there.get(layer)]

    def visible(self, layer: str, shown: bool) -> None:
        """Show or hide a layer; ignore a layer that this show does not have."""
        if layer in self._layers:
            self._layers[layer].visible = shown

    def words(self, sample: int) -> str:
        """Return a description of a sample as Markdown."""
        return words(self.show, sample, self._name)

    def place(self, offset: Float[np.ndarray, "3"]) -> None:
        """Move the base of the show to an offset, m."""
        self.offset = offset
        self._base.position = offset

    def draw(self, sample: int) -> None:
        """Draw all moving parts at a sample."""
        scene = self.show.scene
        bodies = segments(scene, sample, bodies=True)
        self._tubes("balloons/links", bodies, self.colour, opacity=0.55)
        centres, radii = joints(scene, sample)
        self._balls("balloons/joints", centres, 0.35 * radii[:, None], INK)
        threads = segments(scene, sample, bodies=False)
        threads[2][:] = _THREAD * self.scale.extent
        self._tubes("muscles/threads", threads, thread_colours(scene, sample, self.scale.pressure))
        self._points("markers/points", scene.markers, sample, marker_colour(self.colour))
        self._points("recorded/points", self.show.recorded, sample, RECORDED, larger=1.5)
        if (bands := self.show.bands) is not None:
            # Add the radius of the balloon: most bands would otherwise be hidden inside it.
            at = bands.centres[sample], bands.halves[sample] + radii[:, None]
            self._balls("bands/ellipsoids", *at, self.colour, opacity=0.25)
        if caption := self.show.caption_at(sample):
            self._caption(f"{caption}, {self.show.clock[sample]:.0f} s")
        for arrows in scene.arrows:
            if arrows.name in self._layers:
                colour = CONTACT if arrows.name == "contact" else AIR
                self._arrows(arrows.name, arrows.origins[sample], arrows.vectors[sample], colour)

    def _caption(self, text: str) -> None:
        """Show a caption above the scene."""
        known = self._handles.get("caption")
        if known is None:
            place = self.show.scene.extent()[1] * [0.0, 0.0, 1.05]
            self._handles["caption"] = self._api.add_label(
                f"{self._root}/caption", text, position=place
            )
        else:
            known.text = text

    def _tubes(self, name: str, pieces: Any, colour: Any, opacity: float | None = None) -> None:
        starts, ends, radii = pieces
        if not len(starts):
            return
        scales = np.stack([np.linalg.norm(ends - starts, axis=1), radii, radii], axis=1)
        placed = (starts + ends) / 2, turns_to(ends - starts), scales
        self._batch(name, tube(), placed, colour, opacity)

    def _balls(
        self, name: str, centres: Any, halves: Any, colour: Any, opacity: float | None = None
    ) -> None:
        """Draw ellipsoids with half axes along x, y and z, or balls with radii, m."""
        if len(centres):
            turns = np.tile([1.0, 0.0, 0.0, 0.0], (len(centres), 1))
            sizes = np.array(np.broadcast_to(halves, centres.shape))
            self._batch(name, ball(), (centres, turns, sizes), colour, opacity)

    def _points(
        self, name: str, markers: Any, sample: int, colour: Any, larger: float = 1.0
    ) -> None:
        if not markers:
            return
        points = np.stack([each[sample] for each in markers.values()])
        there = np.all(np.isfinite(points), axis=1)
        # A missing marker is drawn so small that it is invisible, because batches keep their size.
        radii = np.where(there, larger * _DOT * self.scale.extent, 1e-9)
        self._balls(name, np.where(there[:, None], points, 0.0), radii[:, None], colour)

    def _batch(
        self, name: str, mesh: Mesh, placed: Any, colour: Any, opacity: float | None = None
    ) -> None:
        """Draw copies of a mesh at given positions, rotations and scales."""
        arrays = (*placed, np.array(colour, dtype=np.uint8))
        moved = dict(zip(_BATCHED, arrays, strict=True))
        known = self._handles.get(name)
        if known is None:
            handle = self._api.add_batched_meshes_simple(
                f"{self._root}/{name}", *mesh, lod="off", cast_shadow=name.startswith("balloons"),
                receive_shadow=False, opacity=opacity, **moved,
            )  # fmt: skip
            self._handles[name] = (handle, moved)
            return
        handle, before = known
        for key, value in moved.items():
            # Send only the values that changed.
            if not np.array_equal(before[key], value):
                setattr(handle, key, value)
                before[key] = value

    def _arrows(self, name: str, origins: Any, vectors: Any, colour: Colour) -> None:
        longest = _LONGEST_ARROW * self.scale.extent / (self.scale.force or 1.0)
        # Omit arrows that would be shorter than their heads.
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
        low, high = self.show.scene.extent()
        whole = brick()
        bricks: dict[str, list[np.ndarray]] = {}
        endless = set()
        for number, block in enumerate(self.show.scene.blocks):
            centre, size = cut(block.centre, block.size, block.axes, low, high)
            vertices = whole.vertices * size @ block.axes.T + centre
            self._api.add_mesh_simple(
                f"{self._root}/surroundings/{number + 1} {block.name.replace('/', '_')}",
                vertices, whole.faces, color=BUILDING, flat_shading=True, opacity=0.75,
                cast_shadow=False, receive_shadow=True,
            )  # fmt: skip
            bricks.setdefault(block.name, []).append(vertices)
            if ends(block, self.scale.extent) is None:
                endless.add(block.name)
        # Edges show the depth of walls, which all have one colour. Ground has no edges.
        for name in bricks.keys() - endless:
            self._api.add_line_segments(
                f"{self._root}/surroundings/edges of {name.replace('/', '_')}",
                edges(bricks[name]), INK, thickness=0.5 * _THREAD * self.scale.extent,
            )  # fmt: skip


# Gap between two shows, in extents of the largest one, and initial distance of the camera, in sizes
# of the scene.
_GAP, _DISTANCE = 0.25, 1.0

VIEWED_FROM = np.array([0.25, -1.0, 0.3])
"""Direction from the scene to the camera: from the right, slightly from above."""

_FIELD = 0.75  # vertical angle of view, rad


def offsets(shows: Sequence[Show], *, overlay: bool) -> Float[np.ndarray, "show 3"]:
    """Return the base position of each show, m: side by side, or all in one place."""
    places = np.zeros((len(shows), 3))
    if overlay:
        return places
    low, high = bounds(shows)
    # Place the shows from left to right, across the arm.
    width = float(high[1] - low[1]) + _GAP * float(np.max(high - low))
    places[:, 1] = -width * np.arange(len(shows))
    return places


def stages(server: "ViserServer", shows: Sequence[Show], *, overlay: bool = False) -> list[Stage]:
    """Draw shows side by side, or all in one place, above a grid, and set the initial camera."""
    scale = scale_of(shows)
    places = offsets(shows, overlay=overlay)
    drawn = [
        Stage(server.scene, show, scale, index, place)
        for index, (show, place) in enumerate(zip(shows, places, strict=True))
    ]
    low, high = bounds(shows)
    low, high = low + places.min(axis=0), high + places.max(axis=0)
    _grid(server, low, high)
    # The camera initially shows the moving parts and the finite surroundings. The page later fits
    # the view to its window.
    extent = float(np.max(high - low))
    blocks = [ends(block, extent) for show in shows for block in show.scene.blocks]
    corners = np.concatenate([[low, high], *(each for each in blocks if each is not None)])
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    middle, size = (low + high) / 2, float(np.linalg.norm(high - low)) or 1.0
    ahead = VIEWED_FROM
    camera: Any = server.initial_camera
    camera.look_at = tuple(middle)
    camera.position = tuple(middle + ahead / np.linalg.norm(ahead) * size * _DISTANCE)
    camera.up = (0.0, 0.0, 1.0)
    camera.fov = _FIELD
    return drawn


def grid_step(extent: float) -> float:
    """Return the distance between grid lines below a scene with a given extent, m."""
    return 1.0 if extent > 3 else 0.1


def _grid(server: "ViserServer", low: np.ndarray, high: np.ndarray) -> None:
    """Add a grid floor below all moving parts."""
    size, middle = high - low, (low + high) / 2
    step = grid_step(float(np.max(size)))
    across = np.ceil((size[:2] + 2 * step) / step / 2) * 2 * step
    server.scene.add_grid(
        "/grid",
        width=float(across[0]),
        height=float(across[1]),
        plane="xy",
        cell_size=step,
        section_size=5 * step,
        position=(float(middle[0]), float(middle[1]), float(low[2]) - 1e-3 * float(np.max(size))),
    )
