"""Time of tracing inside embree: its scenes are replaced by timed ones."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from time import perf_counter, process_time
from typing import Any

import embreex.mesh_construction  # noqa: F401  (it must see the original scene first)
from embreex import rtcore_scene


@dataclass
class EmbreeClock:
    """Seconds inside embree on one thread, and the time of the first call of several rays."""

    wall: float = 0.0
    cpu: float = 0.0
    first_wall: float = 0.0
    first_cpu: float = 0.0

    def add(self, wall: float, cpu: float) -> None:
        if not self.first_wall:
            self.first_wall, self.first_cpu = wall, cpu
        self.wall += perf_counter() - wall
        self.cpu += process_time() - cpu


@contextmanager
def embree_clock() -> Iterator[EmbreeClock]:
    """Time the calls of scenes made inside the block, on one thread."""
    clock, original = EmbreeClock(), rtcore_scene.EmbreeScene

    class TimedScene(original):  # type: ignore[misc, valid-type]
        def run(self, origins: Any, *others: Any, **options: Any) -> Any:
            cpu, wall = process_time(), perf_counter()
            found = super().run(origins, *others, **options)
            # The one ray that completes a scene builds its hierarchy: that is not tracing.
            if len(origins) > 1:
                clock.add(wall, cpu)
            return found

    rtcore_scene.EmbreeScene = TimedScene
    try:
        yield clock
    finally:
        rtcore_scene.EmbreeScene = original
