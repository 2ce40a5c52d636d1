"""Pinhole and orthographic cameras, and the rays of their pixels."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._ext.scene.camera import film_points, film_samples
from .._util.frozen import frozen, set_field
from .._util.parcels import state_without_caches
from .._util.validation import MAX_REPEATS, Floats, count, float_array, positive, unit_vectors

# Sine of the smallest angle between a camera's `up` and its line of sight.
_MIN_UP_SINE = 1e-6


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera, or an orthographic one.

    Parameters
    ----------
    origin, target : (3,)
        Position of the camera, and the point at the centre of the image, m.
    up : (3,)
        The direction that is up in the image; not along the line of sight.
    vertical_fov : float
        Angle between the lower and upper edge of the image, degrees, below 180.
    width, height : int
        Pixels.
    orthographic_height : float, optional
        Height of the image in m; makes the camera orthographic and `vertical_fov` void.
    """

    origin: ArrayLike
    target: ArrayLike
    up: ArrayLike = (0.0, 0.0, 1.0)
    vertical_fov: float = 45.0
    width: int = 600
    height: int = 600
    orthographic_height: float | None = None

    def __post_init__(self) -> None:
        set_field(self, "origin", frozen(float_array(self.origin, "origin", (3,))))
        set_field(self, "target", frozen(float_array(self.target, "target", (3,))))
        set_field(self, "up", frozen(unit_vectors(self.up, "up", (3,))))
        set_field(self, "vertical_fov", positive(self.vertical_fov, "vertical_fov"))
        if self.vertical_fov >= 180.0:
            raise ValueError(
                f"vertical_fov should be below 180 degrees, but is {self.vertical_fov}"
            )
        set_field(self, "width", count(self.width, "width", high=MAX_REPEATS))
        set_field(self, "height", count(self.height, "height", high=MAX_REPEATS))
        if self.orthographic_height is not None:
            height = positive(self.orthographic_height, "orthographic_height")
            set_field(self, "orthographic_height", height)
        self.axes()

    __getstate__ = state_without_caches

    def axes(self) -> tuple[Floats, Floats, Floats]:
        """Return the unit vectors to the right, up and forward of the image.

        Raises
        ------
        ValueError
            If the target is at the origin, or `up` is along the line of sight.
        """
        return self._axes

    @cached_property
    def _axes(self) -> tuple[Floats, Floats, Floats]:
        sight = np.subtract(self.target, self.origin)
        if not sight.any():
            both = np.asarray(self.target)
            raise ValueError(f"target should differ from origin, but both are {both}")
        forward = unit_vectors(sight, "target - origin", (3,))
        up = np.asarray(self.up)
        right = np.cross(forward, up)
        if np.linalg.norm(right) < _MIN_UP_SINE:
            raise ValueError(
                f"up should not be along the line of sight, but is {up} looking along {forward}"
            )
        right /= np.linalg.norm(right)
        return frozen(right), frozen(np.cross(right, forward)), frozen(forward)


def pixel_rays(
    camera: Camera,
    rows: range,
    supersampling: int = 1,
    *,
    offset: tuple[float, float] = (0.5, 0.5),
    columns: range | None = None,
) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Return the rays of some rows of the image, row 0 at the top.

    Parameters
    ----------
    camera : Camera
        Pinhole or orthographic.
    rows : range
        Rows of pixels.
    supersampling : int
        s·s samples per pixel, on a regular grid.
    offset : (float, float)
        Position of samples in the cells of that grid, to the right and down, in [0, 1).
    columns : range, optional
        Of the pixels of these rows, by default all.

    Returns
    -------
    origins, directions : (m, 3)
        Unit directions; the samples of a pixel follow one another.
    pixel : (m,) int64
        Index of the pixel, row · width + column.

    Raises
    ------
    ValueError
        If there are no rows or columns, or some that are not in the image.
    """
    columns = range(camera.width) if columns is None else columns
    _check_pixels(rows, "rows", camera.height)
    _check_pixels(columns, "columns", camera.width)
    s = count(supersampling, "supersampling", high=MAX_REPEATS)
    x, y, pixel = film_samples(
        *(np.asarray(rows), np.asarray(columns), camera.width, camera.height),
        side=s,
        right=offset[0],
        down=offset[1],
    )
    return *_film_rays(camera, x, y), pixel


def _check_pixels(some: range, name: str, n: int) -> None:
    if not len(some) or min(some) < 0 or max(some) >= n:
        raise ValueError(f"{name} should be some of [0, {n}), but are {some}")


def places_of(
    pixel: NDArray[np.int64], rows: range, columns: range, width: int
) -> NDArray[np.int64]:
    """Indices (m,) in a part of an image, of some rows and columns, of pixels (m,) of the image."""
    if len(columns) == width:
        return pixel - rows.start * width
    row, column = np.divmod(pixel, width)
    return (row - rows.start) * len(columns) + column - columns.start


def sample_changes(camera: Camera, supersampling: int) -> tuple[Floats, Floats]:
    """Changes (2, 3) over the width and the height of a sample, to the right and down.

    Of the origins of rays, and of the points where they cross a film at a distance of 1 m.
    """
    right, up, _ = camera.axes()
    changes = 2.0 / (camera.height * supersampling) * np.array([right, -up])
    if camera.orthographic_height is not None:
        return 0.5 * camera.orthographic_height * changes, np.zeros((2, 3))
    return np.zeros((2, 3)), np.tan(np.radians(0.5 * camera.vertical_fov)) * changes


def film_corners(camera: Camera) -> Floats:
    """Origins (4, 3) of the rays at the corners of the image."""
    x, y = np.meshgrid([-1.0, 1.0], [-1.0, 1.0])
    x *= camera.width / camera.height
    return _film_rays(camera, x.ravel(), y.ravel())[0]


def _film_rays(camera: Camera, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Origins and unit directions of rays at film coordinates (m,), in half heights."""
    right, up, forward = camera.axes()
    origin = np.asarray(camera.origin)
    if camera.orthographic_height is not None:
        half = 0.5 * camera.orthographic_height
        origins = film_points(x, y, centre=origin, right=right, up=up, half_height=half, unit=False)
        return origins, np.tile(forward, (len(x), 1))
    half = np.tan(np.radians(0.5 * camera.vertical_fov))
    directions = film_points(x, y, centre=forward, right=right, up=up, half_height=half, unit=True)
    return np.tile(origin, (len(x), 1)), directions
