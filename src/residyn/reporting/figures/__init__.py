"""Pictures of results, each of one thing.

All return a matplotlib `Figure` (no pyplot, no window, no global state): save it, show it in a
notebook, or put it into a page. Saved as PDF its fonts are TrueType, as SVG its letters are paths:
both print as they look. `narrow=True` lays a picture out for a phone's width. Matplotlib is loaded
with the first picture.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
