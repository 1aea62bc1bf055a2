"""`python -m benchmarks` lists the benchmarks, a line each."""

import ast
from pathlib import Path


def main() -> None:
    """Print the name and the first line of every module that can be run."""
    for path in sorted(Path(__file__).parent.glob("*.py")):
        text = path.read_text(encoding="utf-8")
        if path.stem != "__main__" and '__name__ == "__main__"' in text:
            first = (ast.get_docstring(ast.parse(text)) or "").splitlines()[0]
            print(f"python -m benchmarks.{path.stem:14s} {first}")


if __name__ == "__main__":
    main()
