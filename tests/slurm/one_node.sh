#!/usr/bin/env bash
# Slurm with this machine as its only node, for tests/test_clusters.py. Needs root, on a machine of one's own.
#
#   tests/slurm/one_node.sh start    installs the packages slurm-wlm and munge (Debian, Ubuntu), writes
#                                    /etc/slurm/slurm.conf and /etc/munge/munge.key where there are none, and starts
#                                    munged, slurmctld and slurmd
#   tests/slurm/one_node.sh stop     ends these three; packages and files stay
set -euo pipefail
run=/run/slurm-one-node
node=$(hostname -s)

stop() {
  for daemon in slurmd slurmctld munged; do
    [ -s "$run/$daemon.pid" ] && kill "$(cat "$run/$daemon.pid")" 2> /dev/null && echo "ended $daemon" || true
    rm -f "$run/$daemon.pid"
  done
}

start() {
  if [ -s /etc/slurm/slurm.conf ] && ! grep -q "^# one node" /etc/slurm/slurm.conf; then
    echo "/etc/slurm/slurm.conf is of another Slurm." >&2
    exit 1
  fi
  if ! command -v slurmctld munged > /dev/null; then
    apt-get update -qq
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends slurm-wlm munge > /dev/null
  fi
  mkdir -p "$run" /etc/slurm /run/munge /var/spool/slurmd /var/spool/slurmctld
  [ -s /etc/munge/munge.key ] || dd if=/dev/urandom bs=1 count=1024 of=/etc/munge/munge.key status=none
  chown -R munge:munge /etc/munge /run/munge /var/log/munge /var/lib/munge
  chmod 400 /etc/munge/munge.key
  touch "$run/munged.pid" && chown munge:munge "$run" "$run/munged.pid"
  cat > /etc/slurm/slurm.conf << CONF
# one node, by tests/slurm/one_node.sh
ClusterName=local
SlurmctldHost=$node(127.0.0.1)
SlurmUser=root
AuthType=auth/munge
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
StateSaveLocation=/var/spool/slurmctld
SlurmdSpoolDir=/var/spool/slurmd
SlurmctldPidFile=$run/slurmctld.pid
SlurmdPidFile=$run/slurmd.pid
ReturnToService=2
MpiDefault=none
KillWait=5
NodeName=$node NodeAddr=127.0.0.1 CPUs=$(nproc) State=UNKNOWN
PartitionName=main Nodes=$node Default=YES MaxTime=INFINITE State=UP
CONF
  su munge -s /bin/bash -c "/usr/sbin/munged --pid-file=$run/munged.pid"
  slurmctld
  slurmd -N "$node"
  for _ in $(seq 30); do
    sinfo --noheader --format=%t 2> /dev/null | grep -q idle && break
    sleep 1
  done
  sinfo
}

case "${1:-}" in
  start) start ;;
  stop) stop ;;
  *) sed -n '2,8p' "$0" >&2; exit 2 ;;
esac
