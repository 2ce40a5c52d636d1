"""In constant light from all around, white things cannot be told from the background."""

import numpy as np
import pytest

import photonrelax as pr
from tests.helpers.tracing_scenes import ball

RADIANCE = (1.0, 2.0, 0.5)
N_PIXELS = 64


def balls(**materials):
    """Balls side by side, some of them touching nothing."""
    return [
        pr.SceneObject(ball(0.5, [1.1 * i, 0, 0], 5), material, name, smooth=True)
        for i, (name, material) in enumerate(materials.items())
    ]


@pytest.mark.parametrize(
    "objects",
    [
        balls(white=pr.Diffuse(1.0)),
        balls(mirror=pr.Mirror(1.0), white=pr.Diffuse(1.0)),
        balls(glass=pr.Dielectric(1.5), white=pr.Diffuse(1.0)),
        balls(white=pr.Diffuse(1.0), mirror=pr.Mirror(1.0), glass=pr.Dielectric(1.5)),
    ],
    ids=lambda objects: "+".join(item.name for item in objects),
)
def test_all_is_as_bright_as_the_background(objects):
    middle = 0.55 * (len(objects) - 1)
    size = dict.fromkeys(("width", "height"), N_PIXELS)
    camera = pr.Camera((middle, -6, 1), (middle, 0, 0), vertical_fov=35.0, **size)
    scene = pr.Scene(objects, [pr.EnvironmentEmitter(RADIANCE)], camera)
    image = pr.render(scene, n_emitted=150_000, n_global=150_000, max_depth=32)
    blocks = image.layers["radiance"].reshape(4, 16, 4, 16, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(blocks, np.broadcast_to(RADIANCE, blocks.shape), rtol=0.01)
