"""Messages about Slurm jobs, with a Slurm that returns given answers."""

import logging
import os
import stat
from types import SimpleNamespace

import pytest

from wavefield.errors import ExperimentError
from wavefield.execution.slurm_queue import QueueWatch


class Cluster:
    """Two jobs; those that are given up are asked for again under new names."""

    def __init__(self, refused=""):
        self.workers = {f"job-{k}": SimpleNamespace(job_id=str(10 + k), refused=refused) for k in range(2)}
        self.scheduler_info = {"workers": {}}
        self.worker_spec = self.workers
        self.given_up = []

    def scale_down(self, names):
        self.given_up += names
        for name in names:
            del self.workers[name]

    def sync(self, function, *arguments):
        return function(*arguments)


@pytest.fixture
def slurm(tmp_path, monkeypatch):
    """Sets what squeue and scontrol answer."""
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")

    def answer(squeue="", scontrol=""):
        for name, text in (("squeue", squeue), ("scontrol", scontrol)):
            (tmp_path / name).write_text(f"#!/bin/sh\ncat << 'END'\n{text}\nEND\n")
            (tmp_path / name).chmod(stat.S_IRWXU)

    answer()
    return answer


@pytest.fixture
def look(tmp_path, monkeypatch):
    """Makes a watch that asks the queue each time, after an hour in the queue."""
    now = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])

    def make(cluster):
        watch = QueueWatch(cluster, tmp_path)

        def once():
            now[0] += 3600.0
            watch()

        return once

    return make


def test_jobs_that_wait_are_reported_once(slurm, look, caplog):
    slurm("10|PENDING|Priority\n11|PENDING|Resources")
    once = look(Cluster())
    with caplog.at_level(logging.WARNING, "wavefield.run"):
        once()
        once()
    assert len(caplog.messages) == 1
    assert "2 jobs wait in Slurm's queue (Priority, Resources)" in caplog.messages[0]


def test_jobs_for_which_there_is_never_a_place_end_the_run(slurm, look):
    slurm("10|PENDING|QOSMaxWallDurationPerJobLimit")
    with pytest.raises(ExperimentError, match=r"will never start .*: QOSMaxWallDurationPerJobLimit"):
        look(Cluster())()


def test_a_job_that_ended_without_workers_is_named_with_slurms_own_line(slurm, look, tmp_path):
    slurm("", "JobId=10 JobState=TIMEOUT Reason=TimeLimit")
    for number in (10, 11):
        (tmp_path / f"wavefield-{number}.err").write_text(
            "error: *** JOB CANCELLED AT noon DUE TO TIME LIMIT ***\nnanny - worker was killed by signal 15\n"
        )
    once = look(Cluster())
    once()
    sentence = r"job 1[01] ended .* \(TIMEOUT, TimeLimit\); .*-1[01].err has: .* DUE TO TIME LIMIT"
    with pytest.raises(ExperimentError, match=sentence):
        once()


def test_a_job_that_left_no_log_asks_for_a_shared_disk(slurm, look):
    once = look(Cluster())
    once()
    with pytest.raises(ExperimentError, match=r"left no log in .* on a disk that all nodes share"):
        once()


def test_jobs_that_worked_or_were_preempted_do_not_end_the_run(slurm, look):
    slurm("", "JobId=11 JobState=PREEMPTED Reason=None")
    cluster = Cluster()
    cluster.scheduler_info["workers"] = {"tcp://one": {"id": "job-0"}}
    once = look(cluster)
    once()
    cluster.scheduler_info["workers"] = {}  # its time is over
    for _ in range(3):
        once()
    assert cluster.given_up == ["job-1"]


def test_a_job_whose_worker_came_and_went_between_two_queries_is_submitted_again(slurm, look, tmp_path):
    for number in (10, 11):
        log = f"worker - INFO - Registered to: tls://here:1\nworker {number} was killed by signal 15\n"
        (tmp_path / f"wavefield-{number}.err").write_text(log)
    cluster = Cluster()
    once = look(cluster)
    once()
    once()
    assert sorted(cluster.given_up) == ["job-0", "job-1"]


def test_a_run_goes_on_while_others_work_whatever_became_of_a_job(slurm, look):
    slurm("", "JobId=11 JobState=CANCELLED Reason=None")
    cluster = Cluster()
    cluster.worker_spec = {"job-0": None}  # one lost job would be enough to end a run in which none works
    cluster.scheduler_info["workers"] = {"tcp://one": {"id": "job-0"}}
    once = look(cluster)
    for _ in range(3):
        once()
    assert cluster.given_up == ["job-1"]


def test_a_refusal_ends_the_run_unless_it_passes(slurm, look, caplog):
    with pytest.raises(ExperimentError, match="Slurm refuses the jobs of this run: invalid partition"):
        look(Cluster("sbatch: error: invalid partition specified: gpu"))()
    with pytest.raises(ExperimentError, match="there is no sbatch here"):
        look(Cluster("[Errno 2] No such file or directory: 'sbatch'"))()
    cluster = Cluster("sbatch: error: Slurm temporarily unable to accept job, sleeping and retrying")
    look(cluster)()
    assert cluster.given_up == ["job-0", "job-1"]
