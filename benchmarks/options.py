"""Command lines of the benchmarks."""

import argparse
import time
from collections.abc import Callable, Mapping, Sequence


def parser_of(doc: str | None) -> argparse.ArgumentParser:
    """A parser described by the first line of a benchmark's docstring."""
    return argparse.ArgumentParser(description=(doc or "").splitlines()[0])


def run_parts(
    doc: str | None,
    parts: Mapping[str, Callable[[argparse.Namespace], None]],
    words: Sequence[str],
    seeds: Sequence[int],
) -> int:
    """Run the parts of a benchmark that ``--only`` names, with the CPU time of each."""
    parser = parser_of(doc)
    parser.add_argument("--only", nargs="+", default=list(parts), choices=list(parts))
    parser.add_argument("--seeds", nargs="+", type=int, default=list(seeds))
    options = parser.parse_args(words)
    for name in options.only:
        began = time.process_time()
        parts[name](options)
        print(f"({name}: CPU {time.process_time() - began:.0f} s)", flush=True)
    return 0
