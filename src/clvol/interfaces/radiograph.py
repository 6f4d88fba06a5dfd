"""Radiographs of a volume as functions of its pose: pictures and their derivatives, for 2-D/3-D registration."""

from __future__ import annotations

from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, Unpack

import numpy as np

from clvol.base.arrays import reals
from clvol.base.checks import number
from clvol.base.errors import OptionError
from clvol.march.options import as_size
from clvol.march.renderer import Renderer
from clvol.scene.camera import Camera
from clvol.scene.mode import Integral

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from clvol.march.options import FieldOptions
    from clvol.march.source import Drawable

__all__ = ["Radiograph"]

_SMALL = 1e-4  # radians below which the factors of rotations are those of their series
_AT_REST = (0.0,) * 6


class Radiograph:
    """The line integrals of a volume along the rays of a camera, as a function of the volume's pose.

    A pose is six numbers: a translation along x, y and z of the world, in its units, and a rotation about the volume's centre, as a
    vector along its axis whose length is the angle in radians (`scipy.spatial.transform.Rotation.from_rotvec`). The volume is
    rotated, then moved; the camera stays.

    Parameters
    ----------
    volume : Volume, array-like or Field
        In memory, with all its samples.
    camera : Camera, optional
        The source, if it is in perspective, at the eye, and the detector, perpendicular to the view. By default as of
        `clvol.render`. It does not move if it is fitted to the volume: where it then stands for the pose at rest, it stays.
    size : (width, height)
        In pixels.
    step : float
        The most that a ray advances between samples, in voxels.
    mu_water : float, optional
        Values are Hounsfield units, and their attenuation is integrated: see `Integral`.
    **options
        `filter`, `boundary`, `device`: see `Renderer`.

    Raises
    ------
    OptionError
        The volume is not in memory or lacks samples, or an option is not allowed.

    Notes
    -----
    Derivatives are those of the integrals, by the gradient of the spline along the rays, and by the faces of the volume, which move
    too. They are exact but for the sums over samples, and jump where a ray meets an edge of the volume between values that differ
    from 0.

    Examples
    --------
    One step of Gauss and Newton towards the pose in which the volume looks like ``fixed``:

    >>> import clvol, numpy as np
    >>> volume = clvol.phantoms.marschner_lobb(24)
    >>> with clvol.Radiograph(volume, clvol.Camera.orbit(30, 20), (32, 32)) as radiograph:
    ...     fixed = radiograph((0.02, 0, 0, 0, 0, 0.01))
    ...     picture, slopes = radiograph.gradient((0, 0, 0, 0, 0, 0))
    >>> pose, *_ = np.linalg.lstsq(slopes.reshape(-1, 6), (fixed - picture).ravel(), rcond=None)
    """

    def __init__(
        self,
        volume: Drawable,
        camera: Camera | None = None,
        size: tuple[int, int] = (512, 512),
        step: float = 1.0,
        *,
        mu_water: float | None = None,
        **options: Unpack[FieldOptions],
    ) -> None:
        self.size, self.step, self.mode = as_size(size), number("step", step, above=0), Integral(mu_water)
        self._renderer = Renderer(volume, **options)
        try:
            if len(self._renderer.scene.media) > 1:
                raise OptionError(f"a radiograph must be of one volume; got a scene of {len(self._renderer.scene.media)}")
            self._center = self._renderer.volume.center
            small = self._renderer.render(camera, self.mode, (1, 1), self.step, outputs=["value", "pose"])
            width, height = self.size
            fitted = small["value"].camera
            assert fitted is not None
            self._camera, self._view = fitted, fitted.view(self._renderer.volume, width / height)
        except BaseException:
            self.close()
            raise

    def __call__(self, pose: ArrayLike = _AT_REST) -> NDArray[np.float32]:
        """The line integrals, 0 where rays miss the volume; (height, width). `OptionError` if a pose is no six finite numbers."""
        return np.asarray(self._rendered(_six(pose), "value"))

    def gradient(self, pose: ArrayLike = _AT_REST) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The line integrals, and their derivatives by the pose's six numbers, (height, width, 6), in one march."""
        six = _six(pose)
        found = self._rendered(six, ["value", "pose"])
        moved = np.asarray(found["pose"])  # by motions in the volume's own frame
        turn = _rotation(six[3:])
        by_pose = np.concatenate([moved[..., :3] @ turn.T, moved[..., 3:] @ _turned(six[3:])], -1)
        return np.asarray(found["value"]), by_pose.astype(np.float32)

    def camera(self, pose: ArrayLike = _AT_REST) -> Camera:
        """The camera that sees the volume at rest as this one sees it in a pose."""
        six, view = _six(pose), self._view
        back = _rotation(six[3:]).T
        away = float(np.linalg.norm(self._center - view.eye))
        eye = back @ (view.eye - self._center - six[:3]) + self._center
        place, target, up = (tuple(map(float, at)) for at in (eye, eye + away * (back @ view.forward), back @ view.up))
        given = self._camera
        radius = view.half_height * given.zoom * min(1.0, self.size[0] / self.size[1])
        return Camera(place, target, up, projection=given.projection, fov=given.fov, zoom=given.zoom, radius=radius)  # type: ignore[arg-type]  # three

    def _rendered(self, six: NDArray[np.float64], outputs: Any) -> Any:
        how = {"outputs": outputs, "window": (0.5, 1.0), "background": None}  # nobody sees the colours
        return self._renderer.render(self.camera(six), self.mode, self.size, self.step, **how)

    def close(self) -> None:
        """Free the device's memory, except that of a Field which was given."""
        self._renderer.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


def _six(pose: ArrayLike) -> NDArray[np.float64]:
    rule = "six finite numbers, a translation and a rotation vector"
    six = reals("pose", pose, rule)
    if six.shape != (6,) or not np.isfinite(six).all():
        raise OptionError(f"pose must be {rule}; got {pose!r}")
    return six


def _across(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """The matrix of a cross product with a vector."""
    x, y, z = vector
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def _rotation(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """The matrix of a rotation vector."""
    from scipy.spatial.transform import Rotation  # which takes long to import

    return np.asarray(Rotation.from_rotvec(vector.copy()).as_matrix())  # SciPy refuses arrays that are read-only


def _turned(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """How fast a body turns, in its own frame, as each number of its rotation vector changes: the right Jacobian."""
    across = _across(vector)
    cosine, rest = _factors(float(np.linalg.norm(vector)))
    return np.asarray(np.eye(3) - cosine * across + rest * across @ across)


def _factors(angle: float) -> tuple[float, float]:
    """The series (1 - cos a) / a² and (a - sin a) / a³."""
    if angle < _SMALL:
        return 0.5 - angle**2 / 24, 1 / 6 - angle**2 / 120
    return float(1 - np.cos(angle)) / angle**2, float(angle - np.sin(angle)) / angle**3
