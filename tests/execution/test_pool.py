"""Worker processes leave nothing behind."""

import subprocess
import sys

WORK = """
import multiprocessing
from wavefield.execution.pool import Pool

kept = []

def work(item):
    kept.append(multiprocessing.Lock())  # as Blosc does when it first compresses
    return item

if __name__ == "__main__":
    print(sorted(item for item, _ in Pool(2).map_unordered(work, [1, 2, 3])))
"""


def test_locks_that_libraries_make_in_workers_are_not_left_behind(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(WORK)
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=120)
    assert done.stdout == "[1, 2, 3]\n"
    assert done.stderr == ""  # the tracker of resources counts what is left, at the very end
