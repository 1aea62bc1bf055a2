"""Supervision of Slurm jobs: why they wait, why they ended, and resubmission of lost ones."""

import getpass
import logging
import re
import subprocess
import time
from pathlib import Path
from typing import Any

from wavefield.errors import ExperimentError

log = logging.getLogger("wavefield.run")

_MAX_FAILURES = 3  # jobs that end before their workers have started
_POLL_SECONDS = 2.0, 30.0  # between queries of Slurm: at first, and in a long queue
_REPORT_AFTER_S = 10.0  # seconds in the queue after which the reason is worth a line
_FATAL_REASONS = (  # parts of reasons for which Slurm keeps a job waiting until somebody changes it
    "BadConstraints",
    "InvalidAccount",
    "InvalidQOS",
    "PartitionConfig",
    "PartitionNodeLimit",
    "PartitionTimeLimit",
    "MaxMemPerLimit",
    "WallDurationPerJob",
    "CpuPerJob",
    "MemPerJob",
    "NodePerJob",
    "AccountNotAllowed",
    "QOSNotAllowed",
)
_EXTERNAL_CAUSES = ("PREEMPTED", "NODE_FAIL", "BOOT_FAIL")
_TRANSIENT = re.compile(r"temporar|timed out|unable to contact|limit", re.I)  # of sbatch
_ERRORS = re.compile(
    r"error|cannot|no such|not found|no module|no space|quota|denied|killed|cancelled|exceeded|refused", re.I
)
_ENDED_BY_SLURM = re.compile(r"DUE TO|out of memory|oom.kill", re.I)  # of Slurm itself
_MAX_LINE = 300  # characters of a log in a message


class QueueWatch:
    """Supervises the jobs of a run: reports why they wait, resubmits lost ones, ends a hopeless run."""

    def __init__(self, cluster: Any, logs: Path) -> None:
        self._cluster, self._logs = cluster, logs
        self._since = self._checked_at = time.monotonic()
        self._reported = ""
        self._connected: set[str] = set()  # names of workers, whose jobs Dask supervises from then on
        self._absent: set[str] = set()
        self._failed: list[str] = []

    def __call__(self) -> None:
        """Check all jobs, unless that was a moment ago."""
        now = time.monotonic()
        shortest, longest = _POLL_SECONDS
        if now - self._checked_at < min(longest, max(shortest, (now - self._since) / 10)):
            return
        self._checked_at = now
        connected = {str(worker["id"]) for worker in self._cluster.scheduler_info["workers"].values()}
        self._connected |= connected
        silent = {
            str(name): job
            for name, job in list(self._cluster.workers.items())
            if not any(one == str(name) or one.startswith(f"{name}-") for one in self._connected)
        }
        self._check_refused(silent, bool(connected))
        asked = {job.job_id: name for name, job in silent.items() if job.job_id}
        states = _states() if asked else None
        if states is not None:
            self._check_ended(asked, states, bool(connected))
            if not connected:
                self._check_queue([states[number] for number in asked if number in states])

    def _check_refused(self, silent: dict[str, Any], working: bool) -> None:
        for name, job in silent.items():
            if job.refused:
                sentence = _refusal(job.refused)
                if not working and not _TRANSIENT.search(sentence):
                    raise ExperimentError(f"{sentence}; correct the `slurm` block of the workflow")
                self._report(f"{sentence}; asking again")
                self._forget(name)

    def _check_ended(self, asked: dict[str, str], states: dict[str, tuple[str, str]], working: bool) -> None:
        absent = {number for number in asked if number not in states}
        for number in absent & self._absent:  # twice: Slurm may list it late, and the worker may connect late
            blameless = any(state in _shown(number) for state in _EXTERNAL_CAUSES)
            if not blameless and not _connected_once(number, self._logs):
                self._failed.append(number)
            self._forget(asked[number])
        self._absent = absent - self._absent
        if working:
            self._failed.clear()  # jobs do start here
        elif self._failed and len(self._failed) >= min(_MAX_FAILURES, len(self._cluster.worker_spec) or 1):
            raise ExperimentError(why_ended(self._failed[0], self._logs))

    def _check_queue(self, waiting: list[tuple[str, str]]) -> None:
        reasons = sorted({reason for state, reason in waiting if state == "PENDING"})
        for reason in reasons:
            if any(never in reason for never in _FATAL_REASONS):
                raise ExperimentError(
                    f"Slurm will never start the jobs of this run: {reason}; correct `queue`, `walltime`, "
                    "`cores` or `memory` in the workflow (`scontrol show partition` lists what there is)"
                )
        if reasons and time.monotonic() - self._since > _REPORT_AFTER_S:
            self._report(
                f"{len(waiting)} jobs wait in Slurm's queue ({', '.join(reasons)}); the run begins when the "
                "first starts (`squeue --start` estimates when)"
            )

    def _forget(self, name: str) -> None:
        """Take a job for lost, so that another is asked for in its place."""
        self._cluster.sync(self._cluster.scale_down, [name])

    def _report(self, sentence: str) -> None:
        if sentence != self._reported:
            self._reported = sentence
            log.warning("%s", sentence)


def _refusal(text: str) -> str:
    stated = re.findall(r"sbatch: error: (.*)", text)
    if stated:
        reason = "; ".join(dict.fromkeys(line.strip() for line in stated))
    elif "No such file" in text:
        reason = "there is no sbatch here: start the run where jobs can be submitted"
    else:
        reason = text.strip().splitlines()[-1]
    return f"Slurm refuses the jobs of this run: {reason}"


def _states() -> dict[str, tuple[str, str]] | None:
    """State and reason of all our jobs that Slurm still lists, by number; None if it does not answer."""
    command = ["squeue", "--noheader", f"--user={getpass.getuser()}", "--format=%A|%T|%r"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    rows = (line.split("|", 2) for line in done.stdout.splitlines() if line.count("|") >= 2)
    return {number: (state, reason) for number, state, reason in rows if state != "COMPLETING"}


def _connected_once(number: str, logs: Path) -> bool:
    """Whether a worker of a job has reached the scheduler, according to its log."""
    return any(b"Registered to" in path.read_bytes() for path in logs.glob(f"*-{number}*.err"))


def _shown(number: str) -> str:
    """State of a job and its reason, as long as Slurm remembers it."""
    command = ["scontrol", "show", "job", number]
    try:
        shown = subprocess.run(command, capture_output=True, text=True, timeout=30).stdout
    except (OSError, subprocess.SubprocessError):
        return ""
    found = dict(re.findall(r"(JobState|Reason)=(\S+)", shown))
    return ", ".join(found[name] for name in ("JobState", "Reason") if found.get(name, "None") != "None")


def why_ended(number: str, logs: Path) -> str:
    """Why a job ended before its workers started, from Slurm and its log, as a sentence."""
    state = _shown(number)
    head = f"Slurm job {number} ended before its workers started{f' ({state})' if state else ''}; "
    for path in [*sorted(logs.glob(f"*-{number}*.err")), *sorted(logs.glob(f"*-{number}*.out"))]:
        lines = [line.strip() for line in path.read_text(errors="replace").splitlines() if line.strip()]
        if lines:
            causes = [line for line in lines if _ENDED_BY_SLURM.search(line)]
            causes = causes or [line for line in lines if _ERRORS.search(line)] or lines
            return f"{head}{path} has: {causes[-1][:_MAX_LINE]}"
    return (
        f"{head}it left no log in {logs}: is that a folder on a disk that all nodes share, with room, and is "
        "`python` of the workflow's `slurm` block there on the nodes?"
    )
