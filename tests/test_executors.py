"""The same bytes by threads, processes and clusters as by this process alone."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import photonrelax as pr
from tests.helpers.executors import dask_cluster, loky_pool, shared_pool
from tests.helpers.tracing_scenes import SCENES
from tests.transport.test_trace import assert_same_bytes


@pytest.fixture(scope="module")
def dask():
    from distributed import Client

    with dask_cluster() as cluster, Client(cluster) as client:
        yield client.get_executor()


@pytest.fixture(scope="module", params=["threads", "processes", "loky", "dask"])
def executor(request):
    if request.param == "dask":
        pytest.importorskip("distributed")
        yield request.getfixturevalue("dask")
    elif request.param == "processes":
        yield shared_pool()
    else:
        with {"threads": lambda: ThreadPoolExecutor(2), "loky": loky_pool}[request.param]() as pool:
            yield pool


@pytest.fixture(scope="module")
def scene():
    ring = pr.gallery.scene("ring")
    camera = pr.Camera(ring.camera.origin, ring.camera.target, width=24, height=18)
    return pr.Scene(ring.objects, ring.emitters, camera)


def assert_same_image(one, other):
    assert one.layers.keys() == other.layers.keys()
    for name, layer in one.layers.items():
        assert layer.tobytes() == other.layers[name].tobytes(), name


@pytest.mark.parametrize("paths", ["caustic", "all"])
def test_traced_photons(executor, paths):
    three = SCENES["tinted glass, mirror, three emitters"]
    settings = {"paths": paths, "batch_size": 1024}
    one = pr.trace_photons(three, 9000, **settings)
    assert_same_bytes(one, pr.trace_photons(three, 9000, **settings, executor=executor))
    part = {**settings, "photons": range(5, 8000)}
    one = pr.trace_photons(three, 9000, **part)
    assert_same_bytes(one, pr.trace_photons(three, 9000, **part, executor=executor))


@pytest.fixture(scope="module")
def image(scene):
    return pr.render(scene, n_emitted=3000, supersampling=1)


def test_an_image(executor, scene, image):
    other = pr.render(scene, n_emitted=3000, supersampling=1, executor=executor)
    assert_same_image(image, other)
    assert image.metadata == other.metadata


def test_an_irradiance_map(executor, scene):
    field = pr.irradiance_field(pr.trace_photons(scene, 3000))
    place = (-1, -1, 0), (2, 0, 0), (0, 2, 0), (16, 16)
    one = pr.irradiance_map(field, *place)
    assert one.tobytes() == pr.irradiance_map(field, *place, executor=executor).tobytes()
    assert np.isfinite(one).all()
