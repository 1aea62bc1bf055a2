"""Values that YAML would convert, texts of other systems, and names that would leave their folder."""

import pytest

from wavefield.errors import ExperimentError
from wavefield.series import Experiment

NOTE = """\
name: lab
frame_rate: 20.0
cameras:
  cam1: {images: "cam1/img_{frame}.tif"}
  cam2: {images: "cam2/img_{frame}.tif"}
rig: rig.yaml
"""


def loaded(folder, old="", new="", text=NOTE):
    path = folder / "experiment.yaml"
    assert old in text
    path.write_bytes(text.replace(old, new).encode())
    return Experiment.load(path)


def complaint(folder, old="", new="", text=NOTE):
    with pytest.raises(ExperimentError) as caught:
        loaded(folder, old, new, text)
    words = str(caught.value)
    assert "experiment.yaml" in words
    assert "\n" not in words
    return words


@pytest.mark.parametrize("value", ["yes", "on", "1:30", "1:30:00", "2020-01-01", "20,0", "20 Hz"])
def test_words_clocks_and_dates_are_no_numbers(tmp_path, value):
    assert "line 2: frame_rate should be a number" in complaint(tmp_path, "20.0", value)


@pytest.mark.parametrize(
    ("value", "rate"),
    [("20", 20), ("020", 20), ("2e1", 20), ("2.0e+1", 20), (".5e2", 50), ("1_000", 1000), ("0x14", 20)],
)
def test_numbers_are_read_as_people_write_them(tmp_path, value, rate):
    assert loaded(tmp_path, "20.0", value).frame_rate == rate


@pytest.mark.parametrize("name", ["2020-01-01", "7", "run 3", "Küste"])
def test_dates_and_numbers_are_fine_names(tmp_path, name):
    assert loaded(tmp_path, "name: lab", f"name: {name}").name == name


@pytest.mark.parametrize(
    "name", ["../x", "..", "/abs", "CON", "nul.txt", r"'a\b'", "1:30", "'a*'", '"a\\nb"', "''", 101 * "a"]
)
def test_names_of_cameras_and_experiments_stay_in_their_folder(tmp_path, name):
    assert "line 1: name: " in complaint(tmp_path, "name: lab", f"name: {name}")
    words = complaint(tmp_path, "cam1: {", f"{name}: {{")
    assert "line 3: cameras: " in words
    assert "use letters, digits, - and _" in words


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be"])
def test_other_encodings_get_their_remedy(tmp_path, encoding):
    path = tmp_path / "experiment.yaml"
    path.write_bytes(NOTE.encode(encoding))
    with pytest.raises(ExperimentError, match=r"experiment.yaml.* UTF-16.* save it as UTF-8"):
        Experiment.load(path)
    path.write_bytes(NOTE.encode("utf-8-sig"))
    assert Experiment.load(path).name == "lab"


@pytest.mark.parametrize("path", [r'"C:\temp\new.tif"', r'"cam1\img_{frame}.tif"', r'"cam1\new_{frame}.tif"'])
def test_backslashes_in_double_quotes_are_refused_with_the_remedy(tmp_path, path):
    words = complaint(tmp_path, '"cam1/img_{frame}.tif"', path)
    assert "line 4: " in words
    assert "in double quotes \\ begins a special character" in words
    assert "write / between folders" in words


def test_backslashes_between_folders_are_refused_with_the_remedy(tmp_path):
    words = complaint(tmp_path, '"cam1/img_{frame}.tif"', r"'cam1\img_{frame}.tif'")
    assert "line 4: cameras.cam1.images" in words
    assert "write /, which is read on Windows as well" in words
    assert words.count(";") == 1
    assert "line 6: rig" in complaint(tmp_path, "rig: rig.yaml", r"rig: C:\lab\rig.yaml")


def test_a_folder_of_images_in_place_of_their_names(tmp_path):
    (tmp_path / "cam1").mkdir()
    (tmp_path / "cam1" / "img_0.tif").touch()
    with pytest.raises(ExperimentError, match=r"cam1 is not a Zarr array .*name the images, as in"):
        loaded(tmp_path, '"cam1/img_{frame}.tif"', "cam1").open_frames()
