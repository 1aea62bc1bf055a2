"""What the measurement reaches on simulated images, against the exact answer.

    python -m benchmarks.measurement [--quick] [--exact] [--preset fast] [--scale S] [--shared DIR]
        [--pictures DIR]

Full-size cameras, grid of 1 cm over 2 x 1.5 m, 1 px = 1.8 mm, nodes 4 cm inside the edge of the common view.
The rig is calibrated from simulated target images (``--exact``: the exact cameras), except for the texture,
as in the paper. ``--quick``: the middle of the field at full resolution.
"""

import argparse
import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import time
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial import cKDTree

from wavefield.calibration import Target, calibrate, find_target
from wavefield.grid import Grid
from wavefield.measurement import Plan, Settings, diagnose, measure
from wavefield.measurement import surface as stereo
from wavefield.measurement.frame import ready
from wavefield.rig import Rig
from wavefield.tank import Scene, Tank
from wavefield.variables import Quality
from wavefield.waves.kinematics import terms

cv2.setNumThreads(1)
PIXEL = 1.8e-3
MARGIN = 0.04

# the tank's presets at full size: (preset, changes)
SCENES = {
    "texture": ("texture", {}),
    "rest": ("rest", {"surface": {"brightness": 110.0}}),
    "random": ("full", {}),
    "steep": ("steep", {"surface": {"brightness": 110.0}}),
    "noisy": ("noisy", {"surface": {"brightness": 110.0}}),
    "holes": ("full", {"surface": {"holes": 12, "hole_diameter": 0.10}}),
    "light": ("full", {"light": {"gain": {"cam1": 0.4, "cam2": 2.0}, "flicker": 0.3}}),
}


FRAMES, FIRST = 6, 2  # frames drawn, and the first frame of the step that is judged


@dataclass
class Case:
    tank: Tank
    grid: Grid
    frames: dict[str, list[np.ndarray]]
    truth: object
    inside: np.ndarray


def rms(values: np.ndarray) -> float:
    values = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else float("nan")


class Bench:
    def __init__(self, options: argparse.Namespace):
        self.options = options
        self.settings = Settings.from_dict({"preset": options.preset})
        self.rig_options = {"scale": options.scale, "crop": 0.45 if options.quick else 1.0}
        if options.quick:
            self.grid = Grid((-0.44, 0.44), (-0.34, 0.34), 0.01)
        else:
            self.grid = Grid((-1.0, 1.0), (-0.75, 0.75), 0.01)
        self.rows: list[tuple[str, str, str]] = []
        self.cases: dict[str, Case] = {}
        self.calibrated: Rig | None = None

    # -- cases ---------------------------------------------------------------------------------------

    def scene(self, name: str) -> Scene:
        preset, changes = SCENES[name]
        scene = Scene.load(preset).with_(frames=FRAMES, rig=self.rig_options, **changes)
        return scene.with_(grid={"x": self.grid.x, "y": self.grid.y, "step": self.grid.step})

    def case(self, name: str) -> Case:
        if name not in self.cases:
            tank = Tank(self.scene(name))
            images = [tank.render(k) for k in range(FRAMES)]
            frames = {camera: [image[camera] for image in images] for camera in tank.rig}
            truth = tank.truth(FIRST)
            self.cases[name] = Case(tank, self.grid, frames, truth, self.inside(tank.rig, truth.z))
        return self.cases[name]

    def inside(self, rig: Rig, z: np.ndarray) -> np.ndarray:
        """Nodes at least MARGIN inside the edge of the common view."""
        step, n = self.grid.step, int(np.ceil(MARGIN / self.grid.step)) + 2
        x, y = self.grid.x_nodes, self.grid.y_nodes
        x = x[0] + step * np.arange(-n, x.size + n)
        y = y[0] + step * np.arange(-n, y.size + n)
        x, y = np.meshgrid(x, y)
        wide = np.pad(z, n, mode="edge")
        seen = np.all([camera.sees(x, y, wide) for camera in rig.cameras.values()], axis=0)
        distance = cv2.distanceTransform(np.pad(seen, 1).astype(np.uint8), cv2.DIST_L2, 5)[1:-1, 1:-1]
        return (distance * step > MARGIN)[n:-n, n:-n]

    def rig(self) -> Rig:
        """Calibrated from the target images of the random sea's experiment, or exact."""
        tank = self.case("random").tank
        if self.options.exact:
            return tank.rig
        if self.calibrated is None:
            described = tank.scene.calibration.target
            target = Target.from_dict(
                {"kind": "strings", "mesh": described.mesh, "origin_mark": "disc", "x_mark": "small disc"}
            )
            views = {
                camera: {
                    pose: find_target(tank.target_image(pose, camera), target) for pose in tank.target_poses
                }
                for camera in tank.rig
            }
            result = calibrate(views, target)
            if not result.usable:
                raise SystemExit(f"calibration is not usable: {result.problems}")
            self.calibrated = result.rig
        return self.calibrated

    def cube(self, name: str, settings: Settings | None = None, frames=None, rig=None):
        case = self.case(name)
        plan = Plan(rig or self.rig(), self.grid, settings or self.settings)
        rate = case.tank.scene.frame_rate
        out = measure(frames or case.frames, plan, rate)
        # of three steps the one in the middle; its neighbours give the mean elevation of its two frames
        mean = out["z"][1:2] + (out["z_t"][2:] - out["z_t"][:1]) / (16.0 * rate)
        return {name: field[1:2] for name, field in out.items()} | {"mean": mean}

    def errors(self, name: str, out) -> dict[str, np.ndarray]:
        """Errors in px: z; u dt, v dt, w dt against instantaneous truth; dx, dy, dz against displacements."""
        case, dt = self.case(name), 1.0 / self.case(name).tank.scene.frame_rate
        truth = case.truth
        error = {"z": out["z"][0] - truth.z}
        for name_, exact, moved in (
            ("u", truth.u, truth.dx),
            ("v", truth.v, truth.dy),
            ("w", truth.w, truth.dz),
        ):
            error[name_] = (out[name_][0] - exact) * dt
            error["d" + name_] = out[name_][0] * dt - moved
        return {key: np.where(case.inside, value, np.nan) / PIXEL for key, value in error.items()}

    def say(self, test: str, asked: str, reached: str) -> None:
        self.rows.append((test, asked, reached))
        print(f"{test:58s} {asked:>34s}   {reached}", flush=True)

    # -- figures -------------------------------------------------------------------------------------

    def texture(self) -> None:
        case = self.case("texture")
        exact = case.tank.rig
        first = {camera: images[FIRST] for camera, images in case.frames.items()}
        reached = []
        for pairs in ((), (("cam1", "cam2"),)):
            plan = Plan(exact, self.grid, replace(self.settings, pairs=pairs))
            flat = {
                c: stereo.prepare(ready(first[c], plan.binning[c]), c, plan) for c in plan.surface_cameras
            }
            found = stereo.surface(flat, plan)
            good = case.inside & ((found.quality & Quality.MEASURED) > 0)
            miss = (found.z - case.truth.z_start) / PIXEL
            reached.append(f"{rms(miss[good]):.4f} ({100 * good.sum() / case.inside.sum():.1f} % measured)")
        self.say("texture, exact cameras, frame-time z: all; pair 1-2, px", "0.015; 0.04", "; ".join(reached))
        plan = Plan(exact, self.grid, self.settings)
        result = diagnose({c: images[FIRST : FIRST + 2] for c, images in case.frames.items()}, plan, PIXEL)
        miss = result.recombined["cam1", "cam2"][case.inside] / PIXEL
        self.say("texture: recombined minus direct z, px", "0.06", f"{rms(miss):.4f}")
        self.diagnosis("texture", result)

    def diagnosis(self, name: str, result) -> None:
        for row in result.table():
            centimetres = "" if row["cm"] is None else f"{row['cm']:.4f} cm = "
            self.say(f"  {name}: {row['name']}", "", f"{centimetres}{row['px']:.4f} px")

    def seas(self) -> None:
        out = self.cube("rest")
        error = self.errors("rest", out)
        self.say("rest: z, px", "0.03", f"{rms(error['z']):.4f}")
        moved = "; ".join(f"{rms(error['d' + k]):.4f}" for k in "uvw")
        self.say("rest: dx, dy, dz, px", "0.03", moved)
        self.coverage("rest", out, error)
        for name, asked, outliers, share in (
            ("random", ("0.06", "0.05; 0.04; 0.07"), "0.05", "0.15"),
            ("steep", ("0.08", "0.08; 0.08; 0.09"), "0.2", "0.05"),
            ("noisy", ("0.08", "0.07; 0.06; 0.11"), "", ""),
        ):
            out = self.cube(name)
            case, error = self.case(name), self.errors(name, out)
            inside = case.inside
            truth = case.truth
            slope = np.hypot(*np.gradient(truth.z, self.grid.step))[inside].max()
            self.say(
                f"{name}: elevation, largest slope",
                "",
                f"{truth.z.min():.3f} to {truth.z.max():.3f} m, {slope:.2f}",
            )
            calm = {k: np.where(np.abs(v) > 1, np.nan, v) for k, v in error.items()}
            self.say(f"{name}: z at mid-time, px", asked[0], f"{rms(calm['z']):.4f}")
            self.say(
                f"{name}: u, v, w dt against instantaneous truth, px",
                asked[1],
                "; ".join(f"{rms(calm[k]):.4f}" for k in "uvw"),
            )
            self.say(
                f"{name}: dx, dy, dz against exact displacements, px",
                "",
                "; ".join(f"{rms(calm['d' + k]):.4f}" for k in "uvw"),
            )
            worst = max(np.mean(np.abs(error[k][inside]) > 1) for k in ("z", "u", "v", "w"))
            lost = ~np.isfinite(error["z"][inside])
            self.say(f"{name}: outliers (any of z, u, v, w), %", outliers, f"{100 * worst:.3f}")
            measured = ((out["quality"][0] & Quality.MEASURED) > 0)[inside].mean()
            self.say(
                f"{name}: nodes measured; NaN, %", "98; ", f"{100 * measured:.2f}; {100 * np.mean(lost):.2f}"
            )
            exact = {
                "z": truth.z,
                "z_t": (truth.z_end - truth.z_start) * case.tank.scene.frame_rate,
                "u": truth.u,
                "v": truth.v,
                "w": truth.dz * case.tank.scene.frame_rate,
                "mean": 0.5 * (truth.z_start + truth.z_end),
            }
            core = cv2.erode(inside.astype(np.uint8), np.ones((7, 7), np.uint8)) > 0
            shares = []
            for fields in (out, {key: value[None] for key, value in exact.items()}):
                fields = {key: np.nan_to_num(fields[key]).astype(np.float64) for key in exact}
                parts = terms(fields, self.grid.step, self.grid.step)
                shares.append(rms(parts["residual"][0][core]) / rms(parts["nonlinear"][0][core]))
            self.say(
                f"{name}: residual z_t - w + u . grad z over nonlinear term",
                share,
                f"{shares[0]:.3f}; of exact fields {shares[1]:.3f}",
            )
            self.coverage(name, out, error)
            if name == "random":
                two = self.cube(name, replace(self.settings, velocity_cameras=("cam1", "cam2")))
                self.say(
                    "random: eps' of cameras 1 and 2, px", "0.06", f"{rms(two['eps_piv'][0][inside]):.4f}"
                )

    def coverage(self, name: str, out, error) -> None:
        dt = 1.0 / self.case(name).tank.scene.frame_rate
        shares = []
        for key, scale in (("z", 1.0), ("u", dt), ("v", dt), ("w", dt)):
            std = out[key + "_std"][0] * scale / PIXEL
            ok = np.isfinite(error[key])
            shares.append(f"{100 * np.mean(np.abs(error[key])[ok] < std[ok]):.0f}")
        self.say(f"{name}: within one standard uncertainty: z, u, v, w, %", "60-80", "; ".join(shares))

    def faults(self) -> None:
        out = self.cube("holes")
        case, error = self.case("holes"), self.errors("holes", out)
        measured = (out["quality"][0] & Quality.MEASURED) > 0
        wrong = np.abs(error["z"]) > 3 * out["z_std"][0] / PIXEL
        x, y = np.meshgrid(self.grid.x_nodes, self.grid.y_nodes)
        beads = case.tank.population.frame(1)
        distance, _ = cKDTree(np.column_stack([beads.x, beads.y])).query(np.stack([x, y], axis=-1))
        empty = (distance > 0.015).astype(np.uint8)
        near = (cv2.dilate(empty, np.ones((7, 7), np.uint8)) > 0) & case.inside
        self.say(
            "holes: nodes without a bead within 1.5 cm, %", "", f"{100 * np.mean(empty[case.inside]):.2f}"
        )
        self.say("holes: nodes marked as filled, %", "", f"{100 * np.mean(~measured[case.inside]):.2f}")
        off = wrong & measured
        self.say(
            "holes: unmarked nodes wrong by more than 3 z_std: all; at holes, %",
            "never",
            f"{100 * np.mean(off[case.inside]):.3f}; {100 * np.mean(off[near]):.3f}",
        )
        self.say(
            "holes: the same beyond 0.1 px: all; at holes, %",
            "never",
            f"{100 * np.mean((off & (np.abs(error['z']) > 0.1))[case.inside]):.3f}; "
            f"{100 * np.mean((off & (np.abs(error['z']) > 0.1))[near]):.3f}",
        )
        filled = ~measured & case.inside
        self.say(
            "holes: z of filled nodes, px; within 3 z_std, %",
            "",
            f"{rms(error['z'][filled]):.3f}; {100 * np.mean(~wrong[filled]):.1f}",
        )
        self.say("holes: z of measured nodes, px", "", f"{rms(error['z'][measured]):.4f}")

        even, uneven = self.cube("random"), self.cube("light")
        difference = (even["z"][0] - uneven["z"][0])[self.case("random").inside] / PIXEL
        self.say("gains 1:5 and flicker 30 %: change of z, px", "0.02", f"{rms(difference):.4f}")

        for lost in self.case("random").frames:
            frames = {
                c: [None if c == lost and k == FIRST else image for k, image in enumerate(images)]
                for c, images in self.case("random").frames.items()
            }
            out = self.cube("random", frames=frames)
            error = self.errors("random", out)
            measured = (out["quality"][0] & Quality.MEASURED) > 0
            marked = bool((out["quality"][0] & Quality.FEWER_CAMERAS).all())
            calm = {k: np.where(measured & (np.abs(v) < 1), v, np.nan) for k, v in error.items()}
            self.say(
                f"{lost} missing in one frame: z, u, v, w, px; measured; marked",
                "goes on",
                "; ".join(f"{rms(calm[k]):.3f}" for k in ("z", "u", "v", "w"))
                + f"; {100 * measured[self.case('random').inside].mean():.1f} %; {marked}",
            )

    def speed(self) -> None:
        case = self.case("random")
        plan = Plan(case.tank.rig, self.grid, self.settings)
        frames = {c: [images[k % 4] for k in (0, 1, 2, 3, 2, 1)] for c, images in case.frames.items()}
        short = {c: images[:4] for c, images in frames.items()}
        flow = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
        raw = [image[:1024, :1024] for image in case.frames["cam1"][FIRST : FIRST + 2]]
        measure(short, plan, 20.0)
        flow.calc(raw[0], raw[1], None)
        steps, pairs = [], []
        for _ in range(3 if self.options.quick else 5):
            started = time.process_time()
            measure(short, plan, 20.0)
            middle = time.process_time()
            measure(frames, plan, 20.0)
            steps.append((time.process_time() - middle - (middle - started)) / 2)
            started = time.process_time()
            flow.calc(raw[0], raw[1], None)
            flow.calc(raw[1], raw[0], None)
            pairs.append(time.process_time() - started)
        self.say(
            f"a step over two DIS MEDIUM runs ({raw[0].shape[0]} x {raw[0].shape[1]})",
            "1.5 (aim 0.5)",
            f"{min(steps) / min(pairs):.2f}  ({1e3 * min(steps):.0f} ms; {1e3 * min(pairs):.0f} ms)",
        )

    def specimen(self, folder: Path, pictures: Path | None) -> None:
        from benchmarks.specimen import compare

        for test, asked, reached in compare(folder / "data" / "d_specimen", pictures):
            self.say(test, asked, reached)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="the middle of the field only")
    parser.add_argument("--preset", choices=["default", "fast"], default="default", help="of the settings")
    parser.add_argument("--exact", action="store_true", help="exact cameras instead of calibrated ones")
    parser.add_argument("--scale", type=float, default=1.0, help="size of the images over full size")
    parser.add_argument("--only", nargs="*", default=["texture", "seas", "faults", "speed", "specimen"])
    parser.add_argument("--shared", type=Path, help="folder with the real images")
    parser.add_argument("--pictures", type=Path, help="folder for pictures of the real fields")
    options = parser.parse_args()
    bench = Bench(options)
    kind = "exact cameras" if options.exact else "cameras calibrated from simulated target images"
    print(f"1 px = {1e3 * PIXEL} mm; {kind}; grid {bench.grid.shape}\n{'test':58s} {'asked':>34s}   reached")
    for part in options.only:
        if part == "specimen":
            if options.shared:
                bench.specimen(options.shared, options.pictures)
        else:
            getattr(bench, part)()


if __name__ == "__main__":
    main()
