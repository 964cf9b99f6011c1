#!/bin/bash
# Fits each object below OBJECTS whose folder has a scene.ron as a task of a Slurm array, on a file system that all nodes share:
#   sbatch --array=1-$(ls -d photos/*/scene.ron | wc -l) examples/jobs/slurm.sh photos out
# A task that was killed goes on when it is requeued, or with all others by the same command; what has finished is left as it is.
# When all have ended: lobelia report out/* --csv > runs.csv
#SBATCH --cpus-per-task=2
#SBATCH --mem=8G
#SBATCH --requeue
#SBATCH --output=lobelia-%A_%a.log
set -euo pipefail
scenes=("$1"/*/scene.ron)
scene=${scenes[SLURM_ARRAY_TASK_ID - 1]}
out=$2/$(basename "$(dirname "$scene")")
# exec, so that Slurm's SIGTERM reaches the program, which then keeps what it has found.
exec "${LOBELIA:-lobelia}" run "$scene" --out "$out" --resume --threads "${SLURM_CPUS_PER_TASK:-2}" --quiet
