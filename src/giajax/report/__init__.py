"""What a person sees of fits and models: tables, pictures and files.

The public names are listed in `__init__.pyi`. Each is imported when it is first used: the pictures
of one command need libraries that take others longer to import than they run.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
