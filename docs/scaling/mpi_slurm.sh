#!/bin/sh
#SBATCH --job-name=pool
#SBATCH --nodes=100
#SBATCH --ntasks-per-node=16
#SBATCH --cpus-per-task=1
#SBATCH --time=01:00:00
# A folder that all nodes see: values that tasks share are mapped from there, and not sent.
export TMPDIR="$SLURM_SUBMIT_DIR/tmp"
mkdir -p "$TMPDIR"
# A job that was ended goes on from pool.npz when it is submitted again.
srun python mpi_render.py
