"""Write pixels of OpenCV's `projectPoints` as reference values into the file next to this one.

    pip install opencv-python-headless
    python tests/models/opencv_projections.py

OpenCV has a size of 70 MB, so the tests only read these stored values.
"""

import json
from pathlib import Path

import numpy as np

FILE = Path(__file__).with_name("opencv_projections.json")

# k1, k2, p1, p2, k3: no distortion, a usual lens, a wide-angle lens with all terms, tangential
# only.
_LENSES = [
    [0.0, 0.0, 0.0, 0.0, 0.0],
    [-0.11, 0.013, 0.0004, -0.0007, 0.0],
    [-0.28, 0.09, 0.002, -0.003, -0.012],
    [0.0, 0.0, 0.011, -0.008, 0.0],
]


def main() -> None:
    """Write the reference values."""
    import cv2

    random = np.random.default_rng(14)
    cases = []
    for lens in _LENSES:
        for _ in range(3):
            focal = random.uniform(400, 1800)
            matrix = np.array(
                [
                    [focal, 0, random.uniform(300, 1000)],
                    [0, focal * random.uniform(0.9, 1.1), random.uniform(200, 600)],
                    [0, 0, 1],
                ]
            )
            turn = random.normal(size=3)
            turn *= random.uniform(0.1, 3.0) / np.linalg.norm(turn)
            shift = random.uniform(-8, 8, size=3)
            # Points in front of the camera, up to 45 degrees from its axis, transformed to the
            # world.
            depth = random.uniform(0.5, 25, size=(12, 1))
            before = np.hstack([random.uniform(-1, 1, size=(12, 2)) * depth, depth])
            points = (before - shift) @ cv2.Rodrigues(turn)[0]
            pixels, _ = cv2.projectPoints(points, turn, shift, matrix, np.array(lens))
            cases.append(
                {
                    "rvec": turn.tolist(),
                    "tvec": shift.tolist(),
                    "matrix": matrix.tolist(),
                    "distortion": lens,
                    "points": points.tolist(),
                    "pixels": pixels[:, 0].tolist(),
                }
            )
    content = {"opencv": cv2.__version__, "cases": cases}
    FILE.write_text(json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    main()
