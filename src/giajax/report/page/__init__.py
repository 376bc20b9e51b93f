"""Pages for a browser: one result, or a comparison of several. Requires the extra `report`."""

import lazy_loader

# The pages of studies need no plots of bokeh, whose modules take half a second to import.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
