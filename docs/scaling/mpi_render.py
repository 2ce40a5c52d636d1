"""Render on all ranks of an MPI job but the first, which has the scene and the image."""

from mpi4py import MPI
from mpi4py.futures import MPICommExecutor

import photonrelax as pr

if __name__ == "__main__":
    with MPICommExecutor(MPI.COMM_WORLD, root=0) as executor:
        if executor is not None:
            image = pr.render_progressive(
                pr.gallery.scene("pool"),
                n_passes=10_000,
                photons_per_pass=1_000_000,
                settings=pr.ProgressiveSettings(radius="global"),
                checkpoints=pr.Checkpoints("pool.npz"),
                executor=executor,
            )
            image.write_exr("pool.exr")
