"""Workers of a calibration end with it, whatever ends it."""

import subprocess
import sys

import psutil
import pytest

PROGRAM = """
import os, time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from wavefield.calibration.target_images import leave_with_parent

if __name__ == "__main__":
    with ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=leave_with_parent) as pool:
        print(pool.submit(os.getpid).result(), flush=True)
        pool.submit(time.sleep, 600).result()
"""


@pytest.mark.slow
def test_no_worker_outlives_the_calibration(tmp_path):
    script = tmp_path / "program.py"
    script.write_text(PROGRAM)
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True) as program:
        worker = psutil.Process(int(program.stdout.readline()))
        program.kill()
        program.wait()
    gone, _ = psutil.wait_procs([worker], timeout=30)
    assert gone == [worker]
