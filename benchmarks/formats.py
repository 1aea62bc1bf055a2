"""What files of images cost: opening 12,000 frames, and reading one beside reading its bytes.

Run: python -m benchmarks.formats [--frames N] [--folder FOLDER]

Recordings are sparse files of full-size frames (2432 x 1728), so they need little room; frames that are read
hold noise. CPU time, the median of some tries, a frame and its bytes (read into an array) in turn; files
just written come from memory, not from a disk, which would add the same to a file and to its bytes.
Packed pixels fill 1.33 and 1.6 times as many bytes in memory as in the file.
"""

import struct
import tempfile
import time
from collections.abc import Callable, Sequence
from itertools import cycle
from pathlib import Path

import cv2
import h5py
import numpy as np
import tifffile
import zarr

from benchmarks.options import parser_of
from wavefield.series.listing import number_frames
from wavefield.series.readers import close_files, read_entry

ROWS, COLUMNS = 1728, 2432
NOISE = np.random.default_rng(1).integers(0, 4096, (ROWS, COLUMNS)).astype("<u2")


def least(work: Callable[[], object], tries: int = 7) -> float:
    """CPU time, s."""
    best = np.inf
    for _ in range(tries):
        since = time.process_time()
        work()
        best = min(best, time.process_time() - since)
    return best


def in_turn(works: Sequence[Callable[[], object]], tries: int = 31) -> list[float]:
    """Median CPU time of each, s."""
    times: list[list[float]] = [[] for _ in works]
    for _ in range(tries):
        for work, spent in zip(works, times, strict=True):
            since = time.process_time()
            work()
            spent.append(time.process_time() - since)
    return [float(np.median(spent)) for spent in times]


def raw(path: Path, head: bytes, each: int, count: int, skip: int = 0) -> int:
    """A sparse recording with noise in its middle frame; bytes of a frame's pixels."""
    with path.open("wb") as stream:
        stream.write(head)
        stream.truncate(len(head) + count * (each + skip))
        stream.seek(len(head) + (count // 2) * (each + skip))
        stream.write(NOISE.tobytes()[:each])
    return each


def seq(folder: Path, count: int) -> tuple[str, int]:
    each, head = 2 * ROWS * COLUMNS, bytearray(8192)
    struct.pack_into("<I", head, 0, 0xFEED)
    struct.pack_into("<i", head, 28, 5)
    struct.pack_into("<9I", head, 548, COLUMNS, ROWS, 16, 12, each, 100, count, 0, each + 16)
    struct.pack_into("<d", head, 584, 20.0)
    return "a.seq", raw(folder / "a.seq", bytes(head), each, count, 16)


def photron(bits: int) -> Callable[[Path, int], tuple[str, int]]:
    def write(folder: Path, count: int) -> tuple[str, int]:
        (folder / "a.cih").write_text(
            f"Record Rate(fps) : 20\nTotal Frame : {count}\nImage Width : {COLUMNS}\n"
            f"Image Height : {ROWS}\nColor Bit : {bits}\n"
        )
        return "a.mraw", raw(folder / "a.mraw", b"", ROWS * COLUMNS * bits // 8, count)

    return write


def cine(folder: Path, count: int) -> tuple[str, int]:
    each, at = 2 * ROWS * COLUMNS, 84 + 0x400
    head = struct.pack("<2sHHHiIiIIIIII", b"CI", 44, 0, 1, 0, count, 0, count, 44, 84, at, 0, 0)
    head += struct.pack("<IiiHHIIiiII", 40, COLUMNS, -ROWS, 1, 16, 0, each, 0, 0, 0, 4096) + bytes(0x400)
    begin = at + 8 * count
    head += (begin + np.arange(count, dtype="<i8") * each).tobytes()
    written = raw(folder / "a.cine", head, each, count)
    with (folder / "a.cine").open("r+b") as stream:
        stream.seek(begin + (count // 2) * each)
        stream.write(struct.pack("<I", 4))  # length of the note before the pixels
        stream.truncate(begin + (count + 1) * each)
    return "a.cine", written


def hdf5(**options: str) -> Callable[[Path, int], tuple[str, int]]:
    def write(folder: Path, count: int) -> tuple[str, int]:
        shape, chunks = (count, ROWS, COLUMNS), (1, ROWS, COLUMNS)
        with h5py.File(folder / "a.h5", "w") as file:
            data = file.create_dataset("images", shape, "u2", chunks=chunks, **options)
            data[count // 2] = NOISE
            return "a.h5", data.id.get_chunk_info(0).size

    return write


def zarr_array(**options: None) -> Callable[[Path, int], tuple[str, int]]:
    def write(folder: Path, count: int) -> tuple[str, int]:
        shape, chunks = (count, ROWS, COLUMNS), (1, ROWS, COLUMNS)
        array = zarr.create_array(str(folder / "a.zarr"), shape=shape, chunks=chunks, dtype="u2", **options)
        array[count // 2] = NOISE
        return "a.zarr", (
            folder / "a.zarr" / array.metadata.encode_chunk_key((count // 2, 0, 0))
        ).stat().st_size

    return write


def files(ending: str, image: np.ndarray, *options: int) -> Callable[[Path, int], tuple[str, int]]:
    def write(folder: Path, count: int) -> tuple[str, int]:
        for k in range(count):
            (folder / f"img_{k:05d}.{ending}").touch()
        one = folder / f"img_{count // 2:05d}.{ending}"
        if ending == "tif" and not options:
            tifffile.imwrite(one, image)
        else:
            cv2.imwrite(str(one), image, list(options))
        return "img_{frame:05d}." + ending, one.stat().st_size

    return write


def pages(folder: Path, count: int) -> tuple[str, int]:
    with tifffile.TiffWriter(folder / "a.tif", bigtiff=True) as tiff:
        for k in range(count):
            tiff.write(NOISE if k == count // 2 else NOISE[:16, :16], contiguous=False)
    return "a.tif", NOISE.nbytes


def video(folder: Path, count: int) -> tuple[str, int]:
    count = min(count, 200)  # the header holds their number: opening does not depend on it
    film = cv2.VideoWriter(
        str(folder / "a.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 20.0, (COLUMNS, ROWS), isColor=True
    )
    for _ in range(count):
        film.write(cv2.cvtColor((NOISE >> 4).astype("u1"), cv2.COLOR_GRAY2BGR))
    film.release()
    return "a.avi", (folder / "a.avi").stat().st_size // count


FORMATS: dict[str, Callable[[Path, int], tuple[str, int]]] = {
    "TIFF, 16 bits, a file each": files("tif", NOISE),
    "TIFF, 8 bits, a file each": files("tif", (NOISE >> 4).astype("u1")),
    "TIFF, LZW, a file each": files("tif", NOISE, cv2.IMWRITE_TIFF_COMPRESSION, 5),
    "PNG, 8 bits, a file each": files("png", (NOISE >> 4).astype("u1")),
    "BigTIFF of all frames": pages,
    "Phantom cine, 16 bits": cine,
    "Photron mraw, 16 bits": photron(16),
    "Photron mraw, 12 bits packed": photron(12),
    "Photron mraw, 10 bits packed": photron(10),
    "StreamPix seq, 16 bits": seq,
    "HDF5": hdf5(),
    "HDF5, gzip": hdf5(compression="gzip"),
    "Zarr": zarr_array(compressors=None),
    "Zarr, zstd": zarr_array(),
    "AVI, motion JPEG (200 frames)": video,
}


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--frames", type=int, default=12000)
    parser.add_argument("--folder", type=Path, help="where to write, and take away again (some 100 MB)")
    options = parser.parse_args()
    print(f"{'':32s} {'open, s':>8s} {'a frame, ms':>12s} {'its bytes, ms':>14s} {'ratio':>6s}")
    for name, write in FORMATS.items():
        with tempfile.TemporaryDirectory(dir=options.folder) as place:
            folder = Path(place)
            pattern, each = write(folder, options.frames)
            opening = least(lambda f=folder, p=pattern: number_frames(p, f, "cam1"), 2)  # type: ignore[misc]
            numbered = number_frames(pattern, folder, "cam1")
            entries = cycle([numbered[len(numbered) // 2]])
            if pattern == "a.avi":  # a video is read frame after frame; a jump decodes those before
                entries = cycle([numbered[k] for k in sorted(numbered)])
            plain = folder / "plain"
            plain.write_bytes(NOISE.tobytes()[:each].ljust(each, b"\1"))
            works: list[Callable[[], object]] = [
                lambda e=entries: read_entry(next(e)),  # type: ignore[misc]
                lambda p=plain: np.fromfile(p, np.uint8),  # type: ignore[misc]
            ]
            frame, bare = in_turn(works)
            close_files()
            line = f"{name:32s} {opening:8.3f} {1e3 * frame:12.2f} {1e3 * bare:14.2f} {frame / bare:6.1f}"
            print(line, flush=True)


if __name__ == "__main__":
    main()
