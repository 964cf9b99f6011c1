#!/bin/bash
# All units of JOBS as a Slurm array, a unit a task, on a file system that all nodes share:
#   sbatch --array=1-$(lobelia list objects.csv | wc -l) examples/jobs/slurm.sh objects.csv out
# A task that was killed is run again by `scontrol requeue`, or with all others by the same command: it goes on where it was.
# When all have ended: lobelia report out --jobs objects.csv
#SBATCH --cpus-per-task=2
#SBATCH --mem=8G
#SBATCH --requeue
#SBATCH --output=lobelia-%A_%a.log
set -euo pipefail
jobs=$1 out=$2
shift 2 # further options, such as --data DIR, go to both commands; FRAMES is how many frames of a film a unit has
unit=$("${LOBELIA:-lobelia}" list "$jobs" "$@" --frames "${FRAMES:-24}" | sed -n "${SLURM_ARRAY_TASK_ID}p")
# exec, so that Slurm's SIGTERM reaches the program, which then keeps what it has found.
exec "${LOBELIA:-lobelia}" run "$jobs" "$@" --only "$unit" --out "$out" --threads "${SLURM_CPUS_PER_TASK:-2}" --quiet
