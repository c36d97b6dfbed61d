#!/usr/bin/env bash
# Make the parts of a dataset as a SLURM array: sbatch examples/cluster/slurm-array.sh JOB.yaml
# Run it again if tasks were lost. The last part finishes the dataset.
#SBATCH --job-name=omniscv
#SBATCH --array=0-63
#SBATCH --time=02:00:00
#SBATCH --cpus-per-task=4
#SBATCH --mem=8G
#SBATCH --requeue
set -euo pipefail
exec omniscv dataset make "$1" --shard "$SLURM_ARRAY_TASK_ID/$SLURM_ARRAY_TASK_COUNT"
