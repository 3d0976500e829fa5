"""residyn: fit a braked arm from its recordings, see where the model fails, and mend it.

Names are imported when they are first used, so that the command answers `--help` at once; the
stub beside this file lists them.
"""

import lazy_loader

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
