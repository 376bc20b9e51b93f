"""What the data cannot tell: parameters without response, and combinations that go together."""

import numpy as np

# For a change of a parameter by its own size, in units of the noise: alone, the parameter would
# have a standard error of a million times itself.
_NO_RESPONSE = 1e-6

# Column-normalised singular value below which a combination of parameters is not determined.
COLLINEAR = 1e-6


def responds(norms: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Which parameters any channel responds to.

    Arguments:
        norms: of the columns of the Jacobian, weighted residuals by the parameters themselves,
            not by the free coordinates, which have sizes of their own; shape (parameter,).
        sizes: typical size of each parameter, shape (parameter,).

    Returns:
        True for each that does, shape (parameter,).
    """
    return norms * sizes > _NO_RESPONSE


def undetermined_groups(jacobian: np.ndarray) -> list[list[int]]:
    """Groups of parameters of which only combinations are determined.

    Each right singular vector of the column-normalised Jacobian with a vanishing singular value
    is a direction that leaves every channel unchanged; the parameters in it belong together.

    Arguments:
        jacobian: columns of the parameters that respond, shape (row, parameter); or R of its QR
            factorisation, which has the same singular vectors.

    Returns:
        Positions of the columns of each group.
    """
    if jacobian.shape[1] < 2:
        return []
    norms = np.linalg.norm(jacobian, axis=0)
    _, singular, right = np.linalg.svd(np.linalg.qr(jacobian / norms, mode="r"))
    vectors = right[singular < COLLINEAR * singular[0]]
    return [[i for i, part in enumerate(vector) if abs(part) > 0.01] for vector in vectors]


def largest_correlations(correlation: np.ndarray, limit: float) -> dict[int, tuple[int, float]]:
    """For each parameter, the partner it is most correlated with, where that exceeds a limit.

    Arguments:
        correlation: shape (parameter, parameter).
        limit: on the size of the correlation.

    Returns:
        Position and correlation of the partner, by position of the parameter.
    """
    partners = {}
    off = np.abs(correlation - np.diag(np.diag(correlation)))
    for i in range(len(correlation)):
        j = int(np.argmax(off[i]))
        if off[i, j] > limit:
            partners[i] = (j, float(correlation[i, j]))
    return partners
