#!/usr/bin/env bash
# A study as a Slurm array: every task of the array runs its shard, all of them in one shared folder.
#
#   sbatch --array=1-8 --gres=gpu:1 config/cluster/slurm-array.sh config/studies/sufia-bc.toml /shared/sufia-bc
#   trocar report /shared/sufia-bc --out sufia-bc.html          # when they have ended, or before
#
# A shard that comes to its time limit, or is preempted, keeps what it has and is queued again; so can a whole array be
# submitted again at any time: what is done is not done again. Recordings that several shards need are made by the first.
#
#SBATCH --job-name=trocar-study
#SBATCH --cpus-per-task=16
#SBATCH --mem=64G
#SBATCH --time=04:00:00
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --output=%x-%A_%a.log
#SBATCH --signal=B:USR1@180
set -euo pipefail

study=${1:?usage: sbatch --array=1-N slurm-array.sh STUDY.toml DIR [options of trocar study]}
out=${2:?the folder that all shards share}
shift 2
trocar=${TROCAR:-trocar}

# Slurm counts tasks from whatever --array says; shards are counted from 1.
first=${SLURM_ARRAY_TASK_MIN:-1}
step=${SLURM_ARRAY_TASK_STEP:-1}
shard=$((((${SLURM_ARRAY_TASK_ID:?this is an array job: sbatch --array=1-N} - first) / step) + 1))
of=${SLURM_ARRAY_TASK_COUNT:?this is an array job: sbatch --array=1-N}

"$trocar" study "$study" --out "$out" --shard "$shard/$of" --jobs "${SLURM_CPUS_PER_TASK:-1}" "$@" &
child=$!
requeue=no
# Slurm sends USR1 three minutes before the time limit: trainings then keep their state.
trap 'requeue=yes; kill -TERM "$child" 2>/dev/null' USR1
trap 'kill -TERM "$child" 2>/dev/null' INT TERM
code=0
while :; do
    wait "$child" && code=0 || code=$?
    # A signal ends `wait` before the child has ended.
    kill -0 "$child" 2>/dev/null || break
done
if [ "$requeue" = yes ] && [ "$code" != 0 ]; then
    echo "shard $shard/$of: not done at its time limit; queued again"
    scontrol requeue "${SLURM_ARRAY_JOB_ID}_${SLURM_ARRAY_TASK_ID}"
    exit 0
fi
exit "$code"
