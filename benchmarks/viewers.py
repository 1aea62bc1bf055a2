"""Two people look at a job that is running: what it costs the job.

    python -m benchmarks.viewers [--steps 240] [--repeats 2]

The same run, with one worker, alone and with two pages of `wavefield look` open on its cube, in turn. The
pages go to the newest step every second and click a node every three. Wall time, and CPU time of the run
itself. Other people's browsers draw on their machines: here they run as well, on what the run and the page's
server leave to them (nice 19; `--browsers-too` lets them compete).
"""

import argparse
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "explorer"))

import psutil
from browser import FLAGS, Browser, chromium

from benchmarks.cubes import say, write_tank
from benchmarks.scenes import HALF
from wavefield.tank import Scene

_NAMED = "Bokeh.documents[0].get_model_by_name"
_NEWEST = f"""() => {{
  const words = {_NAMED}('state_words').text.match(/measured so far: (\\d+)/)
  if (words) {_NAMED}('step').value = Math.max(Number(words[1]) - 1, 0)
}}"""


def run(experiment: Path, out: Path) -> tuple[subprocess.Popen[bytes], float, float]:
    """A run through the command line, when it began, and the CPU time of what had ended before."""
    workflow = out.with_suffix(".yaml")
    workflow.write_text("cluster: none\nsteps_per_block: 12\n")
    words = ["run", str(experiment), "-o", str(out), "--workflow", str(workflow)]
    command = [sys.executable, "-m", "wavefield.commands.cli", "-q", *words]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL), time.perf_counter(), _spent()


def _spent() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def ended(process: subprocess.Popen[bytes], begun: float, spent: float) -> tuple[float, float]:
    """Wall and CPU time of a run, s."""
    if process.wait() not in (0, 3):
        raise RuntimeError(f"the run ended with {process.returncode}")
    return time.perf_counter() - begun, _spent() - spent


def step_back() -> None:
    """Leave the processor to the others: every process of the browsers, and those that they will start."""
    for process in psutil.Process().children(recursive=True):
        words = " ".join(process.cmdline())
        if "chrom" in words or "playwright" in words:
            process.nice(19)


def watched(experiment: Path, out: Path, compete: bool) -> tuple[float, float, int, list[str]]:
    """A run that two people look at; also how often a page has shown something new."""
    from playwright.sync_api import sync_playwright

    process, begun, spent = run(experiment, out)
    while not (out / "zarr.json").exists():
        time.sleep(0.05)
    command = [sys.executable, "-m", "wavefield.commands.cli", "look", str(out), "--port", "0", "--no-open"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    url = next(line for line in server.stdout if "http://" in line).split()[1]
    shown: set[tuple[int, str]] = set()
    with sync_playwright() as started:
        browser = started.chromium.launch(executable_path=chromium(), args=FLAGS.split())
        if not compete:
            step_back()
        people = [Browser(browser.new_page(viewport={"width": 1400, "height": 900})) for _ in range(2)]
        for person in people:
            person.open(url)
        turn = 0
        while process.poll() is None:
            for number, person in enumerate(people):
                person.page.evaluate(_NEWEST)
                if turn % 3 == number:
                    person.click("map", 0.02 * (turn % 9 - 4), 0.1)
                shown.add((number, person.get("map", "title.text")))
            people[0].page.wait_for_timeout(1000)
            turn += 1
        wall, cpu = ended(process, begun, spent)
        errors = [error for person in people for error in person.errors]
        browser.close()
    server.terminate()
    server.wait()
    return wall, cpu, len(shown), errors


def main(words: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--steps", type=int, default=240)
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--browsers-too", action="store_true", help="let the browsers compete with the run")
    options = parser.parse_args(words)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        scene = Scene.load("full").with_(seed=321, **HALF)
        experiment = write_tank(folder / "tank", scene, options.steps)
        alone, looked_at, errors, views = [], [], [], 0
        for number in range(options.repeats):
            alone.append(ended(*run(experiment, folder / f"alone{number}.zarr")))
            wall, cpu, seen, wrong = watched(
                experiment, folder / f"watched{number}.zarr", options.browsers_too
            )
            looked_at.append((wall, cpu))
            errors += wrong
            views += seen
        for k, (what, asked) in enumerate((("wall", "+ 2 %"), ("CPU of the run", ""))):
            one, two = (statistics.median(times[k] for times in both) for both in (alone, looked_at))
            say(
                f"a job with two people looking, {what}",
                asked,
                f"{100 * (two / one - 1):+.1f} %  ({one:.1f} s alone)",
            )
        say("    views they saw; console errors", "", f"{views}; {len(errors)}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
