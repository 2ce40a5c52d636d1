"""Optics of smooth surfaces for arrays: reflection, refraction, Fresnel and Beer–Lambert.

Normals face against the incoming direction; indices are those of the side the ray comes from
(`n1`) and of the other side (`n2`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._ext.transport import optics as _kernel
from .._util.parallel import thread_count
from .._util.validation import Floats, float_array, unit_vectors

# Rounding error allowed in cosines, beyond [0, 1].
_COSINE_SLACK = 1e-9


def fresnel(
    cos_i: ArrayLike, n1: ArrayLike, n2: ArrayLike, *, n_threads: int | None = None
) -> Floats:
    """Fresnel reflectance of a smooth interface for unpolarised light.

    Parameters
    ----------
    cos_i : array_like
        Cosine of the angle of incidence, in [0, 1].
    n1, n2 : array_like
        Index of refraction on the side of the light and on the other side; broadcast with `cos_i`.
    n_threads : int, optional
        Threads to use; None for all cores.

    Returns
    -------
    array of float64
        In [0, 1], of the broadcast shape; 1 where all light is reflected.

    Raises
    ------
    ValueError
        If a cosine is not in [0, 1] or an index is not positive.
    """
    cosine = float_array(cos_i, "cos_i")
    if (np.abs(cosine - 0.5) > 0.5 + _COSINE_SLACK).any():
        worst = cosine.ravel()[np.abs(cosine - 0.5).argmax()]
        raise ValueError(f"cos_i should lie in [0, 1], but one is {worst}")
    first, second = _index(n1, "n1"), _index(n2, "n2")
    shape = np.broadcast_shapes(cosine.shape, first.shape, second.shape)
    out = np.empty(int(np.prod(shape)))
    _kernel.fresnel(
        _rows(np.clip(cosine, 0.0, 1.0), shape).ravel(),
        _rows(first, shape).ravel(),
        _rows(second, shape).ravel(),
        out,
        thread_count(n_threads),
    )
    return out.reshape(shape)


def reflect(direction: ArrayLike, normal: ArrayLike, *, n_threads: int | None = None) -> Floats:
    """Mirror direction of each ray.

    Parameters
    ----------
    direction, normal : (n, 3) array_like
        Directions of propagation and surface normals; need not be of unit length.
    n_threads : int, optional
        Threads to use; None for all cores.

    Returns
    -------
    (n, 3) float64
        Unit directions.

    Raises
    ------
    TypeError, ValueError
        If an argument is not finite, of the wrong shape, or a vector is zero.
    """
    rays = unit_vectors(direction, "direction", (None, 3))
    normals = unit_vectors(normal, "normal", (len(rays), 3))
    out = np.empty_like(rays)
    _kernel.reflect(rays, normals, out, thread_count(n_threads))
    return out


def refract(
    direction: ArrayLike,
    normal: ArrayLike,
    n1: ArrayLike,
    n2: ArrayLike,
    *,
    n_threads: int | None = None,
) -> tuple[Floats, NDArray[np.bool_]]:
    """Refracted direction of each ray, by Snell's law.

    Parameters
    ----------
    direction, normal : (n, 3) array_like
        Directions of propagation and normals facing against them; need not be of unit length.
    n1, n2 : (n,) array_like or float
        Index of refraction on the side of the ray and on the other side.
    n_threads : int, optional
        Threads to use; None for all cores.

    Returns
    -------
    direction : (n, 3) float64
        Unit directions; NaN where all light is reflected.
    ok : (n,) bool
        False where all light is reflected.

    Raises
    ------
    TypeError, ValueError
        If an argument is not finite, of the wrong shape, a vector is zero, a normal does not face
        against its ray, or an index is not positive.
    """
    rays = unit_vectors(direction, "direction", (None, 3))
    normals = unit_vectors(normal, "normal", (len(rays), 3))
    facing = -np.einsum("ij,ij->i", rays, normals)
    if (facing < -_COSINE_SLACK).any():
        bad = int(facing.argmin())
        raise ValueError(
            f"normal should face against direction, but in row {bad} the cosine of incidence "
            f"is {facing[bad]}"
        )
    out, ok = np.empty_like(rays), np.empty(len(rays), np.uint8)
    first = _rows(_index(n1, "n1"), facing.shape)
    second = _rows(_index(n2, "n2"), facing.shape)
    _kernel.refract(rays, normals, first, second, out=out, ok=ok, n_threads=thread_count(n_threads))
    return out, ok.view(np.bool_)


def beer_lambert(
    absorption: ArrayLike, distance: ArrayLike, *, n_threads: int | None = None
) -> Floats:
    """Transmittance exp(-absorption · distance) of an absorbing medium.

    Parameters
    ----------
    absorption : (3,) or (n, 3) array_like
        Absorption coefficient per channel, 1/m.
    distance : (n,) array_like
        Length travelled in the medium, m.
    n_threads : int, optional
        Threads to use; None for all cores.

    Returns
    -------
    (n, 3) float64
        In [0, 1].

    Raises
    ------
    TypeError, ValueError
        If an argument is not finite, negative or of the wrong shape.
    """
    lengths = float_array(distance, "distance", (None,))
    coefficient = float_array(absorption, "absorption")
    if coefficient.shape not in ((3,), (len(lengths), 3)):
        raise ValueError(
            f"absorption should have shape (3) or ({len(lengths)}, 3), but has {coefficient.shape}"
        )
    for array, name in ((coefficient, "absorption"), (lengths, "distance")):
        if (array < 0.0).any():
            raise ValueError(f"{name} should not be negative, but its least is {array.min()}")
    out = np.empty((len(lengths), 3))
    _kernel.beer_lambert(_rows(coefficient, out.shape), lengths, out, thread_count(n_threads))
    return out


def from_behind(direction: Floats, geometric_normal: Floats) -> NDArray[np.bool_]:
    """True for rays (n, 3) that meet the back of their face, (n,)."""
    behind: NDArray[np.bool_] = np.einsum("ij,ij->i", direction, geometric_normal) > 0.0
    return behind


def _index(value: ArrayLike, name: str) -> Floats:
    array = float_array(value, name)
    if not (array > 0.0).all():
        raise ValueError(f"{name} should be positive, but its least value is {array.min()}")
    return array


def _rows(array: Floats, shape: tuple[int, ...]) -> Floats:
    return np.ascontiguousarray(np.broadcast_to(array, shape))
