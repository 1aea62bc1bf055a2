"""Runs on machines that are reached by SSH: this one, through a server that only this test talks to."""

import getpass
import os
import shutil
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml
from cube_cases import different

from wavefield.pipeline import Workflow, run

ROOT = Path(__file__).parents[2]
SERVER = shutil.which("sshd", path="/usr/sbin:/usr/local/sbin:/usr/bin")


def answers(port):
    with socket.socket() as probe:
        probe.settimeout(1)
        return probe.connect_ex(("127.0.0.1", port)) == 0


@pytest.fixture
def server(tmp_path):
    """Port and key of an SSH server of this user's on the loopback."""
    pytest.importorskip("asyncssh", reason="needs asyncssh")
    if not SERVER or not shutil.which("ssh-keygen"):
        pytest.skip("no SSH server is installed here")
    for name in ("host", "client"):
        subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", tmp_path / name], check=True)
    if getpass.getuser() == "root":
        Path("/run/sshd").mkdir(exist_ok=True)  # where the server locks itself in
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    settings = {
        "HostKey": tmp_path / "host",
        "AuthorizedKeysFile": tmp_path / "client.pub",
        "ListenAddress": "127.0.0.1",
        "Port": port,
        "PidFile": "none",
        "StrictModes": "no",
        "UsePAM": "no",
        "PermitRootLogin": "yes",
    }
    options = [f"-o{name}={value}" for name, value in settings.items()]
    process = subprocess.Popen([SERVER, "-D", "-e", "-f", "/dev/null", *options], stderr=subprocess.DEVNULL)
    since = time.monotonic()
    while not answers(port):
        assert process.poll() is None, "the SSH server ended"
        assert time.monotonic() - since < 60, "the SSH server does not answer"
        time.sleep(0.05)
    try:
        yield port, tmp_path / "client"
    finally:
        process.terminate()
        process.wait()


def python_of_this_environment(folder):
    """A Python with the linear algebra chosen here: other kernels of OpenBLAS give other last bits."""
    chosen = [f"export {name}={value}" for name, value in os.environ.items() if name.startswith("OPENBLAS_")]
    path = folder / "python"
    path.write_text("\n".join(["#!/bin/sh", *chosen, f'exec {sys.executable} "$@"', ""]))
    path.chmod(0o755)
    return path


def test_the_ssh_workflow_makes_the_same_cube_through_tls(server, tank, reference, tmp_path):
    port, key = server
    data = yaml.safe_load((ROOT / "workflows" / "ssh.yaml").read_text())
    data["options"]["connect_options"] = {"port": port, "client_keys": [str(key)], "known_hosts": None}
    data["options"]["remote_python"] = str(python_of_this_environment(tmp_path))
    data["steps_per_block"] = 4
    out = tmp_path / "cube.zarr"
    assert run(tank, out=out, workflow=Workflow(**data)).complete
    assert different(out, reference) == []
    assert "scheduler: tls://" in out.with_suffix(".log").read_text()
    assert not list(out.with_suffix(".jobs").glob(".tls-*")), "credentials go with their run"
