#!/bin/bash
# Starts a Slurm on this machine alone, to try workflows/slurm.yaml without a cluster.
#
#   apt-get install slurm-wlm munge          # Debian or Ubuntu, as root; a container will do
#   workflows/one_node_slurm.sh start        # then: sinfo, sbatch, squeue, scancel
#   workflows/one_node_slurm.sh start 4      # or with four nodes of one core, all of them this machine
#   pytest tests/workflows                   # runs in jobs; jobs cancelled, nodes drained, time limits
#   workflows/one_node_slurm.sh stop
#
# Everything it writes lies below /tmp/one_node_slurm, but for munge's key and socket.
set -eu
place=/tmp/one_node_slurm
configuration=$place/slurm.conf
export SLURM_CONF=$configuration

start() {
    local count=$1 nodes names
    if [ "$count" -eq 1 ]; then
        names=localhost
        nodes="NodeName=localhost CPUs=$(nproc) RealMemory=4000 State=UNKNOWN"
    else
        names="node[1-$count]"
        nodes="NodeName=$names NodeHostname=localhost NodeAddr=127.0.0.1 Port=[17001-$((17000 + count))] CPUs=1 RealMemory=4000 State=UNKNOWN"
    fi
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
AuthInfo=cred_expire=5
StateSaveLocation=$place/state
SlurmdSpoolDir=$place/spool/%n
SlurmctldPidFile=$place/slurmctld.pid
SlurmdPidFile=$place/slurmd.%n.pid
SlurmctldLogFile=$place/slurmctld.log
SlurmdLogFile=$place/slurmd.%n.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SchedulerParameters=batch_sched_delay=0,sched_min_interval=0
AccountingStorageType=accounting_storage/none
JobAcctGatherType=jobacct_gather/none
MpiDefault=none
ReturnToService=2
KillWait=5
OverTimeLimit=0
$nodes
PartitionName=cpu Nodes=$names Default=YES MaxTime=1-00:00:00 State=UP OverSubscribe=FORCE:4
END
    slurmctld -c -f "$configuration"
    if [ "$count" -eq 1 ]; then
        slurmd -N localhost -f "$configuration"
    else
        for number in $(seq "$count"); do slurmd -N "node$number" -f "$configuration"; done
    fi
    for _ in $(seq 120); do
        [ "$(sinfo --noheader --Node --format=%T 2> /dev/null | grep -c -E '^(idle|mixed|allocated)$')" -eq "$count" ] && break
        sleep 0.5
    done
    sinfo --Node
    srun hostname > /dev/null
    echo "Slurm is up. For other shells: export SLURM_CONF=$configuration"
}

stop() {
    for file in "$place"/slurmd.*.pid "$place/slurmctld.pid"; do
        [ -f "$file" ] && kill "$(cat "$file")" 2> /dev/null && rm -f "$file"
    done
    echo "Slurm is down (munged keeps running)."
}

case "${1:-}" in
    start) start "${2:-1}" ;;
    stop) stop ;;
    *) echo "usage: $0 start [NODES] | stop"; exit 2 ;;
esac
