"""Light in a cube of diffuse walls around a point emitter, by radiosity.

Walls are divided into squares of even radiosity. What a square sends to the middles of others is
exact (Lambert's formula for polygons), so the error is that of the division alone.
"""

import numpy as np


def squares(side, n):
    """Middles (6, n², 3), inward normals (6, 3) and corners (6, n², 4, 3) of the walls' squares.

    Wall 2a is that of the lowest coordinate on axis a, and wall 2a + 1 that of the greatest.
    """
    at = (np.arange(n) + 0.5) / n - 0.5
    u, v = (side * grid.ravel() for grid in np.meshgrid(at, at, indexing="ij"))
    half = 0.5 * side / n
    steps = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    middles, normals, corners = [], [], []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            middle = np.zeros((n * n, 3))
            middle[:, axis] = 0.5 * sign * side
            middle[:, (axis + 1) % 3], middle[:, (axis + 2) % 3] = u, v
            corner = np.repeat(middle[:, None], 4, axis=1)
            corner[:, :, (axis + 1) % 3] += steps[:, 0]
            corner[:, :, (axis + 2) % 3] += steps[:, 1]
            middles.append(middle)
            normals.append(-sign * np.eye(3)[axis])
            corners.append(corner)
    return np.array(middles), np.array(normals), np.array(corners)


def form_factors(points, normal, corners):
    """Irradiance (m, k) at points (m, 3) of a normal from polygons (k, 4, 3) of 1 W/m²."""
    towards = corners.transpose(2, 1, 0)[:, :, None] - points.T[:, None, :, None]
    towards /= np.sqrt(np.square(towards).sum(axis=0))
    total = 0.0
    for i in range(4):
        a, b = towards[:, i], towards[:, (i + 1) % 4]
        # The product a × b, coordinate by coordinate.
        across = np.array([a[j - 2] * b[j - 1] - a[j - 1] * b[j - 2] for j in range(3)])
        sine = np.sqrt(np.square(across).sum(axis=0))
        angle = np.arctan2(sine, (a * b).sum(axis=0))
        total = total + angle * np.tensordot(normal, across, 1) / sine
    return np.abs(total) / (2.0 * np.pi)


class Cube:
    """Radiosity of the squares of a cube around the origin.

    Parameters
    ----------
    side : float
        Of the cube.
    albedos : (6, 3)
        Of the walls.
    power, at : (3,), (3,)
        Of the emitter, W, and where it is.
    n : int
        Squares along a side.
    """

    def __init__(self, side, albedos, power, at=(0.0, 0.0, 0.0), n=10):
        self.middles, self.normals, self._corners = squares(side, n)
        m = n * n
        transfer = np.vstack([self._transfer(wall, self.middles[wall]) for wall in range(6)])
        away = np.asarray(at) - self.middles
        squared = (away**2).sum(axis=-1)
        cosine = np.einsum("wmc,wc->wm", away, self.normals) / np.sqrt(squared)
        direct = (cosine / (4.0 * np.pi * squared)).reshape(-1, 1) * np.asarray(power)
        albedo = np.repeat(np.asarray(albedos, dtype=float), m, axis=0)
        self._radiosity = np.empty_like(direct)
        for channel in range(3):
            reflected = np.eye(6 * m) - albedo[:, channel, None] * transfer
            emitted = albedo[:, channel] * direct[:, channel]
            self._radiosity[:, channel] = np.linalg.solve(reflected, emitted)

    def indirect(self, wall, points):
        """Indirect irradiance (m, 3) at points (m, 3) of a wall, W/m²."""
        return self._transfer(wall, points) @ self._radiosity

    def _transfer(self, wall, points):
        """Irradiance at points of a wall from each square of 1 W/m²; none from the same wall."""
        parts = [
            np.zeros((len(points), len(self.middles[0])))
            if other == wall
            else form_factors(points, self.normals[wall], self._corners[other])
            for other in range(6)
        ]
        return np.hstack(parts)
