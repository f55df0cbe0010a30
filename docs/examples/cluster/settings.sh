# What all jobs share. Copy this folder, and change what stands here.
# shellcheck shell=bash disable=SC2034

DATASET=adt
ROOT=${ROOT:-/data/ADT}                    # your copy of the dataset, the same path on every node
WORK=${WORK:-/scratch/$USER/prbench}       # shards, tables and runs: a file system that all nodes share
SHARDS=${SHARDS:-16}

METHOD=static
CONDITION=none
DEVICE=cpu                                 # cuda for a method that uses a GPU; then run.slurm asks for one

TABLE=$WORK/tables/$DATASET
RUN=$WORK/runs/$METHOD-$CONDITION

export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
# A cache of each node's own: what it holds is made again where it is missing.
export PRBENCH_CACHE=${PRBENCH_CACHE:-${TMPDIR:-/tmp}/prbench-$USER}

# Where prbench is: a virtual environment,
if [ -n "${PRBENCH_ENVIRONMENT:-}" ]; then . "$PRBENCH_ENVIRONMENT/bin/activate"; fi
# or a container, for every job alike:
# prbench() { apptainer exec --bind /data,/scratch "$HOME/prbench.sif" prbench "$@"; }

# Exit code 3 says that a recording could not be read. It is named in the log, and the others go on.
allow_unreadable() {
  local code=0
  "$@" || code=$?
  if [ "$code" -eq 3 ]; then code=0; fi
  return "$code"
}
