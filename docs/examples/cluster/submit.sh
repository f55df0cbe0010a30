#!/usr/bin/env bash
# Submits everything, each job to begin when the one before it has succeeded: bash submit.sh
set -euo pipefail
cd "$(dirname "$0")"
. ./settings.sh
mkdir -p "$WORK"

build=$(sbatch --parsable --array="1-$SHARDS" build.slurm)
table=$(sbatch --parsable --dependency="afterok:$build" merge-table.slurm)
run=$(sbatch --parsable --dependency="afterok:$table" --array="1-$SHARDS" run.slurm)
board=$(sbatch --parsable --dependency="afterok:$run" merge-run.slurm)
echo "submitted: build $build, table $table, run $run, board $board"
