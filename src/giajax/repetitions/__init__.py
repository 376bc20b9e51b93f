"""Fits repeated: with other data (bootstrap), and without some of the data (influence)."""

from ._bootstrap import bootstrap as bootstrap
from ._influence import influence as influence
from ._influence_records import Influence as Influence, LeftOut as LeftOut
from ._records import Bootstrap as Bootstrap, Repeated as Repeated
