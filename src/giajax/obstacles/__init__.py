"""What stands around an arm: boxes, planes and walls with an opening, and what is nearest."""

from ._lines import Lines as Lines
from ._nearest import Nearest as Nearest, nearest as nearest
from ._patches import Patches as Patches, patches as patches
from ._shapes import (
    AbstractObstacle as AbstractObstacle,
    Box as Box,
    Plane as Plane,
    WallWithOpening as WallWithOpening,
)
from ._solids import Solids as Solids, owners as owners, solids as solids
