"""Fits repeated: with other data (bootstrap), and without some of the data (influence)."""

from ._bootstrap import bootstrap as bootstrap
from ._records import Bootstrap as Bootstrap, Repeated as Repeated
