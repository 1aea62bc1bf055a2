"""Following cameras that write: how late the picture is, what memory does, which light turns.

    python -m benchmarks.follow [--only latency memory lights] [--size half full] [--seconds 60]
                                [--seeds 301 302 303]

Latency: a process writes 20 frames/s of three cameras, `wavefield follow` measures, a page in headless
Chromium shows; from the last byte of a set of frames until the browser has painted its map. Memory: of the
process of `wavefield follow` over as many seconds as are asked for. Lights: in real time too; the lens, the
camera and the beads are spoiled in the simulated tank, not in its images.
"""

import argparse
import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "explorer"))

from browser import FLAGS, chromium

from benchmarks.cubes import say
from benchmarks.scenes import FULL, HALF
from wavefield.explorer.follower import Follower
from wavefield.explorer.lights import worst_light
from wavefield.images import write_image
from wavefield.series import Experiment
from wavefield.tank import Scene, Tank

RATE = 20.0
DRAWN = 12  # frames, shown forwards and backwards in turn
_REAL = 200  # newest numbers that are files of their own; older ones become links, or a disk would be full
_PAINTED = """() => {
  window._shown = []
  const title = Bokeh.documents[0].get_model_by_name('map').title
  title.properties.text.change.connect(() => {
    const text = title.text
    requestAnimationFrame(() => setTimeout(() => window._shown.push([text, Date.now()]), 0))
  })
}"""

Frames = list[dict[str, NDArray[Any]]]


def prepare(folder: Path, scene: Scene) -> tuple[Path, Frames]:
    """An experiment whose cameras have written nothing yet, and what they will write."""
    tank = Tank(scene)
    folder.mkdir(parents=True)
    tank.rig.save(folder / "rig.yaml")
    cameras = "".join(f'  {name}: "{name}/img_{{frame:06d}}.tif"\n' for name in tank.rig)
    grid = scene.grid
    path = folder / "experiment.yaml"
    path.write_text(
        f"name: live\nframe_rate: {RATE:g}\ncameras:\n{cameras}rig: rig.yaml\n"
        f"grid: {{x: {list(grid.x)}, y: {list(grid.y)}, step: {grid.step}}}\n"
    )
    for name in tank.rig:
        (folder / name).mkdir()
    return path, [tank.render(number) for number in range(DRAWN)]


class Cameras(threading.Thread):
    """Three cameras that write at their own pace; what they see can change while they do."""

    def __init__(self, folder: Path, frames: Frames) -> None:
        super().__init__(daemon=True)
        self.folder, self.frames = folder, frames
        self.silent = ""
        self.number = -1
        self.written: dict[int, float] = {}  # frame: when its last byte was, s since the epoch
        self._stop_writing = threading.Event()

    def run(self) -> None:
        begun = time.time()
        turn = [*range(DRAWN), *range(DRAWN - 2, 0, -1)]
        number = 0
        while not self._stop_writing.wait(max(begun + number / RATE - time.time(), 0.0)):
            for name, image in self.frames[turn[number % len(turn)]].items():
                if name != self.silent:
                    write_image(self._file(name, number), image)
            self.written[number] = time.time()
            self.number = number
            self._thin(number - _REAL)
            number += 1

    def _file(self, name: str, number: int) -> Path:
        return self.folder / name / f"img_{number:06d}.tif"

    def _thin(self, number: int) -> None:
        for name in self.frames[0]:
            old, kept = self._file(name, number), self._file(name, 0)
            if number > 0 and old.exists():
                draft = old.with_suffix(".draft")
                os.link(kept, draft)
                os.replace(draft, old)

    def stop(self) -> None:
        self._stop_writing.set()
        self.join()


def write_on(folder: Path, frames: Path, seconds: float, out: Path) -> None:
    """The cameras as a process of their own: for so long, then it says when each frame was whole."""
    stored = np.load(frames)
    names = sorted(stored.files)
    cameras = Cameras(folder, [{name: stored[name][k] for name in names} for k in range(DRAWN)])
    cameras.start()
    time.sleep(seconds)
    cameras.stop()
    out.write_text(json.dumps(cameras.written))


@contextmanager
def served(experiment: Path) -> Iterator[tuple[str, psutil.Process]]:
    """`wavefield follow` as people start it; gives its address."""
    command = [sys.executable, "-m", "wavefield.commands.cli", "follow", str(experiment), "--port", "0"]
    process = subprocess.Popen([*command, "--no-open"], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        yield (
            next(line for line in process.stdout if "http://" in line).split()[1],
            psutil.Process(process.pid),
        )
    finally:
        process.terminate()
        process.wait()


def follow(folder: Path, scene: Scene, seconds: float) -> dict[str, Any]:
    """Cameras, program and browser for so many seconds."""
    from playwright.sync_api import sync_playwright

    experiment, frames = prepare(folder, scene)
    stored, log = folder / "frames.npz", folder / "written.json"
    np.savez(stored, **{name: np.array([f[name] for f in frames]) for name in frames[0]})
    errors: list[str] = []
    memory: list[tuple[float, float]] = []
    with served(experiment) as (url, process), sync_playwright() as started:
        browser = started.chromium.launch(executable_path=chromium(), args=FLAGS.split())
        page = browser.new_page(viewport={"width": 1400, "height": 900})
        page.on("console", lambda m: errors.append(m.text) if m.type == "error" else None)
        page.goto(url)
        page.wait_for_function("() => window.Bokeh && Bokeh.documents.length")
        page.evaluate(_PAINTED)
        words = ["-m", "benchmarks.follow", "--write", str(folder), str(stored), str(seconds), str(log)]
        begun = time.time()
        writer = subprocess.Popen([sys.executable, *words])
        while writer.poll() is None:
            memory.append((time.time() - begun, process.memory_info().rss / 1e6))
            page.wait_for_timeout(2000)
        shown = page.evaluate("window._shown")
        state = page.evaluate("Bokeh.documents[0].get_model_by_name('state_words').text")
        browser.close()
    written = {int(k): v for k, v in json.loads(log.read_text()).items()}
    pictures = {int(m[1]): at / 1e3 for text, at in shown if (m := re.search(r"frame (\d+)$", text))}
    return {
        "delays": {n: at - written[n + 1] for n, at in pictures.items() if n + 1 in written},
        "first": min(pictures.values(), default=float("nan")) - begun,
        "rate": (len(written) - 1) / (max(written.values()) - min(written.values())),
        "memory": memory,
        "state": state,
        "errors": errors,
    }


def say_delays(found: dict[str, Any], what: str, seconds: float) -> None:
    """How long after the last byte of a set its picture is there; the first three, while it learns, apart."""
    delays = np.array([d for n, d in sorted(found["delays"].items())])
    if not delays.size:
        say(f"last byte to picture, {what}", "2 s", f"no picture within {seconds:g} s")
        return
    later = delays[3:] if len(delays) > 6 else delays
    reached = (
        f"median {np.median(later):.2f}, 95 % {np.percentile(later, 95):.2f}, most {later.max():.2f} s "
        f"({len(delays)} pictures; the first {found['first']:.1f} s after the cameras began)"
    )
    say(f"last byte to picture, {what}", "2 s", reached)


def latency(folder: Path, options: argparse.Namespace) -> None:
    """From the last byte to the picture."""
    for size in options.size:
        scene = Scene.load("full").with_(seed=301, **{"half": HALF, "full": FULL}[size])
        found = follow(folder / size, scene, options.seconds)
        pixels = "{} x {}".format(*scene.build_rig()["cam1"].size)
        say_delays(found, f"3 x {pixels} px, {found['rate']:.1f} frames/s", options.seconds)
        say("    what the page says of it", "what it skips", found["state"])
        say("    console errors", "0", str(len(found["errors"])))


def memory(folder: Path, options: argparse.Namespace) -> None:
    """Whether memory grows."""
    for size in options.size:
        scene = Scene.load("full").with_(seed=302, **{"half": HALF, "full": FULL}[size])
        found = follow(folder / f"long_{size}", scene, options.seconds)
        t, megabytes = np.array(found["memory"]).T
        settled = t > 0.3 * t[-1]
        slope, _ = np.polyfit(t[settled] / 60, megabytes[settled], 1)
        reached = (
            f"{slope:+.2f} MB/min over the last {t[-1] - t[settled][0]:.0f} of {t[-1]:.0f} s; "
            f"{megabytes[settled][0]:.0f} MB, at the end {megabytes[-1]:.0f} MB"
        )
        say(f"memory of `follow`, {size} size", "no growth", reached)
        say_delays(found, f"{size} size", options.seconds)
        say("    what the page says at the end", "", found["state"])


FAULTS: dict[str, tuple[str, dict[str, Any]]] = {
    "a lens turned out of focus": ("focus cam2", {"faults": {"cam2": {"defocus": 1.5}}}),
    "a lamp switched off": (
        "brightness",
        {"surface": {"brightness": 8.0}, "light": {"background": 1.5}},
    ),
    "a camera knocked": ("eps_y cam2", {"faults": {"cam2": {"turned": (0.3, 0.2, 0.0)}}}),
    "a cable pulled": ("synchronisation cam3", {}),
    "beads gone": ("seeding", {"surface": {"density": 400.0}}),
}


def _wait(condition: Callable[[], bool], most: float) -> float:
    """Seconds until something holds; infinite if it never does."""
    begun = time.time()
    while time.time() - begun < most:
        if condition():
            return time.time() - begun
        time.sleep(0.02)
    return float("inf")


def lights(folder: Path, options: argparse.Namespace) -> None:
    """The light that turns, five faults one after the other, each mended again."""
    right, took, alarms, sets = 0, [], [], 0
    for seed in options.seeds:
        scene = Scene.load("full").with_(seed=seed, **HALF)
        experiment, good = prepare(folder / str(seed), scene)
        spoiled = {
            name: [Tank(scene.with_(**change)).render(k) for k in range(DRAWN)] if change else good
            for name, (_, change) in FAULTS.items()
        }
        follower, cameras = Follower(Experiment.load(experiment)), Cameras(folder / str(seed), good)
        follower.start()
        cameras.start()

        def first(follower: Follower = follower) -> str:
            light = worst_light(follower.latest.lights) if follower.latest else None
            return f"{light.name} {light.camera}".strip() if light else ""

        def settled(follower: Follower = follower) -> bool:
            return follower.latest is not None and follower.latest.measured >= 8

        _wait(settled, 120)
        for name, (expected, _) in FAULTS.items():
            watched, until = set(), time.time() + 2.0
            while time.time() < until:  # nothing is wrong
                watched.add((follower.count, first()))
                time.sleep(0.02)
            sets += len({count for count, _ in watched})
            alarms += [f"seed {seed}, before {name}: {said}" for _, said in watched if said]
            begun, said = cameras.number + 1, ""
            cameras.frames, cameras.silent = spoiled[name], "cam3" if name == "a cable pulled" else ""
            seconds = _wait(lambda: bool(first()), 6.0)
            seconds = _wait(lambda e=expected: _is(first(), e), 6.0 - min(seconds, 6.0)) + seconds
            said = first()
            good_light = _is(said, expected) and seconds <= 3.0
            right += good_light
            took.append(seconds)
            mark = "" if good_light else f"  <- asked {expected}"
            print(f"    seed {seed}, {name}: {said or 'nothing'} after {seconds:.1f} s, "
                  f"{cameras.number - begun + 1} frames{mark}", flush=True)  # fmt: skip
            cameras.frames, cameras.silent = good, ""
            _wait(lambda: first() == "", 6.0)
        cameras.stop()
        follower.stop()
    count = len(FAULTS) * len(options.seeds)
    say("the right light first, within 3 s of frames", f"{count} of {count}", f"{right} of {count}")
    say("    after", "3 s", f"median {statistics.median(took):.1f}, most {max(took):.1f} s")
    say("    sets of sound frames with a red light", "0", f"{len(alarms)} of {sets}")
    print("".join(f"    {alarm}\n" for alarm in sorted(set(alarms))), end="")


def _is(said: str, expected: str) -> bool:
    """Whether a light is the one asked for: its name, and the camera where one is to blame."""
    name, _, camera = expected.partition(" ")
    return said.startswith(name) and camera in said


PARTS = {"latency": latency, "memory": memory, "lights": lights}


def main(words: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", nargs="+", default=list(PARTS), choices=list(PARTS))
    parser.add_argument("--size", nargs="+", default=["half", "full"], choices=["half", "full"])
    parser.add_argument("--seconds", type=float, default=60.0, help="for which the cameras write")
    parser.add_argument("--seeds", type=int, nargs="+", default=[301, 302, 303], help="of the lights' seas")
    parser.add_argument("--write", nargs=4, help=argparse.SUPPRESS)
    options = parser.parse_args(words)
    if options.write:
        folder, frames, seconds, out = options.write
        write_on(Path(folder), Path(frames), float(seconds), Path(out))
        return 0
    with tempfile.TemporaryDirectory() as folder:
        for name in options.only:
            PARTS[name](Path(folder), options)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
