"""The same bytes by threads, processes and clusters as by this process alone."""

import os
import shutil
import signal
import subprocess
import sys
from concurrent.futures import Executor, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import photonrelax as pr
from photonrelax._util.parcels import Parcel
from photonrelax._util.workers import WorkerLostError
from photonrelax.cli import main
from photonrelax.imaging.image import read_exr
from photonrelax.rendering.animation import Animation
from photonrelax.transport import splitting
from tests.helpers.executors import dask_cluster, loky_pool, shared_pool, spawned
from tests.helpers.tracing_scenes import SCENES
from tests.transport.test_trace import assert_same_bytes


@pytest.fixture(scope="module")
def dask():
    distributed = pytest.importorskip("distributed")
    with dask_cluster() as cluster, distributed.Client(cluster) as client:
        yield client.get_executor()


@pytest.fixture(scope="module", params=["threads", "processes", "loky", "dask"])
def executor(request):
    if request.param == "dask":
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


def test_an_envelope(executor, monkeypatch):
    monkeypatch.setattr(splitting, "_BATCH", 1000)
    three = SCENES["tinted glass, mirror, three emitters"]
    limits = {"n_rays": 5000, "n_photons": 9000}
    one = pr.trace_envelope(three, **limits)
    other = pr.trace_envelope(three, **limits, executor=executor)
    for name in ("position", "normal", "flux", "misplaced"):
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes()


@pytest.fixture(scope="module")
def image(scene):
    return pr.render(scene, **IMAGE)


IMAGE = {"n_emitted": 3000, "n_global": 3000, "supersampling": 1, "final_gather": 1}


def test_an_image(executor, scene, image):
    other = pr.render(scene, executor=executor, **IMAGE)
    assert_same_image(image, other)
    assert image.metadata == other.metadata


def test_a_crop_of_an_image(executor, scene, image):
    part = pr.render(scene, executor=executor, crop=(2, 5, 20, 11), **IMAGE)
    for name, layer in part.layers.items():
        np.testing.assert_array_equal(layer, image.layers[name][5:11, 2:20], err_msg=name)


def test_an_irradiance_map(executor, scene):
    field = pr.irradiance_field(pr.trace_photons(scene, 3000))
    place = (-1, -1, 0), (2, 0, 0), (0, 2, 0), (16, 16)
    one = pr.irradiance_map(field, *place)
    assert one.tobytes() == pr.irradiance_map(field, *place, executor=executor).tobytes()
    assert np.isfinite(one).all()


GLOBAL = pr.ProgressiveSettings(radius="global")


@pytest.mark.parametrize("settings", [None, GLOBAL])
@pytest.mark.parametrize("stochastic", [False, True])
def test_passes(executor, scene, settings, stochastic):
    how = {"photons_per_pass": 1000, "supersampling": 1, "n_global": 1000}
    how |= {"settings": settings, "stochastic": stochastic}
    one = pr.render_progressive(scene, n_passes=5, **how)
    assert_same_image(one, pr.render_progressive(scene, n_passes=5, executor=executor, **how))


def moving(time):
    return pr.gallery.scene("ring", pixels=12, sections=32)


def test_frames(executor):
    animation = Animation(moving, [0.0, 0.1, 0.2], n_emitted=1000, supersampling=1)
    frames = list(animation.frames(range(3), executor))
    for number, frame in enumerate(frames):
        assert_same_image(animation.frame(number), frame)


@pytest.mark.parametrize("settings", [None, GLOBAL])
def test_a_run_begun_here_is_resumed_by_workers(scene, settings, tmp_path):
    how = {"photons_per_pass": 1000, "supersampling": 1, "settings": settings}
    state = pr.Checkpoints(tmp_path / "run.npz")
    pr.render_progressive(scene, n_passes=2, checkpoints=state, **how)
    pool = shared_pool()
    resumed = pr.render_progressive(scene, n_passes=5, checkpoints=state, executor=pool, **how)
    assert_same_image(pr.render_progressive(scene, n_passes=5, **how), resumed)


class Killer(Executor):
    """An executor one of whose workers is killed when some tasks are done."""

    def __init__(self, executor, after):
        self.executor, self.after, self.done = executor, after, 0

    def submit(self, *arguments):
        future = self.executor.submit(*arguments)
        future.add_done_callback(self.count)
        return future

    def count(self, future):
        self.done += 1
        if self.done == self.after:
            self.kill()

    def kill(self):
        os.kill(next(iter(self.executor._processes)), signal.SIGKILL)


def test_a_run_whose_worker_is_killed_is_resumed_to_the_same_bytes(scene, tmp_path):
    how = {"photons_per_pass": 1000, "supersampling": 1, "n_passes": 30}
    state = pr.Checkpoints(tmp_path / "run.npz")
    with spawned() as pool, pytest.raises(WorkerLostError, match="a worker ended") as lost:
        pr.render_progressive(scene, checkpoints=state, executor=Killer(pool, 12), **how)
    assert "\n" not in str(lost.value)
    assert 0 < np.load(tmp_path / "run.npz")["n_passes"] < 30
    assert os.listdir(tmp_path) == ["run.npz"]
    resumed = pr.render_progressive(scene, checkpoints=state, executor=shared_pool(), **how)
    assert_same_image(pr.render_progressive(scene, **how), resumed)


def test_parts_whose_tracing_lost_a_worker_are_resumed_to_the_same_bytes(tmp_path):
    three = SCENES["tinted glass, mirror, three emitters"]
    how = {"chunk": 2000}
    with loky_pool(1) as pool, pytest.raises(WorkerLostError, match="a worker ended"):
        pr.trace_parts(three, 6000, tmp_path / "parts", executor=Killer(pool, 2), **how)
    begun = pr.PhotonParts.open(tmp_path / "parts")
    assert 0 < begun.n_traced < 6000
    resumed = pr.trace_parts(three, 6000, tmp_path / "parts", executor=shared_pool(), **how)
    one = pr.trace_parts(three, 6000, tmp_path / "one", **how)
    assert_same_bytes(one.photon_map(), resumed.photon_map())


def test_commands_take_the_address_of_a_scheduler(dask, tmp_path):
    arguments = ["irradiance", "ring", "--on", "floor", "--texels", "8", "--photons", "2000"]
    scheduler = ["--scheduler", dask._client.scheduler.address]
    for name, more in (("one", []), ("two", scheduler)):
        assert main([*arguments, "-o", str(tmp_path / f"{name}.exr"), "--quiet", *more]) == 0
    assert_same_image(*(read_exr(tmp_path / f"{name}.exr") for name in ("one", "two")))


def test_dask_runs_the_tasks_of_a_killed_worker_again(dask):
    three, pids = SCENES["tinted glass, mirror, three emitters"], dask._client.run(os.getpid)
    killer = Killer(dask, 2)
    killer.kill = lambda: os.kill(min(pids.values()), signal.SIGKILL)
    one = pr.trace_photons(three, 40_000, batch_size=1024)
    assert_same_bytes(one, pr.trace_photons(three, 40_000, batch_size=1024, executor=killer))
    dask._client.wait_for_workers(2)


def test_dask_scatters_what_workers_find_no_file_of(dask, monkeypatch):
    monkeypatch.setattr(Parcel, "write", lambda *_: None)
    sent = []
    scatter = dask._client.scatter
    monkeypatch.setattr(
        dask._client, "scatter", lambda *a, **named: sent.append(a) or scatter(*a, **named)
    )
    three = SCENES["tinted glass, mirror, three emitters"]
    one = pr.trace_photons(three, 9000, seed=5, batch_size=1024)
    assert_same_bytes(one, pr.trace_photons(three, 9000, seed=5, batch_size=1024, executor=dask))
    assert len(sent) == 1


MPI = """
import photonrelax as pr
from mpi4py import MPI
from mpi4py.futures import MPICommExecutor
with MPICommExecutor(MPI.COMM_WORLD, root=0) as executor:
    if executor is not None:
        photons = pr.trace_photons(pr.gallery.scene("ring"), 20_000, executor=executor)
        photons.save("photons.npz")
"""


def test_photons_traced_by_mpi(tmp_path):
    pytest.importorskip("mpi4py")
    folders = [str(Path(sys.executable).parent), os.environ["PATH"]]
    mpiexec = shutil.which("mpiexec", path=os.pathsep.join(folders))
    if mpiexec is None:
        pytest.skip("there is no mpiexec")
    (tmp_path / "job.py").write_text(MPI)
    command = [mpiexec, "-n", "3", sys.executable, "job.py"]
    subprocess.run(command, cwd=tmp_path, check=True, timeout=100)
    one = pr.trace_photons(pr.gallery.scene("ring"), 20_000)
    assert_same_bytes(one, pr.PhotonMap.load(tmp_path / "photons.npz"))
