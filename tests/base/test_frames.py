"""World frames, units of length and names of axes: one home each."""

from __future__ import annotations

import numpy as np
import pytest

from clvol.base.axes import AXES, meaning
from clvol.base.errors import GeometryError, OptionError
from clvol.base.frames import affine_parts, flipped, from_ras, in_frame, ras_affine
from clvol.base.units import METRES, axes_unit, millimetres, unit_name

POINTS = np.random.default_rng(0).normal(size=(7, 3))


def test_flipped_is_its_own_inverse_and_has_no_negative_zero() -> None:
    np.testing.assert_array_equal(flipped(POINTS), POINTS * [-1, -1, 1])
    np.testing.assert_array_equal(flipped(flipped(POINTS)), POINTS)
    assert not np.signbit(flipped(np.zeros(3))).any()


def test_only_patient_space_has_ras() -> None:
    np.testing.assert_array_equal(in_frame(POINTS, "RAS", "LPS"), flipped(POINTS))
    assert in_frame(POINTS, "LPS", "image") is POINTS
    with pytest.raises(OptionError, match="whose space is 'image'"):
        in_frame(POINTS, "RAS", "image")


@pytest.mark.parametrize("d", [2, 3])
def test_an_affine_in_ras_round_trips(d: int) -> None:
    rng = np.random.default_rng(d)
    spacing, origin, direction = rng.uniform(0.5, 2, d), rng.normal(size=d), np.linalg.qr(rng.normal(size=(d, d))).Q
    affine = ras_affine(spacing, origin, direction)
    about = from_ras(affine_parts(affine[:3, :3], affine[:3, 3]), d, 1.0)
    for name, wanted in (("spacing", spacing), ("origin", origin), ("direction", direction)):
        np.testing.assert_allclose(about[name], wanted, rtol=0, atol=1e-14)


def test_units_have_one_name() -> None:
    assert {unit_name(text) for text in ("µm", "Micron", " micrometre ", "um")} == {"um"}
    assert axes_unit(["um", "micron"]) == "um"
    assert axes_unit(["mm", "s"]) == axes_unit(["pixel", "dimensionless"]) == ""
    assert [millimetres(unit) for unit in ("", "mm", "cm")] == [1.0, 1.0, METRES["cm"] / METRES["mm"]]
    with pytest.raises(GeometryError, match="one unit of length"):
        axes_unit(["mm", "um"])
    with pytest.raises(GeometryError, match="units must be a length"):
        millimetres("s")


def test_axes_have_one_meaning() -> None:
    assert [meaning(word) for word in ("T", "frames", "Channel", "scene", "depth", "what")] == [
        "time",
        "time",
        "channel",
        "position",
        "z",
        "",
    ]
    assert {meaning(axis) for axis in AXES} == set(AXES)
