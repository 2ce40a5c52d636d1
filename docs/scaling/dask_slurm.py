"""Render on a SLURM cluster by way of Dask: ``python dask_slurm.py`` on a login node.

Needs photonrelax[distributed] and dask-jobqueue, the same versions on all nodes. `TMPDIR` should be
a folder that all nodes see: values that tasks share are then mapped from there, and not sent.
"""

from dask_jobqueue import SLURMCluster
from distributed import Client

import photonrelax as pr

NODES, CORES = 100, 16

if __name__ == "__main__":
    cluster = SLURMCluster(
        cores=CORES,
        processes=CORES,  # one-thread workers
        memory="64GB",
        walltime="01:00:00",
        interface="ib0",
    )
    cluster.scale(jobs=NODES)
    scene = pr.gallery.scene("pool")
    with Client(cluster) as client:
        # Passes are begun with the workers that are there; others join.
        client.wait_for_workers(CORES)
        image = pr.render_progressive(
            scene,
            n_passes=10_000,
            photons_per_pass=1_000_000,
            settings=pr.ProgressiveSettings(radius="global"),
            checkpoints=pr.Checkpoints("pool.npz"),
            executor=client.get_executor(),
        )
    image.write_exr("pool.exr")
