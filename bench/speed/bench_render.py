"""The whole of a picture."""

import pytest

import photonrelax as pr
from bench.speed import inputs


@pytest.mark.parametrize("method", ["standard", "parameterised"])
def test_render(timed, photons, n, n_threads, pixels, method):
    scene = inputs.scene(pixels)
    image = timed(
        lambda: pr.render(scene, photons=photons, method=method, n_threads=n_threads),
        n,
        f"render {n} {method=} {n_threads=}",
    )
    assert image.layers["caustic"].max() > 0.0
