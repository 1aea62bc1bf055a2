"""Real images of a plate under load, as a user would measure them, beside the results of OpenCorr.

    python -m benchmarks.loaded_plate FOLDER

FOLDER holds the four images ``GT4-*.tif`` of OpenCorr's examples (``examples/3d_dic``) and its results, a
table of 9,997 points. The rig is the calibration that the example states, level and grid are found from the
images, and all settings are left out. Printed: how many of the points lie on measured nodes, and the medians
of the absolute differences of the displacements.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
import yaml
from scipy.ndimage import map_coordinates

from benchmarks.options import parser_of
from wavefield.calibration.level_on_water import level_experiment
from wavefield.pipeline.running import run
from wavefield.rig.formats import load_rig
from wavefield.store.read import open_cube
from wavefield.variables import Quality

MICRON = 1e-6
TABLE = "GT4-0273_0_epipolar_sift_r16.csv"
LENSES = {  # of test_3d_dic_epipolar_sift.cpp: fx, fy, cx, cy in px, k1, k2, k3
    "1": (6673.315918, 6669.302734, 872.15778, 579.95532, 0.032258954, -1.01141417, 29.78838921),
    "2": (6607.618164, 6602.857422, 917.9733887, 531.6352539, 0.064598486, -4.531373978, 29.78838921),
}
ROTATION = (0.00307711, -0.33278773, 0.00524556)  # of the second camera, rad
TRANSLATION = (122.24886, 1.8488892, 17.624638)  # mm


def write_experiment(folder: Path, images: Path) -> Path:
    """The rig as OpenCV stores it, brought to metres, and the experiment file beside it."""
    storage = cv2.FileStorage(str(folder / "opencv.yaml"), cv2.FILE_STORAGE_WRITE)
    for camera, (fx, fy, cx, cy, k1, k2, k3) in LENSES.items():
        storage.write(f"M{camera}", np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]))
        storage.write(f"D{camera}", np.array([[k1, k2, 0, 0, k3]]))
    storage.write("R", cv2.Rodrigues(np.array(ROTATION))[0])
    storage.write("T", np.array(TRANSLATION).reshape(3, 1))
    storage.release()
    names = ["left", "right"]
    load_rig(folder / "opencv.yaml", dict.fromkeys(names, (1920, 1200)), names, "mm").save(
        folder / "lenses.yaml"
    )
    for number, load in enumerate(("0000", "0273")):
        for camera, name in enumerate(names):
            (folder / f"{name}_{number:05d}.tif").symlink_to(images.resolve() / f"GT4-{load}_{camera}.tif")
    experiment = {
        "name": "plate", "frame_rate": 1.0, "rig": "lenses.yaml",
        "cameras": {name: {"images": name + "_{frame:05d}.tif"} for name in names},
    }  # fmt: skip
    (folder / "experiment.yaml").write_text(yaml.safe_dump(experiment))
    return folder / "experiment.yaml"


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("folder", type=Path)
    images: Path = parser.parse_args().folder
    with TemporaryDirectory() as name:
        folder = Path(name)
        experiment = write_experiment(folder, images)
        rig = level_experiment(experiment).rig
        run(experiment, folder / "cube.zarr", rig=rig)
        cube = open_cube(folder / "cube.zarr").isel(time=0).load()
    table = np.genfromtxt(images / TABLE, delimiter=",", names=True)
    positions = [  # in the frame of the first camera, mm; brought to that of the level
        (1e-3 * np.stack([table[f"{state}_{axis}"] for axis in "xyz"], axis=1) - rig["left"].T)
        @ rig["left"].R
        for state in ("ref", "tar")
    ]
    middle, moved = np.mean(positions, axis=0), positions[1] - positions[0]
    at = [
        (middle[:, i] - cube[axis].values[0]) / np.diff(cube[axis].values)[0]
        for i, axis in ((1, "y"), (0, "x"))
    ]
    measured = map_coordinates(cube["quality"].values & Quality.MEASURED, at, order=0) > 0
    print(f"{np.sum(measured)} of {len(table)} points are on measured nodes")
    for i, axis in enumerate("uvw"):
        difference = map_coordinates(np.nan_to_num(cube[axis].values), at, order=1) - moved[:, i]
        print(f"{axis}: median |difference| {np.median(np.abs(difference[measured])) / MICRON:.2f} um")


if __name__ == "__main__":
    main()
