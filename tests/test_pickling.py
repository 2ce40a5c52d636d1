"""Objects sent to other processes are the same there to the bit."""

import pickle

import numpy as np
import pytest

import photonrelax as pr
from photonrelax._util.parcels import Parcel
from photonrelax.estimation.methods import METHODS
from photonrelax.photons.photon_map import NothingStoredError
from photonrelax.rendering.final_gather import FinalGather
from photonrelax.rendering.view import View
from photonrelax.transport.raycast import RayCaster


def copy_of(value):
    return pickle.loads(pickle.dumps(value))


@pytest.fixture(scope="module")
def scene():
    return pr.gallery.scene("ring")


@pytest.fixture(scope="module")
def photons(scene):
    return pr.trace_photons(scene, 2000, frequency_share=0.1)


def field_of(method, photons, scene):
    elements = pr.trace_envelope(scene, n_rays=1000) if method == "envelope" else photons
    return pr.irradiance_field(elements, method=method, scene=scene)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.filterwarnings("ignore:.*no surface of the scene.*:UserWarning")
def test_a_field(method, scene, photons):
    field = field_of(method, photons, scene)
    points, normals = photons.position[:100], photons.normal[:100]
    # What was evaluated before is not sent along.
    unused = Parcel(field).digest
    expected = field(points, normals), field(points, normals, footprint=np.full(100, 0.05))
    assert Parcel(field).digest == unused
    copy = copy_of(field)
    np.testing.assert_array_equal(copy(points, normals), expected[0])
    np.testing.assert_array_equal(copy(points, normals, footprint=np.full(100, 0.05)), expected[1])


@pytest.mark.parametrize("n_metric", [2, 4])
@pytest.mark.parametrize("n", [0, 1, 500])
def test_a_tree(n, n_metric):
    points = np.random.default_rng(n).random((n, 4))
    tree = pr.KDTree(points, n_metric)
    copy = copy_of(tree)
    for name in ("ids", "coords"):
        one, other = (np.asarray(getattr(each.kernel, name)) for each in (tree, copy))
        np.testing.assert_array_equal(one, other)
    assert copy.n_metric == n_metric


def test_a_photon_map(photons):
    copy = copy_of(photons)
    np.testing.assert_array_equal(copy.spectrum, photons.spectrum)
    assert copy.ledger.to_dict() == photons.ledger.to_dict()
    assert copy.paths == "caustic"


def test_a_caster_is_built_once_for_equal_objects(scene):
    caster = RayCaster(scene.surfaces)
    copy = copy_of(caster)
    assert copy is copy_of(RayCaster(scene.surfaces))
    assert copy is not copy_of(RayCaster(scene.surfaces, [0]))
    origins, down = np.random.default_rng(0).random((100, 3)), np.tile([0.0, 0.0, -1.0], (100, 1))
    one, other = (each.intersect(origins, down) for each in (caster, copy))
    np.testing.assert_array_equal(one.position, other.position)


def test_a_view_and_a_final_gather(scene, photons):
    small = pr.Camera(scene.camera.origin, scene.camera.target, width=8, height=6)
    view = View(pr.Scene(scene.objects, scene.emitters, small), supersampling=1, n_threads=1)
    gather = FinalGather(view, photons, 4, seed=0)
    other_view, other_gather = copy_of((view, gather))
    (band,), (other,) = view.bands(), other_view.bands()
    np.testing.assert_array_equal(band.hits.position, other.hits.position)
    for found, expected in zip(gather(band), other_gather(other), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_an_error_with_its_photons(photons):
    error = copy_of(NothingStoredError("nothing", photons))
    assert str(error) == "nothing"
    assert len(error.photons) == len(photons)
