"""Single vectors of three numbers."""

from __future__ import annotations

import numpy as np

from clvol.base.vectors import cross, length


def test_both_are_numpys_to_the_bit() -> None:
    rng = np.random.default_rng(1)
    for one, other in rng.standard_normal((500, 2, 3)) * 10.0 ** rng.integers(-150, 150, (500, 2, 1)):
        assert cross(one, other).tobytes() == np.cross(one, other).tobytes()
        assert length(one) == np.linalg.norm(one)
