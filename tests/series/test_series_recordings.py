"""Cameras' own files, written here byte by byte from the formats' public descriptions."""

import struct

import h5py
import numpy as np
import pytest
import zarr

from tests.series.series_cases import count_reported
from wavefield.errors import ExperimentError, FrameError
from wavefield.quality.record import remark_on_recordings
from wavefield.series import Experiment
from wavefield.series.formats import open_recording
from wavefield.series.listing import number_frames
from wavefield.series.readers import close_files, read_entry

COUNT, ROWS, COLUMNS = 5, 6, 8


def images(bits):
    return np.random.default_rng(bits).integers(0, 2**bits, (COUNT, ROWS, COLUMNS)).astype("<u2")


def pack(image, bits):
    """Pixels one after another, the highest bit first."""
    text = "".join(f"{value:0{bits}b}" for value in image.ravel().tolist())
    text += "0" * (-len(text) % 8)
    return bytes(int(text[k : k + 8], 2) for k in range(0, len(text), 8))


def as_bytes(image, bits):
    return image.astype("u1").tobytes() if bits == 8 else image.astype("<u2").tobytes()


def write_cine(path, bits, *, packed=False, times=()):
    setup = bytearray(0x400)
    setup[140:144] = struct.pack("<2sH", b"ST", len(setup))
    setup[0x300:0x304] = struct.pack("<I", 2000)
    code = {10: 256, 12: 1024}[bits] if packed else 0
    depth = 8 if bits == 8 else 16
    frames = [pack(i, bits) if packed else as_bytes(i[::-1], bits) for i in images(bits)]
    at_image, at_setup = 44, 84
    setup += struct.pack("<IHHQ", 16, 1001, 0, 0)  # another block
    stamps = b"".join(struct.pack("<II", int(t % 1 * 2**32), int(t)) for t in times)
    setup += struct.pack("<IHH", 8 + len(stamps), 1002, 0) + stamps
    at_offsets = at_setup + len(setup)
    offsets, at = [], at_offsets + 8 * COUNT
    for frame in frames:
        offsets.append(at)
        at += 12 + len(frame)  # a note of 12 bytes before the pixels
    header = struct.pack(
        "<2sHHHiIiIIIIII", b"CI", 44, 2, 1, -3, COUNT, -3, COUNT, at_image, at_setup, at_offsets, 0, 0
    )
    bitmap = struct.pack(
        "<IiiHHIIiiII", 40, COLUMNS, ROWS, 1, depth, code, len(frames[0]), 0, 0, 0, 1 << bits
    )
    body = b"".join(struct.pack("<III", 12, 7, len(frame)) + frame for frame in frames)
    path.write_bytes(header + bitmap + bytes(setup) + struct.pack(f"<{COUNT}q", *offsets) + body)


def write_photron(path, bits, *, xml=True):
    frames = [pack(i, bits) if bits in (10, 12) else as_bytes(i, bits) for i in images(bits)]
    path.write_bytes(b"".join(frames))
    if xml:
        path.with_suffix(".cihx").write_bytes(
            b"\x00\x01binary<cih><frameInfo><totalFrame>%d</totalFrame><startFrame>-3</startFrame></frameInfo>"
            b"<recordInfo><recordRate>2000</recordRate></recordInfo><imageDataInfo><resolution>"
            b"<width>%d</width><height>%d</height></resolution><colorInfo><type>Mono</type><bit>%d</bit>"
            b"</colorInfo></imageDataInfo></cih>\x00" % (COUNT, COLUMNS, ROWS, bits)
        )
    else:
        path.with_suffix(".cih").write_text(
            f"#Camera Information Header\nRecord Rate(fps) : 2000\nTotal Frame : {COUNT}\nStart Frame : -3\n"
            f"Image Width : {COLUMNS}\nImage Height : {ROWS}\nColor Bit : {bits}\nFile Format : MRaw\n"
        )


def write_seq(path, bits, times=(0.0,) * COUNT, pictures=(), rate=2000.0):
    pictures = pictures or [images(bits)[k % COUNT] for k in range(len(times))]
    (rows, columns), depth = pictures[0].shape, 8 if bits == 8 else 16
    each = rows * columns * depth // 8
    head = bytearray(8192)
    struct.pack_into("<I", head, 0, 0xFEED)
    struct.pack_into("<i", head, 28, 5)
    struct.pack_into("<9I", head, 548, columns, rows, depth, bits, each, 100, len(times), 0, each + 16)
    struct.pack_into("<d", head, 584, rate)
    stamps = [round(t * 1e6) for t in times]
    ends = [struct.pack("<IHH8x", t // 10**6, t // 1000 % 1000, t % 1000) for t in stamps]
    path.write_bytes(bytes(head) + b"".join(as_bytes(i, bits) + e for i, e in zip(pictures, ends)))


def write_hdf5(path, bits):
    with h5py.File(path, "w") as file:
        file["run/images"] = images(bits)
        file.attrs["frame_rate"] = 2000.0


CASES = {
    "cine 8": ("a.cine", 8, lambda p: write_cine(p, 8)),
    "cine 16": ("a.cine", 14, lambda p: write_cine(p, 14)),
    "cine packed 10": ("a.cine", 10, lambda p: write_cine(p, 10, packed=True)),
    "cine packed 12": ("a.cine", 12, lambda p: write_cine(p, 12, packed=True)),
    "photron 8": ("a.mraw", 8, lambda p: write_photron(p, 8)),
    "photron 10": ("a.mraw", 10, lambda p: write_photron(p, 10)),
    "photron 12": ("a.mraw", 12, lambda p: write_photron(p, 12, xml=False)),
    "photron 16": ("a.mraw", 16, lambda p: write_photron(p, 16)),
    "streampix 8": ("a.seq", 8, lambda p: write_seq(p, 8)),
    "streampix 16": ("a.seq", 12, lambda p: write_seq(p, 12)),
    "hdf5": ("a.h5", 12, lambda p: write_hdf5(p, 12)),
}


@pytest.fixture(params=CASES.values(), ids=CASES)
def recording(request, tmp_path):
    name, bits, write = request.param
    write(tmp_path / name)
    yield tmp_path / name, bits
    close_files()


def test_images_come_back_to_the_bit_in_any_order(recording):
    path, bits = recording
    opened = open_recording(path)
    assert (opened.count, opened.shape, opened.rate) == (COUNT, (ROWS, COLUMNS), 2000.0)
    for index in (3, 0, 4, 1, 2):
        np.testing.assert_array_equal(opened.read(index), images(bits)[index])
    with pytest.raises(FrameError, match="there is no image 5"):
        opened.read(5)
    opened.close()


@pytest.mark.parametrize(
    "stored", [{"chunks": (1, ROWS, COLUMNS)}, {}, {"compression": "gzip"}, {"chunks": (2, 3, 8)}]
)
@pytest.mark.parametrize("kind", ["<u2", ">u2", "u1"])
def test_images_of_hdf5_however_they_are_stored(tmp_path, stored, kind):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        data = file.create_dataset("images", (COUNT, ROWS, COLUMNS), kind, fillvalue=7, **stored)
        data[:3], data[4] = images(8)[:3], images(8)[4]
    opened = open_recording(tmp_path / "a.h5")
    np.testing.assert_array_equal(opened.read(2), images(8)[2])
    assert opened.read(2).dtype == np.dtype(kind).newbyteorder("=")
    assert (opened.read(3) == 7).all()  # never written
    opened.close()


@pytest.mark.parametrize("stored", [{}, {"compressors": None}, {"compressors": None, "chunks": (2, 3, 8)}])
@pytest.mark.parametrize("kind", ["<u2", ">u2", "u1"])
@pytest.mark.parametrize("version", [2, 3])
def test_images_of_zarr_however_they_are_stored(tmp_path, stored, kind, version):
    array = zarr.create_array(
        str(tmp_path / "a.zarr"),
        **{"shape": (COUNT, ROWS, COLUMNS), "chunks": (1, ROWS, COLUMNS), **stored},
        dtype=kind,
        fill_value=7,
        zarr_format=version,
    )
    array[:3] = images(8)[:3]
    entries = number_frames("{camera}.zarr", tmp_path, "a")
    np.testing.assert_array_equal(read_entry(entries[2]), images(8)[2])
    assert (read_entry(entries[4]) == 7).all()  # never written
    close_files()


def note(folder, text, more=""):
    (folder / "experiment.yaml").write_text(f"name: lab\ncameras: {{{text}}}\n{more}")
    return folder / "experiment.yaml"


def test_the_frame_rate_is_the_recording_s_where_the_note_has_none(recording, tmp_path):
    path, _ = recording
    text = f'a: "{{camera}}{path.suffix}"'
    assert Experiment.load(note(tmp_path, text)).frame_rate == 2000.0
    experiment = Experiment.load(note(tmp_path, text, "frame_rate: 20.0\n"))
    assert experiment.frame_rate == 20.0
    assert "its recording gives 2000 Hz, but experiment.yaml gives 20 Hz" in str(
        next(remark_on_recordings(experiment, {}))
    )


def test_cameras_recorded_at_different_rates_are_reported(tmp_path):
    write_seq(tmp_path / "a.seq", 8)
    write_photron(tmp_path / "b.mraw", 8)
    (tmp_path / "b.cihx").write_bytes((tmp_path / "b.cihx").read_bytes().replace(b"2000", b"1000"))
    with pytest.raises(ExperimentError, match="a was recorded at 2000 Hz and b at 1000: state frame_rate"):
        Experiment.load(note(tmp_path, "a: a.seq, b: b.mraw"))
    with pytest.raises(ExperimentError, match="frame_rate is missing"):
        Experiment.load(note(tmp_path, "a: nowhere.seq, b: 'img_{frame}.tif'"))


def test_damaged_files_are_reported_in_one_sentence(recording):
    assert count_reported(recording[0], reach=1200) > 0


def test_a_recording_that_was_cut_short_keeps_the_images_before(tmp_path):
    write_seq(tmp_path / "a.seq", 8)
    data = (tmp_path / "a.seq").read_bytes()
    (tmp_path / "a.seq").write_bytes(data[:-100])
    assert open_recording(tmp_path / "a.seq").count == COUNT - 2


def test_several_datasets_are_distinguished_by_name(tmp_path):
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["cam1/images"], file["cam2/images"] = images(8), images(8)[:, ::-1]
    with pytest.raises(FrameError, match=r"name one, as run\.h5/cam1/images"):
        open_recording(tmp_path / "run.h5")
    entries = number_frames("run.h5/{camera}/images", tmp_path, "cam2")
    np.testing.assert_array_equal(read_entry(entries[1]), images(8)[1, ::-1])
    with pytest.raises(FrameError, match="no images called 'cam3/images'"):
        open_recording(tmp_path / "run.h5" / "cam3" / "images")
    close_files()


@pytest.mark.parametrize(("name", "write"), [("a.cine", write_cine), ("a.seq", write_seq)])
def test_images_that_a_camera_dropped_leave_gaps_where_its_file_holds_times(tmp_path, name, write):
    taken = 1.7e9 + np.array([0, 1, 2, 5, 6]) / 2000  # two were dropped
    write(tmp_path / name, 8, times=taken)
    np.testing.assert_allclose(open_recording(tmp_path / name).times(), taken, rtol=0, atol=2e-6)
    experiment = Experiment.load(note(tmp_path, f"a: {name}"))
    series = experiment.open_frames()
    assert series["a"].missing.tolist() == [3, 4]
    np.testing.assert_array_equal(series["a"].read(6).image, images(8)[4])
    reported = [str(remark) for remark in remark_on_recordings(experiment, series)]
    assert len(reported) == 1
    assert reported[0].startswith("a: 2 of 7 frames are missing: 3-4")
    close_files()


def remarks_on(folder, **cameras):
    """Remarks on recordings by the times in them, and the frames that are missing."""
    for name, times in cameras.items():
        write_seq(folder / f"{name}.seq", 8, times)
    named = ", ".join(f"{name}: {name}.seq" for name in cameras)
    experiment = Experiment.load(note(folder, named, "frame_rate: 2000\n"))
    series = experiment.open_frames()
    reported = {(r.subject, r.kind): r for r in remark_on_recordings(experiment, series)}
    close_files()
    return reported, {name: one.missing.tolist() for name, one in series.items()}


def test_a_camera_that_alone_dropped_images_stays_aligned_with_the_others(tmp_path):
    even = 9.0 + np.arange(80) / 2000
    reported, missing = remarks_on(tmp_path, a=even, b=np.delete(even, [7, 8, 40]) + 0.3)
    assert missing == {"a": [], "b": [7, 8, 40]}
    assert not reported  # fewer than a tenth


def test_recordings_in_a_row_keep_the_time_between_them(tmp_path):
    write_seq(tmp_path / "a_0.seq", 8, 9.0 + np.arange(5) / 2000)
    write_seq(tmp_path / "a_1.seq", 8, 9.0 + np.arange(8, 13) / 2000)
    experiment = Experiment.load(note(tmp_path, "a: [a_0.seq, a_1.seq]"))
    assert experiment.frame_rate == 2000
    series = experiment.open_frames()["a"]
    assert series.missing.tolist() == [5, 6, 7]
    np.testing.assert_array_equal(series.read(9).image, images(8)[1])
    close_files()


def test_times_of_no_whole_intervals_are_reported_and_shift_no_frame(tmp_path):
    even = 9.0 + np.arange(80) / 2000
    late = np.where(np.arange(80) == 20, even + 0.6 / 2000, even)  # a stamp that came late
    bursts = np.where(np.arange(80) < 40, even, even + 3600.0)
    for times, first in ((late, 19), (bursts, 39)):
        reported, missing = remarks_on(tmp_path, a=times)
        assert missing == {"a": []}
        assert list(reported) == [("a", "frame times")]
        assert reported["a", "frame times"].values["first"] == first


@pytest.mark.parametrize("attached", [True, False], ids=["coordinate", "beside"])
def test_times_of_images_are_read_from_hdf5(tmp_path, attached):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["run/images"] = images(8)
        file["run/t" if attached else "run/time"] = np.array([1000, 1050, 1100, 1250, 1300])
        times = file["run/t" if attached else "run/time"]
        times.attrs["units"] = "milliseconds since 2026-01-01"
        if attached:
            times.make_scale("t")
            file["run/images"].dims[0].attach_scale(times)
    recording = open_recording(tmp_path / "a.h5")
    np.testing.assert_allclose(recording.times(), [1.0, 1.05, 1.1, 1.25, 1.3])
    assert recording.rate == 20.0
    recording.close()
    series = Experiment.load(note(tmp_path, "a: a.h5")).open_frames()
    assert series["a"].missing.tolist() == [3, 4]
    close_files()
    with h5py.File(tmp_path / "a.h5", "a") as file:
        file["run/t" if attached else "run/time"].attrs["units"] = "images"
    recording = open_recording(tmp_path / "a.h5")
    assert (len(recording.times()), recording.rate) == (0, None)
    recording.close()
    assert not Experiment.load(note(tmp_path, "a: a.h5", "frame_rate: 20")).open_frames()["a"].missing.size
    close_files()
