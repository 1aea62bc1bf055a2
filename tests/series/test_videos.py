"""Videos made here: every frame and its time, in turn, at random and alone."""

import re
import struct
from fractions import Fraction

import av
import numpy as np
import pytest

from wavefield.errors import FrameError
from wavefield.quality.record import remark_on_recordings
from wavefield.series import Experiment
from wavefield.series.formats.video import Video
from wavefield.series.readers import FrameEntry, close_files, count_images, read_entry

ROWS, COLUMNS = 96, 160
EVEN = [(n, 0.05 * n) for n in range(45)]
GAPS = [(n, 0.05 * n) for n in range(45) if n not in (10, 11, 30)]
JITTER = [(n, 0.05 * n + 0.004 * (n % 3)) for n in range(45)]

VIDEOS = {
    "mp4, B-frames": ("a.mp4", "libx264", EVEN, {}, 2),
    "mp4, variable rate": ("a.mp4", "libx264", JITTER, {}, 2),
    "mp4, open groups": ("a.mp4", "libx264", GAPS, {"x264-params": "open-gop=1:keyint=8:bframes=3"}, 3),
    "mp4, H.265": ("a.mp4", "libx265", GAPS, {"x265-params": "log-level=none:keyint=10"}, 2),
    "mp4, MPEG-4, gaps": ("a.mp4", "mpeg4", GAPS, {}, 2),
    "mov, H.264": ("a.mov", "libx264", JITTER, {}, 2),
    "mkv, H.264, gaps": ("a.mkv", "libx264", GAPS, {}, 2),
    "mkv, FFV1": ("a.mkv", "ffv1", GAPS, {}, 0),
    "mkv, VP9": ("a.mkv", "libvpx-vp9", GAPS, {"deadline": "realtime", "cpu-used": "8"}, 0),
    "avi, motion JPEG": ("a.avi", "mjpeg", EVEN, {}, 0),
    "avi, MPEG-4, B-frames": ("a.avi", "mpeg4", EVEN, {}, 2),
    "avi, H.264, B-frames": ("a.avi", "libx264", EVEN, {}, 2),
}


def picture(number):
    """An image that shows its number as bits."""
    image = np.full((ROWS, COLUMNS), 90, np.uint8)
    for bit in range(8):
        image[16:48, 16 * bit + 8 : 16 * bit + 24] = 230 if number >> bit & 1 else 20
    return image


def number_of(image):
    return sum(int(image[24:40, 16 * bit + 12 : 16 * bit + 20].mean() > 120) << bit for bit in range(8))


def write_video(path, codec, frames, options=None, b_frames=0):
    formats = {"mjpeg": "yuvj420p", "ffv1": "gray"}
    with av.open(str(path), "w") as film:
        stream = film.add_stream(codec, rate=20, options=options or {})
        stream.width, stream.height, stream.pix_fmt = COLUMNS, ROWS, formats.get(codec, "yuv420p")
        stream.codec_context.gop_size, stream.codec_context.max_b_frames = 12, b_frames
        stream.codec_context.time_base = stream.time_base = Fraction(1, 1000)
        for number, time in frames:
            frame = av.VideoFrame.from_ndarray(picture(number), format="gray")
            frame.pts, frame.time_base = round(1000 * time), Fraction(1, 1000)
            film.mux(stream.encode(frame))
        film.mux(stream.encode(None))


@pytest.mark.parametrize("kind", VIDEOS)
def test_frames_and_their_times_are_those_of_the_container(tmp_path, kind):
    name, codec, frames, options, b_frames = VIDEOS[kind]
    if codec not in av.codecs_available:
        pytest.skip(f"this FFmpeg does not write {codec}")
    path = tmp_path / name
    write_video(path, codec, frames, options, b_frames)
    numbers = [number for number, _ in frames]
    assert count_images(path) == ("images", len(frames))
    video = Video(path)
    assert [number_of(video.read(k)) for k in range(video.count)] == numbers
    order = np.random.default_rng(1).permutation(video.count).tolist()
    assert [number_of(video.read(k)) for k in order] == [numbers[k] for k in order]
    if name == "a.avi":  # its frames are at an even rate by definition
        assert len(video.times()) in (0, len(frames))
    if len(video.times()):
        np.testing.assert_allclose(video.times(), [time for _, time in frames], atol=1.1e-3)
    assert video.rate == pytest.approx(20.0, rel=0.02)
    video.close()
    for k in (0, 7, len(frames) - 1):
        alone = Video(path)
        assert number_of(alone.read(k)) == numbers[k]
        alone.close()


def test_what_a_trimmed_video_does_not_show_is_not_counted(tmp_path):
    path, cut = tmp_path / "a.mp4", 5
    write_video(path, "libx264", EVEN, {}, 2)
    data = bytearray(path.read_bytes())
    entry = data.index(b"elst") + 12
    duration, start = struct.unpack_from(">Ii", data, entry)
    with av.open(str(path)) as film:
        step = round(0.05 / film.streams.video[0].time_base)
    struct.pack_into(">Ii", data, entry, duration, start + cut * step)
    path.write_bytes(bytes(data))
    video = Video(path)
    assert [number_of(video.read(k)) for k in range(video.count)] == list(range(cut, 45))
    assert number_of(video.read(3)) == cut + 3
    assert video.times()[0] == 0.0
    video.close()


@pytest.mark.parametrize("degrees", [90, 180])
def test_a_rotation_that_the_container_states_is_not_applied(tmp_path, degrees):
    path, one = tmp_path / "a.mp4", 1 << 16
    write_video(path, "mpeg4", EVEN[:6])
    data = bytearray(path.read_bytes())
    matrix = (0, one, 0, -one, 0, 0) if degrees == 90 else (-one, 0, 0, 0, -one, 0)
    struct.pack_into(">9i", data, data.index(b"tkhd") + 44, *matrix, COLUMNS * one, ROWS * one, 1 << 30)
    path.write_bytes(bytes(data))
    video = Video(path)
    assert (video.shape, number_of(video.read(5))) == ((ROWS, COLUMNS), 5)
    video.close()
    (tmp_path / "e.yaml").write_text("name: e\nframe_rate: 500\ncameras: {a: a.mp4}\n")
    (note,) = remark_on_recordings(Experiment.load(tmp_path / "e.yaml"), {})
    assert re.search(f"its video states a rotation of -?{degrees} degrees, which is not applied", str(note))


def test_a_video_whose_camera_dropped_frames_leaves_gaps_at_any_playback_rate(tmp_path):
    write_video(tmp_path / "a.mkv", "ffv1", GAPS)
    for rate in ("", "frame_rate: 500\n"):  # of a high-speed camera
        (tmp_path / "e.yaml").write_text(f"name: e\n{rate}cameras: {{a: a.mkv}}\n")
        experiment = Experiment.load(tmp_path / "e.yaml")
        assert experiment.frame_rate == (500 if rate else 20)
        frames = experiment.open_frames()
        assert frames["a"].missing.tolist() == [10, 11, 30]
        assert number_of(frames["a"].read(12).image) == 12
        words = "".join(map(str, remark_on_recordings(experiment, frames)))
        assert ("20 Hz is the playback rate of its video" in words) == (not rate)
    close_files()


def test_a_damaged_or_missing_video_is_named(tmp_path):
    path = tmp_path / "a.mp4"
    with pytest.raises(FrameError, match=r"a\.mp4: no such"):
        count_images(path)
    path.write_bytes(b"not a video" * 100)
    with pytest.raises(FrameError, match=r"a\.mp4 cannot be read as a video"):
        count_images(path)
    write_video(path, "mpeg4", EVEN)
    data = bytearray(path.read_bytes())
    start = data.index(b"mdat") + 4
    data[start + 1500 : start + 1600] = bytes(100)
    path.write_bytes(bytes(data))
    read = 0
    for k in range(45):
        try:
            read += read_entry(FrameEntry("images", str(path), k)).shape == (ROWS, COLUMNS)
        except FrameError as error:
            assert "cannot be decoded" in str(error)  # noqa: PT017
    assert read > 20
    close_files()
