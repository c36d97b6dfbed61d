#!/usr/bin/env bash
# Make the parts of a dataset as a SLURM array: sbatch examples/cluster/slurm-array.sh JOB.yaml
# If tasks were lost, run these again: sbatch --array=5,9 slurm-array.sh JOB.yaml. The last part finishes the dataset.
# PARTS is the number of all parts, whatever tasks run: for others, sbatch --export=ALL,PARTS=128 --array=0-127 ...
#SBATCH --job-name=omniscv
#SBATCH --array=0-63
#SBATCH --time=02:00:00
#SBATCH --cpus-per-task=4
#SBATCH --mem=8G
#SBATCH --requeue
set -euo pipefail
exec omniscv dataset make "$1" --shard "$SLURM_ARRAY_TASK_ID/${PARTS:-64}"
