"""What people read: text for a terminal, tables for a paper, and one page that can be mailed.

Results hold data; here stands what is said of them, a file for each kind of result. Printing a
result does not wait for pictures: Matplotlib is loaded with the first one.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
