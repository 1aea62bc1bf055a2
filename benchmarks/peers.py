"""Time of one pair of images in other programs, beside ours: `python -m benchmarks.peers [--python PATH]`.

PATH is a Python in which any of OpenPIV, pivtools and fluidimage are installed (they may need other versions
of libraries than this program); by default this one. Every program gets the same pair of 1024 x 1024, one
thread, one run to warm up; CPU time, the least of three. Missing programs are named.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks import particle_images as images
from benchmarks.options import parser_of

RECORD = 12_000  # steps
CAMERAS = 3  # a pair each per step
CORES = 2

_TIMED = """
import sys, time, json, logging
import numpy as np
logging.disable(logging.CRITICAL)
images = np.load(sys.argv[1])
a, b = images["a"], images["b"]
{program}
vectors = run()
times = []
for _ in range(3):
    began = time.process_time()
    run()
    times.append(time.process_time() - began)
print("\\n" + json.dumps([min(times), vectors]))
"""

OURS = """
import cv2
cv2.setNumThreads(1)
from wavefield.matching import MatchSettings, match, prepare
settings = MatchSettings.piv()
first = prepare(a, settings)
def run():
    # of a series: an image is prepared once, and matched with the one before and the one after
    return match(first, prepare(b, settings), settings).u.size
"""

OPENPIV = """
from openpiv import filters, validation, windef
from openpiv.settings import PIVSettings
settings = PIVSettings()
settings.windowsizes, settings.overlap, settings.num_iterations = (64, 32, 32), (32, 16, {overlap}), 3
settings.sig2noise_validate, settings.sig2noise_method = False, None
a, b = a.astype(np.int32), b.astype(np.int32)
def run():
    x, y, u, v, s2n = windef.first_pass(a, b, settings)
    nothing = np.zeros_like(u, bool)
    u, v = (np.ma.masked_array(f, mask=nothing) for f in (u, v))
    flags = validation.typical_validation(u, v, s2n, settings)
    u, v = filters.replace_outliers(u, v, flags, method=settings.filter_method,
        max_iter=settings.max_filter_iteration, kernel_size=settings.filter_kernel_size)
    u, v = (np.ma.masked_array(f, mask=nothing) for f in (u, v))
    for number in (1, 2):
        x, y, u, v, _, _ = windef.multipass_img_deform(a, b, number, x, y, u, v, settings)
        u, v = (np.ma.masked_array(f, np.ma.nomask) for f in (u, v))
    return int(u.size)
"""

PIVTOOLS = """
import os, tempfile, yaml
from pathlib import Path
import pivtools_core.config as config
from pivtools_cli.cli import create_default_config
from pivtools_cli.piv.piv_backend.cpu_instantaneous import InstantaneousCorrelatorCPU
os.chdir(tempfile.mkdtemp())  # it reads and writes config.yaml in the current folder
create_default_config(Path("config.yaml"))
text = yaml.safe_load(Path("config.yaml").read_text())
text["instantaneous_piv"].update(window_size=[[n, n] for n in (64, 32, 32, 32)], overlap=[50, 50, 75, 75],
    runs=[4], peak_finder="gauss3", image_warp_interpolation="lanczos")
text["processing"]["omp_threads"] = 1
Path("config.yaml").write_text(yaml.safe_dump(text))
settings = config.Config()
settings._detected_image_shape = a.shape
correlator = InstantaneousCorrelatorCPU(settings)
stack = np.stack([a, b])[None].astype(np.float32)
def run():
    found = correlator.correlate_batch(stack, settings)
    return int((found[0] if isinstance(found, (list, tuple)) else found).passes[-1].ux_mat.size)
"""

FLUIDIMAGE = """
from fluidimage.data_objects.piv import ArrayCouple
from fluidimage.works.piv.multipass import WorkPIV
params = WorkPIV.create_default_params()
params.piv0.shape_crop_im0 = 64
params.piv0.grid.overlap = 0.75
params.multipass.number, params.multipass.coeff_zoom, params.multipass.use_tps = 3, [2, 1], "last"
work = WorkPIV(params)
def run():
    found = work.calcul(ArrayCouple(names=("a", "b"), arrays=(a, b)))
    return int(found.passes[-1].deltaxs.size)
"""

PROGRAMS = {
    "OpenPIV, 64-32-32, overlap 50 %": OPENPIV.replace("{overlap}", "16"),
    "OpenPIV, 64-32-32, overlap 75 %": OPENPIV.replace("{overlap}", "24"),
    "pivtools, 64-32-32-32, overlap 75 %": PIVTOOLS,
    "fluidimage, 64-32-32, overlap 75 %, TPS": FLUIDIMAGE,
}


def timed(python: str, program: str, pair: Path) -> tuple[float, int] | str:
    """CPU seconds of a pair and its vectors; a sentence where the program cannot be run."""
    one = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    done = subprocess.run(
        [python, "-c", _TIMED.replace("{program}", program), str(pair)],
        capture_output=True,
        text=True,
        env=os.environ | one,
    )
    if done.returncode:
        return (done.stderr.strip().splitlines() or ["no reason given"])[-1]
    seconds, vectors = json.loads(done.stdout.strip().splitlines()[-1])
    return seconds, vectors


def main(words: Sequence[str]) -> int:
    parser = parser_of(__doc__)
    parser.add_argument("--python", default=sys.executable, help="where the other programs are installed")
    options = parser.parse_args(words)
    hours = RECORD * CAMERAS / CORES / 3600
    record = f"{RECORD} steps of {CAMERAS} cameras, {CORES} cores"
    print(f"| pair of 1024 x 1024, one thread | CPU s | vectors | {record} |")
    print("|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        pair = Path(folder) / "pair.npz"
        a, b = images.particles(images.cellular(4.0))
        np.savez(pair, a=a, b=b)
        programs = [(sys.executable, "wavefield, displacement of one camera", OURS)]
        programs += [(options.python, name, program) for name, program in PROGRAMS.items()]
        for python, name, program in programs:
            found = timed(python, program, pair)
            if isinstance(found, str):
                print(f"| {name} | not run: {found} | | |", flush=True)
            else:
                print(f"| {name} | {found[0]:.3f} | {found[1]} | {found[0] * hours:.1f} h |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
