"""All benchmarks, one table: `python -m benchmarks`, or some: `python -m benchmarks matching waves`.

Each is a module of its own (`python -m benchmarks.matching`) and prints its table; this runs them one after
the other, so that none disturbs another's timing, and lists at the end which ran.
"""

import os
import subprocess
import sys
import time
from pathlib import Path

FOLDER = Path(__file__).parent
SHARED = Path(os.environ.get("WAVEFIELD_SHARED", FOLDER.parents[1] / "shared"))
NEEDS = {"specimen": SHARED / "data" / "d_specimen"}  # real images, given as the benchmark's argument


def available() -> list[str]:
    """Benchmarks of this folder: modules that can be run."""
    modules = (path for path in FOLDER.glob("*.py") if not path.stem.startswith("_"))
    return sorted(
        path.stem for path in modules if '__name__ == "__main__"' in path.read_text(encoding="utf-8")
    )


def main(names: list[str]) -> int:
    """Run the benchmarks and print their tables."""
    unknown = [name for name in names if name not in available()]
    if unknown:
        print(f"there is no benchmark {unknown[0]!r}; there are {', '.join(available())}", file=sys.stderr)
        return 2
    rows = []
    for name in names or available():
        print(f"\n## {name}: python -m benchmarks.{name}\n", flush=True)
        needed = [NEEDS[name]] if name in NEEDS else []
        if not all(path.is_dir() for path in needed):
            print(f"skipped: {needed[0]} is not there (set WAVEFIELD_SHARED)")
            rows.append((name, "skipped", ""))
            continue
        start = time.perf_counter()
        words = [sys.executable, "-m", f"benchmarks.{name}", *map(str, needed)]
        code = subprocess.run(words, cwd=FOLDER.parent).returncode
        rows.append(
            (name, "ran" if code == 0 else f"failed ({code})", f"{time.perf_counter() - start:.0f} s")
        )
    print("\n| benchmark | | took |\n|---|---|---|")
    for row in rows:
        print("| " + " | ".join(row) + " |")
    return 0 if all(row[1] in ("ran", "skipped") for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
