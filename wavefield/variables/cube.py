"""The variables and codes of a cube, of its ledger and of a simulated experiment's truth."""

from dataclasses import replace
from enum import IntEnum, IntFlag
from typing import Any

from wavefield.variables.table import CUBE_DIMS, TABLE, Variable, register


class Quality(IntFlag):
    """Bits of the cube's ``quality``."""

    MEASURED = 1  # found by matching on its own
    FILLED = 2  # interpolated from its neighbours
    OUTSIDE = 4  # outside the field seen by the cameras
    REJECTED_CORRELATION = 8
    REJECTED_EPS = 16
    REJECTED_NEIGHBOURS = 32
    TWO_FRAME_MEAN = 64  # z at mid-time, or a path, from fewer than four frames
    FEWER_CAMERAS = 128  # a camera's frame is missing, or it contradicts the others: they did the work
    MASKED = 256  # covered: not water, or hidden from the cameras by what is not
    REJECTED_RANGE = 512  # beyond what was searched, or waves far above those that were sampled
    WITHOUT_1 = 1024  # of fewer cameras: without the first of the cube's `cameras`
    WITHOUT_2 = 2048
    WITHOUT_3 = 4096
    WITHOUT_4 = 8192
    WITHOUT_5 = 16384
    WITHOUT_6 = 32768  # or one behind it

    @classmethod
    def without(cls, number: int) -> "Quality":
        """Bits of a node that the others measured: without which camera, counted from 0."""
        return cls.FEWER_CAMERAS | cls(cls.WITHOUT_1.value << min(number, 5))


class FrameStatus(IntEnum):
    """Values of ``frame_status``: the ledger of a run."""

    NOT_STARTED = 0
    DONE = 1
    DONE_WITH_FAULTS = 2
    FAILED = 3
    DISCONTINUOUS = 4  # over a lost, doubled or late frame, or beside it: no values


class FrameFault(IntEnum):
    """What is wrong with a frame."""

    NONE = 0
    MISSING = 1
    UNREADABLE = 2  # corrupt, truncated, or not an image
    WRONG_SIZE = 3  # other rows, columns or type than the rest
    BLANK = 4  # black, or all pixels equal
    RANGE = 5  # the water went further than is searched; the image itself is good
    REPEATED = 6  # bit for bit the frame before it: no camera takes the same noise twice


AROUND = 2  # frames before and after those of a step that enter it
EXACT_SIX = 7  # code for six frames as well, with the displacement of the quintic through them
# by `path_frames`: what the displacement from frame to frame weighs in that at mid-time, and those beside it
# either way; exact for a cubic in time. Those of 6 let less noise pass than those of 4, and leave 1/6 of the
# displacement of the fastest waves that frames show: the weights of least noise would leave none of some
PATH_WEIGHTS: dict[int, tuple[float, ...]] = {
    2: (1.0,),
    4: (26 / 24, -1 / 24),
    6: (34 / 48, 10 / 48, -3 / 48),
    EXACT_SIX: (2134 / 1920, -116 / 1920, 9 / 1920),
}
INSTANTANEOUS = 1  # frames: of velocities at an instant, as a model has them, no displacements over dt


def frames_of_path(code: int) -> int:
    """Number of frames that a path passes through, from `path_frames`."""
    return 6 if code == EXACT_SIX else code


def _cube(name: str, units: str, long_name: str, **more: Any) -> Variable:
    return Variable(name, CUBE_DIMS, units, long_name, **more)


def _flags(enum: Any) -> dict[str, Any]:
    key = "flag_masks" if issubclass(enum, IntFlag) else "flag_values"
    return {
        key: [int(member) for member in enum],
        "flag_meanings": " ".join(member.name.lower() for member in enum),
    }


register(
    Variable("time", ("time",), "s", "time at mid-step", dtype="float64", extra={"axis": "T"}),
    Variable("x", ("x",), "m", "x", dtype="float64", extra={"axis": "X"}),
    Variable("y", ("y",), "m", "y", dtype="float64", extra={"axis": "Y"}),
    Variable(
        "path_frames",
        (),
        "1",
        "frames that velocity and rate of rise come from",
        dtype="uint8",
        meaning="6: six frames, least noise; 7: six frames, exact to the fifth degree in time; 4: four "
        "frames; 2: one step; 1: instantaneous velocities. Fewer are used near lost frames and at the ends",
        extra={
            "flag_values": [1, 2, 4, 6, EXACT_SIX],
            "flag_meanings": "instantaneous one_step four_frames six_frames_smooth six_frames_exact",
        },
    ),
    _cube(
        "z",
        "m",
        "surface elevation",
        standard_name="water_surface_height_above_reference_datum",
        meaning="at mid-time, from six frames, in axes that move with the mean flow",
        extra={"ancillary_variables": "z_std z_level_std quality", "frames": 2 * AROUND + 2, "moving": 1},
    ),
    _cube(
        "z_t",
        "m s-1",
        "rate of rise of the surface",
        meaning="at a fixed node",
    ),
    *(
        _cube(
            name,
            "m s-1",
            text,
            standard_name=standard_name,
            meaning="at mid-time, along the path of the water",
            extra={"ancillary_variables": f"{name}_std quality"},
        )
        for name, text, standard_name in (
            ("u", "velocity along x", "surface_sea_water_x_velocity"),
            ("v", "velocity along y", "surface_sea_water_y_velocity"),
            ("w", "vertical velocity", "upward_sea_water_velocity"),
        )
    ),
    _cube("eps_y", "m", "stereo mismatch across the sight line"),
    _cube("eps_piv", "pixel", "misfit of the cameras' displacements"),
    _cube("z_std", "m", "standard uncertainty of z", meaning="excludes `z_level_std`"),
    Variable(
        "z_level_std",
        (),
        "m",
        "standard uncertainty of z = 0",
        dtype="float64",
        meaning="common to all nodes and times; z_std excludes it",
    ),
    _cube("u_std", "m s-1", "standard uncertainty of u"),
    _cube("v_std", "m s-1", "standard uncertainty of v"),
    _cube("w_std", "m s-1", "standard uncertainty of w"),
    _cube("quality", "1", "how a value came about", dtype="uint16", extra=_flags(Quality)),
    Variable("frame_status", ("time",), "1", "ledger of the run", dtype="uint8", extra=_flags(FrameStatus)),
)

CUBE_FIELDS = tuple(name for name, row in TABLE.items() if row.dims == CUBE_DIMS)

register(
    Variable("frame", ("frame",), "1", "frame number", dtype="int64"),
    Variable("camera", ("camera",), "", "camera", dtype="str"),
    Variable(
        "frame_fault",
        ("camera", "frame"),
        "1",
        "what was wrong with a frame",
        dtype="uint8",
        extra=_flags(FrameFault),
    ),
    # exact fields of a simulated experiment
    _cube("z_rate", "m s-1", "instantaneous rate of rise of the surface"),
    _cube("z_start", "m", "surface elevation at the step's first frame"),
    _cube("z_end", "m", "surface elevation at the step's second frame"),
    _cube("dx", "m", "displacement along x of the water whose path has its mid-point here"),
    _cube("dy", "m", "displacement along y of the water whose path has its mid-point here"),
    _cube("dz", "m", "displacement along z of the water whose path has its mid-point here"),
)

# what the frames of an experiment hold, as xarray opens them
register(
    replace(TABLE["time"], long_name="time of the frame", group="frames"),
    Variable("frame", ("time",), "1", "frame number", dtype="int64", group="frames"),
    Variable("camera", (), "", "camera", dtype="str", group="frames"),
    Variable("image", ("time", "row", "column"), "1", "image", dtype="uint8", group="frames"),
    Variable("present", ("time",), "1", "presence of a file", dtype="bool", group="frames"),
    Variable(
        "departure",
        ("time",),
        "1",
        "delay of a frame behind its even time, by the cameras' clocks, over the frame interval",
        dtype="float64",
        group="frames",
    ),
)
