"""Check that a page shows all of its arm, as large as its window allows, wide and narrow."""

import time

import numpy as np

from browsing import opened
from docs.machinery.browse import WIDTHS

READY = "window.__viserMutable?.cameraControl && document.getElementById('legend') !== null"

CAMERA = """(() => {
  const frame = document.getElementById("view"), page = frame ? frame.contentWindow : window;
  const viewer = page.__viserMutable, camera = viewer.camera;
  const box = viewer.canvas.getBoundingClientRect();
  camera.updateMatrixWorld();
  const legend = page.document.getElementById("legend").getBoundingClientRect();
  return {world: camera.matrixWorldInverse.elements, lens: camera.projectionMatrix.elements,
    width: box.width, height: box.height, window: innerWidth,
    scrolled: document.documentElement.scrollWidth,
    free: box.height - (legend.width > 0.6 * box.width ? legend.height : 0)};
})()"""


def resize(page, width):
    """Set the size of the window; a low resolution, because it is rendered in software."""
    size = {"width": width, "height": 700, "deviceScaleFactor": 0.25, "mobile": False}
    page.call("Emulation.setDeviceMetricsOverride", **size)


# Whether the scene is the topmost element at each place (-1 to 1 across and upwards), apart from
# the notice of viser that the scene is rendered in software.
TOPMOST = """((places) => {
  const frame = document.getElementById("view"), page = frame ? frame.contentWindow : window;
  const scene = page.__viserMutable.canvas, box = scene.getBoundingClientRect();
  return places.map(([x, y]) => scene === page.document.elementsFromPoint(
    box.left + (1 + x) / 2 * box.width, box.top + (1 - y) / 2 * box.height
  ).find((one) => !one.closest("[class*=Notification]")));
})"""


def seen_now(page, points, *, upright):
    """Return what a page shows of points, m: the window, if all are in it, and their share of it.

    The share is that of the width. For an upright arm it may be that of the height below a legend
    that is across the window, since such an arm cannot fill the width of a wide window. In a narrow
    window, where there is no room beside the arm, nothing may cover a point.
    """
    now = page.evaluate(CAMERA)
    world, lens = (np.reshape(now[name], (4, 4)).T for name in ("world", "lens"))
    # The scene of viser is drawn with y upwards, and rotated accordingly.
    turned = np.stack([-points[:, 1], points[:, 2], -points[:, 0], np.ones(len(points))])
    x, y, _, w = lens @ world @ turned
    inside = bool(np.all((w > 0) & (np.abs(x) < w) & (np.abs(y) < w)))
    share = np.ptp(x / w) / 2 * now["width"] / now["window"]
    if upright:
        share = max(share, np.ptp(y / w) / 2 * now["height"] / now["free"])
    if inside and now["window"] == min(WIDTHS):
        places = np.stack([x / w, y / w], axis=1).tolist()
        inside = all(page.evaluate(f"{TOPMOST}({places})"))
    return now, inside, share


def check(page, points, *, upright=False, seconds=180.0):
    """Check both widths in turn, which includes resizing the window; points in m."""
    for width in (*WIDTHS, WIDTHS[0]):
        resize(page, width)
        end = time.monotonic() + seconds
        while True:
            # The initial camera of viser may arrive late, and the page fits its camera again.
            now, inside, share = seen_now(page, points, upright=upright)
            if (inside and now["window"] == width and share > 0.5) or time.monotonic() > end:
                break
            time.sleep(0.1)
        assert inside, f"a part of the arm is outside or covered in a window of {width} px"
        assert now["window"] == width
        assert share > 0.5, f"the arm fills {share:.0%} of a window of {width} px"
        assert now["scrolled"] <= width, f"{now['scrolled']} px wide in a window of {width} px"


def check_file(browser, folder, file, points, *, upright=False):
    """Open a page that plays without a server, and check it and its console; points in m."""
    with opened(browser, folder) as page:
        page.draw_no_scene()
        resize(page, WIDTHS[0])
        page.open(file.as_uri())
        page.wait(READY, 120)
        check(page, points, upright=upright)
        assert not page.complaints
