"""Two people watch a job that is running: its cost for the job.

    python -m benchmarks.viewers [--steps 240] [--repeats 2]

The same run, with one worker, alone and with two pages of `wavefield look` open on its cube, in turn. The
pages go to the newest step every second and click a node every three. Wall time, and CPU time of the run
itself. Other people's browsers draw on their machines: here they run as well, on what the run and the page's
server leave to them (policy IDLE; `--browsers-too` lets them compete).
"""

import resource
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "explorer"))

from browser import FLAGS, Browser, chromium

from benchmarks.command_runs import print_row, write_tank
from benchmarks.options import parser_of
from benchmarks.scenes import HALF
from wavefield.tank import Scene

_NAMED = "Bokeh.documents[0].get_model_by_name"
_NEWEST = f"""() => {{
  const words = {_NAMED}('state_words').text.match(/measured so far: (\\d+)/)
  if (words) {_NAMED}('step').value = Math.max(Number(words[1]) - 1, 0)
}}"""


class Run:
    """A run through the command line; a thread of its own notes when it ends, whatever pages do."""

    def __init__(self, experiment: Path, out: Path) -> None:
        self._before = _spent()
        self._begun = time.perf_counter()
        self._process = _start(experiment, out)
        self._wall = 0.0
        self._waiting = threading.Thread(target=self._wait)
        self._waiting.start()

    def _wait(self) -> None:
        self._process.wait()
        self._wall = time.perf_counter() - self._begun

    @property
    def at_work(self) -> bool:
        """Whether it has not ended."""
        return self._waiting.is_alive()

    def times(self) -> tuple[float, float]:
        """Wall and CPU time, s, once it has ended."""
        self._waiting.join()
        if self._process.returncode not in (0, 3):
            raise RuntimeError(f"the run ended with {self._process.returncode}")
        return self._wall, _spent() - self._before


def _start(experiment: Path, out: Path) -> subprocess.Popen[bytes]:
    workflow = out.with_suffix(".yaml")
    workflow.write_text("cluster: none\nsteps_per_block: 12\n")
    words = ["run", str(experiment), "-o", str(out), "--workflow", str(workflow)]
    command = [sys.executable, "-m", "wavefield.commands.cli", "-q", *words]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL)


def _spent() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _last(folder: Path) -> str:
    """A Chromium that leaves the processor to the others, with all of its threads.

    By policy: niceness it sets itself, back up where it may. It has a session of its own, whose share of the
    processor Linux sets apart from what is in it.
    """
    script = folder / "chromium"
    words = "echo 19 2>/dev/null >/proc/self/autogroup", f'exec chrt --idle 0 {chromium()} "$@"'
    script.write_text("\n".join(("#!/bin/sh", *words, "")))
    script.chmod(0o755)
    return str(script)


def watched(experiment: Path, out: Path, compete: bool) -> tuple[float, float, int, list[str]]:
    """A run that two people watch; also how often a page has shown something new."""
    from playwright.sync_api import sync_playwright

    job = Run(experiment, out)
    while not (out / "zarr.json").exists():
        time.sleep(0.05)
    command = [sys.executable, "-m", "wavefield.commands.cli", "look", str(out), "--port", "0", "--no-open"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    url = next(line for line in server.stdout if "http://" in line).split()[1]
    shown: set[tuple[int, str]] = set()
    with sync_playwright() as started:
        program = chromium() if compete else _last(out.parent)
        browser = started.chromium.launch(executable_path=program, args=FLAGS.split())
        people = [Browser(browser.new_page(viewport={"width": 1400, "height": 900})) for _ in range(2)]
        for person in people:
            person.open(url)
        turn = 0
        while job.at_work:
            for number, person in enumerate(people):
                person.page.evaluate(_NEWEST)
                if turn % 3 == number:
                    person.click("map", 0.02 * (turn % 9 - 4), 0.1)
                shown.add((number, person.get("map", "title.text")))
            people[0].page.wait_for_timeout(1000)
            turn += 1
        wall, cpu = job.times()
        errors = [error for person in people for error in person.errors]
        browser.close()
    server.terminate()
    server.wait()
    return wall, cpu, len(shown), errors


def main(words: Sequence[str]) -> int:
    parser = parser_of(__doc__)
    parser.add_argument("--steps", type=int, default=240)
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--browsers-too", action="store_true", help="let the browsers compete with the run")
    options = parser.parse_args(words)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        scene = Scene.load("full").with_(seed=321, **HALF)
        experiment = write_tank(folder / "tank", scene, options.steps)
        alone, used_blocks, errors, views = [], [], [], 0
        for number in range(options.repeats):
            alone.append(Run(experiment, folder / f"alone{number}.zarr").times())
            wall, cpu, seen, wrong = watched(
                experiment, folder / f"watched{number}.zarr", options.browsers_too
            )
            used_blocks.append((wall, cpu))
            errors += wrong
            views += seen
        for k, (what, asked) in enumerate((("wall", "+ 2 %"), ("CPU of the run", ""))):
            one, two = (statistics.median(times[k] for times in both) for both in (alone, used_blocks))
            print_row(
                f"a job with two people looking, {what}",
                asked,
                f"{100 * (two / one - 1):+.1f} %  ({one:.1f} s alone)",
            )
        print_row("    views they saw; console errors", "", f"{views}; {len(errors)}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
