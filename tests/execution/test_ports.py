"""What a run with the shipped local workflow opens to the network: nothing but the loopback."""

import subprocess
import sys
import threading
from pathlib import Path

import psutil
import pytest

SHIPPED = Path(__file__).parents[2] / "workflows" / "local.yaml"
LOOPBACK = {"127.0.0.1", "::1"}


def listening(process):
    """Addresses at which a process and its descendants wait for others, and how many were examined."""
    found, examined = set(), 0
    try:
        family = [process, *process.children(recursive=True)]
    except psutil.Error:
        return found, examined
    for member in family:
        try:
            for one in member.net_connections("inet"):
                waits = one.status == "LISTEN" or (one.type.name == "SOCK_DGRAM" and not one.raddr)
                if waits and one.laddr:
                    found.add(one.laddr.ip)
            examined += 1
        except psutil.Error:
            continue
    return found, examined


@pytest.mark.skipif(not SHIPPED.exists(), reason="the workflows lie beside the package's source only")
def test_no_command_of_the_local_workflow_listens_beyond_the_loopback(own_tank):
    own_tank.write_text(own_tank.read_text() + "frames: {last: 9}\n")
    cube = str(own_tank.parent / "cube.zarr")
    commands = (
        ["run", str(own_tank), "--workflow", str(SHIPPED)],
        ["status", cube],
        ["verify", cube],
        ["analyze", cube, "--segment", "8"],
    )
    script = f"""
import sys
from wavefield.commands.cli import main
sys.exit(max(main(["-q", *words]) for words in {commands!r}))
"""
    process = subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )
    watched, found, most = psutil.Process(process.pid), set(), [0]
    over = threading.Event()

    def watch():
        while not over.wait(0.1):
            ips, examined = listening(watched)
            found.update(ips)
            most[0] = max(most[0], examined)

    thread = threading.Thread(target=watch)
    thread.start()
    try:
        printed = process.communicate(timeout=300)[0].decode()
    finally:
        over.set()
        thread.join()
    assert process.returncode in (0, 3), printed
    assert most[0] >= 2, "its workers were not seen"
    assert found <= LOOPBACK
