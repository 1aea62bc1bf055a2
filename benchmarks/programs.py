"""Other programs for particle images, each run in a Python that has the libraries it needs."""

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

# each defines run(), which returns x, y (px), u, v (px) of the vectors between images a and b
OPENPIV = """
from openpiv import filters, validation, windef
from openpiv.settings import PIVSettings
settings = PIVSettings()
settings.windowsizes, settings.overlap, settings.num_iterations = (64, 32, 32), (32, 16, 24), 3
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
    return x - 0.5, y - 0.5, u, v
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
    last = (found[0] if isinstance(found, (list, tuple)) else found).passes[-1]
    return *np.meshgrid(last.win_ctrs_x, last.win_ctrs_y), last.ux_mat, last.uy_mat
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
    last = work.calcul(ArrayCouple(names=("a", "b"), arrays=(a, b))).passes[-1]
    return last.xs, last.ys, last.deltaxs_final, last.deltays_final
"""
PROGRAMS = {
    "OpenPIV, 64-32-32, overlap 75 %": OPENPIV,
    "pivtools, 64-32-32-32, overlap 75 %": PIVTOOLS,
    "fluidimage, 64-32-32, overlap 75 %, thin plates": FLUIDIMAGE,
}
_ASKED = """
import sys, time, logging
import numpy as np
logging.disable(logging.CRITICAL)
images = np.load(sys.argv[1])
a, b = images["a"], images["b"]
{program}
run()  # the first run compiles or loads
began = time.process_time()
x, y, u, v = (np.ma.filled(np.ma.asarray(field, float), np.nan) for field in run())
np.savez(sys.argv[2], x=x, y=y, u=u, v=v, seconds=time.process_time() - began)
"""


@dataclass(frozen=True)
class Vectors:
    """Displacements, px, and the CPU time of the pair, s."""

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    u: NDArray[np.float64]
    v: NDArray[np.float64]
    seconds: float


def is_installed(name: str, python: str) -> bool:
    """Whether a Python has a program; says so if not."""
    package = name.partition(",")[0].lower()
    module = {"pivtools": "pivtools_core"}.get(package, package)
    found = subprocess.run([python, "-c", f"import {module}"], capture_output=True).returncode == 0
    if not found:
        print(f"{package} is not installed in {python}: left out", file=sys.stderr)
    return found


def vectors_of(name: str, python: str, a: NDArray[np.uint8], b: NDArray[np.uint8]) -> Vectors | str:
    """Vectors of a program on one thread; a sentence where it cannot be run."""
    script = _ASKED.replace("{program}", PROGRAMS[name])
    one = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    with TemporaryDirectory() as place:
        pair, found = Path(place) / "pair.npz", Path(place) / "found.npz"
        np.savez(pair, a=a, b=b)
        command = [python, "-c", script, str(pair), str(found)]
        done = subprocess.run(command, capture_output=True, text=True, env=os.environ | one)
        if done.returncode:
            return (done.stderr.strip().splitlines() or ["no reason given"])[-1]
        with np.load(found) as file:
            return Vectors(*(file[name] for name in "xyuv"), float(file["seconds"]))
