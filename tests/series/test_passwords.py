"""Addresses that give access by themselves are refused, so that no message, log or attribute repeats them."""

import pytest
import yaml

from wavefield.errors import ExperimentError
from wavefield.series import Experiment

SECRET = "Open5esame"


@pytest.mark.parametrize(
    "address",
    [
        f"https://me:{SECRET}@host/data/run.zarr",
        f"https://{SECRET}@host/data/run.zarr",
        f"s3://bucket/cam1.zarr?X-Sig={SECRET}",
        f"https://host/img_{{frame}}.tif?token={SECRET}/+ab=",
    ],
)
@pytest.mark.parametrize("form", [lambda a: a, lambda a: [a], lambda a: {"images": a}])
def test_an_address_with_a_password_is_refused_without_it(tmp_path, address, form):
    cameras = {"cam1": form(address), "cam2": form("run.zarr")}
    path = tmp_path / "experiment.yaml"
    path.write_text(yaml.safe_dump({"name": "a", "frame_rate": 20, "cameras": cameras, "rig": "rig.yaml"}))
    with pytest.raises(ExperimentError, match="contains a password or token") as error:
        Experiment.load(path)
    assert SECRET not in str(error.value)
