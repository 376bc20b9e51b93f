"""Many fits of one definition: a plan of what differs, and a table of what comes of it."""

from ._plan import Plan as Plan
from ._sweep import FITS as FITS, TABLE as TABLE, sweep as sweep
