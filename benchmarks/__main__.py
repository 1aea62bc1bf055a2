"""All benchmarks, one table: `python -m benchmarks`, or some: `python -m benchmarks matching waves`.

Each is a module of its own (`python -m benchmarks.matching`) and prints its table; this runs them one after
the other, so that none disturbs another's timing, and says at the end which ran.
"""

import subprocess
import sys
import time
from pathlib import Path

FOLDER = Path(__file__).parent


def available() -> list[str]:
    """Benchmarks of this folder: modules that can be run."""
    modules = (path for path in FOLDER.glob("*.py") if not path.stem.startswith("_"))
    return sorted(
        path.stem for path in modules if '__name__ == "__main__"' in path.read_text(encoding="utf-8")
    )


def main(names: list[str]) -> int:
    """Run the benchmarks and print what each says."""
    unknown = [name for name in names if name not in available()]
    if unknown:
        print(f"there is no benchmark {unknown[0]!r}; there are {', '.join(available())}", file=sys.stderr)
        return 2
    rows = []
    for name in names or available():
        print(f"\n## {name}: python -m benchmarks.{name}\n", flush=True)
        start = time.perf_counter()
        code = subprocess.run([sys.executable, "-m", f"benchmarks.{name}"], cwd=FOLDER.parent).returncode
        rows.append(
            (name, "ran" if code == 0 else f"failed ({code})", f"{time.perf_counter() - start:.0f} s")
        )
    print("\n| benchmark | | took |\n|---|---|---|")
    for row in rows:
        print("| " + " | ".join(row) + " |")
    return 0 if all(row[1] == "ran" for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
