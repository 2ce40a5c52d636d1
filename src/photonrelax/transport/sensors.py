"""Photons on sensors: where rays cross them on the way to the next surface.

Sensors are in none of the geometry that rays of paths and cameras hit. Each has a ray caster of its
own, with the resolution of its own size, in which the rays of a pass are followed from crossing to
crossing, as far as the surfaces that they hit. So paths and their random numbers are the same with
and without sensors, and sensors may lie in one another.
"""

from __future__ import annotations

from .._ext.transport.raycast import EmbreeHits
from .._ext.transport.trace import Paths
from ..scene.scene import Scene
from .raycast import RayCaster


def sensor_casters(scene: Scene) -> list[RayCaster]:
    """Ray casters of the sensors of a scene, one of each."""
    return [RayCaster(scene.objects, [sensor]) for sensor in scene.sensors]


def store_crossings(sensors: list[RayCaster], paths: Paths, found: EmbreeHits) -> None:
    """Store photons where live rays cross sensors, up to the surfaces that embree found."""
    rows, origin, direction = paths.stored_rays()
    for sensor in sensors:
        crossing, way, hits = rows, direction, sensor.intersect(origin, direction)
        while hits.hit.any():
            ahead = paths.cross(found, crossing, hits)
            crossing, way, hits = crossing[ahead], way[ahead], hits[ahead]
            hits = sensor.intersect(hits.position, way, origin_offset=hits.offset)
