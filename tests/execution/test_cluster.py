"""Chunks on Dask's workers: what they are given, what goes wrong with them, and who can reach them."""

import os
import signal
import time

import cv2
import numpy as np
import psutil
import pytest

from wavefield.errors import ExperimentError, StoreError
from wavefield.execution import cluster
from wavefield.execution.cluster import count_workers, open_cluster, own_versions
from wavefield.pipeline import Workflow, run

TWO = Workflow(cluster="local", workers=2)


@pytest.fixture(scope="module")
def workers():
    """A map over items on two workers of this machine."""
    with open_cluster(TWO) as map_unordered:
        yield map_unordered


def root(item):
    if item == 7:
        raise ValueError("seven")
    return item


def test_every_item_comes_back_once_and_an_error_with_its_item(workers):
    results = dict(workers(root, range(40)))
    assert isinstance(results.pop(7), ValueError)
    assert results == {item: item for item in range(40) if item != 7}
    assert dict(workers(abs, [-3])) == {-3: 3}


def settings_of(item):
    """How a worker is set up: threads, Ctrl-C, and where it and its scheduler listen."""
    from distributed import get_worker

    ignored = signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    listening = {c.laddr.ip for c in psutil.Process().net_connections("tcp") if c.status == "LISTEN"}
    addresses = get_worker().address, get_worker().scheduler.addr
    return cv2.getNumThreads(), os.environ["OPENBLAS_NUM_THREADS"], ignored, listening, addresses


def test_workers_have_one_thread_ignore_ctrl_c_and_are_reached_through_tls_alone(workers):
    ((_, (threads, blas, ignored, listening, addresses)),) = workers(settings_of, [0])
    assert (threads, blas, ignored) == (1, "1", True)
    assert all(address.startswith("tls://127.0.0.1") for address in addresses)
    mine = {c.laddr.ip for c in psutil.Process().net_connections("tcp") if c.status == "LISTEN"}
    assert listening | mine <= {"127.0.0.1", "::1"}


def test_pages_of_dask_are_not_served(workers):
    import urllib.error
    import urllib.request

    ports = [c.laddr.port for c in psutil.Process().net_connections("tcp") if c.status == "LISTEN"]
    answers = []
    for port in ports:
        for page in ("status", "info/main/workers.html"):
            try:
                urllib.request.urlopen(f"http://127.0.0.1:{port}/{page}", timeout=2)
                answers.append((port, page))
            except (OSError, urllib.error.HTTPError, ValueError):
                continue
            except Exception:  # what answers by TLS is no page
                continue
    assert ports
    assert not answers


def test_the_environment_and_the_threads_of_the_caller_stay_as_they_were(monkeypatch):
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "4")
    before, threads = dict(os.environ), cv2.getNumThreads()
    with open_cluster(Workflow(cluster="none")) as map_unordered:
        assert list(map_unordered(lambda _: cv2.getNumThreads(), [0])) == [(0, 1)]
    with open_cluster(TWO):
        pass
    assert (dict(os.environ), cv2.getNumThreads()) == (before, threads)


def die(item):
    """Ends its worker, each time or the first time."""
    times = item / "times"
    times.write_text(f"{times.read_text()}x" if times.exists() else "x")
    if item.name == "always" or times.read_text() == "x":
        os.kill(os.getpid(), signal.SIGKILL)
    return times.read_text()


@pytest.mark.slow
def test_work_of_a_worker_that_dies_is_done_again_but_not_for_ever(tmp_path):
    once, always = tmp_path / "once", tmp_path / "always"
    with open_cluster(TWO) as map_unordered:
        for item in (once, always):  # in turn: Dask counts an ended worker for work that waits there, too
            item.mkdir()
            ((_, result),) = map_unordered(die, [item])
            if item == once:
                assert result == "xx"
    assert "3 workers ended while they worked on it" in str(result)
    assert (always / "times").read_text() == "xxx"


def take_memory(item):
    """Takes much more than a worker may."""
    kept = np.ones(100_000_000)
    time.sleep(20)
    return kept.size


@pytest.mark.slow
def test_a_worker_beyond_its_memory_is_replaced_and_the_work_given_up():
    limited = Workflow(cluster="local", workers=2, memory="500 MB")
    with open_cluster(limited) as map_unordered:
        ((_, result),) = map_unordered(take_memory, [0])
    assert isinstance(result, StoreError)
    assert "if memory ran out, give more `memory`" in str(result)


def greedy(item):
    np.empty(1 << 60, np.uint8)


def test_an_allocation_that_fails_is_one_sentence_with_the_memory_that_is_needed(workers):
    ((_, error),) = workers(greedy, [1])
    assert isinstance(error, StoreError)
    assert "memory ran out: the work needs more than" in str(error)
    assert "\n" not in str(error)


def test_workers_of_other_versions_are_refused_with_both():
    with pytest.raises(ExperimentError, match=r"but the run Python 2\.7.*: start both from one environment"):
        cluster._do(b"", "Python 2.7, wavefield 0", 1)
    assert own_versions().startswith("Python 3.")


def test_no_scheduler_at_the_address(tank, tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "_SCHEDULER_TIMEOUT", "1s")
    workflow = Workflow(cluster="address", address="tcp://127.0.0.1:9")
    with pytest.raises(ExperimentError, match=r"no scheduler answers at tcp://127.0.0.1:9"):
        run(tank, out=tmp_path / "cube.zarr", workflow=workflow)


def test_workers_from_how_many_to_how_many():
    assert count_workers(Workflow(workers={"minimum": 2, "maximum": 40})) == 40
    with pytest.raises(ValueError, match="below their minimum"):
        Workflow(workers={"minimum": 3, "maximum": 2})
