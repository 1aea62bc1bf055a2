"""Dask's configuration: access, memory, versions; and messages when it fails."""

import logging
import os
import stat
import sys
from types import SimpleNamespace

import dask
import distributed  # noqa: F401  its defaults join the configuration
import psutil
import pytest

import wavefield
from wavefield.errors import ExperimentError, StoreError
from wavefield.execution import dask_cluster
from wavefield.execution.cluster import count_workers, open_cluster
from wavefield.execution.dask_cluster import Task, own_versions
from wavefield.execution.dask_settings import needs_tls, temporary_credentials
from wavefield.execution.slurm import count_jobs
from wavefield.pipeline import Workflow


def ports(item):
    """Addresses at which a worker and its relatives listen, and the worker's own."""
    from distributed import get_worker

    listening = set()
    for process in [*psutil.Process().parents(), psutil.Process()]:
        if process.pid > 1 and "pytest" not in process.name():
            listening |= {c.laddr.ip for c in process.net_connections("tcp") if c.status == "LISTEN"}
    return listening, get_worker().address, dict(os.environ).get("OMP_NUM_THREADS")


def test_daemons_of_this_machine_listen_on_the_loopback_alone_and_through_tls_if_asked(tmp_path):
    before, environment = dask.config.get("distributed.comm"), dict(os.environ)
    workflow = Workflow(cluster="local", workers=1, dashboard=":0", security="tls")
    with open_cluster(workflow, tmp_path) as map_unordered:
        ((_, (worker, address, threads)),) = map_unordered(ports, [0])
        # generator is exhausted: the cluster is gone
    mine = {c.laddr.ip for c in psutil.Process().net_connections("tcp") if c.status == "LISTEN"}
    assert worker | mine <= {"127.0.0.1", "::1"}
    assert address.startswith("tls://127.0.0.1")
    assert threads == "1"
    assert dask.config.get("distributed.comm") == before
    assert dict(os.environ) == environment
    assert list(tmp_path.iterdir()) == [], "credentials go with their run"


def test_credentials_are_for_their_owner_alone(tmp_path):
    with temporary_credentials(tmp_path) as settings:
        for role in ("scheduler", "worker", "client"):
            for path in settings["distributed"]["comm"]["tls"][role].values():
                assert stat.S_IMODE(os.stat(path).st_mode) == 0o600


def test_tls_is_the_rule_where_ports_are_open_to_the_network():
    assert needs_tls(Workflow(cluster="slurm"))
    assert needs_tls(Workflow(cluster="dask", deploy="distributed.SSHCluster"))
    assert needs_tls(Workflow(cluster="dask", deploy="dask_jobqueue.PBSCluster"))
    assert not needs_tls(Workflow(cluster="slurm", security="none"))
    assert not needs_tls(Workflow(cluster="local"))


def test_jobs_of_other_queues_get_the_credentials_and_settings_of_the_run(tmp_path, monkeypatch):
    pytest.importorskip("dask_jobqueue")
    options = {"cores": 1, "memory": "1 GB", "job_script_prologue": ["module load python"]}
    workflow = Workflow(cluster="dask", deploy="dask_jobqueue.PBSCluster", options=options)
    scripts = []
    monkeypatch.setattr(
        dask_cluster, "_map_on", lambda client, *_: iter([scripts.append(client.cluster.job_script())])
    )
    with open_cluster(workflow, tmp_path) as map_unordered:
        list(map_unordered(abs, [-1]))
    (script,) = scripts
    assert "tls://" in script
    for line in (
        "export DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION=True",
        f"export DASK_DISTRIBUTED__COMM__TLS__WORKER__CERT={tmp_path}",
        "export OMP_NUM_THREADS=1",
        "module load python",
    ):
        assert line in script


def test_workers_of_other_versions_are_refused_with_both():
    major, minor = sys.version_info[:2]
    assert Task(abs, own_versions())([-1, -2]) == [1, 2]
    with pytest.raises(ExperimentError, match=rf"run Python {major}\.{minor}, .* but the run Python 2\.7"):
        Task(abs, f"Python 2.7, wavefield {wavefield.__version__}")([-1])
    with pytest.raises(
        ExperimentError, match=r"but the run Python .*, wavefield 0\.0\.1: start both from one"
    ):
        Task(abs, f"Python {major}.{minor}, wavefield 0.0.1")([-1])


class Future:
    """A task of a client that does everything at once."""

    status = "finished"

    def __init__(self, value):
        self.value = value
        if isinstance(value, Exception):
            self.status = "error"

    def add_done_callback(self, function):
        function(self)

    def exception(self):
        return self.value


class Client:
    """Counts the tasks that were submitted and not fetched yet."""

    status = "closed"

    def __init__(self):
        self.sizes, self.fetched, self.most_held = [], 0, 0

    def scheduler_info(self):
        return {"workers": {}}

    def map(self, task, batches, key, pure):
        self.sizes += [len(batch) for batch in batches]
        self.most_held = max(self.most_held, len(self.sizes) - self.fetched)
        assert len(set(key)) == len(batches)
        return [Future(self.do(task, batch)) for batch in batches]

    def do(self, task, batch):
        return task(batch)

    def gather(self, futures):
        self.fetched += len(futures)
        return [future.value for future in futures]


def test_few_tasks_are_held_however_long_the_record():
    client, read, seen = Client(), 0, set()
    for item, result in dask_cluster._map_on(client, abs, range(10_000), 4, lambda: None):
        read += 1
        assert result == item
        seen.add(item)
    assert read == len(seen) == 10_000
    assert client.most_held <= 2 * 4
    assert max(client.sizes) == 8
    assert sum(client.sizes) == 10_000
    assert set(client.sizes[-30:]) == {1}, "the last tasks are small, so that all workers end together"


def root(item):
    if item == 7:
        raise ValueError("seven")
    return item


def test_an_item_that_fails_costs_none_of_those_that_were_sent_with_it():
    results = dict(dask_cluster._map_on(Client(), root, range(2_000), 2, lambda: None))
    assert isinstance(results.pop(7), ValueError)
    assert results == {item: item for item in range(2_000) if item != 7}


def test_an_item_that_ends_its_workers_is_found_among_those_that_were_sent_with_it():
    from distributed import KilledWorker

    class Deadly(Client):
        def do(self, task, batch):
            return KilledWorker("blocks", None, 10) if 7 in batch else task(batch)

    results = dict(dask_cluster._map_on(Deadly(), abs, range(2_000), 2, lambda: None))
    assert "10 workers ended while they worked on it" in str(results.pop(7))
    assert results == {item: item for item in range(2_000) if item != 7}


class Forgetful(Client):
    """A task's results are gone with its worker: once before they are fetched, once while they are."""

    status = "running"

    def map(self, task, batches, key, pure):
        futures = super().map(task, batches, key, pure)
        if len(self.sizes) == len(batches):  # the first that are submitted
            futures[0].status = "lost"
        return futures

    def gather(self, futures):
        from distributed import CancelledError

        if not self.fetched:
            self.fetched = 1
            raise CancelledError("blocks")
        return super().gather(futures)


def test_results_that_went_with_their_worker_are_computed_again():
    results = list(dask_cluster._map_on(Forgetful(), abs, range(200), 2, lambda: None))
    assert sorted(results) == [(item, item) for item in range(200)]


def test_results_that_are_gone_with_the_scheduler_end_the_run():
    client = Forgetful()
    client.status = "closed"
    with pytest.raises(StoreError, match="the scheduler was lost"):
        list(dask_cluster._map_on(client, abs, range(200), 2, lambda: None))


def test_workers_from_how_many_to_how_many():
    workflow = Workflow(cluster="slurm", workers={"minimum": 2, "maximum": 40}, slurm={"cores": 8})
    assert count_workers(workflow) == 40
    assert count_jobs(workflow) == (1, 5)
    with pytest.raises(ValueError, match="below their minimum"):
        Workflow(workers={"minimum": 3, "maximum": 2})


def test_a_scheduler_without_workers_is_named(caplog):
    client = type("Client", (), {"nthreads": lambda self: {}})()
    watch = dask_cluster._WithoutWorkers(client, "tcp://here:1")
    with caplog.at_level(logging.WARNING, "wavefield.run"):
        watch()
        watch()
    assert caplog.messages == [
        "the scheduler at tcp://here:1 has no workers; the run begins when the first is started: "
        "`dask worker tcp://here:1 --nthreads 1`"
    ]


def test_a_worker_without_wavefield_is_named():
    error = ModuleNotFoundError("No module named 'wavefield'", name="wavefield")
    assert "cannot load wavefield" in str(dask_cluster._as_sentence(error))


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"deploy": "distributed.NoCluster"}, "`deploy`: 'distributed.NoCluster' cannot be imported"),
        ({"deploy": "distributed.SSHCluster", "options": {"hosts": []}}, "see `options`"),
    ],
)
def test_classes_that_do_not_deploy_are_named(settings, sentence, tmp_path):
    workflow = Workflow(cluster="dask", **settings)
    with open_cluster(workflow, tmp_path) as mapped, pytest.raises(ExperimentError, match=sentence):
        list(mapped(abs, [1]))


@pytest.mark.parametrize(
    "name",
    ["os.system", "subprocess.Popen", "nowhere.Cluster", "distributed.Client", "distributed", "Cluster", "",
     "distributed.deploy.local.os.system", "dask_evil.Cluster", "distributed_evil.SSHCluster"],
)  # fmt: skip
def test_only_classes_of_clusters_are_imported(name, tmp_path, monkeypatch):
    monkeypatch.setattr(dask_cluster, "import_module", lambda module: pytest.fail(f"imported {module}"))
    path = tmp_path / "workflow.yaml"
    path.write_text(f"cluster: dask\ndeploy: '{name}'\n")
    with pytest.raises(ExperimentError, match=r"no class of clusters|needs the class"):
        Workflow.load(path)


def test_a_folder_for_logs_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").touch()
    workflow = Workflow(cluster="slurm")
    with (
        open_cluster(workflow, tmp_path / "file" / "logs") as mapped,
        pytest.raises(ExperimentError, match="credentials of the run cannot be written there"),
    ):
        list(mapped(abs, [1]))
    workflow = Workflow(cluster="slurm", security="none")
    with (
        open_cluster(workflow, tmp_path / "file" / "logs") as mapped,
        pytest.raises(ExperimentError, match="the jobs' logs cannot be written"),
    ):
        list(mapped(abs, [1]))


class FakeClient:
    """Two workers, of which one is suspended from the third sign on."""

    def __init__(self):
        self.signs = 0

    def scheduler_info(self):
        self.signs += 1
        return {
            "workers": {
                "tcp://a": {"name": "a", "last_seen": self.signs},
                "tcp://b": {"name": "b", "last_seen": min(self.signs, 3)},
            }
        }


def reported_at(monkeypatch, caplog, leap=0.0):
    """Seconds after which a worker is reported; the run itself is suspended once for so long."""
    clock = [100.0]
    monkeypatch.setattr(dask_cluster, "time", SimpleNamespace(monotonic=lambda: clock[0]))
    silent = dask_cluster._SilentWorkers(FakeClient())
    reports = []
    for poll in range(60):
        silent.check()
        if caplog.records:
            reports.append((clock[0], caplog.records[0].message))
            caplog.clear()
        clock[0] += 1.0 + (leap if poll == 20 else 0.0)
    return reports


def test_a_worker_without_a_sign_of_life_is_reported_once_within_half_a_minute(monkeypatch, caplog):
    ((when, message),) = reported_at(monkeypatch, caplog)
    assert "tcp://b" in message
    assert 0 < when - (100 + 2 * dask_cluster._HEARTBEAT_CHECK_SECONDS) <= 30


def test_after_the_run_itself_was_suspended_workers_have_time_for_a_sign(monkeypatch, caplog):
    ((when, _),) = reported_at(monkeypatch, caplog, leap=1000.0)
    assert when > 1100 + dask_cluster._SILENT_SECONDS
