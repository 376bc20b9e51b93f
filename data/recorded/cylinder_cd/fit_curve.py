"""Fit the smooth drag curve of `giajax.mechanics.arm` to the points, and print its coefficients."""

from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

POINTS = Path(__file__).with_name("points.csv")
# Transitions: the fall of creeping flow, the boundary layer's growth, and the drag crisis.
START = [3.8, -0.9, 0.3, 2.9, -0.5, 5.6, 3.9, 6.3, 0.05, 3.0, 0.5]


def curve(coefficients: np.ndarray, x: np.ndarray) -> np.ndarray:
    """A line and three transitions: log10 C_D at x = log10 Re."""
    height, place, width = np.reshape(coefficients[2:], (3, 3))[..., None]
    steps = height * np.tanh((x - place) / width)
    return coefficients[0] + coefficients[1] * x + steps.sum(axis=0)


def fitted() -> tuple[np.ndarray, np.ndarray]:
    """Coefficients by least squares, and the residuals."""
    x, y = np.loadtxt(POINTS, delimiter=",", skiprows=1).T
    found = least_squares(lambda c: curve(c, x) - y, START, xtol=1e-14, ftol=1e-14)
    return found.x, found.fun


if __name__ == "__main__":
    coefficients, residuals = fitted()
    print(np.array2string(np.round(coefficients, 5), separator=", "))
    print(f"rms of the residuals: {np.sqrt(np.mean(residuals**2)):.4f} in log10 C_D")
