"""Random cameras and points for the tests of this room, and files of other programs."""

import numpy as np
from scipy.spatial.transform import Rotation

from wavefield.rig import Camera

TERMS = ("k1", "k2", "p1", "p2", "k3", "tau_x", "tau_y", "skew")


def random_camera(seed, *without):
    rng = np.random.default_rng(seed)
    aim = np.array([*rng.uniform(-0.3, 0.3, 2), 0.0])
    centre = np.array([*rng.uniform(-2.5, 2.5, 2), rng.uniform(3.0, 5.0)])
    z = (aim - centre) / np.linalg.norm(aim - centre)
    x = np.cross(z, rng.normal(size=3))
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(z, x), z])
    terms = {
        "k1": rng.uniform(-0.2, 0.1),
        "k2": rng.uniform(-0.1, 0.1),
        "p1": rng.uniform(-2e-3, 2e-3),
        "p2": rng.uniform(-2e-3, 2e-3),
        "k3": rng.uniform(-0.1, 0.1),
        "tau_x": rng.uniform(-0.1, 0.1),
        "tau_y": rng.uniform(-0.1, 0.1),
        "skew": rng.uniform(-3.0, 3.0),
    }
    for name in without:
        terms[name] = 0.0
    f = rng.uniform(2000.0, 4000.0)
    c = rng.uniform(450.0, 570.0, 2)
    return Camera(f, f * rng.uniform(0.98, 1.02), c[0], c[1], R, -R @ centre, (1024, 1024), **terms)


def field(seed, n=200):
    rng = np.random.default_rng(seed + 1000)
    return (*rng.uniform(-0.5, 0.5, (2, n)), rng.uniform(-0.1, 0.1, n))


def vic_xml(rig):
    """A rig as VIC-3D writes it: lengths in millimetres, angles about x, y, z in turn, degrees."""
    cameras = ""
    for camera in rig.cameras.values():
        terms = [getattr(camera, name) for name in ("cx", "cy", "fx", "fy", "skew", "k1", "k2", "k3")]
        angles = Rotation.from_matrix(camera.R).as_euler("xyz", degrees=True)
        pose = " ".join(repr(float(v)) for v in (*angles, *(1e3 * camera.T)))
        cameras += f"<camera>{' '.join(map(repr, terms))}<orientation>{pose}</orientation></camera>"
    width, height = camera.size
    mask = f'<polygonmask width="{width}" height="{height}"/>'
    return f"<project><calibration>{cameras}</calibration>{mask}</project>"


def dice_xml(rig):
    """A rig as DICe's camera system."""
    cameras = ""
    for camera in rig.cameras.values():
        keys = ("CX", "CY", "FX", "FY", "FS", "K1", "K2", "K3")
        terms = dict(zip(keys, ("cx", "cy", "fx", "fy", "skew", "k1", "k2", "k3")))
        values = {key: repr(getattr(camera, name)) for key, name in terms.items()}
        values |= dict(zip(("TX", "TY", "TZ"), map(repr, (1e3 * camera.T).tolist())))
        values |= {"IMAGE_HEIGHT_WIDTH": "{{ {}, {} }}".format(*camera.size[::-1])}
        values |= {"LENS_DISTORTION_MODEL": "OPENCV_LENS_DISTORTION"}
        numbers = (str(row).replace("[", "{").replace("]", "}") for row in camera.R.tolist())
        rows = {f"ROW {k}": row for k, row in enumerate(numbers)}
        own, turn = (
            "".join(f'<Parameter name="{key}" value="{value}"/>' for key, value in one.items())
            for one in (values, rows)
        )
        cameras += f"<ParameterList>{own}<ParameterList>{turn}</ParameterList></ParameterList>"
    return f"<ParameterList>{cameras}</ParameterList>"
