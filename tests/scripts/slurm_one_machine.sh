#!/usr/bin/env bash
# A study as a Slurm array on this machine alone: config/cluster/slurm-array.sh with Debian's slurm-wlm. Compares its report with
# that of the same study run without Slurm, cancels and requeues a task on the way, and takes down what it started.
#
#   sudo tests/scripts/slurm_one_machine.sh        # from anywhere; minutes; `make build` before
set -euo pipefail
cd "$(dirname "$0")/../.."
root=$PWD
export TROCAR="${TROCAR:-$root/target/release/trocar}"
[ -x "$TROCAR" ] || { echo "slurm: $TROCAR is missing: make build" >&2; exit 1; }
[ "$(id -u)" = 0 ] || { echo 'slurm: needs root: it starts munged, slurmctld and slurmd' >&2; exit 1; }

say() { printf 'slurm: %s\n' "$*" >&2; }
for package in slurm-wlm munge; do
    [ "$(dpkg-query -W -f='${db:Status-Status}' "$package" 2>/dev/null)" = installed ] && continue
    say "installing $package"
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$package" >/dev/null
done

work="$root/target/scratch/slurm"
rm -rf "$work"
mkdir -p "$work/spool" "$work/state"
host=$(hostname -s)
cat >"$work/slurm.conf" <<CONF
ClusterName=one
SlurmctldHost=$host
SlurmUser=root
AuthType=auth/munge
AuthInfo=socket=$work/munge.socket
CredType=cred/munge
SlurmctldPort=16817
SlurmdPort=16818
StateSaveLocation=$work/state
SlurmdSpoolDir=$work/spool
SlurmctldPidFile=$work/slurmctld.pid
SlurmdPidFile=$work/slurmd.pid
SlurmctldLogFile=$work/slurmctld.log
SlurmdLogFile=$work/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SchedulerType=sched/backfill
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
ReturnToService=2
MpiDefault=none
NodeName=$host CPUs=$(nproc) RealMemory=1024 State=UNKNOWN
PartitionName=all Nodes=$host Default=YES MaxTime=INFINITE State=UP
CONF
export SLURM_CONF="$work/slurm.conf"

started=()
stop() {
    local process
    for process in "${started[@]}"; do kill "$process" 2>/dev/null || true; done
}
trap stop EXIT

dd if=/dev/urandom of="$work/munge.key" bs=1 count=1024 status=none
chmod 400 "$work/munge.key"
# munged refuses folders that others may write to, as the checkout's may be.
munged --force --foreground --key-file="$work/munge.key" --socket="$work/munge.socket" --pid-file="$work/munged.pid" \
    --seed-file="$work/munged.seed" --log-file="$work/munged.log" >/dev/null 2>&1 &
started+=($!)
for _ in $(seq 100); do [ -S "$work/munge.socket" ] && break; sleep 0.1; done
slurmctld -D >/dev/null 2>&1 &
started+=($!)
slurmd -D >/dev/null 2>&1 &
started+=($!)
for _ in $(seq 300); do sinfo -h -o %T 2>/dev/null | grep -q idle && break; sleep 0.2; done
sinfo -h -o '%n %T' | grep idle || { say 'the node did not come up'; tail "$work"/*.log; exit 1; }

# The study with small pictures, as the tests make it.
python3 - "$root/config" "$work" <<'PYTHON'
import pathlib, sys
config, work = map(pathlib.Path, sys.argv[1:])
text = (config / "studies/tiny.toml").read_text()
for task in ("needle-lift", "block-transfer"):
    scene = (config / "tasks" / task / "scene.toml").read_text()
    (work / f"{task}.scene.toml").write_text(scene.replace("= 512", "= 64"))
    text = text.replace(f"[task.{task}]\n", f'[task.{task}]\nscene = "{task}.scene.toml"\n')
(work / "tiny.toml").write_text(text)
PYTHON

cd "$work"
export XDG_RUNTIME_DIR=/tmp
submit() {
    sbatch --parsable --array=1-2 --cpus-per-task=1 --mem=0 --time=00:30:00 "$root/config/cluster/slurm-array.sh" tiny.toml "$work/array"
}
job=$(submit)
say "array $job: once a training has a state, one task is told of its time limit, the other is preempted; both go on"
for _ in $(seq 3000); do
    ls array/training/*/checkpoint/training_state.safetensors >/dev/null 2>&1 && break
    sleep 0.1
done
scancel --batch --signal=USR1 "${job}_1" || say 'task 1 had ended already'
scontrol requeue "${job}_2" || say 'task 2 had ended already'
while squeue -h -j "$job" 2>/dev/null | grep -q .; do
    # A requeued task waits two minutes unless it is told not to.
    for task in 1 2; do
        scontrol release "${job}_$task" 2>/dev/null || true
        scontrol update JobId="${job}_$task" StartTime=now 2>/dev/null || true
    done
    sleep 1
done
cat trocar-study-"${job}"_*.log
again=$(submit)
say "array $again: the same once more, with nothing to do"
while squeue -h -j "$again" 2>/dev/null | grep -q .; do sleep 1; done
cat trocar-study-"${again}"_*.log
grep -h 'cells done before' trocar-study-"${again}"_*.log | grep -qv ' 0 now' && { say 'something was done twice'; exit 1; }

"$TROCAR" study tiny.toml --out "$work/machine"
"$TROCAR" report "$work/array" --out array.md --json array.json
"$TROCAR" report "$work/machine" --out machine.md --json machine.json
cmp array.json machine.json
say 'the array came to the same figures as one machine, to the last command'
