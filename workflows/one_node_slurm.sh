#!/bin/bash
# Starts a Slurm of one node on this machine, to try workflows/slurm.yaml without a cluster.
#
#   apt-get install slurm-wlm munge          # Debian or Ubuntu, as root; a container will do
#   workflows/one_node_slurm.sh start        # then: sinfo, sbatch, squeue, scancel
#   pytest tests/workflows                   # tries a run in jobs, cancels it in the middle and goes on
#   workflows/one_node_slurm.sh stop
#
# Everything it writes lies below /tmp/one_node_slurm, but for munge's key and socket.
set -eu
place=/tmp/one_node_slurm
configuration=$place/slurm.conf
export SLURM_CONF=$configuration

start() {
    mkdir -p "$place/state" "$place/spool"
    install -d -o munge -g munge -m 755 /run/munge
    [ -f /etc/munge/munge.key ] || { mungekey --create 2>/dev/null || /usr/sbin/create-munge-key -f; }
    pgrep -x munged > /dev/null || su -s /bin/sh munge -c /usr/sbin/munged
    cat > "$configuration" << END
ClusterName=one
SlurmctldHost=localhost
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
StateSaveLocation=$place/state
SlurmdSpoolDir=$place/spool
SlurmctldPidFile=$place/slurmctld.pid
SlurmdPidFile=$place/slurmd.pid
SlurmctldLogFile=$place/slurmctld.log
SlurmdLogFile=$place/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
AccountingStorageType=accounting_storage/none
JobAcctGatherType=jobacct_gather/none
MpiDefault=none
ReturnToService=2
KillWait=10
NodeName=localhost CPUs=$(nproc) RealMemory=4000 State=UNKNOWN
PartitionName=cpu Nodes=localhost Default=YES MaxTime=INFINITE State=UP OverSubscribe=FORCE:4
END
    slurmctld -f "$configuration"
    slurmd -N localhost -f "$configuration"
    for _ in $(seq 60); do
        sinfo --noheader --format=%T 2> /dev/null | grep -q -E "idle|mixed|allocated" && break
        sleep 0.5
    done
    sinfo
    srun hostname > /dev/null
    echo "Slurm is up. For other shells: export SLURM_CONF=$configuration"
}

stop() {
    for name in slurmd slurmctld; do
        [ -f "$place/$name.pid" ] && kill "$(cat "$place/$name.pid")" && rm -f "$place/$name.pid"
    done
    echo "Slurm is down (munged keeps running)."
}

case "${1:-}" in
    start) start ;;
    stop) stop ;;
    *) echo "usage: $0 start|stop"; exit 2 ;;
esac
