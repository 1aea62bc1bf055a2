#!/bin/bash
# A run as a Slurm job:  sbatch workflows/slurm_job.sh experiment.yaml
# At the time limit Slurm warns with SIGUSR1; the run stops cleanly and this script puts itself back into the queue.
#SBATCH --job-name=wavefield
#SBATCH --cpus-per-task=8
#SBATCH --mem-per-cpu=2G
#SBATCH --time=04:00:00
#SBATCH --signal=USR1@120
#SBATCH --requeue
#SBATCH --open-mode=append

set -u
experiment=${1:?usage: sbatch slurm_job.sh EXPERIMENT [options of wavefield run]}
shift
srun --ntasks=1 wavefield run "$experiment" "$@"
state=$?
said=$(scontrol show job "$SLURM_JOB_ID" | sed -n 's/^ *StdErr=//p')
if [ "$state" -ne 0 ] && [ "${SLURM_RESTART_COUNT:-0}" -lt 20 ] && tail -n 5 "$said" | grep -q "stopped by SIGUSR1"; then
    scontrol requeue "$SLURM_JOB_ID"
fi
exit "$state"
