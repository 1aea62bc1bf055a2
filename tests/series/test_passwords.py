"""What gives access to addresses of images never enters messages, logs or attributes."""

import re
from urllib.parse import quote, unquote

import fsspec
import numpy as np
import pytest
import yaml
import zarr
from fsspec.implementations.memory import MemoryFileSystem
from hypothesis import given
from hypothesis import strategies as st

from wavefield.commands.cli import main
from wavefield.errors import WavefieldError
from wavefield.images import read_image
from wavefield.pipeline.opened_run import image_names
from wavefield.series import Experiment

SECRET = "Open5esame"  # part of every password and token, so that any form of it is found
ANSWERS = ("nothing", "no access", "other names", "spoiled images")
PLACES = (
    *("cam1/img_{frame:03d}.tif", "cam1/*.tif", "cam1/img_%03d.tif", "cam1/{frame}_{frame}.tif"),
    *("cam1/a.tif", "run.zarr", "run.zarr/cam1", "x" * 300 + "/*.tif", ""),
)


class Server(MemoryFileSystem):
    """A store of objects that repeats in its errors what it was asked for, as libraries do."""

    protocol = ("https", "s3")
    answer = "nothing"
    asked = ""

    @classmethod
    def _strip_protocol(cls, path):
        Server.asked = str(path)
        return super()._strip_protocol(re.sub(r"^[a-z0-9]+:/+", "memory://", str(path)))

    def _refuse(self, path):
        if self.answer == "no access":
            raise PermissionError(f"403 for {unquote(self.asked)}, {self.asked}, {path}")
        raise FileNotFoundError(path)

    def ls(self, path, detail=True, **how):
        if self.answer in ("nothing", "no access"):
            self._refuse(path)
        names = [f"{path}/{'b' if self.answer == 'other names' else 'img_'}00{k}.tif" for k in range(3)]
        return [{"name": n, "size": 9, "type": "file"} for n in names] if detail else names

    def cat_file(self, path, *range_, **how):
        if self.answer != "spoiled images":
            self._refuse(path)
        return b"no image"

    def _open(self, path, *mode, **how):
        self._refuse(path)


def note(folder, images):
    cameras = {"cam1": {"images": images}, "cam2": {"images": images}}
    path = folder / "experiment.yaml"
    path.write_text(yaml.safe_dump({"name": "a", "frame_rate": 20, "cameras": cameras, "rig": "rig.yaml"}))
    return path


word = st.text("abcXYZ019-_.~!$%+:@&=", max_size=6)


@given(
    *(st.sampled_from(("https", "s3")), st.sampled_from(PLACES), st.sampled_from(ANSWERS)),
    *(st.tuples(word, word), st.booleans(), st.sampled_from(("", "token", "X-Sig"))),
)
def test_passwords_and_tokens_stay_out_of_messages_and_attributes(
    tmp_path_factory, scheme, place, answer, around, quoted, token
):
    from fsspec.registry import _registry

    secret = f"{around[0]}{SECRET}{around[1]}"
    secret = quote(secret, safe="") if quoted else secret
    address = f"{scheme}://me:{secret}@host/data/{place}" + (f"?{token}={secret}/+ab=" if token else "")
    path = note(tmp_path_factory.mktemp("lab"), address)
    with pytest.MonkeyPatch.context() as patch:
        for protocol in ("https", "s3"):
            patch.setitem(_registry, protocol, Server)
        patch.setattr(Server, "answer", answer)
        fsspec.filesystem(scheme).clear_instance_cache()
        assert SECRET not in "".join(words_on(path))


def words_on(path):
    """What the package says of an experiment whose images cannot be read."""
    try:
        experiment = Experiment.load(path)
        yield f"{experiment!r} {experiment._repr_html_()} {image_names(experiment, 'cam1')}"
        experiment.open_frames()
    except WavefieldError as error:
        yield str(error)
    else:
        pytest.fail("the images are not there")


def test_nothing_that_a_run_writes_or_prints_contains_a_password(own_tank, capsys, monkeypatch):
    for camera in ("cam1", "cam2", "cam3"):
        frames = [read_image(file) for file in sorted((own_tank.parent / camera).glob("*.tif"))]
        frames[3] = frames[3] * 0  # has to be named
        zarr.save_array(f"memory://me:{SECRET}@host/{camera}.zarr", np.stack(frames))
    text = re.sub(r'"(cam.)/[^"]*"', rf'"memory://me:{SECRET}@host/\1.zarr"', own_tank.read_text())
    own_tank.unlink()
    lab = own_tank.parent / "new"
    lab.mkdir()
    (lab / "experiment.yaml").write_text(text.replace("rig.yaml", "../rig.yaml"))
    (lab / "here.yaml").write_text("cluster: none\n")
    monkeypatch.chdir(lab)
    assert main(["-v", "run", "experiment.yaml", "--workflow", "here.yaml"]) in (0, 3)
    assert main(["status", "cube.zarr"]) in (0, 3)
    assert main(["export", "cube.zarr", "cube.mat"]) in (0, 3)
    fsspec.filesystem("memory").store.clear()
    assert main(["check", "experiment.yaml"]) == 1
    printed = capsys.readouterr()
    assert "blank: frame 3" in printed.out
    assert "cam1.zarr" in printed.err
    assert SECRET not in printed.out + printed.err
    written = [file for file in lab.rglob("*") if file.is_file() and file.name != "experiment.yaml"]
    assert len(written) > 20
    assert not [file.name for file in written if SECRET.encode() in file.read_bytes()]
