"""Pictures of a fit.

Each shows one thing: `overlay` the motion beside the model and the residual under it, `spectrum`
at which frequencies something is left, `errors` how far each of several models is from the noise,
`convergence` how searches bring the objective down, `where` and `horizon` where a model fails and
how its predictions do, `missing_torque` the torque that it lacks, `signature` what an effect of the
catalogue would leave if it were missing, `ring_down` the same release with and without air
bearings, `composite_inertia` the driven tests of step 1 on their line; of a diagnosis, `ladder`
shows the error falling, `candidates` what might have been missing, and `law` a law without a name
as a curve with its band.
All return a matplotlib `Figure` (no pyplot, no window, no global state): save it, show it in a
notebook, or put it into a page. Saved as PDF its fonts are TrueType, as SVG its letters are paths:
both print as they look. `narrow=True` lays a picture out for a phone's width. Matplotlib is loaded
with the first picture.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
