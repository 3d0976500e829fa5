"""The demo's table: the residual along time, in times the noise."""

from types import SimpleNamespace

import numpy as np

from residyn.demo import by_window


def test_residual_by_window():
    time = np.arange(100) / 10
    residual = np.ones((100, 2))
    residual[50:] = 3.0
    used = np.ones((100, 2), bool)
    used[:25, 1] = False
    noise = np.array([1.0, 0.5])
    beside = SimpleNamespace(
        recording=SimpleNamespace(time=time, noise=noise), residual=residual, used=used
    )
    edges, sizes = by_window(beside, 4)  # pyright: ignore[reportArgumentType]
    assert (edges[0], edges[-1]) == (0.0, 9.9)
    np.testing.assert_allclose(sizes, [[1, np.nan], [1, 2], [3, 6], [3, 6]])
