"""Faults of folders of frames and magnitudes of settings, drawn at random, the same for the same seed."""

import shutil

import numpy as np
import yaml

from wavefield.images import read_image, write_image

FACTORS = (1e-9, 1e-6, 1e-3, 1e-2, 0.1, 10.0, 100.0, 1e3, 1e6, 1e9, 1e15, -1.0, -1e3, 0.0)


def some_frames(chance, count):
    """A share of a record: its beginning, its end, every n-th frame, or any."""
    share = chance.choice([0.1, 0.5, 0.6, 0.8, 1.0])
    some = max(1, round(share * count))
    kind = chance.randrange(4)
    if kind == 0:
        return list(range(some))
    if kind == 1:
        return list(range(count - some, count))
    if kind == 2:
        return list(range(0, count, max(1, round(1 / share))))
    return sorted(chance.sample(range(count), some))


def files_of(folder, camera):
    return sorted((folder / camera).glob("img_*.tif"))


def spoil_frames(folder, chance):
    """One fault in one camera or in all; returns its words, and the steps that it may have left whole."""
    cameras = chance.choice([["cam1"], ["cam2"], ["cam3"], ["cam1", "cam2", "cam3"]])
    kind = chance.choice(sorted(FRAME_FAULTS))
    count = len(files_of(folder, "cam1"))
    chosen = some_frames(chance, count)
    for camera in cameras:
        FRAME_FAULTS[kind](folder, files_of(folder, camera), chosen, chance)
    bad = set(chosen)
    if kind == "frozen":  # the first frame of the piece is itself
        lost = sum(k in bad and k + 1 in bad for k in range(count - 1))
    else:
        lost = sum(k in bad or k + 1 in bad for k in range(count - 1))
    if kind == "other type" and len(chosen) == count:
        lost = 0  # which is a sound record
    return f"{kind} in {', '.join(cameras)}: frames {chosen}", 1 - lost / (count - 1)


def change(function):
    def fault(folder, files, chosen, chance):
        for k in chosen:
            write_image(files[k], function(read_image(files[k]), chance))

    return fault


def remove(folder, files, chosen, chance):
    for k in chosen:
        files[k].unlink()


def truncate(folder, files, chosen, chance):
    share = chance.choice([0.0, 0.01, 0.3, 0.6, 0.95])
    for k in chosen:
        data = files[k].read_bytes()
        files[k].write_bytes(data[: int(share * len(data))])


def freeze(folder, files, chosen, chance):
    first = files[chosen[0]].read_bytes()
    for k in chosen:
        files[k].write_bytes(first)


def rename(folder, files, chosen, chance):
    """Numbers that leap: by a constant, or to far away."""
    leap = chance.choice([1000, 10**6, 10**9, 10**15])
    for k in chosen:
        files[k].rename(files[k].with_name(f"img_{leap + k:05d}.tif"))


def add(folder, files, chosen, chance):
    """Files of other numbers, or of the same once more."""
    for k in chosen:
        shutil.copy(files[k], files[k].with_name(chance.choice([f"img_{k}.tif", f"img_{10**7 + k}.tif"])))


def exchange(folder, files, chosen, chance):
    """Frames of another camera in the place of these."""
    other = "cam3" if files[0].parent.name != "cam3" else "cam1"
    for k in chosen:
        shutil.copy(folder / other / files[k].name, files[k])


def not_a_number(image, chance):
    return np.full(image.shape, np.nan, np.float32)


FRAME_FAULTS = {
    "missing": remove,
    "black": change(lambda image, chance: np.zeros_like(image)),
    "NaN": change(not_a_number),
    "other type": change(lambda image, chance: image.astype(np.uint16) * 256),
    "other size": change(lambda image, chance: np.ascontiguousarray(image[:-16])),
    "truncated": truncate,
    "frozen": freeze,
    "renamed": rename,
    "added": add,
    "exchanged": exchange,
}


def numbers_in(data, path=()):
    """Places of all numbers in plain data."""
    if isinstance(data, dict):
        for key, value in data.items():
            yield from numbers_in(value, (*path, key))
    elif isinstance(data, list):
        for key, value in enumerate(data):
            yield from numbers_in(value, (*path, key))
    elif isinstance(data, int | float) and not isinstance(data, bool):
        yield path


SETTINGS = {
    "frames": {"first": 0, "last": 16},
    "water": {"depth": 0.7, "level": 0.01, "density": 1000.0, "surface_tension": 0.073},
    "settings": {"z_range": [-0.08, 0.08], "bead_height": 0.0004, "smoothing": 1.0, "eps_limit": 3.0},
}


def spoil_magnitudes(folder, chance):
    """Numbers of the experiment file or the rig, one or some of a kind, by a factor; returns its words."""
    name = chance.choice(["experiment.yaml", "experiment.yaml", "rig.yaml"])
    data = yaml.safe_load((folder / name).read_text())
    if name == "experiment.yaml":
        part = chance.choice(sorted(SETTINGS))
        data[part] = {**SETTINGS[part], **(data.get(part) or {})}
        data["cameras"]["cam2"]["offset"] = 0
    places = list(numbers_in(data))
    chosen = chance.choice(places)
    factor = chance.choice(FACTORS)
    alike = [p for p in places if p[: max(1, len(chosen) - 1)] == chosen[: max(1, len(chosen) - 1)]]
    for place in alike if chance.random() < 0.3 else [chosen]:
        part = data
        for key in place[:-1]:
            part = part[key]
        value = (part[place[-1]] or 1) * factor
        part[place[-1]] = int(value) if isinstance(part[place[-1]], int) else value
    (folder / name).write_text(yaml.safe_dump(data))
    return f"{name}: {'.'.join(map(str, chosen))} x {factor:g}"
