"""How much memory a process has taken, and whether the system ended one for lack of it."""

import re
import sys
from contextlib import suppress
from pathlib import Path

from wavefield.errors import StoreError

_OUT_OF_MEMORY = -4  # of OpenCV's errors
_REMEDY = "ask for fewer `workers`, or a smaller `steps_per_block`, in the workflow"


def peak_memory() -> int:
    """Most memory that this process has used so far, bytes."""
    try:
        import resource
    except ImportError:
        return 0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def kills_for_memory() -> int:
    """Processes that the system has ended so far because memory ran out, as far as it counts them."""
    files = [Path("/proc/vmstat"), Path("/sys/fs/cgroup/memory.events")]
    with suppress(OSError):
        for line in Path("/proc/self/cgroup").read_text().splitlines():
            group = line.split(":", 2)[2].lstrip("/")
            files.append(Path("/sys/fs/cgroup", group, "memory.events"))
            files.append(Path("/sys/fs/cgroup/memory", group, "memory.oom_control"))
    count = 0
    for file in dict.fromkeys(files):
        with suppress(OSError):
            count += sum(map(int, re.findall(r"^oom_kill (\d+)$", file.read_text(), re.MULTILINE)))
    return count


def spell_need(taken: int) -> str:
    """What a worker needs, from what it had taken when it ended."""
    return f"needs at least {taken / 1e9:.2g} GB per worker"


def memory_error(error: Exception) -> StoreError | None:
    """A sentence for an allocation that failed; None for another error."""
    if not isinstance(error, MemoryError) and getattr(error, "code", None) != _OUT_OF_MEMORY:
        return None
    detail = f" ({error})" if str(error) else ""
    return StoreError(f"memory ran out: the work {spell_need(peak_memory())}, and more{detail}; {_REMEDY}")


def lost_for_memory(taken: int, workers: int) -> StoreError:
    """A sentence for workers that the system ended for lack of memory."""
    return StoreError(
        f"memory ran out: the system ended {workers} workers one after the other over the same work, which "
        f"{spell_need(taken)}; {_REMEDY}"
    )
